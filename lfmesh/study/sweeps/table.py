"""Table of a study: one row per point, and results derived from the rows."""

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError, PictureWarning, in_order, summed_up
from lfmesh.study.metrics.column import Column
from lfmesh.study.metrics.metrics import columns_of
from lfmesh.study.sweeps.axes import is_number
from lfmesh.study.sweeps.bench import OnTheWay, in_words
from lfmesh.study.sweeps.plan import Plan, Point
from lfmesh.study.sweeps.statistics import Estimate, Share, Slope, combined, share_of, slope
from lfmesh.study.sweeps.unit import Outcome
from lfmesh.study.tolerances.largest_change import Allowed

Array = NDArray[np.float64]

CONFIDENCE = "95 %"
"""Level of all intervals."""

DOUBT = 1.96
"""Standard errors within which it is undecided whether a camera keeps a limit."""


@dataclass(frozen=True)
class Row:
    """A point and its metrics.

    Attributes
    ----------
    point : Point
    means : dict of Estimate
        Means of the pseudo-values by column; empty for a point that failed or is not done.
    estimates : dict of Estimate
        Values derived from the means.
    fault : str
        Reason if there are none, or "".
    unknown : dict of str
        Reasons for unknown metrics, by name.
    on_the_way : dict of OnTheWay
        Metrics unknown for cameras that a search or an adjustment traced, by name.
    seconds : float
        Tracing time of all batches.
    maps : dict of (rows, columns, 2) float64
        Mean over the batches.
    preview : (h, w) uint8, or None
    warnings : tuple of PictureWarning
        Warnings of all batches.
    adjusted : tuple of float
        Changes by the compensators.
    allowed : Allowed or None
        Result of the search at this point.
    """

    point: Point
    means: Mapping[str, Estimate]
    estimates: Mapping[str, Estimate]
    fault: str = ""
    seconds: float = 0.0
    maps: Mapping[str, Array] = field(default_factory=dict)
    preview: NDArray[np.uint8] | None = None
    warnings: tuple[PictureWarning, ...] = ()
    adjusted: tuple[float, ...] = ()
    allowed: Allowed | None = None
    unknown: Mapping[str, str] = field(default_factory=dict)
    on_the_way: Mapping[str, OnTheWay] = field(default_factory=dict)

    @property
    def warned_of(self) -> str:
        """Classes of the warnings in words, or ""."""
        return "; ".join(dict.fromkeys(type(each).__name__ for each in self.warnings))

    def knows(self, column: Column) -> bool:
        """Tell whether the value of a column is known."""
        return column.name in self.means and column.knows(self.means[column.name])

    @property
    def unknown_in_words(self) -> str:
        """Unknown metrics, here or on the way, with reasons, or ""."""
        way = {f"{name} ({met.unknown} of {met.cameras} cameras on the way)": met.reason
               for name, met in self.on_the_way.items()}  # fmt: skip
        return in_words({**self.unknown, **way})


@dataclass(frozen=True)
class Sensitivity:
    """Derivative of a metric by an axis.

    Attributes
    ----------
    path : str
    column : Column
    slope : Slope
        For magnitudes, by the size of the error.
    left_out : int
        Points of the axis with an unknown value or error of the column.
    """

    path: str
    column: Column
    slope: Slope
    left_out: int = 0


@dataclass(frozen=True, eq=False)
class Table:
    """All points of a study with their metrics."""

    plan: Plan
    rows: tuple[Row, ...]

    @property
    def columns(self) -> tuple[Column, ...]:
        """Columns of the metrics."""
        return columns_of(self.plan.metrics)

    @property
    def failed(self) -> list[Row]:
        """Points without metrics."""
        return [row for row in self.rows if row.fault]

    @property
    def warnings(self) -> tuple[PictureWarning, ...]:
        """Warnings of the points, one per class: how many have it, and the first one's text."""
        known = [row for row in self.rows if row.estimates]
        found = {f"point {row.point.number}": row.warnings for row in known}
        return summed_up(found, len(known), "points")

    def value_of(self, row: Row, axis: int) -> Any:
        """Return the value of an axis at a row's point; None if its search found none."""
        value = row.point.values[axis]
        if row.point.searched == axis:
            return row.allowed.value if row.allowed is not None else None
        return self.plan.reference_values[axis] if value is None else value

    def values(self, column: str) -> Array:
        """Return the values of a column, (points,); NaN: unknown."""
        return np.array([row.estimates[column].value if column in row.estimates else math.nan for row in self.rows])

    def stderr(self, column: str) -> Array:
        """Return the standard errors of a column, (points,)."""
        return np.array([row.estimates[column].stderr if column in row.estimates else math.nan for row in self.rows])

    def records(self) -> list[dict[str, Any]]:
        """Return the rows as plain values by column name."""
        records = []
        for row in self.rows:
            record: dict[str, Any] = {"point": row.point.number}
            for i, axis in enumerate(self.plan.axes):
                record[axis.path] = self.value_of(row, i)
            if self.plan.scenes:
                record["scene"] = self.plan.label(row.point)
            for i, each in enumerate(self.plan.study.compensators):
                record[f"adjusted {each.path}"] = row.adjusted[i] if row.adjusted else None
            if self.plan.searched:
                low, high = row.allowed[1:3] if row.allowed is not None else (None, None)
                record |= {"searched": self._searched(row), "allowed_low": low, "allowed_high": high}
            for column in self.columns:
                estimate = row.estimates.get(column.name)
                record[column.name] = None if estimate is None else estimate.value
                record[f"{column.name}_stderr"] = None if estimate is None else estimate.stderr
            record["fault"] = row.fault
            record["unknown"] = row.unknown_in_words
            record["warnings"] = row.warned_of
            records.append(record)
        return records

    def to_csv(self) -> str:
        """Return the table as CSV, with numbers that read back to the same bits."""
        stream = io.StringIO()
        records = self.records()
        writer = csv.DictWriter(stream, records[0].keys(), lineterminator="\n")
        writer.writeheader()
        for record in records:
            writer.writerow({name: _cell(value) for name, value in record.items()})
        return stream.getvalue()

    def to_parquet(self) -> bytes:
        """Return the table as Parquet.

        Raises
        ------
        LfmeshError
            pyarrow is not installed.
        """
        try:
            import pyarrow
            from pyarrow import parquet
        except ImportError:
            raise LfmeshError('Parquet needs pyarrow: pip install "lfmesh[data]"') from None
        columns: dict[str, list[Any]] = {name: [] for name in self.records()[0]}
        for record in self.records():
            for name, value in record.items():
                columns[name].append(value)
        for name, values in columns.items():
            # A column holds values of one type; names mixed with numbers are written as text.
            if len({type(value) for value in values if value is not None}) > 1:
                numeric = all(value is None or is_number(value) for value in values)
                columns[name] = [None if v is None else float(v) if numeric else str(v) for v in values]
        stream = io.BytesIO()
        parquet.write_table(pyarrow.table(columns), stream)
        return stream.getvalue()

    def sensitivities(self) -> list[Sensitivity]:
        """Return the derivatives of the metrics by every numeric axis that varies alone at some points."""
        found = []
        for i, axis in enumerate(self.plan.axes):
            rows = [row for row in self.along(i) if row.estimates]
            start = self.plan.reference_values[i]
            if not is_number(start) or not all(is_number(self.value_of(row, i)) for row in rows):
                continue
            off = np.array([float(self.value_of(row, i)) - float(start) for row in rows])
            for column in self.columns:
                if column.of == "psnr":
                    continue
                known = [row.estimates[column.name] for row in rows]
                x = np.abs(off) if column.magnitude else off
                fit = slope(x, np.array([e.value for e in known]), np.array([e.stderr for e in known]))
                if fit is not None:
                    found.append(Sensitivity(axis.path, column, fit, len(rows) - fit.points))
        return found

    def along(self, axis: int) -> list[Row]:
        """Return the rows in which only this axis may differ from the reference, including the reference."""
        others = [i for i in range(len(self.plan.axes)) if i != axis]
        start = self.plan.reference_values
        return [row for row in self.rows if all(self.value_of(row, i) == start[i] for i in others)]

    def breaks(self, row: Row, errors: float = 0.0) -> bool:
        """Tell whether a traced point breaks a limit, by known columns; see `keeps`."""
        return any(not self.keeps(row, column, errors) for column in self.limited if row.knows(column))

    def keeps_all(self, row: Row, errors: float = 0.0) -> bool:
        """Tell whether a point keeps all limits, with all columns known; see `keeps`."""
        return all(row.knows(column) and self.keeps(row, column, errors) for column in self.limited)

    def keeps(self, row: Row, column: Column, errors: float = 0.0) -> bool:
        """Tell whether a point keeps the limit of a column known there.

        Parameters
        ----------
        row : Row
        column : Column
        errors : float
            Standard errors by which the value is made worse; an unknown error counts as 0.
        """
        value, error = row.means[column.name]
        sign = 1.0 if column.harm(1.0) > 0.0 else -1.0
        return column.keeps(
            value + sign * errors * error if error == error else value, self.plan.study.limits[column.name]
        )

    @property
    def limited(self) -> tuple[Column, ...]:
        """Columns that have a limit."""
        return tuple(column for column in self.columns if column.name in self.plan.study.limits)

    @property
    def drawn(self) -> list[Row]:
        """Tried points of the design, without the reference and searched points."""
        rows = (row for row in self.rows if row.point.number and row.point.searched is None)
        return [row for row in rows if row.fault != "not done"]

    def yield_share(self) -> Share | None:
        """Return the fraction of good cameras among those with all errors together; None without any or without limits.

        The interval is for independent draws, and too wide for a Latin hypercube or Sobol' points. Its ends count
        cameras that are good, or bad, beyond their standard errors. Cameras with an unknown limited column count as
        trials only if they break another limit; the interval covers both outcomes.
        """
        drawn = self.drawn
        if not self.plan.study.limits or not drawn or self.plan.study.design == "one_at_a_time":
            return None
        settled = [row for row in drawn if self.breaks(row) or all(map(row.knows, self.limited))]
        found = share_of(sum(self.keeps_all(row) for row in settled), len(settled))
        least = share_of(sum(self.keeps_all(row, DOUBT) for row in drawn), len(drawn)).low
        most = share_of(sum(not self.breaks(row, -DOUBT) for row in drawn), len(drawn)).high
        return found._replace(low=least, high=most)

    def breaking(self) -> list[tuple[str, Any]]:
        """Return the axes that break a limit by themselves, with the nearest value to the reference's that does."""
        found: list[tuple[str, Any]] = []
        for i, axis in enumerate(self.plan.axes if self.plan.study.limits else ()):
            rows = [row for row in self.along(i) if row.point.number and row.point.searched is None]
            bad = [self.value_of(row, i) for row in rows if row.means and self.breaks(row)]
            start = self.plan.reference_values[i]
            if bad:
                near = (
                    min(bad, key=lambda v: abs(v - start)) if is_number(start) and all(map(is_number, bad)) else bad[0]
                )
                found.append((axis.path, near))
        return found

    def allowed(self) -> list[Row]:
        """Return the points where a search for the largest change of an axis has a result."""
        return [row for row in self.rows if row.allowed is not None]

    def _searched(self, row: Row) -> str | None:
        if row.point.searched is None:
            return None
        return self.plan.axes[row.point.searched].path

    def efficiency(self) -> list[tuple[Row, float, float]]:
        """Return each row with its efficiency 1/(noise² · time), 1/s, and the efficiency's standard error."""
        found = []
        for row in self.rows:
            noise = row.estimates.get("noise")
            if noise is None or not noise.value > 0.0 or not row.seconds > 0.0:
                continue
            value = 1.0 / (noise.value**2 * row.seconds)
            found.append((row, value, 2.0 * value * noise.stderr / noise.value))
        return found


def table_of(plan: Plan, outcomes: Mapping[tuple[int, int], Outcome], faults: Mapping[int, str]) -> Table:
    """Combine outcomes into a table by point and batch, independent of the order of computation.

    Parameters
    ----------
    plan : Plan
    outcomes : dict of Outcome
        Outcomes by point and batch.
    faults : dict of str
        Reasons for missing units, by number of the point.
    """
    return Table(plan, tuple(_row(plan, point, outcomes, faults) for point in plan.points))


def _row(plan: Plan, point: Point, outcomes: Mapping[tuple[int, int], Outcome], faults: Mapping[int, str]) -> Row:
    mine = [outcomes.get((point.number, batch)) for batch in range(plan.study.batches)]
    known = [outcome for outcome in mine if outcome is not None]
    fault = next((outcome.fault for outcome in known if outcome.fault), "")
    if not fault and len(known) < len(mine):
        fault = faults.get(point.number, "not done")
    found = in_order(warning for outcome in known for warning in outcome.warnings)
    if fault:
        return Row(point, {}, {}, fault, warnings=found)
    columns = columns_of(plan.metrics)
    means = {each.name: combined(_joined([outcome.columns[each.name] for outcome in known])) for each in columns}
    estimates = {column.name: column.estimate(means[column.name]) for column in columns}
    maps = {
        name: np.mean([outcome.maps[name] for outcome in known], axis=0)
        for name in known[0].maps
        if all(name in outcome.maps for outcome in known)
    }
    seconds = sum(outcome.seconds for outcome in known)
    first = known[0]
    unknown = {name: why for outcome in reversed(known) for name, why in outcome.unknown.items()}
    unknown = {name: unknown[name] for name in plan.metrics if name in unknown}
    return Row(
        point, means, estimates, "", seconds, maps, first.preview, found, first.adjusted, first.allowed, unknown,
        first.on_the_way,
    )  # fmt: skip


def _joined(pseudo: Sequence[Array]) -> Array:
    """Concatenate the pseudo-values of all batches; exact values are the same in each."""
    return pseudo[0] if all(len(values) == 1 for values in pseudo) else np.concatenate(list(pseudo))


def _cell(value: Any) -> str:
    if value is None:
        return ""
    return repr(value) if isinstance(value, float) else str(value)
