"""Object-space rays of a camera's samples, fitted by a polynomial in sample and view.

Views and samples are counted by the calibration that decoded the picture. A sample's ray passes through the apex of its
lenslet; the mean of all its rays is slightly different.
"""

from dataclasses import dataclass
from itertools import combinations_with_replacement, product

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from lfmesh.errors import LfmeshError
from lfmesh.geometry import frame as frames
from lfmesh.geometry.lens.main_order import with_main_orders
from lfmesh.lightfield.calibration.calibration import Calibration
from lfmesh.lightfield.rays.chief_rays import plate_of
from lfmesh.lightfield.rays.object_rays import object_rays
from lfmesh.lightfield.rays.pixel_bundles import bundles
from lfmesh.lightfield.views.decode import Sampling, sampling_of, view_count
from lfmesh.lightfield.views.upright import Upright
from lfmesh.scene import Scene
from lfmesh.transport.build import build

Array = NDArray[np.float64]

DEGREE = 5
"""Degree of the polynomial in s, t, u and v."""

VIEWS, ACROSS = 8, 7
"""Numbers of traced views and lenslets along each axis."""

WHOLE = 0.95
"""Fraction of the brightest bundle's light below which a bundle is vignetted."""


@dataclass(frozen=True, eq=False)
class RayMap:
    """Rays in front of the lens as a function of sample and view.

    Attributes
    ----------
    coefficients : (terms, 4) float64
        Coefficients of x and y (mm) at the plane of the first vertex, and of dx/dz and dy/dz; camera frame.
    size : (2,) float64
        Width and height of a view, in samples.
    reach : float
        Range of the map in views from the middle one.
    rms : (4,) float64
        Rms residual of the traced rays.
    """

    coefficients: Array
    size: Array
    reach: float
    rms: Array

    @classmethod
    def of(cls, scene: Scene, decoded: Calibration, reach: float, *, of_bundles: bool = False) -> "RayMap":
        """Trace a camera's rays.

        Parameters
        ----------
        scene : Scene
            Solved.
        decoded : Calibration
            Calibration that defines samples and views.
        reach : float
            Views from the middle one, along each axis.
        of_bundles : bool
            Trace the mean ray of a pixel's bundle instead of the apex ray.

        Raises
        ------
        LfmeshError
            The lens blocks nearly all of the rays.
        """
        upright = Upright.of(scene)
        sampling = sampling_of(decoded, upright)
        size = np.array([len(sampling.s_mm), len(sampling.t_mm)], np.float64)
        rows, columns, samples = _lenslets(sampling, decoded.known)
        views = np.stack(np.meshgrid(*[_chebyshev(VIEWS) * reach] * 2), axis=-1).reshape(-1, 2)
        pixels = decoded.centres_px[rows, columns][:, None] + views * np.array(upright.senses)
        numbers = np.repeat(np.column_stack([columns, rows]), len(views), axis=0)
        place = np.column_stack([np.repeat(samples, len(views), axis=0), np.tile(views, (len(rows), 1))])
        trace = _mean_rays if of_bundles else _apex_rays
        value = trace(scene, numbers, pixels.reshape(-1, 2))
        whole = np.isfinite(value).all(axis=1)
        place, value = place[whole], value[whole]
        terms = _terms(_scaled(place, size, reach))
        if len(terms) < 4 * terms.shape[1]:
            raise LfmeshError("camera: almost no ray of the views passes the lens; check it with lfmesh check")
        q, r = np.linalg.qr(terms)
        coefficients = np.linalg.solve(r, q.T @ value)
        return cls(
            np.asarray(coefficients, np.float64),
            size,
            reach,
            np.sqrt(np.mean((terms @ coefficients - value) ** 2, axis=0)),
        )

    def terms(self, place: Array, spread: Array) -> Array:
        """Return the (n, terms) monomials for the mean ray of each sample, to be multiplied by the coefficients.

        A sample's mean over pixels is taken as that of two views, one standard deviation to either side: exact for
        cubic terms in u and v, such as the lens's aberrations.

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
    """Return the standard deviation of u and v within samples, (n, 2), in views.

    A sample averages over pixels and interpolates between them.

    Parameters
    ----------
    decoded : Calibration
        Calibration that defines samples and views.
    scene : Scene
    place : (n, 4) float64
        Sample s and t, view u and v from the middle one.
    """
    sampling = sampling_of(decoded, Upright.of(scene))
    # Views lie at whole or half pixels from the centre, depending on their number.
    offset = (0.5 * (view_count(decoded, None) - 1)) % 1.0
    part = (decoded.centres_px + offset) % 1.0
    between = uniform_filter((part * (1.0 - part))[sampling.rows], (AROUND, AROUND, 1), mode="nearest")
    parity = sampling.rows & 1
    column = sampling.columns[parity] + np.rint(sampling.share[parity]).astype(np.int64)
    on_samples = np.take_along_axis(between, column[..., None], axis=1)
    t, s = (np.clip(np.rint(place[:, i]).astype(np.int64), 0, on_samples.shape[1 - i] - 1) for i in (1, 0))
    # A pixel's variance is 1/12; a mean of two pixels with weights w and 1 − w adds w (1 − w).
    return np.asarray(np.sqrt(1.0 / 12.0 + on_samples[t, s]))


AROUND = 5
"""Samples along each axis whose interpolation affects a corner."""


def _apex_rays(scene: Scene, lenslets: NDArray[np.int64], pixels: Array) -> Array:
    """Return the rays of pixels through the apexes of lenslets, (n, 4); NaN where blocked."""
    rays = object_rays(scene, lenslets, pixels)
    own = scene.camera.pose
    to_camera = frames.inverse(frames.frame(own.tilt_deg, own.shift_mm))
    p, d = frames.points(to_camera, rays.origin), frames.directions(to_camera, rays.direction)
    slope = d[:, :2] / d[:, 2:]
    return np.column_stack([p[:, :2] - p[:, 2:] * slope, slope])


def _mean_rays(scene: Scene, lenslets: NDArray[np.int64], pixels: Array) -> Array:
    """Return the mean rays of the pixels' bundles, (n, 4); NaN where vignetted."""
    plate = plate_of(scene)
    numbers = lenslets[:, 1] * plate.lenslets.lattice.columns + lenslets[:, 0]
    found = bundles(build(with_main_orders(scene.camera_alone())), plate, numbers, pixels)
    return np.where(found.weight[:, None] > WHOLE * found.weight.max(initial=0.0), found.mean, np.nan)


def _lenslets(sampling: Sampling, known: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Return rows and columns, (n,), of lenslets spread over the array, and their samples s and t, (n, 2)."""
    t = np.unique(np.linspace(0, len(sampling.t_mm) - 1, ACROSS).astype(np.int64))
    rows, columns, samples = [], [], []
    for each in t:
        row = int(sampling.rows[each])
        at = sampling.columns[row & 1] + sampling.share[row & 1]
        order = np.argsort(at)
        column = np.unique(np.linspace(np.ceil(at.min()), np.floor(at.max()), ACROSS).astype(np.int64))
        column = column[known[row, column]]
        rows.append(np.full(len(column), row))
        columns.append(column)
        s = np.interp(column, at[order], order.astype(np.float64))
        samples.append(np.column_stack([s, np.full(len(column), float(each))]))
    return np.concatenate(rows), np.concatenate(columns), np.concatenate(samples)


def _chebyshev(count: int) -> Array:
    return np.asarray(np.cos(np.pi * (np.arange(count) + 0.5) / count))


def _scaled(place: Array, size: Array, reach: float) -> Array:
    """Return s, t, u, v, scaled to about −1..1."""
    half = np.maximum(0.5 * (size - 1.0), 1.0)
    return np.column_stack([(place[:, :2] - 0.5 * (size - 1.0)) / half, place[:, 2:] / reach])


def _terms(scaled: Array) -> Array:
    columns = [np.ones(len(scaled))]
    for degree in range(1, DEGREE + 1):
        columns += [scaled[:, list(which)].prod(axis=1) for which in combinations_with_replacement(range(4), degree)]
    return np.stack(columns, axis=1)
