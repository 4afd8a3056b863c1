"""Sheet of a drawing: text and lines in inches, and views to scale.

Text is measured before placement to prevent overlap.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle
from matplotlib.text import Text

from lfmesh.geometry.meshes.mesh import Array
from lfmesh.view.layout.content import Bundle, Dimension
from lfmesh.view.style import GREY, INK, PALE

SHEET_IN = (13.0, 9.4)

SMALL, NORMAL, LARGE = 7.0, 8.0, 12.0
"""Text sizes, points."""

LEAST_TEXT = 5.0
"""Smallest size of text shrunk to fit its cell; longer text is cut."""

CLEARANCE_IN = 0.06
"""Clearance around texts, as other viewers' fonts may be slightly wider."""

APART_IN = 0.16
"""Spacing of names side by side."""

ROW_IN = 0.2
"""Row height of dimensions."""

BAR_IN = 1.4
"""Maximum length of a scale bar."""


class Sheet:
    """Drawing sheet; positions are in inches from its lower left corner."""

    def __init__(self, figure: Figure) -> None:
        self.figure = figure
        self.axes: Axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        self.axes.set(xlim=(0.0, SHEET_IN[0]), ylim=(0.0, SHEET_IN[1]))
        self.axes.axis("off")
        self._widths: dict[tuple[str, float, bool], float] = {}

    def text(self, x: float, y: float, words: str, size: float = NORMAL, **style: Any) -> Text:
        """Write text with its baseline at y.

        Parameters
        ----------
        x, y : float, inches
        words : str
        size : float, points
        **style
            Properties of matplotlib's Text.
        """
        return self.axes.text(x, y, words, fontsize=size, **{"color": INK, "va": "baseline", **style})

    def line(self, x: Sequence[float], y: Sequence[float], **style: Any) -> None:
        """Draw a line through points."""
        self.axes.plot(x, y, **{"color": INK, "lw": 0.6, "solid_capstyle": "butt", **style})

    def break_marks(self, x: float, y: float, tall: float) -> None:
        """Draw two strokes across a horizontal line, to mark an omission.

        Parameters
        ----------
        x, y : float, inches
            Centre of the marks.
        tall : float, inches
        """
        for stroke in (x - 0.035, x + 0.035):
            self.line([stroke - 0.35 * tall, stroke + 0.35 * tall], [y - tall, y + tall], lw=0.8, zorder=4)

    def frame(self, x: float, y: float, width: float, height: float) -> None:
        """Draw a rectangle.

        Parameters
        ----------
        x, y : float, inches
            Lower left corner.
        width, height : float, inches
        """
        self.axes.add_patch(Rectangle((x, y), width, height, fill=False, ec=INK, lw=0.8))

    def width(self, words: str, size: float = NORMAL, bold: bool = False) -> float:
        """Return the width of a text, inches.

        Parameters
        ----------
        words : str
        size : float, points
        bold : bool
        """
        key = words, size, bold
        if key not in self._widths:
            probe = self.axes.text(0, 0, words, fontsize=size, fontweight="bold" if bold else "normal")
            self._widths[key] = float(probe.get_window_extent().width / self.figure.dpi)
            probe.remove()
        return self._widths[key]

    def fitted(self, words: str, room: float, size: float = NORMAL, bold: bool = False) -> tuple[str, float]:
        """Return a text and its size that fit a given width: smaller, then cut.

        Parameters
        ----------
        words : str
        room : float, inches
        size : float, points
            Largest size.
        bold : bool
        """
        wide = self.width(words, size, bold)
        if wide <= room:
            return words, size
        shrunk = max(LEAST_TEXT, math.floor(10 * size * room / wide) / 10)
        while len(words) > 1 and self.width(words, shrunk, bold) > room:
            words = words.rstrip("…")[:-1].rstrip() + "…"
        return words, shrunk


@dataclass(frozen=True)
class Bands:
    """Room around a view for labels and dimensions, inches."""

    left: float = 0.1
    right: float = 0.1
    bottom: float = 0.3
    top: float = 0.55


class View:
    """Part of the sheet with z and y, mm, drawn to scale."""

    def __init__(
        self, sheet: Sheet, place: tuple[float, float, float, float], window: tuple[float, float, float, float],
        bands: Bands, title: str,
    ) -> None:  # fmt: skip
        self.sheet = sheet
        x, y, width, height = place
        z0, z1, y0, y1 = window
        room = width - bands.left - bands.right, height - bands.bottom - bands.top
        self.scale = min(room[0] / (z1 - z0), room[1] / (y1 - y0))
        self.place = place
        self.z_middle, self.y_middle = 0.5 * (z0 + z1), 0.5 * (y0 + y1)
        self.x_middle = x + bands.left + 0.5 * room[0]
        self.up_middle = y + bands.bottom + 0.5 * room[1]
        (left, low), (right, high) = self.at(z0, y0), self.at(z1, y1)
        self.left, self.right, self.low, self.high = left, right, low, high
        self.clip = Rectangle((left, low), right - left, high - low, transform=sheet.axes.transData)
        ratio = 25.4 * self.scale
        scale = f"{_round(ratio)} : 1" if ratio >= 1.0 else f"1 : {_round(1.0 / ratio)}"
        bar = self._scale_bar()
        words, size = sheet.fitted(f"{title}, scale {scale}", width - bar - 0.2, SMALL)
        sheet.text(x, y + height - 0.14, words, size, color=GREY)

    def at(self, z: Any, y: Any) -> tuple[Any, Any]:
        """Return the sheet position of z and y."""
        return self.x_middle + self.scale * (z - self.z_middle), self.up_middle + self.scale * (y - self.y_middle)

    def points(self, line: Array) -> Array:
        """Return (n, 2) points of z and y on the sheet."""
        return np.column_stack(self.at(line[:, 0], line[:, 1]))

    def lines(self, lines: Sequence[Array], **style: Any) -> None:
        """Draw lines, clipped to the view."""
        drawn = LineCollection([self.points(line) for line in lines], **{"colors": INK, "linewidths": 0.7, **style})
        self.sheet.axes.add_collection(drawn, autolim=False)
        drawn.set_clip_path(self.clip)

    def area(self, line: Array, **style: Any) -> None:
        """Fill a closed outline."""
        drawn = Polygon(self.points(line), **{"closed": True, "ec": INK, "lw": 0.7, **style})
        self.sheet.axes.add_patch(drawn)
        drawn.set_clip_path(self.clip)

    def picture(self, values: Array, window: tuple[float, float, float, float], colour: str) -> None:
        """Draw values from 0 to 1 as the opacity of a colour, clipped to the view; nothing beside it.

        Parameters
        ----------
        values : (h, w) float64
            From the lowest y and z on.
        window : tuple of float
            z from and to, y from and to, mm.
        colour : str
        """
        (x0, low), (x1, high) = self.at(window[0], window[2]), self.at(window[1], window[3])
        if x1 < self.left or x0 > self.right or high < self.low or low > self.high:
            return
        shown = np.empty((*values.shape, 4))
        shown[..., :3], shown[..., 3] = to_rgb(colour), values
        drawn = self.sheet.axes.imshow(
            shown, extent=(x0, x1, low, high), origin="lower", aspect="auto", interpolation="bilinear", zorder=1.1
        )
        drawn.set_clip_path(self.clip)

    def rays(self, bundles: Sequence[Bundle], colours: Sequence[str], width: float) -> None:
        """Draw the rays of bundles, one colour per bundle.

        Parameters
        ----------
        bundles : sequence of Bundle
        colours : sequence of str
        width : float, points
            Line width.
        """
        for bundle, colour in zip(bundles, colours, strict=True):
            self.lines([ray.line[:, [2, 1]] for ray in bundle.rays], colors=colour, linewidths=width, zorder=3)

    def axis(self) -> None:
        """Draw the optical axis."""
        _, y = self.at(0.0, 0.0)
        if self.low <= y <= self.high:
            dashes = (0, (14, 3, 2, 3))
            self.sheet.line([self.left, self.right], [y, y], color=GREY, lw=0.5, ls=dashes, zorder=1.5)

    def _scale_bar(self) -> float:
        """Draw a bar of round length above the view, at the right; return its width including text."""
        length = _nice_below(BAR_IN / self.scale)
        x, y, long = self.place[0] + self.place[2], self.place[1] + self.place[3] - 0.1, length * self.scale
        self.sheet.line([x - long, x], [y, y], lw=2.0)
        for end in (x - long, x):
            self.sheet.line([end, end], [y - 0.04, y + 0.04], lw=0.8)
        words = length_in_words(length)
        self.sheet.text(x - long - 0.08, y - 0.04, words, SMALL, ha="right")
        return long + 0.08 + self.sheet.width(words, SMALL)

    def labels(self, anchors: Sequence[tuple[float, float, str]]) -> None:
        """Write names side by side above the view, each with a line to its position (z, y)."""
        sheet, anchors = self.sheet, sorted(anchors)
        if not anchors:
            return
        places = [self.at(z, y) for z, y, _ in anchors]
        widths = [sheet.width(words, SMALL) + APART_IN for *_, words in anchors]
        middles = spread([x for x, _ in places], widths, self.place[0], self.place[0] + self.place[2])
        base = self.high + 0.2
        for (x, y), middle, (*_, words) in zip(places, middles, anchors, strict=True):
            sheet.text(middle, base, words, SMALL, ha="center")
            sheet.line([middle, x], [base - 0.05, min(y, self.high)], color=PALE, lw=0.5, zorder=1)

    def lengths(self, dimensions: Sequence[Dimension], first_row: float) -> None:
        """Draw axial dimensions below the view, in as few rows as keep their texts apart."""
        taken: list[list[tuple[float, float]]] = []
        for dimension in dimensions:
            (x0, y0), (x1, y1) = self.at(*dimension.start), self.at(*dimension.end)
            wide = self.sheet.width(dimension.text, SMALL) + 2 * CLEARANCE_IN
            # Include the break marks at the start of a dimension.
            marks = 0.3 * dimension.cut
            fits = wide < x1 - x0 - 0.16 - marks
            text_x = 0.5 * (x0 + marks + x1 - wide) if fits else x1 + 0.16
            left = x0 - 0.16 * (not dimension.cut) - wide
            if not fits and left > self.place[0] and (dimension.cut or text_x + wide > self.place[0] + self.place[2]):
                text_x = left
            span = min(x0, text_x) - 0.15 * (not fits), max(x1 + 0.15 * (not fits), text_x + wide)
            row = _free_row(taken, span)
            y = first_row - row * ROW_IN
            self._dimension_line(x0, x1, y, outside=not fits, cut=dimension.cut)
            for x, up in [(x0, y0), (x1, y1)][dimension.cut :]:
                self.sheet.line([x, x], [y - 0.04, max(up, self.low)], color=PALE, lw=0.4, zorder=1)
            self.sheet.text(
                text_x + CLEARANCE_IN, y - 0.035, dimension.text, SMALL,
                bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0}, zorder=4,
            )  # fmt: skip

    def _dimension_line(self, x0: float, x1: float, y: float, *, outside: bool, cut: bool) -> None:
        """Draw a dimension line with arrows between its ends, or outside pointing inwards if there is no room."""
        middle = 0.5 * (x0 + x1)
        if cut:
            # One line from end to end, as separate pieces may be drawn a pixel apart.
            self._arrow((x0, y), (x1, y))
            self.sheet.break_marks(x0 + 0.16, y, 0.05)
            return
        for tail, tip in [(x0 - 0.14, x0), (x1 + 0.14, x1)] if outside else [(middle, x0), (middle, x1)]:
            self._arrow((tail, y), (tip, y))

    def _arrow(self, tail: tuple[float, float], tip: tuple[float, float]) -> None:
        style = {"arrowstyle": "-|>,head_width=0.1,head_length=0.25", "color": INK, "shrinkA": 0, "shrinkB": 0}
        self.sheet.axes.annotate("", tip, tail, arrowprops={**style, "lw": 0.5}, zorder=3.5)

    def heights(self, dimensions: Sequence[Dimension]) -> None:
        """Draw transverse dimensions beside the view, on their nearer side."""
        for dimension in dimensions:
            (x0, y0), (x1, y1) = self.at(*dimension.start), self.at(*dimension.end)
            right = x0 > self.left + 0.7 * (self.right - self.left)
            x = self.right + 0.1 if right else self.left - 0.1
            for from_x, y in ((x0, y0), (x1, y1)):
                self.sheet.line([from_x, x], [y, y], color=PALE, lw=0.4, zorder=1)
            low, high, middle = min(y0, y1), max(y0, y1), 0.5 * (y0 + y1)
            fits = high - low > 0.3
            self._arrow((x, middle if fits else low - 0.14), (x, low))
            self._arrow((x, middle if fits else high + 0.14), (x, high))
            self.sheet.text(
                x + (0.05 if right else -0.05), middle if fits else high + 0.18, dimension.text, SMALL, rotation=90,
                va="center" if fits else "bottom", ha="left" if right else "right",
            )  # fmt: skip


def _free_row(rows: list[list[tuple[float, float]]], span: tuple[float, float]) -> int:
    """Return the first row with room for a span, and reserve it."""
    for number, taken in enumerate(rows):
        if all(b <= span[0] + 1e-9 or span[1] <= a + 1e-9 for a, b in taken):
            taken.append(span)
            return number
    rows.append([span])
    return len(rows) - 1


def spread(middles: Sequence[float], widths: Sequence[float], low: float, high: float) -> list[float]:
    """Return positions of texts side by side, each as near its preferred centre as possible.

    Parameters
    ----------
    middles : sequence of float
        Preferred centres in ascending order.
    """
    # Touching groups are placed at the mean of their members' preferences.
    groups: list[list[int]] = []
    starts: list[float] = []
    for i in range(len(middles)):
        groups.append([i])
        starts.append(0.0)
        while True:
            members = groups[-1]
            offsets = np.cumsum([0.0, *(widths[j] for j in members)])
            wish = np.mean([middles[j] - 0.5 * widths[j] - offsets[k] for k, j in enumerate(members)])
            starts[-1] = float(np.clip(wish, low, max(low, high - offsets[-1])))
            if len(groups) < 2 or starts[-2] + sum(widths[j] for j in groups[-2]) <= starts[-1]:
                break
            last = groups.pop()
            groups[-1] += last
            starts.pop()
    placed = []
    for start, members in zip(starts, groups, strict=True):
        for j in members:
            placed.append(start + 0.5 * widths[j])
            start += widths[j]
    return placed


def length_in_words(length_mm: float, digits: int = 4) -> str:
    """Format a length in a suitable unit."""
    if length_mm < 0.0:
        return f"−{length_in_words(-length_mm, digits)}"
    if length_mm >= 1e4:
        return f"{1e-3 * length_mm:.4g} m"
    return f"{length_mm:.{digits}g} mm" if length_mm >= 1.0 else f"{1e3 * length_mm:.4g} µm"


def _round(ratio: float) -> str:
    """Format a scale number to three digits, without an exponent."""
    digits = 2 - math.floor(math.log10(ratio))
    return (
        f"{round(ratio, digits):.{max(0, digits)}f}".rstrip("0").rstrip(".")
        if digits > 0
        else f"{round(ratio, digits):.0f}"
    )


def _nice_below(length: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that does not exceed a length."""
    power = 10.0 ** math.floor(math.log10(length))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= length)
