"""Coatings in a scene file: what they may be, where they are named, and what is refused in one clear line."""

import json

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.cli import main
from lfmesh.errors import LfmeshError, SceneError
from lfmesh.optics.coatings import Stack, coated
from lfmesh.optics.glass import complex_index
from lfmesh.scene import Coating, Layer
from lfmesh.scene.inputs import files_of

SCENE = """schema_version = 1
[camera]
focus_mm = 500.0
[camera.lens]
f_number = 4.0
surfaces = [
  { radius_mm = 60.0, thickness_mm = 4.0, index = 1.5, semi_diameter_mm = 10.0, coating = "ar" },
  { radius_mm = -60.0, semi_diameter_mm = 10.0 },
]
[camera.mla]
count = [4, 4]
pitch_mm = 0.5
focal_length_mm = 2.6
index = 1.5
thickness_mm = 0.5
curved_coating = "ar"
flat_coating = "none"
[camera.sensor]
pixels = [20, 20]
pixel_mm = 0.1
[coatings.ar]
layers = [{ index = 1.38, thickness_nm = 106.5 }]
[coatings.half]
reflectance = 0.5
"""


def test_a_scene_with_coatings_loads_and_comes_back_from_what_it_writes():
    scene = lf.loads(SCENE)
    assert scene.coatings["ar"] == Coating(layers=[Layer(index=1.38, thickness_nm=106.5)])
    assert scene.camera.lens.surfaces[0].coating == "ar"
    assert scene.camera.lens.surfaces[1].coating == "none"
    again = lf.loads(scene.dump_toml())
    assert again == scene
    assert again.digest == scene.digest
    assert lf.solved(scene).coatings == scene.coatings
    thinner = scene.changed({"coatings.ar.layers[0].thickness_nm": 90.0})
    assert thinner.coatings["ar"].layers[0].thickness_nm == 90.0
    assert thinner.digest != scene.digest


LAYER = "{ index = 1.38, thickness_nm = 106.5 }"
AR = f"layers = [{LAYER}]"
WRONG = {
    "no thickness": (LAYER, "{ index = 1.38 }", "coatings.ar.layers[0].thickness_nm: missing"),
    "thickness zero": ("106.5", "0.0", "coatings.ar.layers[0].thickness_nm = 0.0: must be above 0"),
    "negative thickness": ("106.5", "-3.0", "coatings.ar.layers[0].thickness_nm = -3.0: must be above 0"),
    "thickness without end": ("106.5", "inf", "coatings.ar.layers[0].thickness_nm = inf: must be a finite number"),
    "thickness no number": ("106.5", "nan", "coatings.ar.layers[0].thickness_nm = nan: must be a finite number"),
    "negative index": ("1.38", "-1.38", "coatings.ar.layers[0].index = -1.38: must be above 0"),
    "index no number": ("1.38", "nan", "coatings.ar.layers[0].index = nan"),
    "negative extinction": ("1.38,", "1.38, extinction = -0.1,", "layers[0].extinction = -0.1: must be 0 or more"),
    "no index": (LAYER, "{ thickness_nm = 90.0 }", "coatings.ar.layers[0].index: missing: give the index of the layer"),
    "index and glass": ("1.38,", '1.38, glass = "SCHOTT/N-BK7",', "glass = \"SCHOTT/N-BK7\": index = 1.38 is"),
    "glass and extinction": (
        "index = 1.38,", 'glass = "main/Al/Rakic", extinction = 1.0,', "layers[0].extinction = 1.0: omit it",
    ),
    "unknown glass": ("index = 1.38,", 'glass = "SCHOTT/N-BK77",', "coatings.ar.layers[0].glass"),
    "empty stack": (AR, "layers = []", "coatings.ar.layers: 0 layers are given; a stack has 1 to 1000"),
    "nothing": (AR, "", "coatings.ar: a coating needs one of reflectance, table, measured"),
    "layers and reflectance": (AR, f"{AR}\nreflectance = 0.1", "coatings.ar.layers: reflectance is given too"),
    "reflectance and table": ("reflectance = 0.5", 'reflectance = 0.5\ntable = "x.csv"', "coatings.half.table"),
    "reflectance above 1": ("reflectance = 0.5", "reflectance = 1.5", "half.reflectance = 1.5: must be 1 or less"),
    "negative reflectance": ("reflectance = 0.5", "reflectance = -0.5", "half.reflectance = -0.5: must be 0"),
    "reflectance no number": ("reflectance = 0.5", "reflectance = nan", "half.reflectance = nan: must be"),
    "no such file": ("reflectance = 0.5", 'table = "gone.csv"', "gone.csv"),
    "unknown name": (
        'coating = "ar"', 'coating = "arr"',
        "camera.lens.surfaces[0].coating = \"arr\": no coating has this name (did you mean 'ar'?); there are ar, half",
    ),
    "unknown on the array": ('curved_coating = "ar"', 'curved_coating = "rare"', "mla.curved_coating = \"rare\""),
    "unknown key": ("reflectance = 0.5", "reflectence = 0.5", "unknown key (did you mean 'reflectance'?)"),
    "named none": ("[coatings.half]", "[coatings.none]", 'coatings.none: "none" stands for a bare surface'),
    "a name with a dot": ("[coatings.half]", '[coatings."h.alf"]', "has only letters, digits, _ and -"),
    "no text": ('coating = "ar"', "coating = 3", "camera.lens.surfaces[0].coating = 3: must be text in quotes"),
    "a coated stop": (
        "surfaces = [", 'surfaces = [ { stop = true, thickness_mm = 1.0, coating = "ar" },',
        "camera.lens.surfaces[0].coating = \"ar\": omit it: a stop without glass is no interface",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("old", "new", "reason"), WRONG.values(), ids=WRONG)
def test_a_wrong_coating_is_refused_in_one_line(tmp_path, old, new, reason):
    assert old in SCENE
    with pytest.raises(SceneError) as refused:
        lf.loads(SCENE.replace(old, new, 1), tmp_path)
    assert reason in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_layer_whose_glass_does_not_reach_the_wavelength_is_refused():
    text = SCENE.replace("index = 1.38,", 'glass = "main/MgF2/Li-o",')
    assert lf.loads(text).coatings["ar"].layers[0].glass == "main/MgF2/Li-o"
    with pytest.raises(SceneError, match=r"coatings\.ar\.layers\[0\]\.glass: .*at 20000 nm: its data reach from"):
        lf.loads(text + "[transport]\nwavelengths_nm = [20000.0]\n")


def test_films_of_the_catalogue_have_their_extinction_and_makers_glasses_none():
    assert complex_index("main/Al/Rakic", 550.0) == pytest.approx(1.0152 + 6.6273j, abs=1e-4)
    assert complex_index("main/MgF2/Li-o", 550.0).imag == 0.0
    assert complex_index("SCHOTT/N-BK7", 587.6) == pytest.approx(1.5168, abs=1e-5)
    with pytest.raises(LfmeshError):
        complex_index("main/Al/Rakic", 1e9)


def test_a_coatings_file_is_among_those_of_the_scene(tmp_path):
    (tmp_path / "r.csv").write_text("")
    scene = lf.loads(SCENE.replace("reflectance = 0.5", 'table = "r.csv"'), tmp_path)
    assert ("coatings.half.table", "r.csv") in list(files_of(scene))


def test_an_element_given_as_a_mesh_has_its_coating_on_the_refractor(tmp_path):
    (tmp_path / "x.stl").write_text("")
    with pytest.raises(SceneError, match=r'surfaces\[0\]\.coating = "ar": omit it: .*coating of the refractor'):
        lf.loads(
            SCENE.replace(
                '{ radius_mm = 60.0, thickness_mm = 4.0, index = 1.5, semi_diameter_mm = 10.0, coating = "ar" }',
                '{ thickness_mm = 4.0, coating = "ar", refractor = { file = "x.stl", units = "mm", index = 1.5 } }',
            ),
            tmp_path,
        )


def test_check_says_what_coatings_reflect_and_which_are_not_used(tmp_path, capsys):
    (tmp_path / "scene.toml").write_text(SCENE)
    assert main(["check", str(tmp_path / "scene.toml")]) == 0
    lines = capsys.readouterr().out.replace("\n  ", " ").splitlines()
    own = [line for line in lines if line.startswith("coating of ")]
    # Magnesium fluoride of 106.5 nm on n = 1.5 at 587.6 nm, just off its quarter wave.
    assert [line.split("  ")[0] for line in own] == ["coating of lens surface 0", "coating of the mla's curved face"]
    assert all("ar: reflects 1.41 % at 0, 1.53 % at 30, 5.51 % at 60 degrees; tabulated to " in line for line in own)
    assert "Note: coatings.half: no surface has this coating" in lines


def test_check_says_what_passes_a_coating_that_absorbs(tmp_path, capsys):
    (tmp_path / "scene.toml").write_text(SCENE.replace("index = 1.38,", "index = 1.38, extinction = 0.2,"))
    assert main(["check", str(tmp_path / "scene.toml")]) == 0
    lines = capsys.readouterr().out.replace("\n  ", " ").splitlines()
    cosines = np.cos(np.deg2rad([0.0, 30.0, 60.0]))
    reflected, passed = coated(1.0, 1.5, Stack((1.38 + 0.2j,), (106.5,)), 587.6, cosines)
    assert all(reflected + passed < 0.9)
    one, other = (
        ", ".join(f"{100.0 * share:.3g} % at {angle}" for share, angle in zip(shares, (0, 30, 60), strict=True))
        for shares in (reflected, passed)
    )
    said = f"ar: reflects {one} degrees, passes {other} degrees; tabulated to "
    assert sum(said in line for line in lines) == 2


def test_a_run_states_the_error_of_its_tables(tmp_path):
    plane = '[[targets]]\nshape = { kind = "plane", width_mm = 60.0, height_mm = 60.0 }\nposition_mm = [0, 0, -500]\n'
    text = SCENE + plane.replace("[0, 0, -500]", "[0.0, 0.0, -500.0]") + "[targets.material]\nradiance_w_m2_sr = 1.0\n"
    image = lf.render(lf.loads(text + '[transport]\nsamples = 2\nreplicates = 2\nsplit = "transmit"\n'))
    assert set(image.coatings) == {"ar"}
    assert 0.0 < image.coatings["ar"] < 1e-6
    lf.save(image, tmp_path / "run")
    assert lf.open_run(tmp_path / "run").coatings == image.coatings
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    assert report["coatings"] == image.coatings
    assert any(line.startswith("Reflectance of coating ar comes from tables, to ") for line in report["summary"])
