"""Boards in front of a camera: checkerboard pictures decoded into views, or corner lists."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from lfmesh.errors import LfmeshError
from lfmesh.geometry.array.lattice import Lattice
from lfmesh.lightfield.calibration.calibration import Calibration, calibrate
from lfmesh.lightfield.detector import Exposed
from lfmesh.lightfield.views.decode import Sampling, sampling_of, sorted_views, view_count
from lfmesh.lightfield.views.upright import Upright
from lfmesh.scene import Scene
from lfmesh.study.fits.board_corners import BoardCorners, find_corners
from lfmesh.study.fits.white_picture import Orientation, light_of
from lfmesh.transport.render.image import Image

Array = NDArray[np.float64]

BRIGHT, WHOLE = 0.5, 0.93
"""Fraction of a lenslet's brightest view, on the white image, above which views define full light by their median; and
fraction of full light below which a sample is vignetted."""

FOREIGN = 0.002
"""Largest fraction of a sample's light from neighbouring lenslets, which see the board about one sample away."""

AROUND = 3
"""Samples along each axis over which the white image is averaged for that, to reduce its noise."""


@dataclass(frozen=True, eq=False)
class Board:
    """A picture of a checkerboard, or the corners found on one.

    Attributes
    ----------
    picture : Image, Exposed or (H, W) or (H, W, channels) array, optional
        Linear in light.
    square_mm : float, optional
        Side of a square; needed with a picture.
    columns, rows : int, optional
        Inner corners along x and y of the board; most of the outermost must be visible. Default: all visible ones.
    corners : BoardCorners, optional
        In place of a picture.
    """

    picture: Image | Exposed | NDArray[Any] | None = field(default=None, repr=False)
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
    """Return the samples that the lens does not vignette, (v, u, t, s).

    The others use another part of the pupil than their central rays.

    Parameters
    ----------
    by_white : (v, u, t, s) float64
        White image as views; NaN: unknown.
    """
    smooth = uniform_filter(np.nan_to_num(by_white), (1, 1, AROUND, AROUND), mode="nearest")
    bright = np.where(smooth > BRIGHT * smooth.max(axis=(0, 1)), smooth, np.nan)
    full = np.nanmedian(bright.reshape(-1, *bright.shape[2:]), axis=0)
    return np.asarray((smooth > WHOLE * full) & np.isfinite(by_white))


def of_own_lenslets(calibration: Calibration, sampling: Sampling, upright: Upright, count: int) -> NDArray[np.bool_]:
    """Return the samples whose pixels get no light of neighbouring lenslets, (v, u, t, s).

    The white image of touching micro-images cannot show this: a neighbour's light makes up for vignetting.

    Parameters
    ----------
    calibration : Calibration
    sampling : Sampling
    upright : Upright
    count : int
        Views along each axis.
    """
    radius = 0.5 * calibration.lenslet_to_sensor_mm / calibration.f_number / calibration.pixel_mm
    hexagonal = calibration.layout == "hexagonal"
    ideal = Lattice(hexagonal, 1.0, *calibration.known.shape[::-1]).centres().reshape(-1, 2)
    to_px = np.linalg.lstsq(np.column_stack([ideal, np.ones(len(ideal))]), calibration.centres_px.reshape(-1, 2))[0][:2]
    turns = np.deg2rad(np.arange(0, 360, 60 if hexagonal else 90))
    neighbours = np.column_stack([np.cos(turns), np.sin(turns)]) @ to_px
    from_middle = np.arange(count) - 0.5 * (count - 1)
    views = np.stack(np.meshgrid(from_middle, from_middle), axis=-1) * np.array(upright.senses)
    parity = sampling.rows & 1
    left, share = sampling.columns[parity], sampling.share[parity]
    foreign = np.zeros((count, count, *left.shape))
    for weight, column in ((1.0 - share, left), (share, np.minimum(left + 1, calibration.known.shape[1] - 1))):
        centres = calibration.centres_px[sampling.rows[:, None], column]
        at = centres + views[:, :, None, None]
        first = np.floor(at)
        for corner in np.ndindex(2, 2):
            part = np.where(corner, at - first, 1.0 - (at - first)).prod(axis=-1)
            pixel = first + corner - centres
            foreign += weight * part * sum(_overlap(radius, pixel - each) for each in neighbours)
    return np.asarray(foreign <= FOREIGN)


def _overlap(radius: float, away: Array) -> Array:
    """Return the approximate fraction of unit pixels inside a disk; exactly 0 only outside.

    Parameters
    ----------
    radius : float
    away : (..., 2) float64
        From the disk's centre to the pixel's.
    """
    distance = np.linalg.norm(away, axis=-1)
    reach = 0.5 * np.abs(away).sum(axis=-1) / distance
    return np.asarray(np.clip(radius + reach - distance, 0.0, 1.0))


def corners_of(
    boards: Sequence[Board], scene: Scene, white: Array, orientation: Orientation
) -> tuple[BoardCorners, ...]:
    """Return the corners of boards in the views decoded with the scene's calibration.

    Parameters
    ----------
    boards : sequence of Board
    scene : Scene
        Solved.
    white : (H, W) float64
        White image, as it lies on the sensor.
    orientation : {"upright", "upside_down", "sensor"}
        Orientation of pictures that are arrays.

    Raises
    ------
    LfmeshError
        A picture is not this camera's, or shows no board.
    """
    calibration, upright = calibrate(scene), Upright.of(scene)
    sampling, count = sampling_of(calibration, upright), view_count(calibration, None)
    by_white = sorted_views(white, calibration, count, sampling, upright)
    usable = fully_lit(by_white) & of_own_lenslets(calibration, sampling, upright, count)
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
