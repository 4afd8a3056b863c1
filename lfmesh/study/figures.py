"""The figures of the accuracy report, as SVG that stands by itself in a page.

matplotlib is imported inside the functions: a table needs none.
"""

import io
import re
from collections.abc import Callable, Sequence
from typing import Any

from lfmesh.study.image_efficiency import WAYS, ImageStudy
from lfmesh.study.lens_accuracy import LEVELS, LensRow

COLOURS = {"flat": "#b4541a", "smooth": "#c69214", "patch": "#2a7f62", "exact": "#1f4e8c"}
WAY_COLOURS = ("#8c8c8c", "#b4541a", "#c69214", "#2a7f62", "#1f4e8c")
MARKERS = {"flat": "s", "smooth": "^", "patch": "D", "exact": "o"}
WAY_MARKERS = ("s", "^", "v", "D", "o")

SIZE_IN = (7.2, 4.3)

LEAST_MM = 1e-16
"""Errors of exactly zero are drawn here."""


def error_against_triangles(rows: Sequence[LensRow], title: str, pixel_mm: float) -> str:
    """Return the figure of landing error against triangles a surface, with the slopes of the levels' orders."""

    def draw(axes: Any) -> None:
        for level in LEVELS:
            of_level = [row for row in rows if row.surface == level]
            if not of_level:
                continue
            x = [row.triangles for row in of_level]
            axes.plot(x, [max(row.rms_mm, LEAST_MM) for row in of_level], MARKERS[level] + "-", color=COLOURS[level])
            axes.plot(x, [max(row.max_mm, LEAST_MM) for row in of_level], ":", color=COLOURS[level], alpha=0.7)
            last = of_level[-1]
            axes.annotate(
                level, (x[-1], max(last.rms_mm, LEAST_MM)), xytext=(6, 0), textcoords="offset points",
                color=COLOURS[level], va="center",
            )  # fmt: skip
        _tenth_of_a_pixel(axes, pixel_mm)
        axes.set(xscale="log", yscale="log", xlabel="triangles a surface", ylabel="error where the ray lands / mm")
        low, high = axes.get_xlim()
        axes.set_xlim(low, high * 1.8)

    return _svg(draw, title)


def error_against_time(rows: Sequence[LensRow], title: str, pixel_mm: float) -> str:
    """Return the figure of landing error against the time of an event, level by level."""

    def draw(axes: Any) -> None:
        for level in LEVELS:
            of_level = [row for row in rows if row.surface == level]
            if not of_level:
                continue
            x = [1e9 / row.events_per_second for row in of_level]
            y = [max(row.rms_mm, LEAST_MM) for row in of_level]
            axes.plot(x, y, MARKERS[level] + "-", color=COLOURS[level], label=level)
            for row, at in zip(of_level, zip(x, y, strict=True), strict=True):
                axes.annotate(
                    f"{row.triangles:,}", at, xytext=(5, 4), textcoords="offset points", fontsize=7,
                    color=COLOURS[level],
                )  # fmt: skip
        _tenth_of_a_pixel(axes, pixel_mm)
        axes.set(yscale="log", xlabel="time of a ray-surface event / ns, one core", ylabel="rms error / mm")
        axes.legend(frameon=False)

    return _svg(draw, title)


def image_error_against_time(study: ImageStudy) -> str:
    """Return the figure of an image's relative error against processor time, one line a way to estimate it."""

    def draw(axes: Any) -> None:
        for way, colour, marker in zip(WAYS, WAY_COLOURS, WAY_MARKERS, strict=True):
            rows = study.of(way)
            if not rows:
                continue
            x, y = [row.seconds for row in rows], [row.mse**0.5 for row in rows]
            bars = [0.5 * row.mse_error / row.mse**0.5 for row in rows]
            axes.errorbar(x, y, yerr=bars, fmt=marker + "-", color=colour, label=way.name, capsize=2)
        axes.set(
            xscale="log", yscale="log", xlabel="processor time / s", ylabel="rms error of a pixel / rms of the image"
        )
        axes.legend(frameon=False)

    return _svg(draw, f"{study.scene}: error against time")


def _tenth_of_a_pixel(axes: Any, pixel_mm: float) -> None:
    axes.axhline(0.1 * pixel_mm, color="#666666", lw=0.8, ls="--")
    axes.annotate(
        "a tenth of a pixel", (0.01, 0.1 * pixel_mm), xycoords=("axes fraction", "data"), xytext=(0, 3),
        textcoords="offset points", fontsize=8, color="#666666",
    )  # fmt: skip


def _svg(draw: Callable[[Any], None], title: str) -> str:
    """Return a figure as an SVG element that loads nothing."""
    import matplotlib as mpl
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    # Text stays text, in the reader's font; a fixed salt makes the same figure from the same numbers.
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": title, "font.family": "sans-serif", "font.size": 9}):
        figure = Figure(figsize=SIZE_IN, layout="constrained")
        FigureCanvasSVG(figure)
        axes = figure.add_subplot()
        draw(axes)
        axes.set_title(title, fontsize=10)
        axes.grid(alpha=0.25, which="major")
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
        text = io.StringIO()
        figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    return _inline(text.getvalue())


def _inline(svg: str) -> str:
    """Return the <svg> element alone: inside HTML it needs no names of XML dialects, which look like addresses."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    return re.sub(r'\s+xmlns(:\w+)?="[^"]*"', "", svg).replace("xlink:href", "href")
