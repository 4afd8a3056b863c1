"""Draw the test charts of the example scenes, in assets/charts: chart.png, colour_chart.png, dots.png and siemens.png.

They are 8-bit sRGB pictures, grey but for the colour chart. The chart mixes coarse features, which survive the
one-pixel-per-lenslet resolution of a plenoptic camera, with fine ones for a conventional camera. The dots are the
background of schlieren pictures. Everything is drawn larger and reduced, so that edges are antialiased.
"""

import math
import random
from pathlib import Path
from typing import NamedTuple

from PIL import Image, ImageDraw, ImageFont

ASSETS = Path(__file__).resolve().parent.parent / "assets"

CHART_PX = 1536
SIEMENS_PX = 1024
DOTS_PX = 1024
OVERSAMPLING = 4

PAPER = 236
INK = 14
GRID = 186
DARK_TILE = 64
LIGHT_TILE = 168
SLANT_DEG = 5.0
"""The slanted-edge angle usual in ISO 12233 measurements."""

Colour = int | tuple[int, int, int]
"""Of sRGB: grey, or red, green and blue."""


class Inks(NamedTuple):
    """Colours of the parts of the chart; the corners' stars go from the upper left in rows."""

    words: tuple[Colour, Colour] = (INK, INK)
    letters: tuple[Colour, Colour] = (INK, INK)
    middle_star: Colour = INK
    stars: tuple[Colour, Colour, Colour, Colour] = (INK, INK, INK, INK)
    square: Colour = DARK_TILE
    tiles: Colour = INK
    steps: tuple[Colour, ...] = tuple(round(INK + (PAPER - INK) * step / 5) for step in range(6))


COLOURED = Inks(
    words=((24, 62, 150), (190, 40, 50)),
    letters=((0, 110, 90), (120, 40, 130)),
    middle_star=(20, 24, 46),
    stars=((196, 32, 40), (20, 132, 60), (226, 118, 0), (28, 80, 180)),
    square=(0, 128, 140),
    tiles=(24, 44, 92),
    steps=((196, 32, 40), (226, 118, 0), (240, 200, 0), (20, 132, 60), (28, 80, 180), (120, 40, 130)),
)


class Sheet:
    """A square sheet of paper with lengths in fractions of its side, origin at the top left."""

    def __init__(self, side_px: int, mode: str = "L") -> None:
        self.scale = side_px * OVERSAMPLING
        self.side_px = side_px
        self.picture = Image.new(mode, (self.scale, self.scale), self._ink(PAPER, mode))
        self.pen = ImageDraw.Draw(self.picture)

    @staticmethod
    def _ink(colour: Colour, mode: str) -> Colour:
        return (colour, colour, colour) if mode == "RGB" and isinstance(colour, int) else colour

    def polygon(self, points: list[tuple[float, float]], colour: Colour) -> None:
        """Fill the polygon through `points`."""
        fill = self._ink(colour, self.picture.mode)
        self.pen.polygon([(x * self.scale, y * self.scale) for x, y in points], fill=fill)

    def rectangle(self, x0: float, y0: float, x1: float, y1: float, colour: Colour) -> None:
        """Fill from the corner (x0, y0) to (x1, y1)."""
        self.polygon([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], colour)

    def disk(self, x: float, y: float, radius: float, colour: Colour) -> None:
        """Fill a circle about (x, y)."""
        box = [(x - radius) * self.scale, (y - radius) * self.scale]
        fill = self._ink(colour, self.picture.mode)
        self.pen.ellipse([*box, (x + radius) * self.scale, (y + radius) * self.scale], fill=fill)

    def siemens_star(self, x: float, y: float, radius: float, spokes: int, colour: Colour = INK) -> None:
        """Draw a star of dark spokes on a disk of paper; one spoke is exactly half a period."""
        self.disk(x, y, radius * 1.06, PAPER)
        arc_steps = 12
        for spoke in range(spokes):
            start = 2 * math.pi * spoke / spokes
            rim = [
                (x + radius * math.cos(angle), y + radius * math.sin(angle))
                for angle in (start + math.pi / spokes * step / arc_steps for step in range(arc_steps + 1))
            ]
            self.polygon([(x, y), *rim], colour)

    def slanted_square(self, x: float, y: float, side: float, colour: Colour) -> None:
        """Fill a square about (x, y), turned by `SLANT_DEG`."""
        angle = math.radians(SLANT_DEG)
        half = side / 2
        corners = [(-half, -half), (half, -half), (half, half), (-half, half)]
        self.polygon(
            [
                (x + u * math.cos(angle) - v * math.sin(angle), y + u * math.sin(angle) + v * math.cos(angle))
                for u, v in corners
            ],
            colour,
        )

    def text(self, x: float, y: float, height: float, words: str, colour: Colour = INK) -> None:
        """Write centred on (x, y); `height` is that of the font's em."""
        fill = self._ink(colour, self.picture.mode)
        font = ImageFont.load_default(height * self.scale)
        self.pen.text(
            (x * self.scale, y * self.scale),
            words,
            fill=fill,
            font=font,
            anchor="mm",
            stroke_width=height * self.scale * 0.02,
            stroke_fill=fill,
        )

    def save(self, path: Path) -> None:
        """Reduce to the final size and write a PNG."""
        path.parent.mkdir(parents=True, exist_ok=True)
        small = self.picture.resize((self.side_px, self.side_px), Image.Resampling.BOX)
        small.save(path, optimize=True)
        print(f"{path.relative_to(ASSETS.parent)}: {self.side_px} px, {path.stat().st_size / 1000:.0f} kB")


def grid(sheet: Sheet, cells: int, width: float) -> None:
    for line in range(1, cells):
        at = line / cells
        sheet.rectangle(at - width / 2, 0, at + width / 2, 1, GRID)
        sheet.rectangle(0, at - width / 2, 1, at + width / 2, GRID)


def frame(sheet: Sheet, tiles: int, colour: Colour) -> None:
    """Draw a border of alternating tiles: it shows the field's edge, distortion and vignetting."""
    side = 1 / tiles
    for index in range(tiles):
        along = (colour, PAPER) if index % 2 else (PAPER, colour)
        for offset, ink in ((0.0, along[0]), (1 - side, along[1] if tiles % 2 == 0 else along[0])):
            sheet.rectangle(index * side, offset, (index + 1) * side, offset + side, ink)
            sheet.rectangle(offset, index * side, offset + side, (index + 1) * side, ink)


def line_pairs(sheet: Sheet, x: float, y: float, height: float) -> None:
    """Draw groups of bars from coarse to fine, each group half the period of the one before."""
    period = 0.04
    for _ in range(4):
        for bar in range(3):
            left = x + bar * period
            sheet.rectangle(left, y, left + period / 2, y + height, INK)
        x += 3 * period
        period /= 2


def chart(inks: Inks, mode: str) -> Sheet:
    """Return the chart: stars, slanted squares, letters, line pairs and steps on a grid."""
    sheet = Sheet(CHART_PX, mode)
    grid(sheet, 20, 0.0018)
    frame(sheet, 20, inks.tiles)
    sheet.siemens_star(0.5, 0.5, 0.17, 24, inks.middle_star)
    corners = [(x, y) for y in (0.2, 0.8) for x in (0.2, 0.8)]
    for (x, y), ink in zip(corners, inks.stars, strict=True):
        sheet.siemens_star(x, y, 0.115, 12, ink)
    sheet.rectangle(0.345, 0.1, 0.655, 0.3, PAPER)
    sheet.text(0.5, 0.165, 0.11, "LIGHT", inks.words[0])
    sheet.text(0.5, 0.255, 0.08, "FIELD", inks.words[1])
    sheet.rectangle(0.1, 0.36, 0.3, 0.64, PAPER)
    sheet.slanted_square(0.2, 0.5, 0.15, inks.square)
    sheet.slanted_square(0.2, 0.5, 0.07, PAPER)
    sheet.rectangle(0.7, 0.36, 0.9, 0.64, PAPER)
    sheet.text(0.8, 0.43, 0.11, "F R", inks.letters[0])
    sheet.text(0.8, 0.55, 0.11, "4 7", inks.letters[1])
    sheet.rectangle(0.345, 0.7, 0.655, 0.9, PAPER)
    line_pairs(sheet, 0.39, 0.715, 0.075)
    steps = len(inks.steps)
    for step, ink in enumerate(inks.steps):
        sheet.rectangle(0.36 + step * 0.28 / steps, 0.81, 0.36 + (step + 1) * 0.28 / steps, 0.88, ink)
    return sheet


def siemens() -> Sheet:
    """Return one star of 36 spokes that fills the sheet, in a grey ring."""
    sheet = Sheet(SIEMENS_PX)
    sheet.disk(0.5, 0.5, 0.49, LIGHT_TILE)
    sheet.siemens_star(0.5, 0.5, 0.44, 36)
    return sheet


def dots() -> Sheet:
    """Return dots on a lattice of 26 × 26 cells, each at a random place in its cell."""
    sheet, cells, draw = Sheet(DOTS_PX), 26, random.Random(0)
    for row in range(cells):
        for column in range(cells):
            x, y = ((k + 0.5 + 0.8 * (draw.random() - 0.5)) / cells for k in (column, row))
            sheet.disk(x, y, 0.27 / cells, INK)
    return sheet


def main() -> None:
    dots().save(ASSETS / "charts" / "dots.png")
    chart(Inks(), "L").save(ASSETS / "charts" / "chart.png")
    chart(COLOURED, "RGB").save(ASSETS / "charts" / "colour_chart.png")
    siemens().save(ASSETS / "charts" / "siemens.png")


if __name__ == "__main__":
    main()
