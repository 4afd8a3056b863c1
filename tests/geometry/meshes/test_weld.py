"""Welding merges what is equal, and nothing else."""

import numpy as np

from lfmesh.geometry.meshes.mesh import Mesh
from lfmesh.geometry.meshes.weld import welded


def test_facets_keep_their_corners_and_share_the_equal_ones():
    rng = np.random.default_rng(41)
    apart = rng.integers(-2, 3, size=(300, 3)).astype(float)
    faces = np.arange(300).reshape(100, 3)
    mesh = welded(Mesh(apart, faces))
    np.testing.assert_array_equal(mesh.vertices[mesh.faces], apart[faces])
    assert len(mesh.vertices) == len(np.unique(apart, axis=0))


def test_a_gap_of_one_ulp_stays_open_but_signed_zeros_are_one_place():
    vertices = np.array([[0.0, 1.0, 2.0], [-0.0, 1.0, 2.0], [0.0, 1.0, np.nextafter(2.0, 3.0)]])
    mesh = welded(Mesh(vertices, np.array([[0, 1, 2]])))
    assert mesh.faces[0, 0] == mesh.faces[0, 1] != mesh.faces[0, 2]
