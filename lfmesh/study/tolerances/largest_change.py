"""Inverse tolerancing: the largest change of one number of a camera within all limits of a study.

A camera with unknown limited columns neither keeps nor breaks a limit; the search goes round it. If it cannot, the
result gives the values between which the limit lies, and the reason.
"""

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from lfmesh.study.metrics.column import Column
from lfmesh.study.sweeps.statistics import Estimate

PRECISION = 1e-4
"""Precision of the largest change, as a fraction of the search interval."""

STEP = 0.1
"""Difference for a metric's derivative, as a fraction of the largest change."""

DETOURS = (0.5, 0.25, 0.75, 0.375, 0.625, 0.125, 0.875)
"""Fractions of an interval at which cameras are tried in turn after an unknown one."""

MOST_UNKNOWN = 16
"""Number of unknown cameras that ends a search."""

Means = Mapping[str, Estimate]
"""Mean of the pseudo-values of each limited column, with its standard error."""

Measured = Callable[[float], tuple[Means, str]]
"""Function of the number's value: returns the means of the columns, and why some are unknown, or ""."""


@dataclass(frozen=True)
class Search:
    """Interval in which a number of the camera is changed until it reaches a limit.

    Attributes
    ----------
    path : str
        Path of the number.
    start, far : float
        Value in the reference camera, and farthest value studied on one side.
    limits : dict of float
        Limits by column.
    """

    path: str
    start: float
    far: float
    limits: Mapping[str, float]


class Allowed(NamedTuple):
    """Farthest value of a number that keeps all limits.

    Attributes
    ----------
    value : float
    low, high : float
        95 % interval, from the standard error of the metric (Student) and from unknown cameras.
    column : str
        Column at its limit, or beyond it after unknown cameras; "" if the whole range studied, or known, is allowed.
    unknown : str
        Reason why cameras between `value` and the farther end of the interval are undecided, or "".
    """

    value: float
    low: float
    high: float
    column: str
    unknown: str = ""


def largest_change(
    search: Search, columns: Sequence[Column], reference: Means, measured: Measured, replicates: int
) -> Allowed:
    """Find the change that first reaches a limit, by Brent's method on traced cameras.

    Parameters
    ----------
    search : Search
    columns : sequence of Column
        Columns with limits.
    reference : dict of Estimate
    measured : callable
    replicates : int
        Number behind each mean.
    """
    from scipy.optimize import brentq

    way = _Way(search, columns, reference, measured, replicates)
    broken = [name for name, left in way.room.items() if not left > 0.0]
    if broken:
        return Allowed(search.start, search.start, search.start, broken[0])
    if way.is_known(search.far) and way.least(search.far) >= 0.0:
        return Allowed(search.far, search.far, search.far, "")
    while True:
        kept, beyond = way.bracket()
        if beyond is not None:
            with contextlib.suppress(_UnknownError):
                return way.at_limit(float(brentq(way.least, kept, beyond, xtol=PRECISION * abs(way.reach))))
        if not way.is_gone_round():
            return way.left_open()


class _UnknownError(Exception):
    """Not all limited columns of a camera are known."""


class _Way:
    """Cameras measured by a search, between the reference and the farthest one."""

    def __init__(
        self, search: Search, columns: Sequence[Column], reference: Means, measured: Measured, replicates: int
    ) -> None:
        self.search, self.columns, self.measured, self.replicates = search, columns, measured, replicates
        self.room = {each.name: each.room(reference[each.name].value, search.limits[each.name]) for each in columns}
        self.reach = search.far - search.start
        self.known: dict[float, Means] = {search.start: reference}
        self.unknown: dict[float, str] = {}

    def is_known(self, value: float) -> bool:
        """Measure a camera if necessary, and tell whether its limited columns are known."""
        if value not in self.known and value not in self.unknown:
            means, why = self.measured(value)
            if all(each.knows(means[each.name]) for each in self.columns):
                self.known[value] = means
            else:
                self.unknown[value] = why
        return value in self.known

    def margins(self, value: float) -> dict[str, float]:
        """Return the remaining fraction of the reference's room in each column."""
        if not self.is_known(value):
            raise _UnknownError
        means, limits = self.known[value], self.search.limits
        return {e.name: e.room(means[e.name].value, limits[e.name]) / self.room[e.name] for e in self.columns}

    def least(self, value: float) -> float:
        """Return the smallest margin."""
        return min(self.margins(value).values())

    def bracket(self) -> tuple[float, float | None]:
        """Return the farthest camera that keeps the limits before the nearest that breaks one, and the latter or None.

        Distances are from the reference.
        """
        beyond = min((x for x in self.known if self.least(x) < 0.0), key=self._change, default=None)
        nearer = [x for x in self.known if beyond is None or self._change(x) < self._change(beyond)]
        return max(nearer, key=self._change), beyond

    def is_gone_round(self) -> bool:
        """Try cameras inside the bracket; tell whether a known one was found."""
        kept, beyond = self.bracket()
        end = self.search.far if beyond is None else beyond
        for share in DETOURS:
            if len(self.unknown) >= MOST_UNKNOWN:
                return False
            if self.is_known(kept + share * (end - kept)):
                return True
        return False

    def at_limit(self, root: float) -> Allowed:
        """Return the result of a search that ends at a limit."""
        value = root if self.is_known(root) else min(self.known, key=lambda x: abs(x - root))
        width = min(self._width(value) + PRECISION * abs(self.reach), abs(self.reach))
        least, most = self._span(value - width, value + width)
        return Allowed(value, least, most, self._tightest(value).name)

    def left_open(self) -> Allowed:
        """Return the result of a search that cannot go round unknown cameras."""
        kept, beyond = self.bracket()
        end = self.search.far if beyond is None else beyond
        low, high = sorted((kept, end))
        why = next(why for x, why in self.unknown.items() if low <= x <= high)
        back = 0.0 if kept == self.search.start else self._width(kept)
        on = 0.0 if beyond is None else self._width(beyond)
        before, after = (back, on) if self.reach > 0.0 else (on, back)
        column = "" if beyond is None else self._tightest(beyond).name
        return Allowed(kept, *self._span(low - before, high + after), column, why)

    def _change(self, value: float) -> float:
        return abs(value - self.search.start)

    def _tightest(self, value: float) -> Column:
        margins = self.margins(value)
        return min(self.columns, key=lambda each: margins[each.name])

    def _width(self, value: float) -> float:
        """Return the uncertainty of the change at the limit, from the 95 % interval of a camera's margin."""
        from scipy.stats import t as student

        column = self._tightest(value)
        other = value - STEP * (value - self.search.start)
        if not self.is_known(other):
            other = min((x for x in self.known if x != value), key=lambda x: abs(x - other))
        margin = self.margins(value)[column.name]
        error = column.room_error(self.known[value][column.name]) / self.room[column.name]
        doubt = float(student.ppf(0.975, max(self.replicates - 1, 1))) * error - abs(margin)
        if not doubt > 0.0:
            return 0.0
        fall = abs(margin - self.margins(other)[column.name])
        return doubt * abs(value - other) / fall if fall else abs(self.reach)

    def _span(self, low: float, high: float) -> tuple[float, float]:
        """Clip an interval to the range from no change to the farthest studied."""
        least, most = sorted((self.search.start, self.search.far))
        return max(least, low), min(most, high)
