"""Viewpoints that fit a part of the scene into the picture, whatever its size.

All are computed in the camera frame, with +y up. Seen from behind the camera, x is to the right; in side views, light
travels to the right.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.errors import LfmeshError
from lfmesh.geometry import frame as frames
from lfmesh.transport.collisions import far_end_mm
from lfmesh.transport.packets.packet import CAMERA_FRAME, MLA_FRAME, SENSOR_FRAME, WORLD_FRAME
from lfmesh.transport.world import World
from lfmesh.view.media import media_bodies

Array = NDArray[np.float64]

UP = (0.0, 1.0, 0.0)

ANGLE_DEG = 36.0
"""Vertical field of view in perspective."""

MARGIN = 1.12
"""Size of the picture relative to its content."""

FIELDS = 1.6
"""Targets are framed up to this many fields of view, so that a wall does not reduce the camera to a dot."""

BISECTIONS = 40

LENSLETS = 7
"""Lenslets across the view of the array."""

CHIP = 1.18
"""Size of the sensor's board relative to its pixels."""

WITHOUT_OBJECT = 2.0
"""Camera lengths shown before the camera if there is no object."""


@dataclass(frozen=True)
class Viewpoint:
    """Eye position, centre of rotation, and visible height; world frame, mm."""

    eye: Array
    focus: Array
    up: Array
    parallel: bool
    half_height_mm: float
    """Half the height of the picture at the focus."""


def viewpoint(
    world: World, preset: str, aspect: float, near_mm: tuple[float, float] = (0.0, 0.0), angle_deg: float = ANGLE_DEG
) -> Viewpoint:
    """Return the viewpoint of a preset.

    Parameters
    ----------
    world : World
    preset : str
        One of `PRESETS`.
    aspect : float
        Width over height of the picture.
    near_mm : (x, y), mm
        Point of the array for "array", in the array's frame.
    angle_deg : float
        Vertical field of view in perspective.

    Raises
    ------
    LfmeshError
        No preset has this name, or there is no array to show.
    """
    if preset not in PRESETS:
        raise LfmeshError(f"preset = {preset!r}: use one of {', '.join(PRESETS)}")
    if preset == "array" and not world.tables.mla.present:
        raise LfmeshError('preset = "array": this camera has no microlens array; use "sensor"')
    points, forward, parallel = PRESETS[preset](world, near_mm)
    seen = fitted(points, forward, aspect, parallel, angle_deg)
    if preset != "array" and is_cut(seen, _sensor(world), aspect):
        seen = fitted(np.concatenate([points, _sensor(world)]), forward, aspect, parallel, angle_deg)
    to_world = world.tables.frames[CAMERA_FRAME, WORLD_FRAME]
    eye, focus = frames.points(to_world, np.stack([seen.eye, seen.focus]))
    return Viewpoint(eye, focus, frames.directions(to_world, seen.up[None])[0], parallel, seen.half_height_mm)


def fitted(points: Array, forward: ArrayLike, aspect: float, parallel: bool, angle_deg: float = ANGLE_DEG) -> Viewpoint:
    """Return the nearest viewpoint that has all points in the picture.

    Parameters
    ----------
    points : (n, 3) float64, mm
    forward : (3,)
        Direction of sight.
    aspect : float
        Width over height of the picture.
    parallel : bool
        Parallel projection.
    angle_deg : float
        Vertical field of view in perspective.
    """
    ahead = np.asarray(forward, dtype=np.float64) / np.linalg.norm(forward)
    right = np.cross(ahead, UP)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(right, ahead), ahead])
    x, y, z = axes @ points.T
    tangent = np.tan(np.deg2rad(0.5 * angle_deg)) / MARGIN
    if parallel:
        half = max(0.5 * np.ptp(y), 0.5 * np.ptp(x) / aspect, np.finfo(np.float64).tiny)
        middle = np.array([0.5 * (x.min() + x.max()), 0.5 * (y.min() + y.max()), 0.5 * (z.min() + z.max())])
        away = half / tangent + np.ptp(z)
        return Viewpoint((middle - [0, 0, away]) @ axes, middle @ axes, axes[1], True, MARGIN * half)
    # A point is inside if |x − eye_x| ≤ t (z − eye_z); each side gives the eye's largest depth.
    depth = [
        -((along - slope * z).max() + (-along - slope * z).max()) / (2.0 * slope)
        for along, slope in ((x, aspect * tangent), (y, tangent))
    ]
    eye = np.array([_centred(x, z - min(depth)), _centred(y, z - min(depth)), min(depth)])
    focus = eye.copy()
    focus[2] = 0.5 * (z.min() + z.max())
    away = focus[2] - eye[2]
    return Viewpoint(eye @ axes, focus @ axes, axes[1], False, away * np.tan(np.deg2rad(0.5 * angle_deg)))


def is_cut(seen: Viewpoint, points: Array, aspect: float) -> bool:
    """Tell whether the border of a picture crosses the rectangle round some points in it.

    Parameters
    ----------
    seen : Viewpoint
    points : (n, 3) float64, mm
        In the frame of the viewpoint.
    aspect : float
        Width over height of the picture.
    """
    away = float(np.linalg.norm(seen.focus - seen.eye))
    ahead = (seen.focus - seen.eye) / away
    x, y, z = np.stack([np.cross(ahead, seen.up), seen.up, ahead]) @ (points - seen.eye).T
    if not seen.parallel and (z <= 0.0).any():
        # Behind the eye it is not seen; beside the eye it would reach beyond any picture.
        return not (z <= 0.0).all()
    half = seen.half_height_mm * (1.0 if seen.parallel else z / away)
    across, up = x / (aspect * half), y / half
    beside = across.min() > 1.0 or across.max() < -1.0 or up.min() > 1.0 or up.max() < -1.0
    return not beside and bool(max(np.abs(across).max(), np.abs(up).max()) > 1.0)


def _centred(along: Array, depth: Array) -> float:
    """Return the eye position that centres points of given depths in the picture."""
    low, high = along.min(), along.max()
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        seen = (along - middle) / depth
        low, high = (middle, high) if seen.max() + seen.min() > 0.0 else (low, middle)
    return float(middle)


def _box(low: ArrayLike, high: ArrayLike) -> Array:
    """Return the (8, 3) corners of a box."""
    return np.stack(np.meshgrid(*np.stack([low, high], axis=1)), axis=-1).reshape(-1, 3)


def box_corners(points: Array) -> Array:
    """Return the (8, 3) corners of the box round points (n, 3)."""
    return _box(points.min(axis=0), points.max(axis=0))


def _lens(world: World) -> Array:
    shape = world.lens_shape
    rim = max(shape.rims)
    vertices = np.concatenate([cap.vertices for cap in shape.caps])
    return _box([-rim, -rim, vertices[:, 2].min()], [rim, rim, vertices[:, 2].max()])


def chip_size_mm(world: World) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return half the width and height of the board behind the pixels, and the depths of its faces."""
    width, height = world.scene.camera.sensor.size_mm
    rim = 0.5 * (CHIP - 1.0) * max(width, height)
    return (0.5 * width + rim, 0.5 * height + rim), (0.06 * rim, 0.36 * rim)


def _sensor(world: World) -> Array:
    (x, y), (_, back) = chip_size_mm(world)
    return frames.points(world.tables.frames[SENSOR_FRAME, CAMERA_FRAME], _box([-x, -y, 0.0], [x, y, back]))


def _array(world: World) -> Array:
    """Return the corners of the array's plate, none without an array."""
    if not world.tables.mla.present:
        return np.zeros((0, 3))
    lenslets = world.tables.mla.lenslets
    x, y = lenslets.lattice.half_extent
    box = _box([-x, -y, lenslets.top], [x, y, far_end_mm(world.tables.mla)])
    return frames.points(world.tables.frames[MLA_FRAME, CAMERA_FRAME], box)


def _camera(world: World) -> Array:
    return np.concatenate([_lens(world), _array(world), _sensor(world)])


def _object(world: World) -> Array:
    """Return points of the object: targets and media, as far as the camera sees them, or its field in focus."""
    distance = world.facts.object_distance_mm
    to_camera = world.tables.frames[WORLD_FRAME, CAMERA_FRAME]
    seen = [_in_field(world, frames.points(to_camera, target.mesh.vertices)) for target in world.targets]
    farthest = min((float(points[:, 2].min()) for points in seen), default=-np.inf)
    for body in media_bodies(world):
        points = frames.points(to_camera, body.vertices)
        # Fog may reach far behind the targets, and would make them small.
        low = farthest if points[:, 2].max() > farthest else -np.inf
        points[:, 2] = np.maximum(points[:, 2], low)
        seen.append(_in_field(world, points))
    if seen:
        return np.concatenate(seen)
    if 0.0 < distance < np.inf:
        x, y = (0.5 * size for size in world.facts.field_of_view_mm)
        return _box([-x, -y, -distance], [x, y, -distance])
    length = np.ptp(_camera(world)[:, 2])
    rim = max(world.lens_shape.rims)
    return _box([-rim, -rim, -WITHOUT_OBJECT * length], [rim, rim, -WITHOUT_OBJECT * length])


def _in_field(world: World, points: Array) -> Array:
    """Return the corners of a box round points (n, 3), camera frame, moved to the border of the field if outside."""
    points = points.copy()
    z = np.clip(points[:, 2], -np.inf, 0.0)
    distance = world.facts.object_distance_mm
    widest = np.array(world.facts.field_of_view_mm)
    if 0.0 < distance < np.inf:
        half = 0.5 * FIELDS * widest * (-z[:, None] / distance) + max(world.lens_shape.rims)
    else:
        focal = world.facts.object_index * world.facts.efl_mm
        slope = 0.5 * np.array(world.scene.camera.sensor.size_mm) / abs(focal)
        half = FIELDS * slope * -z[:, None] + max(world.lens_shape.rims)
    points[:, :2] = np.clip(points[:, :2], -half, half)
    return box_corners(points)


def _near_lenslets(world: World, near_mm: tuple[float, float]) -> Array:
    """Return the corners of a few lenslets around a point of the array, and of the sensor behind them."""
    lenslets = world.tables.mla.lenslets
    half = 0.5 * LENSLETS * lenslets.lattice.pitch
    x, y = near_mm
    box = _box([x - half, y - half, lenslets.top], [x + half, y + half, far_end_mm(world.tables.mla)])
    corners = frames.points(world.tables.frames[MLA_FRAME, CAMERA_FRAME], box)
    to_sensor = frames.points(world.tables.frames[CAMERA_FRAME, SENSOR_FRAME], corners)
    to_sensor[:, 2] = 0.0
    return np.concatenate([corners, frames.points(world.tables.frames[SENSOR_FRAME, CAMERA_FRAME], to_sensor)])


Look = tuple[Array, tuple[float, float, float], bool]
"""Points to show, viewing direction, and whether the projection is parallel."""


def _whole(world: World, _: tuple[float, float]) -> Look:
    """Show camera and object from beside the sensor; the angle to the axis decreases with the object distance."""
    camera, objects = _camera(world), _object(world)
    far = max(1.0, -float(objects[:, 2].mean()) / float(np.ptp(camera[:, 2])))
    turn = np.deg2rad(np.clip(66.0 / np.sqrt(far), 8.0, 60.0))
    return np.concatenate([camera, objects]), (np.sin(turn), -0.2, -np.cos(turn)), False


PRESETS: dict[str, Callable[[World, tuple[float, float]], Look]] = {
    "whole": _whole,
    "side": lambda world, _: (np.concatenate([_camera(world), _object(world)]), (1.0, 0.0, 0.0), True),
    "object": lambda world, _: (_object(world), (0.35, -0.2, -1.0), False),
    "lens": lambda world, _: (_lens(world), (1.0, -0.25, -0.45), True),
    "array": lambda world, near: (_near_lenslets(world, near), (0.6, -0.3, 0.75), False),
    "sensor": lambda world, _: (_sensor(world), (0.25, -0.2, 1.0), False),
}
"""Views by name: the points to show, the direction, and True for a parallel projection."""
