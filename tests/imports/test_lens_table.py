"""Prescriptions as tables: any separator, common names of columns, and words for what is not read."""

import math
from pathlib import Path

import pytest

from lfmesh.errors import SceneError
from lfmesh.imports import read_lens_file
from lfmesh.imports.lens_table import read
from lfmesh.imports.report import Verdict
from lfmesh.scene import Paraxial, load, load_lens

ROWS = [
    ("surface", "radius", "thickness", "material", "index", "v-no", "sa", "stop", "conic", "A4", "A6"),
    ("1", "50.0", "4.0", "GLASS", "1.5168", "64.2", "8.0", "", "-0.5", "1e-6", "-2e-9"),
    ("2", "-80.0", "3.0", "air", "", "", "8.0", "", "", "", ""),
    ("3", "inf", "2.0", "", "", "", "5.0", "x", "", "", ""),
    ("4", "60.0", "3.0", "SCHOTT/N-SF11", "", "", "7.0", "", "", "", ""),
    ("5", "", "45.0", "air", "1.0", "", "7.0", "", "", "", ""),
]
FILE = Path("lens.csv")


def text(delimiter: str, decimal: str = ".") -> list[str]:
    return [delimiter.join(cell.replace(".", decimal) if row != ROWS[0] else cell for cell in row) for row in ROWS]


@pytest.mark.parametrize(("delimiter", "decimal"), [(";", "."), (",", "."), ("\t", "."), (";", ","), ("\t", ",")])
def test_a_table_is_a_lens_however_it_is_parted(delimiter: str, decimal: str) -> None:
    lens, report = read(FILE, text(delimiter, decimal))
    first, second, stop, third, last = lens.surfaces
    assert (first.radius_mm, first.thickness_mm, first.semi_diameter_mm) == (50.0, 4.0, 8.0)
    assert (first.conic, first.asphere_mm) == (-0.5, (1e-6, -2e-9))
    assert first.glass is not None
    assert not isinstance(first.glass, str)
    assert (first.glass.nd, first.glass.vd) == (1.5168, 64.2)
    assert (second.medium, stop.stop, stop.semi_diameter_mm, stop.radius_mm) == (None, True, 5.0, math.inf)
    assert (third.glass, last.radius_mm, last.medium) == ("SCHOTT/N-SF11", math.inf, None)
    assert not report.of(Verdict.UNKNOWN)
    assert any("image: 45 mm" in note for note in report.notes)


def test_signs_of_printed_tables_are_understood() -> None:
    printed = [line.replace("-80.0", "\N{MINUS SIGN}80.0").replace("inf", "\N{INFINITY}") for line in text(";")]
    assert read(FILE, printed)[0] == read(FILE, text(";"))[0]


def test_curvatures_diameters_and_an_object_row_are_understood() -> None:
    lines = ["Curvature, Thickness (mm), n, Diameter, Colour", ",1e10,,,", "0.02,4.0,1.5,16,red", "-0.0125,45.0,,16,"]
    lens, report = read(FILE, lines)
    assert [surface.radius_mm for surface in lens.surfaces] == [50.0, -80.0]
    assert [surface.semi_diameter_mm for surface in lens.surfaces] == [8.0, 8.0]
    assert Paraxial.of(lens, 587.6).efl_mm == pytest.approx(1 / (0.5 * (0.02 + 0.0125 - 0.5 * 4 * 0.02 * 0.0125 / 1.5)))
    assert [line.text for line in report.of(Verdict.UNKNOWN)] == ["column Colour"]
    assert "no row is marked as the stop: the first surface is taken" in report.notes


def test_the_columns_of_opticstudio_are_understood() -> None:
    header = "Surf,Type,Radius,Thickness,Material,Clear Semi-Dia,Conic"
    rows = [
        "OBJECT,STANDARD,Infinity,Infinity,,0,0", "1,STANDARD,50,4,N-BK7,8,0", "2,STANDARD,-80,3,,8,0",
        "STO,STANDARD,Infinity,40,,3,0", "IMAGE,STANDARD,Infinity,-,,3,0",
    ]  # fmt: skip
    lens, report = read(FILE, [header, *rows])
    assert [surface.stop for surface in lens.surfaces] == [False, False, True]
    assert [surface.semi_diameter_mm for surface in lens.surfaces] == [8.0, 8.0, 3.0]
    assert any("image: 40 mm" in note for note in report.notes)
    rows[1] = "1,TOROIDAL,50,4,N-BK7,8,0"
    with pytest.raises(SceneError, match="surfaces of type TOROIDAL are not read from tables"):
        read(FILE, [header, *rows])


REFUSED = {
    "radius;thickness;index\n50;2;1.5\n-50;;\n60;2;1.5\n-60;40;": "line 3: -50;;: it has no thickness",
    "radius;thickness;index;A2\n50;2;1.5;1e-4\n-50;40;;": "A2 is not read: even aspheres have A4 to A30",
    "radius;thickness;index;A800\n50;2;1.5;1e-4\n-50;40;;": "A800 is not read: even aspheres have A4 to A30",
    "radius;thickness;index;sa\n50;2;1.5;-5\n-50;40;;5": "a semi-diameter or diameter below 0",
    "radius;thickness;index;stop\n50;2;1.5;x\n-50;40;;x": "line 3: -50;40;;x: line 2 is already the stop",
    "radius;thickness;index\n50;2;1.5;9\n-50;40;;": "line 2: 50;2;1.5;9: more cells than the 3 columns",
    "": "no prescription: it is empty",
    "a;b\n1;2": "line 1: no prescription: its first line must name columns",
    "radius;thickness;radius\n1;2;3": "line 1: two columns give the radius",
    "radius;thickness\nx;2": "line 2: x;2: 'x' is not a number",
    "radius;thickness;glass\n50;2;NO-SUCH\n;40;": "NO-SUCH",
    "radius;thickness\n": "holds no lens",
    "radius;thickness;ne;sa\n50;2;1.5;5\n-50;40;;5": "all of its surfaces have the same medium on both sides",
    "Radius [in];thickness;n\n50;2;1.5\n-50;40;": "column Radius [in]: lengths must be in mm",
    "Radius;Dicke;n\n50;2;1.5\n-50;40;": "it is 'Radius;Dicke;n'",
}


@pytest.mark.parametrize("name", ["A²", "a" + "9" * 5000])
def test_a_column_that_is_no_term_is_left_out_and_said(name: str) -> None:
    _, report = read(FILE, [f"radius;thickness;index;sa;{name}", "50;2;1.5;5;1", "-50;40;;5;"])
    assert len(report.of(Verdict.UNKNOWN)) == 1


@pytest.mark.parametrize("lines", REFUSED)
def test_what_is_no_prescription_is_refused_in_one_line(lines: str) -> None:
    with pytest.raises(SceneError) as refusal:
        read(FILE, lines.splitlines())
    assert REFUSED[lines] in str(refusal.value)
    assert len(str(refusal.value).splitlines()) == 1


def test_ends_may_be_named_by_their_type_and_columns_have_units() -> None:
    plain = ["radius;thickness;n;diameter;A4", "50;4;1.5;16;1e-6", "-50;45;;14;"]
    named = [
        "#,Type,Radius [mm],Thickness (mm),Index,Diameter [mm],A4 (mm^-3)",
        "0,OBJ,Infinity,Infinity,,0,",
        "1,Standard,50,4,1.5,16,1e-6",
        "2,STO,-50,45,,14,",
        "3,IMA,Infinity,0,,5,",
    ]
    lens, report = read(FILE, named)
    assert [surface.stop for surface in lens.surfaces] == [False, True]
    first, second = read(FILE, plain)[0].surfaces
    assert lens.surfaces == (first.model_copy(update={"stop": False}), second.model_copy(update={"stop": True}))
    assert not report.of(Verdict.UNKNOWN)


def test_a_scene_takes_a_table_and_unknown_endings_are_named(tmp_path: Path) -> None:
    (tmp_path / "lens.csv").write_text("\n".join(text(";")))
    sensor = "sensor = { pixels = [4, 4], pixel_mm = 1.0 }"
    (tmp_path / "scene.toml").write_text(f'camera = {{ focus_mm = 500.0, lens = {{ file = "lens.csv" }}, {sensor} }}')
    assert len(load(tmp_path / "scene.toml").camera.lens.surfaces) == 5
    assert load_lens(tmp_path / "lens.csv") == read_lens_file(tmp_path / "lens.csv")[0]
    (tmp_path / "lens.oth").write_text("radius")
    with pytest.raises(
        SceneError, match=r"unknown ending; a lens is read from \.toml, \.zmx, \.seq, \.len, \.json, \.csv or lib:NAME"
    ):
        read_lens_file(tmp_path / "lens.oth")
