"""Columns of a study's table: value and error from pseudo-values, and limits."""

import math
from typing import NamedTuple

from lfmesh.study.sweeps.statistics import Estimate

RESOLVED = 2.0
"""Distance from the border of the possible range, such as 0, that gives a value an error, in standard errors."""

RESOLVED_LOGARITHM = 4.0
"""The same for the logarithm of a mean square."""

IMPOSSIBLE = 4.0
"""Standard errors by which noise may push a value out of the possible range."""

ROUNDING = 1e-9
"""Relative amount by which an exact value may leave the possible range."""


class Column(NamedTuple):
    """A column of the table.

    Attributes
    ----------
    name : str
        Name, with its unit as a suffix.
    title : str
        Title in words, with the unit.
    of : str
        Function of the mean of its pseudo-values: "itself", "root", "psnr", or "chance" (itself, but zero may be by
        chance).
    magnitude : bool
        True for the size of a signed quantity; its derivative is by the size of an error.
    worse : str
        "low" or "high"; "" if neither.
    possible : (float, float)
        Possible range of the value.
    """

    name: str
    title: str
    of: str = "itself"
    magnitude: bool = False
    worse: str = ""
    possible: tuple[float, float] = (-math.inf, math.inf)

    @property
    def noun(self) -> str:
        """Title without its unit."""
        return self.title.rsplit(" / ", 1)[0]

    @property
    def unit(self) -> str:
        """Unit, after a space; "" without one."""
        return f" {self.title.rsplit(' / ', 1)[1]}" if " / " in self.title else ""

    @property
    def reach(self) -> tuple[float, float]:
        """Smallest and largest possible value."""
        return (max(self.possible[0], 0.0) if self.of == "root" else self.possible[0], self.possible[1])

    @property
    def is_square(self) -> bool:
        """True if the mean of the pseudo-values is a mean square, to which independent errors add."""
        return self.of in ("root", "psnr")

    def knows(self, mean: Estimate) -> bool:
        """Tell whether the column has a value at a mean of pseudo-values; a mean square of zero counts."""
        return not math.isnan(mean.value if self.is_square else self.estimate(mean).value)

    def estimate(self, mean: Estimate) -> Estimate:
        """Return the value and its standard error from the mean of the pseudo-values, by first-order propagation.

        An unknown value is NaN, such as the PSNR of identical pictures. An error is NaN for a root or logarithm of a
        mean square hardly above zero, and close to the border of the possible range.
        """
        value, error = mean
        if self.is_square:
            return self._of_square(value, error)
        low, high = self.possible
        slack = ROUNDING * abs(value)
        if low - slack <= value <= high + slack:
            unseen = self.of == "chance" and value == 0.0
            at_border = error > 0.0 and min(value - low, high - value) < RESOLVED * error
            return Estimate(min(max(value, low), high), math.nan if unseen or at_border else error)
        # A value outside the possible range by noise is put at its border; a value farther outside is wrong.
        near = low - IMPOSSIBLE * error <= value <= high + IMPOSSIBLE * error
        return Estimate(min(max(value, low), high) if near else math.nan, math.nan)

    def _of_square(self, square: float, error: float) -> Estimate:
        if self.of == "root":
            root = math.sqrt(max(square, 0.0))
            exact = square == error == 0.0
            return Estimate(root, error / (2.0 * root) if square > RESOLVED * error else 0.0 if exact else math.nan)
        if not square > 0.0:
            return Estimate(math.nan, math.nan)
        told = square > RESOLVED_LOGARITHM * error
        return Estimate(-10.0 * math.log10(square), 10.0 / math.log(10.0) * error / square if told else math.nan)

    def bound(self, mean: Estimate) -> float:
        """Return the worst value that a mean square allows, at `RESOLVED` standard errors."""
        worst = max(mean.value, 0.0) + RESOLVED * mean.stderr
        if self.of == "psnr":
            return -10.0 * math.log10(worst) if worst > 0.0 else math.nan
        return math.sqrt(worst)

    def mean_at(self, value: float) -> float:
        """Return the mean of the pseudo-values that corresponds to a value of the column."""
        return {"root": value * value, "psnr": 10.0 ** (-value / 10.0)}.get(self.of, value)

    def keeps(self, mean: float, limit: float) -> bool:
        """Tell whether a known mean of pseudo-values keeps a limit of the column."""
        return self.room(mean, limit) >= 0.0

    def harm(self, mean: float) -> float:
        """Return a mean of pseudo-values, signed so that more is worse."""
        return -mean if self.worse == "low" and not self.is_square else mean

    def room(self, mean: float, limit: float) -> float:
        """Return the distance of a mean of pseudo-values from a limit; negative beyond it.

        Mean squares are compared by their roots, proportional to small errors.

        Parameters
        ----------
        mean : float
            Mean of pseudo-values.
        limit : float
            Limit of the column.
        """
        most = self.mean_at(limit)
        if self.is_square:
            return math.sqrt(most) - (math.sqrt(max(mean, 0.0)) if mean == mean else math.nan)
        return mean - most if self.worse == "low" else most - mean

    def room_error(self, mean: Estimate) -> float:
        """Return the standard error of `room` at a nonzero mean of pseudo-values."""
        return mean.stderr / (2.0 * math.sqrt(mean.value)) if self.is_square else mean.stderr
