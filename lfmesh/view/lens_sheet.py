"""Lens sheet: the results of `lf.analyse` as PDF, SVG, PNG or HTML.

Ray fans, path differences, spots and point spreads of three fields; longitudinal aberration, foci and distortion over
the field; lateral colour, illumination, wave and ray MTF; definitions. For a camera with an array also its light field:
cross-talk, and the MTF of photographs by depth and view.
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
from lfmesh.view.style import FIELD_COLOURS, GREY, INK, PAPER
from lfmesh.waves.wavefront import ACROSS as WAVEFRONT_ACROSS

SHEET_IN = (14.0, 15.6)
LIGHT_FIELD_IN = 5.0
"""Height of the light-field part."""

WHAT = "a lens sheet"
ENDINGS = (*PICTURES, ".html")

TEMPLATE = Path(__file__).parent / "templates" / "lens_sheet.html"

DEPTH_COLOURS = ("#8c1f1f", "#c46a1b", "#222222", "#2a7f8c", "#1f3a8c")
DEPTH_LINES = (":", "--", "-", "-.", (0, (5, 1, 1, 1, 1, 1)))
"""Line styles from the nearest plane to the farthest."""

WIDEST, NARROWEST = 2.2, 0.7
"""Line widths of the first and last wavelength: both are visible where they coincide."""

LEFT = 0.062
"""Left edge of the first panels, as a fraction of the width; long numbers and a label fit beside it."""

UM = 1e3
"""Micrometres per millimetre."""

DARKEST = 0.75
"""Factor that darkens the lines of bright wavelengths for paper."""

DEFINITION_COLUMNS, WIDE_COLUMNS = 66, 116
"""Characters per line in the definitions of the light field and of the lens."""

NOTE_COLUMNS = 30
"""Characters on a line of a note that fills one of six panels in a row."""

DARKEST_SPREAD = 1e-3
"""Point spread values below this fraction of the peak are black."""

STYLE: Any = {
    **PAPER,
    "font.size": 8.5,
    "axes.titlesize": 9.0,
    "axes.labelsize": 8.5,
    "axes.linewidth": 0.6,
    "lines.linewidth": 0.9,
    "legend.fontsize": 8.0,
    "legend.frameon": True,
    "legend.framealpha": 0.8,
    "legend.edgecolor": "none",
}


def draw_lens_sheet(analysis: LensAnalysis, path: str | Path = "sheet.pdf") -> Path:
    """Draw a lens sheet.

    Parameters
    ----------
    analysis : LensAnalysis
        From `lf.analyse`.
    path : str or Path
        Ends in .pdf, .svg, .png or .html. The file is written completely or not at all; its bytes are reproducible.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    FileError
        The extension is invalid, or the file cannot be written.
    """
    path = Path(path)
    kind = checked_kind(path, WHAT, ENDINGS)
    write_whole(path, _page(analysis) if kind == "html" else _picture(analysis, kind))
    return path


def check_sheet_path(path: str | Path) -> None:
    """Refuse a path where a lens sheet cannot be written, before the analysis.

    Raises
    ------
    FileError
        The extension or the folder is invalid.
    """
    checked_kind(Path(path), WHAT, ENDINGS)


def _picture(analysis: LensAnalysis, kind: str) -> bytes:
    with mpl.rc_context(STYLE):
        return encoded_figure(sheet_of(analysis), kind, analysis.name)


def _page(analysis: LensAnalysis) -> str:
    """Return a self-contained HTML page: the key figures as text, and the sheet."""
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
        5, 6, figure, left=LEFT, right=0.965, top=0.92, bottom=0.04, wspace=0.46, hspace=0.4,
        height_ratios=(1.0, 1.15, 1.15, 1.15, 1.5),
    )  # fmt: skip
    _header(figure, analysis)
    _fans(figure, grid, analysis)
    _path_fans([figure.add_subplot(grid[1, k]) for k in range(3)], analysis)
    _path_maps(figure, [figure.add_subplot(grid[1, 3 + k]) for k in range(3)], analysis)
    _spots([figure.add_subplot(grid[2, k]) for k in range(3)], analysis)
    _point_spreads([figure.add_subplot(grid[2, 3 + k]) for k in range(3)], analysis)
    over_field = grid[3, :].subgridspec(1, 5, wspace=0.36)
    for k, drawn in enumerate((_longitudinal, _foci, _distortion, _lateral, _illumination)):
        drawn(figure.add_subplot(over_field[0, k]), analysis)
    for k in range(3):
        _mtf(figure.add_subplot(grid[4, k]), analysis, k)
    missing = (f"no light field: {analysis.no_light_field}",) if analysis.no_light_field else ()
    _definitions(figure.add_subplot(grid[4, 3:]), (*DEFINITIONS, *analysis.orders, *missing), WIDE_COLUMNS)


def _light_field_part(figure: Any, light_field: LightFieldAnalysis) -> None:
    grid = GridSpec(1, 6, figure, left=LEFT, right=0.985, top=0.84, bottom=0.13, wspace=0.42)
    figure.text(LEFT, 0.94, f"Light field, {light_field.wavelength_nm:.1f} nm", fontsize=10, fontweight="bold")
    _crosstalk(figure.add_subplot(grid[0, 0]), light_field)
    for k, part in enumerate(light_field.parts):
        axes = figure.add_subplot(grid[0, 1 + k])
        for number, each in enumerate(light_field.photographs):
            at = "infinity" if math.isinf(each.distance_mm) else f"{each.distance_mm:.4g} mm"
            colour = DEPTH_COLOURS[number % len(DEPTH_COLOURS)]
            line = DEPTH_LINES[number % len(DEPTH_LINES)]
            axes.plot(light_field.frequencies_per_mm, each.mtf[k], color=colour, linestyle=line, label=at)
        axes.set_xlim(0.0, light_field.frequencies_per_mm[-1])
        axes.set_ylim(0.0, 1.0)
        axes.grid(visible=True, linewidth=0.3)
        axes.set_title(f"MTF of photographs, {part}")
        axes.set_xlabel("line pairs per mm, on the array")
        if light_field.photographs and k == len(light_field.parts) - 1:
            axes.legend(loc="upper right", title="plane")
    _definitions(figure.add_subplot(grid[0, 4:]), light_field.definitions, DEFINITION_COLUMNS)


def _crosstalk(axes: Axes, light_field: LightFieldAnalysis) -> None:
    place = np.arange(len(light_field.crosstalk))
    both = ([each.from_others for each in light_field.crosstalk], [each.to_others for each in light_field.crosstalk])
    for side, (shares, word) in enumerate(zip(both, ("from", "to"), strict=True)):
        bars = axes.bar(
            place + 0.4 * side - 0.2, 100.0 * np.array(shares), 0.38, label=f"{word} others", color=FIELD_COLOURS[side]
        )
        axes.bar_label(bars, fmt="%.2g", fontsize=8.0)
    axes.set_xticks(place, [f"{each.height_mm:.2f}" for each in light_field.crosstalk])
    axes.margins(y=0.3)
    axes.legend(loc="upper left")
    axes.set_title("micro-image cross-talk")
    axes.set_xlabel("lenslet from axis, mm")
    axes.set_ylabel("%")


def _header(figure: FigureBase, analysis: LensAnalysis) -> None:
    facts = analysis.first_order
    at = "infinity" if math.isinf(analysis.object_mm) else f"{analysis.object_mm:.5g} mm"
    figure.text(LEFT, 0.97, analysis.name, fontsize=15, fontweight="bold")
    figure.text(
        LEFT, 0.952,
        f"f = {facts.efl_mm:.3f} mm   working f/{facts.working_f_number:.2f}   object at {at}   "
        f"image plane z = {analysis.image_z_mm:z.3f} mm   Airy radius {UM * analysis.airy_radius_mm:.2f} µm",
        fontsize=10, color=GREY,
    )  # fmt: skip
    if words := analysis.focus_in_words:
        figure.text(LEFT, 0.939, words, color=GREY)
    for k, wavelength in enumerate(analysis.wavelengths_nm):
        figure.text(
            0.985 - 0.085 * (len(analysis.wavelengths_nm) - 1 - k), 0.952, f"— {wavelength:.1f} nm",
            color=_colours(analysis)[k], ha="right", fontsize=10, fontweight="bold",
        )  # fmt: skip


def _colours(analysis: LensAnalysis) -> list[tuple[float, float, float]]:
    """Return the line colour of each wavelength."""
    shown = DARKEST * spectral_srgb(np.array(analysis.wavelengths_nm, dtype=np.float64))
    return [(float(r), float(g), float(b)) for r, g, b in shown]


def _lines(analysis: LensAnalysis) -> list[dict[str, Any]]:
    """Return the line style of each wavelength, the first the widest and lowest."""
    widths = np.linspace(WIDEST, NARROWEST, len(analysis.wavelengths_nm)) if len(analysis.wavelengths_nm) > 1 else [0.9]
    return [{"color": colour, "linewidth": width} for colour, width in zip(_colours(analysis), widths, strict=True)]


def _field_names(analysis: LensAnalysis) -> list[str]:
    return [f"{height:.2f} mm" for height in analysis.heights_mm]


def _cross(axes: Axes) -> None:
    """Draw the two axes through the origin, with few ticks."""
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
            axes.set_title(f"{words} fan, {name}")
            drawn = [fan.sagittal_mm if side else fan.tangential_mm for fan in fans]
            if not np.isfinite(drawn).any():
                _say_why(axes, f"no fan: no ray through the stop's {'yx'[side]} axis passes the lens")
                continue
            _cross(axes)
            for fan, values, look in zip(fans, drawn, _lines(analysis), strict=True):
                axes.plot(fan.pupil, UM * values, **look)
            axes.set_xlim(-1.0, 1.0)
            axes.set_ylim(-1.05 * UM * largest or -1.0, 1.05 * UM * largest or 1.0)
            axes.set_xlabel("stop radius")
            axes.set_ylabel("µm")


def _spots(places: list[Axes], analysis: LensAnalysis) -> None:
    reach = UM * max(max(spot.reach_mm for spot in analysis.spots), analysis.airy_radius_mm)
    for axes, name, spot in zip(places, _field_names(analysis), analysis.spots, strict=True):
        # Random order, so that no wavelength covers another.
        order = np.random.default_rng(0).permutation(len(spot.place_mm))
        which = np.searchsorted(np.sort(analysis.wavelengths_nm), spot.wavelength_nm[order])
        colours = np.array(_colours(analysis))[np.argsort(analysis.wavelengths_nm)][which]
        x, y = UM * spot.place_mm[order].T
        axes.scatter(x, y, s=1.2, c=colours, linewidths=0.0, rasterized=True)
        axes.add_patch(Circle((0.0, 0.0), UM * analysis.airy_radius_mm, fill=False, color=INK, linewidth=0.7, zorder=3))
        axes.set_xlim(-1.05 * reach, 1.05 * reach)
        axes.set_ylim(-1.05 * reach, 1.05 * reach)
        axes.set_aspect("equal")
        axes.set_title(f"spot, {name}, {spot.passed:.0%} pass")
        from_chief = f"GEO {UM * spot.geo_mm:.2f}" if spot.has_chief else "no chief ray"
        axes.set_xlabel(f"µm   rms {UM * spot.rms_mm:.2f}, {from_chief}")


def _path_fans(places: list[Axes], analysis: LensAnalysis) -> None:
    known = [fan for waves in analysis.waves if not isinstance(waves, str) for fan in waves.fans]
    largest = max(
        (float(np.nanmax(np.abs(v), initial=0.0)) for fan in known for v in (fan.tangential_waves, fan.sagittal_waves)),
        default=0.0,
    )
    for axes, name, waves in zip(places, _field_names(analysis), analysis.waves, strict=True):
        axes.set_title(f"path difference, {name}")
        if isinstance(waves, str):
            _say_why(axes, f"no waves: {waves}")
            continue
        _cross(axes)
        for fan, look in zip(waves.fans, _lines(analysis), strict=True):
            axes.plot(fan.pupil, fan.tangential_waves, **look)
            axes.plot(fan.pupil, fan.sagittal_waves, **look, linestyle="--")
        axes.set_xlim(-1.0, 1.0)
        axes.set_ylim(-1.05 * largest or -1.0, 1.05 * largest or 1.0)
        axes.set_xlabel("stop radius; tang. —, sag. - -")
        axes.set_ylabel("waves")


def _path_maps(figure: FigureBase, places: list[Axes], analysis: LensAnalysis) -> None:
    for axes, name, waves in zip(places, _field_names(analysis), analysis.waves, strict=True):
        axes.set_title(f"wavefront, {name}, in waves")
        if isinstance(waves, str):
            _say_why(axes, f"no waves: {waves}")
            continue
        front = waves.wavefront
        number = np.round(0.5 * (front.pupil + 1.0) * WAVEFRONT_ACROSS - 0.5).astype(int)
        drawn = np.full((WAVEFRONT_ACROSS, WAVEFRONT_ACROSS), np.nan)
        drawn[number[:, 1], number[:, 0]] = front.opd_waves
        image = axes.imshow(drawn, origin="lower", extent=(-1.0, 1.0, -1.0, 1.0), cmap="viridis")
        figure.colorbar(image, ax=axes, fraction=0.04, pad=0.03, format="%.3g")
        axes.set_xticks([])
        axes.set_yticks([])
        axes.set_xlabel(f"rms {front.rms_waves:.3f}, P-V {front.pv_waves:.2f}, Strehl {front.strehl:.3f}")


def _point_spreads(places: list[Axes], analysis: LensAnalysis) -> None:
    reach = 1.05 * max(max(spot.reach_mm for spot in analysis.spots), 3.0 * analysis.airy_radius_mm)
    for axes, name, waves in zip(places, _field_names(analysis), analysis.waves, strict=True):
        axes.set_title(f"point spread, {name}, log")
        if isinstance(waves, str):
            _say_why(axes, f"no waves: {waves}")
            continue
        spread = waves.point_spread(reach)
        least = np.log10(DARKEST_SPREAD)
        axes.imshow(
            np.log10(np.maximum(spread / spread.max(), DARKEST_SPREAD)), origin="lower", cmap="inferno", vmin=least,
            vmax=0.0, extent=(-UM * reach, UM * reach, -UM * reach, UM * reach),
        )  # fmt: skip
        axes.add_patch(Circle((0.0, 0.0), UM * analysis.airy_radius_mm, fill=False, color="white", linewidth=0.7))
        axes.set_xlabel(f"µm; peak {spread.max():.3f} of light in phase")


def _say_why(axes: Axes, reason: str) -> None:
    """Write the reason for a missing picture."""
    axes.set_axis_off()
    axes.text(0.0, 0.9, textwrap.fill(reason, NOTE_COLUMNS), va="top", transform=axes.transAxes)


def _longitudinal(axes: Axes, analysis: LensAnalysis) -> None:
    _cross(axes)
    for foci, look in zip(analysis.zone_foci_mm, _lines(analysis), strict=True):
        axes.plot(foci, analysis.zones, **look)
    axes.set_ylim(0.0, 1.0)
    axes.set_title("longitudinal aberration, axis")
    axes.set_xlabel("focus from image plane, mm")
    axes.set_ylabel("stop radius")


def _foci(axes: Axes, analysis: LensAnalysis) -> None:
    _cross(axes)
    curves = analysis.curves
    for w, look in enumerate(_lines(analysis)):
        axes.plot(curves.tangential_mm[w], curves.height_mm, **look)
        axes.plot(curves.sagittal_mm[w], curves.height_mm, **look, linestyle="--")
    axes.set_ylim(0.0, curves.height_mm[-1])
    axes.set_title("foci: tangential —, sagittal - -")
    axes.set_xlabel("from image plane, mm")
    axes.xaxis.set_major_locator(MaxNLocator(3))  # long numbers
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
    for values, look in zip(curves.lateral_mm, _lines(analysis), strict=True):
        axes.plot(UM * values, curves.height_mm, **look)
    if len(analysis.wavelengths_nm) == 1:
        axes.text(0.05, 0.9, "needs several wavelengths", transform=axes.transAxes)
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


def _mtf(axes: Axes, analysis: LensAnalysis, field: int) -> None:
    frequencies, waves = analysis.frequencies_per_mm, analysis.waves[field]
    axes.plot(frequencies, analysis.diffraction_limit, color=INK, linestyle=":", label="diffraction limit")
    for side, (words, style) in enumerate((("tangential", "-"), ("sagittal", "--"))):
        colour = FIELD_COLOURS[side]
        if not isinstance(waves, str):
            axes.plot(
                frequencies, waves.mtf(frequencies, tangential=side == 0), color=colour, linestyle=style,
                linewidth=1.6, label=f"{words}, waves",
            )  # fmt: skip
        axes.plot(
            frequencies, analysis.mtf[field, side], color=colour, linestyle=style, linewidth=0.6, label=f"{words}, rays"
        )
    axes.set_xlim(0.0, frequencies[-1])
    axes.set_ylim(0.0, 1.0)
    axes.grid(visible=True, linewidth=0.3)
    if field == 0:
        axes.legend(loc="upper right")
    axes.set_title(f"MTF, {_field_names(analysis)[field]}")
    axes.set_xlabel("line pairs per mm")


def _definitions(axes: Axes, definitions: Sequence[str], columns: int) -> None:
    axes.set_axis_off()
    lines = [line for each in definitions for line in textwrap.wrap(each, columns, subsequent_indent="    ")]
    axes.text(0.0, 1.0, "\n".join(lines), va="top", fontsize=8.0, linespacing=1.3, transform=axes.transAxes)
