"""Inverse tolerances: the largest change of one number of a camera that keeps all limits of a study.

A camera whose limited columns are unknown neither keeps a limit nor breaks one. The search goes round it. Where it
cannot, it states the values between which the limit lies, and why no more is known.
"""

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from lfmesh.study.metrics.column import Column
from lfmesh.study.sweeps.statistics import Estimate

PRECISION = 1e-4
"""Of the largest change, over the interval that is searched."""

STEP = 0.1
"""Share of the largest change over which a metric's derivative is taken."""

DETOURS = (0.5, 0.25, 0.75, 0.375, 0.625, 0.125, 0.875)
"""Places in an interval, over its length, at which cameras are tried in turn where another one is not known."""

MOST_UNKNOWN = 16
"""Cameras not known after which a search ends."""

Means = Mapping[str, Estimate]
"""Mean of the pseudo-values of each limited column, and its standard error."""

Measured = Callable[[float], tuple[Means, str]]
"""Given a value of the number, returns the means of the columns, and in words why some are not known, or ""."""


@dataclass(frozen=True)
class Search:
    """An interval in which a number of the camera is changed until a limit is reached.

    Attributes
    ----------
    path : str
        Of the number.
    start, far : float
        What it is in the reference camera, and the farthest value that is studied on one side.
    limits : dict of float
        By the name of the column.
    """

    path: str
    start: float
    far: float
    limits: Mapping[str, float]


class Allowed(NamedTuple):
    """The farthest value of a number at which all limits are kept.

    Attributes
    ----------
    value : float
    low, high : float
        Its 95 % interval, from the standard error of the metric (Student) and from what is not known.
    column : str
        The column that is at its limit, or beyond it next to what is not known; "" where none is: the number may change
        as far as was studied, or as is known.
    unknown : str
        Why it is not known whether a camera between `value` and the farther end of the interval keeps the limits; ""
        where it is.
    """

    value: float
    low: float
    high: float
    column: str
    unknown: str = ""


def largest_change(
    search: Search, columns: Sequence[Column], reference: Means, measured: Measured, replicates: int
) -> Allowed:
    """Find where the first limit is reached, by Brent's method on traced cameras.

    Parameters
    ----------
    search : Search
    columns : sequence of Column
        Those that have limits.
    reference : dict of Estimate
    measured : callable
    replicates : int
        Behind each mean.
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
    """A camera's limited columns are not all known."""


class _Way:
    """The cameras that a search has measured, between the reference and the farthest one."""

    def __init__(
        self, search: Search, columns: Sequence[Column], reference: Means, measured: Measured, replicates: int
    ) -> None:
        self.search, self.columns, self.measured, self.replicates = search, columns, measured, replicates
        self.room = {each.name: each.room(reference[each.name].value, search.limits[each.name]) for each in columns}
        self.reach = search.far - search.start
        self.known: dict[float, Means] = {search.start: reference}
        self.unknown: dict[float, str] = {}

    def is_known(self, value: float) -> bool:
        """Measure a camera, unless it was, and tell whether its limited columns are known."""
        if value not in self.known and value not in self.unknown:
            means, why = self.measured(value)
            if all(each.knows(means[each.name]) for each in self.columns):
                self.known[value] = means
            else:
                self.unknown[value] = why
        return value in self.known

    def margins(self, value: float) -> dict[str, float]:
        """Return how much of the reference's room is left in each column."""
        if not self.is_known(value):
            raise _UnknownError
        means, limits = self.known[value], self.search.limits
        return {e.name: e.room(means[e.name].value, limits[e.name]) / self.room[e.name] for e in self.columns}

    def least(self, value: float) -> float:
        """Return the smallest of the margins."""
        return min(self.margins(value).values())

    def bracket(self) -> tuple[float, float | None]:
        """Return the nearest camera that breaks a limit, None without any, after the farthest before it that does not.

        Nearest and farthest are meant from the reference.
        """
        beyond = min((x for x in self.known if self.least(x) < 0.0), key=self._change, default=None)
        nearer = [x for x in self.known if beyond is None or self._change(x) < self._change(beyond)]
        return max(nearer, key=self._change), beyond

    def is_gone_round(self) -> bool:
        """Try cameras inside the bracket, and tell whether one of them is known."""
        kept, beyond = self.bracket()
        end = self.search.far if beyond is None else beyond
        for share in DETOURS:
            if len(self.unknown) >= MOST_UNKNOWN:
                return False
            if self.is_known(kept + share * (end - kept)):
                return True
        return False

    def at_limit(self, root: float) -> Allowed:
        """Return what a search has found that ends at a limit."""
        value = root if self.is_known(root) else min(self.known, key=lambda x: abs(x - root))
        width = min(self._width(value) + PRECISION * abs(self.reach), abs(self.reach))
        least, most = self._span(value - width, value + width)
        return Allowed(value, least, most, self._tightest(value).name)

    def left_open(self) -> Allowed:
        """Return what a search has found that ends where it cannot go round cameras that are not known."""
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
        """Return by how much more or less change a camera may reach the limit, by the 95 % interval of its margin."""
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
        """Return an interval, no nearer than no change and no farther than what was studied."""
        least, most = sorted((self.search.start, self.search.far))
        return max(least, low), min(most, high)
