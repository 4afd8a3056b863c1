"""Figures of a study's report: metrics against an axis with error bars, fields of displacements, pictures."""

import base64
import io
import math
import textwrap
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lfmesh.accuracy.figures import GREY, finish, inline_svg
from lfmesh.study.metrics.column import Column
from lfmesh.study.sweeps.axes import is_number
from lfmesh.study.sweeps.sentences import words_of
from lfmesh.study.sweeps.table import Row, Table

Array = NDArray[np.float64]

BLUE, ORANGE = "#1f4e8c", "#b4541a"
PANELS = 3
"""Side by side in a figure."""

PANEL_IN = (2.45, 1.6)
"""Of a panel without its labels."""

LEFT_IN, RIGHT_IN, NUMBERS_IN = 0.72, 0.13, 0.24
"""Room beside a panel, for numbers of eight letters on its left, and for the numbers below it."""

LINE_IN, GAP_IN = 0.17, 0.09
"""Height of a line of text, and the room above and below it."""

TICKS = 5
"""Steps between the numbers below a panel: more would touch."""

CROWDED = 4e-6
"""Share of a value by which the numbers beside a panel have to differ to be told apart by eight letters."""

TITLE_LETTERS = 34
"""In a line of a panel's title: no more fit above it."""

NAME_LETTERS = 14
"""Of a name below a panel, whose values are no numbers; what is longer is numbered."""

ARROWS = 16
"""Displacements are drawn of so many lenslets at most along each side."""


def axis_figure(table: Table, axis: int, columns: Sequence[Column]) -> str:
    """Return a figure of some columns against an axis, a panel each; one standard error to either side.

    Points at which only this axis differs from the reference are joined; all others are grey dots, unless axes vary one
    at a time: then they would only stand above the reference.

    Parameters
    ----------
    table : Table
    axis : int
    columns : sequence of Column
    """
    joined = [row for row in table.along(axis) if row.estimates]
    alone = table.plan.study.design == "one_at_a_time"
    others = [] if alone else [row for row in table.rows if row.estimates and row not in joined]
    values = [table.value_of(row, axis) for row in (*joined, *others)]
    numeric = all(map(is_number, values))
    names = list(dict.fromkeys(map(str, values)))

    def place(row: Row) -> float:
        value = table.value_of(row, axis)
        return float(value) if numeric else float(names.index(str(value)))

    def draw(panel: Any, column: Column) -> None:
        if others:
            panel.plot([place(row) for row in others], _values(others, column)[0], ".", color="#999999", ms=3, zorder=1)
        rows = sorted(joined, key=place)
        y, error = _values(rows, column)
        x = np.array([place(row) for row in rows])
        style = "o-" if numeric else "o"
        panel.errorbar(x, y, yerr=np.nan_to_num(error), fmt=style, color=BLUE, ms=4, lw=1.2, capsize=3, zorder=2)
        start = table.rows[0]
        if start.estimates and math.isfinite(start.estimates[column.name].value):
            panel.plot([place(start)], [start.estimates[column.name].value], "s", color=ORANGE, ms=6, zorder=3)
        if column.name in table.plan.study.limits:
            panel.axhline(table.plan.study.limits[column.name], color=GREY, ls="--", lw=1.0, zorder=0)
        if not numeric:
            short = [name if len(name) <= NAME_LETTERS else f"value {n}" for n, name in enumerate(names, start=1)]
            panel.set_xticks(range(len(names)), short)
            panel.margins(x=0.2)

    title = table.plan.axes[axis].title
    return _panels([(column.title, partial(draw, column=column)) for column in columns], title)


def efficiency_figure(table: Table) -> str:
    """Return a figure of the efficiency of every point, the best on top."""
    known = sorted(table.efficiency(), key=lambda each: each[1])
    names = [textwrap.fill(words_of(table, row), TITLE_LETTERS) for row, _, _ in known]
    each_in = GAP_IN + LINE_IN * max(map(_lines, names))

    def draw(figure: Any) -> None:
        panel = figure.add_subplot()
        places = range(len(known))
        panel.barh(places, [value for _, value, _ in known], color=BLUE, height=0.6)
        panel.errorbar(
            [value for _, value, _ in known], places, xerr=[error for _, _, error in known], fmt="none", ecolor=ORANGE,
            capsize=3,
        )  # fmt: skip
        panel.set_yticks(places, names)
        panel.set_xlabel("1/(noise² · time) / 1/s")
        finish(panel, "efficiency: more is better")
        panel.title.set_color(GREY)

    return _figure(draw, "efficiency", (8.2, 1.0 + each_in * len(known)), layout="constrained")


def field_figure(row: Row, name: str, title: str) -> str:
    """Return a figure of the displacements of the centres over the array, as arrows, upright as on the sensor.

    Parameters
    ----------
    row : Row
    name : str
        Of the map.
    title : str
    """
    field = row.maps[name]
    step = max(1, -(-max(field.shape[:2]) // ARROWS))
    some = field[step // 2 :: step, step // 2 :: step]
    y, x = np.indices(some.shape[:2]) * step + step // 2
    size = np.hypot(some[..., 0], some[..., 1])

    def draw(figure: Any) -> None:
        panel = figure.add_axes((0.13, 0.14, 0.66, 0.76))
        arrows = panel.quiver(x, y, some[..., 0], some[..., 1], size, cmap="viridis", angles="xy", pivot="mid")
        # From none: of equal displacements colours would else tell rounding, and their numbers but an offset.
        arrows.set_clim(0.0, float(np.nanmax(size)))
        panel.set_aspect("equal", anchor="W")
        panel.set(xlabel="lenslet column", ylabel="lenslet row")
        panel.margins(0.06)
        panel.apply_aspect()
        place = panel.get_position()
        beside = figure.add_axes((place.x1 + 0.03, place.y0, 0.035, place.height))
        figure.colorbar(arrows, cax=beside, label="pixels")
        finish(panel, title)
        panel.title.set_color(GREY)

    return _figure(draw, title, (4.1, 3.3))


def picture(preview: NDArray[np.uint8]) -> str:
    """Return a preview as the address of an image that holds its own bytes."""
    import PIL.Image

    stream = io.BytesIO()
    PIL.Image.fromarray(preview).save(stream, format="PNG")
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode()


def _values(rows: Sequence[Row], column: Column) -> tuple[Array, Array]:
    """Return values and standard errors; what is infinite, such as the PSNR of equal images, is not drawn."""
    y = np.array([row.estimates[column.name].value for row in rows])
    error = np.array([row.estimates[column.name].stderr for row in rows])
    return np.where(np.isfinite(y), y, np.nan), error


def _panels(draws: Sequence[tuple[str, Callable[[Any], None]]], title: str) -> str:
    """Return a figure of panels, each with its words above it and the title below.

    The room for all labels is known from their lines; matplotlib's own layout takes as long as drawing does.

    Parameters
    ----------
    draws : sequence of (str, callable)
        Words above each panel, and what draws it.
    title : str
        Of the horizontal axis.
    """
    rows = -(-len(draws) // PANELS)
    columns = min(len(draws), PANELS)
    wrapped = [textwrap.fill(words, TITLE_LETTERS) for words, _ in draws]
    below = textwrap.fill(title, TITLE_LETTERS)
    above_in = GAP_IN + LINE_IN * max(_lines(words) for words in wrapped)
    below_in = NUMBERS_IN + LINE_IN * _lines(below) + GAP_IN
    each_in = (LEFT_IN + PANEL_IN[0] + RIGHT_IN, above_in + PANEL_IN[1] + below_in)
    size = (each_in[0] * columns, each_in[1] * rows)

    def draw(figure: Any) -> None:
        for number, (words, (_, one)) in enumerate(zip(wrapped, draws, strict=True)):
            row, column = divmod(number, PANELS)
            left, low = each_in[0] * column + LEFT_IN, each_in[1] * (rows - 1 - row) + below_in
            panel = figure.add_axes((left / size[0], low / size[1], PANEL_IN[0] / size[0], PANEL_IN[1] / size[1]))
            one(panel)
            panel.set_xlabel(below)
            panel.tick_params(labelsize=8)
            panel.ticklabel_format(axis="y", useOffset=_is_crowded(panel)) if _is_plain(panel.yaxis) else None
            panel.locator_params(axis="x", nbins=TICKS) if _is_plain(panel.xaxis) else None
            finish(panel, words)

    return _figure(draw, title, size)


def _is_crowded(panel: Any) -> bool:
    """Return whether the numbers on the left have more digits than there is room for."""
    low, high = panel.get_ylim()
    return bool(high - low < CROWDED * abs(high))


def _lines(words: str) -> int:
    return words.count("\n") + 1


def _is_plain(axis: Any) -> bool:
    from matplotlib.ticker import ScalarFormatter

    return isinstance(axis.get_major_formatter(), ScalarFormatter)


def _figure(
    draw: Callable[[Any], None], title: str, size: tuple[float, float], layout: Literal["constrained"] | None = None
) -> str:
    """Return a figure as an SVG element that loads nothing."""
    import matplotlib as mpl
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    # Labels and names are the user's, who may write $ and ^ in them.
    style: dict[Any, Any] = {"font.family": "sans-serif", "font.size": 9, "text.parse_math": False}
    with mpl.rc_context({**style, "svg.fonttype": "none", "svg.hashsalt": title}):
        figure = Figure(figsize=size, layout=layout)
        FigureCanvasSVG(figure)
        draw(figure)
        stream = io.StringIO()
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    return inline_svg(stream.getvalue())
