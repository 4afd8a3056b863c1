"""The lens sheet: what `lf.analyse` found, as PDF, SVG, PNG or HTML.

Ray fans and spots of three fields, longitudinal aberration, foci and distortion over the field, lateral colour,
illumination and the geometric MTF, with the definitions of all of them. Below, for a camera with an array, its light
field: cross-talk, and the MTF of photographs by depth and view.
"""

import math
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure, FigureBase
from matplotlib.gridspec import GridSpec
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator

from lfmesh.analysis.analysis import DEFINITIONS, LensAnalysis
from lfmesh.analysis.light_field import LightFieldAnalysis
from lfmesh.files.colour import spectral_srgb
from lfmesh.files.whole import write_whole
from lfmesh.templates import filled
from lfmesh.view.figure_file import PICTURES, checked_kind, encoded_figure, inline_svg

SHEET_IN = (14.0, 9.6)
LIGHT_FIELD_IN = 4.2
"""Height of the part on the light field."""

WHAT = "a lens sheet"
ENDINGS = (*PICTURES, ".html")

TEMPLATE = Path(__file__).parent / "templates" / "lens_sheet.html"

DEPTH_COLOURS = ("#8c1f1f", "#c46a1b", "#222222", "#2a7f8c", "#1f3a8c")
"""From the nearest plane to the farthest."""

FIELD_COLOURS = ("#1f4e8c", "#2a7f62", "#b4541a")
INK, GREY = "#222222", "#666666"

UM = 1e3
"""Micrometres in a millimetre."""

DARKEST = 0.75
"""Lines of light wavelengths are drawn this much darker than they look, to be seen on paper."""

DEFINITION_COLUMNS = 80

STYLE: Any = {
    "font.family": ["DejaVu Sans", "sans-serif"],
    "font.size": 7.0,
    "axes.titlesize": 7.5,
    "axes.labelsize": 7.0,
    "axes.linewidth": 0.6,
    "lines.linewidth": 0.9,
    "legend.fontsize": 6.5,
    "legend.frameon": False,
    "svg.fonttype": "none",
    "svg.hashsalt": "lfmesh",
    "text.color": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
}


def draw_lens_sheet(analysis: LensAnalysis, path: str | Path = "sheet.pdf") -> Path:
    """Draw a lens sheet.

    Parameters
    ----------
    analysis : LensAnalysis
        From `lf.analyse`.
    path : str or Path
        Ends in .pdf, .svg, .png or .html; it is written whole or not at all. The same analysis makes the same bytes.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    FileError
        The ending is not one of these, or the file cannot be written.
    """
    path = Path(path)
    kind = checked_kind(path, WHAT, ENDINGS)
    write_whole(path, _page(analysis) if kind == "html" else _picture(analysis, kind))
    return path


def check_sheet_path(path: str | Path) -> None:
    """Refuse a file that a lens sheet cannot be written to, before anything is analysed for it.

    Raises
    ------
    FileError
        The ending or the folder.
    """
    checked_kind(Path(path), WHAT, ENDINGS)


def _picture(analysis: LensAnalysis, kind: str) -> bytes:
    with mpl.rc_context(STYLE):
        return encoded_figure(sheet_of(analysis), kind, analysis.name)


def _page(analysis: LensAnalysis) -> str:
    """Return a page of HTML that stands by itself: the key figures as text, and the sheet."""
    drawn = Markup(inline_svg(_picture(analysis, "svg")))
    return filled(TEMPLATE, title=analysis.name, lines=analysis.lines(), drawn=drawn)


def sheet_of(analysis: LensAnalysis) -> Figure:
    """Return the sheet."""
    width, height = SHEET_IN
    if analysis.light_field is None:
        figure = Figure(figsize=SHEET_IN)
        FigureCanvasAgg(figure)
        _lens_part(figure, analysis)
        return figure
    figure = Figure(figsize=(width, height + LIGHT_FIELD_IN))
    FigureCanvasAgg(figure)
    parts: Any = figure.subfigures(2, 1, height_ratios=(height, LIGHT_FIELD_IN))
    _lens_part(parts[0], analysis)
    _light_field_part(parts[1], analysis.light_field)
    return figure


def _lens_part(figure: Any, analysis: LensAnalysis) -> None:
    grid = GridSpec(
        3, 6, figure, left=0.045, right=0.985, top=0.885, bottom=0.055, wspace=0.42, hspace=0.42,
        height_ratios=(1.0, 1.15, 1.15),
    )  # fmt: skip
    _header(figure, analysis)
    _fans(figure, grid, analysis)
    _spots([figure.add_subplot(grid[1, k]) for k in range(len(analysis.spots))], analysis)
    _longitudinal(figure.add_subplot(grid[1, 3]), analysis)
    _foci(figure.add_subplot(grid[1, 4]), analysis)
    _distortion(figure.add_subplot(grid[1, 5]), analysis)
    _lateral(figure.add_subplot(grid[2, 0]), analysis)
    _illumination(figure.add_subplot(grid[2, 1]), analysis)
    _mtf(figure.add_subplot(grid[2, 2:4]), analysis)
    missing = (f"no light field: {analysis.no_light_field}",) if analysis.no_light_field else ()
    _definitions(figure.add_subplot(grid[2, 4:]), (*DEFINITIONS, *missing))


def _light_field_part(figure: Any, light_field: LightFieldAnalysis) -> None:
    grid = GridSpec(1, 6, figure, left=0.045, right=0.985, top=0.84, bottom=0.13, wspace=0.42)
    figure.text(0.045, 0.94, f"Light field, {light_field.wavelength_nm:.1f} nm", fontsize=10, fontweight="bold")
    _crosstalk(figure.add_subplot(grid[0, 0]), light_field)
    for k, part in enumerate(light_field.parts):
        axes = figure.add_subplot(grid[0, 1 + k])
        for number, each in enumerate(light_field.photographs):
            at = "infinity" if math.isinf(each.distance_mm) else f"{each.distance_mm:.4g} mm"
            colour = DEPTH_COLOURS[number % len(DEPTH_COLOURS)]
            axes.plot(light_field.frequencies_per_mm, each.mtf[k], color=colour, label=at)
        axes.set_xlim(0.0, light_field.frequencies_per_mm[-1])
        axes.set_ylim(0.0, 1.0)
        axes.grid(visible=True, linewidth=0.3)
        axes.set_title(f"MTF of photographs, {part}")
        axes.set_xlabel("line pairs a mm, on the array")
        if light_field.photographs:
            axes.legend(loc="upper right", title="plane")
    _definitions(figure.add_subplot(grid[0, 4:]), light_field.definitions)


def _crosstalk(axes: Axes, light_field: LightFieldAnalysis) -> None:
    place = np.arange(len(light_field.crosstalk))
    both = ([each.from_others for each in light_field.crosstalk], [each.to_others for each in light_field.crosstalk])
    for side, (shares, word) in enumerate(zip(both, ("from", "to"), strict=True)):
        bars = axes.bar(
            place + 0.4 * side - 0.2, 100.0 * np.array(shares), 0.38, label=f"{word} others", color=FIELD_COLOURS[side]
        )
        axes.bar_label(bars, fmt="%.1f", fontsize=6.0)
    axes.set_xticks(place, [f"{each.height_mm:.2f} mm" for each in light_field.crosstalk])
    axes.margins(y=0.3)
    axes.legend(loc="upper left")
    axes.set_title("micro-image cross-talk")
    axes.set_xlabel("lenslet from axis")
    axes.set_ylabel("%")


def _header(figure: FigureBase, analysis: LensAnalysis) -> None:
    facts = analysis.first_order
    at = "infinity" if math.isinf(analysis.object_mm) else f"{analysis.object_mm:.5g} mm"
    figure.text(0.045, 0.955, analysis.name, fontsize=13, fontweight="bold")
    figure.text(
        0.045, 0.928,
        f"f = {facts.efl_mm:.3f} mm   f/{facts.working_f_number:.2f} at work   object at {at}   "
        f"image plane z = {analysis.image_z_mm:.3f} mm   Airy radius {UM * analysis.airy_radius_mm:.2f} µm",
        fontsize=8.5, color=GREY,
    )  # fmt: skip
    for k, wavelength in enumerate(analysis.wavelengths_nm):
        figure.text(
            0.985 - 0.075 * (len(analysis.wavelengths_nm) - 1 - k), 0.928, f"— {wavelength:.1f} nm",
            color=_colours(analysis)[k], ha="right", fontsize=8.5, fontweight="bold",
        )  # fmt: skip


def _colours(analysis: LensAnalysis) -> list[tuple[float, float, float]]:
    """Return the colour of each wavelength's lines."""
    shown = DARKEST * spectral_srgb(np.array(analysis.wavelengths_nm, dtype=np.float64))
    return [(float(r), float(g), float(b)) for r, g, b in shown]


def _field_names(analysis: LensAnalysis) -> list[str]:
    return [f"{height:.2f} mm" for height in analysis.heights_mm]


def _cross(axes: Axes) -> None:
    """Draw the two axes through the origin, and few ticks."""
    axes.axhline(0.0, color=GREY, linewidth=0.5)
    axes.axvline(0.0, color=GREY, linewidth=0.5)
    axes.xaxis.set_major_locator(MaxNLocator(4))
    axes.yaxis.set_major_locator(MaxNLocator(5))


def _fans(figure: FigureBase, grid: GridSpec, analysis: LensAnalysis) -> None:
    largest = max(
        float(np.nanmax(np.abs(values), initial=0.0))
        for fans in analysis.fans
        for fan in fans
        for values in (fan.tangential_mm, fan.sagittal_mm)
    )
    for f, (name, fans) in enumerate(zip(_field_names(analysis), analysis.fans, strict=True)):
        for side, words in enumerate(("tangential", "sagittal")):
            axes = figure.add_subplot(grid[0, 2 * f + side])
            _cross(axes)
            for fan, colour in zip(fans, _colours(analysis), strict=True):
                values = fan.sagittal_mm if side else fan.tangential_mm
                axes.plot(fan.pupil, UM * values, color=colour)
            axes.set_xlim(-1.0, 1.0)
            axes.set_ylim(-1.05 * UM * largest or -1.0, 1.05 * UM * largest or 1.0)
            axes.set_title(f"{words} fan, {name}")
            axes.set_xlabel("stop radius")
            axes.set_ylabel("µm")


def _spots(places: list[Axes], analysis: LensAnalysis) -> None:
    reach = UM * max(max(spot.geo_mm for spot in analysis.spots), analysis.airy_radius_mm)
    for axes, name, spot in zip(places, _field_names(analysis), analysis.spots, strict=True):
        for wavelength, colour in zip(analysis.wavelengths_nm, _colours(analysis), strict=True):
            mine = spot.wavelength_nm == wavelength
            axes.plot(*(UM * spot.place_mm[mine]).T, ".", color=colour, markersize=0.9, rasterized=True)
        axes.add_patch(Circle((0.0, 0.0), UM * analysis.airy_radius_mm, fill=False, color=INK, linewidth=0.7, zorder=3))
        axes.set_xlim(-1.05 * reach, 1.05 * reach)
        axes.set_ylim(-1.05 * reach, 1.05 * reach)
        axes.set_aspect("equal")
        axes.set_title(f"spot, {name}, {spot.passed:.0%} pass")
        axes.set_xlabel(f"µm   rms {UM * spot.rms_mm:.2f}, GEO {UM * spot.geo_mm:.2f}")


def _longitudinal(axes: Axes, analysis: LensAnalysis) -> None:
    _cross(axes)
    for foci, colour in zip(analysis.zone_foci_mm, _colours(analysis), strict=True):
        axes.plot(foci, analysis.zones, color=colour)
    axes.set_ylim(0.0, 1.0)
    axes.set_title("longitudinal aberration, axis")
    axes.set_xlabel("focus from image plane, mm")
    axes.set_ylabel("stop radius")


def _foci(axes: Axes, analysis: LensAnalysis) -> None:
    _cross(axes)
    curves = analysis.curves
    for w, colour in enumerate(_colours(analysis)):
        axes.plot(curves.tangential_mm[w], curves.height_mm, color=colour)
        axes.plot(curves.sagittal_mm[w], curves.height_mm, color=colour, linestyle="--")
    axes.set_ylim(0.0, curves.height_mm[-1])
    axes.set_title("foci: tangential —, sagittal - -")
    axes.set_xlabel("from image plane, mm")
    axes.set_ylabel("image height, mm")


def _distortion(axes: Axes, analysis: LensAnalysis) -> None:
    _cross(axes)
    curves = analysis.curves
    axes.plot(100.0 * curves.distortion, curves.height_mm, color=INK)
    widest = max(0.1, 110.0 * float(np.nanmax(np.abs(curves.distortion))))
    axes.set_xlim(-widest, widest)
    axes.set_ylim(0.0, curves.height_mm[-1])
    axes.set_title("distortion")
    axes.set_xlabel("%")
    axes.set_ylabel("image height, mm")


def _lateral(axes: Axes, analysis: LensAnalysis) -> None:
    _cross(axes)
    curves = analysis.curves
    for values, colour in zip(curves.lateral_mm, _colours(analysis), strict=True):
        axes.plot(UM * values, curves.height_mm, color=colour)
    axes.set_ylim(0.0, curves.height_mm[-1])
    axes.set_title("lateral colour")
    axes.set_xlabel("chief ray from primary, µm")
    axes.set_ylabel("image height, mm")


def _illumination(axes: Axes, analysis: LensAnalysis) -> None:
    curves = analysis.curves
    axes.plot(curves.height_mm, 100.0 * curves.illumination, color=INK)
    axes.set_xlim(0.0, curves.height_mm[-1])
    axes.set_ylim(0.0, max(105.0, 105.0 * float(np.nanmax(curves.illumination))))
    axes.grid(visible=True, linewidth=0.3)
    axes.set_title("relative illumination")
    axes.set_xlabel("image height, mm")
    axes.set_ylabel("%")


def _mtf(axes: Axes, analysis: LensAnalysis) -> None:
    for name, both, colour in zip(_field_names(analysis), analysis.mtf, FIELD_COLOURS, strict=True):
        axes.plot(analysis.frequencies_per_mm, both[0], color=colour, label=f"{name}, tangential")
        axes.plot(analysis.frequencies_per_mm, both[1], color=colour, linestyle="--", label="sagittal")
    axes.set_xlim(0.0, analysis.frequencies_per_mm[-1])
    axes.set_ylim(0.0, 1.0)
    axes.grid(visible=True, linewidth=0.3)
    axes.legend(loc="upper right", ncols=1)
    axes.set_title("geometric MTF, all wavelengths")
    axes.set_xlabel("line pairs a mm")


def _definitions(axes: Axes, definitions: Sequence[str]) -> None:
    axes.set_axis_off()
    lines = [line for each in definitions for line in textwrap.wrap(each, DEFINITION_COLUMNS, subsequent_indent="    ")]
    axes.text(0.0, 1.0, "\n".join(lines), va="top", fontsize=6.3, linespacing=1.35, transform=axes.transAxes)
