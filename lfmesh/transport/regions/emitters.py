"""Packets from points of targets to random points of emitting facets, whose light they gather.

A station of its own: its kernel is compiled, and runs, only in scenes with emitting targets.
"""

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernel import kernel
from lfmesh.transport.events.crossing import EDGE, EMITTER_U, clear_of, draw_two
from lfmesh.transport.events.emission import emitting_point
from lfmesh.transport.events.scattering import density, evaluate
from lfmesh.transport.packets.packet import NO_SURFACE, OBJECT_FRAME, OBJECTS, TO_EMITTER, Flow, Options, put
from lfmesh.transport.regions.targets import emitted_radiance, point_of, texture_at
from lfmesh.transport.tables.tables import ObjectTables


@kernel
def ask_emitters(wave: NDArray[np.void], objects: ObjectTables, options: Options, flow: Flow) -> None:
    """Send a packet from each point of a target to a random point of the emitters.

    Parameters
    ----------
    wave : (n,) PACKET
        Packets at the points, with the directions in which they arrived, and the facets in `facet`.
    """
    for i in range(len(wave)):
        packet = wave[i]
        x, y, z = packet.x, packet.y, packet.z
        ix, iy, iz = packet.dx, packet.dy, packet.dz
        own = objects.facets[packet.facet]
        along = own.normal[0] * ix + own.normal[1] * iy + own.normal[2] * iz
        side = -1.0 if along > 0.0 else 1.0
        u, v = draw_two(options, packet, EMITTER_U)
        prim, ex, ey, ez, per_area = emitting_point(objects, u, v)
        facet = objects.facets[prim]
        ux, uy, uz = ex - x, ey - y, ez - z
        distance2 = ux * ux + uy * uy + uz * uz
        if prim == packet.facet or distance2 == 0.0:
            continue
        distance = np.sqrt(distance2)
        ux, uy, uz = ux / distance, uy / distance, uz / distance
        cos_point = side * (own.normal[0] * ux + own.normal[1] * uy + own.normal[2] * uz)
        cos_facet = facet.normal[0] * ux + facet.normal[1] * uy + facet.normal[2] * uz
        # A facet in the point's own plane, to rounding, sends it no light.
        if cos_point <= EDGE or cos_facet == 0.0 or (objects.one_sided[facet.body] and cos_facet > 0.0):
            continue
        cos_facet = abs(cos_facet)
        texel = texture_at(objects, packet.facet, packet.colour, x, y, z)
        point = point_of(objects, packet.facet, x, y, z, side, objects.model[packet.facet], texel, True)
        # Over the sum of both densities: over its own one, and weighted by the balance heuristic.
        by_chance = density(objects.scattering, point, packet.colour, ix, iy, iz, ux, uy, uz)
        brdf = evaluate(objects.scattering, point, packet.colour, ix, iy, iz, ux, uy, uz)
        radiance = emitted_radiance(objects, packet, prim, texture_at(objects, prim, packet.colour, ex, ey, ez))
        light = radiance * brdf * cos_point * cos_facet / (per_area * distance2 + by_chance * cos_facet)
        if light <= 0.0:
            continue
        child = put(
            flow, OBJECTS, packet, OBJECT_FRAME, x, y, z, ux, uy, uz, packet.weight * light, packet.key,
            clear_of(own, x, y, z, ux, uy, uz),
        )  # fmt: skip
        child.kind = TO_EMITTER
        child.last = NO_SURFACE
        child.row = prim
