"""Report of a study as a self-contained HTML page."""

import math
from pathlib import Path
from typing import Any

from markupsafe import Markup

import lfmesh
from lfmesh.study.metrics.column import Column
from lfmesh.study.metrics.metrics import METRICS
from lfmesh.study.sweeps import figures
from lfmesh.study.sweeps.axes import is_number, name_and_unit
from lfmesh.study.sweeps.sentences import (
    NOT_KNOWN,
    NOT_RESOLVED,
    budget_in_words,
    budget_rows,
    column_value,
    first_column,
    in_short,
    percent,
    ranked_by,
    tolerance_rows,
    words_of,
)
from lfmesh.study.sweeps.table import CONFIDENCE, Row, Sensitivity, Table
from lfmesh.study.tolerances.budget import budget_of
from lfmesh.templates import filled

TEMPLATE = Path(__file__).parents[1] / "templates" / "study.html"

MOST_ROWS = 300
"""Largest number of points listed on the page; the table has all of them."""

MOST_FIELDS = 4
"""Largest number of displacement fields drawn per metric: those with the largest displacements."""

LEAST_PX = 1e-6
"""Smallest displacement worth drawing."""

ABREAST = 7
"""Columns of a table, beside those that name its rows, that fit on a page."""

NO_FIGURE = ("_x_px", "_y_px", "_w_per_pixel")
"""Suffixes of columns that appear only in table.csv."""


def page(table: Table) -> str:
    """Return the whole report as HTML."""
    plan = table.plan
    columns = [column for column in table.columns if not column.name.endswith(NO_FIGURE)]
    done = [row for row in table.rows if row.estimates]
    drawn = [i for i in range(len(plan.axes)) if len({str(table.value_of(row, i)) for row in done}) > 1]
    known = [column for column in columns if any(math.isfinite(row.estimates[column.name].value) for row in done)]
    sensitivities = table.sensitivities()
    overview = _overview(table, columns, drawn)
    return filled(
        TEMPLATE,
        title=plan.study.name or f"Study of {plan.base.title or 'a camera'}",
        made_by=f"lfmesh {lfmesh.__version__}; reference: {plan.base.title or 'an unnamed scene'}",
        in_short=in_short(table),
        failed=[(words_of(table, row), row.point.number, row.fault) for row in table.failed if row.fault != "not done"],
        warned=[str(each) for each in table.warnings],
        missing=sum(row.fault == "not done" for row in table.rows),
        axes=[
            {
                "title": plan.axes[i].title,
                "path": plan.axes[i].path,
                "figure": Markup(figures.axis_figure(table, i, known)),
                "unit": name_and_unit(plan.axes[i].title)[1] or "unit",
                "slopes": [_slope_cells(each) for each in sensitivities if each.path == plan.axes[i].path],
                "no_slope": _why_no_slope(table, i, known),
            }
            for i in drawn
            if known
        ],
        overview=overview,
        nothing_drawn=_why_nothing(table, done, known),
        tolerances=tolerance_rows(table),
        budgets=[
            {"title": budget.column.noun, "words": budget_in_words(table, budget), "rows": budget_rows(table, budget)}
            for budget in (budget_of(table, column) for column in table.limited)
        ],
        efficiency=Markup(figures.efficiency_figure(table)) if table.efficiency() else "",
        pictures=_pictures(table, done),
        fields=_fields(table, done),
        points=_abreast(
            [
                *["point", "camera"],
                *(f"adjusted: {each.title}" for each in plan.study.compensators),
                *(column.title for column in columns),
                *(["warnings"] if table.warnings else []),
            ],
            [_cells(table, row, columns) for row in table.rows[:MOST_ROWS]],
            named=2,
        ),
        more=max(0, len(table.rows) - MOST_ROWS),
        confidence=CONFIDENCE,
        paired=plan.study.paired,
        replicates=plan.base.transport.replicates,
        samples=plan.base.transport.samples,
    )


def _why_nothing(table: Table, done: list[Row], columns: list[Column]) -> str:
    """Return the reason why no metric is drawn against a parameter."""
    if table.plan.scenes:
        return "The scenes compared differ in more than one parameter."
    if len(done) < 2:
        return "Fewer than two points are finished."
    return (
        "No parameter has two values among the finished points."
        if columns
        else "No metric has a column with a known value."
    )


def _why_no_slope(table: Table, axis: int, columns: list[Column]) -> str:
    """Return the reason why a parameter has no sensitivities."""
    rows = [row for row in table.along(axis) if row.estimates]
    if not all(is_number(table.value_of(row, axis)) for row in rows):
        return "No sensitivity: the values are not numbers."
    if all(column.of == "psnr" for column in columns):
        limited = "its budget lists those" if table.limited else "with a limit of PSNR, its budget lists those"
        return f"PSNR has no sensitivity, because it is infinite at the reference; {limited} of its mean square."
    return "No sensitivity: it needs three points that differ in this parameter only."


def _overview(table: Table, columns: list[Column], axes: list[int]) -> dict[str, Any]:
    """Return the worst value of each metric along each axis alone, the axis of the largest effect first.

    Empty if there is only one axis, or no camera with a single error.
    """
    judged = [column for column in columns if column.worse]
    if not judged or len(axes) < 2:
        return {}
    budget = budget_of(table, judged[0])
    place = {effect.axis: n for n, effect in enumerate(budget.effects)}
    lines: list[tuple[float, float, list[str]]] = []
    for i in axes:
        rows = [row for row in table.along(i) if row.estimates and row.point.number and row.point.searched is None]
        worst = [ranked[-1] if (ranked := ranked_by(rows, column)) else None for column in judged]
        if not rows:
            continue
        values = [table.value_of(row, i) for row in rows]
        numbers = [float(value) for value in values if is_number(value)]
        span = f"{min(numbers):g} to {max(numbers):g}" if numbers else ", ".join(map(str, dict.fromkeys(values)))
        share = budget.share(budget.effects[place[i]]) if i in place else None
        resolved = i in place and budget.effects[place[i]].is_resolved
        used = NOT_KNOWN if share is None else NOT_RESOLVED
        if share is not None and resolved:
            used = percent(*share)
        cells = [column_value(row, column) if row else NOT_KNOWN for row, column in zip(worst, judged, strict=True)]
        harm = judged[0].harm(worst[0].means[judged[0].name].value) if worst[0] else -math.inf
        lines.append((float(place.get(i, len(place))), -harm, [table.plan.axes[i].title, span, used, *cells]))
    if not lines:
        return {}
    lines.sort(key=lambda line: line[:2])
    share_of = f"share of the budget of {judged[0].noun} / %"
    heading = ["parameter", "from, to", share_of, *(f"worst {column.title}" for column in judged)]
    tables = _abreast(heading, [cells for *_, cells in lines], named=3)
    return {"tables": tables, "first": judged[0].noun, "why": budget.reason}


def _abreast(heading: list[str], rows: list[list[str]], named: int) -> list[tuple[list[str], list[list[str]]]]:
    """Divide a table wider than a page into several, repeating the columns that name its rows.

    Parameters
    ----------
    heading : list of str
    rows : list of list of str
    named : int
        Number of leading columns that name a row.
    """
    parts = range(named, max(len(heading), named + 1), ABREAST)
    return [
        (
            [*heading[:named], *heading[first : first + ABREAST]],
            [[*cells[:named], *cells[first : first + ABREAST]] for cells in rows],
        )
        for first in parts
    ]


def _pictures(table: Table, done: list[Row]) -> list[dict[str, str]]:
    """Return pictures of the reference, the best and the worst point."""
    column = first_column(table)
    ranked = ranked_by(done, column) if column is not None else []
    shown = [("", table.rows[0])]
    if column is not None and len(ranked) == 1:
        shown += [("", ranked[0])]
    elif column is not None and ranked:
        shown += [(f"best by {column.noun}: ", ranked[0]), (f"worst by {column.noun}: ", ranked[-1])]
    return [
        {"words": f"{words}{words_of(table, row)}", "source": figures.picture(row.preview)}
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
            fields.append({"figure": drawing, "words": words_of(table, row)})
    return fields


def _slope_cells(each: Sensitivity) -> list[str]:
    by = " by its size" if each.column.magnitude else ""
    inside = f"{each.slope.low:.4g} to {each.slope.high:.4g}"
    points = f"{each.slope.points}{f', {each.left_out} not known' if each.left_out else ''}"
    return [each.column.title + by, f"{each.slope.value:.4g}", inside, points]


def _cells(table: Table, row: Row, columns: list[Column]) -> list[str]:
    adjusted = [f"{change:.4g}" for change in row.adjusted] or [""] * len(table.plan.study.compensators)
    start = [str(row.point.number), words_of(table, row), *adjusted]
    warned = [row.warned_of] if table.warnings else []
    if row.fault:
        return [*start, row.fault, *[""] * (len(columns) - 1), *warned]
    return [*start, *(column_value(row, column) for column in columns), *warned]
