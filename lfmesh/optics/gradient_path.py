"""Rays through gradient-index glass, in equal steps that end on a given face.

With dσ = ds/n, the ray equation d/ds (n dr/ds) = ∇n becomes

    dr/dσ = T,  dT/dσ = ½ ∇n²,

where the optical ray vector T is n times the unit direction (A. Sharma, D. V. Kumar and A. K. Ghatak, Appl. Opt. 21,
984, 1982). These are Hamilton's equations of H = (|T|² − n²)/2, which is 0 along a ray. A drift changes r at constant
T, and a kick changes T at constant r. A leapfrog step is half a drift, a kick and half a drift; W. Kahan and R.-C. Li
(Math. Comp. 66, 1089, 1997) compose 17 of them to order 8. The optical path ∫ n² dσ = ∫ (|T|² + n²)/2 dσ grows by
|T|² τ/2 in a drift of length τ and by n² τ/2 in a kick, the geometric length ∫ n dσ by |T| τ in a drift. Both are exact
for each drift and kick, and so have order 8 as well.

All steps of a ray have one length, found by Newton's method so that the last step ends on the face. The composition is
symmetric, so a ray sent back from its end takes the same steps in reverse and returns to its start, to rounding. After
a step, |T| differs from n by the error of the integration; the direction of a ray is T/|T|.

The kicks of a step lie between its ends. Only the trials of Newton's method evaluate the index beyond the faces.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.errors import GlassError
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.kernels.vector import fused
from lfmesh.optics.gradients import Gradients, field_at, fields_at

Array = NDArray[np.float64]

_HALF = [
    *[0.13020248308889008087881763, 0.56116298177510838456196441, -0.38947496264484728640807860],
    *[0.15884190655515560089621075, -0.39590389413323757733623154, 0.18453964097831570709183254],
    *[0.25837438768632204729397911, 0.29501172360931029887096624],
]
KICKS = np.array([*_HALF, -0.60550853383003451169892108, *reversed(_HALF)])
"""Lengths of the leapfrog steps of the composition, over the length of the whole step. Their sum is 1."""

STAGES = len(KICKS)

DRIFTS = np.convolve(KICKS, [0.5, 0.5])
"""Lengths of the drifts before, between and behind the kicks: halves of neighbouring leapfrog steps, joined."""

COARSENESS = 4
"""Steps over steps of the first trials. The error of a coarse trial is at most 4⁸ times the final one."""

ROUGH = 0.01
"""Correction over length at which trials take all steps: its third power is left, see `tracer`."""

NEAR = 1e-6
"""Correction over length below which one leapfrog step makes it. The result differs from that of equal steps by the
third power of the correction, and by nine times its product with the integration error: both are rounding."""

MOST_TRIALS = 30
NEWTON_STEPS = 3
"""Steps to the crossing of a parabola and a face: exact for a small correction, and sufficient for another trial."""

FEWEST_STEPS, MOST_STEPS = 4, 4096

FEWEST_TRIAL_STEPS = 64
"""Steps with which a search for probe rays that arrive begins, at least."""

PHASE = 0.5
"""Largest advance in one step, in rad, of the fastest oscillation of a ray about a maximum of the index. Longer steps
are unstable, and the closest approach to a wall within one is not that of a parabola."""

ASIDE = 1e-3
"""Distance of points for a difference of the gradient, over the width of the glass."""

PROBE_PRECISION = 2e-11
"""Largest error of a probe ray's place on the next face, over the distance between the vertices: 1e-9 mm at 50 mm."""

PATH_PRECISION = 0.1
"""Tolerance of the optical path over that of the position."""


class GradientRay(NamedTuple):
    """A point of a ray in a gradient-index medium, in the medium's own frame.

    Attributes
    ----------
    x, y, z : float, mm
    tx, ty, tz : float
        Optical ray vector: the index times the unit direction.
    path, length : float, mm
        Optical path and geometric length so far.
    """

    x: float
    y: float
    z: float
    tx: float
    ty: float
    tz: float
    path: float
    length: float


class ConicFace(NamedTuple):
    """A plane or conic, z(r) − vertex_z = c r² / (1 + √(1 − (1 + k) c² r²)), in the medium's own frame.

    Attributes
    ----------
    curvature : float, mm⁻¹
        c; 0 for a plane.
    conic : float
        k.
    vertex_z : float, mm
    """

    curvature: float
    conic: float
    vertex_z: float


@inlined
def conic_height_at(face: Any, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Return w − ½ c (r² + (1 + k) w²) with w = z − vertex_z, which is 0 on a conic, and its gradient.

    Parameters
    ----------
    face : ConicFace
    x, y, z : float, mm
    """
    c, q = face.curvature, 1.0 + face.conic
    w = z - face.vertex_z
    return w - 0.5 * c * (x * x + y * y + q * w * w), -c * x, -c * y, 1.0 - c * q * w


@inlined
def square(ray: GradientRay) -> float:
    """Return |T|²."""
    return ray.tx * ray.tx + ray.ty * ray.ty + ray.tz * ray.tz


@inlined
def drift(ray: GradientRay, step: float) -> GradientRay:
    """Return a ray after a step in σ, mm, at constant T."""
    squared = square(ray)
    return GradientRay(
        fused(step, ray.tx, ray.x),
        fused(step, ray.ty, ray.y),
        fused(step, ray.tz, ray.z),
        ray.tx,
        ray.ty,
        ray.tz,
        fused(0.5 * step, squared, ray.path),
        fused(step, np.sqrt(squared), ray.length),
    )


def kicker(value_at: Any) -> Any:
    """Make the kernel that changes T at constant r, with `value_at` as in `stepper`."""

    @inlined
    def kick(field: Any, number: int, ray: GradientRay, step: float) -> GradientRay:
        """Return a ray after a step in σ, mm, at constant r."""
        n2, kick_x, kick_y, kick_z = value_at(field, number, ray.x, ray.y, ray.z)
        return GradientRay(
            ray.x,
            ray.y,
            ray.z,
            fused(step, kick_x, ray.tx),
            fused(step, kick_y, ray.ty),
            fused(step, kick_z, ray.tz),
            fused(0.5 * step, n2, ray.path),
            ray.length,
        )

    return kick


def stepper(value_at: Any) -> Any:
    """Make the kernel that takes equal steps in an index field.

    Parameters
    ----------
    value_at : kernel
        Called as ``value_at(field, number, x, y, z)``; returns n² and the three components of ½ ∇n², mm⁻¹.

    Returns
    -------
    advance : kernel
    """
    kick = kicker(value_at)

    @kernel
    def advance(field: Any, number: int, ray: GradientRay, step: float, steps: int) -> GradientRay:
        """Return a ray after equal steps.

        Parameters
        ----------
        field, number : Any
            Passed to `value_at`.
        ray : GradientRay
        step : float, mm
            Length of a step in σ; negative to go back.
        steps : int
        """
        for _ in range(steps):
            for i in range(STAGES):
                ray = drift(ray, DRIFTS[i] * step)
                ray = kick(field, number, ray, KICKS[i] * step)
            ray = drift(ray, DRIFTS[STAGES] * step)
        return ray

    return advance


def corrector(height_at: Any) -> Any:
    """Make the kernel that finds where a ray near a face crosses it, with `height_at` as in `tracer`."""

    @inlined
    def correction(face: Any, end: GradientRay, kick_x: float, kick_y: float, kick_z: float) -> float:
        """Return the change of σ at which the parabola with a ray's position, T and dT/dσ crosses the face.

        Parameters
        ----------
        face : Any
            Passed to `height_at`.
        end : GradientRay
        kick_x, kick_y, kick_z : float, mm⁻¹
            dT/dσ.
        """
        change = 0.0
        for _ in range(NEWTON_STEPS):
            tx, ty, tz = end.tx + change * kick_x, end.ty + change * kick_y, end.tz + change * kick_z
            x = end.x + 0.5 * change * (end.tx + tx)
            y = end.y + 0.5 * change * (end.ty + ty)
            z = end.z + 0.5 * change * (end.tz + tz)
            height, by_x, by_y, by_z = height_at(face, x, y, z)
            change -= height / (by_x * tx + by_y * ty + by_z * tz)
        return change

    return correction


def tracer(value_at: Any, height_at: Any) -> Any:
    """Make the kernel that follows a ray through an index field to a face.

    Parameters
    ----------
    value_at : kernel
        As in `stepper`.
    height_at : kernel
        Called as ``height_at(face, x, y, z)``; returns a function that is 0 on the face, and its gradient. The function
        grows along +z on the part of the face that counts. The face has the attribute `vertex_z`.

    Returns
    -------
    reach : kernel
    """
    advance, kick, correction = stepper(value_at), kicker(value_at), corrector(height_at)

    @inlined
    def z_beside(face: Any, x: float, y: float) -> float:
        """Return the z of a face at (x, y), approximately; beyond its end, of its vertex."""
        z = face.vertex_z
        for _ in range(2):
            height, _, _, by_z = height_at(face, x, y, z)
            z -= height / by_z
        return z if abs(z) < np.inf else face.vertex_z

    @kernel
    def reach(
        field: Any, number: int, ray: GradientRay, face: Any, sense: float, steps: int
    ) -> tuple[bool, GradientRay]:  # fmt: skip
        """Return whether a ray reaches a face, and the ray there; else the ray as it was.

        The correction of a trial's length comes from the parabola that touches the ray at the trial's end, so the error
        of the next trial is of third order.

        Parameters
        ----------
        field, number : Any
            Passed to `value_at`.
        ray : GradientRay
            In front of the face.
        face : Any
            Passed to `height_at`.
        sense : float
            1 for a ray that crosses the face towards +z, −1 for one that crosses it towards −z.
        steps : int
            Number of equal steps.
        """
        z = z_beside(face, ray.x, ray.y)
        kick_z = value_at(field, number, ray.x, ray.y, ray.z)[3]
        if kick_z == 0.0 and z == face.vertex_z:
            # Of a plane in a medium that is constant along z, this is the exact length.
            count, length = steps, (z - ray.z) / ray.tz
        else:
            count, length = max(steps // COARSENESS, 1), abs(z - ray.z) / np.sqrt(square(ray))
        low, high = 0.0, np.inf
        for _ in range(MOST_TRIALS):
            end = advance(field, number, ray, length / count, count)
            height, by_x, by_y, by_z = height_at(face, end.x, end.y, end.z)
            towards = sense * (by_x * end.tx + by_y * end.ty + by_z * end.tz) > 0.0
            _, kick_x, kick_y, kick_z = value_at(field, number, end.x, end.y, end.z)
            change = correction(face, end, kick_x, kick_y, kick_z)
            if towards and count == steps and abs(change) <= NEAR * length:
                if not by_z > 0.0:
                    return False, ray
                return True, drift(kick(field, number, drift(end, 0.5 * change), change), 0.5 * change)
            if sense * height <= 0.0:
                low = length
            else:
                high = length
            following = min(length + change, 2.0 * length)
            if not (towards and low <= following <= high):
                following = 0.5 * (low + high) if high < np.inf else 2.0 * length
            elif abs(change) <= ROUGH * length:
                count, low, high = steps, 0.0, np.inf
            length = following
        return False, ray

    return reach


advance = stepper(field_at)
"""Take equal steps through gradient-index glass; see `stepper`."""

reach_conic = tracer(field_at, conic_height_at)
"""Follow a ray through gradient-index glass to a plane or conic; see `tracer`."""


@kernel
def _trace(
    gradients: Gradients,
    number: int,
    rays: Array,
    reached: NDArray[np.bool_],
    face: ConicFace,
    sense: float,
    steps: int,
) -> None:
    for i in range(len(rays)):
        ray = GradientRay(
            rays[i, 0], rays[i, 1], rays[i, 2], rays[i, 3], rays[i, 4], rays[i, 5], rays[i, 6], rays[i, 7]
        )  # fmt: skip
        reached[i], end = reach_conic(gradients, number, ray, face, sense, steps)
        rays[i, 0], rays[i, 1], rays[i, 2] = end.x, end.y, end.z
        rays[i, 3], rays[i, 4], rays[i, 5] = end.tx, end.ty, end.tz
        rays[i, 6], rays[i, 7] = end.path, end.length


@kernel
def _advance(gradients: Gradients, number: int, rays: Array, lengths: Array, steps: int) -> None:
    for i in range(len(rays)):
        ray = GradientRay(
            rays[i, 0], rays[i, 1], rays[i, 2], rays[i, 3], rays[i, 4], rays[i, 5], rays[i, 6], rays[i, 7]
        )  # fmt: skip
        end = advance(gradients, number, ray, lengths[i] / steps, steps)
        rays[i, 0], rays[i, 1], rays[i, 2] = end.x, end.y, end.z
        rays[i, 3], rays[i, 4], rays[i, 5] = end.tx, end.ty, end.tz
        rays[i, 6], rays[i, 7] = end.path, end.length


def starting_rays(gradients: Gradients, number: int, points: ArrayLike, directions: ArrayLike) -> Array:
    """Return rays inside a medium as rows of `GradientRay`, (n, 8), with paths and lengths 0.

    Parameters
    ----------
    gradients : Gradients
    number : int
        Row of the profile.
    points : (n, 3) array_like, mm
    directions : (n, 3) array_like
        Unit vectors.
    """
    at, along = (np.asarray(each, np.float64).reshape(-1, 3) for each in (points, directions))
    index = np.sqrt(fields_at(gradients, number, at)[:, :1])
    return np.hstack([at, index * along, np.zeros((len(at), 2))])


def traced(
    gradients: Gradients, number: int, rays: ArrayLike, face: ConicFace, steps: int, sense: float = 1.0
) -> tuple[NDArray[np.bool_], Array]:
    """Return which rays of a block reach a plane or conic, (n,) bool, and the rays there, (n, 8).

    Parameters
    ----------
    gradients : Gradients
    number : int
        Row of the profile.
    rays : (n, 8) array_like
        Rows of `GradientRay`; rays that do not reach the face are returned as they were.
    face : ConicFace
    steps : int
        Number of equal steps of each ray.
    sense : float
        1 for rays that cross the face towards +z, −1 for rays that cross it towards −z.
    """
    ends = np.array(rays, np.float64, ndmin=2)
    reached = np.zeros(len(ends), np.bool_)
    _trace(gradients, number, ends, reached, face, sense, steps)
    return reached, ends


def advanced(gradients: Gradients, number: int, rays: ArrayLike, lengths: ArrayLike, steps: int) -> Array:
    """Return the rays of a block after given lengths, (n, 8).

    Parameters
    ----------
    gradients : Gradients
    number : int
        Row of the profile.
    rays : (n, 8) array_like
        Rows of `GradientRay`.
    lengths : (n,) array_like, mm
        Lengths in σ, the geometric length over the index; negative to go back.
    steps : int
        Number of equal steps of each ray.
    """
    ends = np.array(rays, np.float64, ndmin=2)
    _advance(gradients, number, ends, np.ascontiguousarray(lengths, np.float64), steps)
    return ends


def least_steps(gradients: Gradients, number: int, points: ArrayLike, span_mm: float, width_mm: float) -> int:
    """Return the number of steps that follow every oscillation of probe rays, see `PHASE`.

    Parameters
    ----------
    gradients : Gradients
    number : int
        Row of the profile.
    points : (n, 3) array_like, mm
        Starts of the probe rays.
    span_mm : float
        Their longest length in σ.
    width_mm : float
        Width of the glass.
    """
    at, aside = np.asarray(points, np.float64), ASIDE * width_mm
    shifts = aside * np.eye(3)
    rates = [
        (fields_at(gradients, number, at + shift) - fields_at(gradients, number, at - shift))[:, 1:] for shift in shifts
    ]
    fastest = np.sqrt(np.linalg.norm(np.array(rates) / (2.0 * aside), axis=(0, 2)).max())
    return max(1, int(np.ceil(min(span_mm * fastest / PHASE, MOST_STEPS))))


def arriving_probes(arrives: Callable[[int], NDArray[np.bool_]], steps: int) -> NDArray[np.bool_]:
    """Return which probe rays reach the next face, (n,) bool: the same ones in some number of steps and in its double.

    Parameters
    ----------
    arrives : callable
        Tells which probes arrive in a given number of steps, (n,) bool.
    steps : int
        First number, see `least_steps`; at least `FEWEST_TRIAL_STEPS` are taken.
    """
    steps = max(steps, FEWEST_TRIAL_STEPS)
    found = arrives(steps)
    while True:
        finer = arrives(2 * steps)
        if np.array_equal(found, finer) or steps > MOST_STEPS:
            return found & finer
        steps, found = 2 * steps, finer


def steps_needed(trace: Callable[[int], tuple[NDArray[np.bool_], Array]], tolerance_mm: float) -> int:
    """Return the smallest sufficient number of steps for probe rays, all of which arrive.

    The number doubles until the result changes by no more than the tolerance. Then the rate of convergence gives a
    smaller number, which is checked against the finest result.

    Parameters
    ----------
    trace : callable
        Traces the probes in a given number of steps, as `traced` does.
    tolerance_mm : float
        Largest error of a probe's position. The optical path keeps `PATH_PRECISION` of it.

    Raises
    ------
    GlassError
        No probe reaches the face, or more than `MOST_STEPS` steps are needed.
    """
    steps = FEWEST_STEPS
    result, finer = trace(steps), trace(2 * steps)
    while not (error := _difference(result, finer)) <= tolerance_mm:
        steps *= 2
        if steps > MOST_STEPS and not finer[0].all():
            missing = np.count_nonzero(~finer[0])
            raise GlassError(f"gradient index: {missing} of {len(finer[0])} probe rays do not reach the next face")
        if steps > MOST_STEPS:
            raise GlassError(
                f"gradient index: rays in {MOST_STEPS} steps are wrong by {error:.1g} mm, more than "
                f"{tolerance_mm:g} mm; the profile must be smooth and change slowly in the medium"
            )
        result, finer = finer, trace(2 * steps)
    fewer = max(int(steps * (error / tolerance_mm) ** 0.125), steps // 2 + 1 if steps > FEWEST_STEPS else 1)
    while fewer < steps and not _difference(trace(fewer), finer) <= tolerance_mm:
        fewer += 1
    return fewer


def _difference(coarse: tuple[NDArray[np.bool_], Array], fine: tuple[NDArray[np.bool_], Array]) -> float:
    """Return the largest difference of the positions and, in units of `PATH_PRECISION`, the optical paths, mm.

    It is inf unless all rays reach the face: in too few steps, which are unstable, only those on the axis may.
    """
    (reached, ends), (reached_too, truth) = coarse, fine
    if not (reached.all() and reached_too.all() and len(reached)):
        return np.inf
    change = ends - truth
    return max(float(np.linalg.norm(change[:, :3], axis=1).max()), float(np.abs(change[:, 6]).max()) / PATH_PRECISION)
