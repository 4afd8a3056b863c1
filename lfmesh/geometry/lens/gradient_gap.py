"""Rays through a gap of the lens that gradient-index glass fills, from any point to a face or the edge.

All in the medium's own frame: that of the prescription's surfaces, with its origin at the vertex of the surface in
front. Beyond its rim a face continues as the plane of the rim, as lenses are made; the edge is a cylinder at the larger
of both rims.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.surfaces.surface import CONIC_AND_EVEN, form_at
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.gradient_path import GradientRay
from lfmesh.optics.gradient_walls import NO_WALL, lander, wall_finder
from lfmesh.optics.gradients import Gradients

Array = NDArray[np.float64]

FRONT, BACK, EDGE = range(3)
"""Walls of a gap. The first two are the surfaces in front of and behind the space, in the order of their numbers."""

WALLS = 3


class Gap(NamedTuple):
    """A gap between two surfaces of a lens.

    Attributes
    ----------
    surfaces : (K,) SURFACE
        Of the lens.
    space : int
        Number of the surface behind it. A surface that the lens does not have is no wall.
    origin_z : float, mm
        z of the own frame's origin in the prescription.
    front_rim, back_rim : float, mm
        Radii of both rims.
    """

    surfaces: NDArray[np.void]
    space: int
    origin_z: float
    front_rim: float
    back_rim: float


class Face(NamedTuple):
    """A surface of a gap: its number among the lens's `surfaces`, and the gap's `origin_z`."""

    surfaces: NDArray[np.void]
    number: int
    origin_z: float


@inlined
def _clearance_at(gap: Gap, wall: int, ray: GradientRay) -> tuple[float, float]:
    """Return the height of a ray over a face, or the square of its distance from the edge; and the rate along T."""
    x, y = ray.x, ray.y
    r2 = x * x + y * y
    if wall == EDGE:
        wide = max(gap.front_rim, gap.back_rim)
        return wide * wide - r2, -2.0 * (x * ray.tx + y * ray.ty)
    k = gap.space - 1 + wall
    if k < 0 or k >= len(gap.surfaces):
        return np.inf, 0.0
    surface = gap.surfaces[k]
    rim, sense = (gap.front_rim, 1.0) if wall == FRONT else (gap.back_rim, -1.0)
    z, rate = ray.z - (surface.vertex_z - gap.origin_z), ray.tz
    if r2 > rim * rim:
        scale = rim / np.sqrt(r2)
        sag, _, _ = form_at(surface, scale * x, scale * y)
    else:
        sag, by_x, by_y = form_at(surface, x, y)
        rate -= by_x * ray.tx + by_y * ray.ty
    return sense * (z - sag), sense * rate


@inlined
def _height_at(face: Face, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Return a function that is 0 on a face, and its gradient; see `gradient_path.tracer`."""
    surface = face.surfaces[face.number]
    w = z - (surface.vertex_z - face.origin_z)
    if surface.kind == CONIC_AND_EVEN and surface.terms == 0:
        c, q = surface.curvature, 1.0 + surface.conic
        return w - 0.5 * c * (x * x + y * y + q * w * w), -c * x, -c * y, 1.0 - c * q * w
    sag, by_x, by_y = form_at(surface, x, y)
    return w - sag, -by_x, -by_y, 1.0


_find_wall = wall_finder(WALLS, _clearance_at)
_land = lander(_height_at)


@kernel
def follow_in_gap(
    gradients: Gradients, number: int, gap: Gap, ray: GradientRay, step: float, steps: int
) -> tuple[int, GradientRay, float]:
    """Return the first wall that a ray meets, or `NO_WALL`; the ray there; and its length in σ, mm.

    Rays that meet a face beyond its rim meet the edge.

    Parameters
    ----------
    gradients : Gradients
    number : int
        Row of the profile.
    gap : Gap
    ray : GradientRay
        In the gap, or on a face of it.
    step : float, mm
        Longest step in σ.
    steps : int
        Number of equal steps to a face; more for rays that need longer ones than `step`.
    """
    wide, usual = max(gap.front_rim, gap.back_rim), steps
    if wide < np.inf:
        # A ray that turns back may run across the whole glass; its length in σ is that over an index above 1.
        usual = max(steps, int(np.ceil(2.0 * wide / step)))
    wall, end, length = _find_wall(gradients, number, ray, gap, step, usual)
    if wall in (NO_WALL, EDGE):
        return wall, end, length
    rim = gap.front_rim if wall == FRONT else gap.back_rim
    if not end.x * end.x + end.y * end.y <= rim * rim:
        return EDGE, end, length
    if length > 0.0:
        face = Face(gap.surfaces, gap.space - 1 + wall, gap.origin_z)
        lands, there, exact = _land(gradients, number, ray, face, length, max(steps, int(np.ceil(length / step))))
        if lands:
            return wall, there, exact
    return wall, end, length


@kernel
def follow_rays_in_gap(
    gradients: Gradients, number: int, gap: Gap, rays: Array, walls: NDArray[np.int64], step: float, steps: int
) -> None:
    """Follow rays as `follow_in_gap` does.

    Parameters
    ----------
    gradients, number, gap
        As for `follow_in_gap`.
    rays : (n, 8) float64
        Rows of `GradientRay`; replaced by the ends.
    walls : (n,) int64
        Filled with the walls.
    step, steps
        As for `follow_in_gap`.
    """
    for i in range(len(rays)):
        ray = GradientRay(
            rays[i, 0], rays[i, 1], rays[i, 2], rays[i, 3], rays[i, 4], rays[i, 5], rays[i, 6], rays[i, 7]
        )  # fmt: skip
        walls[i], end, _ = follow_in_gap(gradients, number, gap, ray, step, steps)
        rays[i, 0], rays[i, 1], rays[i, 2] = end.x, end.y, end.z
        rays[i, 3], rays[i, 4], rays[i, 5] = end.tx, end.ty, end.tz
        rays[i, 6], rays[i, 7] = end.path, end.length
