"""Bounds of the axial beam hold, or say that they do not, whatever number of zones is looked at."""

import math

import numpy as np
import pytest

from lfmesh.scene import Lens, Scene, Surface, first_order
from lfmesh.scene.first_order import beam_bounds
from lfmesh.scene.first_order.meridional import beam_mm, heights_mm


def warnings_of(*surfaces: Surface) -> str:
    camera = {"focus_mm": math.inf, "lens": Lens(surfaces=surfaces), "sensor": {"pixels": [8, 8], "pixel_mm": 0.01}}
    return " ".join(first_order(Scene.model_validate({"schema_version": 1, "camera": camera})).warnings)


def bulging(index: float, stop_mm: float) -> tuple[Surface, Surface]:
    """A plate with a spherical back, which light along the axis meets at sin i = r / 12 mm."""
    front = Surface(thickness_mm=9.0, index=index, semi_diameter_mm=stop_mm, stop=True)
    return front, Surface(radius_mm=-12.0, semi_diameter_mm=11.0)


@pytest.mark.parametrize("index", [1.5, 1.8])
@pytest.mark.parametrize(("share", "ends"), [(0.999, False), (1.001, True)])
def test_a_beam_is_said_to_end_where_its_rim_is_totally_reflected(index: float, share: float, ends: bool) -> None:
    assert ("beam end at surfaces[1]" in warnings_of(*bulging(index, share * 12.0 / index))) is ends


def test_a_beam_is_said_to_end_at_a_surface_that_its_rim_misses() -> None:
    """Rays that a strong front bends past a small ball, whose clear aperture they do not reach."""
    front = Surface(thickness_mm=1.0, index=1.5, semi_diameter_mm=8.0, stop=True)
    back = Surface(radius_mm=14.0, thickness_mm=15.0, semi_diameter_mm=8.0)
    ball = Surface(radius_mm=9.0, thickness_mm=9.0, index=1.5, semi_diameter_mm=8.9)
    wide = heights_mm(Lens(surfaces=(front, back, ball, Surface(semi_diameter_mm=30.0))), 587.6, math.inf, 7.99)
    assert len(wide) == 2
    assert "beam end at surfaces[2]" in warnings_of(front, back, ball, Surface(semi_diameter_mm=30.0))


def aberrated(clear_mm: float) -> tuple[Surface, ...]:
    """A lens whose asphere bends rays of some zone farther out on the last surface than those of the rim."""
    front = Surface(
        radius_mm=50.0, asphere_mm=(0.0, 5e-7), thickness_mm=3.0, index=1.5, semi_diameter_mm=10.0, stop=True
    )
    back = Surface(radius_mm=-90.0, thickness_mm=25.0, semi_diameter_mm=30.0)
    return front, back, Surface(radius_mm=-80.0, semi_diameter_mm=clear_mm)


@pytest.mark.parametrize("most", [1, 8, 64, 4096])
def test_a_clipped_beam_is_warned_of_however_few_zones_are_divided(most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    fan = [heights_mm(Lens(surfaces=aberrated(30.0)), 587.6, math.inf, 0.02 * k) for k in range(501)]
    widest = max(heights[2] for heights in fan)
    assert widest > 1.001 * abs(fan[-1][2])
    monkeypatch.setattr(beam_bounds, "MOST_OPEN", most)
    assert "surfaces[2]" in warnings_of(*aberrated(widest * (1.0 - 1e-4)))
    # An aperture that no coarse bound reaches is still proven to be clear of the beam.
    assert "surfaces[2]" not in warnings_of(*aberrated(2.0 * widest))
    beam = beam_mm(Lens(surfaces=aberrated(30.0)), 587.6, math.inf, 10.0)
    assert beam.found_mm[2] <= widest * (1.0 + 1e-5)
    assert beam.proven_mm[2] * (1.0 + 2e-6) >= widest
    np.testing.assert_array_less(beam.found_mm, np.array(beam.proven_mm) + 1e-12)
