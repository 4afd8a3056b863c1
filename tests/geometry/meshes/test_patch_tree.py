"""Bounds of the second derivatives of curved patches over their facets."""

from typing import Any

import numpy as np
import pytest

from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.meshes.patch import patches
from lfmesh.geometry.meshes.patch_tree import patch_tree


def tree_of(corners: Array, normals: Array) -> Any:
    """Return the tree of facets with normals, (m, 3, 3) each."""
    bodies = np.zeros(len(corners), np.int64)
    return patch_tree(patches(corners, normals), corners, bodies, np.ones(len(corners), np.bool_))


def random_facets(seed: int, count: int, bend: float) -> tuple[Array, Array]:
    """Return facets near an equilateral one whose corners lie on random quadratic surfaces, and normals of these."""
    rng = np.random.default_rng(seed)
    angle = 2.0 * np.pi * np.arange(3) / 3.0
    corners = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1) + rng.normal(0.0, 0.15, (count, 3, 3))
    form = rng.normal(0.0, bend, (count, 2, 2))
    slope = np.einsum("mki,mij->mkj", corners[..., :2], form + form.transpose(0, 2, 1))
    corners[..., 2] = 0.5 * np.einsum("mki,mki->mk", corners[..., :2], slope)
    normals = np.concatenate([-slope, np.ones((count, 3, 1))], axis=2)
    return corners, normals / np.linalg.norm(normals, axis=2, keepdims=True)


def heights(patch: Any, x: Array, y: Array) -> Array:
    """Return the height of a patch over places of its facet's plane, by Newton's method."""
    eta, zeta = np.einsum("ij,jk->ik", patch["inverse"], np.stack([x, y]))
    basis: Any = lambda p, q: np.stack([np.ones_like(p), p, q, p * q, p * p, q * q])  # noqa: E731
    for _ in range(12):
        at = patch["shape"].T @ basis(eta, zeta)
        by_eta = patch["shape"].T @ np.stack([0 * eta, 1 + 0 * eta, 0 * eta, zeta, 2 * eta, 0 * eta])
        by_zeta = patch["shape"].T @ np.stack([0 * eta, 0 * eta, 1 + 0 * eta, eta, 0 * eta, 2 * zeta])
        determinant = by_eta[0] * by_zeta[1] - by_zeta[0] * by_eta[1]
        eta = eta - ((at[0] - x) * by_zeta[1] - (at[1] - y) * by_zeta[0]) / determinant
        zeta = zeta - ((at[1] - y) * by_eta[0] - (at[0] - x) * by_eta[1]) / determinant
    return np.asarray((patch["shape"].T @ basis(eta, zeta))[2])


@pytest.mark.parametrize(("typical", "close"), [(0.005, 0.1), (0.02, np.inf), (0.05, np.inf), (0.12, np.inf)])
def test_bends_bound_the_second_differences_of_heights_everywhere_between_the_edges(
    typical: float, close: float
) -> None:
    """By brute force along random lines, for patches that hardly turn and for those with uneven bends.

    Bounds of the former are close.
    """
    tree = tree_of(*random_facets(1, 24, typical))
    rng, step, checked = np.random.default_rng(2), 1e-3, 0
    assert len(tree.patches) > 20
    for patch in tree.patches:
        x, y = rng.uniform(-2.5, 2.5, (2, 2000))
        turn = rng.uniform(0.0, np.pi, len(x))
        dx, dy = step * np.cos(turn), step * np.sin(turn)
        edges = patch["edges"]
        inside = (edges[:, :1] * x + edges[:, 1:2] * y + step < edges[:, 2:]).all(axis=0)
        x, y, dx, dy = (each[inside] for each in (x, y, dx, dy))
        z = [heights(patch, x + k * dx, y + k * dy) for k in (-1, 0, 1)]
        bend = (z[0] - 2.0 * z[1] + z[2]) / step**2
        rounding = 1e-14 / step**2
        assert bend.max() <= patch["most_bend"] + rounding
        assert bend.min() >= patch["least_bend"] - rounding
        size = np.abs(bend).max()
        assert patch["most_bend"] <= max(bend.max(), 0.0) + close * size
        assert patch["least_bend"] >= min(bend.min(), 0.0) - close * size
        checked += len(x)
    assert checked > 2000


def test_bends_of_a_gently_curved_sphere_are_bounded_closely() -> None:
    """A facet a tenth of the radius across bends as the sphere does, which 1/radius says."""
    corners = np.array([[[0.3, -0.2, 0.0], [1.3, -0.2, 0.0], [0.8, 0.7, 0.0]]])
    corners[..., 2] = np.sqrt(100.0 - (corners[..., :2] ** 2).sum(axis=-1))
    tree = tree_of(corners, corners / 10.0)
    assert -0.11 < tree.patches["least_bend"][0] < -0.099
