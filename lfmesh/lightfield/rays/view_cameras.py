"""Views as pinhole cameras: intrinsics, distortion and extrinsics in OpenCV's convention, fitted to traced rays.

OpenCV's camera frame has x to the right, y down and z ahead: diag(1, −1, −1) of ours. The pixels of a view are its
samples (s, t), with the centre of the first at (0, 0). As a view's rays do not meet in one point, a pinhole holds only
at the distances of the fit, to its stated error.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from lfmesh.geometry import frame as frames
from lfmesh.lightfield.rays.view_rays import ViewRays
from lfmesh.notebook import Say, silent
from lfmesh.transport.packets.packet import CAMERA_FRAME, WORLD_FRAME
from lfmesh.transport.trace import Status

Array = NDArray[np.float64]

ACROSS = 15
"""Samples along each axis of a view used for the pinhole fit."""

LEAST_RAYS = 12
"""Fewest rays for the pinhole of a view."""

TO_OPENCV = np.diag([1.0, -1.0, -1.0])


class ViewCameras(NamedTuple):
    """One pinhole per view, indexed (v, u) like `LightField`; NaN for views that the lens stops.

    Attributes
    ----------
    intrinsics : (v, u, 3, 3) float64
        fx, fy, cx, cy in samples.
    distortion : (v, u, 4) float64
        k1, k2, p1, p2.
    rotation, translation_mm : (v, u, 3, 3) and (v, u, 3) float64
        A point X of the world frame lies at R X + t in the view's frame.
    rms_error, largest_error : (v, u) float64
        Of the fitted rays, in samples.
    distances_mm : (n,) float64
        Distances of the fit before the first vertex.
    size : (2,) int64
        Height and width of a view, in samples.
    """

    intrinsics: Array
    distortion: Array
    rotation: Array
    translation_mm: Array
    rms_error: Array
    largest_error: Array
    distances_mm: Array
    size: NDArray[np.int64]

    def project(self, points_mm: Array, v: int, u: int) -> Array:
        """Project points into a view, (n, 2): sample s and t.

        Parameters
        ----------
        points_mm : (n, 3) array_like
            World frame.
        v, u : int
            Row and column of the view.
        """
        seen = np.asarray(points_mm, dtype=np.float64) @ self.rotation[v, u].T + self.translation_mm[v, u]
        focal, middle = np.diag(self.intrinsics[v, u])[:2], self.intrinsics[v, u, :2, 2]
        return distorted(seen[:, :2] / seen[:, 2:], self.distortion[v, u]) * focal + middle


def distorted(place: Array, distortion: Array) -> Array:
    """Apply OpenCV's distortion k1, k2, p1, p2 to (n, 2) tangents of angles."""
    x, y = place.T
    k1, k2, p1, p2 = distortion
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * k2)
    return np.column_stack(
        [
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ]
    )


def view_cameras(rays: ViewRays, views: int, distances_mm: Array, say: Say = silent) -> ViewCameras:
    """Fit a pinhole to the rays of every view.

    Parameters
    ----------
    rays : ViewRays
        Of a camera with nothing before it.
    views : int
        Along each axis.
    distances_mm : (n,) float64
        Distances of the fit before the first vertex.
    say : callable, optional
        Called with the progress in words.
    """
    shape = (views, views)
    intrinsics, rotation = np.full((2, *shape, 3, 3), np.nan)
    distortion, translation = np.full((*shape, 4), np.nan), np.full((*shape, 3), np.nan)
    rms, largest = np.full((2, *shape), np.nan)
    height, width = rays.size
    every = max(1, height // ACROSS), max(1, width // ACROSS)
    t, s = (index.ravel() for index in np.mgrid[0 : height : every[0], 0 : width : every[1]])
    to_camera = rays.world.tables.frames[WORLD_FRAME, CAMERA_FRAME]
    turn = TO_OPENCV @ to_camera[:, :3]
    for v, u in np.ndindex(shape):
        say(f"camera model: view {v * views + u + 1} of {views * views}")
        paths, sample = rays.trace(v - 0.5 * (views - 1), u - 0.5 * (views - 1), every)
        out = paths.status == Status.ESCAPED
        if out.sum() < LEAST_RAYS:
            continue
        p = frames.points(to_camera, paths.position[out]) @ TO_OPENCV
        d = frames.directions(to_camera, paths.direction[out]) @ TO_OPENCV
        slope = d[:, :2] / d[:, 2:]
        at_vertex = p[:, :2] - p[:, 2:] * slope
        seen = np.column_stack([s[sample[out]], t[sample[out]]]).astype(np.float64)
        values, errors = _pinhole(at_vertex, slope, seen, distances_mm)
        intrinsics[v, u] = np.array([[values[3], 0.0, values[5]], [0.0, values[4], values[6]], [0.0, 0.0, 1.0]])
        distortion[v, u], rotation[v, u] = values[7:], turn
        # R X + t = D (x − C), with x the point in our camera frame.
        translation[v, u] = TO_OPENCV @ to_camera[:, 3] - values[:3]
        rms[v, u], largest[v, u] = np.sqrt(np.mean(errors**2)), errors.max()
    size = np.array([height, width])
    return ViewCameras(intrinsics, distortion, rotation, translation, rms, largest, np.asarray(distances_mm), size)


def _pinhole(at_vertex: Array, slope: Array, seen: Array, distances: Array) -> tuple[Array, Array]:
    """Fit a pinhole to rays.

    Parameters
    ----------
    at_vertex, slope : (n, 2) float64
        Points of the rays in the plane of the first vertex, and dx/dz and dy/dz; OpenCV's axes.
    seen : (n, 2) float64
        Sample s and t of each ray.
    distances : (m,) float64, mm

    Returns
    -------
    values : (11,) float64
        Centre x, y, z; fx, fy, cx, cy; k1, k2, p1, p2.
    errors : (n · m,) float64
        Distance, in samples, of each projected point from its ray's sample.
    """
    count = len(seen)
    # Point of closest approach by least squares across the axis: x + z dx/dz = C.
    one, zero = np.ones(count), np.zeros(count)
    terms = np.concatenate([np.column_stack([-slope[:, 0], one, zero]), np.column_stack([-slope[:, 1], zero, one])])
    (z, x, y), *_ = np.linalg.lstsq(terms, at_vertex.T.ravel())
    focal, middle = np.array([np.polyfit(slope[:, i], seen[:, i], 1) for i in (0, 1)]).T
    places = at_vertex + distances[:, None, None] * slope

    def residuals(values: Array) -> Array:
        tangent = (places - values[:2]) / (distances[:, None, None] - values[2])
        found = distorted(tangent.reshape(-1, 2), values[7:]) * values[3:5] + values[5:7]
        return np.asarray((found.reshape(places.shape) - seen).ravel())

    start = np.concatenate([[x, y, z], focal, middle, np.zeros(4)])
    fit = least_squares(residuals, start, x_scale="jac", method="lm")
    return fit.x, np.linalg.norm(fit.fun.reshape(-1, 2), axis=1)
