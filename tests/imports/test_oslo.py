"""OSLO's lens files: surfaces, media and conditions as they stand, what is not read named or refused."""

import math
from pathlib import Path

import numpy as np
import pytest

from lfmesh.errors import SceneError
from lfmesh.geometry.lens.element_poses import pose_of
from lfmesh.imports.oslo import commands, read
from lfmesh.imports.report import Verdict

FILE = Path("lens.len")
LENS = """\
// OSLO 6.6
LEN NEW "two; lenses" 50 5
EBR 4.0
ANG 5.0
UNI 1.0
WV 0.58756 0.48613 0.65627
AIR; TH 1e20
NXT // SRF 1
GLA N-BK7; RD 20.0; TH 2.0; AP CHK 6.0
CC -0.5; AD 1e-6; AE -2e-9
NXT
AIR; RD -30.0; TH 3.0; AP 5.5
NXT
GLA MOD G1 1.62 1.63 1.615; TH 2.0; AST
NXT
AIR; RD 60.0; TH 30.0; PY 0.0
NXT
AIR
WW 1.0 1.0 1.0
END 5
"""


def lens_of(text=LENS):
    return read(FILE, text.splitlines())[0]


def test_surfaces_media_and_conditions_are_taken():
    lens, report = read(FILE, LENS.splitlines())
    first, second, stop, last = lens.surfaces
    assert (first.radius_mm, first.conic, first.asphere_mm) == (20.0, -0.5, (1e-6, -2e-9))
    assert (first.glass, first.thickness_mm, first.semi_diameter_mm) == ("SCHOTT/N-BK7", 2.0, 6.0)
    assert (second.radius_mm, second.medium, stop.stop, stop.radius_mm) == (-30.0, None, True, math.inf)
    assert (stop.glass.wavelengths_nm, stop.glass.values) == ((486.13, 587.56, 656.27), (1.63, 1.62, 1.615))
    assert last.medium is None
    held = report.conditions
    assert (held.wavelengths_nm, held.primary, held.image_mm) == ((587.56, 486.13, 656.27), 0, 30.0)
    assert [point.y for point in held.fields] == [0.0, 5.0]
    assert lens.name == "two; lenses"
    assert not [*report.of(Verdict.UNKNOWN), *report.of(Verdict.APPROXIMATED)]


def test_lengths_are_in_the_files_unit():
    inches = lens_of(LENS.replace("UNI 1.0", "UNI 25.4").replace("CC -0.5; AD 1e-6; AE -2e-9", ""))
    assert inches.surfaces[0].radius_mm == pytest.approx(508.0, rel=1e-15)
    assert inches.surfaces[0].thickness_mm == 50.8


def test_the_beam_of_a_near_object_has_its_radius_at_the_first_surface():
    near = (
        LENS.replace("TH 1e20", "TH 100.0")
        .replace("ANG 5.0", "OBH 10.0")
        .replace("AST", "")
        .replace("EBR 4.0", "EBR 3.0")
    )
    lens, report = read(FILE, near.splitlines())
    assert lens.surfaces[0].stop
    assert lens.stop_semi_diameter_mm or lens.surfaces[0].semi_diameter_mm == pytest.approx(3.0, rel=1e-12)
    assert (report.conditions.field_kind, report.conditions.object_mm) == ("object", 100.0)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("AIR; RD -30.0", "RFL; RD -30.0", "mirrors are not supported"),
        ("CC -0.5;", "TLA 2.0;", "the axis is not restored"),
        ("AIR; TH 1e20", "DCY 2.0; TH 300", "an object off the axis is not supported"),
        ("CC -0.5;", "TLA 2.0; TOZ 1.0; DCX 1.0; RCO;", "TOX, TOY and TOZ beside decentres are not supported"),
        ("CC -0.5;", "BEN;", "line 10: BEN: an axis that bends at a mirror is not supported"),
        ("CC -0.5;", "GC 1;", "line 10: GC 1: surfaces placed from any but the previous surface are not supported"),
        ("CC -0.5;", "RCO 3;", "RCO 3: a return to the axis of another surface is not supported"),
        ("CC -0.5;", "DT 2;", "DT 2: it must be 1, decentres first, or -1, tilts first"),
        ("CC -0.5;", "ASP ASX 4;", "aspheres of kind ASX are not supported; ADO, ASR and ARA are"),
        ("CC -0.5;", "AS6 1e-9;", "AS6 1e-9: AD to AG belong to ASP ADO and ASR"),
        ("CC -0.5; AD 1e-6; AE -2e-9", "ASP ARA; AD 1e-6", "AD 1e-6: AD to AG belong to ASP ADO and ASR"),
        ("CC -0.5; AD 1e-6; AE -2e-9", "ASP ARA; AS1 1e-3", "AS1 1e-3: a term in r makes a cone"),
        ("CC -0.5;", "ASP ASR; AS40 1e-9;", "AS40 1e-9: a term in r^80: aspheres reach up to"),
        ("CC -0.5;", "CVX 0.02; ASP ASR; AS1 1e-3;", "AS1 1e-3: a term in y² beside the curvature"),
        ("END 5", "END 2", "END 2: it counts 2 surfaces, but the file holds 5"),
        ("50 5", "50 7", "LEN NEW two; lenses 50 7: it counts 7 surfaces, but the file holds 5"),
        ("AP CHK 6.0", "AP CHK -6.0", "AP CHK -6.0: it must be 0, for the size that rays fill, or more"),
        ("AP CHK 6.0", "GTO 9", "GTO 9: there is no such surface; the last one is 1"),
        ("ANG 5.0", "ANG 90.0", "ANG 90.0: it must be below 90 degrees"),
        ("AST", "LMO NSS", "LMO NSS: non-sequential groups are not supported"),
        ("RD 60.0", "PFL 0", "surface 4: a paraxial lens without a focal length other than 0"),
        ("ANG 5.0", "WV5 0.5", "WV5 0.5: there are 3 wavelengths before it"),
        ("CC -0.5;", "PK CV 1 -1.0;", "pickups, whose values the file does not hold, are not supported"),
        ("RD 20.0", "RD twenty", "'twenty' is not a number"),
        ("TH 3.0;", "PY 0.0;", "a solve for a thickness that the file does not hold"),
        ("1.62 1.63 1.615", "1.62 1.63", "2 indices for 3 wavelengths"),
        ("ANG 5.0", "OBH 5.0", "give ANG for an object at infinity"),
        ("END 5\n", "", "cut short: it has no line END"),
        ("LEN NEW", "LENS", "not an OSLO lens file"),
        ("GLA N-BK7", "GLA K77", "'K77'"),
        ("GLA N-BK7", "GLA 0", "index 0: a refractive index must be above 0"),
    ],
)
def test_what_the_lens_cannot_have_is_refused_in_one_line(old, new, said):
    assert LENS.count(old) == 1
    with pytest.raises(SceneError) as raised:
        lens_of(LENS.replace(old, new))
    assert said in str(raised.value)
    assert "\n" not in str(raised.value)


def test_unknown_commands_are_named_and_zeros_bend_nothing():
    _, report = read(FILE, LENS.replace("CC -0.5;", "TLA 0.0; RCO; XYZ 3;").splitlines())
    assert [line.text for line in report.of(Verdict.UNKNOWN)] == ["XYZ 3"]


def test_commands_are_parted_by_semicolons_outside_quotes():
    assert commands('LEN NEW "a; b" 1 2; EBR 3 // the beam; RD 1') == [["LEN", "NEW", "a; b", "1", "2"], ["EBR", "3"]]


def changed(*pairs):
    text = LENS
    for old, new in pairs:
        assert text.count(old) == 1
        text = text.replace(old, new)
    return text


@pytest.mark.parametrize(
    ("command", "sag"),
    [
        ("ASP ASR 6; AS1 1e-3; AS6 1e-9", lambda r: 1e-3 * r**2 + 1e-9 * r**12),
        ("ASP ASR; AD 1e-5; AS3 1e-6", lambda r: 1e-5 * r**4 + 1e-6 * r**6),
        ("ASP ARA 5; AS2 1e-3; AS3 1e-4; AS5 1e-6", lambda r: 1e-3 * r**2 + 1e-4 * r**3 + 1e-6 * r**5),
        ("ASP ADO; AG 1e-8", lambda r: 1e-8 * r**10),
    ],
)
def test_general_aspheres_have_the_powers_of_their_kind(command, sag):
    lens = lens_of(changed(("RD 20.0", "RD 20.0; CC -1"), ("CC -0.5; AD 1e-6; AE -2e-9", command)))
    for r in (0.7, 2.0, 3.5):
        assert lens.surfaces[0].sag_mm(r) == pytest.approx(r**2 / 40.0 + sag(r), abs=1e-12)


def test_a_curvature_in_the_other_section_makes_a_toroid():
    toroid = lens_of(changed(("CC -0.5; AD 1e-6; AE -2e-9", "CVX 0.025; AD 1e-4"))).surfaces[0]
    along_y = 20.0 - math.sqrt(400.0 - 4.0) + 1e-4 * 16.0
    assert toroid.sag_at_mm(1.0, 2.0) == pytest.approx(40.0 - math.sqrt((40.0 - along_y) ** 2 - 1.0), abs=1e-12)
    by_radius = lens_of(changed(("CC -0.5; AD 1e-6; AE -2e-9", "RDX 40.0; AD 1e-4"))).surfaces[0]
    assert by_radius == toroid
    cylinder = lens_of(changed(("CC -0.5; AD 1e-6; AE -2e-9", "CVX 0"))).surfaces[0]
    assert cylinder.sag_at_mm(1.0, 2.0) == pytest.approx(20.0 - math.sqrt(400.0 - 4.0), abs=1e-12)


def euler(a, b, c, order):
    """The turn of tilts in degrees: left-handed about x and y, right-handed about z."""
    a, b, c = (math.radians(angle) for angle in (-a, -b, c))
    about_x = np.array([[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]])
    about_y = np.array([[math.cos(b), 0, math.sin(b)], [0, 1, 0], [-math.sin(b), 0, math.cos(b)]])
    about_z = np.array([[math.cos(c), -math.sin(c), 0], [math.sin(c), math.cos(c), 0], [0, 0, 1]])
    return about_x @ about_y @ about_z if order > 0 else about_z @ about_y @ about_x


@pytest.mark.parametrize("order", [1, -1])
def test_tilts_and_decentres_place_a_surface_that_rco_undoes(order):
    moved = f"DT {order}; DCX 0.1; DCY 0.2; DCZ 0.3; TLA 1; TLB 2; TLC 3; RCO; PY 0.0"
    lens = lens_of(changed(("RD 60.0; TH 30.0; PY 0.0", f"RD 60.0; TH 30.0; {moved}")))
    (element,) = lens.elements
    assert element.surfaces == (3,)
    pose = pose_of(lens, 3)
    turn = euler(1, 2, 3, order)
    shift = np.array([0.1, 0.2, 0.3]) if order > 0 else turn @ [0.1, 0.2, 0.3]
    np.testing.assert_allclose(pose[:, :3], turn, atol=1e-13)
    vertex = [0.0, 0.0, 2.0 + 3.0 + 2.0]
    at = np.array([0.0, 0.0, lens.vertices_mm[3]])
    np.testing.assert_allclose(pose[:, :3] @ at + pose[:, 3], shift + vertex, atol=1e-13)


def test_a_surface_turns_about_its_point():
    lens = lens_of(changed(("RD 60.0; TH 30.0; PY 0.0", "RD 60.0; TH 30.0; TLA 10; TOZ 5.0; RCO")))
    pose = pose_of(lens, 3)
    centre = np.array([0.0, 0.0, lens.vertices_mm[3] + 5.0])
    np.testing.assert_allclose(pose[:, :3] @ centre + pose[:, 3], [0.0, 0.0, 12.0], atol=1e-12)
    np.testing.assert_allclose(pose[:, :3], euler(10, 0, 0, 1), atol=1e-13)


def test_a_group_that_is_tilted_and_turned_back_is_one_element():
    first, second = "RD 20.0; TH 2.0", "AIR; RD -30.0; TH 3.0"
    back = "AIR; RD -30.0; TH -2.0; NXT; AIR; DT -1; TLA -3; DCY -1; TH 5.0"
    lens = lens_of(changed((first, f"DCY 1; TLA 3; {first}"), (second, back), ("50 5", "50 6"), ("END 5", "END 6")))
    (element,) = lens.elements
    assert (element.surfaces, element.pose.shift_mm) == ((0, 1), (0.0, 1.0, 0.0))
    assert element.pose.tilt_deg == pytest.approx((-3.0, 0.0, 0.0), abs=1e-12)
    assert lens.surfaces[1].thickness_mm == pytest.approx(3.0, abs=1e-12)


def test_gto_numbered_wavelengths_and_the_shift_of_focus_are_taken():
    plain = lens_of(LENS)
    text = changed(("RD 20.0;", "RD 99.0;"), ("AIR\nWW", "AIR; TH 0.5; GTO 1; RD 20.0; GTO 4\nNXT\nWV2 0.5\nWW"))
    lens, report = read(FILE, text.splitlines())
    assert lens.surfaces[0] == plain.surfaces[0]
    assert report.conditions.wavelengths_nm == (587.56, 500.0, 656.27)
    assert report.conditions.image_mm == 30.5


def test_points_of_the_field_are_shares_of_its_edge():
    points = "RST NEW\nF 1 -.5 .25 0 0 0 -.8 .9 -.9 .9 2\nF 2 1 0 0 0 0 -1 1 -1 1 0\nEND\n"
    _, report = read(FILE, (LENS + points).splitlines())
    first, last = report.conditions.fields
    slope = math.tan(math.radians(5.0))
    assert math.tan(math.radians(first.y)) == pytest.approx(-0.5 * slope, rel=1e-14)
    assert math.tan(math.radians(first.x)) == pytest.approx(0.25 * slope, rel=1e-14)
    assert (first.upper, first.lower, last.y) == (0.9, 0.8, 5.0)


def test_other_configurations_and_a_missing_aperture_are_said():
    more = "CFG NEW\nTH 1 2 8\nEND\nLEN NEW again 1 2\n"
    _, report = read(FILE, (LENS.replace("EBR 4.0\n", "").replace("AST", "AST; LMO ELE") + more).splitlines())
    assert [line.how for line in report.of(Verdict.APPROXIMATED)] == [
        "further configurations are not read; the surfaces are taken as they stand",
        "further lenses are not read; the surfaces are taken as they stand",
        "no aperture in the file: OSLO's own is taken, EBR 1",
    ]


@pytest.mark.parametrize(("command", "number"), [("FNO 4.0", 4.0), ("PUK -0.125", 4.0), ("EBR 9; FNO 4", 4.0)])
def test_the_last_aperture_counts(command, number):
    lens = lens_of(changed(("EBR 4.0", command)))
    assert lens.f_number == number


def test_apertures_stop_light_while_they_are_checked():
    drawn = lens_of(changed(("AP CHK 6.0", "AP 6.0")))
    assert lens_of(changed(("UNI 1.0", "UNI 1.0; APCK OFF"))) == drawn


def test_indices_behind_a_name_are_the_glass():
    glass = lens_of(changed(("GLA N-BK7", "GLA N-BK7 1.52,1.53,1.51"))).surfaces[0].glass
    assert glass.values == (1.53, 1.52, 1.51)
