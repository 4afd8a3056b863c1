"""Packets at glass in object space: refracted, reflected, or scattered by rough glass."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.frame import move_direction, move_point
from lfmesh.geometry.meshes.levels import PATCH
from lfmesh.geometry.ray import Ray
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.aims.mixture import aimed_straight
from lfmesh.transport.events.bodies import RANK, TOO_MANY, beyond_facet, bodies_round, is_in, medium_of, set_bodies
from lfmesh.transport.events.crossing import AIM_DISK, AIM_U, AIM_V, draw, lose, reflected, refracted, requery
from lfmesh.transport.events.facets import clear_of, facet_normal, meets_patch, nearest_on_facet, next_query_from
from lfmesh.transport.events.interface import (
    divided,
    is_coated,
    is_rough,
    scattered,
    scattered_density,
    scatterer,
    splitter,
)
from lfmesh.transport.events.object_space import ObjectSpace
from lfmesh.transport.events.polarisation import IN_OBJECTS, shares_by_state
from lfmesh.transport.events.travel import arrive
from lfmesh.transport.lights.lamps import sample as sample_lamp
from lfmesh.transport.lights.many_lamps import NO_NORMAL, lamps_to_ask
from lfmesh.transport.lights.shadow import send
from lfmesh.transport.packets.book import LOST_CONTRADICTION, SAMPLING_ADDED, SAMPLING_REMOVED
from lfmesh.transport.packets.children import AIMED_CHILD
from lfmesh.transport.packets.packet import (
    CAMERA,
    CAMERA_FRAME,
    LAMP,
    NO_SURFACE,
    OBJECT_FRAME,
    OBJECTS,
    ON_GLASS,
    SCATTERED,
    SPECULAR,
    Flow,
    Options,
    put,
)
from lfmesh.transport.packets.random import derived
from lfmesh.transport.paths.automaton import counts
from lfmesh.transport.tables.tables import AIR, Interfaces, ObjectTables, body_row

Array = NDArray[np.float64]
Curved = tuple[int, float, float, float, float]


class RoughFace(NamedTuple):
    """Point at which a packet meets a rough facet of glass.

    Attributes
    ----------
    prim : int
        Facet.
    inside, after : int
        Bodies before and behind the facet.
    beyond : int
        Medium behind the facet.
    number : int
        Row of the interface in its table.
    x, y, z : float, mm
    nx, ny, nz : float
        Unit normal along the ray.
    n_i, n_t : float
        Refractive index before and behind the facet.
    """

    prim: int
    inside: int
    after: int
    beyond: int
    number: int
    x: float
    y: float
    z: float
    nx: float
    ny: float
    nz: float
    n_i: float
    n_t: float


@inlined
def _send_from_glass(
    place: Any, options: Options, flow: Flow, frames: Array, packet: Any, refracts: bool,
    x: float, y: float, z: float, dx: float, dy: float, dz: float, weight: float, key: np.uint64,
) -> None:  # fmt: skip
    """Queue a child of a packet at a facet of glass, with the bodies on the child's side."""
    objects, prim, inside, after = place
    set_bodies(packet, after if refracts else inside)
    clear = clear_of(objects.facets[prim], x, y, z, dx, dy, dz)
    put(flow, OBJECTS, packet, OBJECT_FRAME, x, y, z, dx, dy, dz, weight, key, clear)


_split_at_glass = splitter(_send_from_glass)
_send_from_rough_glass = scatterer(_send_from_glass)


@kernel
def through_glass(glass: Any, space: ObjectSpace, packet: Any, prim: int, t: float, curved: Curved) -> None:
    """Split a packet at a facet of a glass body, at distance t, by the media on both sides.

    A facet has no effect between equal indices, or inside another body of a higher rank.

    Parameters
    ----------
    glass : GlassTables or None
        None: there is no glass, and numba compiles only the first line.
    space : ObjectSpace
    packet : PACKET
    prim : int
        Facet.
    t : float, mm
    curved : tuple
        Facet of the curved patch, or round face, that the packet meets exactly, its distance (equal to t) and its
        normal; the facet is −1 if there is none.
    """
    if glass is None:
        return
    options, flow, frames, objects, _ = space
    facet = objects.facets[prim]
    body = facet.body
    dx, dy, dz = packet.dx, packet.dy, packet.dz
    x, y, z = packet.x + t * dx, packet.y + t * dy, packet.z + t * dz
    inside = bodies_round(packet)
    entering = not is_in(inside, objects.rank[body])
    on_patch, is_round = curved[0] >= 0, facet.size == 0.0
    if on_patch and not is_round:
        # Touching bodies share facets: test on the facet, along its normal, which bodies the packet meets.
        fx, fy, fz = nearest_on_facet(facet, x, y, z)
        sense, normal = -1.0 if entering else 1.0, facet.normal
        after = beyond_facet(
            objects, glass, inside, prim, entering,
            Ray(fx, fy, fz, sense * normal[0], sense * normal[1], sense * normal[2]),
        )  # fmt: skip
    else:
        after = beyond_facet(objects, glass, inside, prim, entering, Ray(x, y, z, dx, dy, dz))
    if after == TOO_MANY:
        lose(options, flow, frames, packet, LOST_CONTRADICTION, objects.lost_slot[body])
        return
    beyond = medium_of(objects, after)
    media, own = len(objects.media.indices), objects.medium[body]
    number = body_row(body, beyond if packet.medium == own else packet.medium, media)
    rough = is_rough(glass.interfaces, number)
    level = glass.level[body]
    if on_patch:
        nx, ny, nz = curved[2], curved[3], curved[4]
    elif level == PATCH:
        met, more, nx, ny, nz = meets_patch(flow, glass.patches, glass.across, facet, prim, Ray(x, y, z, dx, dy, dz))
        if rough:
            # A ray scattered along a curved patch would run between it and the facets, and no query would find its
            # exit. It starts on the facet instead, with the normal of the patch.
            more = 0.0
        elif met and t + more <= 0.0:
            further = next_query_from(facet, packet, t)
            requery(options, flow, frames, OBJECTS, packet, further, False, objects.lost_slot[body])
            return
        x, y, z = x + more * dx, y + more * dy, z + more * dz
    else:
        nx, ny, nz = facet_normal(level, facet, x, y, z)
    cos_i = nx * dx + ny * dy + nz * dz
    if (cos_i < 0.0) != entering and not is_round:
        # An interpolated normal may point against a grazing ray; the facet's normal then replaces it. A round face's
        # normal, perpendicular to the ray, may do so by rounding.
        normal = facet.normal
        nx, ny, nz = normal[0], normal[1], normal[2]
        cos_i = nx * dx + ny * dy + nz * dz
    if cos_i < 0.0:
        nx, ny, nz, cos_i = -nx, -ny, -nz, -cos_i
    cos_i = min(cos_i, 1.0)
    n_i, n_t = objects.media.indices[packet.medium, packet.colour], objects.media.indices[beyond, packet.colour]
    x, y, z = arrive(flow, objects.media, packet, packet.medium, x, y, z)
    # A coating between equal indices counts, unless a body of a higher rank covers it.
    uncovered = (after if entering else inside) & RANK == objects.rank[body]
    if n_i == n_t and inside != 0 and after != 0 and not (uncovered and is_coated(glass.interfaces, number)):
        packet.medium, packet.facet = beyond, NO_SURFACE
        if packet.kind == CAMERA and not (options.adjoint or options.tracing):
            # Its share is settled: it no longer is the child that rough glass aims through air.
            packet.kind = SPECULAR
        set_bodies(packet, after)
        clear = clear_of(facet, x, y, z, dx, dy, dz)
        put(flow, OBJECTS, packet, OBJECT_FRAME, x, y, z, dx, dy, dz, packet.weight, packet.key, clear)
        return
    if rough:
        face = RoughFace(prim, inside, after, beyond, number, x, y, z, nx, ny, nz, n_i, n_t)
        _through_rough_glass(glass.interfaces, space, packet, face)
        return
    reflectance, transmittance, cos_t = divided(
        glass.interfaces, number, packet.colour, n_i, n_t, cos_i, not entering, packet, flow.book
    )
    reflectance, transmittance = shares_by_state(
        flow.polarised, IN_OBJECTS, number, not entering, n_i, n_t, cos_i, (nx, ny, nz), frames, OBJECT_FRAME, packet,
        flow.book, reflectance, transmittance,
    )  # fmt: skip
    packet.facet = NO_SURFACE
    packet.last = NO_SURFACE
    if packet.kind != LAMP:
        packet.kind = SPECULAR
    _split_at_glass(
        (objects, prim, inside, after), options, flow, frames, OBJECT_FRAME, packet, ON_GLASS, body, beyond,
        x, y, z, reflectance, transmittance,
        reflected(dx, dy, dz, nx, ny, nz), refracted(dx, dy, dz, nx, ny, nz, n_i / n_t, cos_i, cos_t),
    )  # fmt: skip


@kernel
def _through_rough_glass(interfaces: Interfaces, space: ObjectSpace, packet: Any, face: RoughFace) -> None:
    """Gather light at a rough facet of glass, and scatter the packet on with its whole weight.

    As on a target, the adjoint method samples lamps. The forward method sends a child aimed at the entrance pupil,
    which counts if it goes straight there; the other child counts if it does not.
    """
    options, flow, frames, objects, _ = space
    packet.facet, packet.last = NO_SURFACE, NO_SURFACE
    if packet.kind == LAMP and not counts(options, packet):
        # Its path belongs to another class, estimated from the sensor.
        flow.book[SAMPLING_REMOVED] += packet.weight
        return
    if options.adjoint and counts(options, packet):
        _ask_lamps_at_glass(interfaces, space, packet, face)
    passes, dx, dy, dz = scattered(
        interfaces, face.number, options, packet, face.n_i, face.n_t, (face.nx, face.ny, face.nz)
    )
    fx, fy, fz = _along_facet(objects.facets[face.prim], face)
    if (fx * dx + fy * dy + fz * dz > 0.0) != passes:
        # A patch or interpolated normal differs from the facet's, which separates the media.
        dx, dy, dz = reflected(dx, dy, dz, fx, fy, fz)
    packet.kind = SPECULAR
    if options.aimed and not options.adjoint and not options.tracing:
        _aim_from_glass(interfaces, space, packet, face)
        packet.kind = SCATTERED
    _send_from_rough_glass(
        (objects, face.prim, face.inside, face.after), options, flow, frames, OBJECT_FRAME, packet, ON_GLASS,
        objects.facets[face.prim].body, face.beyond, face.x, face.y, face.z, passes, dx, dy, dz,
    )  # fmt: skip


@inlined
def _along_facet(facet: Any, face: RoughFace) -> tuple[float, float, float]:
    """Return a facet's normal, oriented like its surface's; for a round face, the surface normal."""
    if facet.size == 0.0:
        return face.nx, face.ny, face.nz
    normal = facet.normal
    sense = 1.0 if normal[0] * face.nx + normal[1] * face.ny + normal[2] * face.nz > 0.0 else -1.0
    return sense * normal[0], sense * normal[1], sense * normal[2]


@kernel
def _ask_lamps_at_glass(interfaces: Interfaces, space: ObjectSpace, packet: Any, face: RoughFace) -> None:
    """Send shadow packets to lamps that a rough facet of glass sees through air, on either side."""
    objects, x, y, z, asked = space.objects, face.x, face.y, face.z, space.flow.asked
    moving = space.flow.moving
    for k in range(lamps_to_ask(space.options, objects.lamps, packet, (x, y, z), NO_NORMAL, asked, moving)):
        lamp = asked[k].lamp
        way = sample_lamp(space.options, objects, packet, lamp, (x, y, z), False, moving)
        ux, uy, uz = way.ray.dx, way.ray.dy, way.ray.dz
        if way.value <= 0.0:
            continue
        density = _density_into_air(interfaces, objects, packet, face, (ux, uy, uz), lamp)
        if density > 0.0:
            clear = clear_of(objects.facets[face.prim], x, y, z, ux, uy, uz)
            weight = packet.weight * way.value * density * asked[k].share
            shadow = send(space.flow, packet, way, weight, packet.key, clear)
            shadow.facet, shadow.medium = face.prim, AIR
            set_bodies(shadow, 0)


@kernel
def _aim_from_glass(interfaces: Interfaces, space: ObjectSpace, packet: Any, face: RoughFace) -> None:
    """Queue a child aimed at the entrance pupil, if the rough facet of glass sees it through air."""
    flow, objects, aim, x, y, z = space.flow, space.objects, space.aim, face.x, face.y, face.z
    px, py, pz = move_point(space.frames, OBJECT_FRAME, CAMERA_FRAME, x, y, z)
    numbers = draw(packet, AIM_DISK), draw(packet, AIM_U), draw(packet, AIM_V)
    ax, ay, az, at_lens = aimed_straight(aim, (px, py, pz), numbers)
    if at_lens <= 0.0:
        return
    ux, uy, uz = move_direction(space.frames, CAMERA_FRAME, OBJECT_FRAME, ax, ay, az)
    density = _density_into_air(interfaces, objects, packet, face, (ux, uy, uz), 0)
    if density > 0.0:
        weight = packet.weight * density / at_lens
        flow.book[SAMPLING_ADDED] += weight
        key = derived(packet.key, AIMED_CHILD + packet.events)
        clear = clear_of(objects.facets[face.prim], x, y, z, ux, uy, uz)
        child = put(flow, OBJECTS, packet, OBJECT_FRAME, x, y, z, ux, uy, uz, weight, key, clear)
        child.kind, child.start, child.medium = CAMERA, weight, AIR
        set_bodies(child, 0)


@kernel
def _density_into_air(
    interfaces: Interfaces, objects: ObjectTables, packet: Any, face: RoughFace, direction: tuple[float, float, float],
    lamp: int,
) -> float:  # fmt: skip
    """Return the density, 1/sr, of scattering by a rough facet into a direction; 0 if that is not in air.

    For `lamp`, see `scattered_density`.
    """
    ux, uy, uz = direction
    nx, ny, nz = face.nx, face.ny, face.nz
    fx, fy, fz = _along_facet(objects.facets[face.prim], face)
    passes = fx * ux + fy * uy + fz * uz > 0.0
    if (face.after if passes else face.inside) != 0:
        return 0.0
    density = 0.0
    # The facet also sends the direction's mirror image this way, if the image lies on the other side of the facet.
    for vx, vy, vz in ((ux, uy, uz), reflected(ux, uy, uz, fx, fy, fz)):
        if (nx * vx + ny * vy + nz * vz > 0.0) == passes:
            density += scattered_density(
                interfaces, face.number, packet, (face.n_i, face.n_t), (nx, ny, nz), (vx, vy, vz), lamp
            )
    return density
