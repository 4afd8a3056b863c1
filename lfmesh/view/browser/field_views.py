"""Light field of a run for the page: views, photographs, epipolar-plane images, depth."""

import math
import warnings
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from lfmesh.files import exr, run
from lfmesh.files.depth import ESTIMATE, shown_range
from lfmesh.files.field import open_field
from lfmesh.files.folder import saved
from lfmesh.geometry.array.lattice import centre
from lfmesh.lightfield.calibration.calibration import Calibration, calibrate
from lfmesh.lightfield.photographs.refocus import refocus
from lfmesh.lightfield.views.decode import decode
from lfmesh.lightfield.views.field import LightField
from lfmesh.lightfield.views.upright import Upright
from lfmesh.scene import Scene
from lfmesh.transport.render.image import Image
from lfmesh.view.pictures import coloured, exposed, white_of

Picture = NDArray[np.uint8]

STEPS = 100
"""Steps of the refocus slider."""


TURN, CIRCLE = 24, 0.65
"""Views in a parallax animation, and the radius of its circle relative to the pupil's."""


class Place(NamedTuple):
    """Position of a raw pixel in the light field."""

    lenslet: tuple[int, int]
    v: int
    u: int
    t: int
    s: int


def calibration_of_run(scene: Scene, folder: Path | None) -> Calibration:
    """Return the calibration stored in a run, or else trace it."""
    kept = run.open_calibration(folder) if folder is not None else None
    return calibrate(scene) if kept is None else kept


class FieldViews:
    """Pictures of a run's light field.

    Parameters
    ----------
    image : Image
        Image from a light-field camera.
    folder : Path
        Run folder; missing data are computed for the page and not stored.
    calibration : Calibration, optional
        Calibration of the run, if known.

    Raises
    ------
    LfmeshError
        A file of the run is damaged, or its camera records no light field.
    """

    def __init__(self, image: Image, folder: Path, calibration: Calibration | None = None) -> None:
        self.calibration = calibration or calibration_of_run(image.scene, folder)
        field = open_field(folder)
        self.decoded_here = field is None
        if field is None:
            field = decode(image, white=run.open_white(folder), calibration=self.calibration)
        self.field: LightField = field
        self.upright = Upright.of(image.scene)
        self._folder = folder
        self.read_depth()

    def read_depth(self) -> None:
        """Read the depth that the run has, if any.

        Raises
        ------
        FileError
            Its file is damaged.
        """
        depth = saved(self._folder, ESTIMATE)
        self.depth_mm = exr.read_map(depth, ("Z",)) if depth is not None else None
        self._true_depth_mm = exr.read_map(depth, ("truth", "Z")) if depth is not None else None

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.calibration.centres_px.reshape(-1, 2))

    @cached_property
    def _white(self) -> float:
        """White level of views and photographs, from the middle view."""
        rows, columns = self.field.views
        return white_of(self.field.view(rows // 2, columns // 2), self.field.wavelengths_nm)

    def place(self, row: int, column: int) -> Place | None:
        """Return a raw pixel's position in the light field; None if no micro-image covers it."""
        distance, nearest = self._tree.query((column, row))
        if not math.isfinite(distance):
            return None
        lenslet = np.unravel_index(nearest, self.calibration.known.shape)
        middle = self.calibration.centres_px[lenslet]
        views_v, views_u = self.field.views
        sense_u, sense_v = self.upright.senses
        u = round(0.5 * (views_u - 1) + sense_u * (column - middle[0]))
        v = round(0.5 * (views_v - 1) + sense_v * (row - middle[1]))
        if not (0 <= u < views_u and 0 <= v < views_v):
            return None
        return Place((int(lenslet[0]), int(lenslet[1])), v, u, *self._sample(int(lenslet[0]), int(lenslet[1])))

    def _sample(self, row: int, column: int) -> tuple[int, int]:
        """Return the sample (t, s) of a lenslet from its position on the array, the nearest one if resampled."""
        mla = self.calibration.lattice._replace(pitch=self.calibration.lenslet_pitch_mm)
        x, _ = centre(mla, column, row)
        t, _ = self.upright.pixel(row, column, self.calibration.known.shape)
        return t, int(np.argmin(np.abs(self.field.s_mm - self.upright.senses[0] * x)))

    def view(self, v: int, u: int) -> Picture:
        """Return a view, upright."""
        return exposed(self.field.view(v, u), self.field.wavelengths_nm, self._white)

    def epi(self, t: int, v: int) -> Picture:
        """Return the epipolar-plane image of a row, u down and s to the right."""
        return exposed(self.field.epi(t=t, v=v), self.field.wavelengths_nm, self._white)

    def epi_of_column(self, s: int, u: int) -> Picture:
        """Return the epipolar-plane image of a column, v down and t to the right."""
        return exposed(self.field.epi(s=s, u=u), self.field.wavelengths_nm, self._white)

    def round_trip(self) -> list[Picture]:
        """Return the views along a circle in the pupil."""
        (rows, columns), angles = self.field.views, np.arange(TURN) * (2.0 * np.pi / TURN)
        v = np.rint(0.5 * (rows - 1) * (1.0 + CIRCLE * np.sin(angles))).astype(int)
        u = np.rint(0.5 * (columns - 1) * (1.0 + CIRCLE * np.cos(angles))).astype(int)
        return [self.view(int(row), int(column)) for row, column in zip(v, u, strict=True)]

    def photograph(self, distance_mm: float) -> Picture:
        """Return a photograph focused on a plane, from all views."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            picture = refocus(self.field, distance_mm)
        return exposed(picture.mean, self.field.wavelengths_nm, white_of(picture.mean, self.field.wavelengths_nm))

    @cached_property
    def planes_mm(self) -> list[float]:
        """Slider distances, nearest first, at equal steps in the shift between views.

        They span the range of sharp refocusing or, if wider, twice the focal length to infinity.
        """
        model = self.field.model
        near, far = model.refocus_range_mm
        nearest = near if math.isfinite(near) else 2.0 * model.nearest_mm
        shifts = np.linspace(model.shift_mm(nearest), model.shift_mm(far), STEPS + 1)
        distances = [model.distance_mm(float(shift)) for shift in shifts]
        return [distance if distance > 0.0 else math.inf for distance in distances]

    @property
    def focus_step(self) -> int:
        """Slider step of the plane in focus, where views do not shift."""
        focus = self.field.model.distance_mm(0.0)
        return int(np.argmin([abs(1.0 / plane - 1.0 / focus) for plane in self.planes_mm]))

    def depth(self) -> tuple[Picture, float, float] | None:
        """Return the depth map in colours with its end distances, mm; None if the run has none."""
        if self.depth_mm is None or self._true_depth_mm is None:
            return None
        low, high = shown_range(self.depth_mm, self._true_depth_mm) or (0.0, 1.0)
        return coloured(self.depth_mm, low, high), low, high
