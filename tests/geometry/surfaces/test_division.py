"""Divided facets cover what they are divided from, leave no gap, and are found as the facets that they are of."""

import numpy as np
import trimesh

from lfmesh.assets import asset_path
from lfmesh.geometry.meshes.mesh import Mesh, facet_normals
from lfmesh.geometry.surfaces.division import EDGES_ACROSS, MANY, MOST_GROWTH, divided
from lfmesh.transport.regions.embree import Finder


def bracket() -> Mesh:
    part = trimesh.load_mesh(asset_path("meshes/bracket.stl"))
    return Mesh(np.asarray(part.vertices), np.asarray(part.faces))


def test_pieces_cover_their_facets_and_leave_no_gap() -> None:
    mesh = bracket()
    pieces, owners = divided(mesh, np.zeros(len(mesh.faces), np.int64))
    assert len(mesh.faces) < len(pieces.faces) <= MOST_GROWTH * len(mesh.faces)
    areas = np.bincount(owners, facet_normals(pieces)[1], len(mesh.faces))
    np.testing.assert_allclose(areas, facet_normals(mesh)[1], rtol=1e-9)
    edges = pieces.vertices[pieces.faces]
    longest = np.linalg.norm(edges - np.roll(edges, 1, axis=1), axis=2).max()
    assert longest <= np.linalg.norm(np.ptp(mesh.vertices, axis=0)) / EDGES_ACROSS
    # Corners of neighbours are equal to the last bit, or the solid would not close.
    corners, faces = np.unique(pieces.vertices, axis=0, return_inverse=True)
    assert trimesh.Trimesh(corners, faces.reshape(-1, 3), process=False).is_watertight


def test_bodies_of_few_facets_and_of_short_ones_stay_as_they_are() -> None:
    ball = trimesh.creation.icosphere(3)
    assert len(ball.faces) > MANY
    for body in (trimesh.creation.box((1.0, 30.0, 2.0)), ball):
        mesh = Mesh(np.asarray(body.vertices), np.asarray(body.faces))
        pieces, owners = divided(mesh, np.zeros(len(mesh.faces), np.int64))
        assert pieces is mesh, "vertices stay shared"
        np.testing.assert_array_equal(owners, np.arange(len(mesh.faces)))
        np.testing.assert_array_equal(pieces.vertices[pieces.faces], mesh.vertices[mesh.faces])


def test_rays_find_the_facets_that_they_find_undivided() -> None:
    """All but those that pass within a rounding error of float32 of an edge, some in ten thousand."""
    mesh = bracket()
    draw = np.random.default_rng(1)
    start = draw.normal(size=(100_000, 3))
    start *= 60.0 / np.linalg.norm(start, axis=1, keepdims=True)
    way = draw.uniform(-20.0, 20.0, start.shape) - start
    origins, directions = start.astype(np.float32), way.astype(np.float32)
    whole = Finder(mesh).find(origins, directions)
    parts = Finder(*divided(mesh, np.zeros(len(mesh.faces), np.int64))).find(origins, directions)
    assert 0.2 < (whole >= 0).mean() < 0.99
    assert (whole != parts).mean() < 5e-4
    assert ((whole >= 0) == (parts >= 0)).mean() > 0.9999
