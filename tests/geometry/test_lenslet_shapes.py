"""The array's shape: one cell is exact, the whole array is a closed solid of the right volume."""

import mpmath as mp
import numpy as np
import pytest

from lfmesh.errors import SceneError
from lfmesh.geometry.array.array_mesh import cell_mesh, cell_pattern, mla_mesh
from lfmesh.geometry.array.lattice import Lattice, neighbour
from lfmesh.geometry.array.lenslets import cap_sag, lenslets, shape_of, type_of
from lfmesh.geometry.meshes.mesh import facet_normals

SQUARE = Lattice(False, 0.125, 5, 4)
HEXAGONAL = Lattice(True, 0.125, 5, 4)
BOTH = pytest.mark.parametrize("lattice", [SQUARE, HEXAGONAL], ids=["square", "hexagonal"])


def volume_under_cap(lattice, radius):
    """Integral of the sag over one cell, from polar coordinates over one fan of it."""
    sides = 6 if lattice.hexagonal else 4
    half = lattice.pitch / 2

    def ray(phi):
        rho = half / mp.cos(phi)
        # The integral of z r dr from 0 to rho in closed form; for R > 0, z = R - sqrt(R² - r²).
        convex = abs(radius) * rho**2 / 2 + ((radius**2 - rho**2) ** 1.5 - abs(radius) ** 3) / 3
        return mp.sign(radius) * convex

    return float(2 * sides * mp.quad(ray, [0, mp.pi / sides]))


@BOTH
def test_pattern_tiles_the_cell(lattice):
    points, faces = cell_pattern(lattice, 6)
    a, b, c = np.moveaxis(points[faces], 1, 0)
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    assert (area > 0).all()
    assert area.sum() == pytest.approx(lattice.cell_area, rel=1e-13)
    edges = {frozenset(edge) for f in faces.tolist() for edge in (f[:2], f[1:], f[::2])}
    assert len(points) - len(edges) + len(faces) == 1  # Euler: no seam is left open


@BOTH
@pytest.mark.parametrize("radius", [0.25, -0.2])
def test_cell_mesh_lies_on_the_sphere_with_its_neighbours_rims(lattice, radius):
    of = lenslets(lattice, np.array([radius]), 0.3)
    mesh = cell_mesh(of, 0)
    normal, area = facet_normals(mesh)
    assert (normal[:, 2] > 0).all()
    corner = mesh.vertices[mesh.faces]
    inside = np.linalg.norm(mesh.vertices[:, :2], axis=1) < 0.5 * lattice.pitch
    x, y, z = mesh.vertices[inside].T
    np.testing.assert_allclose(x * x + y * y + (z - radius) ** 2, radius**2, rtol=1e-14)
    # Exact normals point to the centre of curvature of a convex lenslet, away from that of a concave one.
    cell = np.linalg.norm(corner[:, :, :2], axis=2).max(axis=1) < 0.5 * lattice.pitch
    to_centre = (np.array([0, 0, radius]) - corner[cell]) / radius
    np.testing.assert_allclose(mesh.corner_normals[cell], to_centre, atol=1e-14)
    # More than the cell, and less than all nine.
    assert lattice.cell_area * 1.1 < (area * normal[:, 2]).sum() < lattice.cell_area * 4


@BOTH
@pytest.mark.parametrize("radius", [0.25, -0.2])
def test_an_array_of_equal_lenslets_is_one_closed_shell_of_the_right_volume(lattice, radius):
    of = lenslets(lattice, np.array([radius]), 0.3)
    assert of.alike
    truth = lattice.rows * lattice.columns * (0.3 * lattice.cell_area - volume_under_cap(lattice, radius))
    errors = []
    for subdivisions in (4, 8, 16):
        solid = mla_mesh(of, subdivisions)
        assert solid.is_watertight
        assert solid.is_winding_consistent
        assert solid.is_volume
        assert solid.body_count == 1
        errors.append(abs(solid.volume / truth - 1))
    np.testing.assert_allclose(np.log2(np.divide(errors[:-1], errors[1:])), 2.0, atol=0.1)


@BOTH
@pytest.mark.parametrize(
    ("radii", "errors"),
    [((0.25, 0.3), {}), ((0.25, 0.3, -0.2), {}), ((0.25,), {"decenter_mm": 2e-3, "radius_error": 0.02})],
    ids=["two types", "three types", "form errors"],
)
def test_unlike_lenslets_are_closed_prisms_side_by_side(lattice, radii, errors):
    of = lenslets(lattice, np.array(radii), 0.3, seed=3, **errors)
    assert not of.alike
    solid = mla_mesh(of)
    assert solid.is_watertight
    assert solid.is_winding_consistent
    assert solid.is_volume
    assert solid.body_count == lattice.rows * lattice.columns
    curved = solid.vertices[solid.vertices[:, 2] < 0.3, 2]
    assert of.top - 1e-15 <= curved.min()
    assert curved.max() <= of.valley + 1e-15


def test_no_two_neighbours_are_of_a_kind():
    for lattice, types, sides in ((HEXAGONAL, 3, 6), (SQUARE, 2, 4)):
        of = lenslets(lattice._replace(columns=9, rows=9), np.linspace(0.25, 0.3, types), 0.3)
        for column in range(9):
            for row in range(9):
                kind = type_of(of, column, row)
                assert 0 <= kind < types
                around = [type_of(of, *neighbour(lattice, column, row, side)) for side in range(sides)]
                assert kind not in around


@BOTH
@pytest.mark.parametrize("types", [2, 3])
def test_types_share_the_array_evenly(lattice, types):
    of = lenslets(lattice._replace(columns=12, rows=12), np.linspace(0.25, 0.3, types), 0.3)
    count = np.bincount([type_of(of, c, r) for c in range(12) for r in range(12)], minlength=types)
    np.testing.assert_array_equal(count, 144 // types)


@pytest.mark.parametrize(
    ("errors", "message"),
    [
        ({"radius_error": 0.1}, "sphere ends inside its cell"),
        ({"radius_error": 0.8}, "sphere ends inside its cell"),
        ({"decenter_mm": 0.01}, "sphere ends inside its cell"),
        ({"thickness_mm": 0.05}, "cut through the flat face"),
    ],
)
def test_lenslets_that_are_no_caps_over_their_cells_are_refused(errors, message):
    radius = 0.09  # the corners of the cell lie at 0.0884 mm
    assert lenslets(SQUARE, np.array([radius]), 0.3).valley == pytest.approx(0.0730, abs=1e-4)
    with pytest.raises(SceneError, match=message):
        lenslets(SQUARE, np.array([radius]), **{"thickness_mm": 0.3, **errors})


def test_form_errors_have_the_rms_asked_for_and_do_not_disturb_each_other():
    lattice = SQUARE._replace(columns=100, rows=100)
    both = lenslets(lattice, np.array([0.25]), 0.3, decenter_mm=1e-3, radius_error=0.01, seed=5)
    moved = lenslets(lattice, np.array([0.25]), 0.3, decenter_mm=1e-3, seed=5)
    bent = lenslets(lattice, np.array([0.25]), 0.3, radius_error=0.01, seed=5)
    # Relative standard error of an rms over 10,000: 0.7 % (normal), 0.5 % (radial of two).
    assert np.sqrt((both.decentre**2).sum(axis=1).mean()) == pytest.approx(1e-3, rel=0.03)
    assert (1.0 / both.stretch - 1.0).std() == pytest.approx(0.01, rel=0.03)
    np.testing.assert_array_equal(both.decentre, moved.decentre)
    np.testing.assert_array_equal(both.stretch, bent.stretch)
    other = lenslets(lattice, np.array([0.25]), 0.3, decenter_mm=1e-3, seed=6)
    assert not np.array_equal(other.decentre, moved.decentre)


def test_shape_of_a_lenslet_is_its_types_with_its_own_errors():
    of = lenslets(SQUARE, np.array([0.25, 0.3]), 0.3, decenter_mm=1e-3, radius_error=0.01, seed=5)
    cell = 2 * SQUARE.columns + 3
    kind = type_of(of, 3, 2)
    expected = (of.stretch[cell] / (0.25, 0.3)[kind], *of.decentre[cell])
    assert shape_of(of, 3, 2) == pytest.approx(expected, rel=1e-15)


def test_cap_sag_is_that_of_a_sphere():
    with mp.workdps(30):
        for c in (4.0, -3.0):
            for r in (0.0, 1e-6, 0.05, 0.2):
                truth = (1 - mp.sqrt(1 - (mp.mpf(c) * mp.mpf(r)) ** 2)) / mp.mpf(c)
                assert cap_sag(c, r * r) == pytest.approx(float(truth), rel=4e-16)
