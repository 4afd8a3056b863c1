"""A study in sentences for the designer, with names and units; resolved effects come first."""

import math
from collections.abc import Iterable, Iterator

from lfmesh.scene.literals import counted, literal, plain
from lfmesh.study.metrics.column import Column
from lfmesh.study.sweeps.axes import name_and_unit
from lfmesh.study.sweeps.table import CONFIDENCE, DOUBT, Row, Table
from lfmesh.study.sweeps.unit import Outcome
from lfmesh.study.tolerances.budget import Budget, budget_of
from lfmesh.study.tolerances.largest_change import Allowed

NOT_KNOWN, NOT_RESOLVED = "not known", "not resolved"

SMALL = 0.01
"""Share of a budget below which effects are not named individually."""

MOST_NAMED = 6
"""Largest number of parameters named in a sentence."""

DIGITS = 6
"""Largest number of digits of a value."""

LEAST_PLAIN, MOST_PLAIN = 1e-4, 1e6
"""Range of values written without an exponent."""

LEAST_ERROR = 5e-4
"""Error of a share below which it is not visible in tenths of a per cent."""


def in_short(table: Table) -> list[str]:
    """Return the results of a study, one sentence each."""
    return [
        _progress(table),
        *metrics_not_known(table),
        *_limits(table),
        *yield_in_words(table),
        *largest_changes(table),
        *_breaking(table),
        *(budget_in_words(table, budget_of(table, column)) for column in table.limited or _judged(table)[:1]),
        *_adjustments(table),
        *_ends(table),
        *_steepest(table),
        *_efficiency(table),
    ]


def words_of(table: Table, row: Row) -> str:
    """Return a point in words, with names and units as in reports."""
    searched = row.point.searched
    return table.plan.label(row.point, None if searched is None else table.value_of(row, searched))


def column_value(row: Row, column: Column) -> str:
    """Return the value of a column with its standard error, or its bound, in words."""
    value, error = row.estimates[column.name]
    if column.is_square and math.isnan(error) and math.isfinite(row.means[column.name].value):
        bound = column.bound(row.means[column.name])
        if math.isnan(bound):
            return "no difference"
        return f"{'above' if column.worse == 'low' else 'below'} {plain(bound, 3)}"
    return written(value, error)


def written(value: float, error: float) -> str:
    """Return a value with its standard error, to matching digits; "± ?" if the error is unknown."""
    if math.isnan(value):
        return NOT_KNOWN
    if math.isnan(error):
        return f"{plain(value, 2)} ± ?"
    if not error > 0.5 * 10.0**-DIGITS * abs(value) or not math.isfinite(error):
        return f"{value:.{DIGITS}g}"
    digits = max(1, min(DIGITS, math.floor(math.log10(abs(value) / error)) + 2)) if value and abs(value) > error else 2
    return f"{_rounded(value, digits)} ± {_rounded(error, 2)}"


def _rounded(value: float, digits: int) -> str:
    """Return a value to a number of digits, without an exponent unless it is very large or small."""
    rounded = float(f"{value:.{digits}g}")
    if not LEAST_PLAIN <= abs(rounded) < MOST_PLAIN:
        return f"{rounded:.{digits}g}"
    return f"{rounded:.{max(0, digits - 1 - math.floor(math.log10(abs(rounded))))}f}"


def percent(share: float, error: float = 0.0) -> str:
    """Return a share in per cent, with its standard error if that is visible in the digits."""
    return f"{100.0 * share:.1f}" if error < LEAST_ERROR else written(100.0 * share, 100.0 * error)


def first_column(table: Table) -> Column | None:
    """Return the column that ranks points from best to worst."""
    return next(iter(_judged(table)), None)


def ranked_by(rows: list[Row], column: Column) -> list[Row]:
    """Return the points, without the reference and searched ones, from best to worst."""
    known = [row for row in rows if row.point.number and row.point.searched is None and row.knows(column)]
    return sorted(known, key=lambda row: column.harm(row.means[column.name].value))


def _told_apart(one: Row, other: Row, column: Column) -> bool:
    """Tell whether two points differ in a column by more than their standard errors, taken as independent."""
    (a, error_a), (b, error_b) = one.means[column.name], other.means[column.name]
    errors = [error for error in (error_a, error_b) if not math.isnan(error)]
    return abs(a - b) > DOUBT * math.hypot(*errors)


def _judged(table: Table) -> list[Column]:
    return [column for column in table.columns if column.worse]


def _progress(table: Table) -> str:
    done, all_points = sum(not row.fault for row in table.rows), len(table.rows)
    waiting = sum(row.fault == "not done" for row in table.rows)
    words = [f"{done} of {all_points} points are done" if done < all_points else f"All {all_points} points are done"]
    if failed := len(table.failed) - waiting:
        words.append(f"{failed} could not be traced")
    if waiting:
        words.append(f"{waiting} are not computed yet")
    return "; ".join(words) + "."


def metrics_not_known(table: Table) -> Iterator[str]:
    """Yield for each metric the points and the searched cameras where it is unknown, with reasons."""
    rows = [row for row in table.rows if row.estimates]
    for name in table.plan.metrics:
        lacking = [row for row in rows if name in row.unknown]
        if lacking:
            why = _reasons(row.unknown[name] for row in lacking)
            yield f"{name} is {NOT_KNOWN} at {len(lacking)} of {len(rows)} points ({_listed(table, lacking)}): {why}."
        met = [row for row in rows if name in row.on_the_way]
        if met:
            ways = [row.on_the_way[name] for row in met]
            share = f"{sum(way.unknown for way in ways)} of {sum(way.cameras for way in ways)} cameras"
            why = _reasons(way.reason for way in ways)
            yield (
                f"{name} is {NOT_KNOWN} for {share} tried by searches and adjustments ({_listed(table, met)}): {why}."
            )


def _reasons(given: Iterable[str]) -> str:
    """Return the first reason, and the number of others."""
    first, *others = dict.fromkeys(given)
    return first + (f"; {counted(len(others), 'other reason')} in table.csv" if others else "")


def _listed(table: Table, rows: list[Row]) -> str:
    """Return points in words, as many as fit into a sentence."""
    more = f" and {len(rows) - MOST_NAMED} more" if len(rows) > MOST_NAMED else ""
    return ", ".join(words_of(table, row) for row in rows[:MOST_NAMED]) + more


def unknown_of_reference(outcome: Outcome) -> list[str]:
    """Return the unknown metrics of the reference camera in words, one line each."""
    if outcome.fault:
        return [f"no metric is known for the reference camera: {outcome.fault}"]
    return [f"{name} is {NOT_KNOWN} for the reference camera: {why}" for name, why in outcome.unknown.items()]


def _limits(table: Table) -> Iterator[str]:
    """Yield for each limit how many cameras keep it; a limit that none breaks is held."""
    rows = table.drawn
    yield from () if table.plan.scenes else beyond_limits(table)
    for column in table.limited:
        limit = _limit(table, column)
        known = [row for row in rows if row.knows(column)]
        held = sum(table.keeps(row, column, DOUBT) for row in known)
        bad = sum(not table.keeps(row, column, -DOUBT) for row in known)
        unsure = len(known) - held - bad
        doubt = f"; {unsure} {'are' if unsure > 1 else 'is'} too close to it to decide" if unsure else ""
        if lacking := len(rows) - len(known):
            doubt += f"; for {lacking} its value is {NOT_KNOWN}"
        if not known:
            yield f"Nothing is known about the limit {limit}{'' if rows else ' yet'}."
        elif not bad:
            keeping = "all" if held == len(rows) else f"{held} of"
            yield f"The limit {limit} is held at {keeping} {len(rows)} cameras{doubt}."
        else:
            yield f"The limit {limit} is broken at {bad} of {len(rows)} cameras{doubt}."


def beyond_limits(table: Table) -> Iterator[str]:
    """Yield the limits that the reference camera itself breaks."""
    reference = table.rows[0]
    for column in table.limited if reference.means else ():
        if reference.knows(column) and not table.keeps(reference, column):
            value = column_value(reference, column)
            limit = _limit(table, column)
            yield f"The reference camera itself is beyond the limit {limit}: its value is {value}{column.unit}."


def _limit(table: Table, column: Column) -> str:
    side = "at least" if column.worse == "low" else "at most"
    return f"{column.noun} {side} {table.plan.study.limits[column.name]:g}{column.unit}"


def yield_in_words(table: Table) -> Iterator[str]:
    """Yield the share of cameras that keep the limits, or why a study with limits has none."""
    if good := table.yield_share():
        open_ones = len(table.drawn) - good.trials
        doubt = f"; for {open_ones} more it is {NOT_KNOWN}, and the interval covers both cases" if open_ones else ""
        words = f"{good.good} of {good.trials} cameras keep the limits, {percent(good.value)} %"
        yield (
            f"Yield: {words if good.trials else NOT_KNOWN} "
            f"({CONFIDENCE} interval {percent(good.low)} to {percent(good.high)} %){doubt}."
        )
    elif table.limited and table.plan.study.design == "one_at_a_time":
        yield 'No yield: each error is studied alone; design = "sobol" with a count draws all of them together.'


def largest_changes(table: Table) -> Iterator[str]:
    """Yield the largest change of each axis, the tightest first; axes that reach no limit come last."""
    sides: dict[int, list[Row]] = {}
    for row in table.allowed():
        assert row.point.searched is not None
        sides.setdefault(row.point.searched, []).append(row)
    bound = {i: [row for row in rows if _known(row).column or _known(row).unknown] for i, rows in sides.items()}
    for i in sorted((i for i in bound if bound[i]), key=lambda i: min(_tightness(table, row) for row in bound[i])):
        name, unit = name_and_unit(table.plan.axes[i].title)
        if not any(change_of(table, row) or _known(row).unknown for row in sides[i]):
            at = "beyond" if table.breaks(table.rows[0]) else "at"
            yield f"{name} may not change at all: the reference itself is {at} a limit."
            continue
        spans = [_span(table, row) for row in sides[i]]
        yield f"{name} may change by {' and '.join(spans)}{unit and ' ' + unit}{_until(table, bound[i])}."
        for row in (row for row in bound[i] if _known(row).unknown):
            ends = " and ".join(f"{end:+.3g}" for end in _ends_of(table, row))
            of = f"between {ends}{unit and ' ' + unit}"
            yield f"It is {NOT_KNOWN} whether {name} keeps the limits {of}: {_known(row).unknown}."
    for i in (i for i in bound if not bound[i]):
        name, unit = name_and_unit(table.plan.axes[i].title)
        reach = " and ".join(f"{change_of(table, row):+.4g}" for row in sides[i])
        on_the_way = _on_the_way(table, sides[i])
        broken = {change for change, row in on_the_way if table.breaks(row, -DOUBT)}
        unsure = {change for change, row in on_the_way if not table.keeps_all(row, DOUBT)} - broken
        studied = f"by {reach}{unit and ' ' + unit}, the whole studied range"
        if broken:
            yield f"{name} keeps the limits when changed {studied}, but breaks one in between, at {_changes(broken)}."
        elif unsure:
            yield f"{name} may change {studied}; the limits are undecided at {_changes(unsure)}."
        else:
            yield f"{name} may change {studied}: no limit is reached."


def _on_the_way(table: Table, searched: list[Row]) -> list[tuple[float, Row]]:
    """Return the traced points of an axis within its largest changes, each with its change.

    Parameters
    ----------
    table : Table
    searched : list of Row
        Searched rows of the axis, one per side.
    """
    axis = searched[0].point.searched
    assert axis is not None
    start = float(table.plan.reference_values[axis])
    ends = [change_of(table, row) for row in searched]
    rows = [(float(table.value_of(row, axis)) - start, row) for row in table.along(axis) if row.means]
    return [(change, row) for change, row in rows if any(0.0 < change / end <= 1.0 for end in ends if end)]


def _changes(changes: set[float]) -> str:
    return ", ".join(f"{change:+.4g}" for change in sorted(changes))


def _breaking(table: Table) -> Iterator[str]:
    """Yield the other axes that break a limit by themselves."""
    searched = {table.plan.axes[row.point.searched].path for row in table.rows if row.point.searched is not None}
    titles = {axis.path: axis.title for axis in table.plan.axes}
    for path, value in table.breaking():
        if path not in searched:
            yield f"Changed alone, {titles[path]} breaks a limit at {literal(value)}."


def _until(table: Table, rows: list[Row]) -> str:
    reached = {_known(row).column for row in rows if change_of(table, row) and not _known(row).unknown}
    titles = [_limit(table, column) for column in table.limited if column.name in reached]
    return f", until a limit is reached: {', '.join(titles)}" if titles else ""


def _known(row: Row) -> Allowed:
    assert row.allowed is not None
    return row.allowed


def change_of(table: Table, row: Row) -> float:
    """Return the largest change found by a row, relative to the reference's value."""
    assert row.point.searched is not None
    return _known(row).value - float(table.plan.reference_values[row.point.searched])


def _tightness(table: Table, row: Row) -> float:
    """Return the allowed change divided by the range studied."""
    i = row.point.searched
    assert i is not None
    return change_of(table, row) / (row.point.values[i] - float(table.plan.reference_values[i]))


def _span(table: Table, row: Row) -> str:
    found, change = _known(row), change_of(table, row)
    if not (found.column or found.unknown):
        return f"{change:+.4g} (the whole studied range)"
    low, high = _ends_of(table, row)
    return f"{change:+.4g} ({'at least; not known from ' * bool(found.unknown)}{low:+.3g} to {high:+.3g})"


def _ends_of(table: Table, row: Row) -> tuple[float, float]:
    """Return the interval of the largest change found by a row."""
    found = _known(row)
    start = found.value - change_of(table, row)
    return found.low - start, found.high - start


def tolerance_rows(table: Table) -> list[list[str]]:
    """Return the largest changes found, one row each, with the sensitivities' prediction and the metric there."""
    columns = {column.name: column for column in table.limited}
    budgets = {name: budget_of(table, column) for name, column in columns.items()}
    lines = []
    for row in table.allowed():
        i, found = row.point.searched, _known(row)
        assert i is not None
        start = float(table.plan.reference_values[i])
        far = row.point.values[i] - start
        said = {
            name: effect.predicted(columns[name], table.rows[0].means[name], table.plan.study.limits[name], far)
            for name, budget in budgets.items()
            for effect in budget.effects
            if effect.axis == i
        }
        nearest = min(said.values(), key=abs, default=math.nan)
        predicted = NOT_KNOWN if math.isnan(nearest) else f"{nearest:+.4g}" if abs(nearest) <= abs(far) else "none"
        told = found.column or found.unknown
        interval = f"{found.low - start:+.4g} to {found.high - start:+.4g}" if told else "the whole studied range"
        at = columns.get(found.column)
        at_limit = ["", "no limit is reached"] if at is None else [column_value(row, at), _limit(table, at)]
        at_limit[1] = f"{NOT_KNOWN} within the interval" if found.unknown else at_limit[1]
        lines.append(
            [
                *[table.plan.axes[i].title, f"{found.value - start:+.4g}", interval, predicted],
                *at_limit,
            ]
        )
    return lines


def budget_in_words(table: Table, budget: Budget) -> str:
    """Return the contributions to a column's budget in words, resolved effects first."""
    column = budget.column
    if budget.reason:
        return f"No budget of {column.noun}: {budget.reason}."
    names = {effect.axis: name_and_unit(table.plan.axes[effect.axis].title)[0] for effect in budget.effects}
    resolved = [effect for effect in budget.effects if effect.is_resolved]
    large = [effect for effect in resolved if budget.share(effect).value >= SMALL][:MOST_NAMED]
    small = len(resolved) - len(large)
    shares = [f"{names[e.axis]} {percent(*budget.share(e))} %" for e in large]
    words = f"The mean square {_what(column)} comes from {', '.join(shares)}" if shares else (
        f"No parameter's own effect on {column.noun} is distinguishable from noise and joint effects"
    )  # fmt: skip
    if small and shares:
        words += f", {small} other{'s' if small > 1 else ''} less"
    open_ones = [names[effect.axis] for effect in budget.effects if not effect.is_resolved]
    if open_ones:
        more = f" and {len(open_ones) - MOST_NAMED} more" if len(open_ones) > MOST_NAMED else ""
        words += f"; {NOT_RESOLVED}: {', '.join(open_ones[:MOST_NAMED])}{more}"
    if resolved:
        words += f". All together (RSS): {_amount(budget, budget.square)}"
        if math.isfinite(budget.drawn):
            words += f"; the cameras with all errors: {_amount(budget, budget.drawn)}"
    if budget.left_out:
        words += f". {counted(budget.left_out, 'point')} left out, where {column.noun} is {NOT_KNOWN}"
    return words + "."


def _what(column: Column) -> str:
    """Return the quantity that adds up in squares, in words."""
    return {"psnr": f"difference behind {column.noun}", "root": f"of {column.noun}"}.get(
        column.of, f"change of {column.noun}"
    )


def _amount(budget: Budget, square: float) -> str:
    change = "" if budget.column.is_square else "a change of "
    value = budget.written(square)
    return f"{change}{value:.3g}{budget.column.unit}" if math.isfinite(value) else NOT_RESOLVED


def budget_rows(table: Table, budget: Budget) -> list[list[str]]:
    """Return the effects of a budget, one row each."""
    return [
        [
            table.plan.axes[effect.axis].title,
            _amount(budget, effect.square.value) if effect.is_resolved else NOT_RESOLVED,
            percent(*budget.share(effect)),
            written(*effect.linear),
            written(*effect.quadratic),
        ]
        for effect in budget.effects
    ]


def _adjustments(table: Table) -> Iterator[str]:
    nouns = {column.name: column.noun for column in table.columns}
    for i, each in enumerate(table.plan.study.compensators):
        changes = [row.adjusted[i] for row in table.rows if row.adjusted]
        name, unit = name_and_unit(each.title)
        if changes:
            reach = " to ".join(dict.fromkeys(f"{change:+.3g}" for change in (min(changes), max(changes))))
            best = nouns[each.metric]
            yield f"{name} was adjusted at every camera to the best {best}, by {reach}{unit and ' ' + unit}."


def _ends(table: Table) -> Iterator[str]:
    column = first_column(table)
    rows = [row for row in table.rows if row.estimates]
    ranked = ranked_by(rows, column) if column is not None else []
    # A single camera is neither best nor worst.
    if column is None or len(ranked) < 2:
        return
    for which, row in (("Best", ranked[0]), ("Worst", ranked[-1])):
        value = column_value(row, column)
        near = sum(not _told_apart(row, other, column) for other in ranked if other is not row)
        words = f"{which} by {column.noun}: {words_of(table, row)}, {value}{column.unit if value[0].isdigit() else ''}"
        others = f"{near} of {len(ranked) - 1} others {'is' if near == 1 else 'are'}"
        yield f"{words}; {others} equal to it within errors." if near else f"{words}."


def _steepest(table: Table) -> Iterator[str]:
    """Yield the steepest resolved sensitivities of the first column."""
    column, titles = first_column(table), {axis.path: axis.title for axis in table.plan.axes}
    known = [each for each in table.sensitivities() if each.column == column and each.slope.low * each.slope.high > 0.0]
    for each in sorted(known, key=lambda one: -abs(one.slope.value))[:3]:
        name, unit = name_and_unit(titles[each.path])
        size = "of the magnitude " if each.column.magnitude else ""
        yield (
            f"{each.column.noun} changes by {each.slope.value:.3g}{each.column.unit} for each {unit or 'unit'} "
            f"{size}of {name} ({each.slope.low:.3g} to {each.slope.high:.3g})."
        )


def _efficiency(table: Table) -> Iterator[str]:
    if efficiency := table.efficiency():
        row, rate, error = max(efficiency, key=lambda one: one[1])
        yield f"Most efficient: {words_of(table, row)}, 1/(noise² · time) = {written(rate, error)} 1/s."
