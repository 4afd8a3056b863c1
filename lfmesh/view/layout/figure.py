"""Layout drawing: the content from `layout` on one sheet, as SVG, PNG or PDF.

Above a title block stand three views to scale, surrounded by bands for labels and dimensions, in inches. Text is
measured before placement to prevent overlap.
"""

import math
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from lfmesh.files.whole import write_whole
from lfmesh.geometry.frame import points
from lfmesh.geometry.lens.element_poses import pose_of
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.scene import Scene
from lfmesh.scene.first_order.report import STANDARD
from lfmesh.view.figure_file import checked_kind, encoded_figure
from lfmesh.view.layout.content import Bundle, Dimension, Layout, TargetSection, layout
from lfmesh.view.layout.media_sections import MediumSection
from lfmesh.view.layout.sections import in_section
from lfmesh.view.layout.sheet import (
    LARGE,
    NORMAL,
    ROW_IN,
    SHEET_IN,
    SMALL,
    Bands,
    Sheet,
    View,
    length_in_words,
)
from lfmesh.view.layout.title_block import title_block
from lfmesh.view.rays.names import label
from lfmesh.view.style import FIELD_COLOURS, GREY, INK, PAPER

MARGIN_IN = 0.3
HEADER_IN = 0.42
MAIN_IN = 3.75
TITLE_BLOCK_IN = 0.86
GAP_IN = 0.12

LENSLET_COLOURS = ("#6f93c4", FIELD_COLOURS[0], "#6f93c4")
GLASS, TARGET, DIFFRACTIVE = "#8fb8de", "#d9d2c5", "#8a4fb0"

EVERYWHERE, BODY = 0.15, 0.3
"""Opacity of a uniform medium without bounds, and of one with bounds."""


LEAD = 0.35
"""Length of the beam before the lens in the main view, relative to the camera's, ..."""

NEAR = 0.8
"""... unless the object plane is as near as this."""

FARTHER = 1.6
"""The object side extends to the far end of the refocus range if this is less than so many times its other content."""


STYLE: Any = {**PAPER, "path.simplify": False}


def draw(scene: Scene, path: str | Path = "layout.svg") -> Path:
    """Draw a scene's layout: the meridional section with real rays, the object side, and a close-up of the array.

    Parameters
    ----------
    scene : Scene
    path : str or Path
        Ends in .svg, .png or .pdf. The file is written completely or not at all; its bytes are reproducible.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    LfmeshError
        The extension is invalid, the file cannot be written, or the scene cannot be built.
    """
    path = Path(path)
    kind = checked_kind(path, "a drawing")
    write_whole(path, encoded(layout(scene), kind))
    return path


def encoded(drawn: Layout, kind: str) -> bytes:
    """Return a layout as the bytes of an svg, png or pdf file."""
    with _style():
        return encoded_figure(sheet_figure(drawn), kind, drawn.scene.title or "layout")


@contextmanager
def _style() -> Iterator[None]:
    with mpl.rc_context(STYLE), warnings.catch_warnings():
        # The font may lack a name's script; SVG viewers have other fonts.
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        yield


def sheet_figure(drawn: Layout) -> Figure:
    """Return the complete sheet."""
    figure = Figure(figsize=SHEET_IN)
    FigureCanvasAgg(figure)
    sheet = Sheet(figure)
    width, height = SHEET_IN[0] - 2 * MARGIN_IN, SHEET_IN[1] - 2 * MARGIN_IN
    sheet.frame(MARGIN_IN, MARGIN_IN, width, height)
    title_block(sheet, drawn, MARGIN_IN, MARGIN_IN, width, TITLE_BLOCK_IN)
    top = SHEET_IN[1] - MARGIN_IN - HEADER_IN
    _header(sheet, drawn, MARGIN_IN, top, width)
    x, inner = MARGIN_IN + GAP_IN, width - 2 * GAP_IN
    _main_view(sheet, drawn, (x, top - MAIN_IN, inner, MAIN_IN))
    bottom = MARGIN_IN + TITLE_BLOCK_IN + GAP_IN
    lower = top - MAIN_IN - GAP_IN - bottom
    if _object_reach(drawn) is None:
        _describe_media(sheet, drawn, (x, top - MAIN_IN, inner, MAIN_IN))
        _detail_view(sheet, drawn, (x, bottom, inner, lower))
    else:
        half = 0.5 * (inner - GAP_IN)
        _object_view(sheet, drawn, (x, bottom, half, lower))
        _detail_view(sheet, drawn, (x + half + GAP_IN, bottom, half, lower))
    return figure


def _header(sheet: Sheet, drawn: Layout, x: float, y: float, width: float) -> None:
    """Write the scene's name and, at the right, the colours of the field points."""
    base, right = y + 0.14, x + width - 0.15
    for bundle, colour in list(zip(drawn.bundles, FIELD_COLOURS, strict=True))[::-1]:
        words = _field_words(bundle, drawn)
        right -= sheet.width(words, NORMAL)
        sheet.text(right, base, words, NORMAL)
        sheet.line([right - 0.38, right - 0.08], [base + 0.04] * 2, color=colour, lw=1.8)
        right -= 0.62
    title, size = sheet.fitted(drawn.scene.title or "layout", right - x - 0.2, LARGE, bold=True)
    sheet.text(x + 0.12, base, title, size, fontweight="bold")
    sheet.line([x, x + width], [y, y], lw=0.5)


def _field_words(bundle: Bundle, drawn: Layout) -> str:
    if bundle.slope == 0.0:
        return bundle.name
    if not 0.0 < drawn.distance_mm < math.inf:
        return f"{bundle.name}, {math.degrees(math.atan(bundle.slope)):.3g}°"
    return f"{bundle.name}, y = {bundle.slope * drawn.distance_mm:.4g} mm"


def _main_view(sheet: Sheet, drawn: Layout, place: tuple[float, float, float, float]) -> None:
    """Draw the camera's meridional section with part of the incident beams."""
    camera = drawn.scene.camera
    ends = np.concatenate([drawn.sensor, *([] if drawn.mla is None else [drawn.mla])])
    outlines = np.concatenate([*_lens_lines(drawn), ends])
    front, back = float(outlines[:, 0].min()), float(outlines[:, 0].max())
    tall = 1.04 * float(max(np.abs(outlines[:, 1]).max(), 1.35 * drawn.stop[1]))
    lead = LEAD * (back - front)
    near = 0.0 < drawn.distance_mm <= NEAR * (back - front)
    start = -1.05 * drawn.distance_mm if near else front - lead
    window = start, back + 0.03 * (back - front), -tall, tall
    title = "Meridional section x = 0"
    if drawn.diffractive:
        title += "; rays in " + ", ".join(f"{each.orders} of {label(each.name)}" for each in drawn.diffractive)
    view = View(sheet, place, window, Bands(bottom=0.6, top=0.55, right=0.35), title)
    view.axis()
    _draw_media(view, drawn.media, window)
    _draw_targets(view, drawn.targets)
    _draw_lens(view, drawn)
    view.rays(drawn.bundles, FIELD_COLOURS, 0.7)
    names = [
        (*_top([glass.outline]), f"L{i + 1}{' GRIN' if glass.is_gradient else ''}")
        for i, glass in enumerate(drawn.glass)
    ]
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
        dimensions.append(Dimension(np.array([-drawn.distance_mm, 0.0]), focus, length_in_words(drawn.distance_mm, 5)))
    else:
        sheet.break_marks(view.left + 0.16, view.at(0.0, 0.0)[1], 0.09)
        dimensions.append(Dimension(np.array([start, 0.0]), focus, _distance_words(drawn), cut=True))
    view.labels(names)
    view.lengths(dimensions, view.low - 0.14)
    _mark_detail(view, drawn)


def _lens_lines(drawn: Layout) -> list[Array]:
    """Return the lines of all lens elements."""
    return [
        *(glass.outline for glass in drawn.glass), *(line for thin in drawn.thin for line in thin.lines),
        *(each.line for each in drawn.diffractive),
    ]  # fmt: skip


def _middle(outline: Array) -> float:
    return float(0.5 * (outline[:, 0].min() + outline[:, 0].max()))


def _distance_words(drawn: Layout) -> str:
    if math.isinf(drawn.distance_mm):
        return "plane in focus at infinity"
    if drawn.distance_mm < 0.0:
        return f"virtual object {length_in_words(-drawn.distance_mm, 5)} behind"
    return f"plane in focus {length_in_words(drawn.distance_mm, 5)} before"


def _draw_lens(view: View, drawn: Layout, line: float = 0.7) -> None:
    """Draw glass, stop, array and sensor."""
    for glass in drawn.glass:
        # Denser glass is darker.
        depth = float(np.clip(0.25 + 0.8 * (glass.refractive_index - 1.45), 0.2, 0.7))
        view.area(glass.outline, fc=(*mpl.colors.to_rgb(GLASS), depth), lw=line, zorder=2)
    for thin in drawn.thin:
        view.lines(thin.lines, linewidths=1.6 * line, zorder=3)
    if drawn.diffractive:
        view.lines([each.line for each in drawn.diffractive], linewidths=2.2 * line, colors=DIFFRACTIVE, zorder=3)
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
        if target.at_end:
            view.lines(target.at_end, linewidths=0.7, linestyles=":", colors=GREY, zorder=1.3)


def _draw_media(view: View, media: Sequence[MediumSection], window: tuple[float, float, float, float]) -> None:
    """Draw media: as pictures of their amounts, or as areas; one without bounds over all space before the lens."""
    for section in media:
        colour = section.medium.colour
        if section.amounts is not None:
            view.picture(section.amounts, section.window, colour)
        elif section.is_everywhere:
            low, high = window[2:]
            everywhere = np.array([[window[0], low], [0.0, low], [0.0, high], [window[0], high]])
            view.area(everywhere, fc=colour, ec="none", alpha=EVERYWHERE, zorder=1.0)
        for line in section.lines:
            face = (*mpl.colors.to_rgb(colour), 0.0 if section.amounts is not None else BODY)
            view.area(line, fc=face, ec=colour, lw=0.6, ls=":", zorder=1.1)


def _mark_detail(view: View, drawn: Layout) -> None:
    """Draw the frame of the close-up, labelled A."""
    z0, z1, y0, y1 = drawn.detail.window
    (x0, low), (x1, high) = view.at(z0, y0), view.at(z1, y1)
    # Enlarge a frame that would be too small to see.
    half = max(0.07, 0.5 * (x1 - x0)), max(0.07, 0.5 * (high - low))
    x, y = 0.5 * (x0 + x1), 0.5 * (low + high)
    view.sheet.axes.add_patch(
        Rectangle((x - half[0], y - half[1]), 2 * half[0], 2 * half[1], fill=False, ec=INK, lw=0.7, zorder=5)
    )
    view.sheet.text(max(x + half[0], view.right) + 0.06, y - 0.05, "A", NORMAL + 1, fontweight="bold")


def _object_reach(drawn: Layout) -> float | None:
    """Return how far the object side extends before the lens, mm; None if it is empty."""
    ends = [-float(line[:, 0].min()) for line in _object_lines(drawn)]
    if 0.0 < drawn.distance_mm < math.inf:
        ends.append(drawn.distance_mm)
    return max(ends, default=None) if ends and max(ends) > 0.0 else None


def _object_lines(drawn: Layout) -> list[Array]:
    """Return the lines that the object side must show: of targets, and of media before or beside which these end.

    Fog that reaches far behind the targets would make them small, so its ends need not be seen.
    """
    lines = [line for target in drawn.targets for line in target.lines]
    sides = float(np.abs(np.concatenate([*lines, *_lens_lines(drawn)])[:, 1]).max())
    farthest = min((float(line[:, 0].min()) for line in lines), default=0.0)
    for section in drawn.media:
        if section.lines:
            points = np.concatenate(section.lines)
            is_seen = points[:, 0].max() > farthest and points[:, 1].max() > -sides and points[:, 1].min() < sides
            lines += [] if is_seen else section.lines
    return lines


def _media_names(
    media: Sequence[MediumSection], window: tuple[float, float, float, float]
) -> list[tuple[float, float, str]]:
    """Return z, y and names of media with a body, within the range of z of a view."""
    tops = [(*_top(section.lines), section.medium.name) for section in media if section.lines]
    return [(float(np.clip(z, window[0], window[1])), y, name) for z, y, name in tops]


def _describe_media(sheet: Sheet, drawn: Layout, place: tuple[float, float, float, float]) -> None:
    """Write names and amounts of the media at the bottom of a view."""
    if drawn.media:
        words, size = sheet.fitted("; ".join(section.in_words for section in drawn.media), place[2], SMALL)
        sheet.text(place[0], place[1] + 0.04, words, size, color=GREY)


def _object_view(sheet: Sheet, drawn: Layout, place: tuple[float, float, float, float]) -> None:
    """Draw everything from the farthest target to the sensor."""
    reach = _object_reach(drawn) or 1.0
    outlines = _lens_lines(drawn)
    sections = _object_lines(drawn)
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
    _draw_media(view, drawn.media, window)
    _draw_targets(view, drawn.targets)
    _draw_lens(view, drawn, 0.4)
    view.rays(drawn.bundles, FIELD_COLOURS, 0.5)
    names = [(*_top(t.lines), t.name) for t in drawn.targets]
    names += _media_names(drawn.media, window)
    _describe_media(sheet, drawn, place)
    names.append((*_top(outlines), "camera"))
    dimensions = []
    if finite:
        z = -drawn.distance_mm
        view.lines([np.array([[z, -1.05 * field], [z, 1.05 * field]])], linestyles="--", colors=GREY, zorder=2.5)
        names.append((z, 1.05 * field, "plane in focus"))
        dimensions.append(Dimension(np.array([z, 0.0]), np.zeros(2), length_in_words(drawn.distance_mm, 5)))
    facts = drawn.facts
    if facts.near_mm < reach:
        far = min(facts.far_mm, reach + 0.03 * long)
        what = "refocus range" if facts.kind == STANDARD else "depth of field"
        until = length_in_words(facts.far_mm) if math.isfinite(facts.far_mm) else "infinity"
        words = f"{what} {length_in_words(facts.near_mm)} to {until}"
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
    names = [(_middle(detail.sensor), top, f"sensor, pixels {length_in_words(drawn.scene.camera.sensor.pixel_mm)}")]
    if detail.plate is not None:
        names.append((_middle(detail.plate), top, "microlens array"))
    view.labels(names)
    view.heights(detail.heights)
    view.lengths(detail.lengths, view.low - 0.14)
