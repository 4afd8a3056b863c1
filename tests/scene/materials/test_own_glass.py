"""Glasses by their dispersion in scene files: read, written again, compared, and refused in one line."""

from pathlib import Path

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.errors import SceneError
from lfmesh.optics.glass import refractive_index
from lfmesh.scene.files import load_lens
from lfmesh.scene.materials.glasses import glass_lines
from lfmesh.scene.materials.own_glass import OwnGlass
from tests.cameras import bench_camera

SCENE = """
schema_version = 1
[camera]
[camera.lens]
surfaces = [
  { radius_mm = 30.0, thickness_mm = 3.0, glass = GLASS, semi_diameter_mm = 5.0, stop = true },
  { radius_mm = -30.0, semi_diameter_mm = 5.0 },
]
[camera.sensor]
pixels = [8, 8]
pixel_mm = 0.1
distance_mm = 30.0
"""
MODEL = "{ nd = 1.5168, vd = 64.17 }"
SELLMEIER = "{ sellmeier_b = [1.1, 0.2], sellmeier_c_um2 = [0.01, 100.0] }"
VALUES = "{ wavelengths_nm = [400, 550, 700], values = [1.53, 1.52, 1.51] }"


def scene_of(glass: str, folder: Path = Path()) -> lf.Scene:
    return lf.loads(SCENE.replace("GLASS", glass), folder)


@pytest.mark.parametrize("glass", [MODEL, SELLMEIER, VALUES])
def test_a_written_scene_is_the_same_scene(glass: str) -> None:
    scene = scene_of(glass)
    again = lf.loads(scene.dump_toml())
    assert again == scene
    assert hash(again) == hash(scene)
    assert scene.digest != scene_of(MODEL.replace("64.17", "64.18")).digest


def test_a_table_is_read_beside_the_scene_and_stands_in_it(tmp_path: Path) -> None:
    (tmp_path / "n.csv").write_text("wavelength_nm,n\n400,1.53\n550,1.52\n700,1.51\n")
    scene = scene_of('{ table = "n.csv" }', tmp_path)
    assert scene == scene_of(VALUES)
    (tmp_path / "n.csv").unlink()
    assert lf.loads(scene.dump_toml()) == scene


def test_a_table_of_a_lens_file_is_read_beside_that(tmp_path: Path) -> None:
    folder = tmp_path / "lenses"
    folder.mkdir()
    (folder / "n.csv").write_text("wavelength_nm,n\n400,1.53\n550,1.52\n700,1.51\n")
    head, tail = SCENE.split("surfaces")
    surfaces, rest = tail.split("[camera.sensor]")
    (folder / "own.toml").write_text("surfaces" + surfaces.replace("GLASS", '{ table = "n.csv" }'))
    scene = lf.loads(f'{head}file = "lenses/own.toml"\n[camera.sensor]{rest}', tmp_path)
    assert scene.camera.lens.surfaces == scene_of(VALUES).camera.lens.surfaces
    assert load_lens(folder / "own.toml").surfaces == scene.camera.lens.surfaces


def test_first_order_and_rays_know_it() -> None:
    """Sellmeier's coefficients of N-BK7 make the lens of the catalogue's glass."""
    named = scene_of('"SCHOTT/N-BK7"')
    formula = scene_of(
        "{ sellmeier_b = [1.03961212, 0.231792344, 1.01046945], "
        "sellmeier_c_um2 = [0.00600069867, 0.0200179144, 103.560653] }"
    )
    assert lf.first_order(formula).efl_mm == pytest.approx(lf.first_order(named).efl_mm, rel=1e-12)
    worlds = [lf.build(scene, aimed=False) for scene in (named, formula)]
    for wavelength_nm in (486.1, 656.3):
        one, other = (lf.trace(world, [0.0, 2.0, -9.0], [0.05, 0.1, 1.0], wavelength_nm) for world in worlds)
        assert len(one) > 0
        np.testing.assert_allclose(one.direction, other.direction, rtol=0.0, atol=1e-12)


def test_check_names_it() -> None:
    lines = glass_lines(scene_of(MODEL))
    assert len(lines) == 1
    assert "model glass (nd 1.51680, Vd 64.17): surface 0" in lines[0]


def test_the_schema_has_it() -> None:
    assert "sellmeier_c_um2" in str(lf.Scene.model_json_schema())


@pytest.mark.parametrize(
    ("glass", "line"),
    [
        ("{ nd = 0.9, vd = 60.0 }", "glass.nd = 0.9: must be 1 or more"),
        ("{ nd = 1.5, vd = 0.0 }", "glass.vd = 0.0: must be above 0"),
        ("{ nd = 1.5 }", "glass.vd: missing"),
        ("{ nd = nan, vd = 60.0 }", "glass.nd = nan: must be a finite number"),
        ("{}", "a glass needs nd with vd"),
        ("3", 'glass = 3: must be a name, like "SCHOTT/N-BK7", or a table, like { nd = 1.5168, vd = 64.17 }'),
        ("true", "glass = true: must be a name"),
        ("{ nd = 1.5, vd = 60.0, sellmeier_b = [1.0] }", "glass.sellmeier_b = [1.0]: nd is given too"),
        ("{ sellmeier_b = [1.0], sellmeier_c_um2 = [0.01, 0.02] }", "2 coefficients, but 1"),
        ("{ sellmeier_b = [1.0], sellmeier_c_um2 = [-0.01] }", "must be 0 or more"),
        ("{ sellmeier_b = [], sellmeier_c_um2 = [] }", "0 coefficients"),
        ("{ sellmeier_b = [-3.0], sellmeier_c_um2 = [0.01] }", "at 587.6 nm: n² ="),
        ('{ table = "none.csv" }', 'glass.table = "none.csv": no such file'),
        ("{ wavelengths_nm = [700, 400], values = [1.5, 1.5] }", "wavelengths must increase"),
        ("{ wavelengths_nm = [400, 400.00000000000006, 700], values = [1.5, 1.5, 1.5] }", "wavelengths 0.001 nm apart"),
        ("{ wavelengths_nm = [400, 700], values = [1.5] }", "each wavelength needs one value"),
        ("{ wavelengths_nm = [400, 700], values = [0.5, 1.5] }", "at 400 nm: an index must lie between 1 and 10"),
        ("{ wavelengths_nm = [400, 500], values = [1.5, 1.5] }", "its table reaches from 400 to 500 nm"),
        ('"/N-BK7"', "nothing stands before or after a /; close to it are SCHOTT/N-BK7"),
        ('"SCHOTT/"', "nothing stands before or after a /"),
    ],
)
def test_faults_are_one_line(glass: str, line: str) -> None:
    with pytest.raises(SceneError) as refused:
        scene_of(glass)
    message = str(refused.value)
    assert line in message
    assert len(message.splitlines()) == 1
    assert "camera.lens.surfaces[0].glass" in message


def test_a_gap_in_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "n.csv").write_text("wavelength_nm,n\n400,1.53\n550,\n700,1.51\n")
    with pytest.raises(SceneError, match=r"value nan at 550 nm: it must be a finite number"):
        scene_of('{ table = "n.csv" }', tmp_path)


def test_a_script_gives_it_to_the_array_and_to_bodies() -> None:
    glass = OwnGlass(nd=1.49, vd=57.4)
    body = lf.Refractor(file="a.stl", units="mm", glass=glass)
    array = lf.MicrolensArray(count=(4, 4), pitch_mm=0.1, radius_mm=0.2, thickness_mm=0.3, glass=glass)
    for medium in (body.medium, array.medium):
        assert refractive_index(medium, 587.5618) == pytest.approx(1.49, abs=1e-15)


def test_a_table_whose_name_no_file_can_have_is_refused_in_a_line(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="File name too long"):
        lf.loads(bench_camera(4, 4).replace("index = 1.5", f'glass = {{ table = "{"x" * 300}" }}', 1), tmp_path)
