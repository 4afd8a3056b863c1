"""Results in notebooks and figures: upright pictures, physical scales, key figures in words.

Result classes inherit from `lfmesh.notebook`, where this module is registered.
"""

import io
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import singledispatch
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import PIL.Image
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.files.colour import srgb_encode, to_display
from lfmesh.files.preview import well_known, white_point
from lfmesh.lightfield.detector import Exposed
from lfmesh.lightfield.photographs.depth import DepthMap
from lfmesh.lightfield.photographs.depth_truth import DepthTruth
from lfmesh.lightfield.photographs.photograph import AllInFocus, FocalStack, Photograph
from lfmesh.lightfield.photographs.schlieren import Schlieren
from lfmesh.lightfield.views.field import LightField
from lfmesh.lightfield.views.upright import Upright
from lfmesh.notebook import in_notebook
from lfmesh.templates import filled
from lfmesh.transport.render.image import Image
from lfmesh.view.figure_file import encoded_figure
from lfmesh.view.key_figures import key_figures
from lfmesh.view.pictures import coloured, file_url
from lfmesh.waves.point_spread import PointSpread
from lfmesh.waves.wavefront import Wavefront

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TEMPLATE = Path(__file__).parent / "templates" / "result.html"

LARGEST_PX, SMALLEST_PX = 360, 200
"""Longest side to which notebook pictures are reduced, and to which the pixels of small ones are enlarged."""

MOST_PLANES = 5
"""Most photographs of a focal stack in a figure."""

PANEL_IN = 4.4
"""Width of a panel in a figure, inches."""

DECADES = 4.0
"""Decades below the brightest sample in the picture of a point spread."""

GAMMA = 1.0 / 2.2
"""Gamma of grey pictures in figures, close to a screen's, so that the scale bar gives the light."""

FIGURE_DPI = 90

Floats = NDArray[np.floating]


@dataclass(frozen=True)
class Panel:
    """One picture of a result.

    Attributes
    ----------
    title : str
    values : (H, W) or (H, W, 3) float
        Upright; light is linear, three channels are sRGB primaries.
    low, high : float
        Black and white of light, or the ends of a map's colour scale.
    unit : str
        Label of the scale.
    is_light : bool
        Shown as light, otherwise as a map in colours.
    size_mm : (width, height), optional
        Size for the axes, which otherwise count samples.
    place : str
        Plane in which the size is measured.
    """

    title: str
    values: Floats
    low: float
    high: float
    unit: str
    is_light: bool = True
    size_mm: tuple[float, float] | None = None
    place: str = ""


def _light(title: str, light: Floats, wavelengths_nm: tuple[float, ...], unit: str, **more: Any) -> Panel:
    """Return a panel of upright (H, W, channels) light, automatically exposed for the `known` (H, W) pixels."""
    known = more.pop("known", None)
    shown = to_display(np.nan_to_num(light).astype(np.float64), wavelengths_nm)
    return Panel(title, shown, 0.0, white_point(shown, known), unit, **more)


def _map(title: str, values: Floats, unit: str, low: float | None = None, high: float | None = None) -> Panel:
    known = values[np.isfinite(values)]
    ends = np.percentile(known, [3.0, 97.0]) if known.size else (0.0, 1.0)
    return Panel(title, values, ends[0] if low is None else low, ends[1] if high is None else high, unit, False)


@singledispatch
def panels(result: object) -> list[Panel]:
    """Return the pictures of a result, the most informative first."""
    raise LfmeshError(f"a {type(result).__name__} has no picture")


@panels.register
def _(image: Image) -> list[Panel]:
    upright = Upright.of(image.scene).picture
    known = well_known(image.mean, image.stderr) if image.replicates > 1 else None
    rows, columns = image.mean.shape[:2]
    pixel = image.scene.camera.sensor.pixel_mm
    return [
        _light(
            image.scene.title or "raw image", upright(image.mean), image.wavelengths_nm, "W per pixel",
            known=None if known is None else upright(known),
            size_mm=(columns * pixel, rows * pixel), place="on the sensor",
        )
    ]  # fmt: skip


@panels.register
def _(field: LightField) -> list[Panel]:
    rows, columns = field.views
    height, width = field.size
    step_t, step_s = field.spacing_mm
    middle = field.view(rows // 2, columns // 2)
    return [
        _light(
            "the middle view", middle, field.wavelengths_nm, field.unit,
            size_mm=(width * step_s, height * step_t), place="on the array",
        ),
        _light("all views", field.views_mosaic(), field.wavelengths_nm, field.unit),
    ]  # fmt: skip


@panels.register
def _(photograph: Photograph) -> list[Panel]:
    height, width = photograph.mean.shape[:2]
    sample = photograph.sample_mm
    at = photograph.distance_mm
    title = f"focused on {at:,.5g} mm" if math.isfinite(at) else "focused on infinity"
    size = (width * sample, height * sample) if math.isfinite(sample) else None
    wavelengths = photograph.wavelengths_nm
    return [_light(title, photograph.mean, wavelengths, photograph.unit, size_mm=size, place="in the plane in focus")]


@panels.register
def _(stack: FocalStack) -> list[Panel]:
    number = len(stack.photographs)
    chosen = sorted({round(k) for k in np.linspace(0, number - 1, min(number, MOST_PLANES))})
    return [panel for k in chosen for panel in panels(stack.photographs[k])]


@panels.register
def _(sharp: AllInFocus) -> list[Panel]:
    light = _light("all in focus", sharp.mean, sharp.wavelengths_nm, sharp.unit)
    return [light, _map("taken from the plane at", sharp.distance_mm, "mm")]


@panels.register
def _(depth: DepthMap) -> list[Panel]:
    confidence = _map("confidence", depth.confidence, "", 0.0, 1.0)
    if not np.isfinite(depth.distance_mm).any():
        return [replace(confidence, title="no depth found; confidence")]
    return [_map("depth", depth.distance_mm, "mm"), confidence]


@panels.register
def _(truth: DepthTruth) -> list[Panel]:
    return [_map("true depth", truth.middle_mm, "mm")]


@panels.register
def _(result: Schlieren) -> list[Panel]:
    deflection = 1e3 * result.deflection_rad[result.middle]
    known = np.abs(deflection[np.isfinite(deflection)])
    top = float(np.percentile(known, 99.0)) if known.size else 1.0
    return [
        _map(f"deflection towards +{letter}", deflection[..., axis], "mrad", -top, top)
        for axis, letter in enumerate("xy")
    ]


@panels.register
def _(exposed: Exposed) -> list[Panel]:
    counts = exposed.upright.picture(exposed.counts).astype(np.float64)
    top = float(2**exposed.detector.bits - 1)
    title = f"counts of {exposed.detector.bits} bits" + (", mosaic" if exposed.detector.bayer else "")
    return [Panel(title, counts, float(exposed.detector.black_level), min(top, float(counts.max())), "counts")]


@panels.register
def _(spread: PointSpread) -> list[Panel]:
    # Rings are visible only over decades. The lens inverts the picture.
    mean = spread.mean[:, ::-1]
    rows, columns = mean.shape
    top = float(np.log10(mean.max()))
    part = "a pixel" if spread.oversample == 1 else f"1/{spread.oversample} × 1/{spread.oversample} of a pixel"
    return [
        Panel(
            "point spread", np.log10(np.maximum(mean, 10.0 ** (top - DECADES))), top - DECADES, top,
            f"log₁₀ of W on {part}, for 1 W/sr", is_light=False,
            size_mm=(columns * spread.step_mm, rows * spread.step_mm), place="on the sensor",
        )
    ]  # fmt: skip


@panels.register
def _(found: Wavefront) -> list[Panel]:
    # Points are the centres of squares over the stop.
    across = round(2.0 / float(np.diff(np.unique(found.pupil.round(9))).min()))
    column, row = np.rint(0.5 * across * (found.pupil + 1.0) - 0.5).astype(int).T
    waves = np.full((across, across), np.nan)
    waves[across - 1 - row, column] = found.opd_waves
    return [_map("path difference over the stop", waves, "waves", *np.percentile(found.opd_waves, [0.0, 100.0]))]


def html_of(result: object) -> str:
    """Return a result for a notebook: a table of key figures, with its picture if any."""
    picture, width = None, 0
    if _has_picture(result):
        shown = _enlarged(_pixels(panels(result)[0]))
        picture, width = file_url(_png(shown), "image/png"), shown.width
    warnings = getattr(result, "warnings", ())
    kind = type(result).__name__
    return filled(TEMPLATE, kind=kind, rows=key_figures(result), picture=picture, width=width, warnings=warnings)


def png_of(result: object) -> bytes:
    """Return a result's picture as a PNG, upright and small enough for a notebook."""
    return _png(_enlarged(_pixels(panels(result)[0])))


def _has_picture(result: object) -> bool:
    return panels.dispatch(type(result)) is not panels.dispatch(object)


def _pixels(panel: Panel) -> NDArray[np.uint8]:
    """Return a panel as 8-bit sRGB (H, W) or (H, W, 3)."""
    if not panel.is_light:
        return coloured(panel.values, panel.low, panel.high)
    width = panel.high - panel.low
    return srgb_encode((panel.values - panel.low) / width) if width > 0.0 else np.zeros(panel.values.shape, np.uint8)


def _enlarged(pixels: NDArray[np.uint8]) -> PIL.Image.Image:
    """Return a picture at a size suitable for a notebook."""
    picture = PIL.Image.fromarray(np.ascontiguousarray(pixels))
    longest = max(picture.size)
    if longest > LARGEST_PX:
        picture.thumbnail((LARGEST_PX, LARGEST_PX), PIL.Image.Resampling.BOX)
    elif longest < SMALLEST_PX:
        times = math.ceil(SMALLEST_PX / longest)
        width, height = picture.size
        picture = picture.resize((times * width, times * height), PIL.Image.Resampling.NEAREST)
    return picture


def _png(picture: PIL.Image.Image) -> bytes:
    content = io.BytesIO()
    picture.save(content, format="PNG", optimize=True)
    return content.getvalue()


def figure_of(result: object, make: Callable[..., "Figure"] | None = None) -> "Figure":
    """Return the pictures of a result as a matplotlib figure, side by side, with axes and scales.

    Parameters
    ----------
    result : object
    make : callable, optional
        Makes the figure from matplotlib's keywords: `matplotlib.pyplot.figure` for one in a window.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    drawn = panels(result)
    figure = (make or Figure)(figsize=(PANEL_IN * len(drawn), PANEL_IN), layout="constrained")
    if make is None:
        FigureCanvasAgg(figure)
    for axes, panel in zip(figure.subplots(1, len(drawn), squeeze=False)[0], drawn, strict=True):
        _draw(axes, panel)
    return figure


def _draw(axes: Any, panel: Panel) -> None:
    """Draw a panel: its picture, axes in mm, and scale."""
    from matplotlib.colors import Normalize, PowerNorm
    from matplotlib.ticker import MaxNLocator

    extent = None
    if panel.size_mm is not None:
        width, height = panel.size_mm
        extent = (-0.5 * width, 0.5 * width, -0.5 * height, 0.5 * height)
        axes.set_xlabel(f"mm {panel.place}")
    else:
        axes.set_xticks([])
        axes.set_yticks([])
    # Names of bands and scenes are the user's and may contain $ and ^.
    axes.set_title(panel.title, fontsize=10, loc="left", parse_math=False)
    if panel.values.ndim == 3:
        axes.imshow(_pixels(panel), extent=extent, interpolation="nearest")
        return
    high = panel.high if panel.high > panel.low else panel.low + 1.0
    norm = PowerNorm(GAMMA, panel.low, high, clip=True) if panel.is_light else Normalize(panel.low, high)
    axes.set_facecolor("#dddddd")
    drawn = axes.imshow(
        panel.values, norm=norm, cmap="gray" if panel.is_light else "viridis", extent=extent, interpolation="nearest"
    )
    bar = axes.figure.colorbar(drawn, ax=axes, shrink=0.75, extend="max" if panel.is_light else "neither")
    bar.set_label(panel.unit)
    bar.ax.yaxis.set_major_locator(MaxNLocator(4))
    bar.ax.tick_params(labelsize=8)


def show(result: object) -> None:
    """Show the pictures of a result below the notebook cell, or in a window until it is closed."""
    if in_notebook():
        from IPython.display import Image as Displayed
        from IPython.display import display

        display(Displayed(encoded_figure(figure_of(result), "png", dpi=FIGURE_DPI)))
        return
    from matplotlib import pyplot

    figure_of(result, pyplot.figure)
    pyplot.show()
