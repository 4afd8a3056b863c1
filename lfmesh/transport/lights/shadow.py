"""Shadow packets: sent from a point to a light, with what the light brings if nothing is in between."""

from typing import Any, NamedTuple

import numpy as np

from lfmesh.geometry.ray import Ray
from lfmesh.kernels.decorators import pasted
from lfmesh.transport.packets.packet import NO_SURFACE, OBJECT_FRAME, OBJECTS, SHADOW, Flow, put


class Way(NamedTuple):
    """A way from a point to a light, as the `sample` of the light draws it.

    Attributes
    ----------
    light : int
        Kind of the light: TO_LAMP, TO_FACET, TO_MEDIA or PAST_LAMP.
    goal : int
        Number of the lamp or of the emitting facet.
    ray : Ray
        From the point, in the object frame.
    reach : float, mm
        Distance of a lamp, or of a point of a facet; inf: the light is all along the ray.
    value : float
        Irradiance of a lamp on a plane perpendicular to the ray, W/m²; of other lights 1.
    density : float, 1/sr
        With which the direction is drawn; of a lamp, whose irradiance holds it, 1; 0: nothing is drawn.
    """

    light: int
    goal: int
    ray: Ray
    reach: float
    value: float
    density: float


@pasted
def send(flow: Flow, packet: Any, way: Way, weight: float, key: np.uint64, query_from: float) -> Any:
    """Queue a shadow packet and return its record; its facet, medium and events are those of `packet`.

    Parameters
    ----------
    flow : Flow
    packet : PACKET
        It asks the light.
    way : Way
    weight : float
        Brought to the pixel if the light is reached, W; where the way gathers the light, its factor, m² sr.
    key : uint64
    query_from : float, mm
        Distance along the way at which Embree starts to look.
    """
    ray = way.ray
    shadow = put(
        flow, OBJECTS, packet, OBJECT_FRAME, ray.x, ray.y, ray.z, ray.dx, ray.dy, ray.dz, weight, key, query_from
    )
    shadow.kind, shadow.light, shadow.goal = SHADOW, way.light, way.goal
    shadow.limit, shadow.last = way.reach, NO_SURFACE
    return shadow
