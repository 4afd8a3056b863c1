"""Raw image in the page: a part of it, upright, with the centres of the micro-images."""

from dataclasses import dataclass

import numpy as np
import PIL.Image
from numpy.typing import NDArray

from lfmesh.files.preview import displayed
from lfmesh.lightfield.calibration.calibration import Calibration
from lfmesh.lightfield.views.upright import Upright
from lfmesh.transport.render.image import Image

Array = NDArray[np.float64]

MOST_PX = 1000
"""Parts with more pixels along a side are sent as averages."""

MOST_CENTRES = 12_000
"""Most centres to draw; more cannot be distinguished."""

LEAST_PX = 4.0
"""Closest zoom: pixels along the picture's longer side."""

DARK = 50
"""Highest grey that counts as unlit: 3 % of the light shown as white."""

MARGIN, MOST_LIT = 0.1, 0.6
"""Margin around the lit part relative to its size, and the largest lit fraction of the sensor that is zoomed."""

BLANK = 40
"""Grey of a sensor without an image."""


@dataclass(frozen=True)
class Part:
    """Visible part of an upright picture: first row and column, and size, in whole pixels."""

    row: int
    column: int
    height: int
    width: int


class SensorPicture:
    """Upright raw image with a visible part.

    Positions (x, y) are fractions of the visible part, 0 to 1 from its upper left corner. Pixels are rows and columns
    of the raw image as on the sensor.

    Parameters
    ----------
    columns, rows : int
        Pixels of the sensor.
    upright : Upright
        Orientation of the picture relative to the sensor.
    image : Image, optional
        A blank sensor if omitted.
    calibration : Calibration, optional
        Positions of the micro-images.
    """

    def __init__(
        self, columns: int, rows: int, upright: Upright, image: Image | None = None,
        calibration: Calibration | None = None,
    ) -> None:  # fmt: skip
        self.columns, self.rows = columns, rows
        self._upright, self._shape = upright, (rows, columns)
        self._blank = image is None
        self._picture = np.full((rows, columns), BLANK, np.uint8)
        if image is not None:
            picture, _ = displayed(image.mean, image.wavelengths_nm, image.stderr)
            self._picture = upright.picture(picture)
        self._centres = np.empty((0, 2))
        self.pitch_px = 0.0
        if calibration is not None:
            self._centres = upright.points_px(calibration.centres_px[calibration.known], self._shape)
            self.pitch_px = calibration.pitch_px
        self.all = Part(0, 0, rows, columns)
        self.part = self.all

    def whole(self) -> None:
        """Show the whole sensor."""
        self.part = self.all

    def lit(self) -> None:
        """Show the lit part with a margin, or the whole sensor if most or none of it is lit."""
        bright = self._picture.reshape(self.rows, self.columns, -1).max(axis=2) > DARK
        if self.part != self.all or not bright.any() or self._blank:
            return
        (row, row_end), (column, column_end) = (np.flatnonzero(bright.any(axis=axis))[[0, -1]] for axis in (1, 0))
        margin = MARGIN * max(row_end - row, column_end - column) + 1.0
        height, width = (
            min(end - start + 2.0 * margin, most)
            for start, end, most in ((row, row_end, self.rows), (column, column_end, self.columns))
        )
        if height * width < MOST_LIT * self.rows * self.columns:
            self.part = self._within(row - margin, column - margin, round(height), round(width))

    def zoom(self, x: float, y: float, enlarge: float) -> None:
        """Zoom by a factor about a fixed point.

        Parameters
        ----------
        x, y : float
            Fixed point.
        enlarge : float
            Below 1, more is shown.
        """
        part = self.part
        least = LEAST_PX / max(self.rows, self.columns)
        share = min(1.0, max(least, max(part.width / self.columns, part.height / self.rows) / enlarge))
        width, height = max(1, round(share * self.columns)), max(1, round(share * self.rows))
        row = part.row + y * (part.height - height)
        column = part.column + x * (part.width - width)
        self.part = self._within(row, column, height, width)

    def move(self, dx: float, dy: float) -> None:
        """Shift the picture to the right and down, by fractions of the visible part."""
        part = self.part
        self.part = self._within(part.row - dy * part.height, part.column - dx * part.width, part.height, part.width)

    def pixel(self, x: float, y: float) -> tuple[int, int]:
        """Return row and column of the raw pixel at a position."""
        part = self.part
        row = min(max(int(part.row + y * part.height), 0), self.rows - 1)
        column = min(max(int(part.column + x * part.width), 0), self.columns - 1)
        return self._upright.pixel(row, column, self._shape)

    def pixels(self, x0: float, y0: float, x1: float, y1: float) -> tuple[range, range]:
        """Return the rows and columns of the raw image in the box between two positions.

        Parameters
        ----------
        x0, y0, x1, y1 : float
            Opposite corners.
        """
        first, last = self.pixel(x0, y0), self.pixel(x1, y1)
        rows, columns = (sorted(pair) for pair in zip(first, last, strict=True))
        return range(rows[0], rows[1] + 1), range(columns[0], columns[1] + 1)

    def box(self, rows: range, columns: range) -> tuple[float, float, float, float]:
        """Return left, top, width and height of raw pixels as fractions of the visible part; inverse of `pixels`."""
        part = self.part
        shown_rows, shown_columns = self._upright.box(rows, columns, self._shape)
        return (
            (shown_columns.start - part.column) / part.width,
            (shown_rows.start - part.row) / part.height,
            len(columns) / part.width,
            len(rows) / part.height,
        )

    def pixels_shown(self) -> NDArray[np.uint8]:
        """Return the visible part in whole pixels or, if there are too many, in averages."""
        part = self.part
        cut = self._picture[part.row : part.row + part.height, part.column : part.column + part.width]
        factor = -(-max(cut.shape[:2]) // MOST_PX)
        return cut if factor <= 1 else np.asarray(PIL.Image.fromarray(np.ascontiguousarray(cut)).reduce(factor))

    def centres_shown(self) -> Array:
        """Return the positions (n, 2) of the micro-images' centres; empty if too dense to distinguish."""
        part = self.part
        # Pixel centres lie half a pixel from the edges.
        places = (self._centres + 0.5 - (part.column, part.row)) / (part.width, part.height)
        inside = places[((places >= 0.0) & (places <= 1.0)).all(axis=1)]
        return inside if len(inside) <= MOST_CENTRES else np.empty((0, 2))

    def _within(self, row: float, column: float, height: int, width: int) -> Part:
        return Part(
            min(max(round(row), 0), self.rows - height), min(max(round(column), 0), self.columns - width), height, width
        )
