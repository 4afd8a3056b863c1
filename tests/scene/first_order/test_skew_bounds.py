"""Bounds of skew rays hold for every ray of a cell, and no ray of an anamorphic beam that is clipped goes unnoticed."""

import math
from typing import Any

import numpy as np
import pytest

from lfmesh.scene import Lens, Scene, Surface, first_order
from lfmesh.scene.first_order import axial_beam, skew_bounds
from lfmesh.scene.first_order.meridional import heights_mm

FORMS: dict[str, dict[str, Any]] = {
    "biconic": {"radius_mm": 30.0, "conic": -0.5, "biconic": {"radius_x_mm": -60.0, "conic_x": 1.0}},
    "toroid": {"radius_mm": 30.0, "asphere_mm": (1e-5,), "toroid": {"radius_x_mm": -50.0}},
    "asphere": {"radius_mm": 30.0, "asphere_mm": (1e-5, -1e-8), "conic": -2.0},
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("object_mm", [math.inf, 200.0])
def test_no_ray_of_a_cell_leaves_its_bounds(form: str, object_mm: float) -> None:
    front = Surface(thickness_mm=8.0, index=1.6, semi_diameter_mm=12.0, stop=True, **FORMS[form])
    lens = Lens(surfaces=(front, Surface(radius_mm=-70.0, semi_diameter_mm=15.0)))
    draw = np.random.default_rng(3)
    low = draw.uniform(-8.0, 8.0, (60, 2))
    high = low + 10.0 ** draw.uniform(-3.0, -0.3, (60, 2))
    (least, most), pass_on = skew_bounds._followed(lens, 587.6, object_mm, low, high)
    assert pass_on.mean() > 0.9
    moves = 1e-4 * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    for _ in range(10):
        entry = low + draw.uniform(size=(60, 2)) * (high - low)
        at, right, left, up, down = (
            np.square(axial_beam._crossings(lens, 587.6, object_mm, entry + move)[:-1]).sum(axis=2) for move in moves
        )
        rays = at, (right - left) / 2e-4, (up - down) / 2e-4
        for k, (value, rounding) in enumerate(zip(rays, (1e-9, 1e-4, 1e-4), strict=True)):
            assert (value >= least[:, k, :60] - rounding).all()
            assert (value <= most[:, k, :60] + rounding).all()


def aberrated(clear_mm: float, stop_mm: float = 10.0) -> tuple[Surface, ...]:
    """A lens whose asphere bends rays of a ring farther out on the last surface than those of the rim."""
    front = Surface(
        radius_mm=50.0, asphere_mm=(0.0, 5e-7), thickness_mm=3.0, index=1.5, semi_diameter_mm=stop_mm, stop=True
    )
    back = Surface(radius_mm=-90.0, biconic={"radius_x_mm": -60.0}, thickness_mm=25.0, semi_diameter_mm=30.0)
    return front, back, Surface(radius_mm=-80.0, semi_diameter_mm=clear_mm)


def warnings_of(*surfaces: Surface) -> str:
    camera = {"focus_mm": math.inf, "lens": Lens(surfaces=surfaces), "sensor": {"pixels": [8, 8], "pixel_mm": 0.01}}
    return " ".join(first_order(Scene.model_validate({"schema_version": 1, "camera": camera})).warnings)


def test_an_aperture_that_clips_a_ring_of_an_anamorphic_beam_is_warned_of() -> None:
    """Truth is the fan in the section y–z, whose farthest ray lies between rings of an eighth of the stop."""
    fan = [heights_mm(Lens(surfaces=aberrated(30.0)), 587.6, math.inf, 0.02 * k) for k in range(501)]
    widest = max(abs(heights[2]) for heights in fan)
    assert widest > 1.001 * max(abs(fan[k][2]) for k in range(0, 501, 63))
    assert "surfaces[2], whose clear aperture" in warnings_of(*aberrated(widest * (1.0 - 1e-4)))
    assert "surfaces[2]" not in warnings_of(*aberrated(widest * (1.0 + 1e-4)))


def test_an_aperture_is_called_open_where_too_few_cells_are_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    widest = axial_beam.beam_mm(Lens(surfaces=aberrated(30.0)), 587.6, math.inf).found_mm[2]
    monkeypatch.setattr(skew_bounds, "MOST_OPEN", 1)
    assert "surfaces[2] may limit the light" in warnings_of(*aberrated(widest * (1.0 + 1e-4)))
    assert "surfaces[2]" not in warnings_of(*aberrated(3.0 * widest))


@pytest.mark.parametrize(("share", "ends"), [(0.999, False), (1.001, True)])
def test_an_anamorphic_beam_is_said_to_end_where_its_rim_is_totally_reflected(share: float, ends: bool) -> None:
    """Light along the axis meets the section x–z of the back, a sphere of 12 mm, at sin i = x / 12 mm."""
    front = Surface(thickness_mm=9.0, index=1.8, semi_diameter_mm=share * 12.0 / 1.8, stop=True)
    back = Surface(radius_mm=-40.0, biconic={"radius_x_mm": -12.0}, semi_diameter_mm=11.0)
    assert ("beam end at surfaces[1]" in warnings_of(front, back)) is ends


@pytest.mark.parametrize(("tilt_deg", "said"), [(0.0, False), (1.0, True)])
def test_apertures_of_posed_elements_are_said_to_be_compared_with_the_prescription_only(
    tilt_deg: float, said: bool
) -> None:
    front = Surface(radius_mm=50.0, thickness_mm=5.0, index=1.5, semi_diameter_mm=8.0, stop=True)
    lens = Lens(
        surfaces=(front, Surface(semi_diameter_mm=9.0)),
        elements=({"surfaces": [0, 1], "pose": {"tilt_deg": [tilt_deg, 0.0, 0.0]}},),
    )
    camera = {"focus_mm": math.inf, "lens": lens, "sensor": {"pixels": [8, 8], "pixel_mm": 0.01}}
    scene = Scene.model_validate({"schema_version": 1, "camera": camera})
    assert any("axial beam of the prescription only" in each for each in first_order(scene).warnings) is said
