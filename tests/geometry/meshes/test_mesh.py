"""Meshes: orientation survives motion and reflection, joining keeps facets, the table holds the planes."""

from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest
import trimesh

from lfmesh.geometry.frame import IDENTITY, frame
from lfmesh.geometry.meshes.mesh import Mesh, facet_corner_normals, facet_normals, facet_table, joined

MIRROR = IDENTITY * [[1], [1], [-1]]


@pytest.fixture
def box():
    body = trimesh.creation.box(extents=(1, 2, 3))
    mesh = Mesh(np.array(body.vertices), np.array(body.faces, dtype=np.int64))
    return Mesh(mesh.vertices, mesh.faces, facet_corner_normals(mesh))


@pytest.mark.parametrize("through", [frame((10, 20, 30), (1, 2, 3)), MIRROR])
def test_outward_stays_outward(box, through):
    moved = box.moved(through)
    assert moved.solid().volume == pytest.approx(6.0, rel=1e-14)
    np.testing.assert_allclose(moved.corner_normals, facet_corner_normals(moved), atol=1e-15)


def test_flipping_turns_the_volume_and_the_normals(box):
    flipped = box.flipped()
    assert flipped.solid().volume == pytest.approx(-6.0, rel=1e-14)
    np.testing.assert_allclose(flipped.corner_normals, facet_corner_normals(flipped), atol=1e-15)


def test_joining_keeps_the_facets_in_order(box):
    far = box.moved(frame((0, 0, 0), (9, 0, 0)))
    both = joined([box, far])
    count = len(box.faces)
    np.testing.assert_array_equal(both.vertices[both.faces[:count]], box.vertices[box.faces])
    np.testing.assert_array_equal(both.vertices[both.faces[count:]], far.vertices[far.faces])
    np.testing.assert_array_equal(both.corner_normals[count:], far.corner_normals)


def test_joining_nothing_is_an_empty_mesh():
    assert joined([]).faces.shape == (0, 3)


def test_a_faceted_part_gets_its_facets_normals_when_joined_to_a_smooth_one(box):
    plain = Mesh(box.vertices, box.faces)
    np.testing.assert_array_equal(joined([box, plain]).corner_normals[12:], facet_corner_normals(plain))


def test_facet_table_holds_every_corner_on_its_plane(box):
    moved = box.moved(frame((10, 20, 30), (100, 200, 300)))
    table = facet_table(moved, np.full(len(moved.faces), 7))
    corner = moved.vertices[moved.faces]
    off_plane = np.einsum("ij,ikj->ik", table["normal"], corner) - table["offset"][:, None]
    assert np.abs(off_plane).max() < 2e-13
    assert table["size"].max() == pytest.approx(np.sqrt(13.0))
    assert (table["body"] == 7).all()


def test_a_facet_without_area_has_a_zero_normal_and_no_nan():
    normal, area = facet_normals(Mesh(np.array([[0.0, 0, 0], [1, 1, 1], [2, 2, 2]]), np.array([[0, 1, 2]])))
    assert not normal.any()
    assert area[0] == 0.0


def test_normals_and_areas_are_computed_once_and_cannot_be_changed(box):
    normals, areas = facet_normals(box)
    assert facet_normals(box)[0] is normals
    for values in (normals, areas):
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 0.0
    with pytest.raises(FrozenInstanceError):
        box.faces = box.faces[:, ::-1]


def test_normals_follow_vertices_and_faces_of_each_mesh(box):
    facet_normals(box)
    changed = [
        replace(box, vertices=2.0 * box.vertices),
        replace(box, faces=box.faces[:, ::-1]),
        box.moved(frame((10, 20, 30), (1, 2, 3))),
    ]
    for mesh in changed:
        corner = mesh.vertices[mesh.faces]
        cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        length = np.linalg.norm(cross, axis=1)
        assert np.array_equal(facet_normals(mesh)[0], cross / length[:, None])
        assert np.array_equal(facet_normals(mesh)[1], 0.5 * length)
        assert mesh is not box
