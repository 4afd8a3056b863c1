"""Packets on targets: they gather light and are scattered, towards the camera and to other targets.

In the adjoint method a packet on a target gathers the light that leaves the point towards it: emission, and scattered
light by next-event estimation. In the forward method it sends a child aimed at the entrance pupil. In both it may be
scattered to other targets. Scattering follows the target's model (`events/scattering.py`).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.frame import move_direction, move_point
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.aiming.through_glass import aimed_density_from, aimed_from
from lfmesh.transport.events.crossing import (
    AIM_DISK,
    AIM_U,
    AIM_V,
    BOUNCE_U,
    KEEP_BOUNCE,
    PASS,
    barycentric,
    clear_of,
    deposit,
    draw,
    draw_two,
    end,
    record,
    thinned,
    windowed,
)
from lfmesh.transport.events.emission import asks_emitters, share_by_chance
from lfmesh.transport.events.glow import asks_media
from lfmesh.transport.events.halo import asks_halos
from lfmesh.transport.events.lighting import ask_lights
from lfmesh.transport.events.polarisation import depolarise
from lfmesh.transport.events.scattering import Point, albedo, density, emissivity, evaluate, sample
from lfmesh.transport.packets.book import ESCAPED, LIT, REACHED, SAMPLING_ADDED, SAMPLING_REMOVED
from lfmesh.transport.packets.packet import (
    CAMERA,
    CAMERA_FRAME,
    E_SCATTERED,
    EMITTERS,
    EVENTS,
    LEFT_LENS,
    NO_SURFACE,
    OBJECT_FRAME,
    OBJECTS,
    ON_TARGET,
    S_ABSORBED,
    SCATTERED,
    Flow,
    Options,
    count_event,
    put,
)
from lfmesh.transport.packets.random import DIMENSIONS_PER_EVENT, derived, uniform
from lfmesh.transport.paths.automaton import counts, counts_not_yet
from lfmesh.transport.tables.scattering import THERMAL
from lfmesh.transport.tables.tables import AIR, BY_ALPHA, AimTables, ObjectTables

Array = NDArray[np.float64]

FACETS = 1 << 32
"""Number of the first facet's random numbers among those that a packet's key has for its children."""

KINDS = 8
"""More than there are kinds of packets."""

EMITTED = 1 << 24
"""Number of the random numbers of emission, among those that a packet's key has for its children."""

AIMED_CHILD = 1 << 20
"""Number of the aimed child among a packet's children, larger than any number of events."""


@inlined
def meet_target(
    options: Options, flow: Flow, frames: Array, objects: ObjectTables, aim: AimTables, packet: Any,
    prim: int, x: float, y: float, z: float, along: float,
) -> None:  # fmt: skip
    """Gather light and scatter at a point of a target.

    Parameters
    ----------
    prim : int
        Facet.
    x, y, z : float, mm
        Point, object frame.
    along : float
        The facet's normal · the packet's direction.
    """
    body = objects.facets[prim].body
    slot = objects.target_slot[body]
    dx, dy, dz, weight = packet.dx, packet.dy, packet.dz, packet.weight
    flow.counts[EVENTS] += 1
    if objects.one_sided[body] and along > 0.0:
        end(options, flow, frames, packet, OBJECT_FRAME, x, y, z, dx, dy, dz, weight, slot, S_ABSORBED)
        return
    if counts_not_yet(options, packet):
        # It gathers nothing here, and only few such packets continue: roulette comes before the work of scattering.
        weight = thinned(options.unturned_cutoff, flow.book, packet, weight, packet.key)
        if weight == 0.0:
            return
        packet.weight = weight
    texel = texture_at(objects, prim, packet.colour, x, y, z)
    side = -1.0 if along > 0.0 else 1.0
    point = point_of(objects, prim, x, y, z, side, texel, options.adjoint)
    share = albedo(objects.scattering, point, packet.colour, dx, dy, dz)
    if options.adjoint and counts(options, packet):
        _gather(options, flow, objects, packet, point, share > 0.0)
    scattered = weight * share
    if scattered <= 0.0:
        end(options, flow, frames, packet, OBJECT_FRAME, x, y, z, dx, dy, dz, weight, slot, S_ABSORBED)
        return
    flow.book[slot] += weight - scattered
    if packet.last == LEFT_LENS and not options.bounce and not options.adjoint:
        # The lens reflected it back. Without bounces the adjoint method has no such paths, so they are left out here.
        flow.book[ESCAPED] += scattered
        return
    count_event(packet)
    scatter(options, flow, frames, objects, aim, packet, point, weight, scattered)


@inlined
def point_of(
    objects: ObjectTables,
    prim: int,
    x: float,
    y: float,
    z: float,
    side: float,
    texel: float,
    to_light: bool,
) -> Point:
    """Return a point on one side of a facet, with its scattering model.

    Parameters
    ----------
    prim : int
        Facet.
    x, y, z : float, mm
    side : float
        1: the side that the normal points to, −1: the other.
    texel : float
        See `texture_at`.
    to_light : bool
        Whether packets leave it towards the light, as in the adjoint method.
    """
    facet = objects.facets[prim]
    normal = facet.normal
    nx, ny, nz = side * normal[0], side * normal[1], side * normal[2]
    model = objects.model[prim]
    if side < 0.0:
        model = objects.scattering.models[model].behind
    if not objects.smooth[facet.body]:
        return Point(prim, x, y, z, nx, ny, nz, model, texel, False, nx, ny, nz, to_light, 0.0, 0.0)
    sx, sy, sz = _interpolated_normal(facet, side, x, y, z)
    return Point(prim, x, y, z, nx, ny, nz, model, texel, True, sx, sy, sz, to_light, 0.0, 0.0)


@inlined
def emission_of(objects: ObjectTables, point: Point, key: np.uint64) -> Point:
    """Return a point as it emits: with the model of its emission.

    Parameters
    ----------
    objects : ObjectTables
    point : Point
    key : uint64
        Of the packet.
    """
    row = objects.scattering.models[point.model].emission
    smooth = point.smooth and objects.scattering.models[row].kind == THERMAL
    u, v = 0.0, 0.0
    if smooth:
        u, v = uniform(derived(key, EMITTED), 0), uniform(derived(key, EMITTED), 1)
    return Point(
        point.prim, point.x, point.y, point.z, point.nx, point.ny, point.nz, row, point.texel,
        smooth, point.sx, point.sy, point.sz, point.to_light, u, v,
    )  # fmt: skip


@kernel
def _interpolated_normal(facet: Any, side: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return the unit normal between the facet's corners, on one side of it.

    Parameters
    ----------
    facet : FACET
    side : float
        1: the side that its normal points to, −1: the other.
    x, y, z : float, mm
    """
    b, c = barycentric(facet, x, y, z)
    at = facet.corner_normals
    a = 1.0 - b - c
    nx = a * at[0, 0] + b * at[1, 0] + c * at[2, 0]
    ny = a * at[0, 1] + b * at[1, 1] + c * at[2, 1]
    nz = a * at[0, 2] + b * at[1, 2] + c * at[2, 2]
    over = side / np.sqrt(nx * nx + ny * ny + nz * nz)
    return nx * over, ny * over, nz * over


@inlined
def texture_at(objects: ObjectTables, prim: int, colour: int, x: float, y: float, z: float) -> float:
    """Return the value of the texture at a point of a facet (linear light, bilinear, clamped); 1 without a texture.

    Parameters
    ----------
    prim : int
        Facet.
    colour : int
        Number of the wavelength.
    x, y, z : float, mm
    """
    body = objects.facets[prim].body
    height = objects.texture[body, 1]
    if height == 0:
        return 1.0
    first, width = objects.texture[body, 0], objects.texture[body, 2]
    row, column = _place_in_texture(objects, prim, x, y, z)
    left, low = int(np.floor(column)), int(np.floor(row))
    right_share, low_share = column - left, row - low
    # No views of rows: a view counts its references, which costs more than what is read.
    in_bands = len(objects.texel_weights) > 0
    value = 0.0
    for j in range(2):
        for k in range(2):
            r = min(max(low + j, 0), height - 1)
            s = min(max(left + k, 0), width - 1)
            share = (low_share if j else 1.0 - low_share) * (right_share if k else 1.0 - right_share)
            texel = first + r * width + s
            if in_bands:
                for primary in range(objects.texel_weights.shape[1]):
                    value += share * objects.texels[texel, primary] * objects.texel_weights[colour, primary]
            else:
                value += share * objects.texels[texel, colour]
    return value


@inlined
def _place_in_texture(objects: ObjectTables, prim: int, x: float, y: float, z: float) -> tuple[float, float]:
    """Return row and column of a facet's texture at a point, counted from the middle of the first texel."""
    body = objects.facets[prim].body
    b, c = barycentric(objects.facets[prim], x, y, z)
    uv = objects.uv[prim]
    a = 1.0 - b - c
    u = a * uv[0, 0] + b * uv[1, 0] + c * uv[2, 0]
    v = a * uv[0, 1] + b * uv[1, 1] + c * uv[2, 1]
    return (1.0 - v) * objects.texture[body, 1] - 0.5, u * objects.texture[body, 2] - 0.5


@kernel
def opacity_at(objects: ObjectTables, prim: int, x: float, y: float, z: float) -> float:
    """Return the opacity of a target at a point of a facet: its number, or its texture's alpha (bilinear, clamped).

    Parameters
    ----------
    prim : int
        Facet.
    x, y, z : float, mm
    """
    body = objects.facets[prim].body
    if objects.opacity[body] != BY_ALPHA:
        return objects.opacity[body]
    height, width = objects.texture[body, 1], objects.texture[body, 2]
    row, column = _place_in_texture(objects, prim, x, y, z)
    low, left = min(max(row, 0.0), height - 1.0), min(max(column, 0.0), width - 1.0)
    j, k = min(int(low), max(height - 2, 0)), min(int(left), max(width - 2, 0))
    s, t = low - j, left - k
    place = objects.alpha_first[body] + j * width + k
    down, right = (width if height > 1 else 0), (1 if width > 1 else 0)
    alpha = objects.alpha
    upper = (1.0 - t) * alpha[place] + t * alpha[place + right]
    return (1.0 - s) * upper + s * ((1.0 - t) * alpha[place + down] + t * alpha[place + down + right])


@kernel
def passes(objects: ObjectTables, packet: Any, prim: int, t: float) -> bool:
    """Tell whether a packet passes through a facet of a target that is not opaque.

    The random number belongs to the packet, its kind, its event and the facet: asked again, the answer is the same. A
    packet and those that it sends to lights share key and event, but must not share their luck.

    Parameters
    ----------
    packet : PACKET
    prim : int
        Facet.
    t : float, mm
        Distance at which the packet meets it.
    """
    x, y, z = packet.x + t * packet.dx, packet.y + t * packet.dy, packet.z + t * packet.dz
    chance = uniform(
        derived(packet.key, FACETS + KINDS * prim + packet.kind), packet.events * DIMENSIONS_PER_EVENT + PASS
    )
    return chance >= opacity_at(objects, prim, x, y, z)


@inlined
def _gather(options: Options, flow: Flow, objects: ObjectTables, packet: Any, point: Point, scatters: bool) -> None:
    """Deposit the light that a target emits towards the packet, and send shadow packets for the light it scatters."""
    flow.book[REACHED] += packet.weight
    radiance = emitted_radiance(objects, packet, point, -packet.dx, -packet.dy, -packet.dz)
    if radiance > 0.0:
        share = share_by_chance(objects, packet, point.prim, point.x, point.y, point.z)
        deposit(options, flow, packet.source, packet.colour, packet.weight * share * radiance)
    lit = radiance > 0.0
    if scatters:
        lit = ask_lights(options, objects, flow, packet, point) or lit
        volumes, events = objects.volumes, packet.events
        if (
            asks_emitters(options, objects, events)
            or asks_media(volumes, options)
            or asks_halos(volumes, options, events)
        ):
            asking = put(
                flow, EMITTERS, packet, OBJECT_FRAME, point.x, point.y, point.z, packet.dx, packet.dy, packet.dz,
                packet.weight, packet.key, 0.0,
            )  # fmt: skip
            asking.facet = point.prim
    if lit:
        flow.book[LIT] += packet.weight


@inlined
def emitted_radiance(
    objects: ObjectTables, packet: Any, point: Point, ox: float, oy: float, oz: float
) -> float:  # fmt: skip
    """Return the radiance that a point emits into the packet's medium, as the packet's weight counts it, W/(m² sr).

    Parameters
    ----------
    objects : ObjectTables
    packet : PACKET
    point : Point
    ox, oy, oz : float
        Unit direction away from the surface.
    """
    radiance = objects.radiance[objects.facets[point.prim].body, packet.colour]
    if radiance <= 0.0:
        return 0.0
    source = emission_of(objects, point, derived(packet.key, packet.events))
    if objects.scattering.models[source.model].kind == THERMAL:
        # Radiance over n² is conserved on the way out of glass, in which a black body has n² times that in air.
        return radiance * emissivity(objects.scattering, source, packet.colour, ox, oy, oz)
    radiance *= point.texel
    if packet.medium != AIR:
        radiance /= objects.media.indices[packet.medium, packet.colour] ** 2
    return radiance


@inlined
def scatter(
    options: Options, flow: Flow, frames: Array, objects: ObjectTables, aim: AimTables, packet: Any, point: Point,
    weight: float, scattered: float,
) -> None:  # fmt: skip
    """Scatter (or emit) from a point: towards the camera, and to other targets.

    Parameters
    ----------
    weight : float
        Weight that arrived, along the packet's direction.
    scattered : float
        Weight times the model's albedo.
    """
    if scattered <= 0.0:
        return
    packet.facet = point.prim
    packet.last = NO_SURFACE
    depolarise(flow.polarised, packet)
    if options.record:
        body = objects.facets[point.prim].body
        packet.node = record(
            flow, frames, OBJECT_FRAME, point.x, point.y, point.z, scattered, ON_TARGET, body, E_SCATTERED, packet.node
        )
    to_camera = 0.0
    if options.aimed and not options.adjoint:
        to_camera = _aim_at_camera(flow, frames, objects, aim, packet, point, weight)
    if not options.bounce and (options.aimed or options.adjoint):
        # Nothing but the camera can be met: all other light escapes.
        flow.book[ESCAPED] += scattered - to_camera
        return
    flow.book[SAMPLING_ADDED] += to_camera
    _bounce(options, flow, objects, packet, point, weight, scattered)


@inlined
def _bounce(
    options: Options, flow: Flow, objects: ObjectTables, packet: Any, point: Point, weight: float, scattered: float
) -> None:
    """Queue the child whose direction the scattering model draws, if it survives roulette."""
    x, y, z = point.x, point.y, point.z
    ix, iy, iz = packet.dx, packet.dy, packet.dz
    u, v = draw_two(options, packet, BOUNCE_U)
    dx, dy, dz, share = sample(objects.scattering, point, packet.colour, ix, iy, iz, u, v)
    # A sample carries the scattered weight on average only; the book takes the difference.
    flow.book[SAMPLING_ADDED] += weight * share - scattered
    cutoff = options.unturned_cutoff if counts_not_yet(options, packet) else options.cutoff
    dimension = packet.events * DIMENSIONS_PER_EVENT + KEEP_BOUNCE
    drawn = weight * share
    weight = windowed(flow.book, drawn, cutoff * packet.start, packet.key, dimension)
    if weight > 0.0:
        clear = clear_of(objects.facets[point.prim], x, y, z, dx, dy, dz)
        child = put(flow, OBJECTS, packet, OBJECT_FRAME, x, y, z, dx, dy, dz, weight, packet.key, clear)
        child.kind = SCATTERED
        child.density = density(objects.scattering, point, packet.colour, ix, iy, iz, dx, dy, dz)
        if options.adjoint:
            # Of all that are drawn, roulette keeps few; see `regions.emitters`.
            child.density *= drawn / weight


@inlined
def _aim_at_camera(
    flow: Flow, frames: Array, objects: ObjectTables, aim: AimTables, packet: Any, point: Point, weight: float
) -> float:
    """Queue the child that is aimed at the entrance pupil: BRDF · cos · dω of the weight. Return its weight."""
    x, y, z = point.x, point.y, point.z
    ix, iy, iz = packet.dx, packet.dy, packet.dz
    px, py, pz = move_point(frames, OBJECT_FRAME, CAMERA_FRAME, x, y, z)
    ax, ay, az, at_lens = aimed_from(
        aim.through, aim, px, py, pz,
        draw(packet, AIM_DISK), draw(packet, AIM_U), draw(packet, AIM_V),
    )  # fmt: skip
    dx, dy, dz = move_direction(frames, CAMERA_FRAME, OBJECT_FRAME, ax, ay, az)
    cos_theta = point.nx * dx + point.ny * dy + point.nz * dz
    if cos_theta <= 0.0 or at_lens <= 0.0:
        return 0.0
    weight *= evaluate(objects.scattering, point, packet.colour, ix, iy, iz, dx, dy, dz) * cos_theta / at_lens
    child = put(
        flow, OBJECTS, packet, OBJECT_FRAME, x, y, z, dx, dy, dz, weight,
        derived(packet.key, AIMED_CHILD + packet.events), clear_of(objects.facets[point.prim], x, y, z, dx, dy, dz),
    )  # fmt: skip
    child.kind = CAMERA
    child.start = weight
    child.density = density(objects.scattering, point, packet.colour, ix, iy, iz, dx, dy, dz)
    return weight


@kernel
def share_with_other(flow: Flow, frames: Array, aim: AimTables, packet: Any) -> None:
    """Weight a packet that goes from a target into glass by the balance heuristic (Veach & Guibas 1995).

    Behind the glass the lens may appear where it is aimed at or, as the glass bends light, elsewhere. So both the aimed
    child and the one drawn by the scattering model count, each weighted by its share of their densities.

    Parameters
    ----------
    flow : Flow
    frames : (6, 6, 3, 4) float64
    aim : AimTables
    packet : PACKET
    """
    x, y, z = move_point(frames, OBJECT_FRAME, CAMERA_FRAME, packet.x, packet.y, packet.z)
    dx, dy, dz = move_direction(frames, OBJECT_FRAME, CAMERA_FRAME, packet.dx, packet.dy, packet.dz)
    anywhere = packet.density
    at_lens = aimed_density_from(aim.through, aim, x, y, z, dx, dy, dz)
    weight = packet.weight
    if packet.kind == CAMERA:
        packet.weight *= at_lens / (at_lens + anywhere)
        packet.start = packet.weight
    else:
        packet.weight *= anywhere / (at_lens + anywhere)
    flow.book[SAMPLING_REMOVED] += weight - packet.weight
