"""Upright pictures: turn what lies on the sensor to how an observer behind the camera sees the scene.

The camera frame has x to the right and y up for somebody who stands behind the camera and looks at the objects, along
−z. In an upright picture, columns run along +x and rows along −y of object space. A lens that inverts (negative
magnification) has turned both axes, and rows count along +y: so columns are to be reversed, and rows are right already.
A relay that does not invert has its rows reversed instead. No other place in lfmesh turns pictures.

Pixels within a micro-image are reversed with everything else, and so views come out right too: as ray optics is
symplectic, the sense in which the exit pupil runs over a micro-image against the entrance pupil, whatever the sign of
the pupil magnification, is that in which the scene runs over the array. (Behind a hypercentric lens, whose entrance
pupil lies beyond the objects, (u, v) tell from which side objects are seen.)
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.scene import Scene
from lfmesh.scene.first_order.solve import image_plane_mm

Array = NDArray[np.float64]

UPRIGHT = "upright"
"""Label in files of pictures whose columns run along +x and whose rows run along −y of object space."""

ON_SENSOR = (
    "as on the sensor: the middle of row r and column c lies at y = (r - (rows - 1) / 2) * pixel and "
    "x = (c - (columns - 1) / 2) * pixel in the sensor's frame"
)
"""Label in files of raw images and places in them."""


@dataclass(frozen=True)
class Upright:
    """Maps that turn pictures on the sensor upright; each is its own inverse.

    Attributes
    ----------
    inverts : bool
        Whether the lens images the scene upside down onto array or sensor, as all but relays do.
    """

    inverts: bool

    @classmethod
    def of(cls, scene: Scene) -> "Upright":
        """Find by first-order optics whether a scene's lens inverts.

        The plane in focus decides; where it lies at infinity or is virtual, the chief rays of distant objects do.
        """
        camera = solved_camera(scene)
        lens = camera.paraxial
        image = image_plane_mm(camera.scene.camera, camera.scene.primary_nm)
        distance = lens.object_mm(image)
        if 0.0 < distance < np.inf:
            return cls(lens.magnification(distance) < 0.0)
        # A chief ray that rises comes from a distant object at negative heights.
        return cls(lens.chief_scale_mm(np.inf, image) < 0.0)

    @property
    def senses(self) -> tuple[float, float]:
        """1 or −1: how columns and rows of a picture run against those of the sensor, and (u, v) against pixels."""
        return (-1.0, 1.0) if self.inverts else (1.0, -1.0)

    def picture(self, pixels: NDArray[Any]) -> NDArray[Any]:
        """Return a view of a raw image (rows, columns, ...) as an upright picture; or back again.

        What belongs to the lenslets, (rows, columns, ...) of the array, is turned in the same way.
        """
        return pixels[:, ::-1] if self.inverts else pixels[::-1]

    def rows(self, count: int) -> NDArray[np.int64]:
        """Return the row of the sensor, or of the array, that each row of a picture shows, from the top."""
        return np.arange(count) if self.inverts else np.arange(count)[::-1]

    def columns(self, count: int) -> NDArray[np.int64]:
        """Return the column of the sensor, or of the array, that each column of a picture shows, from the left."""
        return np.arange(count)[::-1] if self.inverts else np.arange(count)

    def pixel(self, row: int, column: int, shape: tuple[int, int]) -> tuple[int, int]:
        """Return where a pixel of an image with `shape` (rows, columns) lies in the picture; or back again.

        Parameters
        ----------
        row, column : int
        shape : (int, int)
            Rows and columns of the image.
        """
        rows, columns = shape
        return (row, columns - 1 - column) if self.inverts else (rows - 1 - row, column)

    def box(self, rows: range, columns: range, shape: tuple[int, int]) -> tuple[range, range]:
        """Return the rows and columns of the picture that a box of pixels fills; or back again.

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
        """Return where points (..., 2) of an image, (column, row) in pixels, lie in the picture; or back again."""
        rows, columns = shape
        (along_x, along_y), last = self.senses, np.array([columns - 1.0, rows - 1.0])
        return np.where(np.array([along_x, along_y]) < 0.0, last - points, points)

    @property
    def raw_in_words(self) -> str:
        """Orientation of raw images, and the map that turns them upright, in words, for files of raw images."""
        turn = "columns reversed, [:, ::-1]" if self.inverts else "rows reversed, [::-1]"
        return f"{ON_SENSOR}; an upright picture is this with its {turn}"
