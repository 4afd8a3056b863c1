"""OSLO's lens files: surfaces, media and conditions as they stand, what is not read named or refused."""

import math
from pathlib import Path

import pytest

from lfmesh.errors import SceneError
from lfmesh.imports.oslo import commands, read
from lfmesh.imports.report import Verdict

FILE = Path("lens.len")
LENS = """\
// OSLO 6.6
LEN NEW "two; lenses" 50 4
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
        ("CC -0.5;", "TLA 2.0;", "line 10: TLA 2.0: tilted and decentred axes are not supported"),
        ("CC -0.5;", "ASP ASR 4;", "aspheres but AD to AG, and gratings, are not supported"),
        ("CC -0.5;", "PK CV 1 -1.0;", "pickups, whose values the file does not hold, are not supported"),
        ("RD 20.0", "RD twenty", "'twenty' is no number"),
        ("TH 3.0;", "PY 0.0;", "a solve for a thickness that the file does not hold"),
        ("1.62 1.63 1.615", "1.62 1.63", "2 indices for 3 wavelengths"),
        ("ANG 5.0", "OBH 5.0", "of an object at infinity give ANG"),
        ("END 5\n", "", "cut short: it has no line END"),
        ("LEN NEW", "LENS", "no OSLO lens file"),
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
    _, report = read(FILE, LENS.replace("CC -0.5;", "TLA 0.0; XYZ 3;").splitlines())
    assert [line.text for line in report.of(Verdict.UNKNOWN)] == ["XYZ 3"]


def test_commands_are_parted_by_semicolons_outside_quotes():
    assert commands('LEN NEW "a; b" 1 2; EBR 3 // the beam; RD 1') == [["LEN", "NEW", "a; b", "1", "2"], ["EBR", "3"]]
