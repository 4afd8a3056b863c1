"""CODE V sequences: the same laws as for Zemax files, and the language's own traps."""

from pathlib import Path

import pytest

from lfmesh.errors import SceneError
from lfmesh.imports import zemax
from lfmesh.imports.codev import read
from lfmesh.imports.codev_commands import commands
from lfmesh.imports.report import Verdict
from lfmesh.optics.glass import refractive_index
from lfmesh.scene import load_lens
from lfmesh.scene.camera.lens import FileChoices
from lfmesh.scene.materials.own_glass import OwnGlass
from tests.imports.files import SINGLET_SEQ, SINGLET_ZMX

FILE = Path("lens.seq")


def lens_of(text, **options):
    return read(FILE, text.splitlines(), **options)[0]


def report_of(text):
    return read(FILE, text.splitlines())[1]


def changed(old, new):
    assert SINGLET_SEQ.count(old) == 1
    return SINGLET_SEQ.replace(old, new)


def refusal_of(text):
    with pytest.raises(SceneError) as error:
        lens_of(text)
    return str(error.value)


def test_the_same_lens_as_in_a_zemax_file():
    there, _ = zemax.read(Path("lens.zmx"), SINGLET_ZMX.splitlines())
    assert lens_of(SINGLET_SEQ).model_copy(update={"source": there.source}) == there


def test_curvatures_in_place_of_radii():
    text = changed("RDM;LEN", "RDM N;LEN").replace("S 50.0 5.0", "S 0.02 5.0").replace("S -80.0", "S -0.0125")
    assert lens_of(text) == lens_of(SINGLET_SEQ)
    guessed = text.replace("RDM N;", "")
    assert lens_of(guessed) == lens_of(SINGLET_SEQ)
    (line,) = report_of(guessed).of(Verdict.APPROXIMATED)
    assert line.how.startswith("no RDM in the file")


def test_commands_are_cut_at_semicolons_and_joined_by_ampersands():
    lines = ["s 1 & ! cut", "2; k 3 ! c; d", "TITLE 'a; b ! c'", 'SLB "x"']
    assert [(at, words) for at, words in commands(lines)] == [
        (1, ["s", "1", "2"]),
        (1, ["k", "3"]),
        (3, ["TITLE", "'a; b ! c'"]),
        (4, ["SLB", '"x"']),
    ]


def test_a_command_may_name_its_surface():
    moved = (
        changed("  CIR 6.25\n", "").replace("  STO\n", "").replace("SI 0.0 0.0\n", "SI 0.0 0.0\nCIR S2 6.25\nSTO S1\n")
    )
    assert lens_of(moved) == lens_of(SINGLET_SEQ)
    assert (
        lens_of(moved + "RDY S1 40\nTHI S1 4\nGLA S1 1.0.0\n".replace("GLA S1 1.0.0\n", "")).surfaces[0].radius_mm == 40
    )


def test_without_a_stop_the_first_surface_is_it():
    assert lens_of(changed("  STO\n", "")) == lens_of(SINGLET_SEQ)


@pytest.mark.parametrize(("unit", "scale"), [("C", 10.0), ("I", 25.4)])
def test_units(unit, scale):
    one, other = lens_of(SINGLET_SEQ), lens_of(changed("DIM M", f"DIM {unit}"))
    for a, b in zip(one.surfaces, other.surfaces, strict=True):
        assert b.sag_mm(3.0 * scale) == pytest.approx(scale * a.sag_mm(3.0), rel=1e-13)


def test_a_private_glass_of_one_index_is_that_index():
    text = changed("SO 0.0", "PRV\nPWL 650 550&\n 450\n'MINE' 1.6 1.6 1.6\nEND\nSO 0.0").replace(
        "NBK7_SCHOTT", "'MINE'"
    )
    assert lens_of(text).surfaces[0].index == 1.6
    dispersive = text.replace("1.6 1.6 1.6", "1.6 1.61 1.62")
    table = OwnGlass(wavelengths_nm=(450.0, 550.0, 650.0), values=(1.62, 1.61, 1.6))
    assert lens_of(dispersive).surfaces[0].glass == table
    assert "'MINE' 1.6 1.61: 2 indices for 3 wavelengths" in refusal_of(text.replace("1.6 1.6 1.6", "1.6 1.61"))


@pytest.mark.parametrize("formula", ["URN", "SEL", "SPG"])
def test_a_private_glass_with_a_gradient_is_refused_by_name(formula):
    private = f"PRV\nPWL 550\n'MINE' {formula} 1.6 -0.01\nEND\nSO 0.0"
    message = refusal_of(changed("SO 0.0", private).replace("NBK7_SCHOTT", "'MINE'"))
    assert f"'MINE' {formula} 1.6 -0.01: gradient indices of CODE V are not supported" in message
    assert "\n" not in message


def test_a_fictitious_glass_is_the_normal_one_of_its_nd_and_vd():
    glass = lens_of(changed("NBK7_SCHOTT", "516800.641700")).surfaces[0].glass
    assert glass.nd == pytest.approx(1.5168, rel=1e-15)
    assert glass.vd == 64.17


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("NBK7_SCHOTT", "REFL", "mirrors are not supported"),
        ("NBK7_SCHOTT", "SK19_SCHOTT", "not in the catalogue"),
        ("  CIR 6.25", "  CIR OBS 2.0", "obscurations and holes"),
        ("  CIR 6.25", "  ADE 5.0", "the axis is not restored"),
        ("  CIR 6.25", "  DIF KIN", "diffractive surfaces of kind KIN are not supported"),
        ("  CIR 6.25", "  XTO", "toroids"),
        ("  CIR 6.25", "  REX 3.0; REY 4.0", "rectangular apertures"),
        ("  CIR 6.25", "  RET S9", "RET S9: there is no surface 9"),
        ("  STO\n", "  STO S9\n", "STO S9: there is no surface 9"),
        ("GO\n", "DEL S1\nGO\n", "DEL S1: commands that edit the lens are not run"),
        ("  CIR 6.25", "  GLB S1", "surfaces placed from any but the previous surface"),
        ("A 1e-6", "A one", "'one' is not a number"),
        ("DIM M", "DIM F", "unit F is unknown"),
    ],
)
def test_what_changes_the_image_is_refused_with_its_line(old, new, reason):
    message = refusal_of(changed(old, new))
    assert message.startswith("lens.seq: ")
    assert reason in message
    assert "line " in message


def test_a_decentre_of_zero_is_nothing():
    assert lens_of(changed("  CIR 6.25", "  CIR 6.25\n  ADE 0.0; YDE 0; DAR")) == lens_of(SINGLET_SEQ)


def test_a_file_that_is_cut_short_says_so():
    assert refusal_of(changed("SI 0.0 0.0\nGO\n", "")) == "lens.seq: cut short: it has no image surface SI"


def test_a_path_loads_by_its_ending(tmp_path):
    path = tmp_path / "Lens.SEQ"
    path.write_text(SINGLET_SEQ)
    assert load_lens(path) == lens_of(SINGLET_SEQ)


SINGLET = """\
RDM
EPD 10.0
DIM M
WL 587.6
REF 1
YAN 0.0
{private}SO 0.0 {far}
S  50.0 4.0 {glass}
  STO
  CIR 8.0
S  -50.0 45.0
  CIR 8.0
SI 0.0 0.0
"""


def singlet(far="1e10", glass="NBK7_SCHOTT", private=""):
    return SINGLET.format(far=far, glass=glass, private=private)


def test_an_object_may_stand_at_inf_and_a_glass_be_given_by_nd_and_vd():
    lens, report = read(Path("lens.seq"), singlet("inf", "1.5168:64.17").splitlines())
    assert (lens.surfaces[0].glass.nd, lens.surfaces[0].glass.vd) == (1.5168, 64.17)
    assert any(note.startswith("object: inf") for note in report.notes)


LAURENT = "PRV\n  PWL 550.0\n  'GLUE' LAU 2.36 0.001 0.0255 -0.00058 -0.35e-5 0.44e-7\nEND\n"


def test_a_private_glass_by_laurents_formula_is_the_formula():
    lens, _ = read(Path("lens.seq"), singlet(glass="'GLUE'", private=LAURENT).splitlines())
    for nm in (404.7, 486.13, 587.6, 656.27, 1013.9):
        um = 1e-3 * nm
        square = 2.36 + 0.001 * um**2 + 0.0255 / um**2 - 0.00058 / um**4 - 0.35e-5 / um**6 + 0.44e-7 / um**8
        assert lens.surfaces[0].glass.index_at(nm) == pytest.approx(square**0.5, abs=1e-8)


@pytest.mark.parametrize("formula", ["GMS 1.0", "GMS 1.0 0.25", "LAU", "LAU 0.1", "SEL x"])
def test_a_private_glass_that_no_surface_has_is_never_in_the_way(formula):
    private = f"PRV\n  PWL 550.0\n  'GLUE' {formula}\nEND\n"
    lens, report = read(Path("lens.seq"), singlet(private=private).splitlines())
    assert lens.surfaces[0].glass == "SCHOTT/N-BK7"
    assert ["refused where a surface has it" in line.how for line in report.of(Verdict.UNKNOWN)] == [True]
    with pytest.raises(SceneError, match="GLUE"):
        read(Path("lens.seq"), singlet(glass="'GLUE'", private=private).splitlines())


BK7 = "1.03961212 0.00600069867 0.231792344 0.0200179144 1.01046945 103.560653"


@pytest.mark.parametrize(
    ("formula", "index"),
    [
        (f"GMS {BK7}", lambda um: refractive_index("SCHOTT/N-BK7", 1e3 * um)),
        (f"SLM {BK7}", lambda um: refractive_index("SCHOTT/N-BK7", 1e3 * um)),
        ("GML 2.36 0.001 0.0255", lambda um: (2.36 + 0.001 * um**2 + 0.0255 / um**2) ** 0.5),
        ("CAU 1.5 0.004 2e-6", lambda um: 1.5 + 0.004 / um**2 + 2e-6 / um**4),
        ("HAR 1.5 0.004 0.12", lambda um: 1.5 + 0.004 / (um - 0.12)),
    ],
)
def test_private_glasses_by_other_formulas_are_the_formulas_and_said(formula, index):
    private = f"PRV\n  PWL 550.0\n  'GLUE' {formula}\nEND\n"
    lens, report = read(Path("lens.seq"), singlet(glass="'GLUE'", private=private).splitlines())
    for nm in (404.7, 486.13, 587.6, 656.27, 1013.9):
        assert lens.surfaces[0].glass.index_at(nm) == pytest.approx(index(1e-3 * nm), abs=2e-8)
    said = [line.how for line in report.of(Verdict.APPROXIMATED)]
    assert said == [f"formula {formula[:3]} with its coefficients in the order that other readers take"]
    _, unused = read(Path("lens.seq"), singlet(private=private).splitlines())
    assert not unused.of(Verdict.APPROXIMATED)


def test_sellmeiers_coefficients_in_another_order_are_refused():
    b1, c1, b2, c2, b3, c3 = BK7.split()
    private = f"PRV\n  PWL 550.0\n  'GLUE' SLM {b1} {b2} {b3} {c1} {c2} {c3}\nEND\n"
    with pytest.raises(SceneError, match="GLUE"):
        read(Path("lens.seq"), singlet(glass="'GLUE'", private=private).splitlines())


def test_a_missing_line_rdm_is_named_as_the_likely_cause():
    with pytest.raises(SceneError, match=r"the file has no line RDM.*put RDM before them"):
        read(Path("lens.seq"), singlet().replace("RDM\n", "").splitlines())
    with pytest.raises(SceneError) as other:
        read(Path("lens.seq"), singlet().replace("50.0 4.0", "1.0 4.0").splitlines())
    assert "RDM" not in str(other.value)


def test_multilayers_are_said_to_be_left_out():
    _, report = read(Path("lens.seq"), singlet().replace("  STO\n", "  STO\n  MLT 'ar.mul'\n").splitlines())
    assert ["the surface is traced bare" in line.how for line in report.of(Verdict.APPROXIMATED)] == [True]


def test_a_surface_that_reflects_by_its_mode_is_refused():
    with pytest.raises(SceneError, match="line 9: RMD REFL: mirrors are not supported"):
        read(Path("lens.seq"), singlet().replace("  STO\n", "  RMD REFL\n").splitlines())
    _, report = read(Path("lens.seq"), singlet().replace("  STO\n", "  STO\n  RMD REFR\n").splitlines())
    assert not report.of(Verdict.UNKNOWN)


@pytest.mark.parametrize(("line", "said"), [("TEM 20", 0), ("PRE 760", 0), ("TEM 60", 1), ("PRE 0", 1)])
def test_another_temperature_or_pressure_than_the_catalogues_is_said(line, said):
    _, report = read(Path("lens.seq"), SINGLET_SEQ.replace("GO\n", f"{line}\nGO\n").splitlines())
    assert sum(each.text == line for each in report.of(Verdict.APPROXIMATED)) == said


def test_a_reference_wavelength_that_is_not_there_is_said():
    _, report = read(Path("lens.seq"), SINGLET_SEQ.replace("REF 2", "REF 7").splitlines())
    assert [each.how for each in report.of(Verdict.APPROXIMATED)] == ["there is no wavelength 7; 3 is the primary one"]
    assert report.conditions.primary == 2


@pytest.mark.parametrize("name", ["SILICA_SPECIAL", "silica_special", "SILICA"])
def test_fused_silica_of_no_maker_is_known(name):
    lens, _ = read(Path("lens.seq"), singlet(glass=name).splitlines())
    assert refractive_index(lens.surfaces[0].glass, 587.5618) == pytest.approx(1.45846, abs=1e-5)


def test_an_object_may_be_named_by_its_number():
    assert lens_of(SINGLET_SEQ.replace("\nSO ", "\nS0 ")) == lens_of(SINGLET_SEQ)


ZOOM = SINGLET_SEQ.replace("GO\n", "ZOO 3\nZOO THI S1 5.0 6.0 7.5\nZOO THC S1 0 0 0\nZOO EPD 10.0 9.0 8.0\nGO\n")


@pytest.mark.parametrize("position", [1, 2, 3])
def test_a_zoom_position_is_the_lens_whose_surfaces_hold_its_values(position):
    thickness, diameter = ((5.0, 10.0), (6.0, 9.0), (7.5, 8.0))[position - 1]
    alone = SINGLET_SEQ.replace("GO\n", f"THI S1 {thickness}\nEPD {diameter}\nGO\n")
    assert lens_of(ZOOM, choices=FileChoices(configuration=position)) == lens_of(alone)


PLACED = ZOOM.replace("ZOO THI S1 5.0 6.0 7.5\n", "ZOO THI S1\nTHI S1 Z1 5.0\nTHI S1 Z2 6.0\nthi s1 z3 7.5\n")


@pytest.mark.parametrize("position", [1, 2, 3])
def test_values_at_single_positions_are_those_of_their_row(position):
    text, choices = PLACED, FileChoices(configuration=position)
    assert lens_of(text, choices=choices) == lens_of(ZOOM, choices=choices)
    assert lens_of(text) == lens_of(ZOOM)
    with pytest.raises(SceneError, match="THI S1 Z4 9: it must give a value at one of 3 positions"):
        lens_of(text.replace("GO\n", "THI S1 Z4 9\nGO\n"), choices=choices)


@pytest.mark.parametrize("row", ["ZOO YAN F2 7.0 5.0 3.0", "YAN F2 Z1 7; YAN F2 Z2 5; YAN F2 Z3 3"])
def test_one_field_and_one_wavelength_may_differ_between_positions(row):
    text = ZOOM.replace("GO\n", f"{row}\nZOO WL W3 400 500 510\nGO\n")
    for position, (field, wavelength) in enumerate(((7.0, 400.0), (5.0, 500.0), (3.0, 510.0)), 1):
        held = read(FILE, text.splitlines(), FileChoices(configuration=position))[1].conditions
        assert [point.y for point in held.fields] == [0.0, field]
        assert held.wavelengths_nm == (*report_of(SINGLET_SEQ).conditions.wavelengths_nm[:2], wavelength)


def test_a_zoom_file_says_which_position_is_taken_and_their_focal_lengths():
    report = report_of(ZOOM)
    (line,) = report.of(Verdict.APPROXIMATED)
    assert line.how == "3 configurations: the values in the surfaces are taken"
    each = [read(FILE, ZOOM.splitlines(), FileChoices(configuration=k))[1].focal_length_mm for k in (1, 2, 3)]
    assert len({round(length, 3) for length in each}) == 3
    listed = ", ".join(f"{k}: {length:.6g} mm" for k, length in enumerate(each, 1))
    assert report.notes[-1] == f"focal lengths of the configurations: {listed}"


@pytest.mark.parametrize(
    ("text", "position", "said"),
    [
        (ZOOM, 4, "configuration = 4: the file has configurations 1 to 3"),
        (SINGLET_SEQ, 2, "configuration = 2: the file has one configuration"),
        (ZOOM.replace("5.0 6.0 7.5", "5.0 6.0"), 2, "it must name one command and its values at 3 positions"),
        (ZOOM.replace("ZOO 3", "ZOO 0"), None, "ZOO 0: the number of zoom positions must be a whole number from"),
        (ZOOM.replace("ZOO 3", "ZOO 2.5"), None, "must be a whole number"),
        (ZOOM.replace("ZOO EPD", "ZOO YAN F4"), 2, "YAN F4 9.0: there is no field 4"),
        (ZOOM.replace("ZOO EPD", "ZOO WL W4"), 2, "WL W4 9.0: there is no wavelength 4"),
        (ZOOM.replace("THI S1 5.0 6.0 7.5", "ADE S1 0.0 1.0 2.0"), 2, "the axis is not restored"),
    ],
)
def test_zoom_positions_that_cannot_be_taken_are_refused(text, position, said):
    with pytest.raises(SceneError, match=said):
        lens_of(text, choices=FileChoices(configuration=position))


def test_a_coating_file_is_for_zemax_files_only():
    with pytest.raises(SceneError, match=r'coating_file = "a\.dat": only for \.zmx files'):
        lens_of(SINGLET_SEQ, choices=FileChoices(coating_file="a.dat"))
