"""The figures of the accuracy report, on matplotlib axes and as self-contained SVG.

matplotlib is imported inside the functions: tables do not need it.
"""

import io
import re
from collections.abc import Callable, Sequence
from typing import Any

from lfmesh.accuracy.image_efficiency import WAYS, ImageRow
from lfmesh.accuracy.lens_accuracy import LEVELS, LensRow

COLOURS = {"flat": "#b4541a", "smooth": "#c69214", "patch": "#2a7f62", "exact": "#1f4e8c"}
WAY_COLOURS = ("#777777", "#b4541a", "#c69214", "#2a7f62", "#6aa2d8", "#1f4e8c")
MARKERS = {"flat": "s", "smooth": "^", "patch": "D", "exact": "o"}
WAY_MARKERS = ("s", "^", "v", "D", "o", "P")
GREY = "#666666"

SIZE_IN = (8.2, 4.4)
"""Size of a figure in the page; the text has the same width."""

LEAST_MM = 1e-16
"""Errors of exactly zero are drawn here."""


def draw_error_against_triangles(axes: Any, rows: Sequence[LensRow], pixel_mm: float) -> None:
    """Draw landing error against triangles per surface, rms and largest, one line per level.

    Parameters
    ----------
    axes : matplotlib Axes
    rows : sequence of LensRow
    pixel_mm : float, mm
        Pixel pitch; a tenth of it is marked.
    """
    from matplotlib.lines import Line2D

    for level, of_level in _by_level(rows):
        x = [row.triangles for row in of_level]
        style = {"color": COLOURS[level], "ms": 5}
        axes.plot(x, [max(row.rms_mm, LEAST_MM) for row in of_level], MARKERS[level] + "-", **style)
        axes.plot(x, [max(row.max_mm, LEAST_MM) for row in of_level], ":", color=COLOURS[level])
        axes.annotate(
            level, (x[-1], max(of_level[-1].rms_mm, LEAST_MM)), xytext=(8, 0), textcoords="offset points",
            color=COLOURS[level], va="center",
        )  # fmt: skip
    axes.set(xscale="log", yscale="log", xlabel="triangles per surface", ylabel="error where a ray lands / mm")
    _plain_counts(axes.xaxis)
    low, high = axes.get_xlim()
    # Make room for the levels' names.
    axes.set_xlim(low, high * (high / low) ** 0.1)
    _tenth_of_a_pixel(axes, pixel_mm)
    kinds = [Line2D([], [], color=GREY, ls=style) for style in ("-", ":")]
    axes.legend(kinds, ["rms", "largest"], frameon=False, loc="center right", bbox_to_anchor=(1.0, 0.3))


def draw_error_against_time(axes: Any, rows: Sequence[LensRow], pixel_mm: float) -> None:
    """Draw landing error against the time of an event, one line for each level, its coarsest and finest mesh named.

    Parameters
    ----------
    axes : matplotlib Axes
    rows : sequence of LensRow
    pixel_mm : float, mm
        Pitch of the sensor; a tenth of it is marked.
    """
    for level, of_level in _by_level(rows):
        x = [1e9 / row.events_per_second for row in of_level]
        y = [max(row.rms_mm, LEAST_MM) for row in of_level]
        axes.plot(x, y, MARKERS[level] + "-", color=COLOURS[level], label=level, ms=5, lw=1)
        ends = {0, len(of_level) - 1}
        for i in ends:
            # Put the labels on the outer sides of the line's ends, so that they do not overlap.
            right = x[i] >= max(x[j] for j in ends)
            axes.annotate(
                f"{of_level[i].triangles:,}", (x[i], y[i]), xytext=(7 if right else -7, 0), textcoords="offset points",
                ha="left" if right else "right", va="center", fontsize=8, color=COLOURS[level],
            )  # fmt: skip
    axes.set(yscale="log", xlabel="time of a ray-surface event on one core / ns", ylabel="rms error / mm")
    axes.margins(x=0.12)
    _tenth_of_a_pixel(axes, pixel_mm)
    axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5), title="numbers: triangles")


def draw_image_error(axes: Any, rows: Sequence[ImageRow], reference_error: float) -> None:
    """Draw an image's relative error against processor time, one line for each way to estimate it.

    Parameters
    ----------
    axes : matplotlib Axes
    rows : sequence of ImageRow
    reference_error : float
        Relative error of the reference itself.
    """
    for name, of_way, colour, marker in _by_way(rows):
        x, y = [row.seconds for row in of_way], [row.mse**0.5 for row in of_way]
        bars = [0.5 * row.mse_error / row.mse**0.5 for row in of_way]
        axes.errorbar(x, y, yerr=bars, fmt=marker + "-", color=colour, label=name, capsize=3, ms=5)
    axes.set(xscale="log", yscale="log", xlabel="processor time / s", ylabel="rms error of a pixel / rms of the image")
    _plain_counts(axes.xaxis)
    _plain_counts(axes.yaxis)
    _rule(axes, reference_error, "the reference's own error")
    axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))


def draw_efficiency(axes: Any, rows: Sequence[ImageRow]) -> None:
    """Draw each estimator's efficiency, from its largest run, as a bar with its standard error."""
    ways = list(_by_way(rows))
    values = [of_way[-1].efficiency for _, of_way, _, _ in ways]
    errors = [of_way[-1].efficiency_error for _, of_way, _, _ in ways]
    places = range(len(ways), 0, -1)
    axes.barh(
        places, values, xerr=errors, color=[colour for *_, colour, _ in ways], height=0.62, capsize=3, ecolor="#222222"
    )
    axes.set_yticks(list(places), [name for name, *_ in ways])
    axes.set(xscale="log", xlabel="efficiency 1/(MSE · time), 1/s")
    for place, value in zip(places, values, strict=True):
        axes.annotate(f"{value:.2g}", (value, place), xytext=(9, 0), textcoords="offset points", va="center")
    low, high = min(values), max(values)
    axes.set_xlim(0.3 * low, high * (high / low) ** 0.1 * 1.5)
    axes.tick_params(axis="y", length=0)


def error_against_triangles(rows: Sequence[LensRow], title: str, pixel_mm: float) -> str:
    """Return the figure of `draw_error_against_triangles` as SVG.

    Parameters
    ----------
    rows : sequence of LensRow
    title : str
    pixel_mm : float, mm
        Pitch of the sensor; a tenth of it is marked.
    """
    return _svg(lambda axes: draw_error_against_triangles(axes, rows, pixel_mm), title)


def error_against_time(rows: Sequence[LensRow], title: str, pixel_mm: float) -> str:
    """Return the figure of `draw_error_against_time` as SVG.

    Parameters
    ----------
    rows : sequence of LensRow
    title : str
    pixel_mm : float, mm
        Pitch of the sensor; a tenth of it is marked.
    """
    return _svg(lambda axes: draw_error_against_time(axes, rows, pixel_mm), title)


def image_error_against_time(rows: Sequence[ImageRow], title: str, reference_error: float) -> str:
    """Return the figure of `draw_image_error` as SVG.

    Parameters
    ----------
    rows : sequence of ImageRow
    title : str
    reference_error : float
        Relative error of the reference itself.
    """
    return _svg(lambda axes: draw_image_error(axes, rows, reference_error), title)


def efficiency(rows: Sequence[ImageRow], title: str) -> str:
    """Return the figure of `draw_efficiency` as SVG."""
    return _svg(lambda axes: draw_efficiency(axes, rows), title, (SIZE_IN[0], 2.4))


def finish(axes: Any, title: str) -> None:
    """Apply the title and the style that all figures share."""
    axes.set_title(title, fontsize=10, loc="left")
    axes.grid(alpha=0.25, which="major")
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _by_level(rows: Sequence[LensRow]) -> list[tuple[str, list[LensRow]]]:
    levels = [(level, [row for row in rows if row.surface == level]) for level in LEVELS]
    return [(level, of_level) for level, of_level in levels if of_level]


def _by_way(rows: Sequence[ImageRow]) -> list[tuple[str, list[ImageRow], str, str]]:
    """Return the estimators' names, rows with a known error, colours and markers."""
    known = [row for row in rows if row.mse > 0.0]
    ways = [
        (way.name, [row for row in known if row.way == way.name], colour, marker)
        for way, colour, marker in zip(WAYS, WAY_COLOURS, WAY_MARKERS, strict=True)
    ]
    return [way for way in ways if way[1]]


def _tenth_of_a_pixel(axes: Any, pixel_mm: float) -> None:
    _rule(axes, 0.1 * pixel_mm, "a tenth of a pixel")


def _rule(axes: Any, value: float, words: str) -> None:
    """Draw a horizontal line with a label at its right end."""
    axes.axhline(value, color=GREY, lw=0.8, ls="--", zorder=0)
    axes.annotate(
        words, (0.995, value), xycoords=("axes fraction", "data"), xytext=(0, 2), textcoords="offset points",
        fontsize=8, color=GREY, ha="right", va="bottom",
    )  # fmt: skip


def _plain_counts(axis: Any) -> None:
    """Label a logarithmic axis with plain numbers such as 1,000 and 0.1, at 1, 2 and 5 of every decade."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=(1.0,)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.10g}"))
    low, high = sorted(axis.get_view_interval())
    if high < 200.0 * low:
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_minor_formatter(NullFormatter())


def _svg(draw: Callable[[Any], None], title: str, size: tuple[float, float] = SIZE_IN) -> str:
    """Return a figure as an SVG element that loads nothing."""
    import matplotlib as mpl
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    # Text stays text, in the reader's font; a fixed salt makes the output reproducible.
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": title, "font.family": "sans-serif", "font.size": 9}):
        figure = Figure(figsize=size, layout="constrained")
        FigureCanvasSVG(figure)
        axes = figure.add_subplot()
        draw(axes)
        finish(axes, title)
        text = io.StringIO()
        figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    return inline_svg(text.getvalue())


def inline_svg(svg: str) -> str:
    """Return the <svg> element alone, without XML namespaces: HTML does not need them, and they look like addresses."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    return re.sub(r'\s+xmlns(:\w+)?="[^"]*"', "", svg).replace("xlink:href", "href")
