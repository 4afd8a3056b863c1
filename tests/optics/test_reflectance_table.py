"""Measured reflectance from a CSV file: what is between the points, and what is refused."""

import numpy as np
import pytest

from lfmesh.errors import FileError
from lfmesh.optics.reflectance_table import read_reflectance

ROWS = [(400, 0, 0.02), (400, 45, 0.05), (400, 90, 1.0), (600, 0, 0.01), (600, 45, 0.03), (600, 90, 1.0)]


def written(tmp_path, rows=ROWS, head="wavelength_nm,angle_deg,reflectance"):
    path = tmp_path / "r.csv"
    path.write_text("\n".join([head, *(",".join(str(value) for value in row) for row in rows)]) + "\n")
    return path


def test_points_of_the_file_are_met_and_wavelengths_are_joined_by_lines(tmp_path):
    table = read_reflectance(written(tmp_path))
    cosines = np.cos(np.radians([0.0, 45.0])), np.zeros(1)
    np.testing.assert_allclose(table.at(400.0, np.concatenate(cosines)), [0.02, 0.05, 1.0], rtol=1e-12)
    np.testing.assert_allclose(table.at(550.0, np.concatenate(cosines)), [0.0125, 0.035, 1.0], rtol=1e-12)


def test_between_the_angles_it_rises_without_overshoot(tmp_path):
    values = read_reflectance(written(tmp_path)).at(400.0, np.linspace(1.0, 0.0, 1000))
    assert (np.diff(values) >= 0.0).all()
    assert values.min() == pytest.approx(0.02, rel=1e-12)


def test_columns_and_rows_may_stand_in_any_order(tmp_path):
    mixed = [(r, w, a) for w, a, r in reversed(ROWS)]
    table = read_reflectance(written(tmp_path, mixed, " reflectance, wavelength_nm ,angle_deg"))
    same = read_reflectance(written(tmp_path))
    np.testing.assert_array_equal(table.reflectance, same.reflectance)
    np.testing.assert_array_equal(table.cosines, same.cosines)


WRONG = {
    "a gap": ([row for row in ROWS if row != (600, 45, 0.03)], "no reflectance for 600 nm at 45 degrees"),
    "twice": ([*ROWS, (600, 45, 0.04)], "600 nm at 45 degrees is given twice"),
    "not to grazing": (
        [row for row in ROWS if row[1] != 90],
        "must reach from 0 to 90 degrees; they reach from 0 to 45",
    ),
    "not from normal": ([row for row in ROWS if row[1] != 0], "must reach from 0 to 90 degrees; they reach from 45"),
    "grazing light passes": ([*ROWS[:-1], (600, 90, 0.9)], "600 nm at 90 degrees is 0.9"),
    "above one": (
        [*ROWS[:-2], (600, 45, 1.2), ROWS[-1]],
        "row 6: reflectance = '1.2'; it must be a number from 0 to 1",
    ),
    "negative": ([(400, 0, -0.1), *ROWS[1:]], "row 2: reflectance = '-0.1'"),
    "not a number": ([(400, 0, "nan"), *ROWS[1:]], "row 2: reflectance = 'nan'"),
    "an angle too wide": ([(400, 91, 0.1), *ROWS], "row 2: angle_deg = '91'; it must be a number from 0 to 90"),
    "a wavelength without end": (
        [("inf", 0, 0.1), *ROWS],
        "row 2: wavelength_nm = 'inf'; it must be a positive number",
    ),
    "wavelength zero": ([(0, 0, 0.1), *ROWS], "row 2: wavelength_nm = '0'; it must be a positive number"),
    "a cell missing": ([(400, 0), *ROWS[1:]], "row 2 has 2 values; it must have 3"),
    "a cell too many": ([(400, 0, 0.02, 7), *ROWS[1:]], "row 2 has 4 values"),
    "empty": ([], "must reach from 0 to 90 degrees"),
}


@pytest.mark.parametrize(("rows", "reason"), WRONG.values(), ids=WRONG)
def test_a_wrong_table_is_refused_in_one_line(tmp_path, rows, reason):
    path = written(tmp_path, rows)
    with pytest.raises(FileError) as refused:
        read_reflectance(path)
    assert str(refused.value).startswith(f"{path}: ")
    assert reason in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_table_without_its_columns_is_refused(tmp_path):
    with pytest.raises(FileError, match="must name the columns wavelength_nm, angle_deg, reflectance"):
        read_reflectance(written(tmp_path, head="nm,deg,R"))


def test_a_file_that_is_no_text_is_refused(tmp_path):
    (tmp_path / "r.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FileError, match="is not UTF-8"):
        read_reflectance(tmp_path / "r.csv")
    with pytest.raises(FileError, match="cannot be read"):
        read_reflectance(tmp_path / "none.csv")
