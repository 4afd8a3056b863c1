"""Shadow packets: sent from a point to a light, with the light that they bring if nothing is in between."""

from typing import Any, NamedTuple

import numpy as np

from lfmesh.geometry.ray import Ray
from lfmesh.kernels.decorators import pasted
from lfmesh.transport.packets.packet import NO_SURFACE, OBJECT_FRAME, OBJECTS, SHADOW, Flow, put


class Way(NamedTuple):
    """Ray from a point to a light, as the `sample` of the light draws it.

    Attributes
    ----------
    light : int
        Kind of the light: TO_LAMP, TO_FACET, TO_MEDIA or PAST_LAMP.
    goal : int
        Number of the lamp or of the emitting facet.
    ray : Ray
        From the point, in the packet's frame.
    reach : float, mm
        Distance of a lamp, or of a point of a facet; inf for light all along the ray.
    value : float
        Irradiance of a lamp on a plane perpendicular to the ray, W/m²; of other lights 1.
    density : float, 1/sr
        Density of the direction; 1 for a lamp, because its irradiance includes it; 0: nothing drawn.
    """

    light: int
    goal: int
    ray: Ray
    reach: float
    value: float
    density: float


@pasted
def send(flow: Flow, packet: Any, way: Way, weight: float, key: np.uint64, query_from: float) -> Any:
    """Queue a shadow packet and return its record; it inherits facet, medium and events from `packet`.

    Parameters
    ----------
    flow : Flow
    packet : PACKET
        Asks the light.
    way : Way
    weight : float
        Light for the pixel if the lamp or facet is reached, W; for rays that gather light, its factor, m² sr.
    key : uint64
    query_from : float, mm
        Start of Embree's search along the ray.
    """
    ray = way.ray
    shadow = put(
        flow, OBJECTS, packet, OBJECT_FRAME, ray.x, ray.y, ray.z, ray.dx, ray.dy, ray.dz, weight, key, query_from
    )
    shadow.kind, shadow.light, shadow.goal = SHADOW, way.light, way.goal
    shadow.limit, shadow.last = way.reach, NO_SURFACE
    return shadow
