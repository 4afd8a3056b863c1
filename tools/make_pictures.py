"""Make the pictures of the README, and those of scenes with media.

From a run of the demo, one that was refocused, a report of its accuracy, a scene to be seen in 3D, or several of them:
tools/run demo -o run, tools/run accuracy assets/scenes/first_light.toml -o report, then
tools/make_pictures.py run report assets/scenes/first_light.toml. From runs of the flame, the particles and the tank,
tools/run render assets/scenes/flame.toml -o flame --white: their views.
"""

import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure
from PIL import Image, ImageDraw, ImageFont

import lfmesh
from lfmesh.accuracy import figures
from lfmesh.accuracy.image_efficiency import ImageRow
from lfmesh.accuracy.lens_accuracy import LENS_ALONE, LensRow
from lfmesh.accuracy.report import IMAGE_CSV, LENS_CSV
from lfmesh.accuracy.tables import read_csv
from lfmesh.assets import asset_path
from lfmesh.scene import load

PICTURES = Path(__file__).resolve().parent.parent / "assets" / "pictures"
SIDE_PX = 320
DETAIL_PX = 80
"""Eight lenslets, enlarged to the side of the other pictures."""
DETAIL_CORNER = (280, 160)

AXES_PX, AXIS_PX = 26, 36
"""Distance of the axes' origin from the picture's edges, and their length."""
AXES_FONT_PX = 15
AXES_COLOUR = "#c22b1f"

NEAR, FAR = "refocused_430mm.png", "refocused_600mm.png"

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
"""What lf.show shows of a scene."""
MEDIA = ("flame", "particles", "tank")
"""Names of scenes of which the view is a picture."""

VIEW_PX = (960, 600)
VIEW_COLOURS = 64
"""Of the palette that keeps these pictures small."""

FIGURE_IN = (8.6, 3.4)
FIGURE_DPI = 120


def from_run(run: Path) -> None:
    """Write the raw image, a detail of it, and the view, all of one size."""
    with Image.open(run / "preview.png") as raw, Image.open(run / "preview_view.png") as view:
        x, y = DETAIL_CORNER
        detail = raw.crop((x, y, x + DETAIL_PX, y + DETAIL_PX)).resize((SIDE_PX, SIDE_PX), Image.Resampling.NEAREST)
        detail.save(PICTURES / "micro_images.png", optimize=True)
        raw.crop((160, 160, 160 + SIDE_PX, 160 + SIDE_PX)).save(PICTURES / "raw.png", optimize=True)
        small = view.resize((SIDE_PX, SIDE_PX), Image.Resampling.LANCZOS).convert("RGB")
        draw_axes(small)
        small.save(PICTURES / "view.png", optimize=True)


def from_media(run: Path, name: str) -> None:
    """Write the view of a scene with media."""
    with Image.open(run / "preview_view.png") as view:
        view.convert("L").resize((SIDE_PX, SIDE_PX)).save(PICTURES / f"{name}.png", optimize=True)


def draw_axes(picture: Image.Image) -> None:
    """Draw the camera's axes into the lower left corner: x to the right, y up, z towards whoever looks."""
    draw, font = ImageDraw.Draw(picture), ImageFont.load_default(AXES_FONT_PX)
    x, y = AXES_PX, picture.height - AXES_PX
    right, up = x + AXIS_PX, y - AXIS_PX
    draw.line([(x, up), (x, y), (right, y)], fill=AXES_COLOUR, width=3)
    draw.polygon([(right + 4, y), (right - 6, y - 5), (right - 6, y + 5)], fill=AXES_COLOUR)
    draw.polygon([(x, up - 4), (x - 5, up + 6), (x + 5, up + 6)], fill=AXES_COLOUR)
    # The point of an arrow that comes out of the picture.
    draw.ellipse([x - 6, y - 6, x + 6, y + 6], fill="white", outline=AXES_COLOUR, width=3)
    draw.ellipse([x - 2, y - 2, x + 2, y + 2], fill=AXES_COLOUR)
    for name, at in (("x", (right + 12, y)), ("y", (x, up - 14)), ("z", (x - 14, y + 8))):
        draw.text(at, name, fill=AXES_COLOUR, font=font, anchor="mm")


def from_photographs(run: Path) -> None:
    """Write the photographs of the near and the far plane and the one with all in focus, of one size."""
    for name, picture in ((NEAR, "near.png"), (FAR, "far.png"), ("all_in_focus.png", "all_in_focus.png")):
        with Image.open(run / name) as photograph:
            resized = photograph.resize((SIDE_PX, SIDE_PX), Image.Resampling.LANCZOS)
            resized.save(PICTURES / picture, optimize=True)


def from_report(report: Path) -> None:
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
        figure.savefig(PICTURES / "accuracy.png", dpi=FIGURE_DPI)


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
        elif (folder / LENS_CSV).is_file():
            from_report(folder)
        elif (name := load(folder / "scene.toml").name) in MEDIA:
            from_media(folder, name)
        elif (folder / NEAR).is_file():
            from_photographs(folder)
        else:
            from_run(folder)
