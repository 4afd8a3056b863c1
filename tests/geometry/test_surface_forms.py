"""Odd aspheres, biconics and toroids by themselves: roots against mpmath, ends, the bound of their meshes."""

from collections.abc import Callable
from typing import Any

import mpmath as mp
import numpy as np
import pytest

import lfmesh as lf
from lfmesh.geometry.lens.air_gaps import cap_on, circles_of
from lfmesh.geometry.ray import Ray
from lfmesh.geometry.surfaces.sag import gradients, heights, sag
from lfmesh.geometry.surfaces.surface import distance_to, form_at, is_revolved, normal_at, surface_of
from lfmesh.geometry.surfaces.tessellation import cap, chord_error, rim_radius

SURFACES: dict[str, dict[str, Any]] = {
    "odd": {"radius_mm": 40.0, "conic": -0.5, "odd_asphere_mm": (3e-4, -2e-6), "asphere_mm": (1e-6,)},
    "odd on a plane": {"odd_asphere_mm": (-4e-4, 0.0, 1e-9)},
    "biconic": {"radius_mm": 40.0, "conic": -1.4, "biconic": {"radius_x_mm": 21.0, "conic_x": 0.7}},
    "saddle": {"radius_mm": -60.0, "biconic": {"radius_x_mm": 33.0, "conic_x": -2.0}},
    "cylinder by biconic": {"radius_mm": -30.0, "conic": -1.0, "biconic": {"radius_x_mm": np.inf}},
    "toroid": {"radius_mm": 50.0, "conic": 0.4, "asphere_mm": (2e-6, -3e-9), "toroid": {"radius_x_mm": 25.0}},
    "hollow toroid": {"radius_mm": -45.0, "toroid": {"radius_x_mm": -20.0}},
    "toric saddle": {"radius_mm": 45.0, "toroid": {"radius_x_mm": -30.0}},
    "cylinder": {"radius_mm": 35.0, "toroid": {"radius_x_mm": np.inf}},
}
SEMI_DIAMETER = 12.0


def curvature(radius: float) -> mp.mpf:
    """Return the curvature that the record holds in float64."""
    return mp.mpf(0) if np.isinf(radius) else mp.mpf(1.0 / radius)


def exact(keys: dict[str, Any]) -> Callable[[Any, Any], Any]:
    """Return the sag of a surface in mpmath, written from the definitions."""
    c, k = curvature(keys.get("radius_mm", np.inf)), mp.mpf(keys.get("conic", 0.0))

    def curve(r2: Any) -> Any:
        z = c * r2 / (1 + mp.sqrt(1 - (1 + k) * c * c * r2))
        z += sum(mp.mpf(a) * r2 ** (j + 2) for j, a in enumerate(keys.get("asphere_mm", ())))
        return z + sum(mp.mpf(b) * mp.sqrt(r2) ** (2 * j + 3) for j, b in enumerate(keys.get("odd_asphere_mm", ())))

    def sag(x: Any, y: Any) -> Any:
        if "biconic" in keys:
            cx, kx = curvature(keys["biconic"]["radius_x_mm"]), mp.mpf(keys["biconic"].get("conic_x", 0.0))
            root = mp.sqrt(1 - (1 + kx) * cx * cx * x * x - (1 + k) * c * c * y * y)
            return (cx * x * x + c * y * y) / (1 + root)
        if "toroid" in keys:
            cx, f = curvature(keys["toroid"]["radius_x_mm"]), curve(y * y)
            return f if cx == 0 else 1 / cx - mp.sign(cx) * mp.sqrt((1 / cx - f) ** 2 - x * x)
        return curve(x * x + y * y)

    return sag


@pytest.fixture(params=SURFACES)
def case(request):
    with mp.workdps(40):
        yield SURFACES[request.param]


def record_of(keys: dict[str, Any]) -> np.void:
    return surface_of(lf.Surface(**keys, semi_diameter_mm=SEMI_DIAMETER, index=1.5), semi_diameter=SEMI_DIAMETER)


def test_height_and_gradient_are_those_of_the_definition(case):
    """To the last digits, in kernels and in numpy; the normal is the unit gradient, and the axis is no exception."""
    of, truth = record_of(case), exact(case)
    places = np.vstack([np.random.default_rng(1).uniform(-8.4, 8.4, (15, 2)), [[0.0, 5.0], [-5.0, 0.0], [1e-9, 1e-9]]])
    for x, y in places:
        z = truth(mp.mpf(x), mp.mpf(y))
        by_x, by_y = (mp.diff(truth, (mp.mpf(x), mp.mpf(y)), n) for n in ((1, 0), (0, 1)))
        found = form_at(of, x, y)
        np.testing.assert_allclose(found, [float(z), float(by_x), float(by_y)], rtol=0, atol=3e-15)
        np.testing.assert_allclose([heights(of, x, y), *gradients(of, x, y)], found, rtol=0, atol=3e-15)
        normal = np.array([-float(by_x), -float(by_y), 1.0]) / float(mp.sqrt(1 + by_x**2 + by_y**2))
        np.testing.assert_allclose(normal_at(of, x, y, found[0]), normal, rtol=0, atol=3e-15)
    assert form_at(of, 0.0, 0.0) == (0.0, 0.0, 0.0)
    if not is_revolved(of):
        with pytest.raises(TypeError, match="no sag by radius alone"):
            sag(of, 1.0)


@pytest.mark.parametrize("displacement", [1e-6, 0.01, 0.3])
def test_distance_from_a_point_near_the_surface(case, displacement):
    """The root next to the start, in both senses, with the error of float64 coordinates."""
    of, truth = record_of(case), exact(case)
    draw = np.random.default_rng(3)
    for _ in range(25):
        x, y = draw.uniform(-8.0, 8.0, 2)
        at = np.array([x, y, float(truth(mp.mpf(x), mp.mpf(y)))])
        d = draw.normal(size=3) * [0.7, 0.7, 1.0]
        d /= np.linalg.norm(d)
        along = float(np.dot(normal_at(of, *at), d))
        if abs(along) < 0.2:
            continue
        start = at - draw.uniform(-displacement, displacement) * d
        meets, t = distance_to(of, Ray(*start, *d), np.sign(along))
        assert meets
        s, e = [mp.mpf(q) for q in start], [mp.mpf(q) for q in d]
        root = mp.findroot(lambda q: s[2] + q * e[2] - truth(s[0] + q * e[0], s[1] + q * e[1]), mp.mpf(t))  # noqa: B023
        assert abs(root - mp.mpf(t)) < 8e-15 / abs(along)
        assert abs(root) <= 1.5 * displacement


@pytest.mark.parametrize("seed", range(8))
def test_a_surface_exists_up_to_its_reach_and_ends_there(seed):
    """At every azimuth below the reach; at some azimuth a little above it does not. There it goes on without a step."""
    draw = np.random.default_rng(seed)
    radius, across = draw.choice([-1.0, 1.0], 2) * draw.uniform(5.0, 20.0, 2)
    conic = float(draw.uniform(-0.9, 2.0))
    keys = {"radius_mm": radius, "conic": conic}
    keys |= {"toroid": {"radius_x_mm": across}} if seed % 2 else {"biconic": {"radius_x_mm": across, "conic_x": 0.3}}
    if seed % 4 == 3:
        # The circle shrinks along y within a narrow stretch of the curve.
        keys |= {"conic": -1.0, "asphere_mm": (0.0, 0.0, 2.0 * np.sign(across) * 8.0**-8)}
    prescribed = lf.Surface(**keys, semi_diameter_mm=1.0, index=1.5)
    of, reach = surface_of(prescribed, semi_diameter=1.0), prescribed.reach_mm
    phi = np.linspace(0.0, 2.0 * np.pi, 7201)
    assert np.isfinite(heights(of, reach * (1 - 1e-9) * np.cos(phi), reach * (1 - 1e-9) * np.sin(phi))).all()
    assert np.isnan(heights(of, reach * (1 + 2e-4) * np.cos(phi), reach * (1 + 2e-4) * np.sin(phi))).any()
    for angle in phi[::600]:
        # The height is continuous through the end, where it goes as the root of the distance.
        z = [form_at(of, reach * f * np.cos(angle), reach * f * np.sin(angle))[0] for f in (1 - 1e-8, 1.0, 1 + 1e-4)]
        assert np.isfinite(z).all()
        assert max(abs(np.diff(z))) < 0.1 * reach


@pytest.mark.parametrize("rings", [5, 12])
def test_the_bound_of_the_mesh_holds(case, rings):
    """Sampled all over every facet; the bound is no more than some times the largest deviation."""
    of = record_of(case)
    rim = rim_radius(of, rings)
    mesh = cap(of, rings, rim)
    grid = np.array([(i, j, 8 - i - j) for i in range(9) for j in range(9 - i)]) / 8.0
    p = np.einsum("gk,fkj->fgj", grid, mesh.vertices[mesh.faces]).reshape(-1, 3)
    deviation = np.abs(p[:, 2] - heights(of, p[:, 0], p[:, 1])).max()
    bound = chord_error(of, rings, rim)
    assert deviation <= bound < 4.0 * deviation


def test_meshes_of_close_toroids_stay_apart():
    """Two alike, 2 µm apart in a hollow: between them every vertex and middle of a facet has its own side."""
    own = {"radius_mm": 30.0, "toroid": {"radius_x_mm": 22.0}, "semi_diameter_mm": 6.0}
    lens = [
        {"thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 6.0, "stop": True},
        {**own, "thickness_mm": 0.002},
        {**own, "thickness_mm": 3.0, "index": 1.6},
        {"semi_diameter_mm": 6.0},
    ]
    records = np.array(
        [
            surface_of(lf.Surface(**s), vertex_z=z, semi_diameter=6.0)
            for s, z in zip(lens, (0, 3, 3.002, 6.002), strict=True)
        ]
    )
    circles = circles_of(records, 5)
    assert circles[1].counts[-1] == circles[2].counts[-1]
    for k, sense in ((1, 1.0), (2, -1.0)):
        mesh = cap_on(records[k], circles[k])
        middles = mesh.vertices[mesh.faces].mean(axis=1)
        inside = np.hypot(middles[:, 0], middles[:, 1]) < 6.0
        gap_middle = 3.001 + heights(records[k], middles[:, 0], middles[:, 1])
        assert (sense * (gap_middle - middles[:, 2])[inside] > 0.0).all()
