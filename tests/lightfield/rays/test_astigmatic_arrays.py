"""Lenslets that act as cylinders by a phase are refused where glass cylinders are."""

from collections.abc import Callable
from typing import Any

import pytest

import lfmesh as lf
from lfmesh.scene import solved

LENS = [
    {"radius_mm": 40.0, "thickness_mm": 4.0, "index": 1.6, "semi_diameter_mm": 6.0},
    {"radius_mm": -40.0, "semi_diameter_mm": 6.0, "thickness_mm": 1.0},
    {"stop": True, "semi_diameter_mm": 4.0},
]
POWER = -57.12
"""Coefficient, rad at 0.1 mm, of a focal length of 1 mm at 550 nm."""


def scene(**face: Any) -> lf.Scene:
    mla = {"count": [8, 8], "pitch_mm": 0.25, "thickness_mm": 0.4, "index": 1.46, "curved_side": "sensor", **face}
    sensor = {"pixels": [32, 32], "pixel_mm": 0.0625}
    camera = {"focus_mm": 300.0, "lens": {"surfaces": LENS}, "mla": mla, "sensor": sensor}
    return lf.Scene(camera=camera, transport={"wavelengths_nm": [550.0]})


def by_phase(*terms: tuple[int, int, float], **face: Any) -> lf.Scene:
    phase = {"kind": "xy", "radius_mm": 0.1, "coefficients_rad": [list(term) for term in terms]}
    return scene(curved_phase=phase, **face)


CYLINDERS = {
    "glass": scene(radius_mm=0.46, cylinder_axis="x"),
    "a phase with power in y": by_phase((0, 2, POWER)),
    "a phase with power in x": by_phase((2, 0, POWER)),
    "two powers": by_phase((2, 0, POWER), (0, 2, 0.5 * POWER)),
    "a phase with power in a diagonal": by_phase((2, 0, POWER / 2), (0, 2, POWER / 2), (1, 1, POWER)),
    "a sphere without power in x": by_phase((2, 0, -POWER), radius_mm=0.46),
}
LENSLETS = {
    "equal powers": by_phase((2, 0, POWER), (0, 2, POWER)),
    "a little astigmatism": by_phase((2, 0, POWER), (0, 2, 0.85 * POWER)),
    "crossed cylinders of glass and a phase": by_phase((2, 0, POWER), radius_mm=0.46, cylinder_axis="x"),
}


@pytest.mark.parametrize("use", [lf.calibrate, lf.camera_model])
@pytest.mark.parametrize("name", CYLINDERS)
def test_lenslets_that_make_lines_are_not_decoded(name: str, use: Callable[[lf.Scene], object]) -> None:
    with pytest.raises(lf.LfmeshError, match=r"camera\.mla\.\w+: |camera\.mla\.cylinder_axis = .* lines") as error:
        use(CYLINDERS[name])
    assert "make lines, not micro-images" in str(error.value)


@pytest.mark.parametrize("name", LENSLETS)
def test_lenslets_of_one_power_are_decoded_whatever_gives_it(name: str) -> None:
    assert lf.calibrate(LENSLETS[name]).centres_px.shape == (8, 8, 2)


def test_check_warns_of_astigmatism_that_is_decoded() -> None:
    """The line is a fifth of a pitch of 10 pixels, but below a pixel in a pitch of 4."""
    coarse = by_phase((2, 0, POWER), (0, 2, 0.8 * POWER))
    assert not [each for each in lf.first_order(coarse).warnings if "the lenslets are astigmatic" in each]
    fine = coarse.changed({"camera.sensor.pixel_mm": 0.025})
    assert any("is 2 pixels long in the other" in each for each in lf.first_order(fine).warnings)


@pytest.mark.parametrize("name", CYLINDERS)
def test_no_plane_in_focus_is_reported_for_lines(name: str) -> None:
    assert lf.first_order(CYLINDERS[name].changed({"camera.sensor.distance_mm": 2.0})).focused == ()


def test_the_sensor_lies_in_the_focus_of_the_larger_power_of_sphere_and_phase() -> None:
    """The phase takes power away in y; so x has the larger one, as alone."""
    scenes = scene(radius_mm=0.46), by_phase((0, 2, -POWER / 2), radius_mm=0.46)
    sphere, both = (solved(each).camera.sensor.distance_mm for each in scenes)
    assert both == pytest.approx(sphere, rel=1e-9)
