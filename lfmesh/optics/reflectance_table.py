"""Measured reflectance of a coating by wavelength and angle, read from a CSV file."""

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import FileError
from lfmesh.regular_file import read_text

Array = NDArray[np.float64]

COLUMNS = ("wavelength_nm", "angle_deg", "reflectance")


@dataclass(frozen=True)
class ReflectanceTable:
    """Reflectance by wavelength and angle, both increasing.

    Attributes
    ----------
    wavelengths_nm : (w,) float64
    cosines : (a,) float64
        Cosines of the angles from 90 to 0 degrees.
    reflectance : (w, a) float64
    """

    wavelengths_nm: Array
    cosines: Array
    reflectance: Array

    @classmethod
    def of(
        cls, wavelengths_nm: Sequence[float], angles_deg: Sequence[float], reflectance: Sequence[Sequence[float]]
    ) -> "ReflectanceTable":
        """Return a table of reflectances.

        Parameters
        ----------
        wavelengths_nm, angles_deg : sequence of float
            Increasing; angles from 0 to 90 degrees.
        reflectance : sequence of sequence of float
            One row per wavelength, one value per angle.
        """
        cosines = np.cos(np.radians(angles_deg))[::-1]
        cosines[0] = 0.0
        return cls(np.array(wavelengths_nm), cosines, np.array(reflectance)[:, ::-1])

    def at(self, wavelength_nm: float, cosine: Array) -> Array:
        """Return the reflectance at a wavelength within the table, by cosine, 0 to 1.

        Linear in wavelength; monotone cubic in the cosine (Fritsch and Carlson, SIAM Journal on Numerical Analysis 17,
        1980), without overshoot.
        """
        from scipy.interpolate import PchipInterpolator

        column = [np.interp(wavelength_nm, self.wavelengths_nm, values) for values in self.reflectance.T]
        return np.clip(PchipInterpolator(self.cosines, column)(cosine), 0.0, 1.0)


def read_reflectance(path: Path) -> ReflectanceTable:
    """Read a table of reflectance.

    Parameters
    ----------
    path : Path
        CSV with the columns wavelength_nm, angle_deg and reflectance, in any order of columns and rows. The angles, the
        same at every wavelength, range from 0 to 90 degrees, where the reflectance is 1.

    Raises
    ------
    FileError
        The file cannot be read, or a number or angle is missing or out of range.
    """
    try:
        text = read_text(path)
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise FileError(f"{path}: byte {error.start} is not UTF-8; a table of reflectance is UTF-8 text") from None
    try:
        rows = [row for row in csv.reader(text.splitlines()) if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise FileError(f"{path}: not CSV: {error}") from None
    head = [cell.strip() for cell in rows[0]] if rows else []
    if sorted(head) != sorted(COLUMNS):
        raise FileError(f"{path}: its first line must name the columns {', '.join(COLUMNS)}")
    values: dict[tuple[float, float], float] = {}
    for number, row in enumerate(rows[1:], start=2):
        wavelength, angle, reflectance = _numbers(path, number, head, row)
        if (wavelength, angle) in values:
            raise FileError(f"{path}: row {number}: {wavelength:g} nm at {angle:g} degrees is given twice")
        values[wavelength, angle] = reflectance
    wavelengths, angles = sorted({w for w, _ in values}), sorted({a for _, a in values}, reverse=True)
    if not values or angles[0] != 90.0 or angles[-1] != 0.0:
        reach = f"they reach from {angles[-1]:g} to {angles[0]:g}; " if values else ""
        raise FileError(
            f"{path}: its angles must reach from 0 to 90 degrees; {reach}at 90 degrees every surface reflects 1"
        )
    for wavelength in wavelengths:
        for angle in angles:
            if (wavelength, angle) not in values:
                raise FileError(f"{path}: there is no reflectance for {wavelength:g} nm at {angle:g} degrees")
        if values[wavelength, 90.0] != 1.0:
            raise FileError(
                f"{path}: the reflectance for {wavelength:g} nm at 90 degrees is {values[wavelength, 90.0]:g}; there "
                "every surface reflects 1"
            )
    return ReflectanceTable.of(wavelengths, angles[::-1], [[values[w, a] for a in angles[::-1]] for w in wavelengths])


def _numbers(path: Path, number: int, head: list[str], row: list[str]) -> tuple[float, float, float]:
    """Return wavelength, angle and reflectance of a row."""
    if len(row) != len(head):
        raise FileError(f"{path}: row {number} has {len(row)} values; it must have {len(head)}")
    found = dict(zip(head, row, strict=True))
    numbers = []
    for column, most in zip(COLUMNS, (math.inf, 90.0, 1.0), strict=True):
        cell = found[column].strip()
        try:
            value = float(cell)
        except ValueError:
            value = math.nan
        is_wavelength = column == "wavelength_nm"
        if not (0.0 <= value <= most and math.isfinite(value)) or (is_wavelength and value == 0.0):
            limits = "a positive number" if is_wavelength else f"a number from 0 to {most:g}"
            raise FileError(f"{path}: row {number}: {column} = {cell!r}; it must be {limits}")
        numbers.append(value)
    return numbers[0], numbers[1], numbers[2]
