"""Winding numbers: one inside, none outside, and both for nested shells."""

import numpy as np
import trimesh

from lfmesh.geometry.meshes.mesh import Mesh, joined
from lfmesh.geometry.meshes.winding import shells, winding


def test_points_are_in_a_ball_by_their_distance():
    """Vertices lie on the sphere, and all of the mesh outside the sphere in it."""
    mesh = trimesh.creation.icosphere(3, 2.0)
    corners = mesh.triangles
    inner = np.linalg.norm(corners.mean(axis=1), axis=1).min()
    points = np.random.default_rng(0).uniform(-2.5, 2.5, (2000, 3))
    r = np.linalg.norm(points, axis=1)
    number = winding(corners, points)
    assert (number[r < inner] == 1).all()
    assert (number[r > 2.0] == 0).all()
    assert (winding(corners[:, ::-1], points)[r < inner] == -1).all()


def test_points_a_millionth_of_a_facet_from_the_surface_are_told_apart():
    corners = trimesh.creation.icosphere(2, 1.0).triangles
    middle = corners.mean(axis=1)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    assert (winding(corners, middle - 1e-7 * normal) == 1).all()
    assert (winding(corners, middle + 1e-7 * normal) == 0).all()


def test_shells_are_the_parts_that_hang_together():
    one, two = trimesh.creation.icosphere(1, 1.0), trimesh.creation.box((1.0, 1.0, 1.0))
    both = joined([Mesh(m.vertices, m.faces) for m in (one, two)])
    assert [len(facets) for facets in shells(both)] == [80, 12]
