"""Passage of a ray through a gap of gradient-index glass in the lens, and the index at a point of it.

A ray that arrives on a face along a curve is replaced by the straight ray that ends as the curve does: in the same
point and direction, after the same length. What happens at the face, and absorption on the way, then need not know of
the curve. One function serves packets and blocks.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.frame import direction_through, point_through
from lfmesh.geometry.lens.gradient_gap import EDGE, Gap, follow_in_gap
from lfmesh.geometry.ray import Ray
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.gradient_path import GradientRay
from lfmesh.optics.gradient_walls import NO_WALL
from lfmesh.optics.gradients import field_at
from lfmesh.transport.tables.gradient_spaces import GradientSpaces
from lfmesh.transport.tables.tables import LensTables

REACHED, AT_EDGE, ON_OTHER_FACE, TRAPPED_INSIDE = range(4)
"""Fates of rays in a gap: on the face aimed at; on the edge; on the other face, as after turning back along the axis;
on no wall after a long way."""


class GapEnd(NamedTuple):
    """The straight ray that ends as a ray through a gap does, camera frame.

    Attributes
    ----------
    fate : int
    x, y, z : float, mm
        Its start.
    dx, dy, dz : float
        Unit direction.
    distance : float, mm
        Length of the curve: the straight ray ends there.
    path : float, mm
        Optical path along the curve.
    """

    fate: int
    x: float
    y: float
    z: float
    dx: float
    dy: float
    dz: float
    distance: float
    path: float


@inlined
def in_gradient(gradients: Any, space: int) -> bool:
    """Tell whether gradient-index glass fills a space of the lens.

    Parameters
    ----------
    gradients : GradientSpaces or None
        None: it fills no space.
    space : int
    """
    if gradients is None:
        return False
    return gradients.number[space] >= 0


@inlined
def gap_of(gradients: GradientSpaces, surfaces: NDArray[np.void], space: int) -> Gap:
    """Return the gap of a space.

    Parameters
    ----------
    gradients : GradientSpaces
    surfaces : (K,) SURFACE
        Of the lens.
    space : int
    """
    return Gap(surfaces, int(space), gradients.origin_z[space], gradients.edge[space, 1], gradients.edge[space, 3])


@inlined
def ray_in_gap(gradients: GradientSpaces, space: int, number: int, ray: Ray) -> GradientRay:
    """Return a ray of the camera frame in the own frame of a space, with its optical ray vector.

    Parameters
    ----------
    gradients : GradientSpaces
    space : int
    number : int
        Row of the profile.
    ray : Ray
    """
    x, y, z = point_through(gradients.unpose[space], ray.x, ray.y, ray.z)
    dx, dy, dz = direction_through(gradients.unpose[space], ray.dx, ray.dy, ray.dz)
    index = np.sqrt(field_at(gradients.gradients, number, x, y, z)[0])
    return GradientRay(x, y, z, index * dx, index * dy, index * dz, 0.0, 0.0)


@kernel
def cross_gap(lens: LensTables, space: int, colour: int, k: int, ray: Ray) -> GapEnd:
    """Follow a ray through a space of gradient-index glass to the first wall that it meets.

    Parameters
    ----------
    lens : LensTables
    space : int
    colour : int
        Wavelength number.
    k : int
        Number of the face aimed at: `space`, or `space` − 1.
    ray : Ray
        Camera frame.
    """
    return _crossed(lens.gradients, lens.surfaces, space, colour, k, ray)


@inlined
def _crossed(gradients: Any, surfaces: NDArray[np.void], space: int, colour: int, k: int, ray: Ray) -> GapEnd:
    """Follow a ray as `cross_gap` does; `gradients` : GradientSpaces or None."""
    if gradients is None:
        return GapEnd(TRAPPED_INSIDE, ray.x, ray.y, ray.z, ray.dx, ray.dy, ray.dz, 0.0, 0.0)
    number = gradients.number[space] + colour
    start = ray_in_gap(gradients, space, number, ray)
    wall, end, _ = follow_in_gap(
        gradients.gradients, number, gap_of(gradients, surfaces, space), start, gradients.longest[space, colour],
        gradients.steps[space, colour],
    )  # fmt: skip
    fate = REACHED if space - 1 + wall == k else ON_OTHER_FACE
    if wall == EDGE:
        fate = AT_EDGE
    elif wall == NO_WALL:
        fate = TRAPPED_INSIDE
    over = 1.0 / np.sqrt(end.tx * end.tx + end.ty * end.ty + end.tz * end.tz)
    dx, dy, dz = direction_through(gradients.pose[space], over * end.tx, over * end.ty, over * end.tz)
    x, y, z = point_through(gradients.pose[space], end.x, end.y, end.z)
    distance = end.length
    return GapEnd(fate, x - distance * dx, y - distance * dy, z - distance * dz, dx, dy, dz, distance, end.path)


@inlined
def index_at(lens: LensTables, space: int, colour: int, x: float, y: float, z: float) -> float:
    """Return the refractive index in a space of the lens.

    Parameters
    ----------
    lens : LensTables
    space : int
    colour : int
        Wavelength number.
    x, y, z : float, mm
        Camera frame; of no effect in a homogeneous space.
    """
    return _index(lens.gradients, lens, space, colour, x, y, z)


@inlined
def _index(gradients: Any, lens: LensTables, space: int, colour: int, x: float, y: float, z: float) -> float:
    """Return the index as `index_at` does; `gradients` : GradientSpaces or None."""
    if gradients is None:
        return lens.media.indices[lens.medium[space], colour]
    if gradients.number[space] < 0:
        return lens.media.indices[lens.medium[space], colour]
    x, y, z = point_through(gradients.unpose[space], x, y, z)
    return np.sqrt(field_at(gradients.gradients, gradients.number[space] + colour, x, y, z)[0])
