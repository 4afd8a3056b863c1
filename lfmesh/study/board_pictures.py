"""Boards before a camera: pictures of checkerboards, decoded into views, or lists of corners."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from lfmesh.errors import LfmeshError
from lfmesh.lightfield.calibration import calibrate
from lfmesh.lightfield.decode import sampling_of, sorted_views, view_count
from lfmesh.lightfield.detector import Exposed
from lfmesh.lightfield.upright import Upright
from lfmesh.scene import Scene
from lfmesh.study.board_corners import BoardCorners, find_corners
from lfmesh.study.white_picture import Orientation, light_of
from lfmesh.transport.render.image import Image

Array = NDArray[np.float64]

BRIGHT, WHOLE = 0.5, 0.93
"""Of the brightest view of a lenslet, on the white image: the views that have more tell, by their median, what is full
light; the lens cuts that of a sample with less than the second of this."""

AROUND = 3
"""Samples along each axis over which the white image is averaged for that, against its noise."""


@dataclass(frozen=True, eq=False)
class Board:
    """A picture of a checkerboard, or the corners found on one.

    Attributes
    ----------
    picture : Image, Exposed or (H, W) or (H, W, channels) array, optional
        Linear in light.
    square_mm : float, optional
        Side of a square; with a picture.
    columns, rows : int, optional
        Corners between four squares, along x and y of the board, of whose outer columns and rows most must be seen.
        Omitted: as many as are seen.
    corners : BoardCorners, optional
        In place of a picture.
    """

    picture: Image | Exposed | NDArray[Any] | None = None
    square_mm: float | None = None
    columns: int | None = None
    rows: int | None = None
    corners: BoardCorners | None = None

    def __post_init__(self) -> None:
        if (self.picture is None) == (self.corners is None):
            raise LfmeshError("board: give a picture, with square_mm, or corners")
        if self.picture is not None and not (self.square_mm is not None and 0.0 < self.square_mm < np.inf):
            raise LfmeshError(f"board: square_mm = {self.square_mm}: must be the side of a square, above 0 and finite")
        for name in ("columns", "rows"):
            count = getattr(self, name)
            if count is not None and count < 2:
                raise LfmeshError(f"board: {name} = {count}: must be 2 or more corners between four squares")


def fully_lit(by_white: Array) -> NDArray[np.bool_]:
    """Return the samples whose light the lens does not cut, (v, u, t, s).

    Those that it cuts see through another part of the pupil than the rays of their middle say.

    Parameters
    ----------
    by_white : (v, u, t, s) float64
        White image as views; NaN: unknown.
    """
    smooth = uniform_filter(np.nan_to_num(by_white), (1, 1, AROUND, AROUND), mode="nearest")
    bright = np.where(smooth > BRIGHT * smooth.max(axis=(0, 1)), smooth, np.nan)
    full = np.nanmedian(bright.reshape(-1, *bright.shape[2:]), axis=0)
    return np.asarray((smooth > WHOLE * full) & np.isfinite(by_white))


def corners_of(
    boards: Sequence[Board], scene: Scene, white: Array, orientation: Orientation
) -> tuple[BoardCorners, ...]:
    """Return the corners of boards, in the views that the scene's calibration decodes.

    Parameters
    ----------
    boards : sequence of Board
    scene : Scene
        Solved.
    white : (H, W) float64
        White image, as it lies on the sensor.
    orientation : {"upright", "upside_down", "sensor"}
        Of pictures that are arrays.

    Raises
    ------
    LfmeshError
        A picture that is none of this camera, or on which the board is not found.
    """
    calibration, upright = calibrate(scene), Upright.of(scene)
    sampling, count = sampling_of(calibration, upright), view_count(calibration, None)
    by_white = sorted_views(white, calibration, count, sampling, upright)
    usable = fully_lit(by_white)
    found = []
    for number, board in enumerate(boards, 1):
        try:
            if board.picture is None or board.square_mm is None:
                found += [] if board.corners is None else [board.corners]
                continue
            light = light_of(board.picture, scene, orientation, "picture of the board")
            seen = sorted_views(light, calibration, count, sampling, upright)
            ratio = np.divide(seen, by_white, out=np.full_like(seen, np.nan), where=usable)
            found.append(find_corners(ratio, usable, board.square_mm, board.columns, board.rows))
        except LfmeshError as error:
            raise LfmeshError(str(error).replace("board", f"board {number}", 1)) from None
    return tuple(found)
