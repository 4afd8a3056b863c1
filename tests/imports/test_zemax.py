"""Zemax files: what is taken, what is approximated and said, what is refused."""

import math
import warnings
from pathlib import Path

import pytest

from lfmesh.errors import LensFileWarning, SceneError
from lfmesh.imports.report import Verdict
from lfmesh.imports.zemax import read
from lfmesh.optics.glass import D_LINE_NM, refractive_index
from lfmesh.scene import Paraxial, load_lens, loads
from lfmesh.scene.camera.lens import FileChoices
from lfmesh.scene.materials.own_glass import OwnGlass
from tests.imports.files import SINGLET_ZMX

FILE = Path("lens.zmx")


def lens_of(text, **options):
    return read(FILE, text.splitlines(), **options)[0]


def report_of(text, **options):
    return read(FILE, text.splitlines(), **options)[1]


def changed(old, new):
    assert SINGLET_ZMX.count(old) == 1
    return SINGLET_ZMX.replace(old, new)


def refusal_of(text):
    with pytest.raises(SceneError) as error:
        lens_of(text)
    return str(error.value)


def test_surfaces_are_those_of_the_file():
    lens = lens_of(SINGLET_ZMX)
    front, back = lens.surfaces
    assert (lens.name, lens.source) == ("singlet", "written for tests")
    assert (front.radius_mm, front.thickness_mm, front.glass, front.stop) == (50.0, 5.0, "SCHOTT/N-BK7", True)
    assert (back.radius_mm, back.conic, back.asphere_mm) == (-80.0, -0.5, (1e-6, -2e-9))
    assert (back.glass, back.thickness_mm, back.semi_diameter_mm) == (None, None, 6.25)


def test_the_stop_follows_from_the_entrance_pupil_not_from_what_the_program_draws():
    assert lens_of(SINGLET_ZMX).surfaces[0].semi_diameter_mm == pytest.approx(5.0, rel=1e-14)
    behind = SINGLET_ZMX.replace("  STOP\n", "").replace("SURF 2\n", "SURF 2\n  STOP\n")
    lens = lens_of(behind)
    _, diameter = Paraxial.of(lens, D_LINE_NM).entrance_pupil(lens.surfaces[1].semi_diameter_mm)
    assert diameter == pytest.approx(10.0, rel=1e-12)


@pytest.mark.parametrize(
    ("pupil", "radius"),
    [
        # y/u' of the singlet at its focus is the focal length: 5.0 of f/N.
        ("FLOA", 5.2),
        ("ENPD 8", 4.0),
    ],
)
def test_pupils(pupil, radius):
    assert lens_of(changed("ENPD 10", pupil)).surfaces[0].semi_diameter_mm == pytest.approx(radius, rel=1e-12)


def test_an_f_number_stays_one():
    assert lens_of(changed("ENPD 10", "FNUM 4 0")).f_number == 4.0


def test_the_aperture_of_an_object_nearby_makes_its_cone():
    near = changed("DISZ INFINITY", "DISZ 200").replace("ENPD 10", "OBNA 0.02 0")
    expected = 200.0 * math.tan(math.asin(0.02))
    assert lens_of(near).surfaces[0].semi_diameter_mm == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(("unit", "scale"), [("CM", 10.0), ("IN", 25.4), ("METER", 1000.0)])
def test_units_scale_every_length_and_each_coefficient_by_its_power(unit, scale):
    one, other = lens_of(SINGLET_ZMX), lens_of(changed("UNIT MM", f"UNIT {unit}"))
    for a, b in zip(one.surfaces, other.surfaces, strict=True):
        assert b.radius_mm == pytest.approx(scale * a.radius_mm, rel=1e-14)
        assert b.semi_diameter_mm == pytest.approx(scale * a.semi_diameter_mm, rel=1e-12)
        assert b.sag_mm(3.0 * scale) == pytest.approx(scale * a.sag_mm(3.0), rel=1e-13)


def test_apertures_that_the_file_leaves_open_pass_the_beams_of_its_fields():
    bare = changed("  DIAM 6.5 1 0 0 1\n  CLAP 0 6.25 0\n", "")
    lens, report = lens_of(bare), report_of(bare)
    index = Paraxial.of(lens, D_LINE_NM).indices[1]
    # By hand: the chief ray of 7 degrees passes the middle of the stop, at the first vertex; the marginal, its edge.
    chief = 5.0 * math.tan(math.radians(7.0)) / index
    edge = 5.0 - 5.0 * 5.0 * (index - 1) / index / 50.0
    assert lens.surfaces[1].semi_diameter_mm == pytest.approx(1.05 * (chief + edge), rel=1e-12)
    assert any("clear aperture of surface 1" in note for note in report.notes)
    squeezed = lens_of(bare.replace("VCYN 0 0 0 0", "VCYN 0 0.25 0 0"))
    assert squeezed.surfaces[1].semi_diameter_mm == pytest.approx(1.05 * max(chief + 0.75 * edge, edge), rel=1e-12)


def test_before_the_stop_the_lower_edge_of_a_beam_decides():
    """The chief ray meets the front below the axis, so that its lower part needs more than the axis."""
    text = (
        SINGLET_ZMX.replace("  STOP\n", "").replace("SURF 2\n", "SURF 2\n  STOP\n").replace("  DIAM 5.2 0 0 0 1\n", "")
    )
    text = text.replace("VCYN 0 0 0 0", "VCYN 0 0.25 0 0").replace("VDYN 0 0 0 0", "VDYN 0 -0.25 0 0")
    lens = lens_of(text)
    pupil_mm, _ = Paraxial.of(lens, D_LINE_NM).entrance_pupil(1.0)
    chief = -pupil_mm * math.tan(math.radians(7.0))
    assert chief < 0
    assert lens.surfaces[0].semi_diameter_mm == pytest.approx(1.05 * (5.0 - chief), rel=1e-12)


def test_a_plane_before_the_lens_adds_to_the_distance_of_the_object():
    near = changed("DISZ INFINITY", "DISZ 200").replace("ENPD 10", "OBNA 0.02 0")
    parted = near.replace("DISZ 200", "DISZ 196").replace("SURF 1\n", "SURF 1\n  CURV 0.0\n  DISZ 4\nSURF 2\n", 1)
    assert lens_of(parted) == lens_of(near)
    assert "object: 200 mm before the first surface (camera.focus_mm)" in report_of(parted).notes


def test_planes_without_effect_are_left_out_and_their_distances_kept():
    dummies = changed("SURF 1\n", "SURF 1\n  CURV 0.0\n  DISZ 4\nSURF 2\n").replace("DISZ 50", "DISZ 20")
    dummies = dummies.replace("  CLAP 0 6.25 0\n", "  CLAP 0 6.25 0\nSURF 9\n  CURV 0.0\n  DISZ 30\n")
    assert lens_of(dummies) == lens_of(SINGLET_ZMX)
    assert "image: 50 mm behind the last surface (camera.sensor.distance_mm)" in report_of(dummies).notes
    assert any(note.startswith("surfaces 1, 4 of the file") for note in report_of(dummies).notes)


def test_a_plane_with_an_aperture_of_its_own_stays():
    lens = lens_of(changed("SURF 1\n", "SURF 1\n  CURV 0.0\n  DISZ 4\n  CLAP 0 7 0\nSURF 2\n"))
    assert (len(lens.surfaces), lens.surfaces[0].semi_diameter_mm, lens.surfaces[0].thickness_mm) == (3, 7.0, 4.0)


def test_without_lines_of_type_a_surface_is_a_standard_one():
    assert lens_of(SINGLET_ZMX.replace("  TYPE STANDARD\n", "")) == lens_of(SINGLET_ZMX)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "latin-1"])
@pytest.mark.parametrize("ending", ["\n", "\r\n"])
def test_encodings_and_line_ends(tmp_path, encoding, ending):
    path = tmp_path / "lens.ZMX"
    path.write_bytes(SINGLET_ZMX.replace("NAME singlet", "NAME Ø 10 mm").replace("\n", ending).encode(encoding))
    lens = load_lens(path)
    assert lens.name == "Ø 10 mm"
    assert lens.surfaces == lens_of(SINGLET_ZMX).surfaces


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("GLAS N-BK7", "GLAS MIRROR", "mirrors are not supported"),
        ("GLAS N-BK7", "GLAS N-BK77", "not in the catalogue; close to it are SCHOTT/N-BK7"),
        ("GLAS N-BK7 0 0 1.5168 64", "GLAS ___BLANK 1 0 1.5168 -64", "glass given by nd = 1.5168, Vd = -64.17"),
        ("PARM 2 1e-6", "PARM 9 1e-6", "parameter 9 of EVENASPH is unknown"),
        ("TYPE EVENASPH", "TYPE GRINSUR6", "gradient-index glass of GLC.DAT"),
        ("CLAP 0 6.25 0", "CLAP 1 6.25 0", "its middle is dark"),
        ("CLAP 0 6.25 0", "OBSC 0 2 0", "a central obscuration"),
        ("CLAP 0 6.25 0", "OBDC 0 2", "a decentred aperture"),
        ("DISZ 5\n", "DISZ five\n", "'five' is not a number"),
        ("DISZ 5\n", "DISZ nan\n", "is not finite"),
        ("DISZ 5\n", "DISZ\n", "it is cut short"),
        ("DISZ 5\n", "DISZ INFINITY\n", "only the object"),
        ("MODE SEQ", "MODE NSC", "only sequential files"),
        ("UNIT MM", "UNIT FURLONG", "unit FURLONG is unknown"),
        ("ENPD 10", "ENPD -10", "above 0"),
    ],
)
def test_what_changes_the_image_is_refused_with_its_line(old, new, reason):
    text = SINGLET_ZMX.replace(old, new, 1)
    message = refusal_of(text)
    assert message.startswith("lens.zmx: line ")
    assert reason in message
    number = int(message.split("line ")[1].split(":")[0])
    assert new.split("\n")[0].split()[0] in text.splitlines()[number - 1]


def test_light_that_would_have_to_go_back_is_refused():
    assert "SURF 1: the next surface lies 5 mm in front of this one" in refusal_of(changed("DISZ 5\n", "DISZ -5\n"))


def test_a_coordinate_break_without_a_tilt_is_nothing():
    zero = "SURF 1\n  TYPE COORDBRK\n  CURV 0.0\n  PARM 3 0\n  PARM 6 0\n  DISZ 0\nSURF 1\n"
    assert lens_of(changed("SURF 1\n", zero)) == lens_of(SINGLET_ZMX)
    assert "the axis is not restored" in refusal_of(changed("SURF 1\n", zero.replace("PARM 3 0", "PARM 3 2.5")))


def test_all_refusals_are_named_at_once():
    message = refusal_of(changed("GLAS N-BK7", "GLAS MIRROR").replace("CLAP 0 6.25 0", "OBSC 0 2 0"))
    assert message.splitlines()[0] == "lens.zmx: 2 faults"
    assert len(message.splitlines()) == 3


def test_a_model_glass_is_the_normal_one_of_its_nd_and_vd():
    text = changed("GLAS N-BK7 0 0", "GLAS ___BLANK 1 0")
    lens, report = lens_of(text), report_of(text)
    assert lens.surfaces[0].glass == OwnGlass(nd=1.5168, vd=64.17)
    assert [line.how for line in report.of(Verdict.APPROXIMATED)] == ["the normal glass of its nd and Vd"]


def test_a_model_glass_beyond_what_nd_and_vd_tell_is_refused():
    text = changed("GLAS N-BK7 0 0", "GLAS ___BLANK 1 0").replace("WAVM 1 0.4861327", "WAVM 1 1.55")
    assert "at 1550 nm: nd and Vd determine the index only from 350 to 1100 nm" in refusal_of(text)


def test_a_glass_is_taken_from_the_catalogue_that_the_file_names():
    """HOYA and HIKARI have an E-F2 of different dispersion: the name alone would not do."""
    text = changed("GLAS N-BK7 0 0 1.5168 64.17", "GLAS E-F2 0 0 1.5 40")
    for makers, glass in {
        "HIKARI": "HIKARI/E-F2",
        "SCHOTT HOYA HIKARI": "HOYA/E-F2",
        "HIKARI_2019": "HIKARI/E-F2",
    }.items():
        assert lens_of(text.replace("GCAT SCHOTT", f"GCAT {makers}")).surfaces[0].glass == glass
    assert "2 glasses of different index have this name" in refusal_of(text)


def test_a_glass_from_elsewhere_than_the_files_catalogues_is_said():
    (line,) = report_of(changed("GCAT SCHOTT", "GCAT LIGHTPATH")).of(Verdict.APPROXIMATED)
    assert line.how == "not in LIGHTPATH; the catalogue has it as SCHOTT/N-BK7 (nd 1.51680, Vd 64.17)"


@pytest.mark.parametrize(
    ("name", "glass", "nd"),
    [
        ("PMMA", "organic/poly_methyl_methacrylate/Sultanova", 1.4917),
        ("POLYCARB", "organic/polycarbonate/Sultanova", 1.5855),
        ("SAPPHIRE", "main/Al2O3/Malitson-o", 1.7682),
        ("MGF2", "main/MgF2/Dodge-o", 1.3777),
    ],
)
def test_crystals_and_plastics_are_taken_and_said(name, glass, nd):
    """The indices are those that data sheets of lens makers print, to the digits in which samples agree."""
    text = changed("GLAS N-BK7", f"GLAS {name}").replace("1.5168 64.17", f"{nd} 30.0")
    assert lens_of(text).surfaces[0].glass == glass
    (line,) = report_of(text).of(Verdict.APPROXIMATED)
    assert line.how.startswith(f"{name}: not a maker's glass; taken as {glass} (nd ")
    assert refractive_index(glass, D_LINE_NM) == pytest.approx(nd, abs=2e-3)


def test_a_glass_that_the_user_names_replaces_the_files():
    text = changed("GLAS N-BK7", "GLAS N-BK77")
    assert "not in the catalogue" in refusal_of(text)
    assert "give --glass N-BK77=GLASS or camera.lens.substitutes" in refusal_of(text)
    assert lens_of(text, choices=FileChoices({"N-BK77": "SCHOTT/N-BK7"})) == lens_of(SINGLET_ZMX)
    assert lens_of(text, choices=FileChoices({"N-BK77": 1.51})).surfaces[0].index == 1.51


def test_a_glass_with_another_index_than_the_file_says_is_taken_and_said():
    (line,) = report_of(changed("1.5168 64.17", "1.6 64.17")).of(Verdict.APPROXIMATED)
    assert line.how == "the file gives nd = 1.6, the catalogue 1.5168, which is taken"


def test_a_rectangular_aperture_is_the_circle_round_it():
    text = changed("CLAP 0 6.25 0", "SQAP 3 4 0")
    assert lens_of(text).surfaces[1].semi_diameter_mm == 5.0
    assert [line.text for line in report_of(text).of(Verdict.APPROXIMATED)] == ["SQAP 3 4 0"]


def test_every_line_has_a_verdict():
    lines = [line for line in SINGLET_ZMX.splitlines() if line.strip()]
    assert {line.number for line in report_of(SINGLET_ZMX).lines} == set(range(1, len(lines) + 1))


def test_doubts_are_warned_of_and_a_plain_file_is_silent(tmp_path):
    path = tmp_path / "lens.zmx"
    path.write_text(changed("  STOP\n", "  STOP\n  NEWKEY 1 2\n"))
    with pytest.warns(LensFileWarning, match="line 26: NEWKEY 1 2: unknown"):
        load_lens(path)
    path.write_text(SINGLET_ZMX)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_lens(path)


SCENE = """
schema_version = 1
[camera]
focus_mm = 500.0
[camera.lens]
file = "{}"
{}
[camera.sensor]
pixels = [32, 32]
pixel_mm = 0.02
"""


def test_a_scene_names_a_zemax_file(tmp_path):
    (tmp_path / "lens.zmx").write_text(SINGLET_ZMX)
    lens = loads(SCENE.format("lens.zmx", ""), tmp_path).camera.lens
    assert lens == lens_of(SINGLET_ZMX)
    faster = loads(SCENE.format("lens.zmx", "f_number = 4.0"), tmp_path).camera.lens
    assert (faster.f_number, faster.surfaces) == (4.0, lens.surfaces)


def test_a_scene_says_what_is_wrong_with_its_lens_file(tmp_path):
    (tmp_path / "lens.zmx").write_text(changed("GLAS N-BK7", "GLAS MIRROR"))
    with pytest.raises(SceneError, match=r'camera\.lens\.file = "lens\.zmx": .*mirrors are not supported'):
        loads(SCENE.format("lens.zmx", ""), tmp_path)


MENISCI_ZMX = """\
MODE SEQ
UNIT MM
FNUM 4 0
SURF 0
  TYPE STANDARD
  DISZ INFINITY
SURF 1
  STOP
  TYPE STANDARD
  CURV 0.045
  DISZ 5.0
  GLAS ___BLANK 1 0 1.8 46.6 0
  DIAM 12.0
SURF 2
  TYPE STANDARD
  CURV 0.020
  DISZ 0.3721
  DIAM 12.0
SURF 3
  TYPE STANDARD
  CURV 0.015
  DISZ 1.0
  GLAS ___BLANK 1 0 1.72 29.5 0
  DIAM 12.0
SURF 4
  TYPE STANDARD
  CURV 0.050
  DISZ 30
  DIAM 11.0
SURF 5
  TYPE STANDARD
  DISZ 0
"""


def test_what_is_drawn_shrinks_where_neighbours_cross():
    lens, report = read(FILE, MENISCI_ZMX.splitlines())
    said = [line.how for line in report.of(Verdict.APPROXIMATED) if "inside the drawn size" in line.how]
    assert len(said) == 2
    # They stand 0.3721 mm apart, and stop doing so at this height.
    sizes = [lens.surfaces[k].semi_diameter_mm for k in (1, 2)]
    assert 11.8 < sizes[0] == sizes[1] < 12.0
    clear = MENISCI_ZMX.replace("  DIAM 12.0\nSURF 3", "  DIAM 12.0\n  FLAP 0 12.0\nSURF 3")
    clear = clear.replace("  DIAM 12.0\nSURF 4", "  DIAM 12.0\n  FLAP 0 12.0\nSURF 4")
    assert "surfaces 1 and 2 cross inside their clear aperture" in refusal_of(clear)


def test_a_name_that_makers_give_to_different_glasses_needs_its_maker():
    other = changed("GLAS N-BK7 0 0 1.5168 64.17", "GLAS F2 0 0 1.5 40").replace("GCAT SCHOTT\n", "")
    assert "glass 'F2' means different glasses: SCHOTT/F2 (nd = 1.62004)" in refusal_of(other)
    assert lens_of(other.replace("UNIT MM", "GCAT CDGM\nUNIT MM")).surfaces[0].glass == "CDGM/F2"
    assert lens_of(other, choices=FileChoices({"F2": "SCHOTT/F2"})).surfaces[0].glass == "SCHOTT/F2"


def test_a_name_without_a_catalogue_that_only_another_maker_has_is_said():
    # SCHOTT's SK2 of old and its N-SK2 have the same index.
    report = report_of(changed("GLAS N-BK7 0 0 1.5168 64.17", "GLAS SK2 0 0 1.5 40").replace("GCAT SCHOTT\n", ""))
    assert any(
        "the file names no catalogue; taken as HIKARI/SK2" in line.how for line in report.of(Verdict.APPROXIMATED)
    )
    assert not any("catalogue" in line.how for line in report_of(SINGLET_ZMX.replace("GCAT SCHOTT\n", "")).lines)


def test_a_primary_wavelength_that_is_not_there_is_said():
    report = report_of(changed("PWAV 2", "PWAV 7"))
    assert [line.how for line in report.of(Verdict.APPROXIMATED)] == [
        "there is no wavelength 7; the first is the primary one"
    ]
    assert report.conditions is not None
    assert report.conditions.primary == 0


def test_a_telecentric_object_space_is_said_where_the_stop_does_not_make_it():
    said = [line.how for line in report_of(changed("FTYP 0 0", "FTYP 0 1")).of(Verdict.APPROXIMATED)]
    assert said == [
        "the file asks for chief rays parallel to the axis in object space; here they pass the stop, with an entrance "
        "pupil 0 mm behind the first surface"
    ]
