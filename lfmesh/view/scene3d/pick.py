"""Picking: the path, glass, pixel or other part at a point of the picture, and the pixels in a box.

It needs only geometry, so it works without a window and in a server. Picture positions are in pixels from the top left
corner.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry import frame as frames
from lfmesh.transport.packets.packet import SENSOR_FRAME, WORLD_FRAME
from lfmesh.view.scene3d.plotter import View
from lfmesh.view.scene3d.projection import projection_matrix

Array = NDArray[np.float64]

TOLERANCE_PX = 6.0
"""Largest distance of a click from a ray."""

EQUALLY_NEAR_PX = 1.0
"""Among rays at distances that differ by less, the front one is picked."""


@dataclass(frozen=True)
class PickedRay:
    """Segment of a path.

    Attributes
    ----------
    path : int
        Index among the shown rays.
    vertex : int
        Start of the segment, an index into their `position`.
    paths : (k,) int64
        All drawn paths that share it.
    """

    path: int
    vertex: int
    paths: NDArray[np.int64]


@dataclass(frozen=True)
class PickedPixel:
    """A pixel of the sensor."""

    row: int
    column: int


@dataclass(frozen=True)
class PickedPart:
    """Glass or another part, by its name in `describe`."""

    name: str
    kind: str


Picked = PickedRay | PickedPixel | PickedPart | None


def pick(view: View, x: float, y: float) -> Picked:
    """Return the target of a click: the ray under it, else the nearest part.

    The sensor is visible through the array, so where both are hit, the pixel is picked. Everything is visible through
    media, so one is picked only if nothing else is hit.

    Parameters
    ----------
    view : View
    x, y : float, pixels
        Position in the picture.
    """
    if ray := pick_ray(view, x, y):
        return ray
    origin, direction = eye_ray(view, x, y)
    hits = []
    for part, mesh in view.meshes():
        if part.kind != "sign" and mesh.n_cells and not mesh.n_lines:
            corners = np.asarray(mesh.points, dtype=np.float64)[mesh.triangulate().regular_faces]
            distance = first_hit(origin, direction, corners)
            if np.isfinite(distance):
                hits.append((distance, part))
    if not hits:
        return None
    nearest = min(hits, key=lambda hit: (hit[1].kind == "medium", hit[0]))[1]
    if nearest.kind in ("array", "sensor") and (pixel := pixel_at(view, x, y)):
        return pixel
    return PickedPart(nearest.name, nearest.kind)


def pick_ray(view: View, x: float, y: float, tolerance_px: float = TOLERANCE_PX) -> PickedRay | None:
    """Return the ray segment at a point of the picture, if near enough.

    Parameters
    ----------
    view : View
    x, y : float, pixels
        Position in the picture.
    tolerance_px : float, pixels
        Largest distance from the segment.
    """
    lines = view.lines
    if lines is None or not len(lines):
        return None
    pieces, segment = lines.pieces
    place, depth = _projected(view, pieces)
    a, b = place[:, 0], place[:, 1]
    along = b - a
    square = np.maximum((along**2).sum(axis=1), np.finfo(np.float64).tiny)
    share = np.clip((([x, y] - a) * along).sum(axis=1) / square, 0.0, 1.0)
    distance = np.linalg.norm(a + share[:, None] * along - [x, y], axis=1)
    distance = np.where(np.isnan(distance), np.inf, distance)
    least = distance.min()
    if least > tolerance_px:
        return None
    near = np.flatnonzero(distance <= least + EQUALLY_NEAR_PX)
    in_front = depth[near, 0] + share[near] * (depth[near, 1] - depth[near, 0])
    found = int(segment[near[np.argmin(in_front)]])
    return PickedRay(int(lines.path[found]), int(lines.vertex[found]), lines.paths_of(found))


def pixel_at(view: View, x: float, y: float) -> PickedPixel | None:
    """Return the sensor pixel at a point of the picture, ignoring anything in front of it.

    Parameters
    ----------
    view : View
    x, y : float, pixels
        Position in the picture.
    """
    sensor = view.world.tables.sensor
    row, column = np.floor(_on_sensor(view, x, y))
    if not (0 <= row < sensor.rows and 0 <= column < sensor.columns):
        return None
    return PickedPixel(int(row), int(column))


def box(view: View, x0: float, y0: float, x1: float, y1: float) -> tuple[range, range] | None:
    """Return the rows and columns of the pixels in a box of the picture; None if it shows no part of the sensor.

    Parameters
    ----------
    view : View
    x0, y0, x1, y1 : float, pixels
        Opposite corners.
    """
    corners = np.array([_on_sensor(view, x, y) for x in (x0, x1) for y in (y0, y1)])
    if not np.isfinite(corners).all():
        return None
    size = view.world.tables.sensor
    low = np.clip(np.floor(corners.min(axis=0)), 0, None).astype(int)
    high = np.minimum(np.ceil(corners.max(axis=0)), [size.rows, size.columns]).astype(int)
    if (low >= high).any():
        return None
    return range(low[0], high[0]), range(low[1], high[1])


def to_picture(view: View, points: Array) -> Array:
    """Return the picture positions (n, 2) of world points (n, 3); NaN behind the eye."""
    return _projected(view, np.asarray(points, dtype=np.float64)[:, None])[0][:, 0]


def eye_ray(view: View, x: float, y: float) -> tuple[Array, Array]:
    """Return origin and unit direction of the line of sight through a point of the picture, world frame.

    Parameters
    ----------
    view : View
    x, y : float, pixels
        Position in the picture.
    """
    width, height = view.plotter.window_size
    ndc = np.array([2.0 * x / width - 1.0, 1.0 - 2.0 * y / height])
    ends = np.array([[*ndc, -1.0, 1.0], [*ndc, 1.0, 1.0]]) @ np.linalg.inv(projection_matrix(view.plotter)).T
    near, far = ends[:, :3] / ends[:, 3:]
    return near, (far - near) / np.linalg.norm(far - near)


def first_hit(origin: Array, direction: Array, corners: Array) -> float:
    """Return the distance along a ray to the first of some triangles; inf if none.

    T. Möller, B. Trumbore, "Fast, Minimum Storage Ray/Triangle Intersection", J. Graphics Tools 2(1), 1997.

    Parameters
    ----------
    origin, direction : (3,) float64
    corners : (n, 3, 3) float64
        Corners of the triangles.
    """
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(direction, second)
    determinant = (first * p).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        from_corner = origin - corners[:, 0]
        u = (from_corner * p).sum(axis=1) / determinant
        q = np.cross(from_corner, first)
        v = (q @ direction) / determinant
        t = (second * q).sum(axis=1) / determinant
        met = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 0.0)
    return float(t[met].min(initial=np.inf))


def _projected(view: View, ends: Array) -> tuple[Array, Array]:
    """Return the picture positions (n, k, 2) and depths (n, k) of points (n, k, 3).

    A segment that extends behind the eye is cut there.
    """
    clip = np.concatenate([ends, np.ones((*ends.shape[:2], 1))], axis=2) @ projection_matrix(view.plotter).T
    w = clip[..., 3]
    if ends.shape[1] == 2 and not view.plotter.camera.parallel_projection:
        nearest = 1e-9 * np.abs(w).max(initial=1.0)
        for one, other in ((0, 1), (1, 0)):
            behind = (w[:, one] < nearest) & (w[:, other] > nearest)
            share = (nearest - w[behind, one]) / (w[behind, other] - w[behind, one])
            clip[behind, one] += share[:, None] * (clip[behind, other] - clip[behind, one])
        w = clip[..., 3]
    width, height = view.plotter.window_size
    with np.errstate(divide="ignore", invalid="ignore"):
        ndc = np.where(w[..., None] > 0.0, clip[..., :3] / w[..., None], np.nan)
    return np.stack([0.5 * (ndc[..., 0] + 1.0) * width, 0.5 * (1.0 - ndc[..., 1]) * height], axis=-1), ndc[..., 2]


def _on_sensor(view: View, x: float, y: float) -> Array:
    """Return row and column, as fractional numbers, of the intersection of a line of sight with the sensor plane."""
    origin, direction = eye_ray(view, x, y)
    to_sensor = view.world.tables.frames[WORLD_FRAME, SENSOR_FRAME]
    start, along = frames.points(to_sensor, origin[None])[0], frames.directions(to_sensor, direction[None])[0]
    if along[2] == 0.0 or -start[2] / along[2] < 0.0:
        return np.full(2, np.nan)
    at = start - start[2] / along[2] * along
    sensor = view.world.tables.sensor
    return np.array([at[1] / sensor.pixel + 0.5 * sensor.rows, at[0] / sensor.pixel + 0.5 * sensor.columns])
