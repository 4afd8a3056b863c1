"""The lens sheet of diffractive lenses: foci by wavelength, the order that is followed, and what is refused."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.analysis.analysis import analyse
from lfmesh.view.lens_sheet import draw_lens_sheet

WAVES_NM = (500.0, 550.0, 600.0)
F_MM = 20.0
RADIAL = {"kind": "radial", "coefficients_rad": [-math.pi * 16.0 / (550e-6 * F_MM)], "radius_mm": 4.0}


def scene(phase: dict[str, Any], **changes: Any) -> lf.Scene:
    front = {"stop": True, "thickness_mm": 1.0, "index": 1.5, "semi_diameter_mm": 1.0}
    given = lf.Scene(
        camera={
            "focus_mm": math.inf,
            "lens": {"surfaces": [front, {"semi_diameter_mm": 4.0, "phase": phase}]},
            "sensor": {"pixels": (40, 40), "pixel_mm": 0.05},
        },
        transport={"wavelengths_nm": WAVES_NM},
    )
    return given.changed(changes)


def test_foci_of_wavelengths_are_those_of_a_diffractive_lens() -> None:
    """f is inverse to the wavelength, for the innermost zone; the sheet says the order."""
    found = analyse(scene(RADIAL))
    middle = found.zone_foci_mm[1, 0]
    for k, wave in enumerate(WAVES_NM):
        expected = F_MM * (550.0 / wave - 1.0)
        assert found.zone_foci_mm[k, 0] - middle == pytest.approx(expected, abs=0.002)
    assert found.orders == ("camera.lens.surfaces[1].phase: followed in order 1",)
    assert found.orders[0] in found.lines()
    assert found.as_dict()["orders"] == list(found.orders)


def test_the_sheet_of_several_orders_follows_the_main_one(tmp_path: Path) -> None:
    orders = [{"order": -1, "share": 0.1}, {"order": 1, "share": 0.6}]
    several, one = analyse(scene({**RADIAL, "orders": orders})), analyse(scene(RADIAL))
    for left, right in zip(several.spots, one.spots, strict=True):
        np.testing.assert_allclose(left.place_mm, right.place_mm, atol=1e-12)
    assert several.orders[0].endswith("order 1, without the light of its other orders")
    assert several.orders[0] in draw_lens_sheet(several, tmp_path / "sheet.html").read_text(encoding="utf-8")


def test_phases_without_an_axis_have_no_sheet() -> None:
    grating = {"kind": "grating", "lines_per_mm": 20.0}
    given = scene(RADIAL).changed({"camera.lens.surfaces[0].phase": grating})
    with pytest.raises(lf.LfmeshError, match=r"surfaces\[0\].phase.*of revolution only"):
        analyse(given)


def test_an_array_with_a_phase_has_figures_of_its_light_field() -> None:
    """Metalenses in place of glass lenslets of the same focal length: the same cross-talk, nearly."""
    lens = {"surfaces": [{"paraxial": True, "focal_length_mm": 50.0, "stop": True, "semi_diameter_mm": 6.25}]}
    array = {"count": (32, 32), "pitch_mm": 0.125, "index": 1.5, "thickness_mm": 0.3}
    glass = {**array, "focal_length_mm": 0.5}
    metalens = {**array, "curved_phase": {"kind": "metalens", "focal_length_mm": 0.5, "design_nm": 550.0}}
    shares = []
    for mla in (glass, metalens):
        camera = {"focus_mm": 500.0, "lens": lens, "mla": mla, "sensor": {"pixels": (320, 320), "pixel_mm": 0.0125}}
        found = analyse(lf.Scene(camera=camera, transport={"wavelengths_nm": (550.0,)}), object_mm=500.0)
        assert found.light_field is not None, found.no_light_field
        shares.append([each.from_others for each in found.light_field.crosstalk])
    np.testing.assert_allclose(shares[1], shares[0], atol=0.03)
    assert found.orders == ("camera.mla.curved_phase: followed in order 1",)
