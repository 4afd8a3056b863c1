"""IES files: symmetries, units of length, tilt, and one line for each thing that may be wrong."""

from pathlib import Path

import numpy as np
import pytest

from lfmesh.errors import FileError
from lfmesh.optics.light_profile import LightProfile, read_profile

HEAD = "IESNA:LM-63-1995\n[TEST]\nTILT=NONE\n"
EVEN = HEAD + "1 1000 1.5 2 1 1 2 0 0 0\n1 1 40\n0 180\n0\n7 7\n"
QUARTER = HEAD + "1 1000 1 3 3 1 2 0 0 0\n1 1 40\n0 45 90\n0 30 90\n4 3 2\n4 2 1\n4 1 0\n"


def read(folder: Path, text: str) -> LightProfile:
    (folder / "lamp.ies").write_text(text)
    return read_profile(folder / "lamp.ies")


def test_an_even_lamp_has_one_intensity(tmp_path: Path) -> None:
    """1 / 4π; from 0 to 90 degrees alone, twice as much."""
    np.testing.assert_allclose(read(tmp_path, EVEN).intensity, 1.0 / (4.0 * np.pi), rtol=1e-13)
    half = read(tmp_path, EVEN.replace("0 180", "0 90"))
    np.testing.assert_allclose(half.intensity, 1.0 / (2.0 * np.pi), rtol=1e-13)
    assert half.shares().sum() == pytest.approx(1.0, rel=1e-15)


def test_a_lamp_whose_angles_end_before_90_degrees_is_dark_beyond(tmp_path: Path) -> None:
    """Even up to 60 degrees: 1 / (2π (1 − cos 60°)) = 1 / π there."""
    profile = read(tmp_path, EVEN.replace("0 180", "0 60"))
    np.testing.assert_allclose(profile.intensity, 1.0 / np.pi, rtol=1e-13)
    directions = profile.at(np.deg2rad([0.0, 59.0, 61.0, 120.0]), np.zeros(4))
    np.testing.assert_allclose(directions, [1.0 / np.pi, 1.0 / np.pi, 0.0, 0.0], rtol=1e-13)


def test_the_integral_of_a_linear_intensity_has_its_closed_form(tmp_path: Path) -> None:
    """I falls from 1 to 0 over 0 to 90 degrees: 2π ∫ (1 − 2θ/π) sin θ dθ = 2π (1 − 2/π)."""
    profile = read(tmp_path, EVEN.replace("0 180", "0 90").replace("7 7", "7 0"))
    assert profile.intensity[0, 0] == pytest.approx(1.0 / (2.0 * np.pi * (1.0 - 2.0 / np.pi)), rel=1e-13)


def test_symmetric_files_are_mirrored_all_round(tmp_path: Path) -> None:
    quarter = read(tmp_path, QUARTER)
    assert np.rad2deg(quarter.horizontal) == pytest.approx([0, 30, 90, 150, 180, 210, 270, 330, 360])
    assert quarter.intensity[:, 1] / quarter.intensity[0, 1] * 3.0 == pytest.approx([3, 2, 1, 2, 3, 2, 1, 2, 3])
    half = read(tmp_path, QUARTER.replace("0 30 90\n", "0 30 180\n"))
    assert np.rad2deg(half.horizontal) == pytest.approx([0, 30, 180, 330, 360])
    assert half.intensity[:, 1] / half.intensity[0, 1] * 3.0 == pytest.approx([3, 2, 1, 2, 3])
    old = read(tmp_path, QUARTER.replace("0 30 90\n", "90 120 270\n"))
    assert np.rad2deg(old.horizontal) == pytest.approx([90, 120, 270, 420, 450])


def test_tilt_and_scale_do_not_change_the_shape(tmp_path: Path) -> None:
    plain = read(tmp_path, QUARTER)
    tilted = QUARTER.replace("TILT=NONE\n", "TILT=INCLUDE\n1\n3\n0 45 90\n1 0.9 0.8\n")
    for text in (
        tilted,
        QUARTER.replace("1000 1 3", "1000 2.5 3"),
        QUARTER.replace("0 30 90\n4 3 2", "0,30,90\n4,3,2"),
    ):
        np.testing.assert_array_equal(read(tmp_path, text).intensity, plain.intensity)


@pytest.mark.parametrize(
    ("text", "said"),
    {
        "no tilt": (QUARTER.replace("TILT=NONE\n", ""), "no line that begins with TILT="),
        "cut short": (QUARTER[:-4], "cut short: 28 numbers at least should follow TILT=, not 26"),
        "too long": (QUARTER + "5\n", "1 numbers follow the 9 intensities"),
        "a word": (QUARTER.replace("4 2 1", "4 two 1"), "line 9: 'two' is not a number"),
        "not finite": (QUARTER.replace("4 2 1", "4 inf 1"), "line 9: 'inf' is not finite"),
        "type B": (QUARTER.replace("3 3 1 2", "3 3 2 2"), "photometric type 2; only type C"),
        "angles out of order": (QUARTER.replace("0 45 90", "0 95 90"), "its vertical angles must increase"),
        "vertical range": (QUARTER.replace("0 45 90", "10 45 90"), "its vertical angles must increase from 0 or 90"),
        "horizontal range": (QUARTER.replace("0 30 90\n", "0 30 80\n"), "its horizontal angles must be 0 alone"),
        "open turn": (QUARTER.replace("0 30 90\n", "0 30 360\n"), "at 0 and at 360 degrees differ"),
        "negative": (QUARTER.replace("4 2 1", "4 -2 1"), "its intensities must be 0 or above"),
        "dark": (EVEN.replace("7 7", "0 0"), "its intensities must be 0 or above, and not all 0"),
        "half an angle": (QUARTER.replace("1 3 3 1", "1 3.5 3 1"), "its number of vertical angles is 3.5"),
    }.values(),
)
def test_what_is_wrong_with_a_file_is_said_in_one_line(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(FileError) as error:
        read(tmp_path, text)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"gone\.ies: cannot be read"):
        read_profile(tmp_path / "gone.ies")
