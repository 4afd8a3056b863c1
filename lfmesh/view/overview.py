"""Overview of a run of a light-field camera on one sheet.

The sheet shows the camera with rays, a part of the raw image, the middle view, two photographs and the depth.
"""

import io
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import PIL.Image
import PIL.ImageOps
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.files import run as runs
from lfmesh.files.depth import shown_range
from lfmesh.files.preview import displayed
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.lightfield.photographs.depth import estimate_depth
from lfmesh.lightfield.photographs.refocus import focal_stack
from lfmesh.lightfield.views.decode import decode
from lfmesh.lightfield.views.upright import Upright
from lfmesh.scene import Scene
from lfmesh.transport.render.image import Image
from lfmesh.view.figure_file import encoded_figure
from lfmesh.view.layout.content import layout
from lfmesh.view.layout.figure import encoded
from lfmesh.view.pictures import coloured, exposed, white_of
from lfmesh.view.scene3d.colours import BACKGROUND, FAINT_TEXT, TEXT
from lfmesh.view.scene3d.gl import Probe
from lfmesh.view.scene3d.plotter import Drawing
from lfmesh.view.show import draw_seen, look, shot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Picture = NDArray[np.uint8]

WIDTH, MARGIN, GAP, CAPTION = 1200, 16, 12, 26
"""Width of the sheet, its border, the space between pictures, and the height of a line of text, in pixels."""

ASPECT = 1.6
"""Width over height of the camera's picture."""

LARGE = round((WIDTH - 2 * MARGIN - GAP) / (ASPECT + 1.0))
SMALL = (WIDTH - 2 * MARGIN - 3 * GAP) // 4
"""Sides of the raw image and of the pictures below it."""

HEIGHT = 2 * MARGIN + GAP + 2 * CAPTION + LARGE + SMALL

ENLARGED = 3
"""Pixels of the sheet for one of the sensor."""

DRAWN = (1440, 900)
"""Size in which the camera is drawn, and then reduced."""

INSET = 0.38
"""Size of the microlenses' picture in the corner, relative to the camera's."""

DPI = 100
FONT = 9.5
BAR = (90, 9)
"""Size of the scale of depths."""


def save_overview(
    image: Image, folder: Path, distances_mm: tuple[float, float], say: Callable[[str], None] = lambda _: None
) -> Path:
    """Add the overview to a run folder as ``overview.png``; return the file.

    Parameters
    ----------
    image : Image
        Of a light-field camera that is not focused plenoptic.
    folder : Path
        Its run.
    distances_mm : (near, far)
        Planes of the photographs, before the first vertex.
    say : callable, optional
        Called with the present step.

    Raises
    ------
    LfmeshError
        The light field cannot be decoded, or the folder holds no complete run or cannot be written.
    """
    figure = overview(image, distances_mm, say)
    with runs.added(folder) as staging:
        (staging / runs.OVERVIEW).write_bytes(encoded_figure(figure, "png", dpi=DPI))
    return folder / runs.OVERVIEW


def overview(image: Image, distances_mm: tuple[float, float], say: Callable[[str], None] = lambda _: None) -> "Figure":
    """Return the sheet as a matplotlib figure.

    Parameters
    ----------
    image, distances_mm, say
        As for `save_overview`.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    say("drawing the camera")
    camera, caption = camera_picture(image, (round(ASPECT * LARGE), LARGE))
    say("sorting the pixels into views")
    field = decode(image)
    say("refocusing")
    photographs = focal_stack(field, distances_mm).photographs
    say("estimating the depth")
    depth = estimate_depth(field).distance_mm
    ends = shown_range(depth, np.full(depth.shape, np.nan)) or distances_mm

    figure = Figure(figsize=(WIDTH / DPI, HEIGHT / DPI), facecolor=BACKGROUND)
    FigureCanvasAgg(figure)
    raw, part = raw_part(image)
    upper, lower = MARGIN + CAPTION, MARGIN + 2 * CAPTION + LARGE + GAP
    _draw(figure, camera, (MARGIN, upper), caption)
    _draw(figure, raw, (WIDTH - MARGIN - LARGE, upper), f"a part of the raw image: {part}")
    middle = field.view(field.views[0] // 2, field.views[1] // 2)
    lights: list[NDArray[np.floating[Any]]] = [middle, *(photograph.mean for photograph in photographs)]
    captions = [f"one of {field.views[1]} × {field.views[0]} views"]
    captions += [f"refocused to {photograph.distance_mm:g} mm" for photograph in photographs]
    for number, (light, caption) in enumerate(zip(lights, captions, strict=True)):
        shown = exposed(light, field.wavelengths_nm, white_of(light, field.wavelengths_nm))
        _draw(figure, enlarged(shown, SMALL), (MARGIN + number * (SMALL + GAP), lower), caption)
    last = (MARGIN + 3 * (SMALL + GAP), lower)
    _draw(figure, enlarged(coloured(depth, *ends), SMALL), last, "depth")
    _draw_scale(figure, last, ends)
    return figure


def camera_picture(image: Image, size: tuple[int, int]) -> tuple[Picture, str]:
    """Return the view of the camera with rays in 3D or, if that fails, its layout drawing; and a caption.

    Parameters
    ----------
    image : Image
        Shown on the sensor.
    size : (width, height), pixels
    """
    try:
        whole, close = _in_3d(image)
    except LfmeshError as fault:
        return _reduced(_layout(image.scene), size), f"the layout of the camera; {fault}"
    picture = PIL.Image.fromarray(_reduced(whole, size))
    inset = PIL.Image.fromarray(_reduced(close, (round(INSET * size[0]), round(INSET * size[1]))))
    inset = PIL.ImageOps.expand(inset, 1, FAINT_TEXT)
    picture.paste(inset, (GAP, size[1] - GAP - inset.height))
    return np.asarray(picture), "the camera with rays from three points; in the corner its microlenses"


def _in_3d(image: Image) -> tuple[PIL.Image.Image, PIL.Image.Image]:
    """Return the whole camera, and its microlenses with rays."""
    with Probe() as probe:
        seen = look(image)
        probe.check()
    view = draw_seen(seen, Drawing(colour="field", size=DRAWN))
    try:
        view.overlay.only_scale(True, 2.0)
        whole = shot(view)
        view.overlay.only_scale(True, 2.0 / INSET)
        view.look("array")
        return whole, shot(view)
    finally:
        view.plotter.close()


def _reduced(picture: PIL.Image.Image, size: tuple[int, int]) -> Picture:
    return np.asarray(picture.convert("RGB").resize(size, PIL.Image.Resampling.LANCZOS))


def _layout(scene: Scene) -> PIL.Image.Image:
    """Return the layout drawing on a sheet of the right shape."""
    with PIL.Image.open(io.BytesIO(encoded(layout(scene), "png"))) as file:
        sheet = PIL.Image.new("RGB", DRAWN, "white")
        drawn = PIL.ImageOps.contain(file.convert("RGB"), DRAWN)
        sheet.paste(drawn, ((DRAWN[0] - drawn.width) // 2, (DRAWN[1] - drawn.height) // 2))
    return sheet


def raw_part(image: Image) -> tuple[Picture, str]:
    """Return the middle of the raw image, its pixels enlarged to squares, and its size in words."""
    power = Upright.of(image.scene).picture(image.mean)
    error = Upright.of(image.scene).picture(image.stderr)
    shown, _ = displayed(power, image.wavelengths_nm, error)
    rows, columns = (min(LARGE // ENLARGED, side) for side in shown.shape[:2])
    top, left = (shown.shape[0] - rows) // 2, (shown.shape[1] - columns) // 2
    part = shown[top : top + rows, left : left + columns]
    pitch = solved_camera(image.scene).report.micro_image_pitch_px
    words = f"{columns} × {rows} pixels"
    if pitch is not None:
        words = f"{columns / pitch:.0f} × {rows / pitch:.0f} micro-images"
    return enlarged(part, LARGE, PIL.Image.Resampling.NEAREST), words


def enlarged(pixels: Picture, side: int, how: PIL.Image.Resampling = PIL.Image.Resampling.BICUBIC) -> Picture:
    """Return a picture with its longer side of a size, in three channels.

    Parameters
    ----------
    pixels : (H, W) or (H, W, 3) uint8
    side : int
    how : Resampling
    """
    picture = PIL.Image.fromarray(np.ascontiguousarray(pixels)).convert("RGB")
    scale = side / max(picture.size)
    return np.asarray(picture.resize((round(scale * picture.width), round(scale * picture.height)), how))


def _axes(figure: "Figure", corner: tuple[int, int], size: tuple[int, int]) -> Any:
    """Return axes without frame, with their upper left corner (x, y) in pixels from the sheet's."""
    (x, y), (width, height) = corner, size
    axes = figure.add_axes((x / WIDTH, 1.0 - (y + height) / HEIGHT, width / WIDTH, height / HEIGHT))
    axes.set_axis_off()
    return axes


def _write(figure: "Figure", point: tuple[int, int], words: str, side: str = "left") -> None:
    x, y = point
    figure.text(x / WIDTH, 1.0 - y / HEIGHT, words, color=TEXT, fontsize=FONT, ha=side, va="center", parse_math=False)


def _draw(figure: "Figure", picture: Picture, corner: tuple[int, int], caption: str) -> None:
    """Draw a picture below its caption."""
    x, y = corner
    height, width = picture.shape[:2]
    _axes(figure, corner, (width, height)).imshow(picture, interpolation="nearest", aspect="auto")
    _write(figure, (x, y - CAPTION // 2), caption)


def _draw_scale(figure: "Figure", corner: tuple[int, int], ends: tuple[float, float]) -> None:
    """Draw the colours of depths at the right end of the caption of a map."""
    x, y = corner
    middle, (width, height) = y - CAPTION // 2, BAR
    right = x + SMALL
    _write(figure, (right, middle), f"{ends[1]:.0f} mm", "right")
    left = right - 58 - width
    ramp = coloured(np.linspace(0.0, 1.0, width)[None], 0.0, 1.0)
    _axes(figure, (left, middle - height // 2), BAR).imshow(ramp, interpolation="nearest", aspect="auto")
    _write(figure, (left - 6, middle), f"{ends[0]:.0f}", "right")
