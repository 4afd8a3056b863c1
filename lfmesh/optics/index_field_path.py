"""Rays through an index field in a box, chord by chord from the point of entry to the first exit.

The ray equation is that of `gradient_path`, dr/dσ = T and dT/dσ = ½ ∇n². There are two schemes.

`LEAPFROG`, for weak fields: half a kick, a drift and half a kick. Equidistant planes divide the box into slabs, across
the axis along which a ray enters the most voxels per mm. Every drift ends on a plane or on a face of the box: with
T + ½ k σ, k = ½ ∇n² at its start, its length σ is the root of a quadratic equation. So the steps of a ray depend on its
position alone. They are the same ones for a ray that is sent back, which returns to its start, to rounding, unless
another axis leads at its exit. A step takes one evaluation. The error is of second order in the step, but small in weak
fields: in a field that fades inside the box, equidistant planes integrate the first-order deflection with an error that
falls exponentially, and the rest of the relative error is proportional to n − 1.

`RUNGE_KUTTA`, for strong fields: the method of A. Sharma, D. V. Kumar and A. K. Ghatak (Appl. Opt. 21, 984, 1982), of
fourth order, with three evaluations a step. Steps have the same length in voxels, along the axis that leads; the last
ends on the face. It is not symmetric: a ray that is sent back returns to its start but for the error of integration.

The optical path ∫ n² dσ is summed by the same scheme, as ∫ (|T|² + n²)/2 dσ in leapfrog steps. Two invariants hold but
for the error of integration: |T|² − n² = 0, and the étendue dx dy dT_x dT_y of neighbouring rays. Invariants by
symmetry hold to rounding in leapfrog steps, and but for the error of integration in others: r × T in a spherical field
(n r sin θ, Bouguer's law), and T along an axis on which n does not depend. T is constant on a chord of leapfrog steps.

A ray may leave the box and enter it again between two ends of steps; such an exit, nearly grazing, is not noticed.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.kernels.vector import fused
from lfmesh.optics.gradient_path import GradientRay, drift, square
from lfmesh.optics.index_fields import LEAPFROG, IndexFields, index_field_at, indices_at

Array = NDArray[np.float64]

INSIDE = -1
"""Face of a ray that has not left the box. The faces are 2 axis, and 2 axis + 1 at the upper end of the axis."""

MOST_CHORDS = 1 << 16
"""Largest number of chords; a ray that has not left the box after them is trapped."""

MOST_TRIALS = 60
"""Trials of a last step. Newton's method takes three; bisection needs all float64 has digits for."""

SETTLED = 1e-12
"""Correction of a last step, over the length of a step, that a drift makes: its square is rounding."""


class FieldRay(NamedTuple):
    """A ray at the end of a chord.

    Attributes
    ----------
    ray : GradientRay
    n2 : float
        n² at its point.
    kick_x, kick_y, kick_z : float, mm⁻¹
        ½ ∇n² there.
    axis, slab : int
        Axis of the slabs, and slab ahead.
    face : int
        Face of the box that the ray leaves by, or INSIDE.
    """

    ray: GradientRay
    n2: float
    kick_x: float
    kick_y: float
    kick_z: float
    axis: int
    slab: int
    face: int


class _Move(NamedTuple):
    """The end of a chord: the ray there, and the face it ends on, or INSIDE; a plane is the face of its axis."""

    ray: GradientRay
    face: int


@inlined
def _crossing(r: float, t: float, k: float, low: float, high: float) -> tuple[float, bool]:
    """Return the length in σ of a chord from a point in [low, high] to one of these bounds, and if it is the upper one.

    The chord runs along t + ½ k σ. The length is inf if the chord runs along the bounds.
    """
    upper = t > 0.0 or (t == 0.0 and k > 0.0)
    ahead = (high if upper else low) - r
    squared = fused(t, t, 2.0 * k * ahead)
    if squared >= 0.0:
        total = abs(t) + np.sqrt(squared)
        return (2.0 * abs(ahead) / total if total > 0.0 else np.inf), upper
    # The gradient turns the chord to the bound behind.
    behind = (low if upper else high) - r
    squared = max(fused(t, t, 2.0 * k * behind), 0.0)
    return (abs(t) + np.sqrt(squared)) / abs(k), not upper


@inlined
def _on_face(ray: GradientRay, face: int, at: float) -> GradientRay:
    """Return a ray with the coordinate across a face set to a number."""
    axis = face >> 1
    return GradientRay(
        at if axis == 0 else ray.x,
        at if axis == 1 else ray.y,
        at if axis == 2 else ray.z,
        ray.tx,
        ray.ty,
        ray.tz,
        ray.path,
        ray.length,
    )


@inlined
def _kicked(ray: GradientRay, n2: float, kick_x: float, kick_y: float, kick_z: float, step: float) -> GradientRay:
    """Return a ray after half the kick of a step."""
    return GradientRay(
        ray.x,
        ray.y,
        ray.z,
        fused(0.5 * step, kick_x, ray.tx),
        fused(0.5 * step, kick_y, ray.ty),
        fused(0.5 * step, kick_z, ray.tz),
        fused(0.25 * step, n2, ray.path),
        ray.length,
    )


@inlined
def _plane(box: Any, axis: int, number: int) -> float:
    """Return the position of a plane between slabs; the outer ones are the faces, to the bit."""
    slabs = box.slabs[axis]
    if number >= slabs:
        return box.high[axis]
    return box.low[axis] + number * ((box.high[axis] - box.low[axis]) / slabs)


@inlined
def _component(ray: GradientRay, axis: int) -> float:
    """Return a component of T."""
    return ray.tx if axis == 0 else (ray.ty if axis == 1 else ray.tz)


@inlined
def _leading(box: Any, ray: GradientRay) -> tuple[int, float]:
    """Return the axis along which a ray crosses the most voxels, and their number per mm of σ."""
    x, y, z = abs(ray.tx) * box.per_mm[0], abs(ray.ty) * box.per_mm[1], abs(ray.tz) * box.per_mm[2]
    most = max(x, y, z)
    return (2 if z == most else (0 if x == most else 1)), most


@inlined
def _beyond(box: Any, axis: int, at: float) -> tuple[float, int]:
    """Return the distance beyond the nearer face of an axis, negative inside, and that face."""
    below, above = box.low[axis] - at, at - box.high[axis]
    return max(below, above), 2 * axis + (above > below)


@inlined
def _farthest(box: Any, ray: GradientRay) -> tuple[float, int]:
    """Return the largest distance beyond a face, and that face; negative inside, with the nearest face."""
    x, face_x = _beyond(box, 0, ray.x)
    y, face_y = _beyond(box, 1, ray.y)
    z, face_z = _beyond(box, 2, ray.z)
    most = max(x, y, z)
    return most, (face_z if z == most else (face_x if x == most else face_y))


@inlined
def _leapt(box: Any, at: FieldRay) -> tuple[GradientRay, float, int]:
    """Return a ray after half a kick and a drift to the next plane or face, the step in σ, and the face or plane."""
    ray, axis = at.ray, at.axis
    begin, end = _plane(box, axis, at.slab), _plane(box, axis, at.slab + 1)
    low_x, high_x = (begin, end) if axis == 0 else (box.low[0], box.high[0])
    low_y, high_y = (begin, end) if axis == 1 else (box.low[1], box.high[1])
    low_z, high_z = (begin, end) if axis == 2 else (box.low[2], box.high[2])
    step_x, upper_x = _crossing(ray.x, ray.tx, at.kick_x, low_x, high_x)
    step_y, upper_y = _crossing(ray.y, ray.ty, at.kick_y, low_y, high_y)
    step_z, upper_z = _crossing(ray.z, ray.tz, at.kick_z, low_z, high_z)
    step = min(step_x, step_y, step_z)
    if step == step_z:
        face, coordinate = 4 + upper_z, (high_z if upper_z else low_z)
    elif step == step_x:
        face, coordinate = 0 + upper_x, (high_x if upper_x else low_x)
    else:
        face, coordinate = 2 + upper_y, (high_y if upper_y else low_y)
    half = _kicked(ray, at.n2, at.kick_x, at.kick_y, at.kick_z, step)
    return _on_face(drift(half, step), face, coordinate), step, face


def _nystrom(value_at: Any) -> Any:
    """Return the step of the Runge-Kutta scheme in an index field."""

    @inlined
    def nystrom(field: Any, number: int, at: FieldRay, step: float) -> GradientRay:
        ray, half, step2 = at.ray, 0.5 * step, step * step
        middle2, middle_x, middle_y, middle_z = value_at(
            field,
            number,
            fused(half, ray.tx, fused(0.125 * step2, at.kick_x, ray.x)),
            fused(half, ray.ty, fused(0.125 * step2, at.kick_y, ray.y)),
            fused(half, ray.tz, fused(0.125 * step2, at.kick_z, ray.z)),
        )
        end2, end_x, end_y, end_z = value_at(
            field,
            number,
            fused(step, ray.tx, fused(0.5 * step2, middle_x, ray.x)),
            fused(step, ray.ty, fused(0.5 * step2, middle_y, ray.y)),
            fused(step, ray.tz, fused(0.5 * step2, middle_z, ray.z)),
        )
        sixth, index = step / 6.0, np.sqrt(at.n2) + 4.0 * np.sqrt(middle2) + np.sqrt(end2)
        return GradientRay(
            fused(step, ray.tx, fused(step * sixth, at.kick_x + 2.0 * middle_x, ray.x)),
            fused(step, ray.ty, fused(step * sixth, at.kick_y + 2.0 * middle_y, ray.y)),
            fused(step, ray.tz, fused(step * sixth, at.kick_z + 2.0 * middle_z, ray.z)),
            fused(sixth, at.kick_x + 4.0 * middle_x + end_x, ray.tx),
            fused(sixth, at.kick_y + 4.0 * middle_y + end_y, ray.ty),
            fused(sixth, at.kick_z + 4.0 * middle_z + end_z, ray.tz),
            fused(sixth, at.n2 + 4.0 * middle2 + end2, ray.path),
            fused(sixth, index, ray.length),
        )

    return nystrom


def _last_step(nystrom: Any) -> Any:
    """Return the kernel that shortens a Runge-Kutta step to end on the face that it crosses."""

    @kernel
    def last_step(field: Any, boxes: NDArray[np.void], number: int, at: FieldRay, whole: float) -> _Move:
        box, ray = boxes[number], at.ray
        inside, outside = 0.0, whole
        guess_x, _ = _crossing(ray.x, ray.tx, at.kick_x, box.low[0], box.high[0])
        guess_y, _ = _crossing(ray.y, ray.ty, at.kick_y, box.low[1], box.high[1])
        guess_z, _ = _crossing(ray.z, ray.tz, at.kick_z, box.low[2], box.high[2])
        step = min(guess_x, guess_y, guess_z)
        if not 0.0 < step < whole:
            step = 0.5 * whole
        for _ in range(MOST_TRIALS):
            end = nystrom(field, number, at, step)
            beyond, _ = _farthest(box, end)
            if beyond > 0.0:
                outside = step
            else:
                inside = step
            # The first exit along T, ahead or behind.
            change = min(
                ((box.high[0] if end.tx > 0.0 else box.low[0]) - end.x) / end.tx if end.tx != 0.0 else np.inf,
                ((box.high[1] if end.ty > 0.0 else box.low[1]) - end.y) / end.ty if end.ty != 0.0 else np.inf,
                ((box.high[2] if end.tz > 0.0 else box.low[2]) - end.z) / end.tz if end.tz != 0.0 else np.inf,
            )
            if abs(change) <= SETTLED * whole:
                # The kick of so short a drift changes the path alone.
                end = _kicked(drift(end, change), square(end), 0.0, 0.0, 0.0, 2.0 * change)
                break
            following = step + change
            step = following if inside < following < outside else 0.5 * (inside + outside)
        _, face = _farthest(box, end)
        bound = box.high[face >> 1] if face & 1 else box.low[face >> 1]
        return _Move(_on_face(end, face, bound), face)

    return last_step


def marcher(value_at: Any) -> tuple[Any, Any]:
    """Make the kernels that enter an index field and take one chord in it.

    Parameters
    ----------
    value_at : kernel
        Called as ``value_at(field, number, x, y, z)``; returns n² and the three components of ½ ∇n², mm⁻¹.

    Returns
    -------
    enter, advance : kernel
    """
    nystrom = _nystrom(value_at)
    last_step = _last_step(nystrom)

    @kernel
    def enter(field: Any, boxes: NDArray[np.void], number: int, ray: GradientRay) -> FieldRay:
        """Return a ray at its entry.

        Parameters
        ----------
        field : Any
            Passed to `value_at`.
        boxes : (n,) INDEX_FIELD
            Bounds and steps; other fields than those of `IndexFields` need no more of the row.
        number : int
            Row of the box; passed to `value_at`.
        ray : GradientRay
            In the box, or on a face with T inwards.
        """
        box = boxes[number]
        axis, _ = _leading(box, ray)
        at = ray.x if axis == 0 else (ray.y if axis == 1 else ray.z)
        slabs, along = box.slabs[axis], _component(ray, axis)
        slab = int(np.floor((at - box.low[axis]) / (box.high[axis] - box.low[axis]) * slabs))
        slab = min(max(slab, 0), slabs - 1)
        # A plane belongs to the slab ahead.
        if along < 0.0 and slab > 0 and _plane(box, axis, slab) >= at:
            slab -= 1
        elif along > 0.0 and slab + 1 < slabs and _plane(box, axis, slab + 1) <= at:
            slab += 1
        n2, kick_x, kick_y, kick_z = value_at(field, number, ray.x, ray.y, ray.z)
        return FieldRay(ray, n2, kick_x, kick_y, kick_z, axis, slab, INSIDE)

    @kernel
    def advance(field: Any, boxes: NDArray[np.void], number: int, at: FieldRay) -> FieldRay:
        """Return a ray after one more chord.

        Parameters
        ----------
        field, boxes, number
            As in `enter`.
        at : FieldRay
            Not yet out of the box.
        """
        box = boxes[number]
        axis, slab = at.axis, at.slab
        if box.scheme == LEAPFROG:
            ray, step, face = _leapt(box, at)
            n2, kick_x, kick_y, kick_z = value_at(field, number, ray.x, ray.y, ray.z)
            ray = _kicked(ray, n2, kick_x, kick_y, kick_z, step)
            along = _component(ray, face >> 1)
            onwards = along > 0.0 if face & 1 else along < 0.0
            if onwards and face >> 1 == axis:
                slab += 1 if face & 1 else -1
                onwards = not 0 <= slab < box.slabs[axis]
            return FieldRay(ray, n2, kick_x, kick_y, kick_z, axis, slab, face if onwards else INSIDE)
        step = box.step / _leading(box, at.ray)[1]
        move = _Move(nystrom(field, number, at, step), INSIDE)
        beyond, _ = _farthest(box, move.ray)
        if beyond >= 0.0:
            move = last_step(field, boxes, number, at, step)
        n2, kick_x, kick_y, kick_z = value_at(field, number, move.ray.x, move.ray.y, move.ray.z)
        return FieldRay(move.ray, n2, kick_x, kick_y, kick_z, axis, slab, move.face)

    return enter, advance


def follower(value_at: Any) -> Any:
    """Make the kernel that follows rays through an index field to their exits.

    Parameters
    ----------
    value_at : kernel
        As in `marcher`.

    Returns
    -------
    follow : kernel
    """
    enter, advance = marcher(value_at)

    @kernel
    def follow(
        field: Any, boxes: NDArray[np.void], number: int, rays: Array, faces: NDArray[np.int64], nodes: Any
    ) -> None:
        """Replace rays by those at their exits.

        Parameters
        ----------
        field, boxes, number
            As in `enter`.
        rays : (n, 8) float64
            Rows of `GradientRay` at the entries; replaced.
        faces : (n,) int64
            Faces of the exits, or INSIDE for rays that are trapped; written.
        nodes : (n, most, 8) float64 or None
            Rays at the ends of their chords, the entry first and the exit last; written. What does not fit is left out.
            Rows behind the exit stay as they were.
        """
        for i in range(len(rays)):
            start = GradientRay(
                rays[i, 0], rays[i, 1], rays[i, 2], rays[i, 3], rays[i, 4], rays[i, 5], rays[i, 6], rays[i, 7]
            )  # fmt: skip
            at = enter(field, boxes, number, start)
            count = 0
            while at.face == INSIDE and count < MOST_CHORDS:
                if nodes is not None and count < nodes.shape[1]:
                    _write(nodes[i, count], at.ray)
                at = advance(field, boxes, number, at)
                count += 1
            if nodes is not None and count < nodes.shape[1]:
                _write(nodes[i, count], at.ray)
            faces[i] = at.face
            _write(rays[i], at.ray)

    return follow


@inlined
def _write(row: Array, ray: GradientRay) -> None:
    row[0], row[1], row[2], row[3] = ray.x, ray.y, ray.z, ray.tx
    row[4], row[5], row[6], row[7] = ray.ty, ray.tz, ray.path, ray.length


enter, advance = marcher(index_field_at)
"""Enter an index field on a voxel grid, and take one chord in it; see `marcher`."""

_follow = follower(index_field_at)


def entries(fields: IndexFields, number: int, points: ArrayLike, directions: ArrayLike) -> Array:
    """Return rays at their entries into a field, (n, 8): rows of `GradientRay` with paths and lengths 0.

    The rays are not refracted at the faces. The row of a ray that misses the box is filled with NaN.

    Parameters
    ----------
    fields : IndexFields
    number : int
        Row of the field and wavelength.
    points : (n, 3) array_like, mm
        Points of the rays, outside the box; a point inside is its own entry.
    directions : (n, 3) array_like
        Unit vectors.
    """
    at, along = (np.array(part, np.float64).reshape(-1, 3) for part in (points, directions))
    box = fields.rows[number]
    with np.errstate(divide="ignore", invalid="ignore"):
        # 0/0 of a ray that runs in the plane of a face sets no bound.
        crossings = np.array([(box["low"] - at) / along, (box["high"] - at) / along])
    begin = np.where(np.isnan(crossings), -np.inf, crossings).min(axis=0).max(axis=1).clip(0.0)
    end = np.where(np.isnan(crossings), np.inf, crossings).max(axis=0).min(axis=1)
    met = begin < end
    entry = np.clip(at + np.where(met, begin, 0.0)[:, None] * along, box["low"], box["high"])
    rays = np.hstack([entry, indices_at(fields, number, entry)[:, :1] * along, np.zeros((len(at), 2))])
    rays[~met] = np.nan
    return rays


def traced(fields: IndexFields, number: int, rays: ArrayLike) -> tuple[NDArray[np.int64], Array]:
    """Return the faces by which rays leave a field, (n,) int64, and the rays there, (n, 8).

    Parameters
    ----------
    fields : IndexFields
    number : int
        Row of the field and wavelength.
    rays : (n, 8) array_like
        Rows of `GradientRay` at the entries. A ray that is trapped leaves by INSIDE.
    """
    ends = np.array(rays, np.float64, ndmin=2)
    faces = np.full(len(ends), INSIDE)
    _follow(fields, fields.rows, number, ends, faces, None)
    return faces, ends


def chords(fields: IndexFields, number: int, rays: ArrayLike, most: int) -> Array:
    """Return the ends of the chords of rays through a field, (n, most, 8).

    A row starts with the entry and ends with the exit; it is filled with NaN behind it. Chords that do not fit are left
    out.

    Parameters
    ----------
    fields, number, rays
        As in `traced`.
    most : int
        Largest number of ends for each ray.
    """
    starts = np.array(rays, np.float64, ndmin=2)
    nodes = np.full((len(starts), most, 8), np.nan)
    _follow(fields, fields.rows, number, starts, np.full(len(starts), INSIDE), nodes)
    return nodes


def unit_directions(rays: ArrayLike) -> Array:
    """Return the directions T/|T| of rays, (n, 3).

    Parameters
    ----------
    rays : (n, 8) array_like
        Rows of `GradientRay`.
    """
    along = np.asarray(rays, np.float64)[..., 3:6]
    return along / np.linalg.norm(along, axis=-1, keepdims=True)


def deflections(starts: ArrayLike, ends: ArrayLike) -> Array:
    """Return the angles between rays at two points, (n,), rad.

    Parameters
    ----------
    starts, ends : (n, 8) array_like
        Rows of `GradientRay`.
    """
    first, last = unit_directions(starts), unit_directions(ends)
    return 2.0 * np.arctan2(np.linalg.norm(last - first, axis=-1), np.linalg.norm(last + first, axis=-1))
