"""Angular profiles of lamps, read from IES files (IES LM-63).

A file with a missing number or unordered angles is refused: a repaired profile would silently be wrong.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import FileError
from lfmesh.regular_file import read_text

Array = NDArray[np.float64]

TYPE_C = 1
"""Photometric type with vertical angles from the nadir and horizontal angles about it."""

MOST_NUMBERS = 1_000_000

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)


@dataclass(frozen=True)
class LightProfile:
    """Shape of a lamp's radiant intensity, linear in the angles between the file's.

    Attributes
    ----------
    vertical : (v,) float64, rad
        Angles from the nadir, increasing; dark outside.
    horizontal : (h,) float64, rad
        Angles about the nadir, counter-clockwise from above, increasing over a whole turn.
    intensity : (h, v) float64, 1/sr
        Intensity over the lamp's power.
    flux_lm : float
        Integral of the file's intensities.
    """

    vertical: Array
    horizontal: Array
    intensity: Array
    flux_lm: float

    def at(self, theta: Array, phi: Array) -> Array:
        """Return the intensity, 1/sr, at angles (n,) from the nadir and about it, within the profile's turn."""
        from scipy.interpolate import RegularGridInterpolator

        look_up = RegularGridInterpolator(
            (self.horizontal, self.vertical), self.intensity, bounds_error=False, fill_value=0.0
        )
        return np.asarray(look_up(np.column_stack([phi, theta])))

    def shares(self) -> Array:
        """Return the fraction of the power in each cell between neighbouring angles, (h − 1, v − 1)."""
        return _cell_integrals(self.vertical, self.horizontal, self.intensity)


def read_profile(path: Path) -> LightProfile:
    """Read an IES file of type C photometry, ignoring its absolute values and its lamp's tilt.

    Raises
    ------
    FileError
        The file cannot be read, a number is missing, surplus or out of range, or the photometric type is another one.
    """
    try:
        lines = read_text(path, errors="replace").splitlines()
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror}") from None
    tilt = next((i for i, line in enumerate(lines) if line.strip().upper().startswith("TILT=")), None)
    if tilt is None:
        raise FileError(f"{path}: has no line that begins with TILT=; an IES file (LM-63) has one before its numbers")
    numbers = _numbers(path, lines[tilt + 1 :], tilt + 2)
    if lines[tilt].strip().upper() == "TILT=INCLUDE":
        # Lamp's position in the luminaire, number of angles, angles, factors.
        count = _whole(path, _part(path, numbers, 1, 1)[0], "its number of tilt angles")
        numbers = numbers[2 + 2 * count :]
    head = _part(path, numbers, 0, 13)
    rows, columns = (_whole(path, head[i], f"its number of {name} angles") for i, name in _COUNTED)
    if head[5] != TYPE_C:
        raise FileError(f"{path}: photometric type {head[5]:g}; only type C, 1, can be read")
    if rows * columns > MOST_NUMBERS:
        raise FileError(f"{path}: {rows} x {columns} angles; at most {MOST_NUMBERS} are allowed in all")
    vertical, horizontal = _part(path, numbers, 13, rows), _part(path, numbers, 13 + rows, columns)
    candela = _part(path, numbers, 13 + rows + columns, rows * columns).reshape(columns, rows)
    further = len(numbers) - (13 + rows + columns + rows * columns)
    if further:
        raise FileError(f"{path}: {further} numbers follow the {rows * columns} intensities that it announces")
    # Files of spots may end before 90 degrees, where they are dark, although LM-63 requires zeros up to there.
    spans = vertical[0] in (0.0, 90.0) and vertical[-1] <= 180.0
    if rows < 2 or (np.diff(vertical) <= 0.0).any() or not spans:
        raise FileError(f"{path}: its vertical angles must increase from 0 or 90 up to 180 degrees at most")
    if (candela < 0.0).any() or not candela.any():
        raise FileError(f"{path}: its intensities must be 0 or above, and not all 0")
    horizontal, candela = _all_round(path, horizontal, candela)
    theta, phi = np.deg2rad(vertical), np.deg2rad(horizontal)
    flux = float(_cell_integrals(theta, phi, candela).sum())
    # Multiplier and ballast factor.
    return LightProfile(theta, phi, candela / flux, flux * float(head[2] * head[10]))


_COUNTED = ((3, "vertical"), (4, "horizontal"))


def _all_round(path: Path, horizontal: Array, candela: Array) -> tuple[Array, Array]:
    """Complete the horizontal angles and intensities to a whole turn, by the symmetry of the file."""
    if len(horizontal) == 1:
        return np.array([0.0, 360.0]), np.repeat(candela, 2, axis=0)
    span = horizontal[0], horizontal[-1]
    if (np.diff(horizontal) <= 0.0).any() or span not in ((0.0, 90.0), (0.0, 180.0), (0.0, 360.0), (90.0, 270.0)):
        raise FileError(
            f"{path}: its horizontal angles must be 0 alone, or increase from 0 to 90, 180 or 360 or from 90 to 270 "
            "degrees"
        )
    if span == (0.0, 360.0) and not np.array_equal(candela[0], candela[-1]):
        raise FileError(f"{path}: its intensities at 0 and at 360 degrees differ")
    while horizontal[-1] - horizontal[0] < 360.0:
        # Mirror at the last plane: a quarter to a half, a half to the whole.
        horizontal = np.concatenate([horizontal, 2.0 * horizontal[-1] - horizontal[-2::-1]])
        candela = np.concatenate([candela, candela[-2::-1]])
    return horizontal, candela


def _cell_integrals(vertical: Array, horizontal: Array, intensity: Array) -> Array:
    """Return the integrals of the bilinear intensity over the cells between angles, (h − 1, v − 1), W."""
    low, width = vertical[:-1, None], np.diff(vertical)[:, None]
    share = 0.5 * (_NODES + 1.0)
    ring = 0.5 * _WEIGHTS * width * np.sin(low + share * width)
    start, end = (ring * (1.0 - share)).sum(axis=1), (ring * share).sum(axis=1)
    along = intensity[:, :-1] * start + intensity[:, 1:] * end
    return np.asarray(0.5 * (along[:-1] + along[1:]) * np.diff(horizontal)[:, None])


def _numbers(path: Path, lines: list[str], first: int) -> Array:
    """Return all numbers in some lines, separated by blanks or commas."""
    values: list[float] = []
    for number, line in enumerate(lines, start=first):
        for word in line.replace(",", " ").split():
            try:
                value = float(word)
            except ValueError:
                raise FileError(f"{path}: line {number}: {word!r} is not a number") from None
            if not np.isfinite(value):
                raise FileError(f"{path}: line {number}: {word!r} is not finite")
            values.append(value)
    return np.array(values)


def _part(path: Path, numbers: Array, first: int, count: int) -> Array:
    """Return `count` numbers from index `first` on."""
    if first + count > len(numbers):
        raise FileError(f"{path}: cut short: {first + count} numbers at least should follow TILT=, not {len(numbers)}")
    return numbers[first : first + count]


def _whole(path: Path, value: float, what: str) -> int:
    """Return a count."""
    if value != int(value) or not 1 <= value <= MOST_NUMBERS:
        raise FileError(f"{path}: {what} is {value:g}; it must be a whole number of at least 1")
    return int(value)
