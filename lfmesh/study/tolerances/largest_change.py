"""Inverse tolerances: the largest change of one number of a camera that keeps all limits of a study."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from lfmesh.study.metrics.metrics import Column
from lfmesh.study.sweeps.statistics import Estimate

PRECISION = 1e-4
"""Of the largest change, over the interval that is searched."""

STEP = 0.1
"""Share of the largest change over which a metric's derivative is taken."""

Means = Mapping[str, Estimate]
"""Mean of the pseudo-values of each limited column, and its standard error."""


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
        Its 95 % interval, from the standard error of the metric (Student).
    column : str
        The column that is at its limit; "" where none is: the number may change as far as was studied.
    """

    value: float
    low: float
    high: float
    column: str


def largest_change(
    search: Search,
    columns: Sequence[Column],
    reference: Means,
    measured: Callable[[float], Means],
    replicates: int,
) -> Allowed:
    """Find where the first limit is reached, by Brent's method on traced cameras.

    Parameters
    ----------
    search : Search
    columns : sequence of Column
        Those that have limits.
    reference : dict of Estimate
    measured : callable
        Given a value of the number, returns the means of the columns.
    replicates : int
        Behind each mean.
    """
    from scipy.optimize import brentq
    from scipy.stats import t as student

    room = {each.name: each.room(reference[each.name].value, search.limits[each.name]) for each in columns}
    broken = [name for name, left in room.items() if not left > 0.0]
    if broken:
        return Allowed(search.start, search.start, search.start, broken[0])

    known: dict[float, Means] = {}

    def margins(value: float) -> dict[str, float]:
        """Return how much of the reference's room is left in each column; −1 where a column is not known."""
        if value not in known:
            known[value] = measured(value)
        left = {e.name: e.room(known[value][e.name].value, search.limits[e.name]) / room[e.name] for e in columns}
        return {name: share if share == share else -1.0 for name, share in left.items()}

    far = min(margins(search.far).values())
    if far >= 0.0:
        return Allowed(search.far, search.far, search.far, "")
    reach = search.far - search.start
    value = float(
        brentq(
            lambda x: 1.0 if x == search.start else min(margins(x).values()),
            search.start,
            search.far,
            xtol=PRECISION * abs(reach),
        )
    )
    here = margins(value)
    column = next(each for each in columns if here[each.name] == min(here.values()))
    step = STEP * (value - search.start)
    slope = abs((here[column.name] - margins(value - step)[column.name]) / step) if step else 0.0
    error = column.room_error(known[value][column.name]) / room[column.name]
    width = float(student.ppf(0.975, max(replicates - 1, 1))) * error / slope if slope else abs(reach)
    width = min(width + PRECISION * abs(reach), abs(reach))
    # No smaller than no change, and no larger than what was studied.
    least, most = sorted((search.start, search.far))
    return Allowed(value, max(least, value - width), min(most, value + width), column.name)
