"""Make the pictures of the README and the guides.

From a run of the demo, one that was refocused, a report of the accuracy, a scene to be seen in 3D, or several of them:
tools/run demo -o run --samples 128, tools/run accuracy assets/scenes/first_light.toml -o report, then
tools/make_pictures.py run report assets/scenes/first_light.toml. From runs of the flame, the particles and the tank,
tools/run render assets/scenes/flame.toml -o flame --white: their views. From an example notebook: its last figure.
"""

import base64
import io
import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
import nbformat
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from PIL import Image

import lfmesh
from lfmesh.accuracy import figures
from lfmesh.accuracy.image_efficiency import ImageRow
from lfmesh.accuracy.lens_accuracy import LENS_ALONE, LensRow
from lfmesh.accuracy.report import IMAGE_CSV, LENS_CSV
from lfmesh.accuracy.tables import read_csv
from lfmesh.assets import asset_path
from lfmesh.files.run import OVERVIEW
from lfmesh.scene import load

PICTURES = Path(__file__).resolve().parent.parent / "assets" / "pictures"
SIDE_PX = 320
DETAIL_PX = 80
"""Eight lenslets, enlarged to the side of the other pictures."""
DETAIL_CORNER = (280, 160)

PICTURE_DPI = 100
LEFT_PX, BELOW_PX, MARGIN_PX = 58, 44, 10
"""Round a picture, for the numbers at its axes."""
AXES_FONT = 9.0
PICTURE_COLOURS = 128
"""Of the palette that keeps these pictures small."""

NEAR, FAR = "refocused_450mm.png", "refocused_600mm.png"

VIEWS: dict[str, dict[str, Any]] = {
    "camera.png": {},
    "ghost.png": {
        "rays": "field 0,30,-500",
        "count": 48,
        "split": "both",
        "weight_cutoff": 1e-4,
        "filter": "reflects(L5b) and reflects(L3b) and reflections == 2 and last == sensor",
        "colour": "path",
        "preset": "lens",
        "cut": True,
    },
    "array.png": {
        "rays": "pixel 317,313",
        "count": 48,
        "split": "transmit",
        "filter": "status == target or status == escaped",
        "preset": "array",
        "cut": True,
    },
}
"""View that lf.show opens of a scene."""
MEDIA = ("flame", "particles", "tank")
"""Names of scenes of which the view is a picture."""

VIEW_PX = (960, 600)
OVERVIEW_COLOURS = 256
VIEW_COLOURS = 64
"""Of the palette that keeps these pictures small."""

FIGURE_IN = (8.6, 3.4)
FIGURE_DPI = 120


def from_run(run: Path) -> None:
    """Write the overview of the demo, and a detail of its raw image."""
    with Image.open(run / OVERVIEW) as sheet:
        # Median cut would spend the palette on large areas, and draw thin coloured rays in grey.
        method, dither = Image.Quantize.MAXCOVERAGE, Image.Dither.NONE
        colours = sheet.convert("RGB").quantize(OVERVIEW_COLOURS, method, kmeans=1, dither=dither)
        colours.save(PICTURES / OVERVIEW, optimize=True)
    pixel = load(run / "scene.toml").camera.sensor.pixel_mm
    with Image.open(run / "preview.png") as raw:
        x, y = DETAIL_CORNER
        left, top = (x - raw.width / 2) * pixel, (raw.height / 2 - y) * pixel
        extent = (left, left + DETAIL_PX * pixel, top - DETAIL_PX * pixel, top)
        detail = raw.crop((x, y, x + DETAIL_PX, y + DETAIL_PX))
        write_with_axes(detail, extent, "mm on the sensor", "micro_images")


def write_with_axes(picture: Image.Image, extent: tuple[float, float, float, float], what: str, name: str) -> None:
    """Write an upright picture with axes: x to the right, y up.

    Parameters
    ----------
    picture : Image
    extent : (left, right, bottom, top)
        Of the picture, mm.
    what : str
        What the numbers at the axes are.
    name : str
        Of the file, without its ending.
    """
    with mpl.rc_context({"font.size": AXES_FONT}):
        width, height = LEFT_PX + SIDE_PX + MARGIN_PX, BELOW_PX + SIDE_PX + MARGIN_PX
        figure = Figure(figsize=(width / PICTURE_DPI, height / PICTURE_DPI))
        # As many pixels of the file as the picture has, or a whole number of times as many: lenslets stay alike.
        axes = figure.add_axes((LEFT_PX / width, BELOW_PX / height, SIDE_PX / width, SIDE_PX / height))
        axes.imshow(np.asarray(picture.convert("RGB")), extent=extent, interpolation="nearest")
        axes.set(xlabel=f"x, {what}", ylabel="y, mm")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
        buffer = io.BytesIO()
        figure.savefig(buffer, dpi=PICTURE_DPI)
    with Image.open(buffer) as drawn:
        colours = drawn.convert("RGB").quantize(PICTURE_COLOURS, dither=Image.Dither.NONE)
        colours.save(PICTURES / f"{name}.png", optimize=True)


def from_media(run: Path, name: str) -> None:
    """Write the view of a scene with media."""
    with Image.open(run / "preview_view.png") as view:
        view.convert("L").resize((SIDE_PX, SIDE_PX)).save(PICTURES / f"{name}.png", optimize=True)


def from_photographs(run: Path) -> None:
    """Write the photographs of the near and the far plane and the one with all in focus, of one size."""
    for name, picture in ((NEAR, "near.png"), (FAR, "far.png"), ("all_in_focus.png", "all_in_focus.png")):
        with Image.open(run / name) as photograph:
            resized = photograph.resize((SIDE_PX, SIDE_PX), Image.Resampling.LANCZOS)
            resized.save(PICTURES / picture, optimize=True)


def from_report(report: Path, picture: Path = PICTURES / "accuracy.png") -> None:
    """Write the main figure of the accuracy of the first scene: what a facet stands for, and what an image costs."""
    lenses = read_csv((report / LENS_CSV).read_text(encoding="utf-8"), LensRow)
    images = read_csv((report / IMAGE_CSV).read_text(encoding="utf-8"), ImageRow)
    pixel_mm = load(asset_path("scenes/first_light.toml")).camera.sensor.pixel_mm
    with mpl.rc_context({"font.size": 8.5}):
        figure = Figure(figsize=FIGURE_IN, layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=(1.2, 1.0))
        rows = [row for row in lenses if row.way == LENS_ALONE]
        figures.draw_error_against_triangles(left, rows, pixel_mm)
        figures.finish(left, f"{rows[0].lens}: what a facet stands for")
        figures.draw_efficiency(right, images)
        figures.finish(right, "first light: ways to estimate its image")
        figure.savefig(picture, dpi=FIGURE_DPI)


def from_notebook(notebook: Path) -> None:
    """Write the last figure that a notebook keeps."""
    outputs = [output for cell in nbformat.read(notebook, as_version=4).cells for output in cell.get("outputs", [])]
    figures_kept = [output.data["image/png"] for output in outputs if "image/png" in output.get("data", {})]
    (PICTURES / f"{notebook.stem}.png").write_bytes(base64.b64decode(figures_kept[-1]))


def from_scene(scene: Path) -> None:
    """Write the camera with rays, a ghost in its lens, and what one pixel sees through the array."""
    for name, options in VIEWS.items():
        lfmesh.show(scene, **options, size=VIEW_PX, screenshot=PICTURES / name)
        with Image.open(PICTURES / name) as picture:
            small = picture.quantize(VIEW_COLOURS, dither=Image.Dither.NONE)
        small.save(PICTURES / name, optimize=True)


if __name__ == "__main__":
    PICTURES.mkdir(parents=True, exist_ok=True)
    for folder in map(Path, sys.argv[1:]):
        if folder.suffix == ".toml":
            from_scene(folder)
        elif folder.suffix == ".ipynb":
            from_notebook(folder)
        elif (folder / LENS_CSV).is_file():
            from_report(folder)
        elif (name := load(folder / "scene.toml").name) in MEDIA:
            from_media(folder, name)
        elif (folder / NEAR).is_file():
            from_photographs(folder)
        else:
            from_run(folder)
