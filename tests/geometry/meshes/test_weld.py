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


def test_places_are_those_of_a_brute_search_in_the_order_of_the_facets():
    """Of a lattice, whose coordinates differ in few bits, with vertices of no facet among its own."""
    rng = np.random.default_rng(64)
    vertices = np.ldexp(rng.integers(-40, 40, size=(4000, 3)).astype(float), rng.integers(-3, 3, size=(4000, 1)))
    faces = rng.integers(0, len(vertices), size=(900, 3))
    mesh = welded(Mesh(vertices, faces))
    np.testing.assert_array_equal(mesh.vertices[mesh.faces], vertices[faces])
    places = list(dict.fromkeys(map(tuple, vertices[faces].reshape(-1, 3).tolist())))
    assert list(map(tuple, mesh.vertices.tolist())) == places
