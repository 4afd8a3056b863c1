"""Facets of bodies that touch find each other, and nobody else's do."""

import numpy as np
import pytest
import trimesh

from lfmesh.geometry.meshes.mesh import Mesh
from lfmesh.transport.tables.contacts import contacts


def cube(x: float, turned: float = 0.0) -> Mesh:
    """Return a cube of 10 mm about a point of the x axis, turned about that axis."""
    mesh = trimesh.creation.box((10.0, 10.0, 10.0))
    mesh.apply_transform(trimesh.transformations.rotation_matrix(turned, [1.0, 0.0, 0.0]))
    mesh.apply_translation([x, 0.0, 0.0])
    return Mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces))


def touching(meshes: list[Mesh], *glass: bool) -> set[tuple[int, int]]:
    """Return the pairs of facets that lie on each other, each as (mesh and facet counted on, ...)."""
    first, partners, _ = contacts(meshes, np.array(glass or [True] * len(meshes)), sum(len(m.faces) for m in meshes))
    if not len(first):
        return set()
    assert len(first) == 1 + sum(len(mesh.faces) for mesh in meshes)
    assert first[-1] == len(partners)
    return {(k, int(p)) for k in range(len(first) - 1) for p in partners[first[k] : first[k + 1]]}


def facets_at(mesh: Mesh, x: float) -> set[int]:
    return {k for k, corners in enumerate(mesh.vertices[mesh.faces]) if np.allclose(corners[:, 0], x, atol=1e-3)}


@pytest.mark.parametrize("turned", [0.0, 0.3])
@pytest.mark.parametrize("gap", [0.0, 5e-5, -5e-5])
def test_the_facets_of_a_shared_face_lie_on_each_other(turned: float, gap: float) -> None:
    one, other = cube(0.0), cube(10.0 + gap, turned)
    found = touching([one, other])
    own, its = facets_at(one, 5.0), {12 + k for k in facets_at(other, 5.0)}
    shared = {(a, b) for a, b in found if a in own}
    # Boxes round triangles are wider than they are: some pairs only may lie on each other.
    assert {a for a, _ in shared} == own
    assert {b for _, b in shared} == its
    assert {(b, a) for a, b in found} == found


def test_bodies_apart_and_targets_that_are_no_glass_touch_nothing() -> None:
    assert touching([cube(0.0), cube(10.01)]) == set()
    assert touching([cube(0.0), cube(10.0)], True, False) == set()
    assert touching([cube(0.0)]) == set()


def test_facets_are_counted_over_all_targets() -> None:
    alone = touching([cube(0.0), cube(10.0)])
    assert touching([cube(0.0), cube(50.0), cube(10.0)], True, False, True) == {
        (a + 12 * (a >= 12), b + 12 * (b >= 12)) for a, b in alone
    }
