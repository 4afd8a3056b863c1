"""The plane waves that a lens makes of a point's light: amplitude and phase by direction, from traced rays.

Behind the lens every ray stands for a plane wave. Its direction is the one in which the focus sees the ray cross the
sphere about it through the exit pupil, and its phase is the optical path up to there: the pupil function. Where the
pupil lies at infinity, these are the ray's own direction and the angle characteristic (M. Born, E. Wolf, Principles of
Optics, 4.1). Its power is that of the point's solid angle that the lens sends there. Both are smooth, as is the place
in each aperture, and are fitted by polynomials of the direction cosines; so they are known on any grid. From a pupil at
a finite distance come spherical waves in place of plane ones, see `rim_phase`.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.geometry.lens.solved_camera import SolvedCamera
from lfmesh.scene.literals import plain
from lfmesh.transport.world import World
from lfmesh.waves.bundle import PARALLEL, Bundle, LensRays, nearest_to_all, pupil_grid
from lfmesh.waves.refused import NoLightError
from lfmesh.waves.wavefront import NM_PER_MM

Array = NDArray[np.float64]

ACROSS = 40
"""Rays on a diameter of the stop."""

DEGREES = (6, 8, 10, 12, 14, 16, 18)
"""Of the polynomials, in turn until the phase is followed."""

FOLLOWED, REFUSED = 1e-4, 0.02
"""Largest difference of the phase from its polynomial, waves: that is sought; that is refused."""

CLOSE_TO_RIM = 0.8
"""Of its semi-diameter: rays that come no farther from the axis than this say that a face does not clip them."""

LEAST_RAYS, LEAST_TRIALS = 16, 3
"""That pass, so that a wavefront is known; so that a focus is."""

FINE = 401
"""Directions on a side of the grid by which the power is summed."""


@dataclass(frozen=True, eq=False)
class PupilRays:
    """Rays of one point behind the lens, at one wavelength.

    Attributes
    ----------
    wavelength_mm : float
    middle, half : (2,) float64
        Middle and half width of the range of direction cosines along x and y.
    focus_mm : (3,) float64
        Where rays come closest together, camera frame: the phases are those of this point.
    radius_mm : float
        From the exit pupil to the focus along the middle direction; inf, or below 0 where the pupil lies behind it.
    rays : (n, 3) float64, (n, 3) float64
        Places in the air behind the lens, mm, and directions.
    """

    wavelength_mm: float
    middle: Array
    half: Array
    focus_mm: Array
    radius_mm: float
    rays: tuple[Array, Array]

    def places_at(self, z_mm: float) -> Array:
        """Return where the rays cross a plane in the air behind the lens, (n, 2) mm."""
        position, direction = self.rays
        return position[:, :2] + ((z_mm - position[:, 2]) / direction[:, 2])[:, None] * direction[:, :2]


@dataclass(frozen=True, eq=False)
class PupilWaves(PupilRays):
    """Plane waves behind the lens, from one point of 1 W/sr at one wavelength.

    Attributes
    ----------
    coefficients : (degree + 1, degree + 1, columns) float64
        Of Chebyshev's polynomials in both direction cosines, of: phase in waves, amplitude, two coordinates whose areas
        are the power that enters, the place in the stop and the squared height at the faces that clip, both over the
        rim's.
    misfit_waves : float
        Largest difference of the phase of a ray from its polynomial.
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
        """Return amplitudes on a grid of directions, and the share of each that its average over a cell keeps.

        Parameters
        ----------
        px : (columns,) float64
            Direction cosines along x, evenly spaced, ascending.
        py : (rows,) float64

        Returns
        -------
        amplitudes : (rows, columns) complex128, √W
            At the centers of the cells. Their squares are the power in each cell; where a rim cuts a cell, means.
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
        """Return share within the rims, amplitude and phase (waves) in the cells of a grid close to the pupil."""
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
        """Return the phase (rows, columns) in waves by which the plane of the focus sees the pupil at its distance.

        Seen from a point beside the focus, the pupil's points are |x − P| away, not by plane waves; of all of them the
        middle one's difference counts (that of the others is the same to the order of NA² x² / 2R).

        Parameters
        ----------
        x, y : (columns,), (rows,) float64, mm
            From the focus.
        """
        if math.isinf(self.radius_mm):
            return np.zeros((len(y), len(x)))
        x, y = x[None, :], y[:, None]
        linear = self.middle[0] * x + self.middle[1] * y
        off = 2.0 * self.radius_mm * linear + x * x + y * y
        # |x − P| − R − linear, without the difference of large numbers.
        beyond = off / (np.sqrt(np.maximum(self.radius_mm**2 + off, 0.0)) + abs(self.radius_mm))
        return np.asarray((math.copysign(1.0, self.radius_mm) * beyond - linear) / self.wavelength_mm)


def pupil_waves(world: World, camera: SolvedCamera, point_mm: Array, wavelength_nm: float) -> PupilWaves:
    """Trace a point's light through the lens, and return the plane waves behind it.

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
        As `waves_of_field`.
    """
    rays = LensRays(world, -float(point_mm[2]), 0.0)
    try:
        return waves_of_field(rays, camera, point_mm[:2] / rays.object_mm, wavelength_nm)
    except LfmeshError as error:
        raise type(error)(f"point_mm = {[float(x) for x in point_mm]}: {error}") from None


def waves_of_field(
    rays: LensRays, camera: SolvedCamera, slope: Array, wavelength_nm: float, about_mm: Array | None = None
) -> PupilWaves:
    """Trace a field's light through the lens, and return the plane waves behind it.

    Parameters
    ----------
    rays : LensRays
    camera : SolvedCamera
    slope : (2,) float64
        Of the object point, see `LensRays.bundle`.
    wavelength_nm : float
    about_mm : (3,) float64, optional
        Centre of the sphere on which phases are taken. Power is then that of equal areas of the stop, 1 in all, as
        `lf.wavefront` has it. Where rays come closest together, and W per W/sr, if left out.

    Raises
    ------
    NoLightError
        None of its light passes.
    LfmeshError
        Surfaces that are meshes, ideal lenses beside real ones, a point whose light does not pass or crosses before the
        stop, or light that is collimated or too aberrated behind the lens.
    """
    rays.refuse_crossing(slope, wavelength_nm)
    bundle = rays.bundle(slope, pupil_grid(ACROSS, rim=True), wavelength_nm)
    passes = bundle.passes
    if not passes.any():
        raise NoLightError("the lens lets none of its light pass; move it into the field of view")
    _refuse_few(bundle, LEAST_RAYS)
    traced = rays.traced(slope, bundle.entry[passes], wavelength_nm)
    direction, wavelength = traced.direction, wavelength_nm / NM_PER_MM
    found = _focus(traced.position, direction)
    focus = found if about_mm is None else about_mm
    radius = _radius(camera, focus, direction)
    seen, path = traced.onto_sphere(focus, radius)
    if not np.isfinite(path).all():
        raise LfmeshError(f"rays miss the sphere of the exit pupil, whose radius is {abs(radius):.4g} mm")
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
        raise LfmeshError(
            f"the wavefront behind the lens is too aberrated: polynomials of degree {DEGREES[-1]} leave "
            f"{plain(misfit, 2)} waves of it, {REFUSED:g} are allowed; give a smaller stop"
        )
    return PupilWaves(wavelength, middle, half, focus, radius, (traced.position, direction), coefficients, misfit)


def pupil_rays(bundle: Bundle, camera: SolvedCamera, image_z_mm: float, wavelength_nm: float) -> PupilRays:
    """Return what rays alone say of a point's waves: their range of directions, and their focus.

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
    low, high = direction[:, :2].min(axis=0), direction[:, :2].max(axis=0)
    radius = _radius(camera, focus, direction)
    return PupilRays(
        wavelength_nm / NM_PER_MM, 0.5 * (low + high), 0.5 * (high - low), focus, radius, (position, direction)
    )


def _refuse_few(bundle: Bundle, least: int) -> None:
    """Refuse a point of whose rays the lens lets fewer pass than are needed."""
    if bundle.passes.sum() < least:
        raise LfmeshError(
            f"the lens lets {bundle.passes.sum()} of {len(bundle.passes)} rays of this point pass; move it"
        )


def _focus(position: Array, direction: Array) -> Array:
    """Return where rays behind the lens come closest together, (3,) mm; refuse those that are parallel."""
    if np.ptp(direction[:, :2] / direction[:, 2:], axis=0).min() < PARALLEL:
        raise LfmeshError("its light is collimated behind the lens; a point spread needs light that converges")
    return nearest_to_all(position, direction)


def _radius(camera: SolvedCamera, focus: Array, direction: Array) -> float:
    """Return the way from the exit pupil to the focus along the middle direction, mm."""
    return (float(focus[2]) - camera.report.exit_pupil_z_mm) / float(direction[:, 2].mean())


def _equal_areas(direction: Array) -> Array:
    """Return coordinates (n, 2) of unit directions (n, 3) whose areas are solid angles (J. H. Lambert, 1772)."""
    return direction[:, :2] * np.sqrt(2.0 / (1.0 + direction[:, 2:]))


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
