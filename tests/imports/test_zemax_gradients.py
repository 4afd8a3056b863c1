"""Gradient-index glass of Zemax files against the formulas of OpticStudio's help; tests/validation has stored rays."""

import math

import numpy as np
import pytest

from lfmesh.errors import SceneError
from lfmesh.imports import read_lens_file
from lfmesh.imports.report import Verdict
from lfmesh.optics.gradients import fields_at, gradient_table
from lfmesh.scene import Paraxial, load_lens, loads
from lfmesh.scene.camera.lens import FileChoices
from tests.imports.files import GRADIENT_FILES, GRADIENTS_ZMX
from tests.imports.test_zemax import lens_of, refusal_of, report_of

SURFACE = """\
MODE SEQ
UNIT {unit}
ENPD 1
COFN COATING.DAT SCATTER_PROFILE.DAT ABG_DATA.DAT PROFILE.GRD
FTYP 0 0 1 2 0 0 0
YFLN 0
WAVM 1 0.55 1
WAVM 2 0.65 1
PWAV 1
SURF 0
  TYPE STANDARD
  DISZ INFINITY
SURF 1
  STOP
  TYPE {kind}
  CURV {curvature}
{lines}  DISZ 3
  DIAM 2
SURF 2
  TYPE STANDARD
  CURV -0.01
  DISZ 20
  DIAM 2
SURF 3
  TYPE STANDARD
  DISZ 0
"""
POINTS = np.random.default_rng(0).uniform([-1.0, -1.0, 0.0], [1.0, 1.0, 3.0], (30, 3))
X, Y, Z = POINTS.T
R2 = X * X + Y * Y
SPHERE = -math.copysign(1.0, -20.0) * np.hypot(np.sqrt(R2), -20.0 - Z) - 20.0
"""R − ρ of spheres about (0, 0, −20)."""


def text_of(kind, *lines, unit="MM", curvature="0.02"):
    return SURFACE.format(kind=kind, lines="".join(f"  {line}\n" for line in lines), unit=unit, curvature=curvature)


def gradient_of(kind, *lines, **options):
    return lens_of(text_of(kind, *lines, **options)).surfaces[0].gradient


def index_of(gradient, points=POINTS, wavelength_nm=550.0):
    return np.sqrt(fields_at(gradient_table([gradient.profile(wavelength_nm)]), 0, points)[:, 0])


def parameters(first, *values):
    return [f"PARM {place} {value!r}" for place, value in enumerate(values, first)]


CASES = {
    "GRINSUR1": ((0.1, 1.5, -0.083, 0.0), 1.5 - 0.083 * R2),
    "GRINSUR2": (
        (0.1, 2.25, -0.05, 3e-3, -1e-4, 2e-5, 0.0, 1e-6),
        np.sqrt(2.25 - 0.05 * R2 + 3e-3 * R2**2 - 1e-4 * R2**3 + 2e-5 * R2**4 + 1e-6 * R2**6),
    ),
    "GRINSUR3": (
        (0.1, 1.6, -0.01, 2e-3, -1e-4, 0.02, -3e-3, 1e-3),
        1.6 - 0.01 * R2 + 2e-3 * R2**2 - 1e-4 * R2**3 + 0.02 * Z - 3e-3 * Z**2 + 1e-3 * Z**3,
    ),
    "GRINSUR4": (
        (0.1, 1.6, 0.01, -0.02, 0.03, -0.04, 0.02, -3e-3),
        1.6 + 0.01 * X - 0.02 * X**2 + 0.03 * Y - 0.04 * Y**2 + 0.02 * Z - 3e-3 * Z**2,
    ),
    "GRINSUR5": (
        (0.1, 1.6, -0.01, 2e-3, 0.02, -3e-3, 1e-3, -1e-4),
        1.6 - 0.01 * R2 + 2e-3 * R2**2 + 0.02 * Z - 3e-3 * Z**2 + 1e-3 * Z**3 - 1e-4 * Z**4,
    ),
    "GRINSUR7": ((0.1, 1.6, -20.0, 0.02, -1e-3), 1.6 + 0.02 * SPHERE - 1e-3 * SPHERE**2),
    "GRINSU10": (
        (0.1, 1.6, 0.0, -0.02, 0.0, 3e-3, 0.0, -1e-4), 1.6 - 0.02 * Y**2 + 3e-3 * Y**4 - 1e-4 * Y**6,
    ),
    "GRINSU12": (
        (0.1, 4, 1.6, 0.01, 0.02, 0.03, -0.02, -0.03, 1e-3, 1e-3, 2e-3, 3e-3, 1e-4, -2e-4, 3e-4, 9.0),
        1.6 + 0.01 * X + 0.02 * Y + 0.03 * Z - 0.02 * X**2 - 0.03 * Y**2 + 1e-3 * Z**2
        + 1e-3 * X**3 + 2e-3 * Y**3 + 3e-3 * Z**3 + 1e-4 * X**4 - 2e-4 * Y**4 + 3e-4 * Z**4,
    ),
}  # fmt: skip
"""Parameters from 1, and the index at the points. Beyond the order of GRINSU12, its numbers do not count."""


@pytest.mark.parametrize("kind", CASES)
def test_the_index_is_that_of_the_formula(kind):
    values, index = CASES[kind]
    np.testing.assert_allclose(index_of(gradient_of(kind, *parameters(1, *values))), index, rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("kind", CASES)
def test_coefficients_are_in_the_units_of_the_file(kind):
    """A lens in inches is 25.4 times as large, its index the same at points 25.4 times as far."""
    values, index = CASES[kind]
    gradient = gradient_of(kind, *parameters(1, *values), unit="IN")
    np.testing.assert_allclose(index_of(gradient, 25.4 * POINTS), index, rtol=0.0, atol=1e-13)


def test_spheres_without_a_radius_follow_the_surface():
    own = gradient_of("GRINSUR7", *parameters(1, 0.1, 1.6, 0.0, 0.02, -1e-3), curvature="-0.05")
    given = gradient_of("GRINSUR7", *parameters(1, 0.1, 1.6, -20.0, 0.02, -1e-3))
    assert own == given
    flat = gradient_of("GRINSUR7", *parameters(1, 0.1, 1.6, 0.0, 0.02, -1e-3), curvature="0")
    np.testing.assert_allclose(index_of(flat), 1.6 + 0.02 * Z - 1e-3 * Z**2, rtol=0.0, atol=1e-14)


def test_extra_data_among_the_parameters_are_the_same_gradient():
    """Earlier versions store parameters from 13 on as extra data."""
    values, index = CASES["GRINSU12"]
    lines = [line.replace("PARM 13", "XDAT 1").replace("PARM 14", "XDAT 2") for line in parameters(1, *values)]
    gradient = gradient_of(
        "GRINSU12", *(line.replace("PARM 15", "XDAT 3").replace("PARM 16", "XDAT 4") for line in lines)
    )
    np.testing.assert_allclose(index_of(gradient), index, rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("kind", [kind for kind in CASES if kind != "GRINSUR2"])
def test_a_gradient_without_terms_is_an_index(kind):
    base = parameters(2, 0, 1.6) if kind == "GRINSU12" else parameters(2, 1.6)
    surface = lens_of(text_of(kind, *base)).surfaces[0]
    assert (surface.index, surface.gradient) == (1.6, None)


def test_the_power_is_that_of_a_rod():
    """A flat rod n² = n₀² (1 − g² r²) of length L has the power n₀ g sin(g L)."""
    g = 0.2
    lens = lens_of(
        text_of("GRINSUR2", *parameters(2, 2.25, -2.25 * g * g), curvature="0").replace("CURV -0.01", "CURV 0")
    )
    power = 1.5 * g * math.sin(3.0 * g)
    assert Paraxial.of(lens, 550.0).efl_mm == pytest.approx(1.0 / power, rel=1e-12)
    report = report_of(text_of("GRINSUR2", *parameters(2, 2.25, -2.25 * g * g), curvature="0").replace("-0.01", "0"))
    assert report.focal_length_mm == pytest.approx(1.0 / power, rel=1e-12)
    assert "gradients: 1, of surface 0 (radial_n2)" in report.notes


def test_the_base_of_a_square_is_told():
    """No public file shows whether it is n or n²."""
    report = report_of(text_of("GRINSUR2", *parameters(2, 2.25, -0.01)))
    told = {line.text: line.how for line in report.of(Verdict.APPROXIMATED)}
    assert told == {"TYPE GRINSUR2": "parameter 2 is taken as n² on the axis, so that n = 1.5"}


def test_the_step_has_no_effect_and_the_rest_is_taken():
    report = report_of(text_of("GRINSUR1", *parameters(1, 0.1, 1.5, -0.083, 0.0)))
    verdicts = {line.text: line.verdict for line in report.lines}
    assert verdicts["PARM 1 0.1"] is Verdict.WITHOUT_EFFECT
    assert {verdicts[f"PARM {rest}"] for rest in ("2 1.5", "3 -0.083", "4 0.0")} == {Verdict.TAKEN}
    assert verdicts["TYPE GRINSUR1"] is Verdict.TAKEN


def test_every_surface_of_a_gradient_stays():
    """Equal gradients differ behind each other, since each counts from its own vertex."""
    lens = lens_of(GRADIENTS_ZMX)
    assert [surface.gradient and surface.gradient.kind for surface in lens.surfaces] == [
        "radial_n", "spherical", "radial_n2", "xyz", None, "xyz", "xyz", "radial_n", "radial_n", None,
    ]  # fmt: skip
    twice = text_of("GRINSUR3", *parameters(2, 1.6, -0.01, 0.0, 0.0, 0.02)).replace(
        "SURF 2\n", "SURF 2\n  TYPE GRINSUR3\n  PARM 2 1.6\n  PARM 3 -0.01\n  PARM 6 0.02\n  DISZ 2\nSURF 3\n"
    )
    assert len(lens_of(twice).surfaces) == 3


@pytest.mark.parametrize(
    ("kind", "lines", "where", "reason"),
    [
        ("GRINSUR1", parameters(2, 1.5, -0.08, 0.01), "PARM 4 0.01", "a term in r makes a cone of the index"),
        ("GRINSUR1", parameters(3, -0.08), "TYPE GRINSUR1", "parameter 2, the index n₀, is missing"),
        ("GRINSUR1", parameters(2, 1.5, -0.08, 0.0, 0.1), "PARM 5 0.1", "parameter 5 of GRINSUR1 is unknown"),
        ("GRINSUR1", ["PARM 0 1", *parameters(2, 1.5, -0.08)], "PARM 0 1", "parameter 0 of GRINSUR1 is unknown"),
        ("GRINSUR1", [*parameters(2, 1.5, -0.08), "XDAT 1 2"], "XDAT 1 2", "GRINSUR1 has no extra data"),
        ("GRINSUR1", [*parameters(2, 1.5, -0.08), "GLAS N-BK7"], "GLAS N-BK7", "has its index in its parameters"),
        ("GRINSUR1", [*parameters(2, 1.5), "GLAS ___BLANK 1 0 1.5 40"], "GLAS ___BLANK", "index in its parameters"),
        ("GRINSUR1", [*parameters(2, 1.5), "GLAS MIRROR"], "GLAS MIRROR", "mirrors are not supported"),
        ("GRINSUR1", parameters(2, 1.5, 1e300), "PARM 3 1e+300", "must be 1e+15 or less in magnitude"),
        ("GRINSUR1", ["PARM 2 1.5", "PARM 3 nan"], "PARM 3 nan", "'nan' is not finite"),
        ("GRINSUR1", parameters(2, 0.5, -0.08), "SURF 1", "between 1 and 10"),
        ("GRINSUR3", parameters(2, 1.6, 0.0, 0.0, 0.0, -9.0), "SURF 1", "between 1 and 10"),
        ("GRINSUR2", parameters(2, -2.0, 0.1), "PARM 2 -2.0", "n² on the axis must be above 0"),
        ("GRINSUR5", ["PARM 2 1.5", "PARM 9 0.1"], "PARM 9 0.1", "a surface with a tilt term is not supported"),
        ("GRINSU10", parameters(2, 1.5, 0.1), "PARM 3 0.1", "an odd power of |y| makes a kink"),
        ("GRINSU12", parameters(2, 21, 1.5, 0.1), "PARM 2 21", "the order must be a whole number up to 20"),
        ("GRINSU12", parameters(2, 0.5, 1.5, 0.1), "PARM 2 0.5", "the order must be a whole number up to 20"),
        ("GRINSU12", parameters(2, 2), "TYPE GRINSU12", "parameter 3, the index n₀, is missing"),
        ("GRINSU12", [*parameters(2, 2, 1.5), "PARM 64 1"], "PARM 64 1", "GRINSU12 has no such number"),
        ("GRINSUR6", ["GLAS ARS10"], "TYPE GRINSUR6", "gradient-index glass of GLC.DAT is not supported"),
        ("GRINSU11 Sample.GGD", ["PARM 1 1"], "TYPE GRINSU11", "gradient-index glass on a grid is not supported"),
        ("GRINSUR9", ["PARM 1 0.1"], "TYPE GRINSUR9", "needs the name of a material, GLAS"),
        ("GRINSUR9", ["PARM 2 0.1", "GLAS SLS-1.0"], "PARM 2 0.1", "a surface with a tilt term is not supported"),
        ("GRINSUR8", ["PARM 4 1", "GLAS G41SFN"], "PARM 4 1", "capped, decentred or tilted is not supported"),
    ],
)  # fmt: skip
def test_glass_that_cannot_be_read_is_one_line(kind, lines, where, reason):
    message = refusal_of(text_of(kind, *lines))
    assert message.startswith("lens.zmx: ")
    assert where in message or "SURF 1" in message
    assert reason in message
    assert "\n" not in message


def test_an_object_in_gradient_glass_is_refused():
    text = GRADIENTS_ZMX.replace("SURF 0\n  TYPE STANDARD", "SURF 0\n  TYPE GRINSUR1\n  PARM 2 1.5\n  PARM 3 0.1")
    assert "an object in gradient-index glass is not supported" in refusal_of(text)


def test_glass_that_changes_with_the_configuration_is_refused():
    text = GRADIENTS_ZMX + "MNUM 2 1\nGLSS 1 1 A 0 0 0 1 1 1 0 0\nGLSS 1 2 B 0 0 0 1 1 1 0 0\n"
    with pytest.raises(SceneError, match="gradient-index glass that differs between configurations"):
        lens_of(text, choices=FileChoices(configuration=2))


SELFOC = text_of("GRINSUR9", *parameters(1, 0.1, 0, 0), "GLAS SLS-1.0 0 0 1.5 40")
GRADIUM = text_of("GRINSUR8", *parameters(0, 12.1, 0.25, 5.0, 1.710571457024, 0), "GLAS G41SFN 0 0 1.5 40")
WITH_MATERIAL = text_of("GRINSUR5", *parameters(1, 0.1, 1.6, -0.01, 0.0, 0.02), "GLAS GSF 0 0 1.5 40")
NAMED = {"selfoc": (SELFOC, ["GRADIENT_9.DAT"]), "gradium": (GRADIUM, ["PROFILE.GRD", "SGRIN.DAT"]),
         "radial_n": (WITH_MATERIAL, ["SGRIN.DAT"])}  # fmt: skip


def beside(folder, text, names):
    """Write a lens file and files of materials; return the lens file."""
    for name in names:
        (folder / name).write_text(GRADIENT_FILES[name], encoding="utf-8")
    path = folder / "lens.zmx"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("kind", NAMED)
def test_materials_are_found_beside_the_lens_file_or_given(kind, tmp_path):
    text, names = NAMED[kind]
    # As wide as the SELFOC rod, whose index falls below 1 farther from the axis.
    text = text.replace("DIAM 2", "DIAM 0.5")
    lens, report = read_lens_file(beside(tmp_path, text, names))
    assert lens.surfaces[0].gradient.kind == kind
    assert not report.of(Verdict.APPROXIMATED)
    elsewhere = tmp_path / "glass"
    elsewhere.mkdir()
    for number, name in enumerate(names):
        (tmp_path / name).rename(elsewhere / f"{number}.txt")
    given = tuple(str(elsewhere / f"{number}.txt") for number in range(len(names)))
    assert read_lens_file(tmp_path / "lens.zmx", FileChoices(gradient_files=given))[0] == lens
    scene = f'camera.lens = {{ file = "lens.zmx", gradient_files = {list(given)!r} }}\n'.replace("'", '"')
    scene += "camera.sensor = { pixels = [9, 9], pixel_mm = 0.01, distance_mm = 20.0 }"
    assert loads(scene, tmp_path).camera.lens.surfaces == lens.surfaces


@pytest.mark.parametrize("kind", NAMED)
def test_a_material_without_its_file_is_refused_by_name(kind, tmp_path):
    text, names = NAMED[kind]
    path = beside(tmp_path, text, names)
    for name in names:
        held = (tmp_path / name).read_text(encoding="utf-8")
        (tmp_path / name).unlink()
        with pytest.raises(SceneError) as error:
            load_lens(path)
        assert f"stand in OpticStudio's file {name}" in str(error.value)
        assert "gradient_files" in str(error.value)
        assert "\n" not in str(error.value)
        (tmp_path / name).write_text(held, encoding="utf-8")


def test_an_unknown_material_is_refused_with_those_that_there_are(tmp_path):
    path = beside(tmp_path, SELFOC.replace("SLS-1.0", "SLS-9.0"), ["GRADIENT_9.DAT"])
    with pytest.raises(SceneError, match=r"GRADIENT_9\.DAT has no SLS-9\.0; it has SLS-1\.0, SLW-1\.8"):
        load_lens(path)


def test_the_lens_file_names_its_file_of_profiles(tmp_path):
    path = beside(tmp_path, GRADIUM.replace("PROFILE.GRD", "MINE.GRD"), ["SGRIN.DAT"])
    (tmp_path / "mine.grd").write_text(GRADIENT_FILES["PROFILE.GRD"], encoding="utf-8")
    assert load_lens(path).surfaces[0].gradient.kind == "gradium"


def test_the_index_of_a_material_is_that_of_its_formula(tmp_path):
    """SELFOC's n = n₀ (1 − A r²/2) at 550 nm, and Sellmeier's formula of GSF about its reference wavelength."""
    rod = load_lens(beside(tmp_path, SELFOC, ["GRADIENT_9.DAT"])).surfaces[0].gradient
    per = 1.0 / 0.55**2
    n0, root = 1.5477 + 6.37e-3 * per, 0.4785 + 7.157e-3 * per + 3.749e-4 * per**2
    np.testing.assert_allclose(index_of(rod), n0 * (1.0 - 0.5 * root**2 * R2), rtol=1e-14)
    glass = load_lens(beside(tmp_path, WITH_MATERIAL, ["SGRIN.DAT"])).surfaces[0].gradient
    reference = 1.6 - 0.01 * R2 + 0.02 * Z
    np.testing.assert_allclose(index_of(glass, wavelength_nm=587.56), reference, rtol=1e-14)
    k = [[-0.0683636, -0.0323639, -0.0286748, -0.0169163, 0.00256909, 0.0174719],
         [-0.00109783, 0.0334663, 0.0388098, 0.0370413, 0.017429, -0.0405421],
         [0.931075, -0.0306245, -0.0392756, -0.0423487, -0.0256629, 0.0437821]]  # fmt: skip
    poles = [[0.00498103, 0.000410271, 2.44e-5], [0.082168, 0.0343531, -0.0337717], [110.0, 2.85988e-4, 3.62547e-4]]
    square = reference**2 + (0.65**2 - 0.58756**2) * sum(
        np.polynomial.polynomial.polyval(reference, a) / (0.65**2 - np.polynomial.polynomial.polyval(reference, b))
        for a, b in zip(k, poles, strict=True)
    )
    np.testing.assert_allclose(index_of(glass, wavelength_nm=650.0), np.sqrt(square), rtol=1e-14)


def test_doubts_about_a_material_are_told(tmp_path):
    beside(tmp_path, GRADIUM, ["PROFILE.GRD", "SGRIN.DAT"])
    for old, new, word in (
        ("1.710571457024", "1.7105", "the file has n = 1.7105 at the vertex, its profile 1.71057146, which is taken"),
        ("WAVM 2 0.65", "WAVM 2 0.35", "at 350 nm, outside the data of GSF from 380 to 2200 nm"),
    ):
        (tmp_path / "lens.zmx").write_text(GRADIUM.replace(old, new), encoding="utf-8")
        _, report = read_lens_file(tmp_path / "lens.zmx")
        assert [line.text for line in report.of(Verdict.APPROXIMATED)] == ["TYPE GRINSUR8"]
        assert word in report.of(Verdict.APPROXIMATED)[0].how


def test_materials_in_mm_do_not_go_with_a_lens_in_inches(tmp_path):
    for text in (SELFOC, GRADIUM):
        path = beside(tmp_path, text.replace("UNIT MM", "UNIT IN"), GRADIENT_FILES)
        with pytest.raises(SceneError, match="are in mm; a file in another unit is not supported"):
            load_lens(path)


@pytest.mark.parametrize("ending", [".seq", ".len", ".json", ".csv"])
def test_files_of_materials_are_only_for_zemax_files(ending, tmp_path):
    path = tmp_path / f"lens{ending}"
    path.write_text("", encoding="utf-8")
    with pytest.raises(SceneError, match=r'gradient_files = \["a\.dat"\]: only for \.zmx files; omit it'):
        read_lens_file(path, FileChoices(gradient_files=("a.dat",)))


def test_layers_on_gradient_glass_are_told_as_bare():
    text = text_of("GRINSUR1", *parameters(2, 1.5, -0.01), "COAT AR").replace("SURF 2\n", "SURF 2\n  COAT I.95\n")
    lens, report = lens_of(text), report_of(text)
    assert lens.surfaces[0].coating == "none"
    assert lens.surfaces[1].coating != "none"
    assert ["bare" in line.how for line in report.of(Verdict.APPROXIMATED) if line.text == "COAT AR"] == [True]
