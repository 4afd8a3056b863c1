"""The layout drawing: what `layout` found, on one sheet, as SVG, PNG or PDF.

The sheet is laid out in inches: three views, each to scale, with bands round them for labels and dimensions, over a
title block. Text is measured before it is placed, so that it does not overlap.
"""

import math
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle
from matplotlib.text import Text

from lfmesh.files.whole import write_whole
from lfmesh.geometry.frame import points
from lfmesh.geometry.lens.element_poses import pose_of
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.scene import Scene
from lfmesh.scene.first_order.lenslets import LensletSection
from lfmesh.scene.first_order.report import STANDARD
from lfmesh.scene.first_order.solve import lenslet_focal_length_mm
from lfmesh.view.figure_file import checked_kind, encoded_figure
from lfmesh.view.layout.content import Bundle, Dimension, Layout, TargetSection, layout
from lfmesh.view.layout.sections import in_section
from lfmesh.view.rays.names import label

SHEET_IN = (13.0, 9.4)
MARGIN_IN = 0.3
HEADER_IN = 0.42
MAIN_IN = 3.75
TITLE_BLOCK_IN = 0.86
GAP_IN = 0.12

FIELD_COLOURS = ("#1f4e8c", "#2a7f62", "#b4541a")
LENSLET_COLOURS = ("#6f93c4", "#1f4e8c", "#6f93c4")
INK, GREY, PALE = "#222222", "#666666", "#aaaaaa"
GLASS, TARGET = "#8fb8de", "#d9d2c5"

SMALL, NORMAL, LARGE = 7.0, 8.0, 12.0
"""Sizes of text, points."""

LEAST_TEXT = 5.0
"""Text that is longer than its cell shrinks to this, then is cut."""

CLEARANCE_IN = 0.06
"""Round texts: fonts of other viewers may be a little wider."""

APART_IN = 0.16
"""Between names that stand side by side."""

ROW_IN = 0.2
"""Of dimensions."""

LEAD = 0.35
"""Length of the beam before the lens that the main view shows, over the camera's, ..."""

NEAR = 0.8
"""... unless the object plane lies as near as this."""

FARTHER = 1.6
"""The object side is drawn as far as the refocus range goes, unless that is so many times what else there is."""

BAR_IN = 1.4
"""Length that a scale bar does not exceed."""

STYLE: Any = {
    "font.family": ["DejaVu Sans", "sans-serif"],
    "svg.fonttype": "none",
    "svg.hashsalt": "lfmesh",
    "pdf.fonttype": 42,
    "text.parse_math": False,
    "path.simplify": False,
}


def draw(scene: Scene, path: str | Path = "layout.svg") -> Path:
    """Draw a scene's layout: the meridional section with real rays, the object side, and the array close up.

    Parameters
    ----------
    scene : Scene
    path : str or Path
        Ends in .svg, .png or .pdf. The same scene makes the same bytes. It is written whole or
        not at all.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    LfmeshError
        The ending is not one of these, the file cannot be written, or the scene cannot be built.
    """
    path = Path(path)
    kind = checked_kind(path, "a drawing")
    write_whole(path, encoded(layout(scene), kind))
    return path


def encoded(drawn: Layout, kind: str) -> bytes:
    """Return a layout as the bytes of an svg, png or pdf file."""
    with _style():
        return encoded_figure(sheet_figure(drawn), kind, drawn.scene.name or "layout")


@contextmanager
def _style() -> Iterator[None]:
    with mpl.rc_context(STYLE), warnings.catch_warnings():
        # A name in a script that this font lacks: SVG viewers have others.
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        yield


def sheet_figure(drawn: Layout) -> Figure:
    """Return the whole sheet."""
    figure = Figure(figsize=SHEET_IN)
    FigureCanvasAgg(figure)
    sheet = Sheet(figure)
    width, height = SHEET_IN[0] - 2 * MARGIN_IN, SHEET_IN[1] - 2 * MARGIN_IN
    sheet.frame(MARGIN_IN, MARGIN_IN, width, height)
    _title_block(sheet, drawn, MARGIN_IN, MARGIN_IN, width, TITLE_BLOCK_IN)
    top = SHEET_IN[1] - MARGIN_IN - HEADER_IN
    _header(sheet, drawn, MARGIN_IN, top, width)
    x, inner = MARGIN_IN + GAP_IN, width - 2 * GAP_IN
    _main_view(sheet, drawn, (x, top - MAIN_IN, inner, MAIN_IN))
    bottom = MARGIN_IN + TITLE_BLOCK_IN + GAP_IN
    lower = top - MAIN_IN - GAP_IN - bottom
    if _object_reach(drawn) is None:
        _detail_view(sheet, drawn, (x, bottom, inner, lower))
    else:
        half = 0.5 * (inner - GAP_IN)
        _object_view(sheet, drawn, (x, bottom, half, lower))
        _detail_view(sheet, drawn, (x + half + GAP_IN, bottom, half, lower))
    return figure


class Sheet:
    """The paper: places text and lines in inches from its lower left corner."""

    def __init__(self, figure: Figure) -> None:
        self.figure = figure
        self.axes: Axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        self.axes.set(xlim=(0.0, SHEET_IN[0]), ylim=(0.0, SHEET_IN[1]))
        self.axes.axis("off")
        self._widths: dict[tuple[str, float, bool], float] = {}

    def text(self, x: float, y: float, words: str, size: float = NORMAL, **style: Any) -> Text:
        """Write words, on one baseline with others of the same y.

        Parameters
        ----------
        x, y : float, inches
        words : str
        size : float, points
        **style
            Of matplotlib's Text.
        """
        return self.axes.text(x, y, words, fontsize=size, **{"color": INK, "va": "baseline", **style})

    def line(self, x: Sequence[float], y: Sequence[float], **style: Any) -> None:
        """Draw a line through points."""
        self.axes.plot(x, y, **{"color": INK, "lw": 0.6, "solid_capstyle": "butt", **style})

    def break_marks(self, x: float, y: float, tall: float) -> None:
        """Draw two strokes across a horizontal line, the sign of something left out.

        Parameters
        ----------
        x, y : float, inches
            Their middle.
        tall : float, inches
        """
        for stroke in (x - 0.035, x + 0.035):
            self.line([stroke - 0.35 * tall, stroke + 0.35 * tall], [y - tall, y + tall], lw=0.8, zorder=4)

    def frame(self, x: float, y: float, width: float, height: float) -> None:
        """Draw a rectangle.

        Parameters
        ----------
        x, y : float, inches
            The lower left corner.
        width, height : float, inches
        """
        self.axes.add_patch(Rectangle((x, y), width, height, fill=False, ec=INK, lw=0.8))

    def width(self, words: str, size: float = NORMAL, bold: bool = False) -> float:
        """Return the width of words, inches.

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
        """Return words and the text size at which they fit into some room: smaller, then cut.

        Parameters
        ----------
        words : str
        room : float, inches
        size : float, points
            The largest.
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
    """Room round what a view shows, for labels and dimensions, inches."""

    left: float = 0.1
    right: float = 0.1
    bottom: float = 0.3
    top: float = 0.55


class View:
    """A part of the sheet in which z and y, mm, are drawn to scale."""

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
        """Return the place of z and y on the sheet."""
        return self.x_middle + self.scale * (z - self.z_middle), self.up_middle + self.scale * (y - self.y_middle)

    def points(self, line: Array) -> Array:
        """Return (n, 2) points of z and y on the sheet."""
        return np.column_stack(self.at(line[:, 0], line[:, 1]))

    def lines(self, lines: Sequence[Array], **style: Any) -> None:
        """Draw lines, cut at the border of what the view shows."""
        drawn = LineCollection([self.points(line) for line in lines], **{"colors": INK, "linewidths": 0.7, **style})
        self.sheet.axes.add_collection(drawn, autolim=False)
        drawn.set_clip_path(self.clip)

    def area(self, line: Array, **style: Any) -> None:
        """Fill a closed outline."""
        drawn = Polygon(self.points(line), **{"closed": True, "ec": INK, "lw": 0.7, **style})
        self.sheet.axes.add_patch(drawn)
        drawn.set_clip_path(self.clip)

    def rays(self, bundles: Sequence[Bundle], colours: Sequence[str], width: float) -> None:
        """Draw the rays of bundles, each bundle in its colour.

        Parameters
        ----------
        bundles : sequence of Bundle
        colours : sequence of str
        width : float, points
            Of the lines.
        """
        for bundle, colour in zip(bundles, colours, strict=True):
            self.lines([ray.points[:, [2, 1]] for ray in bundle.rays], colors=colour, linewidths=width, zorder=3)

    def axis(self) -> None:
        """Draw the optical axis."""
        _, y = self.at(0.0, 0.0)
        if self.low <= y <= self.high:
            dashes = (0, (14, 3, 2, 3))
            self.sheet.line([self.left, self.right], [y, y], color=GREY, lw=0.5, ls=dashes, zorder=1.5)

    def _scale_bar(self) -> float:
        """Draw a bar of a round length above the view, at the right; return how wide it is with its text."""
        length = _nice_below(BAR_IN / self.scale)
        x, y, long = self.place[0] + self.place[2], self.place[1] + self.place[3] - 0.1, length * self.scale
        self.sheet.line([x - long, x], [y, y], lw=2.0)
        for end in (x - long, x):
            self.sheet.line([end, end], [y - 0.04, y + 0.04], lw=0.8)
        words = _length(length)
        self.sheet.text(x - long - 0.08, y - 0.04, words, SMALL, ha="right")
        return long + 0.08 + self.sheet.width(words, SMALL)

    def labels(self, anchors: Sequence[tuple[float, float, str]]) -> None:
        """Write names above the view, side by side, each with a line to its place (z, y)."""
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
        """Draw dimensions along the axis below the view, in as few rows as keep their texts apart."""
        taken: list[list[tuple[float, float]]] = []
        for dimension in dimensions:
            (x0, y0), (x1, y1) = self.at(*dimension.start), self.at(*dimension.end)
            wide = self.sheet.width(dimension.text, SMALL) + 2 * CLEARANCE_IN
            # Break marks at the start of a dimension take room, too.
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
        """Draw the line and its arrows: between its ends, or pointing at them from outside where there is no room."""
        middle = 0.5 * (x0 + x1)
        if cut:
            self.sheet.line([x0, middle], [y, y], lw=0.5)
            self.sheet.break_marks(x0 + 0.16, y, 0.05)
            self._arrow((middle, y), (x1, y))
            return
        for tail, tip in [(x0 - 0.14, x0), (x1 + 0.14, x1)] if outside else [(middle, x0), (middle, x1)]:
            self._arrow((tail, y), (tip, y))

    def _arrow(self, tail: tuple[float, float], tip: tuple[float, float]) -> None:
        style = {"arrowstyle": "-|>,head_width=0.1,head_length=0.25", "color": INK, "shrinkA": 0, "shrinkB": 0}
        self.sheet.axes.annotate("", tip, tail, arrowprops={**style, "lw": 0.5}, zorder=3.5)

    def heights(self, dimensions: Sequence[Dimension]) -> None:
        """Draw dimensions across the axis beside the view, on the side they lie nearer to."""
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
    """Return the first row in which a span touches no other, and book it there."""
    for number, taken in enumerate(rows):
        if all(b <= span[0] + 1e-9 or span[1] <= a + 1e-9 for a, b in taken):
            taken.append(span)
            return number
    rows.append([span])
    return len(rows) - 1


def spread(middles: Sequence[float], widths: Sequence[float], low: float, high: float) -> list[float]:
    """Return where texts of some widths stand side by side, each as near to its middle as the others let it.

    Parameters
    ----------
    middles : sequence of float
        In rising order.
    """
    # Groups that touch stand where their members' wishes are met on average.
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


def _header(sheet: Sheet, drawn: Layout, x: float, y: float, width: float) -> None:
    """Write the scene's name, and at the right which colour is which field point."""
    base, right = y + 0.14, x + width - 0.15
    for bundle, colour in list(zip(drawn.bundles, FIELD_COLOURS, strict=True))[::-1]:
        words = _field_words(bundle, drawn)
        right -= sheet.width(words, NORMAL)
        sheet.text(right, base, words, NORMAL)
        sheet.line([right - 0.38, right - 0.08], [base + 0.04] * 2, color=colour, lw=1.8)
        right -= 0.62
    title, size = sheet.fitted(drawn.scene.name or "layout", right - x - 0.2, LARGE, bold=True)
    sheet.text(x + 0.12, base, title, size, fontweight="bold")
    sheet.line([x, x + width], [y, y], lw=0.5)


def _field_words(bundle: Bundle, drawn: Layout) -> str:
    if bundle.slope == 0.0:
        return bundle.name
    if not 0.0 < drawn.distance_mm < math.inf:
        return f"{bundle.name}, {math.degrees(math.atan(bundle.slope)):.3g}°"
    return f"{bundle.name}, y = {bundle.slope * drawn.distance_mm:.4g} mm"


def _main_view(sheet: Sheet, drawn: Layout, place: tuple[float, float, float, float]) -> None:
    """Draw the camera in its meridional section, with a part of the beams before it."""
    camera = drawn.scene.camera
    ends = np.concatenate([drawn.sensor, *([] if drawn.mla is None else [drawn.mla])])
    outlines = np.concatenate([*_lens_lines(drawn), ends])
    front, back = float(outlines[:, 0].min()), float(outlines[:, 0].max())
    tall = 1.04 * float(max(np.abs(outlines[:, 1]).max(), 1.35 * drawn.stop[1]))
    lead = LEAD * (back - front)
    near = 0.0 < drawn.distance_mm <= NEAR * (back - front)
    start = -1.05 * drawn.distance_mm if near else front - lead
    window = start, back + 0.03 * (back - front), -tall, tall
    view = View(sheet, place, window, Bands(bottom=0.6, top=0.55, right=0.35), "Meridional section x = 0")
    view.axis()
    _draw_targets(view, drawn.targets)
    _draw_lens(view, drawn)
    view.rays(drawn.bundles, FIELD_COLOURS, 0.7)
    names = [(*_top([glass.outline]), f"L{i + 1}") for i, glass in enumerate(drawn.glass)]
    names += [(*_top(thin.lines), f"{label(thin.name)} f = {thin.focal_length_mm:.5g} mm") for thin in drawn.thin]
    names.append((float(drawn.stop[0]), 1.3 * float(drawn.stop[1]), f"stop ⌀ {2 * drawn.stop[1]:.4g} mm"))
    if drawn.mla is not None:
        names.append((*_top([drawn.mla]), "array"))
    names.append((*_top([drawn.sensor]), "sensor"))
    last, focus = camera.lens.vertices_mm[-1], np.zeros(2)
    behind = camera.mla.distance_mm if camera.mla is not None else camera.sensor.distance_mm
    chain = [(0.0, last), (last, last + (behind or 0.0))]
    dimensions = [Dimension(np.array([a, 0.0]), np.array([b, 0.0]), f"{b - a:.5g} mm") for a, b in chain if b > a]
    if near:
        names.append((-drawn.distance_mm, 0.8 * tall, "plane in focus"))
        view.lines([np.array([[-drawn.distance_mm, -tall], [-drawn.distance_mm, tall]])], linestyles="--", colors=GREY)
        dimensions.append(Dimension(np.array([-drawn.distance_mm, 0.0]), focus, _length(drawn.distance_mm, 5)))
    else:
        sheet.break_marks(view.left + 0.16, view.at(0.0, 0.0)[1], 0.09)
        dimensions.append(Dimension(np.array([start, 0.0]), focus, _distance_words(drawn), cut=True))
    view.labels(names)
    view.lengths(dimensions, view.low - 0.14)
    _mark_detail(view, drawn)


def _lens_lines(drawn: Layout) -> list[Array]:
    """Return the lines of all elements of the lens."""
    return [*(glass.outline for glass in drawn.glass), *(line for thin in drawn.thin for line in thin.lines)]


def _middle(outline: Array) -> float:
    return float(0.5 * (outline[:, 0].min() + outline[:, 0].max()))


def _distance_words(drawn: Layout) -> str:
    if math.isinf(drawn.distance_mm):
        return "plane in focus at infinity"
    if drawn.distance_mm < 0.0:
        return f"virtual object {_length(-drawn.distance_mm, 5)} behind"
    return f"plane in focus {_length(drawn.distance_mm, 5)} before"


def _draw_lens(view: View, drawn: Layout, line: float = 0.7) -> None:
    """Draw glass, stop, array and sensor."""
    for glass in drawn.glass:
        # Denser glass is darker.
        depth = float(np.clip(0.25 + 0.8 * (glass.refractive_index - 1.45), 0.2, 0.7))
        view.area(glass.outline, fc=(*mpl.colors.to_rgb(GLASS), depth), lw=line, zorder=2)
    for thin in drawn.thin:
        view.lines(thin.lines, linewidths=1.6 * line, zorder=3)
    z, rim = drawn.stop
    bar = 0.06 * rim
    ticks = [np.array([[z, side * rim], [z, side * 1.3 * rim]]) for side in (-1.0, 1.0)]
    feet = [np.array([[z - bar, side * rim], [z + bar, side * rim]]) for side in (-1.0, 1.0)]
    lens = drawn.scene.camera.lens
    pose = pose_of(lens, lens.stop_index or 0)
    marks = [in_section(points(pose, np.column_stack([np.zeros(2), p[:, 1], p[:, 0]]))) for p in ticks + feet]
    view.lines(marks, linewidths=2.0 * line, zorder=4)
    if drawn.mla is not None:
        view.area(drawn.mla, fc=GLASS, lw=0.5 * line, zorder=2)
    if drawn.cover is not None:
        view.area(drawn.cover, fc=GLASS, lw=0.5 * line, zorder=2)
    view.lines([drawn.sensor], linewidths=2.2 * line, zorder=4)


def _draw_targets(view: View, targets: Sequence[TargetSection]) -> None:
    for target in targets:
        if target.closed:
            for line in target.lines:
                view.area(line, fc=GLASS if target.glass else TARGET, alpha=0.6 if target.glass else 1.0, zorder=1.2)
        else:
            view.lines(target.lines, linewidths=1.4, zorder=2)


def _mark_detail(view: View, drawn: Layout) -> None:
    """Draw the frame of the close-up, named A."""
    z0, z1, y0, y1 = drawn.detail.window
    (x0, low), (x1, high) = view.at(z0, y0), view.at(z1, y1)
    # A frame too small to see is drawn larger.
    half = max(0.07, 0.5 * (x1 - x0)), max(0.07, 0.5 * (high - low))
    x, y = 0.5 * (x0 + x1), 0.5 * (low + high)
    view.sheet.axes.add_patch(
        Rectangle((x - half[0], y - half[1]), 2 * half[0], 2 * half[1], fill=False, ec=INK, lw=0.7, zorder=5)
    )
    view.sheet.text(max(x + half[0], view.right) + 0.06, y - 0.05, "A", NORMAL + 1, fontweight="bold")


def _object_reach(drawn: Layout) -> float | None:
    """Return how far before the lens the object side reaches, mm; None where there is nothing to show."""
    ends = [-float(line[:, 0].min()) for target in drawn.targets for line in target.lines]
    if 0.0 < drawn.distance_mm < math.inf:
        ends.append(drawn.distance_mm)
    return max(ends, default=None) if ends and max(ends) > 0.0 else None


def _object_view(sheet: Sheet, drawn: Layout, place: tuple[float, float, float, float]) -> None:
    """Draw everything from the farthest target to the sensor."""
    reach = _object_reach(drawn) or 1.0
    outlines = _lens_lines(drawn)
    sections = [line for target in drawn.targets for line in target.lines]
    back = float(max(drawn.sensor[:, 0].max(), *(line[:, 0].max() for line in outlines)))
    finite = 0.0 < drawn.distance_mm < math.inf
    field = max(abs(b.slope) for b in drawn.bundles) * drawn.distance_mm if finite else 0.0
    tall = max(field, *(float(np.abs(line[:, 1]).max()) for line in outlines + sections))
    if math.isfinite(drawn.facts.far_mm) and drawn.facts.far_mm < FARTHER * reach:
        reach = max(reach, drawn.facts.far_mm)
    long = reach + back
    window = -reach - 0.03 * long, back + 0.03 * long, -1.08 * tall, 1.08 * tall
    view = View(sheet, place, window, Bands(bottom=0.75, top=0.6), "Object side")
    view.axis()
    _draw_targets(view, drawn.targets)
    _draw_lens(view, drawn, 0.4)
    view.rays(drawn.bundles, FIELD_COLOURS, 0.5)
    names = [(*_top(t.lines), t.name) for t in drawn.targets]
    names.append((*_top(outlines), "camera"))
    dimensions = []
    if finite:
        z = -drawn.distance_mm
        view.lines([np.array([[z, -1.05 * field], [z, 1.05 * field]])], linestyles="--", colors=GREY, zorder=2.5)
        names.append((z, 1.05 * field, "plane in focus"))
        dimensions.append(Dimension(np.array([z, 0.0]), np.zeros(2), _length(drawn.distance_mm, 5)))
    facts = drawn.facts
    if facts.near_mm < reach:
        far = min(facts.far_mm, reach + 0.03 * long)
        what = "refocus range" if facts.kind == STANDARD else "depth of field"
        until = _length(facts.far_mm) if math.isfinite(facts.far_mm) else "infinity"
        words = f"{what} {_length(facts.near_mm)} to {until}"
        dimensions.append(Dimension(np.array([-far, 0.0]), np.array([-facts.near_mm, 0.0]), words, far < facts.far_mm))
    view.labels(names)
    view.lengths(dimensions, view.low - 0.14)


def _top(lines: Sequence[Array]) -> tuple[float, float]:
    """Return z and y of the middle of the highest edge."""
    points = np.concatenate(lines)
    highest = float(points[:, 1].max())
    edge = points[points[:, 1] > highest - 1e-6 * np.ptp(points, axis=0).max()]
    return float(0.5 * (edge[:, 0].min() + edge[:, 0].max())), highest


def _detail_view(sheet: Sheet, drawn: Layout, place: tuple[float, float, float, float]) -> None:
    """Draw the close-up of array and sensor."""
    detail = drawn.detail
    bands = Bands(left=0.42, right=0.42, bottom=0.42 + ROW_IN * max(1, len(detail.lengths) - 1), top=0.6)
    view = View(sheet, place, detail.window, bands, "Detail A")
    words, size = sheet.fitted(detail.caption, place[2], SMALL)
    sheet.text(place[0], place[1] + 0.04, words, size, color=GREY)
    view.axis()
    if detail.plate is not None:
        view.area(detail.plate, fc=(*mpl.colors.to_rgb(GLASS), 0.45), lw=0.7, zorder=2)
    if drawn.cover is not None:
        view.area(drawn.cover, fc=(*mpl.colors.to_rgb(GLASS), 0.3), lw=0.7, zorder=2)
    colours = LENSLET_COLOURS if len(detail.bundles) == 3 else FIELD_COLOURS[:1] * len(detail.bundles)
    view.rays(detail.bundles, colours, 0.6)
    view.lines([detail.sensor], linewidths=1.4, zorder=4)
    view.lines(list(detail.pixels), linewidths=0.5, zorder=4)
    top = detail.window[3]
    names = [(_middle(detail.sensor), top, f"sensor, pixels {_length(drawn.scene.camera.sensor.pixel_mm)}")]
    if detail.plate is not None:
        names.append((_middle(detail.plate), top, "microlens array"))
    view.labels(names)
    view.heights(detail.heights)
    view.lengths(detail.lengths, view.low - 0.14)


def _title_block(sheet: Sheet, drawn: Layout, x: float, y: float, width: float, height: float) -> None:
    """Write the table of what the drawing shows, at the foot of the sheet."""
    rows = _facts(drawn)
    tall = height / len(rows)
    for i, row in enumerate(rows):
        base = y + height - (i + 1) * tall
        sheet.line([x, x + width], [base + tall] * 2, lw=0.5)
        shares = np.cumsum([0.0, *(share for share, *_ in row)]) / sum(share for share, *_ in row)
        for (_, name, value), left, right in zip(row, shares, shares[1:], strict=False):
            start, room = x + left * width, (right - left) * width - 0.16
            sheet.text(start + 0.08, base + tall - 0.14, name, LEAST_TEXT + 1.0, color=GREY)
            words, size = sheet.fitted(value, room)
            sheet.text(start + 0.08, base + 0.08, words, size)
            if left > 0.0:
                sheet.line([start, start], [base, base + tall], lw=0.5)


def _facts(drawn: Layout) -> list[list[tuple[float, str, str]]]:
    """Return the cells of the title block: share of the width, name, value."""
    scene, facts = drawn.scene, drawn.facts
    camera, mla, sensor = scene.camera, scene.camera.mla, scene.camera.sensor
    full = drawn.bundles[-1].slope
    pupil = facts.entrance_pupil_z_mm if math.isfinite(facts.entrance_pupil_z_mm) else 0.0
    real = 0.0 < drawn.distance_mm < math.inf
    angle = math.degrees(math.atan(full * drawn.distance_mm / (drawn.distance_mm + pupil) if real else full))
    size = f"±{abs(full * drawn.distance_mm):.4g} mm, " if real else ""
    focus = "infinity" if math.isinf(drawn.distance_mm) else _length(drawn.distance_mm, 5)
    first = [
        (2.4, "lens", camera.lens.name or f"{len(camera.lens.surfaces)} surfaces"),
        (1.2, "effective focal length", f"{facts.efl_mm:.5g} mm"),
        (1.0, "working f-number", f"f/{facts.working_f_number:.3g}"),
        (1.2, "plane in focus", focus),
        (1.8, "field in y", f"{size}±{abs(angle):.3g}°"),
        (1.0, "magnification", f"{facts.magnification:.4g}".replace("-", "−")),
        (1.0, "wavelength", f"{facts.wavelength_nm:g} nm"),
    ]
    pixels = f"{sensor.pixels[0]} × {sensor.pixels[1]} pixels of {_length(sensor.pixel_mm)}"
    if mla is None:
        return [first, [(4.0, "microlens array", "none: a conventional camera"), (4.0, "sensor", pixels)]]
    profile = f" {mla.profile_words}," if mla.profile_words else ", curved side"
    focal = ", ".join(f"{f:.4g}" for f in lenslet_focal_length_mm(mla, facts.wavelength_nm))
    shape = ", both faces curved" if mla.has_back else f"{profile} to the {mla.curved_side}"
    micro = f"{facts.micro_image_diameter_px:.3g} px, every {facts.micro_image_pitch_px:.5g} px"
    number = f"f/{facts.microlens_f_number:.3g}"
    if len(facts.lenslet_sections) > 1:
        bent = [at for at in facts.lenslet_sections if at.f_number is not None]
        number = ", ".join(f"{at.section}: f/{at.f_number:.3g}" for at in bent)
        micro = ", ".join(f"{at.section}: {_micro_image(at)}" for at in facts.lenslet_sections)
        focal = ", ".join(f"{at.section}: {at.focal_length_mm:.4g}" for at in facts.lenslet_sections)
    second = [
        (2.4, "microlens array", f"{mla.count[0]} × {mla.count[1]} {mla.layout}{shape}"),
        (1.2, "pitch", _length(mla.pitch_mm)),
        (1.8, "lenslet focal length", f"{focal} mm"),
        (1.2, "lenslet f-number", number),
        (1.4, "micro-image", micro),
        (2.0, "sensor", pixels),
    ]
    return [first, second]


def _micro_image(at: LensletSection) -> str:
    """Write how wide a micro-image is in one section of the lenslets."""
    return "a line" if at.micro_image_diameter_px is None else f"{at.micro_image_diameter_px:.3g} px"


def _length(length_mm: float, digits: int = 4) -> str:
    """Write a length in the unit that suits it."""
    if length_mm < 0.0:
        return f"−{_length(-length_mm, digits)}"
    if length_mm >= 1e4:
        return f"{1e-3 * length_mm:.4g} m"
    return f"{length_mm:.{digits}g} mm" if length_mm >= 1.0 else f"{1e3 * length_mm:.4g} µm"


def _round(ratio: float) -> str:
    """Write the number of a scale to three digits, without an exponent."""
    digits = 2 - math.floor(math.log10(ratio))
    return (
        f"{round(ratio, digits):.{max(0, digits)}f}".rstrip("0").rstrip(".")
        if digits > 0
        else f"{round(ratio, digits):.0f}"
    )


def _nice_below(length: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not above a length."""
    power = 10.0 ** math.floor(math.log10(length))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= length)
