"""Plane waves behind a lens for a point's light: amplitude and phase by direction, from traced rays.

Behind the lens every ray represents a plane wave. Its direction is that of the ray's intersection with the sphere
through the exit pupil, seen from the focus at the centre. Its phase is the optical path to this intersection: the pupil
function. With the pupil at infinity, these are the ray's direction and the angle characteristic (M. Born, E. Wolf,
Principles of Optics, 4.1). Its power is that of the corresponding solid angle at the point. Polynomials of the
direction cosines are fitted to phase, amplitude and position in each aperture. A pupil at a finite distance sends
spherical waves, see `rim_phase`. Direction cosines are optical: times the index behind the lens.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.geometry.lens.solved_camera import SolvedCamera
from lfmesh.scene import Scene
from lfmesh.scene.camera.phase import ZonedPhase
from lfmesh.scene.literals import plain
from lfmesh.transport.world import World
from lfmesh.waves.bundle import PARALLEL, Bundle, LensRays, nearest_to_all, pupil_grid
from lfmesh.waves.ray_ends import IN_GRADIENT
from lfmesh.waves.refused import NoLightError
from lfmesh.waves.wavefront import NM_PER_MM

Array = NDArray[np.float64]

ACROSS = 40
"""Rays on a diameter of the stop."""

DEGREES = (6, 8, 10, 12, 14, 16, 18)
"""Degrees of the polynomials, tried in turn until the phase fits."""

FOLLOWED, REFUSED = 1e-4, 0.02
"""Phase errors of the polynomial fit, waves: the goal, and the largest accepted."""

CLOSE_TO_RIM = 0.8
"""A face does not clip if its rays stay within this fraction of its semi-diameter."""

LEAST_RAYS, LEAST_TRIALS = 16, 3
"""Fewest passing rays for a wavefront, and for a focus."""

FINE = 401
"""Directions per side of the grid used to sum the power."""


@dataclass(frozen=True, eq=False)
class PupilRays:
    """Rays of one point behind the lens, at one wavelength.

    Attributes
    ----------
    wavelength_mm : float
    middle, half : (2,) float64
        Middle and half width of the range of optical direction cosines along x and y.
    focus_mm : (3,) float64
        Point of closest approach of the rays and reference of phases, camera frame.
    radius_mm : float
        From the exit pupil to the focus along the middle direction; inf, or negative if the pupil lies behind it.
    rays : (n, 3) float64, (n, 3) float64
        Positions behind the lens, mm, and directions.
    index : float
        Of the medium behind the lens.
    """

    wavelength_mm: float
    middle: Array
    half: Array
    focus_mm: Array
    radius_mm: float
    rays: tuple[Array, Array]
    index: float

    def places_at(self, z_mm: float) -> Array:
        """Return the intersections of the rays with a plane behind the lens, (n, 2) mm."""
        position, direction = self.rays
        return position[:, :2] + ((z_mm - position[:, 2]) / direction[:, 2])[:, None] * direction[:, :2]


@dataclass(frozen=True, eq=False)
class PupilWaves(PupilRays):
    """Plane waves behind the lens, from one point of 1 W/sr at one wavelength.

    Attributes
    ----------
    coefficients : (degree + 1, degree + 1, columns) float64
        Of Chebyshev polynomials in both direction cosines, for: phase in waves, amplitude, two coordinates with areas
        equal to the entering power, position in the stop, and squared height at each clipping face, both relative to
        the rim.
    misfit_waves : float
        Largest error of the phase polynomial at a ray.
    """

    coefficients: Array
    misfit_waves: float

    @cached_property
    def power_w(self) -> float:
        """Power of all waves."""
        px, py = (np.linspace(m - w, m + w, FINE) for m, w in zip(self.middle, self.half, strict=True))
        cover, amplitude, _ = self._in_cells(px, py)
        return float((cover * amplitude**2).sum())

    def at(self, px: Array, py: Array) -> tuple[NDArray[np.complex128], Array]:
        """Return amplitudes on a grid of directions, and their reduction by averaging over cells.

        Parameters
        ----------
        px : (columns,) float64
            Optical direction cosines along x, evenly spaced, ascending.
        py : (rows,) float64

        Returns
        -------
        amplitudes : (rows, columns) complex128, √W
            At the centres of cells, means in cells cut by a rim; squares are power.
        shares : (rows, columns) float64
            sinc g for a phase that changes by g waves across a cell.
        """
        inside_x = np.flatnonzero(np.abs(px - self.middle[0]) <= self.half[0] + abs(px[1] - px[0]))
        inside_y = np.flatnonzero(np.abs(py - self.middle[1]) <= self.half[1] + abs(py[1] - py[0]))
        cover, amplitude, phase = self._in_cells(px[inside_x], py[inside_y])
        waves, shares = np.zeros((len(py), len(px)), np.complex128), np.zeros((len(py), len(px)))
        turn_y, turn_x = np.gradient(phase)
        inside = np.ix_(inside_y, inside_x)
        waves[inside] = cover * amplitude * np.exp(2j * np.pi * phase)
        shares[inside] = np.sinc(turn_x) * np.sinc(turn_y)
        return waves, shares

    def _in_cells(self, px: Array, py: Array) -> tuple[Array, Array, Array]:
        """Return unclipped fraction, amplitude and phase (waves) in the cells of a grid around the pupil."""
        u = (px - self.middle[0]) / self.half[0]
        v = (py - self.middle[1]) / self.half[1]
        phase, root, _, _, sx, sy, *heights2 = self._on_grid(self.coefficients, u, v)
        slopes = [np.asarray(chebyshev.chebder(self.coefficients[:, :, 2:4], axis=axis), np.float64) for axis in (0, 1)]
        (xu, yu), (xv, yv) = (self._on_grid(each, u, v) for each in slopes)
        entering = np.abs(xu * yv - xv * yu)
        cover = np.ones_like(phase)
        for height2 in (sx * sx + sy * sy, *heights2):
            across, along = np.gradient(height2)
            cover *= np.clip(0.5 + (1.0 - height2) / (np.abs(across) + np.abs(along)), 0.0, 1.0)
        cell = (px[1] - px[0]) * (py[1] - py[0]) / (self.half[0] * self.half[1])
        return cover, root * np.sqrt(entering * cell), phase

    @staticmethod
    def _on_grid(coefficients: Array, u: Array, v: Array) -> Array:
        """Return the values of polynomials on a grid, (columns, rows of v, columns of u)."""
        along_u = chebyshev.chebvander(u, coefficients.shape[0] - 1)
        along_v = chebyshev.chebvander(v, coefficients.shape[1] - 1)
        return np.asarray(np.einsum("vj,ijc,ui->cvu", along_v, coefficients, along_u, optimize=True))

    def rim_phase(self, x: Array, y: Array) -> Array:
        """Return the phase, waves, in the plane of the focus due to a pupil at finite distance, (rows, columns).

        Beside the focus, light from a pupil point P travels |x − P|, unlike a plane wave. The middle point's difference
        is used for the whole pupil, correct to the order of NA² x² / 2R.

        Parameters
        ----------
        x, y : (columns,), (rows,) float64, mm
            From the focus.
        """
        if math.isinf(self.radius_mm):
            return np.zeros((len(y), len(x)))
        x, y, ahead = x[None, :], y[:, None], self.middle / self.index
        linear = ahead[0] * x + ahead[1] * y
        off = 2.0 * self.radius_mm * linear + x * x + y * y
        # |x − P| − R − linear, without subtracting large numbers.
        beyond = off / (np.sqrt(np.maximum(self.radius_mm**2 + off, 0.0)) + abs(self.radius_mm))
        path = self.index * (math.copysign(1.0, self.radius_mm) * beyond - linear)
        return np.asarray(path / self.wavelength_mm)


def pupil_waves(world: World, camera: SolvedCamera, point_mm: Array, wavelength_nm: float) -> PupilWaves:
    """Return the plane waves behind the lens for a point.

    Parameters
    ----------
    world : World
        Of the camera alone.
    camera : SolvedCamera
    point_mm : (3,) float64
        Camera frame.
    wavelength_nm : float

    Raises
    ------
    LfmeshError
        As from `waves_of_field`.
    """
    rays = LensRays(world, -float(point_mm[2]), 0.0)
    try:
        return waves_of_field(rays, camera, point_mm[:2] / rays.object_mm, wavelength_nm)
    except LfmeshError as error:
        raise type(error)(f"point_mm = {[float(x) for x in point_mm]}: {error}") from None


def waves_of_field(
    rays: LensRays, camera: SolvedCamera, slope: Array, wavelength_nm: float, about_mm: Array | None = None
) -> PupilWaves:
    """Return the plane waves behind the lens for a field.

    Parameters
    ----------
    rays : LensRays
    camera : SolvedCamera
    slope : (2,) float64
        Of the object point, see `LensRays.bundle`.
    wavelength_nm : float
    about_mm : (3,) float64, optional
        Centre of the reference sphere; power is then per area of the stop, 1 in all, as in `lf.wavefront`. Default: the
        point of closest approach of the rays, with power in W per W/sr.

    Raises
    ------
    NoLightError
        None of its light passes.
    LfmeshError
        Meshes, ideal lenses beside real ones, too few rays, rays that cross before the stop, rays that end inside
        gradient-index glass, or light that is collimated or too aberrated behind the lens.
    """
    bundle = rays.bundle(slope, pupil_grid(ACROSS, rim=True), wavelength_nm)
    passes = bundle.passes
    if not passes.any():
        raise NoLightError("the lens transmits none of its light; move it into the field of view")
    _refuse_few(bundle, LEAST_RAYS)
    _refuse_ends_in_gradients(bundle)
    traced = rays.traced(slope, bundle.entry[passes], wavelength_nm)
    direction, wavelength = traced.direction, wavelength_nm / NM_PER_MM
    found = _focus(traced.position, direction)
    focus = found if about_mm is None else about_mm
    radius = _radius(camera, focus, direction)
    seen, path = traced.onto_sphere(focus, radius)
    if not np.isfinite(path).all():
        raise LfmeshError(f"rays miss the sphere of the exit pupil, whose radius is {abs(radius):.4g} mm")
    seen = traced.index_behind * seen
    stop = camera.paraxial.stop
    clips = [number != stop for number in rays.world.lens_shape.numbers] & (traced.heights.max(axis=0) > CLOSE_TO_RIM)
    columns = np.column_stack(
        [
            (path - path.mean()) / wavelength,
            np.sqrt(bundle.weight[passes]),
            _equal_areas(traced.before) if about_mm is None else bundle.pupil[passes] / math.sqrt(math.pi),
            bundle.pupil[passes],
            traced.heights[:, clips] ** 2,
        ]
    )
    low, high = seen.min(axis=0), seen.max(axis=0)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    coefficients, misfit = _fitted((seen - middle) / half, columns)
    if misfit > REFUSED:
        zone = _first_zone(camera.scene)
        cause = "is too aberrated" if zone is None else f"has the kink or step of {zone[0]} at {zone[1]:g} mm"
        remedy = "a smaller stop" if zone is None else "a stop that keeps light inside, or use lf.wavefront or rays"
        raise LfmeshError(
            f"the wavefront behind the lens {cause}: polynomials of degree {DEGREES[-1]} leave a residual "
            f"of {plain(misfit, 2)} waves, above the limit of {REFUSED:g}; give {remedy}"
        )
    return PupilWaves(
        wavelength, middle, half, focus, radius, (traced.position, direction), traced.index_behind, coefficients, misfit
    )


def pupil_rays(bundle: Bundle, camera: SolvedCamera, image_z_mm: float, wavelength_nm: float) -> PupilRays:
    """Return the directions and the focus of a point's light, from rays alone.

    Parameters
    ----------
    bundle : Bundle
        Some rays pass.
    camera : SolvedCamera
    image_z_mm : float
        Of the bundle's image plane.
    wavelength_nm : float

    Raises
    ------
    LfmeshError
        Too few rays pass, or light is collimated behind the lens.
    """
    _refuse_few(bundle, LEAST_TRIALS)
    place, direction = bundle.place[bundle.passes], bundle.direction[bundle.passes]
    position = np.column_stack([place, np.full(len(place), image_z_mm)])
    focus = _focus(position, direction)
    index = camera.scene.camera.image_index(wavelength_nm)
    low, high = index * direction[:, :2].min(axis=0), index * direction[:, :2].max(axis=0)
    radius = _radius(camera, focus, direction)
    return PupilRays(
        wavelength_nm / NM_PER_MM, 0.5 * (low + high), 0.5 * (high - low), focus, radius, (position, direction), index
    )


def _refuse_few(bundle: Bundle, least: int) -> None:
    """Refuse a point if the lens passes too few of its rays."""
    if bundle.passes.sum() < least:
        raise LfmeshError(
            f"only {bundle.passes.sum()} of {len(bundle.passes)} rays of this point pass the lens; move it"
        )


def _refuse_ends_in_gradients(bundle: Bundle) -> None:
    """Refuse a point with rays that end between the faces of gradient-index glass; rims are known on faces alone."""
    inside = np.flatnonzero(np.isin(bundle.ends.edge, IN_GRADIENT))
    if len(inside):
        number = int(bundle.ends.surface[inside[0]])
        raise LfmeshError(
            f"camera.lens.surfaces[{number}].gradient: {len(inside)} of {len(bundle.passes)} rays of this point end "
            "inside the glass, between its faces; waves are cut off at faces alone: give a smaller stop or wider glass"
        )


def _focus(position: Array, direction: Array) -> Array:
    """Return the point of closest approach of rays behind the lens, (3,) mm; refuse parallel rays."""
    if np.ptp(direction[:, :2] / direction[:, 2:], axis=0).min() < PARALLEL:
        raise LfmeshError("its light is collimated behind the lens; a point spread needs light that converges")
    return nearest_to_all(position, direction)


def _radius(camera: SolvedCamera, focus: Array, direction: Array) -> float:
    """Return the distance from the exit pupil to the focus along the middle direction, mm."""
    return (float(focus[2]) - camera.report.exit_pupil_z_mm) / float(direction[:, 2].mean())


def _equal_areas(direction: Array) -> Array:
    """Return coordinates (n, 2) of unit directions (n, 3) with areas equal to solid angles (J. H. Lambert, 1772)."""
    return direction[:, :2] * np.sqrt(2.0 / (1.0 + direction[:, 2:]))


def _first_zone(scene: Scene) -> tuple[str, float] | None:
    """Return the path and the border, mm, of the first zone of a lens, or None without zones."""
    for number, surface in enumerate(scene.camera.lens.surfaces):
        where = f"camera.lens.surfaces[{number}]"
        if surface.outer_zone is not None:
            return f"{where}.outer_zone", surface.outer_zone.border_mm
        borders = [each.border_mm for each in surface.phase.zones] if isinstance(surface.phase, ZonedPhase) else []
        if borders and borders[0] is not None:
            return f"{where}.phase.zones", borders[0]
    return None


def _fitted(points: Array, columns: Array) -> tuple[Array, float]:
    """Return coefficients (degree + 1, degree + 1, columns), and the largest misfit of the first column."""
    best, least = np.zeros((1, 1, columns.shape[1])), math.inf
    for degree in DEGREES:
        chosen = np.add.outer(np.arange(degree + 1), np.arange(degree + 1)) <= degree
        if chosen.sum() > len(points) // 3 and degree > DEGREES[0]:
            break
        terms = chebyshev.chebvander2d(points[:, 0], points[:, 1], [degree, degree])[:, chosen.ravel()]
        found = np.linalg.lstsq(terms, columns, rcond=None)[0]
        misfit = float(np.abs(terms @ found[:, 0] - columns[:, 0]).max())
        if misfit < least:
            best, least = np.zeros((degree + 1, degree + 1, columns.shape[1])), misfit
            best[chosen] = found
        if least < FOLLOWED:
            break
    return best, least
