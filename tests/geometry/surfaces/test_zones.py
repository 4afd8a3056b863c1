"""Exact surfaces of two zones: heights, slopes, crossings, bounds and meshes, against closed forms."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import lfmesh as lf
from lfmesh.geometry.lens.surface_gaps import end_where_they_touch, reaches_through
from lfmesh.geometry.ray import Ray
from lfmesh.geometry.surfaces.bends import bends_between, box_of, height_range, rim_range, set_bends
from lfmesh.geometry.surfaces.sag import gradients, heights, reach, sag, slope
from lfmesh.geometry.surfaces.surface import first_crossing, form_at, put_in_pose, surface_of
from lfmesh.geometry.surfaces.tessellation import cap, ring_radii

INNER = 1.0 / 3.2, -0.5, -0.0124
SHAPES = {"rises": (1.0 / 2.6, -0.8, -0.01), "falls": (-1.0 / 6.0, 0.4, 0.004), "flat": (0.0, 0.0, 0.0)}
BORDER, RIM = 1.25, 2.0


def record_of(shape, **keys):
    c, k, a = SHAPES[shape]
    zone = {"border_mm": BORDER, "radius_mm": 1.0 / c if c else np.inf, "conic": k, "asphere_mm": (a,)}
    model = lf.Surface(
        radius_mm=1.0 / INNER[0], conic=INNER[1], asphere_mm=(INNER[2],), outer_zone=zone, semi_diameter_mm=RIM,
        index=1.5,
    )  # fmt: skip
    record = surface_of(model, semi_diameter=RIM, **keys)
    set_bends(record, RIM)
    return record


def formula(r, number):
    """Return sag, slope, z'/r and z'' of (c, k, a) in extended precision."""
    c, k, a = (np.longdouble(each) for each in number)
    r = np.asarray(r, np.longdouble)
    root = np.sqrt(1 - (1 + k) * (c * r) ** 2)
    z = c * r * r / (1 + root) + a * r**4
    return z, c * r / root + 4 * a * r**3, c / root + 4 * a * r**2, c / root**3 + 12 * a * r**2


def truth(r, shape):
    inner, outer = formula(r, INNER), list(formula(r, SHAPES[shape]))
    outer[0] = outer[0] + formula(BORDER, INNER)[0] - formula(BORDER, SHAPES[shape])[0]
    return [np.where(np.asarray(r) > BORDER, o, i) for i, o in zip(inner, outer, strict=True)]


@pytest.mark.parametrize("shape", SHAPES)
def test_heights_and_slopes_are_those_of_each_zone(shape):
    of, r = record_of(shape), np.linspace(0.0, RIM, 501)
    z, rate, *_ = truth(r, shape)
    np.testing.assert_allclose(sag(of, r), z.astype(float), atol=2e-16 * 4)
    np.testing.assert_allclose(slope(of, r), rate.astype(float), atol=1e-15)
    np.testing.assert_allclose(heights(of, 0.6 * r, -0.8 * r), z.astype(float), atol=1e-15)
    kernel = np.array([form_at(of, 0.6 * each, -0.8 * each) for each in r])
    np.testing.assert_allclose(kernel.T, [z.astype(float), 0.6 * rate.astype(float), -0.8 * rate.astype(float)],
                               atol=1e-15)  # fmt: skip
    np.testing.assert_allclose(gradients(of, 0.6 * r, -0.8 * r), kernel.T[1:], atol=1e-15)


def test_the_end_is_that_of_the_outer_zone():
    assert reach(record_of("rises")) == pytest.approx(2.6 / np.sqrt(0.2), rel=1e-14)
    assert reach(record_of("flat")) == np.inf


@pytest.mark.parametrize("shape", SHAPES)
def test_bounds_of_heights_and_bends_hold_and_are_close(shape):
    of = record_of(shape)
    r = np.linspace(0.0, RIM, 40_001)
    z, _, across, along = (each.astype(float) for each in truth(r, shape))
    least, most = height_range(of, RIM)
    assert z.min() - 1e-4 <= least <= z.min() + 1e-15
    assert z.max() - 1e-15 <= most <= z.max() + 1e-4
    assert rim_range(of, RIM) == pytest.approx((z[-1], z[-1]), rel=1e-14)
    assert of["least_bend"] <= min(across.min(), along.min())
    assert of["most_bend"] >= max(across.max(), along.max())
    box = box_of(of, RIM)
    assert box[:, 2].min() <= z.min()
    assert box[:, 2].max() >= z.max()


@pytest.mark.parametrize(("shape", "jumps_up"), [("rises", True), ("falls", False), ("flat", False)])
def test_a_kink_is_unbounded_on_its_own_side_in_cells_that_contain_the_border(shape, jumps_up):
    """And it denies that the whole surface is convex, or concave, as each zone may be."""
    of = record_of(shape)
    least, most = bends_between(of, np.array([0.0, 1.2, BORDER]), np.array([BORDER, 1.3, RIM]))
    assert np.isfinite([least[0], most[0], least[2], most[2]]).all()
    assert (most[1] == np.inf) == jumps_up
    assert (least[1] == -np.inf) != jumps_up
    jump = float(formula(BORDER, SHAPES[shape])[1] - formula(BORDER, INNER)[1])
    assert (jump > 0.0) == jumps_up
    assert of["most_bend"] > 0.0 if jumps_up else of["least_bend"] < 0.0


def crossings_by_samples(shape, p, d, sense):
    """Return the first change of side among 40,001 points of a ray inside the rim, with the step."""
    t, step = np.linspace(0.0, 6.0, 40_001, retstep=True)
    at = p + t[:, None] * d
    r = np.hypot(at[:, 0], at[:, 1])
    inside = r <= RIM
    until = len(t) if inside.all() else int(np.argmin(inside))
    side = sense * (at[:until, 2] - truth(r[:until], shape)[0].astype(float))
    changes = np.flatnonzero((side[:-1] < 0.0) & (side[1:] >= 0.0))
    return (t[changes[0]] if len(changes) else None), step


@pytest.mark.parametrize("shape", SHAPES)
def test_no_crossing_is_missed_at_any_incidence(shape):
    """Rays from close to the surface, many of them nearly along it and across the kink."""
    of, draw = record_of(shape), np.random.default_rng(sorted(SHAPES).index(shape))
    met = 0
    for _ in range(300):
        p, d = draw.uniform(-1.4, 1.4, 3), draw.normal(size=3)
        sense = draw.choice([-1.0, 1.0])
        d[2] = sense * abs(d[2]) * draw.choice([0.01, 0.1, 1.0])
        d /= np.linalg.norm(d)
        p[2] = float(sag(of, np.hypot(*p[:2]))) - sense * (1e-3 + 0.3 * abs(p[2]))
        wanted, step = crossings_by_samples(shape, p, d, sense)
        found, t = first_crossing(of, Ray(*p, *d), sense, 0.0, np.inf, True)
        if wanted is not None:
            assert found
            assert wanted - 1e-12 <= t <= wanted + 1.001 * step
            met += 1
        elif found:
            # Samples may miss a short dip below the surface; what is found lies on it.
            at = p + t * d
            assert abs(at[2] - float(sag(of, np.hypot(*at[:2])))) < 1e-13
    assert met > 50


def test_a_ray_to_the_kink_meets_it():
    """Rays to points of the border, along the axis and obliquely."""
    of = record_of("falls")
    for phi in np.linspace(0.0, 6.0, 13):
        kink = np.array([BORDER * np.cos(phi), BORDER * np.sin(phi), float(sag(of, BORDER))])
        for d in ([0.0, 0.0, 1.0], [0.3, -0.2, 0.9], [-0.6 * np.cos(phi), -0.6 * np.sin(phi), 0.8]):
            d = np.array(d) / np.linalg.norm(d)
            found, t = first_crossing(of, Ray(*(kink - d), *d), 1.0, 0.0, np.inf, True)
            assert found
            assert t == pytest.approx(1.0, abs=4e-15)


@pytest.mark.parametrize("rings", [2, 6, 31])
def test_a_ring_of_vertices_lies_on_the_border(rings):
    of = record_of("rises")
    radii = ring_radii(of, rings, RIM)
    assert (np.diff(radii) > 0.0).all()
    assert (radii[0], radii[-1]) == (0.0, RIM)
    assert BORDER in radii
    mesh = cap(of, rings, RIM)
    r = np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 1])
    np.testing.assert_allclose(mesh.vertices[:, 2], sag(of, np.minimum(r, RIM)), atol=1e-14)


@pytest.mark.parametrize("tilt_deg", [0.0, 2.0])
def test_depths_of_a_zone_beyond_a_plane_are_bounded_closely(tilt_deg):
    """A plane 0.1 mm before the highest circle of the surface, level and tilted."""
    of = record_of("falls")
    plane = surface_of(
        lf.Surface(radius_mm=np.inf, semi_diameter_mm=4.0), semi_diameter=4.0, vertex_z=height_range(of, RIM)[1] - 0.1
    )
    set_bends(plane, 4.0)
    if tilt_deg:
        put_in_pose(of, np.hstack([Rotation.from_euler("x", tilt_deg, degrees=True).as_matrix(), np.zeros((3, 1))]))
    x, y = np.meshgrid(np.linspace(-RIM, RIM, 801), np.linspace(-RIM, RIM, 801))
    x, y = x[np.hypot(x, y) <= RIM], y[np.hypot(x, y) <= RIM]
    points = np.column_stack([x, y, heights(of, x, y)])
    depth = float((points @ of["pose"][2, :3] + of["pose"][2, 3]).max() - plane["vertex_z"])
    found, possible = reaches_through(of, plane, 1.0, 1e-9)
    assert depth - 1e-5 <= found <= possible
    # Level, the whole border is highest, and its squares are too many to halve further.
    assert possible < 1.1 * depth


def test_surfaces_that_touch_beyond_the_border_end_there():
    """A plane that the outer zone reaches at the radius 1.9 of its rising flank."""
    zoned, at = record_of("rises"), 1.9
    plane = surface_of(lf.Surface(radius_mm=np.inf), semi_diameter=1.0, vertex_z=float(sag(zoned, at)))
    zoned["semi_diameter"] = 1.0
    pair = np.array([zoned, plane])
    pair["semi_diameter"] = 1.0
    end_where_they_touch(pair, 12)
    assert np.isinf(pair["end"]).all()
    pair["semi_diameter"] = at * 0.999
    end_where_they_touch(pair, 12)
    assert pair["end"].min() == pytest.approx(at, rel=1e-6)
