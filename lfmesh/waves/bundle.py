"""Bundles of real rays from an object plane through chosen points of the stop to the image plane.

Rays pass the surfaces in sequence, with all apertures and Fresnel transmittances. Positions are in the camera frame,
mm. Fields lie in the plane x = 0.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.errors import LfmeshError
from lfmesh.geometry import frame as frames
from lfmesh.geometry.lens.element_poses import pose_of
from lfmesh.geometry.lens.main_order import lens_phases, refuse_several_orders
from lfmesh.geometry.meshes.levels import EXACT
from lfmesh.optics.glass import refractive_index
from lfmesh.scene.literals import percent
from lfmesh.transport.sequences.follower import route_of
from lfmesh.transport.sequences.gradient_gaps import gap_paths
from lfmesh.transport.sequences.ray_tables import (
    Arrived,
    follow_sequence,
    follow_to,
    lens_of_faces,
    without_apertures,
)
from lfmesh.transport.sequences.sequences import LENS_LEG, Leg, image_path
from lfmesh.transport.trace import at_wavelength
from lfmesh.transport.world import World
from lfmesh.waves.phase_path import phase_path_mm
from lfmesh.waves.ray_ends import Edge, Ends
from lfmesh.waves.stop_aim import INSIDE, Sent, StopAim, gradient_spaces

Array = NDArray[np.float64]

PARALLEL = 1e-9
"""Range of slopes behind the lens below which rays count as parallel, with their image at infinity."""


class Bundle(NamedTuple):
    """Rays of one field at one wavelength.

    Attributes
    ----------
    pupil : (n, 2) float64
        Points in the stop, in units of its radius.
    place : (n, 2) float64, mm
        Points on the image plane; NaN for rays that the lens stops.
    entry : (n, 2) float64, mm
        Points of the incident rays on the plane of the first vertex; NaN if no ray reaches the point of the stop.
    direction : (n, 3) float64
        Unit, behind the lens.
    weight : (n,) float64
        Transmittance; 0 for rays that the lens stops.
    ends : Ends
        Edges that stop the rays.
    """

    pupil: Array
    place: Array
    entry: Array
    direction: Array
    weight: Array
    ends: Ends

    @property
    def passes(self) -> NDArray[np.bool_]:
        """(n,): True for rays that the lens transmits."""
        return np.asarray(self.weight > 0.0)

    def at(self, shift_mm: float) -> Array:
        """Return the points on a plane at a distance behind the image plane, (n, 2) mm."""
        return np.asarray(self.place + shift_mm * self.direction[:, :2] / self.direction[:, 2:])


class Chief(NamedTuple):
    """Chief ray of a field, apertures ignored.

    Attributes
    ----------
    entry : (2,) float64, mm
        Point on the plane of the first vertex.
    place : (2,) float64, mm
        Point on the image plane.
    blocked_by : str
        Edge that ends the ray, see `ray_ends.WORDS`; empty if it exists.
    """

    entry: Array
    place: Array
    blocked_by: str = ""

    @property
    def exists(self) -> bool:
        """False if an edge ends the ray, as the end of a surface or total reflection; its points are then NaN."""
        return bool(np.isfinite(self.place).all())


class Traced(NamedTuple):
    """Rays of one object point behind the lens, apertures ignored.

    Attributes
    ----------
    before, direction : (n, 3) float64
        Unit, before the first face and behind the last one.
    position : (n, 3) float64, mm
        On the last face.
    path_mm : (n,) float64
        Optical path from the object point to `position`, less that to the origin; for parallel bundles, from the
        perpendicular plane through the origin. Behind ideal lenses, with equal paths from point to image, less a common
        constant. At a diffractive face the path grows by m λ Φ / 2π. In gradient-index glass it is the integral of the
        index along the curved ray.
    heights : (n, faces) float64
        Distance from the axis at each refracting face, over its semi-diameter.
    index_behind : float
        Refractive index behind the lens.
    """

    before: Array
    direction: Array
    position: Array
    path_mm: Array
    heights: Array
    index_behind: float

    def onto_sphere(self, centre: Array, radius_mm: float) -> tuple[Array, Array]:
        """Return the rays' intersections with a sphere as directions from its centre, and optical paths.

        Parameters
        ----------
        centre : (3,) float64, mm
        radius_mm : float
            Negative if light meets the sphere behind its centre; inf for the rays' own directions.

        Returns
        -------
        (n, 2) float64
            Direction cosines.
        (n,) float64, mm
            Less a common constant. Both are NaN for rays that miss the sphere.
        """
        off = self.position - centre
        along = (off * self.direction).sum(axis=1)
        if math.isinf(radius_mm):
            return self.direction[:, :2], self.path_mm - self.index_behind * along
        aside2 = ((off - along[:, None] * self.direction) ** 2).sum(axis=1)
        root = np.sqrt(np.where(aside2 <= radius_mm**2, radius_mm**2 - aside2, np.nan))
        # If the centre lies in the exit pupil, the radius is 0 and all rays miss the sphere.
        with np.errstate(divide="ignore", invalid="ignore"):
            # √(R² − aside²) − R, without subtracting large numbers.
            less = -aside2 / (root + abs(radius_mm)) * math.copysign(1.0, radius_mm)
            further = -along - less
            at = off + (further - radius_mm)[:, None] * self.direction
            return -at[:, :2] / radius_mm, self.path_mm + self.index_behind * further


@dataclass(frozen=True)
class LensRays:
    """Ray tracer from an object plane through the lens of a camera.

    Attributes
    ----------
    world : World
        Exact surfaces only, diffractive faces with one order each.
    object_mm : float
        Object distance before the first vertex; inf for parallel bundles.
    image_z_mm : float
        Plane to which rays are traced.
    """

    world: World
    object_mm: float
    image_z_mm: float

    def __post_init__(self) -> None:
        shape = self.world.lens_shape
        if not (shape.analytic.all() and (shape.surfaces["level"] == EXACT).all()):
            raise LfmeshError('the lens has surfaces that are meshes: an analysis needs surface = "exact"')
        refuse_several_orders(lens_phases(self.world.scene))
        if not self.object_mm > 0.0:
            raise LfmeshError(f"object distance = {self.object_mm} mm: must be above 0, or inf")

    @cached_property
    def aim(self) -> StopAim:
        """Ray aiming at points of the stop."""
        return StopAim(self.world, 1.0 / self.object_mm)

    @property
    def stop_radius(self) -> float:
        """Radius of the stop, mm."""
        return self.aim.stop_radius

    @cached_property
    def _is_ideal(self) -> bool:
        """True for a lens that consists of ideal lenses."""
        lens = self.world.scene.camera.lens
        ideal = [each.paraxial for i, each in enumerate(lens.surfaces) if not lens.is_pure_stop(i)]
        if any(ideal) and not all(ideal):
            where = next(i for i, each in enumerate(lens.surfaces) if each.paraxial)
            raise LfmeshError(
                f"camera.lens.surfaces[{where}] is an ideal lens among real surfaces, and has no optical path"
            )
        return any(ideal)

    def starts(self, slope: Array, entry: Array) -> tuple[Array, Array]:
        """Return the start points of rays before the lens, and their unit directions; see `StopAim.starts`."""
        return self.aim.starts(slope, entry)

    def _followed(self, slope: Array, entry: Array, wavelength_nm: float) -> Arrived:
        tables = at_wavelength(self.world, wavelength_nm)
        return follow_sequence(tables, image_path(len(tables.lens.surfaces)), *self.starts(slope, entry))

    def bundle(self, slope: ArrayLike, pupil: ArrayLike, wavelength_nm: float) -> Bundle:
        """Return the rays of a field through points of the stop.

        Parameters
        ----------
        slope : float, or (2,) float64
            Height (or x and y) of the object point over its distance; for parallel bundles, tangent of the field angle.
        pupil : (n, 2) float
            Points of the stop, in units of its radius.
        wavelength_nm : float

        Raises
        ------
        LfmeshError
            Ray aiming found neither a ray nor an edge, or rays that pass cross before the stop.
        """
        pupil = np.asarray(pupil, dtype=np.float64).reshape(-1, 2)
        aim = pupil * (self.stop_radius * INSIDE)
        field = _field(slope)
        slope = np.broadcast_to(field, aim.shape)
        entry, ends = self._sent(field, aim, wavelength_nm)
        self._refuse_crossing(field, wavelength_nm)
        known = np.isfinite(entry).all(axis=1)
        place, direction, weight = np.full((len(aim), 2), np.nan), np.full((len(aim), 3), np.nan), np.zeros(len(aim))
        if known.any():
            arrived = self._followed(slope[known], entry[known], wavelength_nm)
            weight[known] = arrived.weight
            ends.edge[known], ends.surface[known] = self.aim.stopped(slope[known], entry[known], arrived, wavelength_nm)
            passes = arrived.weight > 0.0
            mine = np.flatnonzero(known)[passes]
            place[mine] = self._on_image_plane(arrived)[passes]
            direction[mine] = arrived.direction[passes]
        return Bundle(pupil, place, entry, direction, weight, ends)

    def chief(self, slope: ArrayLike, wavelength_nm: float) -> Chief:
        """Return the chief ray of a field, the reference for images even if apertures stop it.

        Parameters
        ----------
        slope : float, or (2,) float64
            As for `bundle`.
        wavelength_nm : float

        Raises
        ------
        LfmeshError
            Ray aiming found neither the ray nor an edge.
        """
        field = _field(slope)
        entry, ends = self._sent(field, np.zeros((1, 2)), wavelength_nm)
        if np.isfinite(entry).all():
            arrived = self.aim.unstopped(field[None], entry, wavelength_nm)
            if arrived.weight[0] > 0.0:
                return Chief(entry[0], self._on_image_plane(arrived)[0])
            ends = self.aim.lost(arrived)
        return Chief(np.full(2, np.nan), np.full(2, np.nan), ends.words_of(0))

    def _sent(self, field: Array, aim: Array, wavelength_nm: float) -> Sent:
        """Return the rays of a field through points of the stop (n, 2), mm; raise if the search did not converge."""
        sent = self.aim.through(field, aim, wavelength_nm)
        if (unknown := int((sent.ends.edge == Edge.UNKNOWN).sum())) > 0:
            raise LfmeshError(
                f"ray aiming did not converge for {unknown} of {len(aim)} rays of the field with a slope of "
                f"{float(field[1]):.4g} at {wavelength_nm:g} nm; give a smaller field or stop"
            )
        return sent

    def _on_image_plane(self, arrived: Arrived) -> Array:
        p, d = arrived.position, arrived.direction
        return np.asarray(p[:, :2] + ((self.image_z_mm - p[:, 2]) / d[:, 2])[:, None] * d[:, :2])

    def _refuse_crossing(self, field: Array, wavelength_nm: float) -> None:
        """Refuse a field (2,) if rays that pass cross before the stop: some of its points then have several rays.

        Trial rays that map to the stop with reversed orientation show it. On their grid, crossed rays in less than a
        hundredth of the pupil can be missed.
        """
        key = (float(field[0]), float(field[1]), wavelength_nm)
        if key in self._single_rays:
            return
        entry = self.aim.trials()
        passes = self._followed(np.broadcast_to(field, entry.shape), entry, wavelength_nm).weight > 0.0
        share = self.aim.turned_share(field, entry[passes], wavelength_nm)
        if share > 0.0:
            raise LfmeshError(
                f"rays of this field cross before the stop ({percent(share)} of the rays that pass the lens), so "
                "several share one point of the stop; move the stop, or make a clear aperture smaller"
            )
        self._single_rays.add(key)

    @cached_property
    def _single_rays(self) -> set[tuple[float, float, float]]:
        """Slopes and wavelengths of fields known to have one ray through each point of the stop."""
        return set()

    def traced(self, slope: ArrayLike, entry: Array, wavelength_nm: float) -> Traced:
        """Trace rays face by face with their optical paths, apertures ignored.

        Parameters
        ----------
        slope : (2,) float64
            Of the object point, as for `bundle`.
        entry : (n, 2) float64, mm
            Points on the plane of the first vertex; the rays pass the lens.
        wavelength_nm : float

        Raises
        ------
        LfmeshError
            The lens has ideal lenses beside real surfaces.
        """
        field = np.asarray(slope, dtype=np.float64)
        position, direction = self.aim.starts(np.broadcast_to(field, entry.shape), entry, self.aim.far_ahead)
        before = direction
        if math.isinf(self.object_mm):
            path = (position * direction).sum(axis=1)
        else:
            path = further_than(position, np.array([*(field * self.object_mm), -self.object_mm]))
        tables, shape = at_wavelength(self.world, wavelength_nm), self.world.lens_shape
        glass = self.world.scene.camera.lens
        lens, route = without_apertures(tables.lens), route_of([Leg(LENS_LEG, (0,), (False,), True)], checked=False)
        media = [refractive_index(medium, wavelength_nm) for medium in shape.media]
        path = media[0] * path
        heights, curved = np.empty((len(position), len(media) - 1)), gradient_spaces(lens)
        for face, index in enumerate(media[:-1]):
            alone = tables._replace(lens=lens_of_faces(lens, face, face + 1)).camera
            arrived = follow_to(alone, route, position, direction)
            if curved[face]:
                path = path + gap_paths(lens, face, 0, position, direction)
            else:
                path = path + index * np.linalg.norm(arrived.position - position, axis=1)
            position, direction = arrived.position, arrived.direction
            own = frames.points(frames.inverse(pose_of(glass, shape.numbers[face])), position)
            phase = glass.surfaces[shape.numbers[face]].phase
            if phase is not None:
                path = path + phase_path_mm(phase, own[:, :2], wavelength_nm)
            heights[:, face] = np.hypot(own[:, 0], own[:, 1]) / shape.surfaces["semi_diameter"][face]
        if self._is_ideal:
            path = media[-1] * ((position - nearest_to_all(position, direction)) * direction).sum(axis=1)
        return Traced(before, direction, position, path, heights, media[-1])


def _field(slope: ArrayLike) -> Array:
    """Return x and y of a slope, (2,); a single number lies in the meridional plane."""
    given = np.asarray(slope, dtype=np.float64)
    return given if given.ndim else np.array([0.0, float(given)])


def further_than(position: Array, point: Array) -> Array:
    """Return distances of places (n, 3) from a point less the origin's, without subtracting large numbers.

    Parameters
    ----------
    position : (n, 3) float64
    point : (3,) float64
    """
    both = np.linalg.norm(position - point, axis=1) + np.linalg.norm(point)
    return np.asarray(((position - 2.0 * point) * position).sum(axis=1) / both)


def nearest_to_all(position: Array, direction: Array) -> Array:
    """Return the point of closest approach of rays, on their mean line, (3,) mm; for parallel rays, their middle."""
    steep = direction[:, :2] / direction[:, 2:]
    place = position[:, :2] - position[:, 2:] * steep
    off, turn = place - place.mean(axis=0), steep - steep.mean(axis=0)
    if not np.abs(turn).max() > PARALLEL:
        return np.asarray(position.mean(axis=0))
    z = -float((off * turn).sum() / (turn * turn).sum())
    return np.array([*(place.mean(axis=0) + z * steep.mean(axis=0)), z])


def pupil_grid(across: int, *, rim: bool = False) -> Array:
    """Return the points of a square grid within the unit circle, (n, 2), symmetric about the axes.

    Parameters
    ----------
    across : int
        Points on a diameter.
    rim : bool
        Add points on the circle itself.
    """
    steps = (np.arange(across) - 0.5 * (across - 1)) / (0.5 * across)
    x, y = np.meshgrid(steps, steps, indexing="xy")
    inside = x * x + y * y <= 1.0
    points = np.column_stack([x[inside], y[inside]])
    if rim:
        angle = 2.0 * np.pi * np.arange(4 * across) / (4 * across)
        points = np.vstack([points, np.column_stack([np.cos(angle), np.sin(angle)])])
    return points
