"""Flatness of meshes, against planes that are turned, divided, moved and bent."""

import numpy as np
import pytest
import trimesh

from lfmesh.geometry.meshes import flatness
from lfmesh.geometry.meshes.mesh import Mesh

FACETS = np.array(
    [[[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 3.0, 0.0]], [[0.0, 0.0, 0.0], [2.0, 3.0, 0.0], [0.0, 3.0, 0.0]]]
)
RNG = np.random.default_rng(1)


def in_one_plane(corners: np.ndarray) -> bool:
    return flatness.in_one_plane([Mesh(part.reshape(-1, 3), np.array([[0, 1, 2]])) for part in corners])


def divided(corners: np.ndarray) -> np.ndarray:
    """Each facet as four."""
    vertices, faces = trimesh.remesh.subdivide(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
    return np.asarray(vertices[faces])


def moved(corners: np.ndarray, scale: float) -> np.ndarray:
    """Turned about a random axis, scaled and moved by a random length."""
    turn = trimesh.transformations.random_rotation_matrix(RNG.random(3))[:3, :3]
    return scale * (corners @ turn.T + RNG.normal(size=3) * 100.0)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_flatness_survives_moves_scales_division_and_the_rounding_of_files(scale: float) -> None:
    for _ in range(50):
        flat = moved(divided(FACETS) if RNG.random() < 0.5 else FACETS, scale)
        assert in_one_plane(flat)
        assert in_one_plane(flat[:1])
        middle = flat.mean(axis=(0, 1))
        assert in_one_plane((flat - middle).astype(np.float32).astype(np.float64) + middle)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_a_fold_a_step_and_a_solid_are_not_flat(scale: float) -> None:
    fold = FACETS.copy()
    fold[1, 2, 2] = 1e-3
    step = np.concatenate([FACETS, np.add(FACETS, [0.0, 0.0, 1e-3])])
    beside = np.concatenate([FACETS, np.add(FACETS, [10.0, 0.0, 1e-3])])
    box = trimesh.creation.box()
    for corners in (fold, step, beside, divided(fold), box.vertices[box.faces]):
        assert not in_one_plane(moved(np.asarray(corners), scale))


def test_sheets_side_by_side_in_one_plane_are_flat() -> None:
    assert in_one_plane(moved(np.concatenate([FACETS, np.add(FACETS, [10.0, -7.0, 0.0])]), 1.0))
    assert in_one_plane(np.zeros((0, 3, 3)))
