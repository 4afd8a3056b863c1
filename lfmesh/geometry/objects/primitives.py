"""Meshes of the primitive targets, with their texture coordinates.

A picture reads correctly from outside the body: right × up is the outward normal. Its top lies towards +y, or towards
∓z on faces that look along ±y. On the face that looks along +z, towards the camera, right is therefore +x. A plane or
disk is one sheet with its outside at +z: from behind, its picture is mirrored.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from lfmesh.geometry.meshes.mesh import Array, Index, Mesh, facet_normals
from lfmesh.geometry.meshes.weld import welded
from lfmesh.geometry.surfaces.tessellation import disk_pattern, revolved
from lfmesh.scene.objects.shapes import Box, Cylinder, Disk, Plane, Shape, Solid, Sphere

RINGS = 20
"""Rings of triangles in a disk. Its 120 chords leave 3.4e-4 of the radius, the 3° facets of a sphere 6.9e-4."""

COARSE = 4
"""Rings of a mesh that only encloses a round shape."""

KEPT = 16
"""Number of meshes in the cache."""


class Primitive(NamedTuple):
    """Mesh, mm, and the texture coordinates (m, 3, 2) of its facets' corners, if it has any."""

    mesh: Mesh
    uv: Array | None


@lru_cache(maxsize=KEPT)
def primitive(shape: Shape) -> Primitive:
    """Return the mesh of a shape in its own frame, shared by equal shapes."""
    return _MAKERS[type(shape)](shape)


@lru_cache(maxsize=KEPT)
def hull(shape: Disk | Sphere | Cylinder, rings: int = COARSE) -> Mesh:
    """Return a mesh in the shape's own frame that encloses it, more tightly with more rings."""
    if isinstance(shape, Sphere):
        mesh = sphere(shape, rings).mesh
        nearest = np.einsum("ij,ij->i", facet_normals(mesh)[0], mesh.vertices[mesh.faces[:, 0]]).min()
        return Mesh(mesh.vertices * (shape.radius_mm / nearest), mesh.faces)
    mesh = (cylinder(shape, rings) if isinstance(shape, Cylinder) else disk(shape, rings)).mesh
    wider = 1.0 / np.cos(np.pi / _azimuths(rings))
    return Mesh(mesh.vertices * [wider, wider, 1.0], mesh.faces)


def plane(shape: Plane) -> Primitive:
    """Return a rectangle of two facets that faces +z and carries the whole picture."""
    corners = _SQUARE * [0.5 * shape.width_mm, 0.5 * shape.height_mm]
    return Primitive(Mesh(_at_height(corners, 0.0), _TWO_FACETS), _uv(_SQUARE)[_TWO_FACETS])


def disk(shape: Disk, rings: int = RINGS) -> Primitive:
    """Return a disk that faces +z; its bounding square spans the picture."""
    points, faces = _unit_disk(rings)
    return Primitive(Mesh(_at_height(points * shape.radius_mm, 0.0), faces), _uv(points)[faces])


def box(shape: Box) -> Primitive:
    """Return a box of twelve facets, with the whole picture on each face."""
    half = 0.5 * np.array(shape.size_mm)
    vertices = np.concatenate(
        [(_SQUARE @ np.array([right, up]) + np.cross(right, up)) * half for right, up in _BOX_FACES]
    )
    faces = np.concatenate([_TWO_FACETS + 4 * k for k in range(len(_BOX_FACES))])
    uv = np.tile(_uv(_SQUARE)[_TWO_FACETS], (len(_BOX_FACES), 1, 1))
    return Primitive(welded(Mesh(vertices, faces)), uv)


def solid_of_glass(shape: Solid) -> Mesh:
    """Return the mesh of a closed shape with facet normals at its corners."""
    mesh = primitive(shape).mesh
    return Mesh(mesh.vertices, mesh.faces, np.repeat(facet_normals(mesh)[0][:, None, :], 3, axis=1))


def sphere(shape: Sphere, rings: int = RINGS) -> Primitive:
    """Return a sphere; its picture is an equirectangular map: centre towards +z, top towards +y."""
    meridians, parallels = _azimuths(rings), _azimuths(rings) // 2
    u, v = np.arange(meridians + 1) / meridians, np.arange(parallels + 1) / parallels
    longitude, latitude = np.pi * (2.0 * u - 1.0), np.pi * (v - 0.5)
    # The seam and the poles close exactly.
    longitude[-1] = longitude[0]
    around = np.cos(latitude)
    around[[0, -1]] = 0.0
    unit = np.stack(
        [
            np.outer(around, np.sin(longitude)),
            np.outer(np.sin(latitude), np.ones(meridians + 1)),
            np.outer(around, np.cos(longitude)),
        ],
        axis=-1,
    )
    number = np.arange(unit[..., 0].size).reshape(unit.shape[:2])
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    # At a pole a cell has one facet instead of two.
    lower, upper = np.stack([a, b, c], axis=-1)[1:], np.stack([a, c, d], axis=-1)[:-1]
    faces = np.concatenate([lower.reshape(-1, 3), upper.reshape(-1, 3)])
    places = np.stack(np.broadcast_arrays(u, v[:, None]), axis=-1).reshape(-1, 2)
    return Primitive(welded(Mesh(shape.radius_mm * unit.reshape(-1, 3), faces)), places[faces])


def cylinder(shape: Cylinder, rings: int = RINGS) -> Primitive:
    """Return a closed cylinder along z.

    Its ends carry the picture as disks do. On the wall the picture goes once round, its middle towards +y and its top
    towards -z, as on the +y face of a box: rotated by 90° about x, the cylinder stands upright.
    """
    points, faces = _unit_disk(rings)
    azimuths = _azimuths(rings)
    half = 0.5 * shape.height_mm
    rim = shape.radius_mm
    # The polyline runs towards -z, so that the wall faces outwards.
    wall = revolved(np.array([[rim, half], [rim, -half]]), azimuths)
    front, back = _at_height(points * rim, half), _at_height(points * rim, -half)
    uv_disk = _uv(points)
    # Seen from behind, the picture's right is -x.
    uv_back = _uv(points * [-1.0, 1.0])
    # Seen from outside with -z on top, azimuths grow to the left. Where a facet ends at the seam, at -y and three
    # quarters of a turn, u is 1, not 0.
    right = (3 * azimuths // 4 - wall.faces % azimuths) % azimuths / azimuths
    right = np.where((right == 0.0) & (right.max(axis=1, keepdims=True) > 0.5), 1.0, right)
    # `revolved` lays the circle at +z first.
    uv_wall = np.stack([right, wall.faces >= azimuths], axis=-1).astype(np.float64)
    vertices = np.concatenate([front, back, wall.vertices])
    joint = np.concatenate([faces, faces[:, ::-1] + len(points), wall.faces + 2 * len(points)])
    uv = np.concatenate([uv_disk[faces], uv_back[faces[:, ::-1]], uv_wall])
    return Primitive(welded(Mesh(vertices, joint)), uv)


_SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
_TWO_FACETS = np.array([[0, 1, 2], [0, 2, 3]])

_BOX_FACES = (
    ((1, 0, 0), (0, 1, 0)),
    ((-1, 0, 0), (0, 1, 0)),
    ((0, 0, -1), (0, 1, 0)),
    ((0, 0, 1), (0, 1, 0)),
    ((1, 0, 0), (0, 0, -1)),
    ((1, 0, 0), (0, 0, 1)),
)
"""Right and up directions of the picture on the +z, -z, +x, -x, +y and -y faces."""

_MAKERS: dict[type, Callable[[Any], Primitive]] = {
    Plane: plane,
    Disk: disk,
    Box: box,
    Sphere: sphere,
    Cylinder: cylinder,
}


def _uv(points: Array) -> Array:
    """Map points of the square from -1 to 1 (right, up) to texture coordinates, (0, 0) at the bottom left."""
    return 0.5 + 0.5 * points


def _at_height(points: Array, z: float) -> Array:
    return np.column_stack([points, np.full(len(points), z)])


def _azimuths(rings: int) -> int:
    """Return the number of vertices on the outermost ring."""
    return 6 * rings


def _unit_disk(rings: int) -> tuple[Array, Index]:
    ring, azimuth, faces = disk_pattern(rings)
    return (ring / rings)[:, None] * np.column_stack([np.cos(azimuth), np.sin(azimuth)]), faces
