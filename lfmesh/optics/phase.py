"""Phase functions: the angular distribution of light scattered by a particle or medium.

A phase function p(μ), in 1/sr, depends on the cosine μ of the scattering angle (1: forward) and integrates to one over
the sphere. Light is unpolarised. `sampled_cosine` samples exactly the density that `evaluate_phase` returns, by closed
forms. A table is linear in μ between its nodes, so its integral is quadratic and inverted by a root.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.errors import FileError
from lfmesh.kernels.by_address import by_address
from lfmesh.kernels.decorators import kernel
from lfmesh.kernels.search import piece_with
from lfmesh.optics.number_table import read_table

Array = NDArray[np.float64]

ISOTROPIC, HENYEY_GREENSTEIN, RAYLEIGH, TABULATED = 0, 1, 2, 3

PHASE = np.dtype(
    [
        ("kind", "i8"),
        ("g", "f8"),  # HENYEY_GREENSTEIN: mean cosine
        ("first", "i8"),  # TABULATED: first node
        ("count", "i8"),  # and number of nodes
    ]
)


@by_address
class PhaseTables(NamedTuple):
    """Phase functions in the form that kernels read."""

    rows: NDArray[np.void]  # (phase functions, wavelengths) PHASE
    cosines: Array  # nodes of all tables, -1 to 1 within each
    values: Array  # 1/sr, at the nodes
    until: Array  # share of the light below each node


@dataclass(frozen=True, eq=False)
class PhaseFunction:
    """A phase function at one wavelength.

    Attributes
    ----------
    kind : int
    g : float
        Mean cosine, for Henyey-Greenstein.
    cosines : (n,) float64
        Cosines of a table, increasing from -1 to 1.
    values : (n,) float64, 1/sr
        Phase function at these cosines.
    """

    kind: int = ISOTROPIC
    g: float = 0.0
    cosines: Array = field(default_factory=lambda: np.zeros(0))
    values: Array = field(default_factory=lambda: np.zeros(0))

    @cached_property
    def mean_cosine(self) -> float:
        """Mean cosine of the scattering angle, the asymmetry parameter g."""
        if self.kind != TABULATED:
            return self.g
        a, b = self.cosines[:-1], self.cosines[1:]
        p, q = self.values[:-1], self.values[1:]
        return float(2.0 * np.pi * ((b - a) * (p * (2.0 * a + b) + q * (a + 2.0 * b)) / 6.0).sum())

    def at(self, cosine: ArrayLike) -> Array:
        """Return the phase function at cosines of the scattering angle, 1/sr."""
        cosine = np.asarray(cosine, dtype=np.float64)
        tables, found = phase_tables([[self]]), np.empty(cosine.size)
        evaluate_phases(tables, 0, cosine.ravel(), found)
        return found.reshape(cosine.shape)


def isotropic() -> PhaseFunction:
    """Return the phase function of isotropic scattering."""
    return PhaseFunction()


def henyey_greenstein(g: float) -> PhaseFunction:
    """Return the Henyey-Greenstein phase function (Astrophysical Journal 93, 70, 1941) of mean cosine g, |g| < 1."""
    if not -1.0 < g < 1.0:
        raise ValueError(f"g = {g!r}: it must lie between -1 and 1")
    return PhaseFunction(HENYEY_GREENSTEIN, float(g))


def rayleigh() -> PhaseFunction:
    """Return the phase function of spheres much smaller than the wavelength, 3 (1 + μ²) / (16 π)."""
    return PhaseFunction(RAYLEIGH)


def tabulated(cosines: ArrayLike, values: ArrayLike) -> PhaseFunction:
    """Return a phase function that is linear in the cosine between nodes, normalised to one.

    Parameters
    ----------
    cosines : (n,) array_like
        Increasing from -1 to 1.
    values : (n,) array_like
        In any unit, 0 or more, not all 0.
    """
    cosines, values = np.array(cosines, dtype=np.float64), np.array(values, dtype=np.float64)
    whole = np.pi * float((np.diff(cosines) * (values[:-1] + values[1:])).sum())
    return PhaseFunction(TABULATED, 0.0, cosines, values / whole)


def read_phase(path: Path) -> PhaseFunction:
    """Read a phase function from a CSV file.

    Parameters
    ----------
    path : Path
        CSV with the columns angle_deg, increasing from 0 to 180, and value, in any unit; linear in the cosine between
        its rows.

    Raises
    ------
    FileError
        The file cannot be read, or a number is missing or invalid.
    """
    angle, value = read_table(path, ("angle_deg", "value"))
    if len(angle) < 2 or angle[0] != 0.0 or angle[-1] != 180.0 or (np.diff(angle) <= 0.0).any():
        raise FileError(f"{path}: its angles must increase from 0 to 180 degrees")
    if not (np.isfinite(value).all() and (value >= 0.0).all() and value.any()):
        raise FileError(f"{path}: its values must be finite, 0 or more, and not all 0")
    cosines = np.cos(np.deg2rad(angle))
    cosines[-1] = -1.0
    if (np.diff(cosines) >= 0.0).any():
        raise FileError(f"{path}: two of its angles have the same cosine; omit one of them")
    return tabulated(cosines[::-1], value[::-1])


def phase_tables(functions: Sequence[Sequence[PhaseFunction]]) -> PhaseTables:
    """Return phase functions in the form that kernels read.

    Parameters
    ----------
    functions : (phase functions, wavelengths) sequence of PhaseFunction
        A function used at several wavelengths is stored once.
    """
    columns = len(functions[0]) if len(functions) else 0
    rows = np.zeros((len(functions), columns), PHASE)
    cosines, values, until = [np.zeros(0)], [np.zeros(0)], [np.zeros(0)]
    known: dict[int, int] = {}
    end = 0
    for row, of_wavelengths in zip(rows, functions, strict=True):
        for entry, function in zip(row, of_wavelengths, strict=True):
            entry["kind"], entry["g"], entry["count"] = function.kind, function.g, len(function.cosines)
            if function.kind != TABULATED:
                continue
            if id(function) not in known:
                known[id(function)] = end
                pieces = np.diff(function.cosines) * (function.values[:-1] + function.values[1:])
                sums = np.concatenate([[0.0], np.cumsum(pieces)])
                cosines.append(function.cosines)
                values.append(function.values)
                until.append(sums / sums[-1])
                end += len(function.cosines)
            entry["first"] = known[id(function)]
    return PhaseTables(rows, np.concatenate(cosines), np.concatenate(values), np.concatenate(until))


@kernel
def evaluate_phase(phases: PhaseTables, row: Any, cosine: float) -> float:
    """Return a phase function at a cosine of the scattering angle, 1/sr.

    Parameters
    ----------
    phases : PhaseTables
    row : PHASE
        `phases.rows[number, colour]`.
    cosine : float
        -1 to 1; 1 is forward.
    """
    if row.kind == ISOTROPIC:
        return 0.25 / np.pi
    if row.kind == RAYLEIGH:
        return 3.0 / (16.0 * np.pi) * (1.0 + cosine * cosine)
    if row.kind == HENYEY_GREENSTEIN:
        # From the distance to the peak: for |g| near 1 it is narrower than the digits of 1 + g² − 2gμ.
        g = abs(row.g)
        off = 1.0 - (cosine if row.g >= 0.0 else -cosine)
        square = (1.0 - g) * (1.0 - g) + 2.0 * g * off
        return 0.25 / np.pi * (1.0 - g) * (1.0 + g) / (square * np.sqrt(square))
    cosines = phases.cosines[row.first : row.first + row.count]
    i = piece_with(cosines, cosine)
    t = min(max((cosine - cosines[i]) / (cosines[i + 1] - cosines[i]), 0.0), 1.0)
    at = row.first + i
    return (1.0 - t) * phases.values[at] + t * phases.values[at + 1]


@kernel
def sampled_cosine(phases: PhaseTables, row: Any, u: float) -> float:
    """Sample a cosine from the phase function; it increases with u.

    Parameters
    ----------
    phases : PhaseTables
    row : PHASE
        `phases.rows[number, colour]`.
    u : float
        Uniform in [0, 1).
    """
    if row.kind == ISOTROPIC:
        return 2.0 * u - 1.0
    if row.kind == RAYLEIGH:
        # The real root of μ³ + 3μ = 8u − 4.
        return min(max(2.0 * np.sinh(np.arcsinh(4.0 * u - 2.0) / 3.0), -1.0), 1.0)
    if row.kind == HENYEY_GREENSTEIN:
        # The distance from the peak, in a form without cancellation at g = 0 and at |g| = 1.
        g = abs(row.g)
        v = u if row.g >= 0.0 else 1.0 - u
        t = (1.0 - g) + 2.0 * g * v
        off = 2.0 * (1.0 - v) * (1.0 + g * v) * ((1.0 - g) / t) * ((1.0 - g) / t)
        return 1.0 - off if row.g >= 0.0 else off - 1.0
    until = phases.until[row.first : row.first + row.count]
    i = piece_with(until, u)
    at = row.first + i
    low, high = phases.values[at], phases.values[at + 1]
    share = (u - until[i]) / (until[i + 1] - until[i]) if until[i + 1] > until[i] else 0.0
    # The root of low t + (high − low) t² / 2 = share (low + high) / 2, in the form that holds for any slope.
    root = np.sqrt(max(low * low + share * (high - low) * (high + low), 0.0))
    t = share * (low + high) / (low + root) if low + root > 0.0 else 0.0
    return phases.cosines[at] + min(t, 1.0) * (phases.cosines[at + 1] - phases.cosines[at])


@kernel
def evaluate_phases(phases: PhaseTables, colour: int, cosine: Array, found: Array) -> None:
    """Evaluate the first phase function in tables at one wavelength.

    Parameters
    ----------
    phases : PhaseTables
    colour : int
        Wavelength index.
    cosine : (n,) float64
        Cosines of the scattering angle.
    found : (n,) float64, 1/sr
        Filled with the results.
    """
    for k in range(len(cosine)):
        found[k] = evaluate_phase(phases, phases.rows[0, colour], cosine[k])
