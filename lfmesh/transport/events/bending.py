"""Chords of rays through media that bend light.

A packet in object space waits at a node, with the ray's true direction there. Its next chord is straight: outside all
fields, up to the face of a field; in a field, one step of the integration (`optics.index_field_path`). So Embree, exact
faces, media and targets need not know of curves. A ray refracts at the faces of a field, or is totally reflected there.
What a face reflects otherwise is neglected: 2.5e-7 at a step of 1e-3, except near grazing.
"""

from typing import Any

import numpy as np

from lfmesh.geometry.frame import direction_through, point_through
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.gradient_path import GradientRay
from lfmesh.optics.index_field_path import INSIDE, MOST_CHORDS, FieldRay, marcher
from lfmesh.transport.packets.packet import (
    CHORDS,
    END_STATE,
    END_TX,
    END_TY,
    END_TZ,
    EVENT_AT_END,
    LENGTH,
    NO_EVENT,
    NO_PLANE,
    OPTICAL,
    OUTSIDE,
    PLANE,
    REFLECTED_AT_FACE,
    REFRACTED_AT_FACE,
    SHADOW,
    STATE,
    UNKNOWN,
)
from lfmesh.transport.tables.bending_fields import BendingFields, bending_at

GRAIN = 1e-14
"""Shortest chord, over the coordinates of its start: rounding of a position."""

SMALLEST = 1e-300
"""Added to the rounding of a position, so that a chord from the origin has a length too; mm."""

CONTACT = 1e-12
"""Distance behind the end of a chord, over the coordinates, up to which a hit still counts: from the node it might lie
behind the start."""

SHORT = 1e-6
"""Length of a step, over the longest edge of its field, below which the next step joins its chord."""

MOST_JOINED = 3
"""Largest number of steps of such a chord."""

enter, advance = marcher(bending_at)

Vector = tuple[float, float, float]


@inlined
def next_chord(fields: Any, packet: Any) -> None:
    """Find the chord of a packet at a node, if it is not known, and turn the packet along it.

    Parameters
    ----------
    fields : BendingFields or None
        None: nothing bends light, and numba compiles only the first line.
    packet : BENT
        In the object frame.
    """
    if fields is None:
        return
    if packet.chord[LENGTH] == 0.0:
        _find_chord(fields, packet)


@inlined
def straight_mm(fields: Any, packet: Any) -> float:
    """Return the length of a packet's chord, mm; inf if nothing bends its ray.

    Parameters
    ----------
    fields : BendingFields or None
    packet : BENT
        After `next_chord`.
    """
    if fields is None:
        return np.inf
    return packet.chord[LENGTH]


@inlined
def bends_before(fields: Any, packet: Any, t: float) -> bool:
    """Tell whether a packet's chord ends before a hit; a face that lies on its end, to rounding, is met.

    Parameters
    ----------
    fields : BendingFields or None
    packet : BENT
        After `next_chord`.
    t : float, mm
        Distance of the hit; inf if there is none.
    """
    if fields is None:
        return False
    straight = packet.chord[LENGTH]
    return straight + CONTACT * (abs(packet.x) + abs(packet.y) + abs(packet.z) + straight) < t


@inlined
def is_in_field(fields: Any, packet: Any) -> bool:
    """Tell whether a packet starts in a field; `fields` : BendingFields or None."""
    if fields is None:
        return False
    return packet.chord[STATE] > 0.0


@inlined
def squared_index_ratio(fields: Any, packet: Any, x: float, y: float, z: float) -> float:
    """Return n² at a point of a packet's chord over that outside the fields.

    Parameters
    ----------
    fields : BendingFields or None
    packet : BENT
    x, y, z : float, mm
        In the object frame.
    """
    if fields is None:
        return 1.0
    return _squared_ratio(fields, packet.colour, packet.chord[STATE], x, y, z)


@kernel
def _squared_ratio(fields: BendingFields, colour: int, state: float, x: float, y: float, z: float) -> float:
    if state <= 0.0:
        return 1.0
    field = int(state) - 1
    px, py, pz = point_through(fields.to_own[field], x, y, z)
    n2, _, _, _ = bending_at(fields, field * fields.wavelengths + colour, px, py, pz)
    return n2 / (fields.around[colour] * fields.around[colour])


@inlined
def squared_index_at(fields: Any, colour: int, x: float, y: float, z: float) -> float:
    """Return n² at a point of the object frame over that outside the fields.

    Parameters
    ----------
    fields : BendingFields or None
    colour : int
        Number of the wavelength.
    x, y, z : float, mm
    """
    if fields is None:
        return 1.0
    return _squared_ratio(fields, colour, field_round(fields, x, y, z), x, y, z)


@inlined
def squared_index_of_emission(fields: Any, packet: Any) -> float:
    """Return n² on a packet's chord over that outside the fields, for media that emit a given radiance; else 1.

    Radiance over n² is conserved. That of a body with a temperature is proportional to n², and so needs no factor.

    Parameters
    ----------
    fields : BendingFields or None
    packet : BENT
    """
    if fields is None:
        return 1.0
    if not fields.emit_radiance or packet.chord[STATE] <= 0.0:
        return 1.0
    half = 0.5 * packet.chord[LENGTH]
    x, y, z = packet.x + half * packet.dx, packet.y + half * packet.dy, packet.z + half * packet.dz
    return _squared_ratio(fields, packet.colour, packet.chord[STATE], x, y, z)


@kernel
def field_round(fields: BendingFields, x: float, y: float, z: float) -> float:
    """Return the state of a packet at a point of the object frame: OUTSIDE, or k + 1 in field k.

    Parameters
    ----------
    fields : BendingFields
    x, y, z : float, mm
    """
    for field in range(len(fields.free)):
        box = fields.fields.rows[field * fields.wavelengths]
        px, py, pz = point_through(fields.to_own[field], x, y, z)
        if (
            box.low[0] < px < box.high[0] and box.low[1] < py < box.high[1] and box.low[2] < pz < box.high[2]
        ):  # fmt: skip
            return field + 1.0
    return OUTSIDE


@kernel
def _find_chord(fields: BendingFields, packet: Any) -> None:
    """Find the chord of a packet; see `next_chord`."""
    if packet.bodies >= 0:
        # Bodies of glass do not reach into fields.
        packet.chord[STATE], packet.chord[LENGTH] = OUTSIDE, np.inf
        return
    if packet.chord[STATE] == UNKNOWN:
        packet.chord[STATE] = field_round(fields, packet.x, packet.y, packet.z)
        packet.chord[OPTICAL], packet.chord[PLANE], packet.chord[CHORDS] = 0.0, NO_PLANE, 0.0
    if packet.chord[STATE] <= OUTSIDE:
        _towards_fields(fields, packet)
    elif packet.kind == SHADOW:
        # No straight line leads out of a field.
        packet.chord[LENGTH] = _grain(packet)
    else:
        _within_field(fields, packet)


@inlined
def _grain(packet: Any) -> float:
    """Return the rounding of a packet's position, mm, above 0."""
    return GRAIN * (abs(packet.x) + abs(packet.y) + abs(packet.z)) + SMALLEST


@inlined
def _slab(low: float, high: float, p: float, d: float) -> tuple[float, float]:
    """Return the distances at which a ray enters and leaves the slab between two planes."""
    if d == 0.0:
        return (-np.inf, np.inf) if low < p < high else (np.inf, -np.inf)
    a, b = (low - p) / d, (high - p) / d
    return min(a, b), max(a, b)


@inlined
def _entry(box: Any, at: Vector, along: Vector) -> tuple[float, int]:
    """Return the distance of the face by which a ray from outside enters a box, and its axis; inf if it misses."""
    begin_x, end_x = _slab(box.low[0], box.high[0], at[0], along[0])
    begin_y, end_y = _slab(box.low[1], box.high[1], at[1], along[1])
    begin_z, end_z = _slab(box.low[2], box.high[2], at[2], along[2])
    begin, end = max(begin_x, begin_y, begin_z), min(end_x, end_y, end_z)
    if begin < end and end > 0.0:
        return begin, 2 if begin == begin_z else (0 if begin == begin_x else 1)
    return np.inf, 0


@kernel
def _towards_fields(fields: BendingFields, packet: Any) -> None:
    """Find the chord of a packet outside all fields: up to the first field that its ray enters."""
    behind = int(OUTSIDE - packet.chord[STATE]) - 1
    nearest, met, axis = np.inf, -1, 0
    for field in range(len(fields.free)):
        if field == behind:
            continue
        own = fields.to_own[field]
        at = point_through(own, packet.x, packet.y, packet.z)
        along = direction_through(own, packet.dx, packet.dy, packet.dz)
        t, face_axis = _entry(fields.fields.rows[field * fields.wavelengths], at, along)
        if t < nearest:
            nearest, met, axis = t, field, face_axis
    if met < 0:
        packet.chord[LENGTH] = np.inf
        return
    length = max(nearest, _grain(packet))
    packet.chord[LENGTH] = length
    number, own = met * fields.wavelengths + packet.colour, fields.to_own[met]
    x, y, z = point_through(own, packet.x, packet.y, packet.z)
    dx, dy, dz = direction_through(own, packet.dx, packet.dy, packet.dz)
    x, y, z = _in_box(fields.fields.rows[number], x + length * dx, y + length * dy, z + length * dz)
    n2, _, _, _ = bending_at(fields, number, x, y, z)
    around = fields.around[packet.colour]
    tx, ty, tz, passes = _through_face(axis, around * dx, around * dy, around * dz, n2 - around * around)
    state = met + 1.0 if passes else OUTSIDE - (met + 1.0)
    _set_end(fields, packet, met, (tx, ty, tz), state, REFRACTED_AT_FACE if passes else REFLECTED_AT_FACE)
    packet.chord[OPTICAL], packet.chord[PLANE], packet.chord[CHORDS] = np.sqrt(n2), NO_PLANE, 0.0


@inlined
def _in_box(box: Any, x: float, y: float, z: float) -> Vector:
    """Return the nearest point of a box."""
    return (
        min(max(x, box.low[0]), box.high[0]),
        min(max(y, box.low[1]), box.high[1]),
        min(max(z, box.low[2]), box.high[2]),
    )


@inlined
def _through_face(
    axis: int, tx: float, ty: float, tz: float, rise: float
) -> tuple[float, float, float, bool]:  # fmt: skip
    """Return an optical ray vector behind a plane face, by Snell's law, and if it passes the face.

    The change of n², not n² itself, keeps the digits of grazing rays.

    Parameters
    ----------
    axis : int
        Axis normal to the face.
    tx, ty, tz : float
        Optical ray vector before the face.
    rise : float
        n² behind the face less n² before it.
    """
    along = tz if axis == 2 else (tx if axis == 0 else ty)
    squared = along * along + rise
    passes = squared > 0.0
    changed = np.copysign(np.sqrt(squared), along) if passes else -along
    return (
        changed if axis == 0 else tx,
        changed if axis == 1 else ty,
        changed if axis == 2 else tz,
        passes,
    )


@inlined
def _set_end(fields: BendingFields, packet: Any, field: int, t: Vector, state: float, event: float) -> None:
    """Set the optical ray vector, from a field's own frame, the state and the event at the end of a chord."""
    tx, ty, tz = direction_through(fields.from_own[field], t[0], t[1], t[2])
    packet.chord[END_TX], packet.chord[END_TY], packet.chord[END_TZ] = tx, ty, tz
    packet.chord[END_STATE], packet.chord[EVENT_AT_END] = state, event


@inlined
def _at_node(fields: BendingFields, packet: Any, field: int) -> FieldRay:
    """Return the ray of a packet at a node in a field, in the field's own frame."""
    number, own = field * fields.wavelengths + packet.colour, fields.to_own[field]
    x, y, z = point_through(own, packet.x, packet.y, packet.z)
    x, y, z = _in_box(fields.fields.rows[number], x, y, z)
    dx, dy, dz = direction_through(own, packet.dx, packet.dy, packet.dz)
    n2, kick_x, kick_y, kick_z = bending_at(fields, number, x, y, z)
    optical = packet.chord[OPTICAL]
    if optical == 0.0:
        optical = np.sqrt(n2)
    ray = GradientRay(x, y, z, optical * dx, optical * dy, optical * dz, 0.0, 0.0)
    plane = int(packet.chord[PLANE])
    if plane < 0:
        return enter(fields, fields.fields.rows, number, ray)
    return FieldRay(ray, n2, kick_x, kick_y, kick_z, plane % 3, plane // 3, INSIDE)


@kernel
def _within_field(fields: BendingFields, packet: Any) -> None:
    """Find the chord of a packet in a field: one step, or up to the face."""
    field = int(packet.chord[STATE]) - 1
    number = field * fields.wavelengths + packet.colour
    box = fields.fields.rows[number]
    at = _at_node(fields, packet, field)
    x, y, z = at.ray.x, at.ray.y, at.ray.z
    longest = max(box.high[0] - box.low[0], box.high[1] - box.low[1], box.high[2] - box.low[2])
    ex, ey, ez, length = 0.0, 0.0, 0.0, 0.0
    for _ in range(MOST_JOINED):
        at = advance(fields, fields.fields.rows, number, at)
        ex, ey, ez = at.ray.x - x, at.ray.y - y, at.ray.z - z
        length = np.sqrt(ex * ex + ey * ey + ez * ez)
        if at.face != INSIDE or length > SHORT * longest:
            break
    packet.chord[LENGTH] = max(length, _grain(packet))
    packet.chord[CHORDS] += 1.0
    if length > 0.0:
        per = 1.0 / length
        dx, dy, dz = direction_through(fields.from_own[field], per * ex, per * ey, per * ez)
        packet.dx, packet.dy, packet.dz = dx, dy, dz
    _leave(fields, packet, field, at)


@inlined
def _leave(fields: BendingFields, packet: Any, field: int, at: FieldRay) -> None:
    """Set the end of a chord at a node in a field, or behind the face that the node lies on."""
    ray = at.ray
    if at.face == INSIDE:
        _set_end(fields, packet, field, (ray.tx, ray.ty, ray.tz), field + 1.0, NO_EVENT)
        packet.chord[OPTICAL] = np.sqrt(ray.tx * ray.tx + ray.ty * ray.ty + ray.tz * ray.tz)
        packet.chord[PLANE] = 3.0 * at.slab + at.axis
        return
    around = fields.around[packet.colour]
    # The vector has the length of the index but for the error of the integration.
    scale = np.sqrt(at.n2 / (ray.tx * ray.tx + ray.ty * ray.ty + ray.tz * ray.tz))
    rise = around * around - at.n2
    tx, ty, tz, passes = _through_face(at.face >> 1, scale * ray.tx, scale * ray.ty, scale * ray.tz, rise)
    state = OUTSIDE - (field + 1.0) if passes else field + 1.0
    _set_end(fields, packet, field, (tx, ty, tz), state, REFRACTED_AT_FACE if passes else REFLECTED_AT_FACE)
    packet.chord[OPTICAL], packet.chord[PLANE] = 0.0, NO_PLANE


@kernel
def leap_to_face(fields: BendingFields, packet: Any) -> None:
    """Move a packet in a field to the face where it leaves, past all nodes, for a field in which nothing stands.

    Parameters
    ----------
    fields : BendingFields
    packet : BENT
        At a node. Afterwards its chord has no length, and its end is behind the face, or in the field if it is trapped.
    """
    field = int(packet.chord[STATE]) - 1
    number = field * fields.wavelengths + packet.colour
    at = _at_node(fields, packet, field)
    count = packet.chord[CHORDS]
    while at.face == INSIDE and count <= MOST_CHORDS:
        at = advance(fields, fields.fields.rows, number, at)
        count += 1.0
    packet.x, packet.y, packet.z = point_through(fields.from_own[field], at.ray.x, at.ray.y, at.ray.z)
    packet.chord[LENGTH], packet.chord[CHORDS] = 0.0, count
    _leave(fields, packet, field, at)
