"""Spectral quantities and bands in scene files: what is read, written again, and refused with a line each."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.errors import FileError, LfmeshError, SceneError
from lfmesh.optics.cie import observer
from lfmesh.scene import loads
from tests.cameras import camera_without_array

PLANE = {"shape": {"kind": "plane", "width_mm": 100.0, "height_mm": 100.0}, "position_mm": [0.0, 0.0, -150.0]}
LAMP = {"kind": "point", "position_mm": [20.0, 30.0, -25.0], "power_w": 1.0}
RED = {"name": "red", "center_nm": 620.0, "fwhm_nm": 30.0}
TABLE = {"wavelengths_nm": (300.0, 900.0), "values": (0.2, 0.6)}
IN_BANDS = {"camera.sensor.bands": "rgb"}
LIGHT, MATERIAL = "lights[0].spectrum", "targets[0].material"


@pytest.fixture
def scene() -> lf.Scene:
    return lf.Scene(camera=camera_without_array(), targets=[PLANE], lights=[LAMP])


def test_presets_have_the_areas_of_their_functions(scene: lf.Scene) -> None:
    x, y, z = scene.changed({"camera.sensor.bands": "xyz"}).passbands
    w = np.arange(380.0, 781.0)
    np.testing.assert_allclose([b.response.area_nm for b in (x, y, z)], np.trapezoid(observer(w), w), rtol=1e-12)
    rgb = scene.changed(IN_BANDS)
    assert rgb.channel_names == ("R", "G", "B")
    assert rgb.reach_nm == (380.0, 735.0)
    np.testing.assert_allclose(rgb.wavelengths_nm[:2], (600.0, 540.0), rtol=1e-9)


def test_first_order_optics_takes_the_centroid_of_the_first_band(scene: lf.Scene) -> None:
    changed = scene.changed({"camera.sensor.bands": [RED, {**RED, "name": "blue", "center_nm": 450.0}]})
    np.testing.assert_allclose(lf.first_order(changed).wavelength_nm, 620.0, rtol=1e-9)
    assert lf.first_order(scene).wavelength_nm == 587.6


def test_text_and_tables_of_spectra_load_to_equal_scenes(scene: lf.Scene, tmp_path: Path) -> None:
    (tmp_path / "paint.csv").write_text("wavelength_nm,value\n300,0.1\n900,0.3\n")
    (tmp_path / "filter.csv").write_text("response,wavelength_nm\n0,500\n1,550\n0,600\n")
    scene = scene.in_folder(tmp_path).changed(
        {
            "camera.sensor.bands": [RED, {"name": "green", "response": "filter.csv"}],
            f"{MATERIAL}.reflectance": "paint.csv",
            LIGHT: "D65",
        }
    )
    again = loads(scene.dump_toml(), tmp_path)
    assert again == scene
    np.testing.assert_allclose(again.wavelengths_nm, (620.0, 550.0), rtol=1e-9)
    np.testing.assert_allclose(
        lf.build(again).tables.objects.scattering.parameters[0],
        np.interp(lf.build(again).lines.wavelengths_nm, (300.0, 900.0), (0.1, 0.3)),
    )


WRONG: list[tuple[dict[str, Any], str]] = [
    ({LIGHT: "D65"}, r"lights\[0\]\.spectrum: needs camera\.sensor\.bands"),
    ({LIGHT: {"blackbody_k": 3000.0}}, r"lights\[0\]\.spectrum: needs camera\.sensor\.bands"),
    ({f"{MATERIAL}.temperature_k": 3000.0}, r"temperature_k = 3000\.0: needs camera\.sensor\.bands"),
    ({f"{MATERIAL}.radiance_w_m2_sr": TABLE}, r"radiance_w_m2_sr: needs camera\.sensor\.bands"),
    ({**IN_BANDS, LIGHT: "D66"}, r"spectrum\.name = \"D66\": no illuminant .*did you mean 'D65'"),
    ({**IN_BANDS, LIGHT: 2.0}, r"spectrum = 2\.0: must be a table"),
    ({**IN_BANDS, LIGHT: {}}, r"lights\[0\]\.spectrum: a spectrum needs wavelengths_nm with values, or file"),
    ({**IN_BANDS, LIGHT: {"name": "A", "blackbody_k": 3000.0}}, r"blackbody_k = 3000\.0: name is given too"),
    ({**IN_BANDS, LIGHT: {"blackbody_k": 0.0}}, r"blackbody_k = 0\.0: must be 1 or more"),
    ({**IN_BANDS, LIGHT: {"wavelengths_nm": (400.0, 700.0), "values": (1.0, 1.0)}},
     r"spectrum: its spectrum extends from 400 to 700 nm, but the scene's wavelengths lie from 380 to 735 nm"),
    ({**IN_BANDS, LIGHT: {"wavelengths_nm": (300.0, 900.0), "values": (1.0,)}}, r"2 wavelengths and 1 values"),
    ({**IN_BANDS, LIGHT: {"wavelengths_nm": (900.0, 300.0), "values": (1.0, 1.0)}}, "wavelengths must increase"),
    ({**IN_BANDS, LIGHT: {"wavelengths_nm": (300.0, 900.0), "values": (1.0, -1.0)}}, "value -1 at 900 nm"),
    ({f"{MATERIAL}.reflectance": 1.5}, r"material\.reflectance = 1\.5: must be 1 or less"),
    ({f"{MATERIAL}.reflectance": "D65"}, r"material\.reflectance: an illuminant is no reflectance"),
    ({f"{MATERIAL}.reflectance": {"blackbody_k": 3000.0}}, r"material\.reflectance: a black body is no reflectance"),
    ({f"{MATERIAL}.reflectance": {**TABLE, "values": (0.5, 1.5)}}, r"value 1\.5 at 900 nm: a reflectance must lie"),
    ({f"{MATERIAL}.reflectance": {**TABLE, "wavelengths_nm": (300.0, 500.0)}}, r"extends from 300 to 500 nm"),
    ({**IN_BANDS, f"{MATERIAL}.radiance_w_m2_sr": "D65"}, r"an illuminant has no absolute scale"),
    ({**IN_BANDS, f"{MATERIAL}.spectrum": "D65"}, r"material\.spectrum: omit it: .* no radiance_w_m2_sr"),
    ({**IN_BANDS, f"{MATERIAL}.temperature_k": 900.0, f"{MATERIAL}.radiance_w_m2_sr": 1.0}, "give one of them"),
    ({"camera.sensor.bands": ()}, r"sensor\.bands: must not be empty"),
    ({"camera.sensor.bands": "rbg"}, r"bands = \"rbg\": must be 'rgb' or 'xyz' \(did you mean 'rgb'"),
    ({"camera.sensor.bands": 3}, r"sensor\.bands = 3: must be a list"),
    ({"camera.sensor.bands": [{"name": "a", "center_nm": 500.0}]}, r"bands\[0\]\.fwhm_nm: missing"),
    ({"camera.sensor.bands": [{"name": "a", "fwhm_nm": 50.0}]}, r"bands\[0\]\.center_nm: missing"),
    ({"camera.sensor.bands": [{**RED, "response": "a.csv"}]}, r"center_nm = 620\.0: response is given too"),
    ({"camera.sensor.bands": [{**RED, "fwhm_nm": 400.0}]}, r"fwhm_nm = 400\.0: the band extends from 20 to 1220 nm"),
    ({"camera.sensor.bands": [{**RED, "name": "a/b"}]}, r"name = \"a/b\": a band name has at most 32 characters"),
    ({"camera.sensor.bands": [RED, RED]}, r"bands\[1\]\.name = \"red\": another band has this name"),
    ({"camera.sensor.bands": [RED] * 65}, r"65 bands are given; a sensor has at most 64"),
    ({**IN_BANDS, "transport.wavelengths_nm": (500.0, 600.0)}, r"wavelengths_nm = .*bands is given too"),
    ({**IN_BANDS, "camera.lens.surfaces[0].index": None, "camera.lens.surfaces[0].glass": "HIKARI/SK16"},
     r"surfaces\[0\]\.glass: .*380 nm.*from 400 to 700 nm"),
]  # fmt: skip


@pytest.mark.parametrize(("values", "message"), WRONG)
def test_wrong_spectra_and_bands_are_refused(scene: lf.Scene, values: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        scene.changed(values)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("500,0\n600,0\n", "the response is 0 at every wavelength"),
        ("500,0\n", "two wavelengths or more"),
        ("500,0\n600,-1\n", "value -1 at 600 nm"),
    ],
)
def test_a_wrong_file_of_a_response_is_refused(scene: lf.Scene, tmp_path: Path, rows: str, message: str) -> None:
    (tmp_path / "filter.csv").write_text("wavelength_nm,response\n" + rows)
    bands = [{"name": "a", "response": "filter.csv"}]
    with pytest.raises(FileError, match=message):
        lf.build(scene.changed({"camera.sensor.bands": bands}).in_folder(tmp_path))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({f"{MATERIAL}.reflectance": "short.csv"}, r"material\.reflectance: its spectrum extends from 500 to 600 nm"),
        ({f"{MATERIAL}.reflectance": "high.csv"}, r"material\.reflectance: value 2 at 900 nm"),
        ({LIGHT: "short.csv"}, r"lights\[0\]\.spectrum: its spectrum extends from 500 to 600 nm"),
        ({LIGHT: "dark.csv"}, r"lights\[0\]\.spectrum: it has no power from 380 to 735 nm"),
        ({LIGHT: "missing.csv"}, r"missing\.csv: cannot be read"),
    ],
)
def test_files_that_do_not_fit_are_refused_when_they_are_read(
    scene: lf.Scene, tmp_path: Path, change: dict[str, Any], message: str
) -> None:
    head = "wavelength_nm,value\n"
    (tmp_path / "short.csv").write_text(head + "500,0.5\n600,0.5\n")
    (tmp_path / "high.csv").write_text(head + "300,0.5\n900,2\n")
    (tmp_path / "dark.csv").write_text(head + "300,0\n900,0\n")
    with pytest.raises(LfmeshError, match=message) as raised:
        lf.build(scene.changed({**IN_BANDS, **change}).in_folder(tmp_path))
    assert "\n" not in str(raised.value)


def test_a_scene_at_a_line_has_no_spectra_left(scene: lf.Scene) -> None:
    scene = scene.changed({**IN_BANDS, LIGHT: "D65", f"{MATERIAL}.temperature_k": 2000.0})
    line = scene.at_line(500.0)
    assert line.wavelengths_nm == (500.0,)
    assert line.targets[0].material.radiance_w_m2_sr == 1.0
    assert line.lights[0].spectrum is None
