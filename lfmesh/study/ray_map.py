"""Rays of a camera's views in object space as a smooth function of sample and view: a polynomial fitted to traced ones.

Views and samples are those of another camera, the one by which a picture was decoded: a ray belongs to the pixel that
it lands on, and so to the view that this pixel has there.
"""

from dataclasses import dataclass
from itertools import combinations_with_replacement, product

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from lfmesh.errors import LfmeshError
from lfmesh.geometry import frame as frames
from lfmesh.lightfield.calibration import Calibration
from lfmesh.lightfield.decode import sampling_of, view_count
from lfmesh.lightfield.upright import Upright
from lfmesh.lightfield.view_rays import ViewRays
from lfmesh.scene import Scene
from lfmesh.transport.packets.packet import CAMERA_FRAME, WORLD_FRAME
from lfmesh.transport.trace import Status

Array = NDArray[np.float64]

DEGREE = 5
"""Of the polynomial in s, t, u and v."""

VIEWS, ACROSS = 7, 8
"""Along each axis: the views that are traced, and the samples in each."""


@dataclass(frozen=True, eq=False)
class RayMap:
    """Rays before the lens by sample and view.

    Attributes
    ----------
    coefficients : (terms, 4) float64
        Of x and y (mm) where a ray crosses the plane of the first vertex, and of dx/dz and dy/dz; camera frame.
    size : (2,) float64
        Width and height of a view, in samples.
    reach : float
        Views from the middle one, to which the map goes.
    rms : (4,) float64
        What the polynomial leaves of the traced rays.
    """

    coefficients: Array
    size: Array
    reach: float
    rms: Array

    @classmethod
    def of(cls, scene: Scene, decoded: Calibration, reach: float) -> "RayMap":
        """Trace a camera's rays.

        Parameters
        ----------
        scene : Scene
            Solved.
        decoded : Calibration
            By which samples and views are counted.
        reach : float
            Views from the middle one, along each axis.

        Raises
        ------
        LfmeshError
            The lens lets hardly any of the rays through.
        """
        rays = ViewRays.of_camera(scene)
        height, width = rays.size
        every = max(1, height // ACROSS), max(1, width // ACROSS)
        t, s = (index.ravel() for index in np.mgrid[0 : height : every[0], 0 : width : every[1]])
        senses, size = np.array(Upright.of(scene).senses), np.array([width, height], float)
        to_camera = rays.world.tables.frames[WORLD_FRAME, CAMERA_FRAME]
        places, values = [], []
        # Chebyshev's points keep a polynomial tame up to the border.
        for v, u in np.array(np.meshgrid(*[_chebyshev(VIEWS) * reach] * 2)).reshape(2, -1).T:
            paths, sample = rays.trace(float(v), float(u), every)
            out = paths.status == Status.ESCAPED
            # Rays that land on a pixel belong to the view which that pixel has by the calibration.
            beside = rays.of_samples((rays.landing_px(float(v), float(u)) - decoded.centres_px) * senses)
            view = beside[:: every[0], :: every[1]].reshape(-1, 2)[sample[out]]
            p = frames.points(to_camera, paths.position[out])
            d = frames.directions(to_camera, paths.direction[out])
            slope = d[:, :2] / d[:, 2:]
            places.append(np.column_stack([s[sample[out]], t[sample[out]], view]))
            values.append(np.column_stack([p[:, :2] - p[:, 2:] * slope, slope]))
        place, value = np.concatenate(places), np.concatenate(values)
        terms = _terms(_scaled(place, size, reach))
        if len(terms) < 4 * terms.shape[1]:
            raise LfmeshError("camera: the lens lets hardly any ray of the views through; check it with lfmesh check")
        coefficients, *_ = np.linalg.lstsq(terms, value, rcond=None)
        return cls(coefficients, size, reach, np.sqrt(np.mean((terms @ coefficients - value) ** 2, axis=0)))

    def terms(self, place: Array, spread: Array) -> Array:
        """Return the (n, terms) monomials by which the coefficients are to be multiplied, for the mean ray of a sample.

        The mean over a pixel, or over the two between which a sample is interpolated, is that of two views a standard
        deviation to either side, exact up to cubes: of u and v, as aberrations of the lens are.

        Parameters
        ----------
        place : (n, 4) float64
            Sample s and t, view u and v from the middle one.
        spread : (n, 2) float64
            Standard deviation of u and v within a sample, in views.
        """
        ends = [
            np.column_stack([place[:, :2], place[:, 2:] + spread * np.array(sides)])
            for sides in product((1.0, -1.0), repeat=2)
        ]
        return np.asarray(np.mean([_terms(_scaled(end, self.size, self.reach)) for end in ends], axis=0))


def view_spread(decoded: Calibration, scene: Scene, place: Array) -> Array:
    """Return the standard deviation of u and v within samples, (n, 2), in views: pixels, and interpolation of them.

    Parameters
    ----------
    decoded : Calibration
        By which samples and views are counted.
    scene : Scene
    place : (n, 4) float64
        Sample s and t, view u and v from the middle one.
    """
    sampling = sampling_of(decoded, Upright.of(scene))
    # Views lie at whole pixels, or halves, from the centre: the last view's place tells which.
    offset = (0.5 * (view_count(decoded, None) - 1)) % 1.0
    part = (decoded.centres_px + offset) % 1.0
    between = uniform_filter((part * (1.0 - part))[sampling.rows], (AROUND, AROUND, 1), mode="nearest")
    parity = sampling.rows & 1
    column = sampling.columns[parity] + np.rint(sampling.share[parity]).astype(np.int64)
    on_samples = np.take_along_axis(between, column[..., None], axis=1)
    t, s = (np.clip(np.rint(place[:, i]).astype(np.int64), 0, on_samples.shape[1 - i] - 1) for i in (1, 0))
    # A pixel's variance is 1/12, that of a mean of two pixels with weights w and 1 − w is w (1 − w) more.
    return np.asarray(np.sqrt(1.0 / 12.0 + on_samples[t, s]))


AROUND = 5
"""Samples along each axis whose interpolation counts for a corner."""


def _chebyshev(count: int) -> Array:
    return np.asarray(np.cos(np.pi * (np.arange(count) + 0.5) / count))


def _scaled(place: Array, size: Array, reach: float) -> Array:
    """Return s, t, u, v, each within about −1..1."""
    half = np.maximum(0.5 * (size - 1.0), 1.0)
    return np.column_stack([(place[:, :2] - 0.5 * (size - 1.0)) / half, place[:, 2:] / reach])


def _terms(scaled: Array) -> Array:
    columns = [np.ones(len(scaled))]
    for degree in range(1, DEGREE + 1):
        columns += [scaled[:, list(which)].prod(axis=1) for which in combinations_with_replacement(range(4), degree)]
    return np.stack(columns, axis=1)
