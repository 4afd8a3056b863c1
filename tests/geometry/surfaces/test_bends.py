"""Second derivatives of exact surfaces stay within their bounds, which are close."""

import numpy as np
import pytest

from lfmesh.geometry import frame
from lfmesh.geometry.surfaces.bends import BEFORE_END, box_of, height_range, rim_hull, rim_range, set_bends
from lfmesh.geometry.surfaces.sag import gradients, heights
from lfmesh.geometry.surfaces.surface import BICONIC, CONIC_AND_EVEN, TOROID, put_in_pose, surface
from lfmesh.scene.camera.sections import toroid_reach_mm

BENT = {
    "sphere": surface(30.0),
    "asphere": surface(30.0, 0.0, (3e-6,)),
    "asphere that turns": surface(30.0, 0.0, (-1e-4,)),
    "cylinder along x": surface(30.0, kind=BICONIC, radius_x_mm=np.inf),
    "cylinder along y": surface(np.inf, kind=BICONIC, radius_x_mm=30.0),
}


@pytest.mark.parametrize("name", BENT)
def test_bends_bound_the_second_derivatives_in_all_directions_and_not_by_much(name):
    """Of a sphere and a r⁴ along the meridian and across it, in closed form: z″ and z′/r; of a cylinder 0 across."""
    of, rim, c, a = BENT[name].copy(), 10.0, 1.0 / 30.0, {"asphere": 3e-6, "asphere that turns": -1e-4}.get(name, 0.0)
    set_bends(of, rim)
    r = np.linspace(0.0, rim, 5001)
    root = np.sqrt(1.0 - (c * r) ** 2)
    along, across = c / root**3 + 12.0 * a * r**2, c / root + 4.0 * a * r**2
    if "cylinder" in name:
        across = 0.0 * r
    least, most = min(along.min(), across.min()), max(along.max(), across.max())
    assert most < of["most_bend"] < 1.06 * most
    if least < 0.0:
        assert 1.06 * least < of["least_bend"] < least
    else:
        assert of["least_bend"] > -1e-9


def test_bends_of_surfaces_of_revolution_are_bounded_between_all_samples_too():
    """High powers that cancel but for a narrow zone: closed forms at 200,001 radii lie within, and closely."""
    of = surface(30.0, -0.7, (1e-5, -4e-7, 5e-9, -2e-11), odd_mm=(2e-4,))
    set_bends(of, 10.0)
    r = np.linspace(0.0, float(of["domain"]), 200_001)
    root = np.sqrt(1.0 - 0.3 * (r / 30.0) ** 2)
    powers = {4: 1e-5, 6: -4e-7, 8: 5e-9, 10: -2e-11, 3: 2e-4}
    across = 1.0 / 30.0 / root + sum(n * a * r ** (n - 2) for n, a in powers.items())
    along = 1.0 / 30.0 / root**3 + sum(n * (n - 1) * a * r ** (n - 2) for n, a in powers.items())
    least, most = min(along.min(), across.min()), max(along.max(), across.max())
    spread = 0.02 * (most - least)
    assert least - spread < of["least_bend"] <= least
    assert most <= of["most_bend"] < most + spread


def drawn_surface(draw, kind):
    """Return a biconic, or a toroid with terms along its curve, and a radius inside its end."""
    radii, conics = draw.choice([-1.0, 1.0], 2) * draw.uniform(12.0, 60.0, 2), draw.uniform(-3.0, 0.8, 2)
    if kind == BICONIC:
        return surface(radii[0], conics[0], kind=kind, radius_x_mm=radii[1], conic_x=conics[1]), draw.uniform(2.0, 8.5)
    terms = draw.normal(size=4) * 0.003 / 8.0 ** np.arange(3, 10, 2)
    of = surface(radii[0], conics[0], terms, kind=kind, radius_x_mm=radii[1])
    powers = [(4 + 2 * n, float(a)) for n, a in enumerate(terms)]
    of["end"] = toroid_reach_mm(1.0 / radii[1], 1.0 / radii[0], conics[0], powers, 8.9)
    return of, draw.uniform(2.0, 8.5)


def sampled_bends(of):
    """Return the least and the largest second derivative at 36,000 places, by differences of slopes."""
    domain = float(of["domain"])
    step = 1e-5 * domain
    r, phi = np.sqrt(np.linspace(0.0, (1.0 - 2e-5) ** 2, 400))[:, None] * domain, np.linspace(0.0, 0.5 * np.pi, 91)
    x, y = r * np.cos(phi), r * np.sin(phi)
    xx, yx = (np.subtract(*pair) for pair in zip(*(gradients(of, x + s, y) for s in (step, -step)), strict=True))
    xy, yy = (np.subtract(*pair) for pair in zip(*(gradients(of, x, y + s) for s in (step, -step)), strict=True))
    mean, half = 0.5 * (xx + yy) / (2.0 * step), 0.5 * np.hypot(xx - yy, xy + yx) / (2.0 * step)
    return (mean - half).min(), (mean + half).max()


@pytest.mark.parametrize("kind", [BICONIC, TOROID])
def test_bends_of_biconics_and_toroids_bound_those_at_all_samples_and_not_by_much(kind):
    draw = np.random.default_rng(kind)
    for _ in range(60):
        of, rim = drawn_surface(draw, kind)
        set_bends(of, rim)
        least, most = sampled_bends(of)
        size = max(abs(least), abs(most))
        assert least - 0.05 * size < of["least_bend"] < least + 1e-6 * size
        assert most - 1e-6 * size < of["most_bend"] < most + 0.05 * size


@pytest.mark.parametrize("radius_x_mm", [10.0, 20.0])
def test_the_bends_of_a_biconic_are_bounded_up_to_its_end(radius_x_mm):
    """They grow as (1 − r²/R²)^(−3/2) there: samples a step further in are a third of those at the end."""
    of = surface(10.0, kind=BICONIC, radius_x_mm=radius_x_mm)
    set_bends(of, 11.0)
    domain = 10.0 * (1.0 - BEFORE_END)
    root2 = (1.0 - domain / 10.0) * (1.0 + domain / 10.0)
    assert of["domain"] == pytest.approx(domain)
    assert 0.1 / root2**1.5 <= of["most_bend"] * (1.0 + 1e-9) < 1.05 * 0.1 / root2**1.5
    assert of["least_bend"] >= 0.0


def test_convex_toroids_bend_nowhere_the_other_way():
    """Light that leaves one need not be followed back to it: an exact zero, for cylinders too."""
    for radius_mm, radius_x_mm in ((30.0, 20.0), (10.0, 15.0), (15.0, np.inf), (np.inf, 15.0)):
        of = surface(radius_mm, kind=TOROID, radius_x_mm=radius_x_mm)
        set_bends(of, 8.0)
        assert of["least_bend"] >= 0.0


@pytest.mark.parametrize("kind", [CONIC_AND_EVEN, BICONIC, TOROID])
def test_heights_lie_within_their_bounds_which_are_close(kind):
    draw = np.random.default_rng(10 + kind)
    for _ in range(30):
        of, rim = drawn_surface(draw, max(kind, BICONIC))
        if kind == CONIC_AND_EVEN:
            of = surface(20.0, draw.uniform(-3.0, 0.8), draw.normal(size=4) / 8.0 ** np.arange(3, 10, 2))
        low, high = height_range(of, rim)
        r, phi = np.linspace(0.0, rim * (1.0 - 1e-12), 801)[:, None], np.linspace(0.0, 0.5 * np.pi, 181)
        z = heights(of, r * np.cos(phi), r * np.sin(phi))
        assert low <= z.min() < low + 1e-3 * np.ptp(z)
        assert high >= z.max() > high - 1e-3 * np.ptp(z)


def test_boxes_of_aspheres_hold_the_crests_between_all_samples_too():
    """In closed form z = c r²/2 + a r⁴ is highest where r² = −c / (4 a), at −c² / (16 a)."""
    for crest in (0.31234567, 0.71234567, 0.51234567):
        c = 0.05
        a = -c / (4.0 * (crest * 8.0) ** 2)
        top = -(c**2) / (16.0 * a)
        assert top <= box_of(surface(1.0 / c, -1.0, (a,)), 8.0)[:, 2].max() < 1.001 * top


def test_boxes_of_turned_spheres_hold_the_points_that_bulge_between_vertex_and_rim():
    """A sphere of radius R reaches R from its centre along each axis on which its normal points inside the rim."""
    radius, rim, vertex_z = 30.0, 9.0, 4.0
    for tilt_deg in (0.1, 2.0, 8.0, 15.0):
        of = surface(radius)
        of["vertex_z"] = vertex_z
        put_in_pose(of, frame.frame((tilt_deg, 0.0, 0.0), (0.3, -0.2, 0.1)))
        turn, shift = of["pose"][:, :3], of["pose"][:, 3]
        centre = turn @ [0.0, 0.0, vertex_z + radius] + shift
        assert radius * np.sin(np.radians(tilt_deg)) < rim
        low = box_of(of, rim)[:, 2].min()
        assert centre[2] - radius - 1e-3 < low <= centre[2] - radius


@pytest.mark.parametrize("kind", [CONIC_AND_EVEN, BICONIC, TOROID])
def test_boxes_hold_posed_surfaces_and_are_close_round_those_of_revolution(kind):
    draw = np.random.default_rng(40 + kind)
    for _ in range(6):
        of, rim = drawn_surface(draw, max(kind, BICONIC))
        if kind == CONIC_AND_EVEN:
            of = surface(20.0, draw.uniform(-3.0, 0.8), draw.normal(size=4) / 8.0 ** np.arange(3, 10, 2))
        of["vertex_z"] = draw.uniform(-5.0, 5.0)
        put_in_pose(of, frame.frame(draw.uniform(-20.0, 20.0, 3), draw.normal(size=3)))
        r, phi = np.linspace(0.0, rim * (1.0 - 1e-12), 201)[:, None], np.linspace(0.0, 2.0 * np.pi, 361)
        x, y = r * np.cos(phi), r * np.sin(phi)
        points = np.stack([x, y, of["vertex_z"] + heights(of, x, y)], axis=-1).reshape(-1, 3)
        points = frame.points(of["pose"], points)
        low, high = (end(box_of(of, rim), axis=0) for end in (np.min, np.max))
        assert (low <= points.min(axis=0)).all()
        assert (high >= points.max(axis=0)).all()
        if kind == CONIC_AND_EVEN:
            assert np.allclose([low, high], [points.min(axis=0), points.max(axis=0)], rtol=0.0, atol=2e-3 * rim)


@pytest.mark.parametrize("kind", [CONIC_AND_EVEN, BICONIC, TOROID])
def test_no_point_of_a_rim_lies_outside_its_hull_or_far_inside(kind):
    """Along any direction the hull reaches as far as the rim at 40,000 azimuths.

    Beyond, it reaches 2e-3 of the radius and the rim's own rise and fall at most.
    """
    draw = np.random.default_rng(70 + kind)
    phi = np.linspace(0.0, 2.0 * np.pi, 40_000)
    for _ in range(8):
        of, rim = drawn_surface(draw, max(kind, BICONIC))
        if kind == CONIC_AND_EVEN:
            of = surface(20.0, draw.uniform(-3.0, 0.8), draw.normal(size=4) / 8.0 ** np.arange(3, 10, 2))
        x, y = rim * np.cos(phi), rim * np.sin(phi)
        z = heights(of, x, y)
        low, high = rim_range(of, rim)
        assert low - 1e-12 <= z.min() < low + 1e-3 * np.ptp(z) + 1e-12
        assert high + 1e-12 >= z.max() > high - 1e-3 * np.ptp(z) - 1e-12
        of["vertex_z"] = draw.uniform(-5.0, 5.0)
        put_in_pose(of, frame.frame(draw.uniform(-20.0, 20.0, 3), draw.normal(size=3)))
        points = frame.points(of["pose"], np.column_stack([x, y, of["vertex_z"] + z]))
        hull = rim_hull(of, rim)
        spare = 2e-3 * rim + (0.0 if kind == CONIC_AND_EVEN else np.ptp(z))
        for way in draw.normal(size=(20, 3)):
            way /= np.linalg.norm(way)
            assert -1e-12 <= (hull @ way).max() - (points @ way).max() < spare


def test_a_kind_without_bounds_is_no_toroid():
    of = surface(30.0, kind=TOROID, radius_x_mm=20.0).copy()
    of["kind"] = TOROID + 1
    for bounds in (set_bends, height_range):
        with pytest.raises(NotImplementedError, match=f"kind {TOROID + 1}"):
            bounds(of, 5.0)
