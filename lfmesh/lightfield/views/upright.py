"""Upright pictures: turn sensor images to the orientation seen by an observer behind the camera.

In the camera frame, x points right and y up for an observer behind the camera who looks at the objects, along −z.
Columns of an upright picture run along +x, rows along −y of object space. A lens that inverts (negative magnification)
turns both axes: rows on the sensor are then upright, and columns must be reversed. A relay that does not invert needs
its rows reversed. No other module turns pictures.

Pixels within a micro-image are reversed too, which also turns the views correctly. As ray optics is symplectic, the
entrance pupil runs over a micro-image in the same sense as the scene over the array, for either sign of the pupil
magnification. (Behind a hypercentric lens, with its entrance pupil beyond the objects, (u, v) give the side of the
view.)
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.lens.orientation import image_inverts
from lfmesh.scene import Scene

Array = NDArray[np.float64]

UPRIGHT = "upright"
"""Label in files of pictures with columns along +x and rows along −y of object space."""

ON_SENSOR = (
    "as on the sensor: the middle of row r and column c lies at y = (r - (rows - 1) / 2) * pixel and "
    "x = (c - (columns - 1) / 2) * pixel in the sensor's frame"
)
"""Label in files of raw images and places in them."""


@dataclass(frozen=True)
class Upright:
    """Maps that turn sensor images upright; each is its own inverse.

    Attributes
    ----------
    inverts : bool
        True if the lens images the scene upside down onto array or sensor, as all but relays do. A single
        gradient-index rod before the sensor counts as a part of the lens.
    """

    inverts: bool

    @classmethod
    def of(cls, scene: Scene) -> "Upright":
        """Determine by first-order optics whether a scene's lens inverts."""
        return cls(image_inverts(scene))

    @property
    def senses(self) -> tuple[float, float]:
        """Directions, 1 or −1, of a picture's columns and rows on the sensor, and of (u, v) over pixels."""
        return (-1.0, 1.0) if self.inverts else (1.0, -1.0)

    def picture(self, pixels: NDArray[Any]) -> NDArray[Any]:
        """Turn a raw image (rows, columns, ...) upright, or back, as a view.

        Arrays over the lenslets, (rows, columns, ...), are turned in the same way.
        """
        return pixels[:, ::-1] if self.inverts else pixels[::-1]

    def rows(self, count: int) -> NDArray[np.int64]:
        """Return the row of the sensor, or of the array, for each row of a picture, from the top."""
        return np.arange(count) if self.inverts else np.arange(count)[::-1]

    def columns(self, count: int) -> NDArray[np.int64]:
        """Return the column of the sensor, or of the array, for each column of a picture, from the left."""
        return np.arange(count)[::-1] if self.inverts else np.arange(count)

    def pixel(self, row: int, column: int, shape: tuple[int, int]) -> tuple[int, int]:
        """Return the picture's pixel for a pixel of an image with `shape`, or back.

        Parameters
        ----------
        row, column : int
        shape : (int, int)
            Rows and columns of the image.
        """
        rows, columns = shape
        return (row, columns - 1 - column) if self.inverts else (rows - 1 - row, column)

    def box(self, rows: range, columns: range, shape: tuple[int, int]) -> tuple[range, range]:
        """Return the picture's rows and columns for a box of pixels, or back.

        Parameters
        ----------
        rows, columns : range
        shape : (int, int)
            Rows and columns of the image.
        """
        height, width = shape
        if self.inverts:
            return rows, range(width - columns.stop, width - columns.start)
        return range(height - rows.stop, height - rows.start), columns

    def points_px(self, points: Array, shape: tuple[int, int]) -> Array:
        """Map points (..., 2) of an image, (column, row) in pixels, to the picture, or back."""
        rows, columns = shape
        (along_x, along_y), last = self.senses, np.array([columns - 1.0, rows - 1.0])
        return np.where(np.array([along_x, along_y]) < 0.0, last - points, points)

    @property
    def raw_in_words(self) -> str:
        """Orientation of raw images and the map that turns them upright, in words, for their files."""
        turn = "columns reversed, [:, ::-1]" if self.inverts else "rows reversed, [::-1]"
        return f"{ON_SENSOR}; an upright picture is this with its {turn}"
