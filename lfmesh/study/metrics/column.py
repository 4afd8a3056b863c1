"""Columns of the table of a study: their value and error from pseudo-values, and their limits."""

import math
from typing import NamedTuple

from lfmesh.study.sweeps.statistics import Estimate

RESOLVED = 2.0
"""Standard errors by which a value has to differ from the border of what is possible, such as 0, to have an error."""

RESOLVED_LOGARITHM = 4.0
"""The same for a mean square whose logarithm has an error."""

IMPOSSIBLE = 4.0
"""Standard errors by which noise may bring a value beyond what is possible."""

ROUNDING = 1e-9
"""By this share a value may be beyond what is possible and still be exact."""


class Column(NamedTuple):
    """A column of the table.

    Attributes
    ----------
    name : str
        With its unit as a suffix.
    title : str
        In words, with the unit.
    of : str
        How it follows from the mean of its pseudo-values: "itself", "root", "psnr", or "chance": itself, and where it
        is zero chance has shown none, which does not tell how much there is.
    magnitude : bool
        Whether it is the size of something that may have a sign: its derivative is by the size of an error.
    worse : str
        "low" or "high", or "": neither.
    possible : (float, float)
        Range of what the value can be.
    """

    name: str
    title: str
    of: str = "itself"
    magnitude: bool = False
    worse: str = ""
    possible: tuple[float, float] = (-math.inf, math.inf)

    @property
    def noun(self) -> str:
        """The title without its unit."""
        return self.title.rsplit(" / ", 1)[0]

    @property
    def unit(self) -> str:
        """The unit, after a space; "" where the column has none."""
        return f" {self.title.rsplit(' / ', 1)[1]}" if " / " in self.title else ""

    @property
    def reach(self) -> tuple[float, float]:
        """Least and largest value that the column can have."""
        return (max(self.possible[0], 0.0) if self.of == "root" else self.possible[0], self.possible[1])

    @property
    def is_square(self) -> bool:
        """True if the mean of the pseudo-values is a mean square, to which independent errors add."""
        return self.of in ("root", "psnr")

    def knows(self, mean: Estimate) -> bool:
        """Tell whether the column has a value at a mean of pseudo-values; mean squares of nothing are known, too."""
        return not math.isnan(mean.value if self.is_square else self.estimate(mean).value)

    def estimate(self, mean: Estimate) -> Estimate:
        """Return the value and its standard error from the mean of the pseudo-values, by first-order propagation.

        NaN where the value is not known, such as the PSNR of pictures that do not differ. The error is NaN where it
        cannot be told: of the root or the logarithm of a mean square that is hardly told from zero, and of a value that
        is hardly told from the border of what is possible.
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
        # Beyond what is possible by noise, it is at the border; by more, it is wrong.
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
        """Return the value that is as bad as a mean square leaves possible, by `RESOLVED` standard errors."""
        worst = max(mean.value, 0.0) + RESOLVED * mean.stderr
        if self.of == "psnr":
            return -10.0 * math.log10(worst) if worst > 0.0 else math.nan
        return math.sqrt(worst)

    def mean_at(self, value: float) -> float:
        """Return the mean of the pseudo-values at which the column has a value."""
        return {"root": value * value, "psnr": 10.0 ** (-value / 10.0)}.get(self.of, value)

    def keeps(self, mean: float, limit: float) -> bool:
        """Tell whether a mean of pseudo-values, which is known, keeps a limit of the column."""
        return self.room(mean, limit) >= 0.0

    def harm(self, mean: float) -> float:
        """Return a mean of pseudo-values with the sign by which more is worse."""
        return -mean if self.worse == "low" and not self.is_square else mean

    def room(self, mean: float, limit: float) -> float:
        """Return how far a mean of pseudo-values is from a limit, below 0 beyond it.

        Mean squares are compared by their roots, which go with the size of a small error.

        Parameters
        ----------
        mean : float
            Of pseudo-values.
        limit : float
            Of the column.
        """
        most = self.mean_at(limit)
        if self.is_square:
            return math.sqrt(most) - (math.sqrt(max(mean, 0.0)) if mean == mean else math.nan)
        return mean - most if self.worse == "low" else most - mean

    def room_error(self, mean: Estimate) -> float:
        """Return the standard error of `room` at a mean of pseudo-values that is not zero."""
        return mean.stderr / (2.0 * math.sqrt(mean.value)) if self.is_square else mean.stderr
