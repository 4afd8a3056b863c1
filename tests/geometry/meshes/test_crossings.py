"""Crossings of meshes, against edges that pass through facets and against many points of a surface."""

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from lfmesh.geometry.meshes.crossings import near_pairs, parts_in_shells, segments
from lfmesh.geometry.meshes.winding import winding

Array = NDArray[np.float64]

RNG = np.random.default_rng(7)
TOUCHING = 1e-5


def facets(mesh: trimesh.Trimesh) -> Array:
    """Corners of its facets."""
    return np.asarray(mesh.vertices, np.float64)[np.asarray(mesh.faces)]


def passes(edge: Array, facet: Array) -> bool:
    """Tell whether an edge passes through a facet, by the signs of volumes of tetrahedra."""

    def volume(*points: Array) -> float:
        return float(np.linalg.det(np.subtract(points[1:], points[0])))

    a, b, c = facet
    p, q = edge
    sides = [volume(p, q, *pair) > 0.0 for pair in ((a, b), (b, c), (c, a))]
    return len(set(sides)) == 1 and (volume(a, b, c, p) > 0.0) != (volume(a, b, c, q) > 0.0)


def test_facets_cross_where_an_edge_of_one_passes_through_the_other() -> None:
    one, other = RNG.normal(size=(40, 3, 3)), RNG.normal(size=(40, 3, 3))
    found = segments(one, other)
    truth = set()
    for i, a in enumerate(one):
        for j, b in enumerate(other):
            edges = [(a[[k, (k + 1) % 3]], b) for k in range(3)] + [(b[[k, (k + 1) % 3]], a) for k in range(3)]
            if any(passes(*each) for each in edges):
                truth.add((i, j))
    assert set(zip(found.own.tolist(), found.other.tolist(), strict=True)) == truth
    assert len(truth) > 50
    for corners, number in ((one, found.own), (other, found.other)):
        nearest = trimesh.triangles.closest_point(np.repeat(corners[number], 2, axis=0), found.ends.reshape(-1, 3))
        np.testing.assert_allclose(nearest, found.ends.reshape(-1, 3), atol=1e-12)


def test_pairs_of_near_facets_are_those_of_which_boxes_meet(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfmesh.geometry.meshes.crossings.AT_ONCE", 16)
    one, other = (RNG.normal(size=(200, 1, 3)) + 0.1 * RNG.normal(size=(200, 3, 3)) for _ in range(2))
    meet = (one.min(axis=1)[:, None] <= other.max(axis=1)) & (one.max(axis=1)[:, None] >= other.min(axis=1))
    truth = set(zip(*(each.tolist() for each in np.nonzero(meet.all(axis=2))), strict=True))
    assert {tuple(pair) for pair in near_pairs(one, other).tolist()} == truth


def test_parts_of_a_surface_are_those_that_its_points_find() -> None:
    """Balls and boxes in random places: 3,000 points of the surface miss no part that is not tiny."""
    for _ in range(4):
        makers = [lambda: trimesh.creation.icosphere(2), lambda: trimesh.creation.box((1.5, 1.2, 1.0))]
        bodies = []
        for maker in RNG.choice(makers, 4):
            mesh = maker()
            mesh.apply_transform(trimesh.transformations.random_rotation_matrix(RNG.random(3)))
            mesh.apply_translation(RNG.uniform(-0.8, 0.8, 3))
            bodies.append(facets(mesh))
        own, *shells = bodies
        points = np.einsum("nk,nki->ni", RNG.dirichlet(np.ones(3), 3_000), own[RNG.integers(0, len(own), 3_000)])
        inside = np.stack([winding(shell, points) != 0 for shell in shells], axis=1)
        drawn, counts = np.unique(inside, axis=0, return_counts=True)
        found = {tuple(row) for row in parts_in_shells(own, shells, TOUCHING)[0].tolist()}
        assert {tuple(row) for row in drawn.tolist()} <= found
        assert found <= {tuple(row) for row in drawn[counts > 0].tolist()} | _small_parts(own, shells, found)


def _small_parts(own: Array, shells: list[Array], found: set[tuple[bool, ...]]) -> set[tuple[bool, ...]]:
    """Combinations that points close to the segments find, which points of the whole surface may have missed."""
    ends = np.concatenate([segments(own, shell).ends.reshape(-1, 3) for shell in shells] + [np.zeros((0, 3))])
    number = np.concatenate([np.repeat(segments(own, shell).own, 2) for shell in shells] + [np.zeros(0, np.int64)])
    weights = RNG.dirichlet(np.ones(3), (len(ends), 8))
    spread = np.einsum("nqk,nki->nqi", weights, own[number])
    points = (ends[:, None] + 1e-3 * (spread - ends[:, None])).reshape(-1, 3)
    inside = np.stack([winding(shell, points) != 0 for shell in shells], axis=1)
    return {tuple(row) for row in np.unique(inside, axis=0).tolist()}


@pytest.mark.parametrize(
    ("width", "parts"),
    [
        (30.0, {(True, True)}),
        (36.0, {(True, True)}),
        (36.0 * (1.0 + 1e-9), {(True, True)}),
        (39.0, {(True, True), (True, False)}),
        (150.0, {(True, True), (True, False), (False, False)}),
    ],
)
def test_a_sheet_in_a_tank_is_in_what_it_reaches_into_not_in_what_it_touches(
    width: float, parts: set[tuple[bool, bool]]
) -> None:
    """A thin wall that no centre of a facet lies in is found; a wall that the sheet ends at to rounding is not."""
    wall, liquid = facets(trimesh.creation.box((40.0, 36.0, 20.0))), facets(trimesh.creation.box((36.0, 32.0, 16.0)))
    half = 0.5 * width
    corners = np.array([[-half, -10.0, 0.0], [half, -10.0, 0.0], [half, 10.0, 0.0], [-half, 10.0, 0.0]])
    found, _ = parts_in_shells(corners[[[0, 1, 2], [0, 2, 3]]], [wall, liquid], 20.0 * TOUCHING)
    assert {tuple(row) for row in found.tolist()} == parts


@pytest.mark.parametrize("seed", range(20))
def test_what_fills_an_open_box_in_any_pose_is_in_no_part_outside_of_it(seed: int) -> None:
    """The open ends lie in one plane but for rounding, where the line in which two planes meet is noise."""
    draw = np.random.default_rng(seed)
    turn = trimesh.transformations.random_rotation_matrix(draw.uniform(size=3))
    turn[:3, 3] = draw.uniform(-200.0, 200.0, 3)
    wall, liquid = trimesh.creation.box((100.0, 80.0, 60.0)), trimesh.creation.box((90.0, 70.0, 55.0))
    liquid.apply_translation([0.0, 0.0, 2.5])
    outer, inner = (facets(each.apply_transform(turn)) for each in (wall, liquid))
    assert parts_in_shells(inner, [outer], 100.0 * TOUCHING)[0].tolist() == [[True]]
    assert parts_in_shells(outer, [inner], 100.0 * TOUCHING)[0].tolist() == [[False]]


def test_a_surface_far_from_all_shells_is_in_none() -> None:
    ball = facets(trimesh.creation.icosphere(1))
    np.testing.assert_array_equal(parts_in_shells(ball, [ball + 5.0], TOUCHING)[0], [[False]])
