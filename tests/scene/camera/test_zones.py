"""Surfaces and phases in concentric zones: their keys, their sags, and what they exclude."""

import math

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.errors import SceneError
from lfmesh.scene.camera.gaps import least_gap_mm

ZONE = {"border_mm": 1.25, "radius_mm": -6.0, "conic": 0.4, "asphere_mm": (-0.01,)}
FRONT = {"radius_mm": 3.2, "conic": -0.5, "asphere_mm": (-0.0124, 1e-4), "semi_diameter_mm": 2.0, "index": 1.5}
PHASE = {
    "kind": "zones",
    "zones": [
        {"border_mm": 1.25, "coefficients_rad": (-20.0, 3.0), "radius_mm": 1.25},
        {"coefficients_rad": (-70.0,), "radius_mm": 2.5, "offset_rad": 0.5},
    ],
}


def conic(c, k, r):
    return c * r * r / (1.0 + np.sqrt(1.0 - (1.0 + k) * (c * r) ** 2))


def sag(r):
    inner = conic(1.0 / 3.2, -0.5, r) - 0.0124 * r**4 + 1e-4 * r**6
    outer = conic(-1.0 / 6.0, 0.4, r) - 0.01 * r**4
    return inner, outer


def test_the_outer_zone_continues_the_inner_one():
    surface = lf.Surface(outer_zone=ZONE, **FRONT)
    r = np.linspace(-2.0, 2.0, 401)
    shift = sag(1.25)[0] - sag(1.25)[1]
    inner, outer = sag(np.abs(r))
    wanted = np.where(np.abs(r) > 1.25, outer + shift, inner)
    np.testing.assert_allclose(surface.sag_mm(r), wanted, atol=1e-15)
    np.testing.assert_allclose(surface.sag_at_mm(0.6 * r, 0.8 * r), wanted, atol=1e-15)
    np.testing.assert_allclose([surface.sag_mm(float(each)) for each in r], wanted, atol=1e-15)


def test_bounds_of_the_sag_and_its_derivatives_hold_in_cells_across_the_border():
    """Second derivatives are unbounded there; slopes and heights are not."""
    surface = lf.Surface(outer_zone=ZONE, **FRONT)
    zone = surface.outer_zone
    draw = np.random.default_rng(4)
    low = draw.uniform(-1.6, 1.2, (2, 400))
    high = np.minimum(low + 10.0 ** draw.uniform(-4.0, -0.3, (2, 400)), 1.6)
    found = zone.bends_in(surface, (low[0], high[0]), (low[1], high[1]))
    step = 1e-6
    for _ in range(20):
        x, y = low + draw.uniform(size=low.shape) * (high - low)
        keep = (np.hypot(x, y) < 1.99) & (np.abs(np.hypot(x, y) - 1.25) > 3.0 * step)
        z = surface.sag_at_mm(x, y)
        by_x = (surface.sag_at_mm(x + step, y) - surface.sag_at_mm(x - step, y)) / (2.0 * step)
        by_y = (surface.sag_at_mm(x, y + step) - surface.sag_at_mm(x, y - step)) / (2.0 * step)
        for value, (least, most) in zip((z, by_x, by_y), found[:3], strict=True):
            assert (value >= least - 1e-8)[keep].all()
            assert (value <= most + 1e-8)[keep].all()
    assert all(np.isfinite(each).all() for pair in found[:3] for each in pair)
    corner = np.hypot(np.maximum(np.abs(low), np.abs(high))[0], np.maximum(np.abs(low), np.abs(high))[1])
    inside = corner < 1.25
    assert inside.any()
    assert all(np.isfinite(each[inside]).all() for pair in found for each in pair)


def test_first_order_optics_follow_the_inner_zone():
    def lens(**keys):
        back = {"radius_mm": -8.0, "semi_diameter_mm": 2.0}
        return lf.Scene(
            camera={
                "lens": {"surfaces": [{**FRONT, "thickness_mm": 1.0, "stop": True, **keys}, back]},
                "sensor": {"pixels": (8, 8), "pixel_mm": 0.01}, "focus_mm": 500.0,
            }
        )  # fmt: skip

    one, two = (lf.first_order(lens(**keys)) for keys in ({}, {"outer_zone": ZONE}))
    assert two.efl_mm == one.efl_mm
    radial = {"kind": "radial", "coefficients_rad": (-20.0, 3.0), "radius_mm": 1.25}
    one, two = (lf.first_order(lens(phase=phase)) for phase in (radial, PHASE))
    assert two.efl_mm == pytest.approx(one.efl_mm, rel=1e-14)


def test_the_gap_behind_a_zone_is_that_of_its_shape():
    """Of two surfaces whose zones turn towards each other, at the rim."""
    front = lf.Surface(outer_zone=ZONE | {"radius_mm": 4.0, "asphere_mm": ()}, thickness_mm=1.0, **FRONT)
    back = lf.Surface(radius_mm=math.inf, semi_diameter_mm=2.0)
    r = np.linspace(0.0, 2.0, 100_001)
    wanted = float((0.0 - front.sag_mm(r)).min())
    assert least_gap_mm(front, back, 0.0, 2.0)[0] == pytest.approx(wanted, rel=1e-6)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"outer_zone": {"radius_mm": 3.0}}, r"outer_zone\.border_mm: missing"),
        ({"outer_zone": {"border_mm": 1.0}}, r"outer_zone\.radius_mm: missing"),
        ({"outer_zone": {"border_mm": 0.0, "radius_mm": 3.0}}, r"outer_zone\.border_mm = 0"),
        ({"outer_zone": {"border_mm": 1.0, "radius_mm": 0.9}}, r"outer_zone\.radius_mm = 0.9: .* ends 0.9 mm"),
        ({"outer_zone": ZONE, "radius_mm": 1.2, "conic": 0.0}, r"outer_zone\.border_mm = 1.25: the inner zone ends"),
        ({"outer_zone": ZONE | {"radius_mm": 1.9, "conic": 0.0}}, r"semi_diameter_mm = 2.*the surface ends 1.9 mm"),
        ({"outer_zone": ZONE, "odd_asphere_mm": (1e-4,)}, "odd_asphere_mm.*omit it: an outer_zone has no such terms"),
        ({"outer_zone": ZONE, "toroid": {"radius_x_mm": 9.0}}, "outer_zone: toroid is given too"),
        ({"outer_zone": ZONE | {"asphere_mm": (1e300,)}}, r"outer_zone\.\w+"),
    ],
)
def test_a_zone_that_cannot_be_is_named(keys, said):
    with pytest.raises(SceneError, match=said):
        lf.Surface(**(FRONT | keys))


def test_gradient_glass_excludes_a_face_of_two_zones():
    gradient = {"kind": "radial_n2", "index": 1.6, "coefficients": [-3e-3]}
    rod = {"thickness_mm": 4.0, "gradient": gradient, "semi_diameter_mm": 1.0, "stop": True}
    end = {"semi_diameter_mm": 1.0, "outer_zone": {"border_mm": 0.5, "radius_mm": -30.0}}
    with pytest.raises(SceneError, match=r"surfaces\[1\]\.outer_zone: omit it: a curved path"):
        lf.Lens(surfaces=[rod, end])


@pytest.mark.parametrize(
    ("zones", "said"),
    [
        ([{"coefficients_rad": (1.0,), "radius_mm": 1.0}] * 2, r"zones\[0\]\.border_mm: missing"),
        ([{**PHASE["zones"][0]}] * 2, r"zones\[1\]\.border_mm = 1.25: omit it"),
        ([PHASE["zones"][0], PHASE["zones"][0], PHASE["zones"][1]], r"zones\[1\]\.border_mm = 1.25: must be above"),
        ([], "zones"),
    ],
)
def test_zones_of_a_phase_follow_each_other_outwards(zones, said):
    with pytest.raises(SceneError, match=said):
        lf.Surface(phase={"kind": "zones", "zones": zones})


def test_one_zone_is_a_radial_phase():
    phase = lf.ZonedPhase(zones=[{"coefficients_rad": (-20.0, 3.0), "radius_mm": 1.25}])
    same = lf.RadialPhase(coefficients_rad=(-20.0, 3.0), radius_mm=1.25)
    assert phase.power_per_mm(550.0) == same.power_per_mm(550.0)
    assert phase.of_revolution
