"""Configurations of Zemax files: the lens in each, against a file that holds its values in the surfaces."""

from pathlib import Path

import pytest

from lfmesh.errors import LensFileWarning, SceneError
from lfmesh.imports import read_lens
from lfmesh.imports.report import Verdict
from lfmesh.imports.zemax import read
from lfmesh.scene import loads
from lfmesh.scene.camera.lens import FileChoices
from tests.imports.files import SINGLET_ZMX

OPERANDS = """\
MNUM 2 1
MOFF 0 1 "" 0 0 0 1 1 0 0 0.0 "" 0
THIC   1   1 5 0 0 0 1 1 1 0 0
THIC   1   2 7.5 0 0 0 1 1 1 0 0
CRVT   2   1 -0.0125 0 0 0 1 1 1 0 0
CRVT   2   2 -0.015 0 0 0 1 1 1 0 0
CONN   2   1 -0.5 0 0 0 1 1 1 0 0
CONN   2   2 -0.25 0 0 0 1 1 1 0 0
GLSS   1   1 N-BK7 0 0 0 1 1 1 0 0
GLSS   1   2 N-SF11 0 0 0 1 1 1 0 0
SDIA   2   1 6.5 0 0 0 1 1 1 0 0
SDIA   2   2 6.5 0 0 0 1 1 1 0 0
APER   0   1 10 0 0 0 1 1 1 0 0
APER   0   2 8 0 0 0 1 1 1 0 0
YFIE   2   1 7 0 0 0 1 1 1 0 0
YFIE   2   2 5 0 0 0 1 1 1 0 0
WAVE   2   1 0.5875618 0 0 0 1 1 1 0 0
WAVE   2   2 0.6 0 0 0 1 1 1 0 0
"""

ZOOM = SINGLET_ZMX.replace("MNUM 1 1\n", OPERANDS)


def second_in_place() -> str:
    """Return the file whose surfaces hold the values of the second configuration."""
    text = SINGLET_ZMX
    for old, new in (
        ("DISZ 5\n", "DISZ 7.5\n"),
        ("CURV -0.0125", "CURV -0.015"),
        ("CONI -0.5", "CONI -0.25"),
        ("GLAS N-BK7 0 0 1.5168 64.17 0", "GLAS N-SF11 0 0 1.7847 25.68 0"),
        ("ENPD 10", "ENPD 8"),
        ("YFLN 0 7", "YFLN 0 5"),
        ("WAVM 2 0.5875618", "WAVM 2 0.6"),
    ):
        assert text.count(old) == 1
        text = text.replace(old, new)
    return text


def lens_and_report(text, configuration=None):
    return read(Path("zoom.zmx"), text.splitlines(), FileChoices(configuration=configuration))


def refusal_of(text, configuration):
    with pytest.raises(SceneError) as error:
        lens_and_report(text, configuration)
    return str(error.value)


def test_each_configuration_is_the_lens_whose_surfaces_hold_its_values():
    assert lens_and_report(ZOOM, 1)[0] == lens_and_report(SINGLET_ZMX)[0]
    lens, report = lens_and_report(ZOOM, 2)
    expected, of_expected = lens_and_report(second_in_place())
    assert lens == expected
    assert report.focal_length_mm == of_expected.focal_length_mm
    assert report.notes[:-1] == of_expected.notes
    assert not report.of(Verdict.APPROXIMATED)


def test_the_values_of_the_current_configuration_stand_in_the_surfaces():
    ending = OPERANDS.replace("MNUM 2 1", "MNUM 2 2")
    text = second_in_place().replace("MNUM 1 1\n", ending)
    assert lens_and_report(text, 1)[0] == lens_and_report(SINGLET_ZMX)[0]
    assert lens_and_report(text)[0] == lens_and_report(text, 2)[0] == lens_and_report(second_in_place())[0]


def test_a_file_with_several_says_which_is_taken_and_their_focal_lengths(tmp_path):
    _, report = lens_and_report(ZOOM)
    (line,) = report.of(Verdict.APPROXIMATED)
    assert line.how == "2 configurations: 1, whose values are in the surfaces, is taken"
    each = [lens_and_report(ZOOM, k)[1].focal_length_mm for k in (1, 2)]
    assert report.notes[-1] == f"focal lengths of the configurations: 1: {each[0]:.6g} mm, 2: {each[1]:.6g} mm"
    file = tmp_path / "zoom.zmx"
    file.write_text(ZOOM)
    with pytest.warns(LensFileWarning, match="2 configurations: 1, .* is taken"):
        read_lens(file)


def test_an_operand_that_is_not_supported_is_refused_where_it_differs_and_is_not_current():
    text = ZOOM + "PRAM 2 1 1e-6 0 2 0 1 1 1 0 0\nPRAM 2 2 2e-6 0 2 0 1 1 1 0 0\n"
    lens_and_report(text, 1)
    assert "PRAM" in refusal_of(text, 2)
    lens_and_report(text.replace("2e-6", "1e-6"), 2)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("THIC   1   2 7.5", "THIC   9   2 7.5", "there is no surface 9"),
        ("YFIE   2   2 5", "YFIE   8   2 5", "there is no field 8"),
        ("WAVE   2   2 0.6", "WAVE   8   2 0.6", "there is no wavelength 8"),
        ("THIC   1   2 7.5", "THIC   1   2 x", "'x' is not a number"),
        ("GLSS   1   2 N-SF11", "GLSS   1   2 MIRROR", "mirrors are not supported"),
        ("THIC   1   2 7.5 0 0 0 1 1 1 0 0\n", "", "no value for configuration 2"),
    ],
)
def test_a_value_that_cannot_be_taken_is_refused(old, new, words):
    assert ZOOM.count(old) == 1
    assert words in refusal_of(ZOOM.replace(old, new), 2)


@pytest.mark.parametrize(("text", "has"), [(ZOOM, "configurations 1 to 2"), (SINGLET_ZMX, "one configuration")])
def test_a_configuration_that_the_file_does_not_have_is_refused(text, has):
    assert refusal_of(text, 3) == f"zoom.zmx: configuration = 3: the file has {has}"


SCENE = """\
[camera]
focus_mm = 500.0
[camera.lens]
file = "zoom.zmx"
%s
[camera.sensor]
pixels = [8, 8]
pixel_mm = 0.1
[[targets]]
shape = { kind = "plane", width_mm = 94.0, height_mm = 94.0 }
position_mm = [0.0, 0.0, -500.0]
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "zoom.zmx").write_text(ZOOM.replace("GLAS N-BK7", "GLAS N-BK77"))
    (tmp_path / "lens.toml").write_text("surfaces = []\n")
    return tmp_path


def test_a_scene_chooses_the_configuration_and_the_glasses_of_its_lens_file(folder):
    with pytest.warns(LensFileWarning, match="N-BK77: SCHOTT/N-BK7 as asked for"):
        scene = loads(SCENE % 'substitutes = { N-BK77 = "SCHOTT/N-BK7" }\nconfiguration = 1', folder)
    assert scene.camera.lens.surfaces == lens_and_report(ZOOM, 1)[0].surfaces
    scene = loads(SCENE % "configuration = 2", folder)
    assert scene.camera.lens.surfaces == lens_and_report(ZOOM, 2)[0].surfaces


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ("configuration = 0", "configuration = 0"),
        ("configuration = 3", "configuration = 3: the file has configurations 1 to 2"),
        ('substitutes = { N-BK77 = "SCHOTT/N-BK77" }', "N-BK77"),
        ("substitutes = { N-BK77 = 0.5 }", "0.5"),
        ('substitutes = "BK77"', "substitutes"),
        ("configuration = 1", "'N-BK77'"),
    ],
)
def test_choices_that_cannot_be_are_refused_by_their_key(folder, keys, words):
    with pytest.raises(SceneError, match=words):
        loads(SCENE % keys, folder)


def test_choices_need_a_lens_file_of_another_program(folder):
    with pytest.raises(
        SceneError, match=r"configuration can be chosen for \.csv, \.json, \.len, \.seq, \.zmx files only"
    ):
        loads((SCENE % "configuration = 1").replace("zoom.zmx", "lens.toml"), folder)
    with pytest.raises(SceneError, match=r"camera\.lens\.configuration = 1: it selects from a lens file"):
        loads((SCENE % "configuration = 1").replace('file = "zoom.zmx"', "surfaces = []"), folder)
