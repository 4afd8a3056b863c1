"""The report of a study as one HTML page that loads nothing."""

import math
from pathlib import Path
from typing import Any

from markupsafe import Markup

import lfmesh
from lfmesh.scene.literals import literal
from lfmesh.study.metrics.metrics import METRICS, Column
from lfmesh.study.sweeps import figures
from lfmesh.study.sweeps.axes import is_number
from lfmesh.study.sweeps.table import CONFIDENCE, Row, Sensitivity, Table
from lfmesh.templates import filled

TEMPLATE = Path(__file__).parent / "templates" / "study.html"

MOST_ROWS = 300
"""Points that the page lists; the table has all of them."""

MOST_FIELDS = 4
"""Fields of displacements that are drawn of a metric: those of the points with the largest."""

LEAST_PX = 1e-6
"""Where nothing moves by more, there is nothing to draw."""

NO_FIGURE = ("_x_px", "_y_px", "_w_per_pixel")
"""Columns, by the end of their name, that are in the table alone."""


def page(table: Table) -> str:
    """Return the whole report as HTML."""
    plan = table.plan
    columns = [column for column in table.columns if not column.name.endswith(NO_FIGURE)]
    done = [row for row in table.rows if row.estimates]
    drawn = [i for i in range(len(plan.axes)) if len({str(table.value_of(row, i)) for row in done}) > 1]
    sensitivities = table.sensitivities()
    return filled(
        TEMPLATE,
        title=plan.study.name or f"A study of {plan.base.name or 'a camera'}",
        made_by=f"lfmesh {lfmesh.__version__}; reference: {plan.base.name or 'a scene without a name'}",
        in_short=_in_short(table, done, sensitivities),
        failed=[
            (plan.label(row.point), row.point.number, row.fault) for row in table.failed if row.fault != "not done"
        ],
        warned=[str(each) for each in table.warnings],
        missing=sum(row.fault == "not done" for row in table.rows),
        axes=[
            {
                "title": plan.axes[i].label or plan.axes[i].path,
                "path": plan.axes[i].path,
                "figure": Markup(figures.axis_figure(table, i, columns)),
                "slopes": [_slope_cells(each) for each in sensitivities if each.path == plan.axes[i].path],
            }
            for i in drawn
            if columns
        ],
        overview=_overview(table, columns, drawn),
        efficiency=Markup(figures.efficiency_figure(table)) if table.efficiency() else "",
        pictures=_pictures(table, done),
        fields=_fields(table, done),
        heading=["point", *(axis.path for axis in plan.axes), *(column.title for column in table.columns), "warnings"],
        rows=[_cells(table, row) for row in table.rows[:MOST_ROWS]],
        more=max(0, len(table.rows) - MOST_ROWS),
        confidence=CONFIDENCE,
        paired=plan.study.paired,
        replicates=plan.base.transport.replicates,
        samples=plan.base.transport.samples,
    )


def _in_short(table: Table, done: list[Row], sensitivities: list[Sensitivity]) -> list[str]:
    plan = table.plan
    lines = [f"{len(done)} of {len(plan.points)} points are done, {len(table.failed)} are not or cannot be traced."]
    if good := table.yield_share():
        lines.append(
            f"Yield: {good.good} of {good.trials} cameras keep the limits, {good.value:.1%} "
            f"({CONFIDENCE} interval {good.low:.1%} to {good.high:.1%})."
        )
    lines += [f"By itself, {path} breaks a limit at {literal(value)}." for path, value in table.breaking()]
    column = _first(table)
    if column is not None:
        ranked = _ranked(done, column)
        if ranked:
            best, worst = ranked[0], ranked[-1]
            for which, row in (("Best", best), ("Worst", worst)):
                value = written(row.estimates[column.name].value, row.estimates[column.name].stderr)
                lines.append(f"{which} by {column.title}: {plan.label(row.point)}, {value}.")
    known = [each for each in sensitivities if each.column == column]
    lines += [
        f"{each.column.title} changes by {each.slope.value:.3g} for each unit of {each.path} "
        f"({each.slope.low:.3g} to {each.slope.high:.3g})."
        for each in sorted(known, key=lambda one: -abs(one.slope.value))[:3]
    ]
    if efficiency := table.efficiency():
        row, rate, error = max(efficiency, key=lambda one: one[1])
        lines.append(f"Most efficient: {plan.label(row.point)}, 1/(noise² · time) = {written(rate, error)} 1/s.")
    return lines


def _overview(table: Table, columns: list[Column], axes: list[int]) -> dict[str, Any]:
    """Return the worst value of every metric along each axis by itself, the axis that does most harm first."""
    judged = [column for column in columns if column.worse]
    if not judged or len(axes) < 2:
        return {}
    lines: list[tuple[float, list[str]]] = []
    for i in axes:
        rows = [row for row in table.along(i) if row.estimates and row.point.number]
        worst = [ranked[-1].estimates[column.name] for column in judged if (ranked := _ranked(rows, column))]
        if not rows or len(worst) < len(judged):
            continue
        values = [table.value_of(row, i) for row in rows]
        numbers = [float(value) for value in values if is_number(value)]
        span = f"{min(numbers):g} to {max(numbers):g}" if numbers else ", ".join(map(str, dict.fromkeys(values)))
        axis = table.plan.axes[i]
        harm = worst[0].value if judged[0].worse == "low" else -worst[0].value
        lines.append((harm, [axis.label or axis.path, span, *(written(each.value, each.stderr) for each in worst)]))
    lines.sort(key=lambda line: line[0])
    heading = ["parameter", "from, to", *(f"worst {column.title}" for column in judged)]
    return {"heading": heading, "rows": [cells for _, cells in lines]}


def _first(table: Table) -> Column | None:
    """Return the column by which points are called best and worst."""
    return next((column for column in table.columns if column.worse), None)


def _ranked(rows: list[Row], column: Column) -> list[Row]:
    """Return the points apart from the reference, the best first."""
    known = [row for row in rows if row.point.number and not math.isnan(row.estimates[column.name].value)]
    return sorted(known, key=lambda row: row.estimates[column.name].value, reverse=column.worse == "low")


def _pictures(table: Table, done: list[Row]) -> list[dict[str, str]]:
    """Return reference, best and worst point as pictures."""
    column = _first(table)
    ranked = _ranked(done, column) if column is not None else []
    shown = [("reference", table.rows[0])]
    if column is not None and ranked:
        shown += [(f"best by {column.title}", ranked[0]), (f"worst by {column.title}", ranked[-1])]
    return [
        {"words": f"{words}: {table.plan.label(row.point)}", "source": figures.picture(row.preview)}
        for words, row in shown
        if row.preview is not None
    ]


def _fields(table: Table, done: list[Row]) -> list[dict[str, Any]]:
    fields = []
    for name in table.plan.metrics:
        column = f"{name}_rms_px"
        if not any(each.name == column for each in METRICS[name].columns):
            continue
        rows = [row for row in done if row.point.number and row.estimates[column].value > LEAST_PX]
        rows.sort(key=lambda row: -row.estimates[column].value)
        for row in (row for row in rows[:MOST_FIELDS] if name in row.maps):
            title = f"point {row.point.number}, {'white images' if name == 'centres' else 'chief rays'}"
            drawing = Markup(figures.field_figure(row, name, title))
            fields.append({"figure": drawing, "words": table.plan.label(row.point)})
    return fields


def _slope_cells(each: Sensitivity) -> list[str]:
    by = " by its size" if each.column.magnitude else ""
    inside = f"{each.slope.low:.4g} to {each.slope.high:.4g}"
    return [each.column.title + by, f"{each.slope.value:.4g}", inside, str(each.slope.points)]


def _cells(table: Table, row: Row) -> list[str]:
    values = [literal(table.value_of(row, i)) for i in range(len(table.plan.axes))]
    if row.fault:
        return [str(row.point.number), *values, row.fault, *[""] * (len(table.columns) - 1), row.warned_of]
    estimates = [row.estimates[column.name] for column in table.columns]
    return [str(row.point.number), *values, *(written(each.value, each.stderr) for each in estimates), row.warned_of]


def written(value: float, error: float) -> str:
    """Return a value with its standard error, as many digits as that allows."""
    if math.isnan(value):
        return "none"
    if math.isinf(value):
        return "∞"
    if not error > 0.0 or not math.isfinite(error):
        return f"{value:.6g}"
    digits = max(1, min(12, math.floor(math.log10(abs(value) / error)) + 2)) if value and abs(value) > error else 2
    return f"{value:.{digits}g} ± {error:.2g}"
