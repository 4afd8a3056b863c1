"""Ray aiming at the stop: the ray of an object point through each point of the stop, or the edge that ends it.

Rays are aimed without apertures, so apertures only stop rays with known paths. The first rays of a field are continued
from the axis, all others from rays of the same field. A continuation that ends at a surface's edge names the surface.
Positions are in the camera frame, mm.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from lfmesh.geometry import frame as frames
from lfmesh.geometry.lens.element_poses import pose_of
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.optics.ray_aiming import ContinuedRays, aim_rays, continue_rays
from lfmesh.transport.packets.book import STOP, TRAPPED, TURNED_BACK
from lfmesh.transport.sequences.bundle import DROPPED
from lfmesh.transport.sequences.follower import route_of
from lfmesh.transport.sequences.ray_tables import Arrived, follow_to, without_apertures
from lfmesh.transport.sequences.sequences import LENS_LEG, Leg
from lfmesh.transport.tables.tables import Camera, LensTables
from lfmesh.transport.trace import at_wavelength
from lfmesh.transport.world import World
from lfmesh.waves.ray_ends import IN_GRADIENT, Edge, Ends

Array = NDArray[np.float64]
Whole = NDArray[np.int64]

DIFFERENCE = 1e-5
"""Step of the finite differences for derivatives, over the stop's radius."""

INSIDE = 1.0 - 1e-9
"""Factor for points on the rim of the stop, so that their rays pass it."""

RINGS = ((0.4, 6), (0.75, 10), (1.0, 14))
"""Radii, over the stop's, and numbers of rays used to interpolate guesses for many others."""

MANY = 100
"""Number of rays from which rays on rings are found first, to interpolate guesses."""

DEGREES = (5, 3, 1)
"""Degrees of the interpolating polynomials; the first with enough known rays is used."""

CLOSE = 0.1
"""Largest distance of a ray from its interpolated guess, over its distance from the chief ray."""

NEAR_CAUSTIC = 0.1
"""Ratio of the areas to which known rays map, below which interpolated rays may lie beyond a caustic."""

NEAR_EDGE = 1e-3
"""Distance from the end of a continuation, over the front's radius, within which a surface's end is sought."""

NEAR_FOLD = 1e-2
"""Distance from the end of a continuation, over the front's radius, within which a caustic is sought."""

TURNED = (TURNED_BACK + 1.0, TRAPPED + 1.0)
"""Codes of rays that end in gradient-index glass without an edge, see `bundle.ENDED_ON`."""

TRIALS = 33
"""Trial rays along each axis of the front, if no ray can be continued from the axis."""


class Sent(NamedTuple):
    """Rays of a field through points of the stop.

    Attributes
    ----------
    entry : (n, 2) float64, mm
        Points on the plane of the first vertex; NaN if no ray reaches the point of the stop.
    ends : Ends
        Edges that end the latter before the stop.
    """

    entry: Array
    ends: Ends


class _Known(NamedTuple):
    """Known rays of a field: points of the stop (n, 2), mm, entries, and derivatives of the points by the entries."""

    aim: Array
    entry: Array
    derivative: Array

    def taken(self, which: Whole) -> "_Known":
        """Return some of these rays."""
        return _Known(self.aim[which], self.entry[which], self.derivative[which])


@dataclass(frozen=True)
class StopAim:
    """Ray aiming from the points of one object plane to points of the stop.

    Attributes
    ----------
    world : World
        Its lens surfaces have formulas.
    vergence : float
        1/mm: inverse distance of the object plane before the first vertex; 0 for parallel bundles, negative for points
        behind it.
    """

    world: World
    vergence: float

    @cached_property
    def stop(self) -> int:
        """Number of the stop in the prescription."""
        return solved_camera(self.world.scene).paraxial.stop

    @cached_property
    def stop_radius(self) -> float:
        """Radius of the stop, mm."""
        return solved_camera(self.world.scene).scene.camera.lens.surfaces[self.stop].semi_diameter_mm or math.nan

    @cached_property
    def front_radius(self) -> float:
        """Rim radius of the first surface's mesh, at least that of the stop, mm."""
        return float(max(self.world.lens_shape.rims[0], self.stop_radius))

    @cached_property
    def _into_stop(self) -> Array:
        return frames.inverse(pose_of(self.world.scene.camera.lens, self.stop))

    @cached_property
    def _faces_to_stop(self) -> int:
        """Number of refracting surfaces up to and including the stop."""
        return sum(number <= self.stop for number in self.world.lens_shape.numbers)

    @cached_property
    def _stop_z(self) -> float:
        """Vertex of a stop that is not a refracting surface, else NaN."""
        lens = self.world.scene.camera.lens
        return float(lens.vertices_mm[self.stop]) if lens.is_pure_stop(self.stop) else math.nan

    @cached_property
    def _fields(self) -> dict[float, dict[tuple[float, float], _Known]]:
        """Known rays by wavelength and slope, the chief ray first if there is one."""
        return {}

    @cached_property
    def _cameras(self) -> dict[float, Camera]:
        """Cameras without apertures, by wavelength."""
        return {}

    @cached_property
    def far_ahead(self) -> float:
        """Start plane of rays traced without apertures, in front of the surfaces' continuations."""
        before = float(self.world.tables.lens.box_low[2])
        free = before - 4.0 * self.front_radius
        return min(before, max(free, -1.0 / self.vergence)) if self.vergence > 0.0 else free

    def starts(self, slope: Array, entry: Array, z_mm: float | None = None) -> tuple[Array, Array]:
        """Return the start points of rays before the lens, and their unit directions, (n, 3) each.

        Parameters
        ----------
        slope : (n, 2) float64
            x and y of the object points over their distance.
        entry : (n, 2) float64, mm
            Points on the plane of the first vertex.
        z_mm : float, optional
            Start plane (default: just before the lens).
        """
        ahead = np.column_stack([entry * self.vergence - slope, np.ones(len(entry))])
        before = float(self.world.tables.lens.box_low[2]) if z_mm is None else z_mm
        start = np.column_stack([entry, np.zeros(len(entry))]) + before * ahead
        return start, ahead / np.linalg.norm(ahead, axis=1, keepdims=True)

    def _unbounded(self, slope: Array, entry: Array, wavelength_nm: float, faces: int) -> Arrived:
        """Trace rays through the first faces, which continue beyond their apertures."""
        if wavelength_nm not in self._cameras:
            tables = at_wavelength(self.world, wavelength_nm)
            self._cameras[wavelength_nm] = tables._replace(lens=without_apertures(tables.lens)).camera
        route = route_of([Leg(LENS_LEG, tuple(range(faces)), (False,) * faces, True)], checked=False)
        return follow_to(self._cameras[wavelength_nm], route, *self.starts(slope, entry, self.far_ahead))

    def unstopped(self, slope: Array, entry: Array, wavelength_nm: float) -> Arrived:
        """Trace rays through the whole lens, apertures ignored.

        Parameters
        ----------
        slope, entry : (n, 2) float64
            As for `starts`.
        wavelength_nm : float
        """
        return self._unbounded(slope, entry, wavelength_nm, len(self.world.lens_shape.numbers))

    def at_stop(self, slope: Array, entry: Array, wavelength_nm: float) -> Array:
        """Return the points of rays on the stop, in its frame, apertures ignored.

        Parameters
        ----------
        slope, entry : (n, 2) float64
            As for `starts`.
        wavelength_nm : float

        Returns
        -------
        (n, 2) float64, mm
            NaN for rays that miss a surface before the stop, are totally reflected there, or turn back in
            gradient-index glass.
        """
        if self._faces_to_stop == 0:
            # The stop stands before the lens.
            position, direction = self.starts(slope, entry)
            comes = np.ones(len(position), np.bool_)
        else:
            arrived = self._unbounded(slope, entry, wavelength_nm, self._faces_to_stop)
            position, direction, comes = arrived.position, arrived.direction, arrived.weight > 0.0
        p = frames.points(self._into_stop, position)
        if not math.isnan(self._stop_z):
            d = frames.directions(self._into_stop, direction)
            p = p + ((self._stop_z - p[:, 2]) / d[:, 2])[:, None] * d
        return np.where(comes[:, None], p[:, :2], np.nan)

    def through(self, field: Array, aim: Array, wavelength_nm: float) -> Sent:
        """Return the rays of a field through points of the stop.

        Parameters
        ----------
        field : (2,) float64
            Slope of the object point, see `starts`.
        aim : (n, 2) float64, mm
            Points of the stop, in its frame.
        wavelength_nm : float
        """
        entry = np.full(aim.shape, np.nan)
        ends = Ends(np.zeros(len(aim), np.int64), np.full(len(aim), -1))
        mine = self._of_wavelength(wavelength_nm)
        if len(aim) < MANY and tuple(field) not in mine:
            # A few rays are continued directly from the nearest field.
            next_field, near = self._nearest(field, wavelength_nm)
            if len(near.aim):
                middle = near.taken(np.zeros(len(aim), np.int64))
                found = self._continued((next_field, field), middle, aim, wavelength_nm)
                entry[found.arrived] = found.start[found.arrived]
        left = np.flatnonzero(~np.isfinite(entry[:, 0]))
        if not len(left):
            return Sent(entry, ends)
        known = self._known(field, wavelength_nm)
        if not len(known.aim):
            return Sent(entry, self._no_ray(field, len(aim), wavelength_nm))
        entry[left] = self._interpolated(known, field, aim[left], wavelength_nm)
        left = left[~np.isfinite(entry[left, 0])]
        # Continue from the nearest known rays until none is added.
        while len(left):
            near = known.taken(KDTree(known.aim).query(aim[left])[1])
            found = self._continued((field, field), near, aim[left], wavelength_nm)
            entry[left[found.arrived]] = found.start[found.arrived]
            known = _of(found, aim[left])
            if not len(known.aim) or found.arrived.all():
                ended = left[~found.arrived]
                ends.edge[ended], ends.surface[ended] = self._edges(field, aim[ended], found, wavelength_nm)
                break
            left = left[~found.arrived]
        return Sent(entry, ends)

    def _continued(
        self, fields: tuple[Array, Array], known: _Known, to_aim: Array, wavelength_nm: float
    ) -> ContinuedRays:
        """Continue known rays (n, 2) of one field to another field and other points of the stop."""
        field, to_field = fields

        def miss(entry: Array, share: Array, which: Whole) -> Array:
            share = share[:, None]
            slope = field + share * (to_field - field)
            wanted = known.aim[which] + share * (to_aim - known.aim)[which]
            return self.at_stop(slope, entry, wavelength_nm) - wanted

        given = known.derivative if np.isfinite(known.derivative).all() else None
        return continue_rays(miss, known.entry, DIFFERENCE * self.stop_radius, self.stop_radius, given)

    def _of_wavelength(self, wavelength_nm: float) -> dict[tuple[float, float], _Known]:
        """Return the known fields at a wavelength, at least the axial one."""
        if wavelength_nm not in self._fields:
            self._fields[wavelength_nm] = {(0.0, 0.0): self._axial(wavelength_nm)}
        return self._fields[wavelength_nm]

    def _nearest(self, field: Array, wavelength_nm: float) -> tuple[Array, _Known]:
        """Return the nearest field with known rays, and these rays."""
        mine = self._of_wavelength(wavelength_nm)
        slopes = [slope for slope, known in mine.items() if len(known.aim)] or [(0.0, 0.0)]
        nearest = min(slopes, key=lambda slope: math.dist(slope, field))
        return np.array(nearest), mine[nearest]

    def _known(self, field: Array, wavelength_nm: float) -> _Known:
        """Return some rays of a field: its chief ray and others on rings of the stop."""
        key, mine = (float(field[0]), float(field[1])), self._of_wavelength(wavelength_nm)
        middle = mine.get(key, _nothing())
        if key in mine and len(middle.aim) != 1:
            return middle
        if key not in mine:
            middle = self._from_next(field, wavelength_nm)
        if not len(middle.aim):
            middle = self._by_trials(field, wavelength_nm)
        if len(middle.aim):
            points = self.stop_radius * INSIDE * _rings()
            near = middle.taken(KDTree(middle.aim).query(points)[1])
            found = _of(self._continued((field, field), near, points, wavelength_nm), points)
            middle = _Known(*(np.concatenate(pair) for pair in zip(middle, found, strict=True)))
        mine[key] = middle
        return middle

    def _axial(self, wavelength_nm: float) -> _Known:
        """Return the chief ray of the axial point; in a centred lens, the axis itself."""
        axis = np.zeros((1, 2))
        hit = self.at_stop(axis, axis, wavelength_nm)
        if not np.isfinite(hit).all():
            return _nothing()
        start = _Known(hit, axis, np.full((1, 2, 2), np.nan))
        return _of(self._continued((axis[0], axis[0]), start, axis, wavelength_nm), axis)

    def _from_next(self, field: Array, wavelength_nm: float) -> _Known:
        """Return a field's chief ray, continued from the nearest field, or other rays continued from the axis."""
        for next_field, near in (
            self._nearest(field, wavelength_nm),
            (np.zeros(2), self._of_wavelength(wavelength_nm)[0.0, 0.0]),
            (np.zeros(2), self._known(np.zeros(2), wavelength_nm)),
        ):
            if len(near.aim):
                found = _of(self._continued((next_field, field), near, near.aim, wavelength_nm), near.aim)
                if len(found.aim):
                    return found
        return _nothing()

    def _by_trials(self, field: Array, wavelength_nm: float) -> _Known:
        """Return rays of a field found by trials across the front."""
        trial = self.trials()
        hit = self.at_stop(np.broadcast_to(field, trial.shape), trial, wavelength_nm)
        senses = self._senses(np.broadcast_to(field, trial.shape), trial, wavelength_nm)
        ok = np.flatnonzero(np.isfinite(hit).all(axis=1) & np.isfinite(senses))
        # Keep the branch at the middle of the front; another lies beyond a caustic.
        ok = ok[senses[ok] == senses[ok[np.argsort(np.hypot(*trial[ok].T))[:1]]]]
        nearest = np.argsort(np.hypot(*hit[ok].T))[:TRIALS]
        start = _Known(hit[ok][nearest], trial[ok][nearest], np.full((len(nearest), 2, 2), np.nan))
        return _of(self._continued((field, field), start, start.aim, wavelength_nm), start.aim)

    def trials(self) -> Array:
        """Return points (n, 2), mm, on a square grid across the front of the lens, in the plane of the first vertex."""
        steps = np.linspace(-1.0, 1.0, TRIALS) * self.front_radius
        return np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)

    def turned_share(self, field: Array, entry: Array, wavelength_nm: float) -> float:
        """Return the fraction of rays with reversed neighbourhoods in the stop, as beyond a caustic.

        The rarer orientation counts as reversed.

        Parameters
        ----------
        field : (2,) float64
        entry : (n, 2) float64, mm
        wavelength_nm : float
        """
        senses = self._senses(np.broadcast_to(field, entry.shape), entry, wavelength_nm)
        # At borders the neighbourhood is unknown.
        turned = senses[np.isfinite(senses)] < 0.0
        return float(min(turned.mean(), 1.0 - turned.mean())) if len(turned) else 0.0

    def _senses(self, slope: Array, entry: Array, wavelength_nm: float) -> Array:
        """Return the orientation, ±1 (n,), of rays around each ray in the stop; NaN at borders."""
        sides = DIFFERENCE * self.stop_radius * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
        trial = (entry + sides[:, None]).reshape(-1, 2)
        hit = self.at_stop(np.tile(slope, (4, 1)), trial, wavelength_nm).reshape(4, -1, 2)
        (a, b), (c, d) = (hit[0] - hit[1]).T, (hit[2] - hit[3]).T
        return np.asarray(np.sign(a * d - b * c))

    def _interpolated(self, known: _Known, field: Array, aim: Array, wavelength_nm: float) -> Array:
        """Return the entries of rays found from guesses by polynomials through known rays; NaN if not found."""
        entry, scale = np.full(aim.shape, np.nan), 1.0 / self.stop_radius
        degree = next((each for each in DEGREES if len(known.aim) >= 1.4 * _terms(each)), None)
        if degree is None:
            return entry
        fit = np.linalg.lstsq(_powers(known.aim * scale, degree), known.entry, rcond=None)[0]
        guess = np.asarray(_powers(aim * scale, degree) @ fit, dtype=np.float64)
        by_x, by_y = (_powers_by(aim * scale, degree, axis) @ fit * scale for axis in (0, 1))
        derivative = np.asarray(np.linalg.inv(_regular(np.stack([by_x, by_y], axis=2))), dtype=np.float64)

        def landing(entry: Array, which: Whole) -> Array:
            return self.at_stop(np.broadcast_to(field, entry.shape), entry, wavelength_nm)

        aimed = aim_rays(landing, aim, guess, derivative, self.stop_radius)
        off, way = (np.hypot(*(aimed.start - of).T) for of in (guess, known.entry[0]))
        widest = np.hypot(*(known.entry - known.entry[0]).T).max()
        ok = aimed.arrived & (off <= CLOSE * np.maximum(way, CLOSE * widest))
        area = (
            known.derivative[:, 0, 0] * known.derivative[:, 1, 1]
            - known.derivative[:, 0, 1] * known.derivative[:, 1, 0]
        )
        if len(area) <= len(_rings()) or np.abs(area).min() < NEAR_CAUSTIC * np.abs(area).max():
            # Beyond a caustic the map is reversed; rays there belong to another branch.
            landed = np.flatnonzero(ok)
            ok[landed] = (
                self._senses(
                    np.broadcast_to(field, (len(landed), 2)), entry=aimed.start[landed], wavelength_nm=wavelength_nm
                )
                * area[0]
                > 0.0
            )
        entry[ok] = aimed.start[ok]
        return entry

    def _edges(self, field: Array, aim: Array, found: ContinuedRays, wavelength_nm: float) -> Ends:
        """Return the edges that end continued rays: borders of surfaces, or folds."""
        start, derivative = found.start[~found.arrived], found.derivative[~found.arrived]
        slope = np.broadcast_to(field, start.shape)
        edge, surface = np.full(len(start), int(Edge.UNKNOWN)), np.full(len(start), -1)
        hit = self.at_stop(slope, start, wavelength_nm)
        step = np.linalg.solve(_regular(derivative), (aim - hit)[:, :, None])[:, :, 0]
        unit = step / np.maximum(np.hypot(*step.T), 1e-300)[:, None]
        _, _, across = np.linalg.svd(derivative)
        numbers = np.append(self.world.lens_shape.numbers, -1)
        # The map is stretched without limit across a border, so the step there may run along the border.
        for way in (unit, across[:, 0], -across[:, 0]):
            for reach in np.geomspace(1e-9, NEAR_EDGE, 13) * self.front_radius:
                open_ = np.flatnonzero(edge == Edge.UNKNOWN)
                if not len(open_):
                    break
                trial = start[open_] + reach * way[open_]
                arrived = self._unbounded(slope[open_], trial, wavelength_nm, self._faces_to_stop)
                lost = ~(arrived.weight > 0.0)
                edge[open_[lost]], on_last = self._lost_at(arrived.ended[lost], arrived.met[lost])
                surface[open_[lost]] = numbers[arrived.met[lost] - on_last]
        before = self._senses(slope, start, wavelength_nm)
        for reach in np.geomspace(1e-2, 1.0, 3) * NEAR_FOLD * self.front_radius:
            for way in (across[:, 1], -across[:, 1]):
                open_ = np.flatnonzero(edge == Edge.UNKNOWN)
                if len(open_):
                    there = self._senses(slope[open_], start[open_] + reach * way[open_], wavelength_nm)
                    edge[open_[there * before[open_] < 0.0]] = Edge.CAUSTIC
        return Ends(edge, surface).with_diffraction(self.world.scene.camera.lens)

    def _no_ray(self, field: Array, count: int, wavelength_nm: float) -> Ends:
        """Return the ends of the rays of a field without any ray through the stop."""
        slope = field[None]
        arrived = self._unbounded(slope, np.zeros((1, 2)), wavelength_nm, self._faces_to_stop)
        edge, on_last = self._lost_at(arrived.ended, arrived.met)
        met = int(arrived.met[0] - on_last[0])
        number = self.world.lens_shape.numbers[max(0, min(met, self._faces_to_stop - 1))]
        ends = Ends(np.full(count, edge[0]), np.full(count, number))
        return ends.with_diffraction(self.world.scene.camera.lens)

    def _lost_at(self, ended: Array, met: Whole) -> tuple[Whole, Whole]:
        """Return the edges that end rays traced without apertures, (n,), and 1 if one belongs to the last face met.

        Parameters
        ----------
        ended, met : (n,)
            Of `Arrived`, for rays that do not pass.
        """
        reflected = ended == DROPPED
        turned = gradient_spaces(self.world.tables.lens)[met] & np.isin(ended, TURNED)
        edge = np.select([reflected, turned], [Edge.REFLECTED, Edge.TURNED], Edge.MISSED)
        return edge, (reflected | turned).astype(np.int64)

    def lost(self, arrived: Arrived) -> Ends:
        """Return the ends of rays that do not pass the whole lens though apertures are ignored.

        Parameters
        ----------
        arrived : Arrived
            See `unstopped`.
        """
        numbers = np.asarray(self.world.lens_shape.numbers)
        edge, on_last = self._lost_at(arrived.ended, arrived.met)
        ends = Ends(edge, numbers[np.minimum(arrived.met - on_last, len(numbers) - 1)])
        return ends.with_diffraction(self.world.scene.camera.lens)

    def stopped(self, slope: Array, entry: Array, arrived: Arrived, wavelength_nm: float) -> Ends:
        """Return the ends of rays traced through the whole lens with its apertures.

        Parameters
        ----------
        slope, entry : (n, 2) float64
            As for `starts`.
        arrived : Arrived
            Of these rays.
        wavelength_nm : float
        """
        numbers = np.asarray(self.world.lens_shape.numbers)
        faces = len(numbers)
        edge, met = np.zeros(len(entry), np.int64), arrived.met.copy()
        ended = np.flatnonzero(~(arrived.weight > 0.0))
        if len(ended):
            free, lens = self.unstopped(slope[ended], entry[ended], wavelength_nm), self.world.tables.lens
            code, missed = arrived.ended[ended], free.met <= met[ended]
            dropped = code == DROPPED
            reflected = dropped & (free.ended == DROPPED) & (free.met == met[ended])
            inside = gradient_spaces(lens)[met[ended]] & ~dropped
            at_edge = inside & (code == lens.ring_slot[met[ended]] + 1.0)
            turned = inside & np.isin(code, TURNED)
            edge[ended] = np.select(
                [code == STOP + 1.0, reflected, dropped, turned, at_edge, missed],
                [Edge.STOP, Edge.REFLECTED, Edge.OTHER_SIDE, Edge.TURNED, Edge.GLASS_EDGE, Edge.MISSED],
                Edge.APERTURE,
            )
            met[ended] -= reflected | np.isin(edge[ended], IN_GRADIENT)
        # A ray that meets the last surface again has met all of them.
        surface = np.where(edge == Edge.STOP, self.stop, numbers[np.minimum(met, faces - 1)])
        ends = Ends(edge, np.where(edge == Edge.NONE, -1, surface))
        return ends.with_diffraction(self.world.scene.camera.lens)


def gradient_spaces(lens: LensTables) -> NDArray[np.bool_]:
    """Tell which spaces of a lens are filled with gradient-index glass, (faces + 1,)."""
    if lens.gradients is None:
        return np.zeros(len(lens.medium), np.bool_)
    return np.asarray(lens.gradients.number >= 0)


def _rings() -> Array:
    turns = [(radius, 2.0 * math.pi * (np.arange(count) + 0.5 * (number % 2)) / count)
             for number, (radius, count) in enumerate(RINGS)]  # fmt: skip
    return np.vstack([radius * np.column_stack([np.sin(angle), np.cos(angle)]) for radius, angle in turns])


def _nothing() -> _Known:
    return _Known(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 2, 2)))


def _of(found: ContinuedRays, aim: Array) -> _Known:
    ok = found.arrived
    return _Known(aim[ok], found.start[ok], found.derivative[ok])


def _regular(matrices: Array) -> Array:
    """Return matrices (n, 2, 2) with singular ones replaced by the identity."""
    fine = np.abs(np.linalg.det(np.where(np.isfinite(matrices), matrices, 0.0))) > 0.0
    return np.where(fine[:, None, None], matrices, np.eye(2))


def _terms(degree: int) -> int:
    return (degree + 1) * (degree + 2) // 2


def _exponents(degree: int) -> list[tuple[int, int]]:
    return [(i, total - i) for total in range(degree + 1) for i in range(total + 1)]


def _powers(at: Array, degree: int) -> Array:
    """Return the monomials of points, (n, terms)."""
    x, y = (np.vander(at[:, k], degree + 1, increasing=True) for k in (0, 1))
    return np.stack([x[:, i] * y[:, j] for i, j in _exponents(degree)], axis=1)


def _powers_by(at: Array, degree: int, axis: int) -> Array:
    """Return the derivatives of the monomials by x or y, (n, terms)."""
    x, y = (np.vander(at[:, k], degree + 1, increasing=True) for k in (0, 1))
    if axis == 0:
        return np.stack([i * x[:, max(i - 1, 0)] * y[:, j] for i, j in _exponents(degree)], axis=1)
    return np.stack([j * x[:, i] * y[:, max(j - 1, 0)] for i, j in _exponents(degree)], axis=1)
