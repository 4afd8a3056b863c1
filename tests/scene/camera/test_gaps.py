"""Crossings of neighbouring surfaces, against closed forms and dense samples."""

import math

import numpy as np
import pytest

from lfmesh.errors import SceneError
from lfmesh.scene.camera.forms import Form
from lfmesh.scene.camera.gaps import least_gap_mm, room_mm
from lfmesh.scene.camera.lens import Lens, Surface
from lfmesh.scene.camera.sections import toroid_reach_mm

REVOLVED, BICONIC, TOROID = "revolved", "biconic", "toroid"
KINDS = (REVOLVED, BICONIC, TOROID)


def crest(at_mm, height_mm):
    """Return coefficients of r⁴ and r⁶ of a flat surface with one crest, 3 q² − 2 q³ of q = r²/at²."""
    return 3.0 * height_mm / at_mm**4, -2.0 * height_mm / at_mm**6


@pytest.mark.parametrize("place", [20.5, 117.5, 130.37, 199.5])
def test_a_crest_that_rises_between_all_regular_samples_crosses(place):
    """Its top is 1e-7 mm higher than the gap; at the nearest 256th of the aperture it is 1e-5 mm lower."""
    height, aperture = 1.0, 10.0

    def lens(gap_mm):
        terms = crest(place / 256.0 * aperture, height)
        semi = min(aperture, 1.2 * place / 256.0 * aperture) if place < 150 else aperture
        front = Surface(thickness_mm=gap_mm, index=1.5, asphere_mm=terms, semi_diameter_mm=semi)
        return Lens(surfaces=(front, Surface(semi_diameter_mm=semi, stop=True)))

    lens(height)
    with pytest.raises(SceneError, match="cross inside their clear aperture"):
        lens(height - 1e-7)


def drawn(draw, kind, thickness_mm=0.0):
    radius, radius_x = draw.choice([-1.0, 1.0], 2) * draw.uniform(9.0, 60.0, 2)
    conic, conic_x = draw.uniform(-3.0, 0.8, 2)
    keys = {"radius_mm": radius, "conic": conic, "thickness_mm": thickness_mm}
    terms = {"asphere_mm": tuple(draw.normal(size=4) * 0.003 / 6.0 ** np.arange(3, 10, 2))}
    if kind == BICONIC:
        return Surface(**keys, biconic={"radius_x_mm": radius_x, "conic_x": conic_x})
    if kind == TOROID:
        return Surface(**keys, **terms, toroid={"radius_x_mm": radius_x})
    return Surface(**keys, **terms, odd_asphere_mm=(1e-4 * draw.normal(),))


def sampled_gaps(front, back, radius):
    """Return heights, and the least difference of sags over 181 azimuths at each."""
    r = radius * np.sqrt(np.linspace(0.0, 1.0, 601))
    turn = np.linspace(0.0, 0.5 * math.pi, 181)
    x, y = r[:, None] * np.sin(turn), r[:, None] * np.cos(turn)
    return r, (back.sag_at_mm(x, y) - front.sag_at_mm(x, y)).min(axis=1)


@pytest.mark.parametrize("kinds", [(one, other) for one in KINDS for other in KINDS], ids="-".join)
def test_the_least_gap_is_no_more_than_any_sample_and_the_gap_of_one_place(kinds):
    draw = np.random.default_rng(sum(map(len, kinds)))
    for _ in range(6):
        front, back = (drawn(draw, kind) for kind in kinds)
        radius = min(front.reach_mm, back.reach_mm, draw.uniform(2.0, 9.0))
        least, height = least_gap_mm(front, back, 0.0, radius)
        _, gaps = sampled_gaps(front, back, radius)
        assert least <= gaps.min() + 1e-8
        # Samples are this far apart.
        assert least >= gaps.min() - 1e-3 * (np.ptp(gaps) + 1e-3)
        turn = np.linspace(0.0, 0.5 * math.pi, 20_001)
        x, y = height * np.sin(turn), height * np.cos(turn)
        assert least == pytest.approx((back.sag_at_mm(x, y) - front.sag_at_mm(x, y)).min(), abs=1e-7)


@pytest.mark.parametrize("kinds", [(REVOLVED, REVOLVED), (REVOLVED, TOROID), (BICONIC, REVOLVED)], ids="-".join)
def test_surfaces_have_room_up_to_where_samples_cross(kinds):
    draw = np.random.default_rng(3)
    for _ in range(4):
        front, back = (drawn(draw, kind) for kind in kinds)
        radius = min(front.reach_mm, back.reach_mm, draw.uniform(2.0, 9.0))
        r, gaps = sampled_gaps(front, back, radius)
        given = max(0.1, -0.6 * gaps.min())
        room = room_mm(front.model_copy(update={"thickness_mm": given}), back, radius)
        crossed = np.flatnonzero(gaps < -given)
        if crossed.size:
            assert r[crossed[0] - 1] * (1.0 - 1e-3) <= room <= r[crossed[0]]
        else:
            assert room >= 0.99 * radius


def test_surfaces_of_one_shape_touch_all_over_and_do_not_cross():
    same = Surface(radius_mm=20.0, conic=0.3, asphere_mm=(1e-5, -1e-8), thickness_mm=0.0)
    assert least_gap_mm(same, same, 0.0, 9.0)[0] == pytest.approx(0.0, abs=1e-9)
    assert room_mm(same, same, 9.0) == 9.0


@pytest.mark.parametrize("radius_mm", [12.0, -12.0, 40.0, math.inf])
def test_a_toroid_reaches_as_far_as_its_closed_form(radius_mm):
    """A torus whose two circles have a centre each: the nearest point of its end lies in one of the sections."""
    c_x, c_y = 1.0 / 12.0, 0.0 if math.isinf(radius_mm) else 1.0 / radius_mm
    reach = toroid_reach_mm(c_x, c_y, 0.0, (), abs(radius_mm))
    y = np.linspace(0.0, 12.0, 200_001)
    f = c_y * y * y / (1.0 + np.sqrt(np.maximum(0.0, 1.0 - (c_y * y) ** 2)))
    ends = np.hypot(y, np.maximum(0.0, 12.0 - f))
    assert reach <= min(12.0, ends.min()) * (1.0 + 1e-12)
    assert reach > min(12.0, ends.min()) * (1.0 - 3e-6)


def test_toroids_of_many_curves_exist_up_to_the_height_that_they_are_said_to_reach():
    draw = np.random.default_rng(5)
    y = np.linspace(0.0, 12.0, 200_001)
    for _ in range(40):
        terms = draw.normal(size=4) * 0.02 / 6.0 ** np.arange(3, 10, 2)
        c_x, c_y = draw.uniform(-0.12, 0.12, 2)
        powers = [(4 + 2 * k, float(a)) for k, a in enumerate(terms)]
        most = min(12.0, 1.0 / abs(c_y))
        inside = y[y <= most]
        f = c_y * inside**2 / (1.0 + np.sqrt(np.maximum(0.0, 1.0 - (c_y * inside) ** 2)))
        f += sum(a * inside**n for n, a in powers)
        end = min(most, float(np.hypot(inside, np.maximum(0.0, 1.0 - c_x * f) / c_x).min()))
        reach = toroid_reach_mm(c_x, c_y, 0.0, powers, most)
        assert end * (1.0 - 5e-6) < reach <= end


@pytest.mark.parametrize("turn_deg", [11.0, 37.7, 61.3])
def test_an_edge_is_as_thick_as_at_its_thinnest_azimuth(turn_deg):
    """Rims z = A s + B s² with s = sin² of the azimuth, of two toroids, are closest where no regular azimuth lies."""
    back = Surface(radius_mm=-30.0, asphere_mm=(6e-5,), semi_diameter_mm=9.0, toroid={"radius_x_mm": -20.0})
    turns = np.linspace(0.0, 0.5 * math.pi, 200_001)
    rim = back.sag_at_mm(9.0 * np.sin(turns), 9.0 * np.cos(turns))
    # The slope of a front of two sections makes the azimuth in question the thinnest one.
    slope = np.interp(math.radians(turn_deg), turns, np.gradient(rim, np.sin(turns) ** 2))
    c_x = float(slope * 2.0 / 8.0**2)
    front = Surface(thickness_mm=8.0, index=1.5, semi_diameter_mm=8.0, conic=-1.0,
                    biconic={"radius_x_mm": 1.0 / c_x, "conic_x": -1.0})  # fmt: skip
    thick = 8.0 + rim - front.sag_at_mm(8.0 * np.sin(turns), 8.0 * np.cos(turns))
    thinnest = float(thick.min())
    assert Lens(surfaces=(front, back)).edge_mm(0) == pytest.approx(thinnest, abs=1e-9)


class Ripples(Form):
    """A shape that is zero at every azimuth of a 32nd of a quarter turn."""

    def sag_at_mm(self, surface, x_mm, y_mm):
        return 0.01 * np.sin(64.0 * np.arctan2(x_mm, y_mm)) * np.hypot(x_mm, y_mm) ** 2

    def ranges_in(self, surface, square, sine, cosine):
        most = 0.01 * square[1]
        return (-most, most), (-0.01 + 0.0 * most, 0.01 + 0.0 * most), (-64.0 * most, 64.0 * most)


def test_a_shape_is_flat_only_where_its_sag_is_proven_to_be_zero():
    assert not Ripples().is_flat(Surface(semi_diameter_mm=5.0))
    assert Surface(semi_diameter_mm=5.0, biconic={"radius_x_mm": math.inf}).is_flat
    assert Surface(semi_diameter_mm=5.0, toroid={"radius_x_mm": math.inf}).is_flat
    assert not Surface(semi_diameter_mm=5.0, toroid={"radius_x_mm": 1e9}).is_flat
