"""Figures of a study's report: metrics against axes with error bars, displacement fields, pictures."""

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
"""Panels side by side in a figure."""

PANEL_IN = (2.45, 1.6)
"""Size of a panel without its labels."""

LEFT_IN, RIGHT_IN, NUMBERS_IN = 0.72, 0.13, 0.24
"""Margins of a panel: left, for numbers of eight characters; right; and below, for numbers."""

LINE_IN, GAP_IN = 0.17, 0.09
"""Height of a line of text, and space above and below it."""

TICKS = 5
"""Largest number of steps between the numbers below a panel, so that they do not touch."""

CROWDED = 4e-6
"""Relative difference below which numbers beside a panel look alike in eight characters."""

TITLE_LETTERS = 34
"""Characters that fit in a line of a panel's title."""

NAME_LETTERS = 14
"""Characters of a name below a panel of non-numeric values; longer names are numbered."""

ARROWS = 16
"""Largest number of arrows along each side of a displacement field."""


def axis_figure(table: Table, axis: int, columns: Sequence[Column]) -> str:
    """Return a figure of columns against an axis, one panel each, with error bars of one standard error.

    Points where only this axis differs from the reference are joined. Others are grey dots, except in studies of one
    axis at a time, where all would lie at the reference.

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
    """Return a bar chart of the efficiency of every point, the best on top."""
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
        panel.set_xlabel("1/(noise² · time), 1/s")
        finish(panel, "efficiency: more is better")
        panel.title.set_color(GREY)

    return _figure(draw, "efficiency", (8.2, 1.0 + each_in * len(known)), layout="constrained")


def field_figure(row: Row, name: str, title: str) -> str:
    """Return a figure of the centres' displacements over the array, as arrows, oriented as on the sensor.

    Parameters
    ----------
    row : Row
    name : str
        Name of the map.
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
        # Start the scale at zero: otherwise equal displacements get colours that show only rounding errors.
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
    """Return a preview as a data URL."""
    import PIL.Image

    stream = io.BytesIO()
    PIL.Image.fromarray(preview).save(stream, format="PNG")
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode()


def _values(rows: Sequence[Row], column: Column) -> tuple[Array, Array]:
    """Return values and standard errors; infinite values, such as the PSNR of equal images, become NaN."""
    y = np.array([row.estimates[column.name].value for row in rows])
    error = np.array([row.estimates[column.name].stderr for row in rows])
    return np.where(np.isfinite(y), y, np.nan), error


def _panels(draws: Sequence[tuple[str, Callable[[Any], None]]], title: str) -> str:
    """Return a figure of panels, each with a title above and the axis's title below.

    The space for labels follows from their lines: matplotlib's layout would take as long as drawing.

    Parameters
    ----------
    draws : sequence of (str, callable)
        Title of each panel, and the function that draws it.
    title : str
        Title of the horizontal axis.
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
    """Tell whether the numbers on the left have more digits than fit."""
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
    """Return a figure as a self-contained SVG element."""
    import matplotlib as mpl
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    # Users may write $ and ^ in labels and names.
    style: dict[Any, Any] = {"font.family": "sans-serif", "font.size": 9, "text.parse_math": False}
    with mpl.rc_context({**style, "svg.fonttype": "none", "svg.hashsalt": title}):
        figure = Figure(figsize=size, layout=layout)
        FigureCanvasSVG(figure)
        draw(figure)
        stream = io.StringIO()
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    return inline_svg(stream.getvalue())
