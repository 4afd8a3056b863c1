"""Coefficients of any magnitude end in lines that name them, not in an overflow."""

from typing import Any

import pytest

import lfmesh as lf

HUGE = [1e30, -1e30, 1e155, -1e300]
FRONT = {"radius_mm": 40.0, "thickness_mm": 4.0, "semi_diameter_mm": 6.0, "stop": True}
ARRAY = {"count": [4, 4], "pitch_mm": 0.25, "thickness_mm": 0.4, "index": 1.46}


def scene(front: dict[str, Any], mla: dict[str, Any] | None = None) -> lf.Scene:
    glass = {} if "gradient" in front else {"index": 1.6}
    # A stop without an aperture is sized by the f-number.
    size = {"f_number": 8.0} if front.get("semi_diameter_mm", 1.0) is None else {}
    camera: dict[str, Any] = {
        "focus_mm": 300.0,
        "lens": {"surfaces": [FRONT | glass | front, {"radius_mm": -40.0, "semi_diameter_mm": 6.0}]} | size,
        "sensor": {"pixels": [8, 8], "pixel_mm": 0.1},
    }
    return lf.Scene(camera=camera if mla is None else camera | {"mla": ARRAY | mla})


def radial(huge: float, radius_mm: float = 5.0) -> dict[str, Any]:
    return {"kind": "radial", "coefficients_rad": [0.0, huge], "radius_mm": radius_mm}


def zones(huge: float) -> dict[str, Any]:
    inner = {"border_mm": 1.0, "coefficients_rad": [huge], "radius_mm": 1.0}
    return {"kind": "zones", "zones": [inner, {"coefficients_rad": [1.0], "radius_mm": 1.0}]}


def xy(huge: float) -> dict[str, Any]:
    return {"kind": "xy", "coefficients_rad": [[0, 2, huge]], "radius_mm": 5.0}


def gradium(huge: float) -> dict[str, Any]:
    return {"kind": "gradium", "coefficients": [1.6, huge], "blank_mm": 1e-6}


SURFACES = {
    "phase.coefficients_rad[1]": lambda huge: {"phase": radial(huge)},
    "phase.coefficients_rad[0][2]": lambda huge: {"phase": xy(huge)},
    "phase.zones[0].coefficients_rad[0]": lambda huge: {"phase": zones(huge)},
    "asphere_mm[0]": lambda huge: {"asphere_mm": [huge]},
    "odd_asphere_mm[0]": lambda huge: {"odd_asphere_mm": [huge]},
    "qcon": lambda huge: {"qcon": {"norm_radius_mm": 8.0, "coefficients_mm": [huge]}},
    "qbfs": lambda huge: {"qbfs": {"norm_radius_mm": 8.0, "coefficients_mm": [huge]}},
    "toroid, asphere_mm[0]": lambda huge: {"toroid": {"radius_x_mm": 40.0}, "asphere_mm": [huge]},
    "outer_zone": lambda huge: {"outer_zone": {"border_mm": 2.0, "radius_mm": 40.0, "asphere_mm": [huge]}},
    "gradient": lambda huge: {"gradient": {"kind": "axial", "index": 1.6, "coefficients": [0.0, huge]}},
    "gradient of a blank, gradient": lambda huge: {"gradient": gradium(huge)},
    "gradient without an aperture, gradient": lambda huge: {
        "gradient": {"kind": "radial_n2", "index": 1.6, "coefficients": [huge]}, "semi_diameter_mm": None,
    },
}  # fmt: skip
ARRAYS = {
    "curved_phase.coefficients_rad[1]": lambda huge: {"curved_phase": radial(huge, 0.1)},
    "flat_phase.coefficients_rad[1]": lambda huge: {"radius_mm": 0.5, "flat_phase": radial(huge, 0.1)},
    "radius_mm": lambda huge: {"radius_mm": 0.5, "asphere_mm": [huge]},
    "gradient": lambda huge: {
        "index": None, "gradient": {"kind": "radial_n", "index": 1.6, "coefficients": [huge]},
    },
}  # fmt: skip


@pytest.mark.parametrize("huge", HUGE)
@pytest.mark.parametrize("key", SURFACES)
def test_a_huge_coefficient_of_a_surface_is_refused_by_its_key(key: str, huge: float) -> None:
    with pytest.raises(lf.SceneError) as error:
        lf.first_order(scene(SURFACES[key](huge)))
    assert any(f"surfaces[0].{key.split(', ')[-1]}" in line for line in str(error.value).splitlines())


@pytest.mark.parametrize("huge", HUGE)
@pytest.mark.parametrize("key", ARRAYS)
def test_a_huge_coefficient_of_an_array_is_refused_by_its_key(key: str, huge: float) -> None:
    with pytest.raises(lf.SceneError) as error:
        lf.first_order(scene({}, ARRAYS[key](huge)))
    assert any(f"mla.{key}" in line for line in str(error.value).splitlines())
