"""Error budget: contribution of each axis to a metric, from linear and quadratic sensitivities.

A metric is modelled as a sum of quadratic polynomials, one per axis, which is exact for small independent errors. Mean
squares, such as of displacements, add up; so do the squares of other metrics' changes.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lfmesh.study.metrics.column import ROUNDING, Column
from lfmesh.study.sweeps.axes import is_number
from lfmesh.study.sweeps.statistics import Estimate

if TYPE_CHECKING:
    from lfmesh.study.sweeps.table import Row, Table

Array = NDArray[np.float64]

LEVEL = 0.975
"""Level of Student's quantile for a 95 % interval."""


@dataclass(frozen=True)
class Effect:
    """Effect of one axis on a column.

    Attributes
    ----------
    axis : int
    linear, quadratic : Estimate
        Sensitivities of the mean of the pseudo-values, per unit and per unit squared; NaN: unknown.
    square : Estimate
        Mean square added by the axis over its values: of the quantity itself, or of its change.
    quantile : float
        Factor from a standard error to half a 95 % interval.
    """

    axis: int
    linear: Estimate
    quadratic: Estimate
    square: Estimate
    quantile: float

    @property
    def is_resolved(self) -> bool:
        """True if the effect differs significantly from zero."""
        return self.square.value > self.quantile * self.square.stderr

    def predicted(self, column: Column, start: Estimate, limit: float, far: float) -> float:
        """Return the change that reaches a limit, predicted from the sensitivities; infinite if it is never reached.

        Parameters
        ----------
        column : Column
        start : Estimate
            Mean of the reference's pseudo-values.
        limit : float
        far : float
            Farthest change studied, signed.
        """
        offset = start.value - column.mean_at(limit)
        roots = np.roots([self.quadratic.value, self.linear.value, offset])
        real = [float(root.real) for root in roots if abs(root.imag) < 1e-9 * abs(root) and root.real * far > 0.0]
        return min(real, key=abs, default=math.copysign(math.inf, far))


@dataclass(frozen=True)
class Budget:
    """Effects of all axes on a column, the largest first and unresolved ones last.

    Attributes
    ----------
    column : Column
    effects : tuple of Effect
    reason : str
        Reason if there are none, or "".
    drawn : float
        Mean square of the same quantity over the known cameras with all errors together.
    left_out : int
        Traced points with an unknown value.
    """

    column: Column
    effects: tuple[Effect, ...]
    reason: str = ""
    drawn: float = math.nan
    left_out: int = 0

    @property
    def square(self) -> float:
        """Sum of the mean squares of all effects."""
        return sum(max(each.square.value, 0.0) for each in self.effects)

    def share(self, effect: Effect) -> Estimate:
        """Return the fraction of the sum due to an effect."""
        total = self.square or math.nan
        return Estimate(max(effect.square.value, 0.0) / total, effect.square.stderr / total)

    def written(self, square: float) -> float:
        """Return a mean square in the unit of the column: its root, or its PSNR."""
        if self.column.of == "psnr":
            return -10.0 * math.log10(square) if square > 0.0 else math.nan
        return math.sqrt(max(square, 0.0))


def budget_of(table: "Table", column: Column) -> Budget:
    """Return the budget of a column over all numeric axes."""
    axes = [i for i, start in enumerate(table.plan.reference_values) if _varies(table, i, start)]
    if not axes:
        return Budget(column, (), "no axis of numbers varies")
    start = table.rows[0]
    if not start.knows(column):
        return Budget(column, (), f"{column.noun} is not known for the reference")
    alone = table.plan.study.design == "one_at_a_time"
    groups = [[i] for i in axes] if alone else [axes]
    effects: list[Effect] = []
    for group in groups:
        rows = table.along(group[0]) if alone else list(table.rows)
        rows = [row for row in rows if row.knows(column)]
        found = _fitted(table, column, group, rows)
        if found is None:
            what = f"{len(rows)} points" if not alone else f"{len(rows)} points of {table.plan.axes[group[0]].title}"
            return Budget(column, (), f"{what} are too few for linear and quadratic sensitivities")
        effects += found
    effects.sort(key=lambda each: (not each.is_resolved, -each.square.value))
    means = [row.means[column.name].value for row in table.drawn if row.knows(column)]
    off = np.array(means) - (0.0 if column.is_square else start.means[column.name].value)
    drawn = math.nan if alone or not means else float(off.mean() if column.is_square else (off**2).mean())
    left_out = sum(bool(row.means) and not row.knows(column) for row in table.rows)
    return Budget(column, tuple(effects), "", drawn, left_out)


def _varies(table: "Table", axis: int, start: object) -> bool:
    values = [table.value_of(row, axis) for row in table.rows if row.means]
    return is_number(start) and all(map(is_number, values)) and len(set(values)) > 1


def _offsets(table: "Table", axis: int, rows: "list[Row]") -> Array:
    start = float(table.plan.reference_values[axis])
    return np.array([float(table.value_of(row, axis)) - start for row in rows])


def _fitted(table: "Table", column: Column, axes: list[int], rows: "list[Row]") -> list[Effect] | None:
    """Fit a constant and two sensitivities per axis by least squares; None: too few points.

    Errors cover the standard errors of the points and any larger scatter about the polynomial. An axis with a single
    value has one sensitivity: quadratic for a mean square, otherwise linear.
    """
    from scipy.stats import t as student

    y = np.array([row.means[column.name].value for row in rows])
    noise = np.nan_to_num([row.means[column.name].stderr for row in rows])
    off = [_offsets(table, i, rows) for i in axes]
    scale = [float(np.abs(each).max()) or 1.0 for each in off]
    terms = [(k, power) for k, each in enumerate(off) for power in _powers(each, column)]
    design = np.column_stack([np.ones(len(rows)), *((off[k] / scale[k]) ** power for k, power in terms)])
    degrees = len(rows) - design.shape[1]
    if degrees < 0 or np.linalg.matrix_rank(design) < design.shape[1]:
        return None
    solve = np.linalg.pinv(design)
    fit = solve @ y
    # Anything that small compared with the values is rounding error.
    rounding = ROUNDING * float(np.abs(y).max())
    fit = np.where(np.abs(fit) > rounding, fit, 0.0)
    # Without spare points to show the scatter, only the points' own errors are known.
    scatter = float(((y - design @ fit) ** 2).sum()) / degrees if degrees else 0.0
    spread = np.maximum(scatter, noise**2)
    covariance = solve @ np.diag(np.where(spread > rounding**2, spread, 0.0)) @ solve.T
    quantile = float(student.ppf(LEVEL, degrees or table.plan.base.transport.replicates - 1))
    effects = []
    for k, axis in enumerate(axes):
        own = {power: n for n, (of, power) in enumerate(terms, start=1) if of == k}
        # Average over the axis's own values: in a study of one axis at a time it does not vary at other points.
        values = [row for row in table.drawn if row.point.values[axis] is not None]
        x = _offsets(table, axis, values) / scale[k]
        powers = np.array([[x**power for power in own]]).reshape(len(own), -1)
        places = list(own.values())
        change = fit[places] @ powers
        gradient = powers.mean(axis=1) if column.is_square else 2.0 * (powers * change).mean(axis=1)
        square = float(change.mean() if column.is_square else (change**2).mean())
        error = math.sqrt(float(gradient @ covariance[np.ix_(places, places)] @ gradient))
        linear, quadratic = (
            Estimate(float(fit[own[power]]), math.sqrt(covariance[own[power], own[power]])) if power in own
            else Estimate(0.0, 0.0)
            for power in (1, 2)
        )  # fmt: skip
        effects.append(
            Effect(axis, _over(linear, scale[k]), _over(quadratic, scale[k] ** 2), Estimate(square, error), quantile)
        )
    return effects


def _powers(off: Array, column: Column) -> tuple[int, ...]:
    """Return the degrees of an axis's sensitivities that its values determine."""
    values = len(set(off[off != 0.0].tolist()))
    return (1, 2) if values > 1 else ((2,) if column.is_square else (1,))


def _over(estimate: Estimate, unit: float) -> Estimate:
    return Estimate(estimate.value / unit, estimate.stderr / unit)
