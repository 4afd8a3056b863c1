"""Curves over the field against sums of all rays on a grid across the front of the lens, which share no code."""

import math
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import lfmesh as lf
from lfmesh.analysis.field_curves import _collected, field_curves, paraxial_scale
from lfmesh.waves.bundle import LensRays, pupil_grid
from tests.waves.brute_pupil import Prescription
from tests.waves.test_stop_aim import WAVE_NM, drawn_lens, scene_of

Array = NDArray[np.float64]

GRID, EXACT = 240, 3e-3
"""Places along each axis, and how far sums may be off: the edge of a beam crosses some 1,000 of 20,000 or more cells,
of which each counts as whole or dark."""

BEHIND_MM = 100.0
"""Image plane of all lenses here."""


def before_a_lens(stop_mm: float, lens_mm: float) -> list[dict[str, Any]]:
    """A stop 20 mm before a plano-convex lens, whose clear aperture ends the light of far fields."""
    return [
        {"stop": True, "semi_diameter_mm": stop_mm, "thickness_mm": 20.0},
        {"radius_mm": 50.0, "thickness_mm": 4.0, "index": 1.5, "semi_diameter_mm": lens_mm},
        {"radius_mm": math.inf, "semi_diameter_mm": 30.0},
    ]


def rays_of(surfaces: list[dict[str, Any]]) -> tuple[LensRays, Prescription]:
    world = lf.build(lf.solved(scene_of(surfaces)).camera_alone())
    return LensRays(world, math.inf, BEHIND_MM), Prescription(surfaces, math.inf, 0.0)


def _grid(low: Array, high: Array) -> tuple[Array, float]:
    """Return the middles of equal cells of a rectangle, and the area of each."""
    steps = (np.arange(GRID) + 0.5) / GRID
    x, y = np.meshgrid(*(low[k] + steps * (high[k] - low[k]) for k in (0, 1)))
    return np.column_stack([x.ravel(), y.ravel()]), float((high - low).prod()) / GRID**2


def collected(lens: Prescription, within: tuple[Array, Array] | None = None) -> float:
    """Return the light of a piece of a Lambertian plane that passes, summed over the front, or a part of it."""
    low, high = lens.box() if within is None else within
    for _ in range(3):
        entry, area = _grid(low, high)
        passes = lens.followed(entry).met.all(axis=1)
        if not passes.any():
            return 0.0
        # A place is as wide as the middles of cells are apart.
        low, high = entry[passes].min(axis=0) - (high - low) / GRID, entry[passes].max(axis=0) + (high - low) / GRID
    entry, area = _grid(low, high)
    rays = lens.followed(entry)
    ahead = np.column_stack([entry / lens.object_mm - [0.0, lens.slope], np.ones(len(entry))])
    cosine = 1.0 / np.linalg.norm(ahead, axis=1)
    return float((rays.weight * cosine**4)[rays.met.all(axis=1)].sum()) * area


def chief_mm(lens: Prescription) -> float:
    """Return the height of the chief ray in the image plane, whatever stops it, by halving its height on the front."""
    low, high = (float(corner[1]) for corner in lens.box())
    low, high = low - 0.5 * (high - low), high + 0.5 * (high - low)
    trial = np.linspace(low, high, 4001)
    hit = lens.followed(np.column_stack([np.zeros(len(trial)), trial])).at_stop[:, 1]
    crosses = np.flatnonzero(np.isfinite(hit[:-1] * hit[1:]) & (hit[:-1] * hit[1:] <= 0.0))
    k = crosses[np.argmin(np.abs(hit[crosses + 1] - hit[crosses]))]
    low, high, sign = float(trial[k]), float(trial[k + 1]), math.copysign(1.0, hit[k])
    for _ in range(50):
        middle = 0.5 * (low + high)
        if sign * float(lens.followed(np.array([[0.0, middle]])).at_stop[0, 1]) > 0.0:
            low = middle
        else:
            high = middle
    rays = lens.followed(np.array([[0.0, low]]))
    (y, z), (v, w) = rays.position[0, 1:], rays.direction[0, 1:]
    return float(y + (BEHIND_MM - z) / w * v)


def irradiance(lens: Prescription, within: tuple[Array, Array] | None = None) -> float:
    """Return the irradiance of the image of a Lambertian plane, in arbitrary units."""
    step = 1e-4
    at = [chief_mm(replace(lens, slope=lens.slope + move)) for move in (-step, 0.0, step)]
    along = (at[2] - at[0]) / (2.0 * step)
    return collected(lens, within) / abs(along * (at[1] / lens.slope if lens.slope else along))


@pytest.mark.parametrize("seed", [None, 14])
def test_illumination_is_the_sum_of_all_rays_over_that_on_the_axis(seed: int | None) -> None:
    """Without a seed a lens whose aperture stops the chief ray of its farthest fields, and not all of their light."""
    rays, lens = rays_of(before_a_lens(3.0, 5.0)) if seed is None else drawn_lens(seed)
    farthest = 0.36 if seed is None else 0.3
    height = abs(paraxial_scale(rays, WAVE_NM)) * farthest
    curves = field_curves(rays, (WAVE_NM,), height)
    axis = irradiance(replace(lens, slope=0.0))
    for k in (7, 14, 20):
        wanted = irradiance(replace(lens, slope=float(curves.slope_y[k]))) / axis
        assert curves.illumination[k] == pytest.approx(wanted, rel=EXACT, abs=EXACT)
    assert (curves.illumination[-1] > 0.01) or seed is not None


def test_illumination_does_not_depend_on_the_region_that_is_looked_at_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """A circle through which light comes is widened until it holds the whole beam."""
    rays, _ = rays_of(before_a_lens(3.0, 5.0))
    whole = [_collected(rays, WAVE_NM, slope) for slope in (0.0, 0.2)]
    module = sys.modules[field_curves.__module__]
    monkeypatch.setattr(module, "pupil_grid", lambda *given, **keys: 0.3 * pupil_grid(*given, **keys))
    part = [_collected(rays, WAVE_NM, slope) for slope in (0.0, 0.2)]
    np.testing.assert_allclose(part, whole, rtol=EXACT)


def test_a_field_without_light_has_no_illumination_instead_of_an_unknown_one() -> None:
    rays, _ = rays_of(before_a_lens(3.0, 5.0))
    curves = field_curves(rays, (WAVE_NM,), abs(paraxial_scale(rays, WAVE_NM)) * 0.5)
    slopes = np.abs(curves.slope_y)
    assert (curves.illumination[slopes > 0.4] == 0.0).all()
    assert (curves.illumination[slopes < 0.39] > 0.0).all()


def test_light_between_two_edges_that_nearly_meet_is_found() -> None:
    """At this field a sliver of the stop is lit, 0.05 mm of 6 mm wide: narrower than a cell of the integral's grid."""
    rays, lens = rays_of(before_a_lens(3.0, 5.0))
    curves = field_curves(rays, (WAVE_NM,), abs(paraxial_scale(rays, WAVE_NM)) * 0.394)
    lens = replace(lens, slope=float(curves.slope_y[-1]))
    far = math.copysign(2.9, lens.slope)
    sliver = np.array([-1.0, far - 0.1]), np.array([1.0, far + 0.1])
    wanted = irradiance(lens, sliver) / irradiance(replace(lens, slope=0.0))
    assert 0.0 < wanted < 1e-3
    assert curves.illumination[-1] == pytest.approx(wanted, rel=0.05)
