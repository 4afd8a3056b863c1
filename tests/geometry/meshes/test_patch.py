"""Curved facets: what the patch goes through, how patches join, and where a ray meets one."""

import mpmath as mp
import numpy as np
import pytest

from lfmesh.geometry.meshes.mesh import Mesh
from lfmesh.geometry.meshes.patch import edge_curvature, hit_patch, neighbours, patch_points, patches
from lfmesh.geometry.ray import Ray
from lfmesh.geometry.surfaces.surface import surface
from lfmesh.geometry.surfaces.tessellation import cap

ASPHERE = surface(45.0, -1.2, (3e-6, -2e-9), semi_diameter=12.0)
CORNERS = np.array([0.0, 1.0, 1.0]), np.array([0.0, 0.0, 1.0])
"""η and ζ of a patch's three corners."""


@pytest.fixture(scope="module")
def mesh():
    return cap(ASPHERE, 6, 12.0)


def coefficients(mesh):
    return patches(mesh.vertices[mesh.faces], mesh.corner_normals)


def test_a_patch_goes_through_its_corners_with_their_normals(mesh):
    points, normals = patch_points(coefficients(mesh), *CORNERS)
    np.testing.assert_allclose(points, mesh.vertices[mesh.faces], rtol=0, atol=1e-14)
    # The edges' parabolas are square to the normals at both of their ends, so their tangents' product is the normal.
    np.testing.assert_allclose(normals, mesh.corner_normals, rtol=0, atol=1e-13)


def test_an_edge_is_a_parabola_square_to_the_normals_at_its_ends():
    draw = np.random.default_rng(1)
    start, end = draw.normal(size=(2, 500, 3))
    normals = np.array([0.0, 0.0, 1.0]) + 0.3 * draw.normal(size=(2, 500, 3))
    first, second = normals / np.linalg.norm(normals, axis=2, keepdims=True)
    c = edge_curvature(start, end, first, second)
    d = end - start
    # dx/dt = (d − c) + 2 c t at t = 0 and 1.
    scale = np.linalg.norm(d, axis=1) + np.linalg.norm(c, axis=1)
    assert np.abs(np.einsum("ij,ij->i", d - c, first) / scale).max() < 1e-13
    assert np.abs(np.einsum("ij,ij->i", d + c, second) / scale).max() < 1e-13


def edge_points(of, facet, edge, share):
    """Points along one edge of one patch; edge 0 runs from corner a to b, 1 from b to c, 2 from c to a."""
    eta = {0: share, 1: np.ones_like(share), 2: 1.0 - share}[edge]
    zeta = {0: np.zeros_like(share), 1: share, 2: 1.0 - share}[edge]
    return patch_points(of[facet][None], eta, zeta)[0][0]


def test_neighbours_share_the_parabola_of_their_edge(mesh):
    of, across = coefficients(mesh), neighbours(mesh.faces, mesh.corner_normals)
    share = np.linspace(0.0, 1.0, 9)
    joints = 0
    for facet, edge in np.argwhere(across >= 0):
        other = across[facet, edge]
        back = int(np.flatnonzero(across[other] == facet)[0])
        apart = edge_points(of, facet, edge, share) - edge_points(of, other, back, share)[::-1]
        assert np.abs(apart).max() < 1e-14
        joints += 1
    # Every edge has two facets but those of the rim.
    assert joints == 3 * len(mesh.faces) - 36
    chords = mesh.vertices[mesh.faces[:, [0, 1]]].mean(axis=1)
    middles = patch_points(of, np.array([0.5]), np.array([0.0]))[0][:, 0]
    assert np.linalg.norm(middles - chords, axis=1).min() > 1e-3  # curved edges, not the chords


def test_nothing_lies_across_a_crease():
    faces = np.array([[0, 1, 2], [1, 0, 3]])
    smooth = np.broadcast_to([0.0, 0.0, 1.0], (2, 3, 3))
    np.testing.assert_array_equal(neighbours(faces, smooth), [[1, -1, -1], [0, -1, -1]])
    sharp = np.array([[[0.0, 0.7071, 0.7071]] * 3, [[0.0, -0.7071, 0.7071]] * 3])
    assert (neighbours(faces, sharp) == -1).all()


def test_a_patch_between_equal_normals_is_the_plane_of_its_facet():
    draw = np.random.default_rng(2)
    corners = draw.normal(size=(50, 3, 3))
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    of = patches(corners, np.repeat(normal[:, None], 3, axis=1))
    np.testing.assert_array_equal(of[:, 3:], 0.0)
    across = np.full((50, 3), -1)
    for facet in range(50):
        b, c = 0.2, 0.3
        target = np.array([0.5, b, c]) @ corners[facet]
        d = draw.normal(size=3)
        d /= np.linalg.norm(d)
        met, t, *found = hit_patch(of, across, facet, b, c, Ray(*(target - 2.0 * d), *d))
        assert met
        assert abs(t - 2.0) * abs(d @ normal[facet]) < 1e-13
        assert np.abs(np.cross(found, normal[facet])).max() < 1e-13


def test_a_ray_meets_the_patch_where_30_digits_say(mesh):
    of, across = coefficients(mesh), neighbours(mesh.faces, mesh.corner_normals)
    draw = np.random.default_rng(3)
    compared = 0
    for facet in draw.choice(len(mesh.faces), 25, replace=False):
        corners = mesh.vertices[mesh.faces[facet]]
        weights = draw.dirichlet([4.0, 4.0, 4.0])
        d = np.array([*draw.uniform(-0.3, 0.3, 2), 1.0])
        d /= np.linalg.norm(d)
        o = weights @ corners - 3.0 * d
        met, t, *normal = hit_patch(of, across, facet, weights[1], weights[2], Ray(*o, *d))
        assert met
        with mp.workdps(30):
            rows = [[mp.mpf(float(value)) for value in row] for row in of[facet]]
            ray = [mp.mpf(float(v)) for v in o], [mp.mpf(float(v)) for v in d]

            def point(eta, zeta, rows=rows):
                basis = (1, eta, zeta, eta * zeta, eta**2, zeta**2)
                return [mp.fsum(b * row[axis] for b, row in zip(basis, rows, strict=True)) for axis in range(3)]

            def miss(eta, zeta, t, ray=ray, point=point):
                return [p - o - t * d for p, o, d in zip(point(eta, zeta), *ray, strict=True)]

            start = weights[1] + weights[2], weights[2], 3.0
            eta, zeta, truth = mp.findroot(miss, tuple(mp.mpf(float(s)) for s in start))
            if not 0 < zeta < eta < 1:
                continue  # the neighbour's
            by_eta = [mp.diff(lambda e, axis=a: point(e, zeta)[axis], eta) for a in range(3)]  # noqa: B023
            by_zeta = [mp.diff(lambda z, axis=a: point(eta, z)[axis], zeta) for a in range(3)]  # noqa: B023
            cross = np.cross(np.array(by_eta, float), np.array(by_zeta, float))
        assert abs(float(truth) - t) < 1e-13
        assert np.abs(cross / np.linalg.norm(cross) - normal).max() < 1e-13
        compared += 1
    assert compared >= 20


def test_a_root_beyond_the_edge_is_found_on_the_neighbour(mesh):
    """Rays that cross a facet within 1e-4 of its edge at a slope meet the curved surface over the next one."""
    of, across = coefficients(mesh), neighbours(mesh.faces, mesh.corner_normals)
    handed_on = 0
    for facet, edge in np.argwhere(across >= 0):
        corners = mesh.vertices[mesh.faces[facet]]
        weights = np.full(3, 0.5)
        weights[(edge + 2) % 3] = 1e-4
        weights /= weights.sum()
        other = across[facet, edge]
        outwards = mesh.vertices[mesh.faces[other]].mean(axis=0) - corners.mean(axis=0)
        # The surface stands before the chords: the ray, on its way back, has come from over the neighbour.
        d = np.array([0.0, 0.0, 1.0]) - 2.0 * outwards / np.linalg.norm(outwards)
        d /= np.linalg.norm(d)
        o = weights @ corners - 3.0 * d
        met, t, *normal = hit_patch(of, across, facet, weights[1], weights[2], Ray(*o, *d))
        there = hit_patch(of, across, other, 1.0 / 3.0, 1.0 / 3.0, Ray(*o, *d))
        alone = hit_patch(of, np.full_like(across, -1), facet, weights[1], weights[2], Ray(*o, *d))
        assert met
        if there[0] and alone[0] and abs(there[1] - alone[1]) > 1e-12:
            np.testing.assert_allclose([t, *normal], there[1:], rtol=0, atol=1e-13)
            handed_on += 1
    assert handed_on > 50


def test_a_rim_is_continued_by_half_a_patch_and_no_further():
    facet = Mesh(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]]), np.array([[0, 1, 2]]))
    of = patches(facet.vertices[facet.faces], np.broadcast_to([0.0, 0.0, 1.0], (1, 3, 3)))
    across = np.full((1, 3), -1)
    for beyond, expected in ((0.49, True), (0.51, False)):
        met, *_ = hit_patch(of, across, 0, 0.5, 0.0, Ray(0.5, -beyond, -1.0, 0.0, 0.0, 1.0))
        assert met == expected
