"""Packets at the ends of their chords, where media bend light: see `events.bending`."""

from typing import Any

import numpy as np

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.index_field_path import MOST_CHORDS
from lfmesh.transport.events.bending import is_in_field, leap_to_face, next_chord
from lfmesh.transport.events.crossing import end_here, record, too_deep
from lfmesh.transport.events.facets import FLOAT32_GRAIN
from lfmesh.transport.events.object_space import ObjectSpace
from lfmesh.transport.events.travel import travel
from lfmesh.transport.packets.book import SAMPLING_REMOVED
from lfmesh.transport.packets.children import IN_BENDING
from lfmesh.transport.packets.packet import (
    CAMERA,
    CHORDS,
    E_BENT,
    E_REFLECTED,
    E_TRANSMITTED,
    END_STATE,
    END_TX,
    END_TY,
    END_TZ,
    EVENT_AT_END,
    EVENTS,
    IN_FIELD,
    LAMP,
    LEFT_LENS,
    LEFT_MEDIUM,
    LENGTH,
    NO_EVENT,
    NO_SURFACE,
    OBJECT_FRAME,
    OBJECTS,
    OUTSIDE,
    REFLECTED_AT_FACE,
    S_ABSORBED,
    SCATTERED,
    SHARE,
    SPECULAR,
    STATE,
    Flow,
    Options,
    count_event,
    keep_chord,
    put,
)
from lfmesh.transport.packets.random import derived
from lfmesh.transport.paths.automaton import AT_GLASS
from lfmesh.transport.regions.targets import share_with_other
from lfmesh.transport.regions.volumes import cross_media
from lfmesh.transport.tables.bending_fields import BendingFields


@inlined
def begin_in_field(fields: Any, options: Options, packet: Any) -> None:
    """Let a packet that starts in a field count for the light that no shadow packet asks there.

    Parameters
    ----------
    fields : BendingFields or None
        None: nothing bends light, and numba compiles only the first line.
    options : Options
    packet : BENT
    """
    if fields is None:
        return
    if is_in_field(fields, packet):
        packet.path = AT_GLASS[packet.path]
        if options.adjoint and packet.kind == SCATTERED:
            packet.kind = SPECULAR


@kernel
def to_chord_end(fields: Any, space: ObjectSpace, packet: Any) -> None:
    """Move a packet to the end of its chord, through a field in which nothing stands to its face, and queue it there.

    Parameters
    ----------
    fields : BendingFields or None
        None: nothing bends light, and numba compiles only the first line.
    space : ObjectSpace
    packet : BENT
        With a chord that ends before its next hit.
    """
    if fields is None:
        return
    flow = space.flow
    if _is_stopped_on_chord(fields, space, packet):
        return
    while _may_go_on(fields, space, packet):
        if fields.alone:
            leap_to_face(fields, packet)
        else:
            next_chord(fields, packet)
        if _is_stopped_on_chord(fields, space, packet):
            return
    x, y, z, dx, dy, dz = packet.x, packet.y, packet.z, packet.dx, packet.dy, packet.dz
    child = put(flow, OBJECTS, packet, OBJECT_FRAME, x, y, z, dx, dy, dz, packet.weight, packet.key, 0.0)
    # The number of chords is limited instead.
    child.moves = packet.moves
    # In float32 a start just in front of a face may lie behind it.
    child.query_from = -FLOAT32_GRAIN * (abs(x) + abs(y) + abs(z) + space.objects.radius)
    keep_chord(fields, packet, child)


@inlined
def _may_go_on(fields: BendingFields, space: ObjectSpace, packet: Any) -> bool:
    """Tell whether a packet can cross the rest of a field without a query, a child or a vertex on its way."""
    options = space.options
    if packet.chord[STATE] <= 0.0 or packet.chord[EVENT_AT_END] == REFLECTED_AT_FACE:
        return False
    if (options.record and fields.curves) or _scatters(space.objects.volumes):
        return False
    return bool(fields.free[int(packet.chord[STATE]) - 1])


@inlined
def _scatters(volumes: Any) -> bool:
    """Tell whether media scatter light; `volumes` : Volumes or None."""
    if volumes is None:
        return False
    return volumes.scatters


@kernel
def _is_stopped_on_chord(fields: BendingFields, space: ObjectSpace, packet: Any) -> bool:
    """Move a packet to the end of its chord, with the direction there; tell whether it ends on the way."""
    options, flow, frames, objects, _ = space
    if _is_absorbed(objects.volumes, space, packet):
        return True
    event = packet.chord[EVENT_AT_END]
    if packet.chord[CHORDS] > MOST_CHORDS:
        end_here(options, flow, frames, packet, fields.slot[int(packet.chord[STATE]) - 1], S_ABSORBED)
        return True
    if event != NO_EVENT and too_deep(options, flow, frames, packet):
        return True
    aims = packet.last != LEFT_LENS and not (options.adjoint or options.tracing)
    if aims and packet.kind == CAMERA and packet.facet == NO_SURFACE:
        # Aimed from rough glass: light that does not go straight to the lens belongs to the other child.
        flow.book[SAMPLING_REMOVED] += packet.weight
        return True
    has_twin = aims and options.bounce and options.aimed and packet.facet != NO_SURFACE
    has_twin = has_twin and (packet.kind == CAMERA or packet.kind == SCATTERED)
    if has_twin and packet.chord[SHARE] == 0.0:
        _set_share(space, packet)
    packet.x, packet.y, packet.z = travel(flow, objects.media, packet, packet.medium, packet.chord[LENGTH])
    tx, ty, tz = packet.chord[END_TX], packet.chord[END_TY], packet.chord[END_TZ]
    per = 1.0 / np.sqrt(tx * tx + ty * ty + tz * tz)
    packet.dx, packet.dy, packet.dz = per * tx, per * ty, per * tz
    before, after = packet.chord[STATE], packet.chord[END_STATE]
    packet.chord[LENGTH], packet.chord[STATE] = 0.0, after
    packet.facet, packet.last = LEFT_MEDIUM if has_twin else NO_SURFACE, NO_SURFACE
    if packet.kind != LAMP and not has_twin:
        packet.kind = SPECULAR
    if event == NO_EVENT:
        # Each chord has random numbers of its own.
        packet.key = derived(packet.key, IN_BENDING + packet.events)
    else:
        packet.path = AT_GLASS[packet.path]
        flow.counts[EVENTS] += 1
        count_event(packet)
    if options.record and (event != NO_EVENT or fields.curves):
        inside = max(before, after)
        field = int(inside) - 1 if inside > 0.0 else int(OUTSIDE - after) - 1
        kind = E_REFLECTED if event == REFLECTED_AT_FACE else (E_TRANSMITTED if event != NO_EVENT else E_BENT)
        packet.node = record(
            flow, frames, OBJECT_FRAME, packet.x, packet.y, packet.z, packet.weight, IN_FIELD, fields.medium[field],
            kind, packet.node,
        )  # fmt: skip
    return False


@inlined
def _is_absorbed(volumes: Any, space: ObjectSpace, packet: Any) -> bool:
    """Let a packet pass the media along its chord; tell whether none of its light is left.

    `volumes` is None without media; numba then compiles only the first line.
    """
    if volumes is None:
        return False
    cross_media(space, packet, packet.chord[LENGTH])
    if packet.weight > 0.0:
        return False
    end_here(space.options, space.flow, space.frames, packet, volumes.rows[0].slot, S_ABSORBED)
    return True


@inlined
def _set_share(space: ObjectSpace, packet: Any) -> None:
    """Weight an aimed packet beside its scattered twin, and note the share of a scattered one for `take_share`.

    A scattered packet also lights targets and media behind the first chord, with its whole weight. Its aimed twin does
    not, so that packets do not multiply from point to point of a medium.
    """
    book, weight = space.flow.book, packet.weight
    share_with_other(space.flow, space.frames, space.aim, packet)
    if packet.kind == CAMERA:
        packet.chord[SHARE] = 1.0
        return
    packet.chord[SHARE] = packet.weight / weight
    book[SAMPLING_REMOVED] -= weight - packet.weight
    packet.weight = weight


@inlined
def is_shared(fields: Any, packet: Any) -> bool:
    """Tell whether a packet shares light with a twin, through a field; `fields` : BendingFields or None."""
    if fields is None:
        return False
    return packet.chord[SHARE] > 0.0


@inlined
def take_share(fields: Any, flow: Flow, packet: Any) -> None:
    """Reduce a scattered packet from a field to its share beside its aimed twin, where both count: at lens or glass.

    Parameters
    ----------
    fields : BendingFields or None
        None: nothing bends light, and numba compiles only the first line.
    flow : Flow
    packet : BENT
    """
    if fields is None:
        return
    if packet.kind == SCATTERED and packet.chord[SHARE] > 0.0:
        lost = packet.weight * (1.0 - packet.chord[SHARE])
        packet.weight -= lost
        flow.book[SAMPLING_REMOVED] += lost
        packet.kind = SPECULAR
