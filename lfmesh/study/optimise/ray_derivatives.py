"""Rays of a lens with their derivatives by the variables, for all rays at once.

Rays run from object points through given points of the stop to the image plane, along a fixed sequence of surfaces, and
no aperture blocks them. Newton's iterations to surfaces and stop use plain numbers. By the implicit function theorem,
one further step with jets gives the derivatives. In gradient-index glass rays are curves (`gradient_rays.py`).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.study.optimise.gradient_rays import GradientGlass
from lfmesh.study.optimise.jet import Jet, Number, constant
from lfmesh.study.optimise.lens_numbers import LensNumbers, RayLayout, SurfaceNumbers
from lfmesh.study.optimise.phase_terms import steepness

Array = NDArray[np.float64]
Whole = NDArray[np.int64]
Vector = tuple[Number, Number, Number]

STEPS = 30
"""Largest number of Newton steps to a surface or a point of the stop."""

SETTLED = 1e-13
"""Relative step at which Newton's method has converged."""

AIMED = 1e-9
"""Distance from the point of the stop at which a ray counts as aimed, in stop radii."""

MOST_STEP = 0.5
"""Longest step of the aim at the first vertex, in stop radii."""


class RayFan(NamedTuple):
    """Rays to trace.

    Attributes
    ----------
    pupil : (n, 2) float64
        Points of the stop, in stop radii.
    field, wave : (n,) int64
        Numbers of the field and the wavelength.
    """

    pupil: Array
    field: Whole
    wave: Whole


class Landed(NamedTuple):
    """Rays at the image plane.

    Attributes
    ----------
    x, y : Jet
        (n,), mm; NaN for lost rays.
    entry : (n, 2) float64
        Intersections with the plane of the first vertex, mm.
    """

    x: Jet
    y: Jet
    entry: Array


def land(layout: RayLayout, numbers: Jet, fan: RayFan, guess: Array) -> Landed:
    """Trace rays through points of the stop to the image plane.

    Parameters
    ----------
    layout : RayLayout
    numbers : Jet
        Numbers of the lens, with their derivatives by m variables; m may be 0.
    fan : RayFan
    guess : (n, 2) float64
        Approximate intersections with the plane of the first vertex, mm.

    Returns
    -------
    Landed
        Derivatives are by the m variables, with each ray re-aimed.
    """
    with np.errstate(all="ignore"):
        entry = _aimed(layout, numbers.value, fan, guess)
        variables = numbers.slope.shape[-1]
        lens = layout.opened(Jet(numbers.value, np.pad(numbers.slope, ((0, 0), (0, 2)))))
        x, y, stop = _followed(layout, lens, fan, _seeded(entry, variables), to_image=True)
        # A ray stays at its point of the stop while variables change; its entry must move accordingly.
        off = [stop[k] - lens.stop_radius * fan.pupil[:, k] for k in (0, 1)]
        slopes = np.stack([each.slope for each in off], axis=1)
        moved = -np.linalg.solve(_regular(slopes[:, :, variables:]), slopes[:, :, :variables])
        landed = [
            Jet(at.value, at.slope[:, :variables] + np.einsum("nk,nkm->nm", at.slope[:, variables:], moved))
            for at in (x, y)
        ]
    return Landed(landed[0], landed[1], entry)


def _regular(matrices: Array) -> Array:
    """Return matrices (n, 2, 2) with singular ones replaced by the identity."""
    fine = np.abs(np.linalg.det(np.where(np.isfinite(matrices), matrices, 0.0))) > 0.0
    return np.where(fine[:, None, None], matrices, np.eye(2))


def _seeded(entry: Array, variables: int) -> tuple[Jet, Jet]:
    """Return the entry points of rays, with themselves as the last two variables."""
    x, y = (constant(entry[:, k], variables + 2) for k in (0, 1))
    x.slope[:, variables] = 1.0
    y.slope[:, variables + 1] = 1.0
    return x, y


def _aimed(layout: RayLayout, numbers: Array, fan: RayFan, guess: Array) -> Array:
    """Return the entry points of aimed rays in the plane of the first vertex, (n, 2) mm; NaN if none is found."""
    lens = layout.opened(constant(numbers, 2))
    radius = float(lens.stop_radius.value)
    aim, entry = radius * fan.pupil, guess.copy()
    for _ in range(STEPS):
        _, _, stop = _followed(layout, lens, fan, _seeded(entry, 0), to_image=False)
        off = np.stack([stop[0].value, stop[1].value], axis=1) - aim
        matrix = np.stack([stop[0].slope, stop[1].slope], axis=1)
        step = -np.linalg.solve(_regular(matrix), off[:, :, None])[:, :, 0]
        length = np.hypot(*step.T)
        most = MOST_STEP * radius
        entry += step * np.where(length > most, most / length, 1.0)[:, None]
        if not np.any(length > SETTLED * (radius + np.abs(entry).max(axis=1))):
            break
    # Convergence is quadratic: the remaining error is about the square of the last step.
    return np.where((length <= AIMED * radius)[:, None], entry, np.nan)


def _followed(
    layout: RayLayout, lens: LensNumbers, fan: RayFan, entry: tuple[Jet, Jet], *, to_image: bool
) -> tuple[Jet, Jet, tuple[Jet, Jet]]:
    """Return the intersections of rays with the image plane, and with the stop surface in its frame."""
    p, d = _starts(lens, fan, entry)
    stop: tuple[Jet, Jet] = entry
    for number, surface in enumerate(lens.surfaces):
        pure = number == layout.stop and layout.pure_stop
        before = lens.indices.picked((fan.wave, number))
        if number and layout.gradients[number - 1] is not None:
            p, d, before = _through_gradient(layout, lens, fan, number, (p, d))
        else:
            p, d = _into(surface.pose, p, d)
            p = _met(surface, () if pure else layout.powers[number], p, d)
        if number == layout.stop:
            stop = (_as_jet(p[0]), _as_jet(p[1]))
            if not to_image:
                break
        if not pure:
            after = _index_behind(layout, lens, fan, number, p)
            turn = layout.turns_mm[fan.wave] / after if any(layout.phases[number]) else None
            d = _bent(surface, layout.powers[number], p, d, before / after, turn)
        p, d = _out_of(surface.pose, p, d)
    if not to_image:
        return *stop, stop
    t = (lens.image_z - p[2]) / d[2]
    return _as_jet(p[0] + t * d[0]), _as_jet(p[1] + t * d[1]), stop


def _starts(lens: LensNumbers, fan: RayFan, entry: tuple[Jet, Jet]) -> tuple[Vector, Vector]:
    """Return rays at the plane of the first vertex, with unit directions; see `LensRays.starts`."""
    slope = lens.slopes.picked(fan.field)
    x, y = entry[0] * lens.vergence, entry[1] * lens.vergence - slope
    scale = 1.0 / (x * x + y * y + 1.0).root()
    return (entry[0], entry[1], entry[0] * 0.0), (x * scale, y * scale, scale)


def _index_behind(layout: RayLayout, lens: LensNumbers, fan: RayFan, number: int, p: Vector) -> Jet:
    """Return the index behind a surface at points on it, in its frame."""
    form = layout.gradients[number]
    if form is None:
        return lens.indices.picked((fan.wave, number + 1))
    return GradientGlass(form, lens.surfaces[number].gradient, fan.wave).index_at(_stacked(p))


def _through_gradient(
    layout: RayLayout, lens: LensNumbers, fan: RayFan, number: int, rays: tuple[Vector, Vector]
) -> tuple[Vector, Vector, Jet]:
    """Return rays on a surface behind gradient-index glass, in its frame, and the index before it.

    Parameters
    ----------
    layout : RayLayout
    lens : LensNumbers
    fan : RayFan
    number : int
        Number of the surface.
    rays : (Vector, Vector)
        Points on the surface before it, and unit directions behind that, camera frame.
    """
    front, surface, form = lens.surfaces[number - 1], lens.surfaces[number], layout.gradients[number - 1]
    assert form is not None
    glass = GradientGlass(form, front.gradient, fan.wave)
    p, d = _frame_into(front.pose, *rays)
    points, directions = _stacked(p), _stacked(d)
    momenta = directions * _as_column(glass.index_at(points))
    plain = [SurfaceNumbers(*(constant(number.value, 0) for number in numbers)) for numbers in (front, surface)]
    lengths, steps = _gradient_lengths(glass, plain, layout.powers[number], points.value, momenta.value)
    ends, ahead = glass.carried(points, momenta, lengths, steps)
    at, along = _frame_into(surface.pose, *_out_of(front.pose, _parted(ends), _parted(ahead)))
    kick = _parted(constant(glass.kicks(ends.value), points.slope.shape[-1]))
    _, turn = _frame_into(surface.pose, *_out_of(front.pose, _parted(ends), kick))
    excess, fall = _excess(surface, layout.powers[number], at, along)
    change = -excess / _value(fall)
    at, along = _moved(at, along, change), _moved(along, turn, change)
    index = _as_jet(along[0] * along[0] + along[1] * along[1] + along[2] * along[2]).root()
    return at, tuple(component / index for component in along), index  # type: ignore[return-value]


def _gradient_lengths(
    glass: GradientGlass, surfaces: list[SurfaceNumbers], powers: tuple[int, ...], points: Array, momenta: Array
) -> tuple[Array, int]:
    """Return the lengths of rays in σ from one surface to the next, (n,) mm, and a sufficient number of steps.

    Parameters
    ----------
    glass : GradientGlass
    surfaces : list of SurfaceNumbers
        The two surfaces, without derivatives.
    powers : tuple of int
        Powers of r added to the conic of the second.
    points, momenta : (n, 3) float64
        As for `GradientGlass.ends`.
    """
    front, surface = surfaces
    depth = np.linalg.norm(surface.pose.value[:, 3] - front.pose.value[:, 3])
    lengths = (depth - points[:, 2]) / momenta[:, 2]
    steps = glass.steps_for(points, momenta, lengths)
    for _ in range(STEPS):
        ends = glass.ends(points, momenta, lengths, steps)
        p, along = (_parted(constant(half, 0)) for half in (ends[:, :3], ends[:, 3:]))
        excess, fall = _excess(surface, powers, *_frame_into(surface.pose, *_out_of(front.pose, p, along)))
        step = _value(excess) / _value(fall)
        lengths = lengths - step
        if not np.any(np.abs(step) > SETTLED * (1.0 + np.abs(lengths))):
            break
    return np.where(np.abs(step) <= AIMED * (1.0 + np.abs(lengths)), lengths, np.nan), steps


def _stacked(vector: Vector) -> Jet:
    """Return the components of vectors as one jet, (n, 3)."""
    parts = [_as_jet(part) for part in vector]
    return Jet(np.stack([part.value for part in parts], axis=1), np.stack([part.slope for part in parts], axis=1))


def _parted(vectors: Jet) -> Vector:
    return tuple(vectors.picked((slice(None), k)) for k in range(3))  # type: ignore[return-value]


def _as_column(numbers: Jet) -> Jet:
    return Jet(numbers.value[:, None], numbers.slope[:, None])


def _is_upright(pose: Jet) -> bool:
    return bool((pose.value[:, :3] == np.eye(3)).all() and not pose.slope[:, :3].any())


def _into(pose: Jet, p: Vector, d: Vector) -> tuple[Vector, Vector]:
    """Transform rays into the frame of a surface, and move them to the plane of its vertex."""
    p, d = _frame_into(pose, p, d)
    t = -p[2] / d[2]
    return (p[0] + t * d[0], p[1] + t * d[1], p[2] * 0.0), d


def _frame_into(pose: Jet, p: Vector, d: Vector) -> tuple[Vector, Vector]:
    """Transform rays into the frame of a surface."""
    p = tuple(p[i] - pose.picked((i, 3)) for i in range(3))  # type: ignore[assignment]
    if not _is_upright(pose):
        p, d = (_turned(pose, vector, back=True) for vector in (p, d))
    return p, d


def _out_of(pose: Jet, p: Vector, d: Vector) -> tuple[Vector, Vector]:
    """Transform rays back into the camera frame."""
    if not _is_upright(pose):
        p, d = (_turned(pose, vector, back=False) for vector in (p, d))
    return tuple(p[i] + pose.picked((i, 3)) for i in range(3)), d  # type: ignore[return-value]


def _turned(pose: Jet, vector: Vector, *, back: bool) -> Vector:
    rows = range(3)
    at = [[pose.picked((j, i) if back else (i, j)) for j in rows] for i in rows]
    return tuple(sum((at[i][j] * vector[j] for j in rows), 0.0) for i in rows)  # type: ignore[return-value]


def _met(surface: SurfaceNumbers, powers: tuple[int, ...], p: Vector, d: Vector) -> Vector:
    """Return the intersections of rays, given at the plane of the vertex, with a surface.

    The conic is intersected in closed form; other terms follow by Newton's method. A last step with jets gives the
    derivatives, -(∂F/∂variables)/(∂F/∂t) of F = z - sag.
    """
    values, ahead = [_value(each) for each in p], (_value(d[0]), _value(d[1]), _value(d[2]))
    plain = SurfaceNumbers(*(constant(each.value, 0) for each in surface))
    c, k = surface.curvature.value, surface.conic.value
    square = c * (ahead[0] * ahead[0] + ahead[1] * ahead[1] + (1.0 + k) * ahead[2] * ahead[2])
    linear = c * (values[0] * ahead[0] + values[1] * ahead[1]) - ahead[2]
    rest = c * (values[0] * values[0] + values[1] * values[1])
    t = rest / (np.sqrt(linear * linear - square * rest) - linear)
    start: Vector = (constant(values[0], 0), constant(values[1], 0), constant(values[2], 0))
    for _ in range(STEPS if powers else 0):
        excess, fall = _excess(plain, powers, _moved(start, ahead, t), ahead)
        step = _value(excess) / _value(fall)
        t = np.asarray(t - step)
        if not np.any(np.abs(step) > SETTLED * (1.0 + np.abs(t))):
            break
    at = _moved(p, d, t)
    excess, fall = _excess(surface, powers, at, d)
    return _moved(at, d, -excess / _value(fall))


def _moved(p: Vector, d: Vector, t: Number) -> Vector:
    return p[0] + t * d[0], p[1] + t * d[1], p[2] + t * d[2]


def _excess(surface: SurfaceNumbers, powers: tuple[int, ...], p: Vector, d: Vector) -> tuple[Number, Number]:
    """Return the distance of points behind a surface along z, and its derivative along rays."""
    r2 = _as_jet(p[0] * p[0] + p[1] * p[1])
    sag, double = _sag(surface, powers, r2)
    return p[2] - sag, d[2] - double * (p[0] * d[0] + p[1] * d[1])


def _sag(surface: SurfaceNumbers, powers: tuple[int, ...], r2: Jet) -> tuple[Number, Number]:
    """Return the sag at given squared heights, and its derivative by the height, divided by the height."""
    c = surface.curvature
    root = (1.0 - (surface.conic + 1.0) * c * c * r2).root()
    sag, double = c * r2 / (root + 1.0), c / root
    if powers:
        r = r2.root()
        for number, power in enumerate(powers):
            a = surface.terms.picked(number)
            lower = r.power(power - 2)
            sag, double = sag + a * lower * r2, double + a * lower * float(power)
    return sag, double


def _bent(
    surface: SurfaceNumbers, powers: tuple[int, ...], p: Vector, d: Vector, ratio: Jet, turn: Jet | None
) -> Vector:
    """Return the directions of rays behind a surface, by Snell's law in vector form or for an ideal thin lens.

    Parameters
    ----------
    surface : SurfaceNumbers
    powers : tuple of int
        Powers of r added to its conic.
    p, d : Vector
        Points on the surface, and unit directions.
    ratio : Jet
        Index before the surface over that behind it.
    turn : Jet, optional
        Factor from the gradient of a phase to the change of the tangential direction: λ/2π over the index behind, mm.
        None for a surface without a phase.
    """
    if surface.thin_power.value != 0.0 or surface.thin_power.slope.any():
        x, y = (d[i] / d[2] - surface.thin_power * p[i] for i in (0, 1))
        scale = 1.0 / (_as_jet(x * x + y * y + 1.0)).root()
        return x * scale, y * scale, scale
    r2 = _as_jet(p[0] * p[0] + p[1] * p[1])
    _, double = _sag(surface, powers, r2)
    normal = (-double * p[0], -double * p[1], 1.0)
    scale = 1.0 / _as_jet(normal[0] * normal[0] + normal[1] * normal[1] + 1.0).root()
    normal = tuple(each * scale for each in normal)  # type: ignore[assignment]
    if turn is not None:
        steep = turn * steepness(surface.phase_powers, surface.phase_distances, r2)
        return _diffracted((ratio * d[0] + steep * p[0], ratio * d[1] + steep * p[1], ratio * d[2]), normal)
    cosine = sum((normal[i] * d[i] for i in range(3)), 0.0)
    behind = (1.0 - ratio * ratio * (1.0 - cosine * cosine)).root()
    along = behind - ratio * cosine
    return tuple(ratio * d[i] + along * normal[i] for i in range(3))  # type: ignore[return-value]


def _diffracted(moved: Vector, normal: Vector) -> Vector:
    """Return unit directions with the tangential part of given vectors."""
    along = sum((normal[i] * moved[i] for i in range(3)), 0.0)
    square = sum((moved[i] * moved[i] for i in range(3)), 0.0)
    behind = _as_jet(1.0 - (square - along * along)).root()
    return tuple(moved[i] + (behind - along) * normal[i] for i in range(3))  # type: ignore[return-value]


def _value(number: Number) -> Array:
    return number.value if isinstance(number, Jet) else np.asarray(number, dtype=np.float64)


def _as_jet(number: Number) -> Jet:
    assert isinstance(number, Jet)
    return number
