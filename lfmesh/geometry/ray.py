"""A ray, as kernels pass it on."""

from typing import Any, NamedTuple

from lfmesh.kernels.decorators import inlined


class Ray(NamedTuple):
    """Point (mm) and unit direction in one frame."""

    x: float
    y: float
    z: float
    dx: float
    dy: float
    dz: float


@inlined
def along(ray: Ray, t: float) -> tuple[float, float, float]:
    """Return the point, mm, at distance t (mm) along a ray."""
    return ray.x + t * ray.dx, ray.y + t * ray.dy, ray.z + t * ray.dz


@inlined
def ray_of(packet: Any) -> Ray:
    """Return the ray of a packet."""
    return Ray(packet.x, packet.y, packet.z, packet.dx, packet.dy, packet.dz)
