"""Curves over wavelength: tables with linear interpolation, undefined outside."""

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.errors import FileError
from lfmesh.regular_file import read_text

Array = NDArray[np.float64]

SHORTEST_NM, LONGEST_NM = 100.0, 20000.0
"""Limits on the wavelengths of a scene."""


@dataclass(frozen=True, eq=False)
class Curve:
    """A quantity by wavelength.

    Attributes
    ----------
    wavelengths_nm : (n,) float64, nm
        Increasing, two or more.
    values : (n,) float64
        Not negative.
    """

    wavelengths_nm: Array
    values: Array

    @property
    def ends_nm(self) -> tuple[float, float]:
        """First and last wavelength, nm."""
        return float(self.wavelengths_nm[0]), float(self.wavelengths_nm[-1])

    def at(self, wavelength_nm: ArrayLike) -> Array:
        """Return the values at wavelengths within the table's range."""
        return np.asarray(np.interp(np.asarray(wavelength_nm), self.wavelengths_nm, self.values))

    def holds(self, first_nm: float, last_nm: float) -> bool:
        """Tell whether the table covers a range of wavelengths, within rounding."""
        first, last = self.ends_nm
        return first <= first_nm * (1.0 + 1e-9) and last_nm * (1.0 - 1e-9) <= last

    def integral(self, first_nm: float, last_nm: float) -> float:
        """Return the integral between two wavelengths, in nm times the unit of the values."""
        w = self.wavelengths_nm
        nodes = np.concatenate([[first_nm], w[(w > first_nm) & (w < last_nm)], [last_nm]])
        return float(np.trapezoid(self.at(nodes), nodes))

    def integrals(self, edges_nm: Array, other: "Curve | None" = None) -> Array:
        """Return the integrals of the curve, or of its product with another, over intervals, (n,).

        Parameters
        ----------
        edges_nm : (n + 1,) float64, nm
            Edges of the intervals, increasing, within the curve.
        other : Curve, optional
        """
        curves = (self,) if other is None else (self, other)
        knots = np.unique(np.concatenate([edges_nm, *(curve.wavelengths_nm for curve in curves)]))
        knots = knots[(knots >= edges_nm[0]) & (knots <= edges_nm[-1])]
        middle = 0.5 * (knots[1:] + knots[:-1])
        # A product of two straight pieces is a parabola, which Simpson's rule integrates exactly.
        first, half, last = (
            np.prod([curve.at(w) for curve in curves], axis=0) for w in (knots[:-1], middle, knots[1:])
        )
        pieces = np.diff(knots) * (first + 4.0 * half + last) / 6.0
        count = len(edges_nm) - 1
        interval = np.clip(np.searchsorted(edges_nm, middle, side="right") - 1, 0, count - 1)
        return np.bincount(interval, pieces, count).astype(np.float64)

    @cached_property
    def area_nm(self) -> float:
        """Integral of the whole curve, in nm times the unit of the values."""
        return float(self._cumulative[-1])

    @cached_property
    def centroid_nm(self) -> float:
        """Mean wavelength, weighted by the values, nm."""
        a, b = self.wavelengths_nm[:-1], self.wavelengths_nm[1:]
        p, q = self.values[:-1], self.values[1:]
        # The integral over an interval of w times a line.
        moments = (b - a) * (p * (2.0 * a + b) + q * (a + 2.0 * b)) / 6.0
        return float(moments.sum() / self.area_nm)

    @cached_property
    def _cumulative(self) -> Array:
        pieces = 0.5 * np.diff(self.wavelengths_nm) * (self.values[:-1] + self.values[1:])
        return np.concatenate([[0.0], np.cumsum(pieces)])

    def quantile_nm(self, share: ArrayLike) -> Array:
        """Return the wavelengths at fractions, in [0, 1], of the cumulative integral."""
        wanted = np.asarray(share, dtype=np.float64) * self.area_nm
        piece = np.clip(np.searchsorted(self._cumulative, wanted, side="right") - 1, 0, len(self.values) - 2)
        left, width = self.wavelengths_nm[piece], np.diff(self.wavelengths_nm)[piece]
        p, q = self.values[piece], self.values[piece + 1]
        rest = np.maximum(wanted - self._cumulative[piece], 0.0)
        # The root of p t + (q − p) t² / (2 width) = rest, in the form that holds for any slope.
        root = np.sqrt(np.maximum(p * p + 2.0 * rest * (q - p) / width, 0.0))
        t = np.divide(2.0 * rest, p + root, out=np.zeros_like(rest), where=p + root > 0.0)
        return np.asarray(left + np.clip(t, 0.0, width))


def gaussian(center_nm: float, fwhm_nm: float, first_nm: float, last_nm: float, pieces: int = 2048) -> Curve:
    """Return a Gaussian with a peak of 1 between two wavelengths, as a table.

    Parameters
    ----------
    center_nm, fwhm_nm : float, nm
        Peak wavelength, and full width at half maximum.
    first_nm, last_nm : float, nm
        Ends of the table.
    pieces : int
        Intervals; 2048 over three full widths give an error below 2e-6.
    """
    w = np.linspace(first_nm, last_nm, pieces + 1)
    return Curve(w, np.exp2(-((2.0 * (w - center_nm) / fwhm_nm) ** 2)))


def read_curve(path: Path, column: str, most: float = math.inf) -> Curve:
    """Read a curve from a CSV file.

    Parameters
    ----------
    path : Path
        CSV with the columns wavelength_nm and `column`, in either order, by increasing wavelength.
    column : str
        Name of the values.
    most : float
        Largest valid value.

    Raises
    ------
    FileError
        The file cannot be read, or a number is missing or invalid.
    """
    try:
        text = read_text(path)
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise FileError(f"{path}: byte {error.start} is not UTF-8; a table is UTF-8 text") from None
    names = ("wavelength_nm", column)
    try:
        rows = [row for row in csv.reader(text.splitlines()) if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise FileError(f"{path}: not CSV: {error}") from None
    head = [cell.strip() for cell in rows[0]] if rows else []
    if sorted(head) != sorted(names):
        raise FileError(f"{path}: its first line must name the columns {' and '.join(names)}")
    found: list[list[float]] = []
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != 2:
            raise FileError(f"{path}: row {number} has {len(row)} values; it must have 2")
        found.append([_number(row[head.index(name)]) for name in names])
    wavelengths, values = [pair[0] for pair in found], [pair[1] for pair in found]
    if why := curve_fault(wavelengths, values, most):
        raise FileError(f"{path}: {why}")
    return Curve(np.array(wavelengths), np.array(values))


def curve_fault(wavelengths_nm: Sequence[float], values: Sequence[float], most: float = math.inf) -> str | None:
    """Return the reason why a table is not a curve, or None if it is one.

    Parameters
    ----------
    wavelengths_nm, values : sequence of float
    most : float
        Largest valid value.
    """
    if len(wavelengths_nm) != len(values):
        return f"{len(wavelengths_nm)} wavelengths and {len(values)} values; each wavelength needs one value"
    if len(wavelengths_nm) < 2:
        return "a table needs two wavelengths or more"
    before = 0.0
    for wavelength, value in zip(wavelengths_nm, values, strict=True):
        if not SHORTEST_NM <= wavelength <= LONGEST_NM:
            return f"wavelength {wavelength:g} nm: wavelengths must lie between {SHORTEST_NM:g} and {LONGEST_NM:g} nm"
        if wavelength <= before:
            return f"wavelength {wavelength:g} nm after {before:g} nm: wavelengths must increase"
        before = wavelength
        if not (0.0 <= value <= most and math.isfinite(value)):
            limits = f"a number from 0 to {most:g}" if math.isfinite(most) else "a finite number, 0 or more"
            return f"value {value:g} at {wavelength:g} nm: it must be {limits}"
    return None


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan
