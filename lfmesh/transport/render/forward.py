"""The forward method's start, the paper's chain: packets leave a lamp or an emitting target.

A lamp's packets go into the cone round the targets; what it sends elsewhere is booked as escaped at once. An emitting
facet's packet is scattered where it starts, as light that arrived there would be. The adjoint method has its share of
such packets, for lamps that glass hides from it (`parts`): those go into the cone round the glass.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernel import kernel
from lfmesh.optics.scattering import about, tangents
from lfmesh.transport.packets.book import EMITTED, ESCAPED
from lfmesh.transport.packets.packet import LAMP, NO_SURFACE, OBJECT_FRAME, OBJECTS, Flow, Options, put
from lfmesh.transport.packets.random import derived
from lfmesh.transport.regions.objects import scatter, texture_at
from lfmesh.transport.render.adjoint import start
from lfmesh.transport.tables.tables import DIRECTIONAL, DISK, Aim, ObjectTables

Array = NDArray[np.float64]

SOURCE_U, PLACE_U, PLACE_V, WAY_U, WAY_V, SIDE = 0, 1, 2, 3, 4, 5


@kernel
def launch_forward(
    first: int, count: int, total: int, replicate_key: np.uint64, wave: int,
    objects: ObjectTables, aim: Aim, frames: Array, options: Options, flow: Flow, template: NDArray[np.void],
) -> None:  # fmt: skip
    """Start packets number `first` to `first + count` of a replicate's `total`."""
    sources = objects.sources
    packet = template[0]
    packet.wave = wave
    packet.last = NO_SURFACE
    packet.column = NO_SURFACE
    for number in range(first, first + count):
        key = derived(replicate_key, number)
        packet.source = number
        packet.key = key
        packet.events = 0
        packet.kind = LAMP
        packet.facet = NO_SURFACE
        packet.node = NO_SURFACE
        which = min(int(np.searchsorted(sources["until"], start(key, SOURCE_U), side="right")), len(sources) - 1)
        source = sources[which]
        weight = source.power / (source.share * total)
        if source.light >= 0:
            _from_lamp(objects, flow, packet, source.light, weight)
        else:
            _from_facet(objects, aim, frames, options, flow, packet, source.facet, weight)


@kernel
def _from_lamp(objects: ObjectTables, flow: Flow, packet: Any, number: int, weight: float) -> None:
    """Start a packet of a light towards the sphere that is aimed at: the targets', or that of glass alone."""
    light = objects.lights[number]
    key = packet.key
    ax, ay, az = light.direction[0], light.direction[1], light.direction[2]
    x, y, z = light.position[0], light.position[1], light.position[2]
    flow.book[EMITTED] += weight
    radius = objects.lit_radius
    mx, my, mz = objects.lit_middle[0], objects.lit_middle[1], objects.lit_middle[2]
    if light.kind != DISK and light.kind != DIRECTIONAL:
        dx, dy, dz, share = _into_cone(x - mx, y - my, z - mz, radius, key)
        towards = weight * share
    else:
        r = (radius if light.kind == DIRECTIONAL else light.radius) * np.sqrt(start(key, PLACE_U))
        phi = 2.0 * np.pi * start(key, PLACE_V)
        px, py, pz, qx, qy, qz = tangents(ax, ay, az)
        a, b = r * np.cos(phi), r * np.sin(phi)
        if light.kind == DIRECTIONAL:
            # From before everything that may stand in its way.
            x, y, z = mx + a * px + b * qx, my + a * py + b * qy, mz + a * pz + b * qz
            back = objects.outer_radius + (x * ax + y * ay + z * az)
            x, y, z = x - back * ax, y - back * ay, z - back * az
            dx, dy, dz = ax, ay, az
            towards = weight
        else:
            x, y, z = x + a * px + b * qx, y + a * py + b * qy, z + a * pz + b * qz
            dx, dy, dz, share = _into_cone(x - mx, y - my, z - mz, radius, key)
            # Lambert's law against uniform directions: cos θ / π over 1 / (4π share).
            towards = weight * 4.0 * share * max(0.0, dx * ax + dy * ay + dz * az)
    flow.book[ESCAPED] += weight - towards
    if towards <= 0.0:
        return
    packet.start = towards
    put(flow, OBJECTS, packet, OBJECT_FRAME, x, y, z, dx, dy, dz, towards, key, 0.0)


@kernel
def _into_cone(x: float, y: float, z: float, radius: float, key: np.uint64) -> tuple[float, float, float, float]:
    """Return a uniform direction from a point, seen from the sphere's middle, into the cone round the sphere.

    And that cone's share of 4π.
    """
    distance2 = x * x + y * y + z * z
    cos_edge = -1.0
    if distance2 > radius * radius:
        cos_edge = np.sqrt(1.0 - radius * radius / distance2)
    # 1 − cos without cancellation for a far lamp.
    depth = 2.0 if cos_edge < 0.0 else radius * radius / distance2 / (1.0 + cos_edge)
    cos_theta = 1.0 - depth * start(key, WAY_U)
    phi = 2.0 * np.pi * start(key, WAY_V)
    if distance2 == 0.0:
        dx, dy, dz = about(0.0, 0.0, 1.0, cos_theta, phi)
    else:
        scale = -1.0 / np.sqrt(distance2)
        dx, dy, dz = about(x * scale, y * scale, z * scale, cos_theta, phi)
    return dx, dy, dz, 0.5 * depth


@kernel
def _from_facet(
    objects: ObjectTables,
    aim: Aim,
    frames: Array,
    options: Options,
    flow: Flow,
    packet: Any,
    prim: int,
    weight: float,
) -> None:
    """Emit from a uniform point of a facet, on either side of an open sheet."""
    key = packet.key
    body = objects.facets[prim].body
    u, v = start(key, PLACE_U), start(key, PLACE_V)
    if u + v > 1.0:
        u, v = 1.0 - u, 1.0 - v
    corner = objects.facets[prim].corners
    w = 1.0 - u - v
    x = w * corner[0, 0] + u * corner[1, 0] + v * corner[2, 0]
    y = w * corner[0, 1] + u * corner[1, 1] + v * corner[2, 1]
    z = w * corner[0, 2] + u * corner[1, 2] + v * corner[2, 2]
    side = 1.0
    if not objects.closed[body] and start(key, SIDE) < 0.5:
        side = -1.0
    weight *= texture_at(objects, prim, packet.wave, x, y, z)
    flow.book[EMITTED] += weight
    packet.start = weight
    packet.weight = weight
    scatter(options, flow, frames, objects, aim, packet, prim, x, y, z, side, weight)
