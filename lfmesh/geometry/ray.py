"""A ray: a point and a unit direction, as kernels hand it on."""

from typing import Any, NamedTuple

from lfmesh.kernels.decorators import inlined


class Ray(NamedTuple):
    """A point, mm, and a unit direction, in one frame."""

    x: float
    y: float
    z: float
    dx: float
    dy: float
    dz: float


@inlined
def along(ray: Ray, t: float) -> tuple[float, float, float]:
    """Return the point at a distance on a ray, mm.

    Parameters
    ----------
    ray : Ray
    t : float, mm
    """
    return ray.x + t * ray.dx, ray.y + t * ray.dy, ray.z + t * ray.dz


@inlined
def ray_of(packet: Any) -> Ray:
    """Return the ray of a packet.

    Parameters
    ----------
    packet : PACKET
    """
    return Ray(packet.x, packet.y, packet.z, packet.dx, packet.dy, packet.dz)
