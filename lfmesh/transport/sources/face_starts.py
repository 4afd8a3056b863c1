"""Rays that start on a face, set back slightly so that they meet it.

A point on a face is on neither side of it; rounding alone would decide the ray's first medium.
"""

import numpy as np

from lfmesh.geometry import frame
from lfmesh.geometry.meshes.mesh import Array, facet_normals
from lfmesh.geometry.surfaces.sag import heights
from lfmesh.geometry.surfaces.surface import in_place
from lfmesh.transport.packets.packet import CAMERA_FRAME, WORLD_FRAME
from lfmesh.transport.world import World

ON_FACE = 2.0**-45
"""Distance within which a point lies on a face, relative to its coordinates: some roundings of float64."""

BACK = 4.0
"""Distance by which a ray is set back, in units of the distance above."""

MOST_AT_ONCE = 1 << 22
"""Pairs of points and facets compared at a time, to bound the memory."""


def before_faces(world: World, p: Array, d: Array) -> Array:
    """Return the starts of rays, with any on a face of lens or glass set back along the ray by a few roundings.

    Parameters
    ----------
    world : World
    p : (n, 3) float64, mm, world frame
    d : (n, 3) float64
        Directions, of any length but 0.

    Returns
    -------
    (n, 3) float64
        `p` itself if no start lies on a face.
    """
    to_camera = world.tables.frames[WORLD_FRAME, CAMERA_FRAME]
    low, high = world.tables.lens.box_low[2], world.tables.lens.box_high[2]
    z = p @ to_camera[2, :3] + to_camera[2, 3]
    hair = ON_FACE * float(np.abs(world.tables.lens.box_high - world.tables.lens.box_low).sum())
    some = np.flatnonzero((z >= low - hair) & (z <= high + hair))
    on_lens = some[_on_lens(world, frame.points(to_camera, p[some]))]
    on_glass = _on_glass(world, p)
    on_face = np.union1d(on_lens, on_glass)
    if not len(on_face):
        return p
    moved, length = p.copy(), np.linalg.norm(d[on_face], axis=1, keepdims=True)
    way = np.divide(d[on_face], length, out=np.zeros((len(on_face), 3)), where=length > 0.0)
    moved[on_face] -= BACK * _grain(p[on_face], hair)[:, None] * way
    return moved


def _grain(points: Array, hair: float) -> Array:
    """Return the distance within which points (n, 3) lie on a face, mm."""
    return np.asarray(ON_FACE * np.abs(points).sum(axis=1) + hair)


def _on_lens(world: World, points: Array) -> Array:
    """Return a mask of camera-frame points (n, 3) on a surface of the lens."""
    shape, on = world.lens_shape, np.zeros(len(points), bool)
    grain = _grain(points, ON_FACE * max(shape.rims))
    for surface, rim in zip(shape.surfaces, shape.rims, strict=True):
        q = in_place(surface, points)
        r = np.hypot(q[:, 0], q[:, 1])
        near = np.flatnonzero(r <= rim)
        on[near] |= np.abs(q[near, 2] - surface["vertex_z"] - heights(surface, q[near, 0], q[near, 1])) <= grain[near]
    return on


def _on_glass(world: World, points: Array) -> Array:
    """Return the numbers of world-frame points (n, 3) on the surface of a body of glass."""
    found = [np.zeros(0, np.int64)]
    for body in np.flatnonzero(world.tables.objects.rank):
        target = world.targets[body]
        low, high = target.box_mm
        hair = ON_FACE * float((high - low).sum())
        inside = ((points >= low - hair) & (points <= high + hair)).all(axis=1)
        near = np.flatnonzero(inside)
        if not len(near):
            continue
        places, of_point = np.unique(points[near], axis=0, return_inverse=True)
        if target.round is not None:
            on = target.round.distance_mm(places) <= _grain(places, hair)
            found.append(near[on[of_point.reshape(-1)]])
            continue
        mesh = target.mesh
        corners, normals = mesh.vertices[mesh.faces], facet_normals(mesh)[0]
        rows = max(1, MOST_AT_ONCE // len(corners))
        on = np.concatenate(
            [_on_facets(places[i : i + rows], corners, normals, hair) for i in range(0, len(places), rows)]
        )
        found.append(near[on[of_point.reshape(-1)]])
    return np.concatenate(found)


def _on_facets(places: Array, corners: Array, normals: Array, hair: float) -> Array:
    """Return a mask of points (n, 3) on any of the facets (m, 3, 3)."""
    height = places @ normals.T - np.einsum("mi,mi->m", corners[:, 0], normals)
    grain = _grain(places, hair)
    point, facet = np.nonzero(np.abs(height) <= grain[:, None])
    inside = np.ones(len(point), bool)
    for corner in range(3):
        a, b = corners[facet, corner], corners[facet, (corner + 1) % 3]
        inward = np.cross(normals[facet], b - a)
        depth = np.einsum("ij,ij->i", places[point] - a, inward)
        inside &= depth >= -grain[point] * np.linalg.norm(inward, axis=1)
    on = np.zeros(len(places), bool)
    on[point[inside]] = True
    return on
