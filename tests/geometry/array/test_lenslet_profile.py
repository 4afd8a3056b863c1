"""Profiles of lenslets: sag and slopes by mpmath, crossings by brute force, and how they are laid out over an array."""

import mpmath as mp
import numpy as np
import pytest

from lfmesh.errors import SceneError
from lfmesh.geometry.array.array_mesh import cell_mesh, mla_mesh
from lfmesh.geometry.array.lattice import Lattice
from lfmesh.geometry.array.lenslet_profile import (
    first_crossing,
    is_steeper,
    next_fall,
    profile_of,
    profile_shape,
)
from lfmesh.geometry.array.lenslets import face_normal, face_sag, faces_at, lenslets, shape_of, type_of
from lfmesh.geometry.ray import Ray

SQUARE = Lattice(False, 0.125, 5, 4)
HEXAGONAL = Lattice(True, 0.125, 5, 4)
CORNER = 0.09


def sag_slope_bend(c, k, terms, rho):
    """Sag, slope, and the larger second derivative along the meridian or across it; NaN beyond the end."""
    with np.errstate(invalid="ignore"):
        root = np.sqrt(1.0 - (1.0 + k) * (c * rho) ** 2)
    powers = [(4 + 2 * i, a) for i, a in enumerate(terms)]
    sag = c * rho**2 / (1.0 + root) + sum(a * rho**n for n, a in powers)
    across = c / root + sum(n * a * rho ** (n - 2) for n, a in powers)
    along = c / root**3 + sum(n * (n - 1) * a * rho ** (n - 2) for n, a in powers)
    return sag, across * rho, np.maximum(np.abs(across), np.abs(along))


def sag_at(c, k, terms, r2):
    """The sag alone, by the square of the radius, for brute force; NaN beyond the end."""
    with np.errstate(invalid="ignore"):
        root = np.sqrt(1.0 - (1.0 + k) * c**2 * r2)
    return c * r2 / (1.0 + root) + r2 * r2 * np.polyval(terms[::-1], r2)


def drawn_profile(seed, axis=None, wavy=1.0):
    """A random profile up to CORNER, its curvature, conic and terms; with `wavy` = 1 many of them turn back."""
    draw = np.random.default_rng(seed)
    curvature = draw.choice([-1, 1]) * draw.uniform(0.2, 0.8) / CORNER
    conic = draw.uniform(-6.0, 0.5)
    depth = abs(curvature) * CORNER**2 / 2
    terms = wavy * draw.uniform(-1, 1, 4) * depth / CORNER ** np.arange(4, 12, 2)
    one = np.array([curvature])
    return profile_of(one, np.array([conic]), terms[None], axis, CORNER, (1.0, 1.0)), curvature, conic, terms


@pytest.mark.parametrize("axis", [None, "x", "y"])
@pytest.mark.parametrize("seed", range(4))
def test_sag_and_slopes_are_those_of_the_formula_in_thirty_digits(seed, axis):
    profile, c, k, terms = drawn_profile(seed, axis)
    with mp.workdps(30):

        def sag(x, y):
            r2 = (0 if axis == "x" else mp.mpf(x) ** 2) + (0 if axis == "y" else mp.mpf(y) ** 2)
            z = c * r2 / (1 + mp.sqrt(1 - (1 + mp.mpf(k)) * mp.mpf(c) ** 2 * r2))
            return z + sum(mp.mpf(a) * r2 ** (j + 2) for j, a in enumerate(terms))

        for x, y in np.random.default_rng(seed).uniform(-0.06, 0.06, (5, 2)):
            truth = float(sag(x, y)), float(mp.diff(sag, (x, y), (1, 0))), float(mp.diff(sag, (x, y), (0, 1)))
            assert profile_shape(profile, 0, c, x, y) == pytest.approx(truth, rel=1e-13, abs=1e-16)


@pytest.mark.parametrize("seed", range(20))
def test_slopes_and_bends_stay_within_their_bounds(seed):
    profile, c, k, terms = drawn_profile(seed)
    rho = np.linspace(0.0, profile.domain, 20_011)
    sag, slope, bend = sag_slope_bend(np.asarray(c), k, terms, rho)
    assert profile.domain >= CORNER
    assert np.isfinite(sag).all()
    assert np.abs(slope).max() <= profile.steepest[0] <= 1.01 * np.abs(slope).max()
    assert bend.max() <= profile.bend[0] <= 1.01 * bend.max()
    # The second differences of the sag itself.
    step = rho[1]
    assert np.abs(np.diff(sag, 2)).max() / step**2 <= profile.bend[0] * (1 + 1e-3)


@pytest.mark.parametrize("seed", range(6))
def test_bounds_hold_for_all_curvatures_that_form_errors_make_and_depths_are_those_of_the_face(seed):
    one, c, k, terms = drawn_profile(seed)
    profile = profile_of(np.array([c]), one.conic, terms[None], None, CORNER, (0.8, 1.15))
    rho, bent = np.linspace(0.0, profile.domain, 4001), c * np.linspace(0.8, 1.15, 41)[:, None]
    _, slope, bend = sag_slope_bend(bent, k, terms, rho)
    assert np.abs(slope).max() <= profile.steepest[0] <= 1.01 * np.abs(slope).max()
    assert bend.max() <= profile.bend[0] <= 1.01 * bend.max()
    array = lenslets(SQUARE, np.array([1.0 / c]), 1.0, conic=(k,), asphere_mm=(terms,))
    sag = sag_slope_bend(c, k, terms, np.linspace(0.0, SQUARE.circumradius, 100_001))[0]
    assert array.top <= sag.min() <= array.top + 1e-5 * np.ptp(sag)
    assert array.valley >= sag.max() >= array.valley - 1e-5 * np.ptp(sag)


def brute_force(profile, c, p, d, side, end):
    """Distances at which a ray goes from either side to the other, by dense samples; in order."""
    t = np.linspace(0.0, end, 40_001)
    x, y = p[0] + t * d[0], p[1] + t * d[1]
    z = p[2] + t * d[2]
    r2 = profile.weight_x * x * x + profile.weight_y * y * y
    above = side * (sag_at(c, profile.conic[0], profile.terms[0], r2) - z) > 0.0
    return t[1:][above[:-1] != above[1:]]


@pytest.mark.parametrize("axis", [None, "y"])
def test_the_first_of_several_crossings_is_found(axis):
    several = found = 0
    for seed in range(250):
        profile, c, _, _ = drawn_profile(seed, axis, wavy=10.0)
        draw = np.random.default_rng([seed, 1])
        phi, side = draw.uniform(0, 2 * np.pi), draw.choice([-1.0, 1.0])
        # A chord of the cell from one point near the face to another: it may cross the face a few times.
        p = draw.uniform(0.5, 0.9) * CORNER * np.array([np.cos(phi), np.sin(phi), 0.0])
        q = draw.uniform(0.5, 0.9) * CORNER * np.array([np.cos(phi + 2.8), np.sin(phi + 2.8), 0.0])
        for point in (p, q):
            off = 0.3 * draw.normal() * abs(c) * CORNER**2
            point[2] = profile_shape(profile, 0, c, point[0], point[1])[0] + off
        if side * (profile_shape(profile, 0, c, p[0], p[1])[0] - p[2]) <= 0.0:
            continue
        truth = brute_force(profile, c, p, q - p, side, 1.0)
        met, t = first_crossing(profile, 0, c, Ray(*p, *(q - p)), side, 0.0, 1.0)
        assert met == bool(len(truth)), seed
        if met:
            found += 1
            several += len(truth) > 1
            assert abs(t - truth[0]) < 5e-5
            x, y, z = p + t * (q - p)
            assert abs(profile_shape(profile, 0, c, x, y)[0] - z) < 1e-15
            if is_steeper(profile, 0, *(q - p)):
                assert len(truth) == 1
    assert found > 40
    assert several > 4


def test_all_crossings_into_the_glass_are_found_along_a_line():
    most = 0
    for seed in range(150):
        profile, c, _, _ = drawn_profile(seed, None, wavy=3.0)
        draw = np.random.default_rng([seed, 2])
        ends = np.zeros((2, 3))
        ends[:, :2] = CORNER * np.array([[-0.9, 0.0], [0.9, 0.0]]) * draw.uniform(0.3, 1.0, (2, 1))
        for point in ends:
            point[2] = profile_shape(profile, 0, c, point[0], point[1])[0]
        p, way = ends[0], ends[1] - ends[0]
        layer = 1.5 * np.abs(ends[:, 2]).max()
        g = way[:2] / way[2]
        a = p[:2] - g * p[2]
        z = np.linspace(-layer, layer, 100_001)
        r2 = ((a[:, None] + g[:, None] * z) ** 2).sum(axis=0)
        above = sag_at(c, profile.conic[0], profile.terms[0], r2) > z
        inside = r2 <= profile.domain**2
        truth = z[1:][above[:-1] & ~above[1:] & inside[1:] & inside[:-1]]
        falls, side, begin = [], 0.0, -layer
        while True:
            crosses, begin, turned = next_fall(profile, 0, c, *a, *g, side, begin, layer)
            if not crosses:
                break
            assert turned > 0.0
            falls.append(begin)
            side = -1.0
        np.testing.assert_allclose(falls, truth, atol=1e-4 * layer)
        most = max(most, len(falls))
    assert most > 1


def test_a_ray_that_leaves_the_face_does_not_meet_it_at_its_start():
    for seed in range(200):
        profile, c, _, _ = drawn_profile(seed, None, wavy=0.0)
        draw = np.random.default_rng([seed, 3])
        x, y = draw.uniform(-0.5, 0.5, 2) * CORNER
        z, gx, gy = profile_shape(profile, 0, c, x, y)
        d = draw.normal(size=3)
        d /= np.linalg.norm(d)
        away = d[2] - gx * d[0] - gy * d[1]
        met, t = first_crossing(profile, 0, c, Ray(x, y, z, *d), -np.sign(away), 0.0, 0.05)
        # A conic bulges to one side: only a ray within it meets it once more.
        assert not met or t > 1e-9


ASPHERES = {"conic": (-1.4,), "asphere_mm": ((-60.0, 4000.0),)}


@pytest.mark.parametrize("lattice", [SQUARE, HEXAGONAL], ids=["square", "hexagonal"])
def test_an_array_of_equal_aspheres_is_one_closed_shell(lattice):
    of = lenslets(lattice, np.array([0.25]), 0.3, **ASPHERES)
    assert of.alike
    solid = mla_mesh(of)
    assert solid.is_watertight
    assert solid.is_volume
    assert solid.body_count == 1
    x, y, z = cell_mesh(of, 0).vertices.T
    near = np.hypot(x, y) < 0.5 * lattice.pitch
    assert near.sum() > 12
    for px, py, pz in zip(x[near], y[near], z[near], strict=True):
        assert face_sag(of, 0, 0, 4.0, px, py) == pytest.approx(pz, rel=1e-14, abs=1e-18)
        assert of.top <= pz <= of.valley


def test_types_have_their_own_profiles_and_errors_bend_the_radius_alone():
    of = lenslets(
        SQUARE, np.array([0.25, -0.3]), 0.3, decenter_mm=1e-3, radius_error=0.02, seed=5,
        conic=(-2.0, 0.3), asphere_mm=((), (10.0,)),
    )  # fmt: skip
    for column, row in ((0, 0), (1, 0), (3, 2)):
        kind = type_of(of, column, row)
        curvature, _, _ = shape_of(of, column, row)
        points = np.random.default_rng(column).uniform(-0.05, 0.05, (6, 2))
        z, normals = faces_at(of, kind, curvature, points)
        conic, term = ((-2.0, 0.0), (0.3, 10.0))[kind]
        r2 = (points**2).sum(axis=1)
        truth = curvature * r2 / (1 + np.sqrt(1 - (1 + conic) * curvature**2 * r2)) + term * r2**2
        np.testing.assert_allclose(z, truth, rtol=1e-14)
        for (x, y), at, normal in zip(points, z, normals, strict=True):
            np.testing.assert_allclose(face_normal(of, column, row, curvature, x, y, at), normal, rtol=1e-14)


@pytest.mark.parametrize("axis", ["x", "y"])
def test_each_cylinder_is_one_lenslet_over_its_whole_row_or_column(axis):
    of = lenslets(SQUARE, np.array([0.25, 0.3]), 0.3, decenter_mm=1e-3, radius_error=0.02, seed=5, cylinder_axis=axis)
    seen = set()
    for row in range(SQUARE.rows):
        for column in range(SQUARE.columns):
            first = (column, 0) if axis == "y" else (0, row)
            assert type_of(of, column, row) == type_of(of, *first) == max(first) % 2
            assert shape_of(of, column, row) == shape_of(of, *first)
            seen.add(shape_of(of, column, row)[0])
            along = (0.03, 0.05) if axis == "y" else (0.05, 0.03)
            other = (along[0], 0.0) if axis == "y" else (0.0, along[1])
            assert face_sag(of, column, row, 4.0, *along) == face_sag(of, column, row, 4.0, *other)
            assert face_sag(of, column, row, 4.0, *along) != face_sag(of, column, row, 4.0, *along[::-1])
    assert len(seen) == (SQUARE.columns if axis == "y" else SQUARE.rows)


def test_form_errors_that_end_a_conic_inside_its_cell_are_refused():
    assert lenslets(SQUARE, np.array([0.1]), 0.3, conic=(0.2,)).valley < 0.3
    with pytest.raises(SceneError, match="conic ends inside its cell"):
        lenslets(SQUARE, np.array([0.1]), 0.3, conic=(0.2,), decenter_mm=0.01)
    with pytest.raises(SceneError, match="cut through the flat face"):
        lenslets(SQUARE, np.array([0.25]), 0.05, asphere_mm=((1000.0,),))
