"""Exact surfaces against mpmath with 30 digits."""

import mpmath as mp
import numpy as np
import pytest

from lfmesh.geometry.ray import Ray
from lfmesh.geometry.surfaces.sag import normals, reach, sag, slope
from lfmesh.geometry.surfaces.surface import distance_to, half_slope_at, normal_at, sag_at, surface

SURFACES = {
    "plane": (np.inf, 0.0, ()),
    "sphere": (30.0, 0.0, ()),
    "concave sphere": (-25.0, 0.0, ()),
    "paraboloid": (40.0, -1.0, ()),
    "hyperboloid": (-35.0, -2.3, ()),
    "prolate ellipsoid": (50.0, -0.6, ()),
    "oblate ellipsoid": (60.0, 1.5, ()),
    "asphere": (45.0, -1.2, (3e-6, -2e-9, 4e-12)),
    "asphere on a plane": (np.inf, 0.0, (2e-5, -1e-8)),
    "oblate asphere": (-55.0, 0.8, (0.0, 5e-9)),
}
SEMI_DIAMETER = 12.0


@pytest.fixture(params=SURFACES)
def case(request):
    with mp.workdps(30):
        yield request.param


def exact_sag(case, r2):
    radius, conic, asphere = SURFACES[case]
    # The record holds the curvature in float64; it is the surface that is asked about.
    c = mp.mpf(0) if np.isinf(radius) else mp.mpf(1.0 / radius)
    z = c * r2 / (1 + mp.sqrt(1 - (1 + mp.mpf(conic)) * c * c * r2))
    return z + sum(mp.mpf(a) * r2 ** (i + 2) for i, a in enumerate(asphere))


def made(case):
    return surface(*SURFACES[case])


def test_sag_and_slope(case):
    of = made(case)
    for r in np.linspace(0.0, SEMI_DIAMETER, 13):
        z = exact_sag(case, mp.mpf(r) ** 2)
        tolerance = 8e-16 * (1e-3 + abs(float(z)))
        assert abs(sag(of, r) - z) < tolerance
        assert abs(sag_at(of, r * r) - exact_sag(case, mp.mpf(r * r))) < tolerance
        rate = mp.diff(lambda q: exact_sag(case, q**2), mp.mpf(r))
        assert abs(slope(of, r) - rate) < 2e-15 * (1 + abs(rate))
        assert abs(2 * half_slope_at(of, r * r) * r - rate) < 2e-15 * (1 + abs(rate))


def test_normal_is_the_unit_gradient_towards_plus_z(case):
    of = made(case)
    for x, y in np.random.default_rng(2).uniform(-8.0, 8.0, size=(10, 2)):
        gx = mp.diff(lambda q: exact_sag(case, q**2 + mp.mpf(y) ** 2), mp.mpf(x))  # noqa: B023
        gy = mp.diff(lambda q: exact_sag(case, q**2 + mp.mpf(x) ** 2), mp.mpf(y))  # noqa: B023
        length = mp.sqrt(1 + gx**2 + gy**2)
        truth = np.array([float(-gx / length), float(-gy / length), float(1 / length)])
        z = float(exact_sag(case, mp.mpf(x) ** 2 + mp.mpf(y) ** 2))
        np.testing.assert_allclose(normal_at(of, x, y, z), truth, atol=4e-16)
        np.testing.assert_allclose(normals(of, x, y), truth, atol=4e-16)


@pytest.mark.parametrize("displacement", [1e-6, 0.01, 0.3])
def test_distance_from_a_point_near_the_surface(case, displacement):
    """Near: where the ray crosses the facet. The error must be that of float64 coordinates."""
    of = made(case)
    rng = np.random.default_rng(3)
    for _ in range(30):
        x, y = rng.uniform(-8.0, 8.0, size=2)
        at = np.array([x, y, float(exact_sag(case, mp.mpf(x) ** 2 + mp.mpf(y) ** 2))])
        d = rng.normal(size=3) * [0.7, 0.7, 1.0]
        d /= np.linalg.norm(d)
        along = float(np.dot(normals(of, x, y), d))
        if abs(along) < 0.2:
            continue
        start = at - rng.uniform(-displacement, displacement) * d
        meets, t = distance_to(of, Ray(*start, *d), np.sign(along))
        assert meets
        s, e = [mp.mpf(q) for q in start], [mp.mpf(q) for q in d]

        def height(q, s=s, e=e):
            return s[2] + q * e[2] - exact_sag(case, (s[0] + q * e[0]) ** 2 + (s[1] + q * e[1]) ** 2)

        truth = mp.findroot(height, mp.mpf(t))
        assert abs(truth - mp.mpf(t)) < 6e-15 / abs(along)
        # The root nearest to the start, not another sheet.
        assert abs(truth) <= 1.5 * displacement


def test_of_several_crossings_the_one_next_to_the_start_is_returned():
    """A flat ray crosses the ring-shaped ridge of an asphere four times, in and out by turns."""
    ridge = surface(-6.0, -1.0, (1.8e-3,), semi_diameter=7.0)
    rng = np.random.default_rng(8)
    for _ in range(200):
        z, slope, aside = rng.uniform(-0.7, -0.4), rng.uniform(0.0, 0.02), rng.uniform(-2.0, 2.0)
        o, d = np.array([-9.0, aside, z]), np.array([1.0, 0.0, slope]) / np.hypot(1.0, slope)
        # z + q d_z = −r²/12 + 1.8e-3 r⁴ with r² = (x + q d_x)² + y²: a polynomial of the fourth degree in q.
        r2 = np.polynomial.Polynomial([o[0] ** 2 + aside**2, 2.0 * o[0] * d[0], d[0] ** 2])
        roots = (np.polynomial.Polynomial([z, d[2]]) + r2 / 12.0 - 1.8e-3 * r2**2).roots()
        roots = np.sort(roots[np.abs(roots.imag) < 1e-9].real)
        assert len(roots) == 4
        for number, root in enumerate(roots):
            sense = 1.0 if number % 2 == 0 else -1.0
            # Half-way to the next crossing Newton's method by itself runs away.
            gap = np.abs(np.delete(roots, number) - root).min()
            for off in (-1e-4, 1e-4, *(gap * np.array([-0.55, -0.5, -0.1, 0.1, 0.5, 0.55]))):
                start = o + (root + off) * d
                meets, t = distance_to(ridge, Ray(*start, *d), sense)
                assert meets
                assert abs(t + off) < 1e-12


@pytest.mark.parametrize("case", ["sphere", "concave sphere", "prolate ellipsoid", "oblate ellipsoid"])
def test_a_ray_that_passes_the_surface_by_is_told_so(case):
    radius, conic, _ = SURFACES[case]
    of = made(case)
    z = float(np.copysign(abs(radius) / (1.0 + conic), radius))
    assert not distance_to(of, Ray(reach(of) * 1.001, 0.0, z, 0.0, 0.0, 1.0), 1.0)[0]
    assert distance_to(of, Ray(reach(of) * 0.999, 0.0, z, 0.0, 0.0, 1.0), 1.0)[0]


def test_a_ray_beside_a_plane_does_not_meet_it():
    assert not distance_to(surface(np.inf), Ray(0.0, 0.0, 1e-3, 1.0, 0.0, 0.0), 1.0)[0]


def test_reach_is_where_the_conic_turns_back(case):
    radius, conic, _ = SURFACES[case]
    of = made(case)
    if np.isinf(radius) or conic <= -1.0:
        assert reach(of) == np.inf
    else:
        assert np.isfinite(sag(of, reach(of) * (1 - 1e-9)))
        assert np.isnan(sag(of, reach(of) * (1 + 1e-9)))
