"""Packets on targets: they gather light and are scattered, towards the camera and to other targets.

An adjoint packet gathers the light leaving the point towards it: emission, and scattered light by next-event
estimation. A forward packet sends a child aimed at the entrance pupil. Both may be scattered to other targets, by the
target's model (`events/scattering.py`).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.frame import move_direction, move_point
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.aims.mixture import aimed, aimed_density
from lfmesh.transport.events.crossing import (
    AIM_DISK,
    AIM_U,
    AIM_V,
    BOUNCE_U,
    KEEP_BOUNCE,
    PASS,
    deposit,
    draw,
    draw_two,
    end,
    record,
    thinned,
    windowed,
)
from lfmesh.transport.events.facets import clear_of
from lfmesh.transport.events.object_space import ObjectSpace
from lfmesh.transport.events.polarisation import depolarise
from lfmesh.transport.events.scattering import Point, albedo, density, evaluate, sample
from lfmesh.transport.events.surface import emitted_radiance, opacity_at, point_of
from lfmesh.transport.lights.combine import ask_lamps, has_asked, share_of_scattered, wait_for_lights
from lfmesh.transport.lights.emitting_facets import density as density_to_facet
from lfmesh.transport.packets.book import ESCAPED, LIT, REACHED, SAMPLING_ADDED, SAMPLING_REMOVED
from lfmesh.transport.packets.children import AIMED_CHILD
from lfmesh.transport.packets.packet import (
    CAMERA,
    CAMERA_FRAME,
    E_SCATTERED,
    EVENTS,
    LEFT_LENS,
    NO_SURFACE,
    OBJECT_FRAME,
    OBJECTS,
    ON_TARGET,
    S_ABSORBED,
    SCATTERED,
    SHADOW,
    Flow,
    Options,
    count_event,
    put,
)
from lfmesh.transport.packets.random import DIMENSIONS_PER_EVENT, derived, uniform
from lfmesh.transport.paths.automaton import counts, counts_not_yet
from lfmesh.transport.tables.tables import LensAim, ObjectTables

Array = NDArray[np.float64]

FACETS = 1 << 32
"""Offset, in a packet's key, of the first facet's random numbers."""

KINDS = 8
"""Number of kinds of packets; shadow packets to each kind of light come last."""


@inlined
def meet_target(space: ObjectSpace, packet: Any, prim: int, x: float, y: float, z: float, along: float) -> None:
    """Gather light and scatter at a point of a target.

    Parameters
    ----------
    space : ObjectSpace
    packet : PACKET
    prim : int
        Facet.
    x, y, z : float, mm
        Point, object frame.
    along : float
        The facet's normal · the packet's direction.
    """
    options, flow, frames, objects, _ = space
    body = objects.facets[prim].body
    slot = objects.target_slot[body]
    dx, dy, dz, weight = packet.dx, packet.dy, packet.dz, packet.weight
    flow.counts[EVENTS] += 1
    if objects.one_sided[body] and along > 0.0:
        end(options, flow, frames, packet, OBJECT_FRAME, x, y, z, dx, dy, dz, weight, slot, S_ABSORBED)
        return
    if counts_not_yet(options, packet):
        # It gathers nothing here, and few such packets continue: play roulette before the work of scattering.
        weight = thinned(options.thinning.unturned_cutoff, flow.book, packet, weight, packet.key)
        if weight == 0.0:
            return
        packet.weight = weight
    side = -1.0 if along > 0.0 else 1.0
    point = point_of(objects, packet, prim, (x, y, z), side, options.adjoint)
    share = albedo(objects.scattering, point, packet.colour, dx, dy, dz)
    if options.adjoint and counts(options, packet):
        _gather(space, packet, point, share > 0.0)
    scattered = weight * share
    if scattered <= 0.0:
        end(options, flow, frames, packet, OBJECT_FRAME, x, y, z, dx, dy, dz, weight, slot, S_ABSORBED)
        return
    flow.book[slot] += weight - scattered
    if packet.last == LEFT_LENS and not options.bounce and not options.adjoint:
        # The lens reflected it back. Without bounces the adjoint method lacks such paths, so they are omitted here.
        flow.book[ESCAPED] += scattered
        return
    count_event(packet)
    scatter(space, packet, point, weight, scattered)


@kernel
def passes(objects: ObjectTables, packet: Any, prim: int, t: float, along: float) -> bool:
    """Tell whether a packet passes through a facet of a target that is not opaque.

    The random number depends on the packet, its kind and light, its event, the facet, and the side of a round face,
    which a packet may cross twice. A repeated query therefore gives the same answer. A packet and its shadow packets
    share key and event, but pass independently.

    Parameters
    ----------
    packet : PACKET
    prim : int
        Facet.
    t : float, mm
        Distance of the facet.
    along : float
        The facet's normal · the packet's direction.
    """
    x, y, z = packet.x + t * packet.dx, packet.y + t * packet.dy, packet.z + t * packet.dz
    kind = packet.kind + packet.light if packet.kind == SHADOW else packet.kind
    number = prim + len(objects.facets) if along > 0.0 and objects.facets[prim].size == 0.0 else prim
    chance = uniform(derived(packet.key, FACETS + KINDS * number + kind), packet.events * DIMENSIONS_PER_EVENT + PASS)
    return chance >= opacity_at(objects, prim, x, y, z)


@inlined
def _gather(space: ObjectSpace, packet: Any, point: Point, scatters: bool) -> None:
    """Deposit the light that a target emits towards the packet, and sample lights for the target to scatter."""
    options, flow, objects = space.options, space.flow, space.objects
    flow.book[REACHED] += packet.weight
    radiance = emitted_radiance(objects, packet, point, -packet.dx, -packet.dy, -packet.dz, flow.moving)
    lit = radiance > 0.0
    if lit:
        share = 1.0
        if has_asked(packet):
            asked = density_to_facet(objects, packet, point.prim, point.x, point.y, point.z, flow.moving)
            share = share_of_scattered(packet, asked)
        deposit(options, flow, packet.source, packet.colour, packet.weight * share * radiance)
    if scatters:
        packet.facet = point.prim
        lit = ask_lamps(space, packet, point) or lit
        wait_for_lights(space, packet, (point.x, point.y, point.z), NO_SURFACE, packet.key)
    if lit:
        flow.book[LIT] += packet.weight


@inlined
def scatter(space: ObjectSpace, packet: Any, point: Point, weight: float, scattered: float) -> None:
    """Scatter (or emit) from a point: towards the camera, and to other targets.

    Parameters
    ----------
    space : ObjectSpace
    packet : PACKET
    point : Point
    weight : float
        Weight that arrives along the packet's direction.
    scattered : float
        Weight times the model's albedo.
    """
    options, flow, frames, objects, _ = space
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
        to_camera = _aim_at_camera(space, packet, point, weight)
    if not options.bounce and (options.aimed or options.adjoint):
        # Only the camera can be met: all other light escapes.
        flow.book[ESCAPED] += scattered - to_camera
        return
    flow.book[SAMPLING_ADDED] += to_camera
    _bounce(options, flow, objects, packet, point, weight, scattered)


@inlined
def _bounce(
    options: Options, flow: Flow, objects: ObjectTables, packet: Any, point: Point, weight: float, scattered: float
) -> None:
    """Queue a child in a direction drawn by the scattering model, if it survives roulette."""
    x, y, z = point.x, point.y, point.z
    incoming = packet.dx, packet.dy, packet.dz
    u, v = draw_two(options, packet, BOUNCE_U)
    dx, dy, dz, share = sample(objects.scattering, point, packet.colour, incoming, u, v)
    # A sample carries the scattered weight on average only; the book takes the difference.
    flow.book[SAMPLING_ADDED] += weight * share - scattered
    cutoff = options.thinning.unturned_cutoff if counts_not_yet(options, packet) else options.thinning.cutoff
    dimension = packet.events * DIMENSIONS_PER_EVENT + KEEP_BOUNCE
    drawn = weight * share
    weight = windowed(flow.book, drawn, cutoff * packet.start, packet.key, dimension)
    if weight > 0.0:
        clear = clear_of(objects.facets[point.prim], x, y, z, dx, dy, dz)
        child = put(flow, OBJECTS, packet, OBJECT_FRAME, x, y, z, dx, dy, dz, weight, packet.key, clear)
        child.kind = SCATTERED
        child.density = density(objects.scattering, point, packet.colour, incoming, (dx, dy, dz))
        if options.adjoint:
            # Roulette keeps only some of the samples; see `lights.combine`.
            child.density *= drawn / weight


@inlined
def _aim_at_camera(space: ObjectSpace, packet: Any, point: Point, weight: float) -> float:
    """Queue the child aimed at the entrance pupil, of weight · BRDF · cos · dω; return its weight."""
    _, flow, frames, objects, aim = space
    x, y, z = point.x, point.y, point.z
    incoming = packet.dx, packet.dy, packet.dz
    px, py, pz = move_point(frames, OBJECT_FRAME, CAMERA_FRAME, x, y, z)
    numbers = draw(packet, AIM_DISK), draw(packet, AIM_U), draw(packet, AIM_V)
    ax, ay, az, at_lens = aimed(aim, (px, py, pz), numbers)
    dx, dy, dz = move_direction(frames, CAMERA_FRAME, OBJECT_FRAME, ax, ay, az)
    cos_theta = point.nx * dx + point.ny * dy + point.nz * dz
    if cos_theta <= 0.0 or at_lens <= 0.0:
        return 0.0
    weight *= evaluate(objects.scattering, point, packet.colour, incoming, (dx, dy, dz)) * cos_theta / at_lens
    child = put(
        flow, OBJECTS, packet, OBJECT_FRAME, x, y, z, dx, dy, dz, weight,
        derived(packet.key, AIMED_CHILD + packet.events), clear_of(objects.facets[point.prim], x, y, z, dx, dy, dz),
    )  # fmt: skip
    child.kind = CAMERA
    child.start = weight
    child.density = density(objects.scattering, point, packet.colour, incoming, (dx, dy, dz))
    return weight


@kernel
def share_with_other(flow: Flow, frames: Array, aim: LensAim, packet: Any) -> None:
    """Weight a packet that goes from a target into glass by the balance heuristic (Veach & Guibas 1995).

    Behind the glass, the lens may appear at the aim or, as glass bends light, elsewhere. So the aimed child and the one
    drawn by the scattering model both count, by their shares of the densities.

    Parameters
    ----------
    flow : Flow
    frames : (6, 6, 3, 4) float64
    aim : LensAim
    packet : PACKET
    """
    p = move_point(frames, OBJECT_FRAME, CAMERA_FRAME, packet.x, packet.y, packet.z)
    d = move_direction(frames, OBJECT_FRAME, CAMERA_FRAME, packet.dx, packet.dy, packet.dz)
    anywhere = packet.density
    at_lens = aimed_density(aim, p, d)
    weight = packet.weight
    if packet.kind == CAMERA:
        packet.weight *= at_lens / (at_lens + anywhere)
        packet.start = packet.weight
    else:
        packet.weight *= anywhere / (at_lens + anywhere)
    flow.book[SAMPLING_REMOVED] += weight - packet.weight
