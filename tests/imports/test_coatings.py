"""Coatings of Zemax files: light that traced rays keep against the package `tmm`, and what is said of the others."""

import warnings
from pathlib import Path

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.errors import LensFileWarning, SceneError
from lfmesh.imports import read_lens_file, write_lens_file
from lfmesh.imports.report import Verdict
from lfmesh.scene import load_lens, loads
from lfmesh.scene.camera.lens import FileChoices

PRIMARY_NM = 587.5618

PLATE = """\
MODE SEQ
UNIT MM
ENPD 8
FTYP 0 0 1 1
YFLN 0
WAVM 1 0.5875618 1
PWAV 1
SURF 0
  TYPE STANDARD
  CURV 0.0
  DISZ INFINITY
SURF 1
  STOP
  TYPE STANDARD
  COAT {front}
  CURV 1e-9 0 0 0 0
  DISZ 5
  GLAS ___BLANK 1 0 1.78472 0 0
  DIAM 10
SURF 2
  TYPE STANDARD
  COAT {back}
  CURV -1e-9 0 0 0 0
  DISZ 60
  DIAM 10
SURF 3
  TYPE STANDARD
  CURV 0.0
  DISZ 0
"""

FILE = """\
! A comment
MATE MGF2
0.4 1.384 0
0.7 1.376 0
MATE DARK ! absorbs
0.55 2.1 -0.3
MATE TIO2
0.5 2.4 0.0
TAPR EDGE
COAT PLAIN
MGF2 0.25
COAT STACK
TIO2 0.05 1
MGF2 0.1 1 0
DARK .02 1
COAT GROUPS
TIO2 0.25 0 2
MGF2 0.25 0 2
TIO2 0.125 0 0
COAT OPEN
TIO2 0.25 0 3
COAT TAPERED
MGF2 0.25 0 0 EDGE
COAT UNKNOWN
GOLD 0.25
IDEAL HALF 0.5 0.5
IDEAL GREY 0.5 0.1
IDEAL MUCH 0.9 0.5
COAT I.75 ! the name is all there is
TABLE MEASURED
ANGL 0
WAVE 0.5 0.02 0.02 0.98 0.98 0 0 0 0
WAVE 0.7 0.04 0.04 0.96 0.96 0 0 0 0
ANGL 60
WAVE 0.5 0.2 0.1 0.8 0.9
WAVE 0.7 0.3 0.1 0.7 0.9
ENCRYPTED SECRET
"""


def read(folder, front, back="NONE", file=FILE):
    if file is not None:
        (folder / "Coating.dat").write_text(file)
    (folder / "plate.zmx").write_text(PLATE.format(front=front, back=back))
    return read_lens_file(folder / "plate.zmx")


def arriving(lens, degrees, wavelength_nm, split):
    """Return the packets in which a ray ends at the sensor."""
    scene = lf.Scene(
        camera={
            "lens": lens,
            "focus_mm": 500.0,
            "sensor": {"pixels": [400, 400], "pixel_mm": 0.5, "distance_mm": 20.0},
        },
        transport={"wavelengths_nm": [wavelength_nm]},
    )
    angle = np.radians(degrees)
    direction = np.array([0.0, np.sin(angle), np.cos(angle)])
    settings = {"split": split, "weight_cutoff": 1e-12, "threads": 1}
    paths = lf.trace(lf.build(scene), [-5.0 * direction], [direction], wavelength_nm, **settings)
    return paths.weight[paths.status == lf.Status.SENSOR]


def kept(lens, degrees, wavelength_nm=PRIMARY_NM):
    """Return the share of a ray's light that reaches the sensor, without reflections."""
    (weight,) = arriving(lens, degrees, wavelength_nm, "transmit")
    return float(weight)


def by_tmm(front, back, degrees, wavelength_nm=PRIMARY_NM, index=1.78472):
    """Return the same by tmm, each face a stack of (index, nm) from the air side."""
    tmm = pytest.importorskip("tmm")
    share = 1.0
    inside = np.arcsin(np.sin(np.radians(degrees)) / index)
    for stack, angle, ends in ((front, np.radians(degrees), (1.0, index)), (back[::-1], inside, (index, 1.0))):
        indices = [ends[0], *(layer[0] for layer in stack), ends[1]]
        nm = [np.inf, *(layer[1] for layer in stack), np.inf]
        share *= tmm.unpolarized_RT(indices, nm, angle, wavelength_nm)["T"]
    return share


QUARTER = (1.38, PRIMARY_NM / 1.38 / 4)
MGF2 = float(np.interp(PRIMARY_NM, [400.0, 700.0], [1.384, 1.376]))
PLAIN = [(MGF2, PRIMARY_NM / MGF2 / 4)]
TIO2 = (2.4, PRIMARY_NM / 2.4 / 4)
STACKS = {
    "AR": [QUARTER],
    "PLAIN": PLAIN,
    "STACK": [(2.4, 50.0), (MGF2, 100.0), (2.1 + 0.3j, 20.0)],
    "GROUPS": [TIO2, PLAIN[0], TIO2, PLAIN[0], (2.4, TIO2[1] / 2)],
    "NULL": [],
}


@pytest.mark.parametrize("name", STACKS)
@pytest.mark.parametrize("degrees", [0.0, 35.0])
def test_light_through_coated_faces_is_that_of_tmm(tmp_path: Path, name: str, degrees: float) -> None:
    lens, report = read(tmp_path, name, name, None if name == "AR" else FILE)
    assert not report.of(Verdict.APPROXIMATED)
    stack = STACKS[name]
    assert kept(lens, degrees) == pytest.approx(by_tmm(stack, stack, degrees), abs=1e-6)


GHOSTS = [("AR", "STACK"), ("STACK", "GROUPS"), ("NULL", "PLAIN")]


@pytest.mark.parametrize(("front", "back"), GHOSTS)
@pytest.mark.parametrize("degrees", [0.0, 20.0])
def test_ghosts_between_coated_faces_are_those_of_tmm(tmp_path: Path, front: str, back: str, degrees: float) -> None:
    tmm = pytest.importorskip("tmm")
    lens, _ = read(tmp_path, front, back)
    index = 1.78472
    inside = np.arcsin(np.sin(np.radians(degrees)) / index)
    pair = 1.0
    for stack in (STACKS[front], STACKS[back]):
        indices = [index, *(layer[0] for layer in stack[::-1]), 1.0]
        nm = [np.inf, *(layer[1] for layer in stack[::-1]), np.inf]
        pair *= tmm.unpolarized_RT(indices, nm, inside, PRIMARY_NM)["R"]
    direct = by_tmm(STACKS[front], STACKS[back], degrees)
    found = np.sort(arriving(lens, degrees, PRIMARY_NM, "both"))[::-1]
    # Without a reflection, after two, and after four.
    np.testing.assert_allclose(found[:3], direct * pair ** np.arange(3), rtol=1e-6)


def test_layers_of_a_file_disperse(tmp_path: Path) -> None:
    lens, _ = read(tmp_path, "PLAIN")
    index = float(np.interp(450.0, [400.0, 700.0], [1.384, 1.376]))
    truth = by_tmm([(index, PLAIN[0][1])], [], 20.0, 450.0)
    assert kept(lens, 20.0, 450.0) == pytest.approx(truth, abs=1e-6)


@pytest.mark.parametrize(
    ("name", "passes"),
    [("I.95", 0.95), ("I.75", 0.75), ("I0.5", 0.5), ("I.0.5", 0.5), ("HALF", 0.5), ("I1", 1.0)],
)
def test_ideal_coatings_pass_their_share(tmp_path: Path, name: str, passes: float) -> None:
    lens, report = read(tmp_path, name, name)
    assert not report.of(Verdict.APPROXIMATED)
    assert kept(lens, 30.0) == pytest.approx(passes**2, abs=1e-12)


def test_a_table_of_reflectance_counts_by_its_mean_over_polarisations(tmp_path: Path) -> None:
    lens, report = read(tmp_path, "MEASURED", "I1")
    assert kept(lens, 0.0, 600.0) == pytest.approx(0.97, abs=1e-6)
    assert kept(lens, 60.0, 600.0) == pytest.approx(1 - 0.175, abs=1e-6)
    (said,) = report.of(Verdict.APPROXIMATED)
    assert said.how == "at 90 degrees it reflects everything, as every surface does"


BARE = {
    "HEAR1": "Coating.dat has no such coating; the surface is traced bare",
    "UNKNOWN": "Coating.dat: material GOLD is not in the file; the surface is traced bare",
    "OPEN": "Coating.dat: a group of layers with number 3 has no end; the surface is traced bare",
    "MUCH": "Coating.dat: it reflects 0.5 and transmits 0.9, together more than 1; the surface is traced bare",
    "SECRET": "Coating.dat has it as ENCRYPTED, which is not read; the surface is traced bare",
}
APPROXIMATED = {
    "AR": "Coating.dat has no such coating; replaced by a quarter wave of MgF2",
    "GREY": "it absorbs 0.4 of the light, which is transmitted here",
    "TAPERED": "layers of taper EDGE get the thickness at the middle everywhere",
    "MIRROR": "a metal coating; taken as a perfect reflector",
}


@pytest.mark.parametrize("name", BARE | APPROXIMATED)
def test_loading_warns_of_coatings_that_are_not_the_files(tmp_path: Path, name: str) -> None:
    lens, report = read(tmp_path, name)
    assert [line.how for line in report.of(Verdict.APPROXIMATED)] == [(BARE | APPROXIMATED)[name]]
    assert (lens.surfaces[0].coating == "none") == (name in BARE)
    with pytest.warns(LensFileWarning, match=f"line 15: COAT {name}: approximated: "):
        load_lens(tmp_path / "plate.zmx")


def test_a_coating_without_a_file_is_bare_and_said(tmp_path: Path) -> None:
    _, report = read(tmp_path, "WAR2", file=None)
    (said,) = report.of(Verdict.APPROXIMATED)
    assert said.how == "no COATING.DAT beside the file; the surface is traced bare"


def test_the_file_that_the_lens_names_counts(tmp_path: Path) -> None:
    (tmp_path / "own.dat").write_text("MATE X\n0.5 1.3 0\nCOAT AR\nX 0.25\n")
    (tmp_path / "plate.zmx").write_text(
        PLATE.format(front="AR", back="NONE").replace("UNIT MM", 'COFN QF "OWN.DAT" "S.DAT"\nUNIT MM')
    )
    lens, _ = read_lens_file(tmp_path / "plate.zmx")
    # A definition of the file's own comes before the built-in one.
    assert lens.coatings["AR"].layers[0].index_at(500.0) == 1.3


def test_a_surface_without_an_interface_has_no_coating(tmp_path: Path) -> None:
    text = PLATE.format(front="NONE", back="NONE").replace(
        "SURF 1\n  STOP\n", "SURF 1\n  STOP\n  COAT AR\n  CURV 0\n  DISZ 3\n  DIAM 4\nSURF 2\n"
    )
    (tmp_path / "plate.zmx").write_text(text)
    lens, report = read_lens_file(tmp_path / "plate.zmx")
    assert [surface.coating for surface in lens.surfaces] == ["none", "none", "none"]
    (said,) = report.of(Verdict.APPROXIMATED)
    assert said.how == "no coating, since it has the same medium on both sides"


def test_an_uncoated_file_is_taken_without_a_word(tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read(tmp_path, "NONE")
        load_lens(tmp_path / "plate.zmx")


def test_coatings_survive_conversion_and_come_with_the_lens_of_a_scene(tmp_path: Path) -> None:
    lens, _ = read(tmp_path, "STACK", "I.95")
    write_lens_file(lens, tmp_path / "plate.toml")
    again = load_lens(tmp_path / "plate.toml")
    assert again.coatings == lens.coatings
    assert set(lens.coatings) == {"STACK", "I_95"}
    camera = (
        'camera = { focus_mm = 500.0, lens = { file = "plate.toml" }, sensor = { pixels = [4, 4], pixel_mm = 1.0 } }'
    )
    (tmp_path / "scene.toml").write_text(camera + "\n[coatings.I_95]\nreflectance = 0.5\n")
    with pytest.raises(SceneError, match=r"coatings\.I_95: the lens has another coating of this name"):
        lf.load(tmp_path / "scene.toml")
    (tmp_path / "scene.toml").write_text(camera)
    assert lf.load(tmp_path / "scene.toml").camera.lens.coatings == lens.coatings


@pytest.mark.parametrize("rows", ["", "0.5 1.5 0.1\n", "0.5 a 0\n", "0.5 1.5\n0.5 1.6\n", "-1 1.5\n", "0.5\n"])
def test_an_impossible_material_matters_only_to_coatings_that_have_it(tmp_path: Path, rows: str) -> None:
    file = f"MATE X\n{rows}MATE Y\n0.5 1.4 0\nCOAT BAD\nX 0.25\nCOAT GOOD\nY 0.25\n"
    lens, report = read(tmp_path, "GOOD", "BAD", file)
    assert [surface.coating for surface in lens.surfaces] == ["GOOD", "none"]
    (said,) = report.of(Verdict.APPROXIMATED)
    assert said.how.startswith("Coating.dat: MATE X: ")
    assert said.how.endswith("; the surface is traced bare")


def test_coatings_whose_names_become_one_stay_apart(tmp_path: Path) -> None:
    file = "MATE A\n0.5 2.0 0\nMATE B\n0.5 1.5 0\nCOAT Q.1\nA 0.25\nCOAT Q_1\nB 0.25\n"
    lens, _ = read(tmp_path, "Q.1", "Q_1", file)
    indices = [lens.coatings[surface.coating].layers[0].index_at(500.0).real for surface in lens.surfaces]
    assert indices == [2.0, 1.5]


def test_a_named_coating_file_that_is_missing_is_named(tmp_path: Path) -> None:
    (tmp_path / "COATING.DAT").write_text(FILE)
    text = PLATE.format(front="STACK", back="AR").replace("UNIT MM", "COFN QF OTHER.DAT\nUNIT MM")
    (tmp_path / "plate.zmx").write_text(text)
    assert [line.how for line in read_lens_file(tmp_path / "plate.zmx")[1].of(Verdict.APPROXIMATED)] == [
        "no OTHER.DAT beside the file; the surface is traced bare",
        "no OTHER.DAT beside the file; replaced by a quarter wave of MgF2",
    ]


def test_a_scene_may_give_a_lens_of_a_file_coatings_beside_its_own(tmp_path: Path) -> None:
    read(tmp_path, "STACK")
    own = "coatings = { extra = { reflectance = 0.5 } }"
    text = f'camera = {{ focus_mm = 500.0, lens = {{ file = "plate.zmx", {own} }}, '
    (tmp_path / "scene.toml").write_text(text + "sensor = { pixels = [4, 4], pixel_mm = 1.0 } }")
    assert set(lf.load(tmp_path / "scene.toml").camera.lens.coatings) == {"STACK", "extra"}


def test_wavelengths_beyond_a_materials_table_are_said(tmp_path):
    (tmp_path / "COATING.DAT").write_text(FILE)
    text = PLATE.format(front="PLAIN", back="NONE").replace("FTYP 0 0 1 1", "FTYP 0 0 1 2")
    (tmp_path / "plate.zmx").write_text(text.replace("WAVM 1 0.5875618 1\n", "WAVM 1 0.5875618 1\nWAVM 2 0.85 1\n"))
    (line,) = [line for line in read_lens_file(tmp_path / "plate.zmx")[1].lines if line.text == "COAT PLAIN"]
    assert line.verdict is Verdict.APPROXIMATED
    assert line.how == "at 850 nm, outside its table from 400 to 700 nm, the nearest index or shares are taken"
    assert not [line for line in read(tmp_path, "PLAIN")[1].lines if "outside its table" in line.how]


def test_a_coating_file_that_is_given_comes_before_the_one_beside_the_lens_file(tmp_path):
    given = tmp_path / "elsewhere" / "mine.dat"
    given.parent.mkdir()
    given.write_text(FILE)
    (tmp_path / "plate.zmx").write_text(PLATE.format(front="STACK", back="NONE"))
    lens, report = read_lens_file(tmp_path / "plate.zmx", FileChoices(coating_file=str(given)))
    assert not [line for line in report.of(Verdict.APPROXIMATED) if "bare" in line.how]
    beside, _ = read(tmp_path, "STACK")
    assert lens.coatings == beside.coatings
    (tmp_path / "Coating.dat").write_text(FILE.replace("MGF2 0.1 1 0", "MGF2 0.2 1 0"))
    assert read_lens_file(tmp_path / "plate.zmx", FileChoices(coating_file=str(given)))[0] == lens
    scene = loads(
        """schema_version = 1
camera = { focus_mm = 500.0, lens = { file = "plate.zmx", coating_file = "elsewhere/mine.dat" }, \
sensor = { pixels = [2, 2], pixel_mm = 0.1 } }
targets = [{ shape = { kind = "plane", width_mm = 1.0, height_mm = 1.0 }, position_mm = [0.0, 0.0, -500.0] }]
""".replace("\\\n", ""),
        tmp_path,
    )
    assert scene.camera.lens.coatings == lens.coatings
    with pytest.raises(SceneError, match=r"none\.dat: cannot be read"):
        read_lens_file(tmp_path / "plate.zmx", FileChoices(coating_file=str(tmp_path / "none.dat")))
