"""Motions of a scene's objects and camera in the world, relative to their places at t = 0."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import SceneError
from lfmesh.geometry import frame
from lfmesh.geometry.objects.tanks import tank_bodies
from lfmesh.geometry.rigid_motion import steady, through_poses
from lfmesh.scene import Medium, Scene
from lfmesh.scene.model import format_path
from lfmesh.scene.motion import centre_of_spin, is_moving, pose_frames

Segments = NDArray[np.void]


class SceneMotions(NamedTuple):
    """Motion of everything in a scene, each (n,) SEGMENT in the world, or None at rest."""

    camera: Segments | None
    bodies: tuple[Segments | None, ...]
    """Of the targets, then of wall and liquid of each tank, as they are numbered in `Scene.bodies`."""
    lights: tuple[Segments | None, ...]
    media: tuple[Segments | None, ...]


def motion_of(thing: Any) -> Segments | None:
    """Return the motion of an object or the camera, (n,) SEGMENT: pose(t) · pose(0)⁻¹ in the world; None at rest.

    Equal motions of several objects have the same bits.

    Parameters
    ----------
    thing : Target, Tank, Medium, Light or Camera
    """
    if not is_moving(thing):
        return None
    motion = thing.motion
    if motion.poses:
        return through_poses([pose.time_s for pose in motion.poses], _relative(pose_frames(thing)))
    spin = motion.spin_deg_s or (0.0, 0.0, 0.0)
    centre = centre_of_spin(thing) if any(spin) else (0.0, 0.0, 0.0)
    return steady(motion.velocity_mm_s or (0.0, 0.0, 0.0), spin, centre)


def medium_motion(scene: Scene, medium: Medium) -> Segments | None:
    """Return the motion of a medium, as `motion_of`; inside a body without one of its own, that of the body.

    Parameters
    ----------
    scene : Scene
    medium : Medium
    """
    if medium.motion is not None or medium.inside is None:
        return motion_of(medium)
    number = scene.body_named(medium.inside)
    targets = len(scene.targets)
    return motion_of(scene.targets[number] if number < targets else scene.tanks[(number - targets) // 2])


def motions_of(scene: Scene) -> SceneMotions:
    """Return the motions of everything in a scene but its particles.

    Parameters
    ----------
    scene : Scene
    """
    tanks = [motion_of(body) for tank in scene.tanks for body in tank_bodies(tank, "")]
    return SceneMotions(
        motion_of(scene.camera),
        (*map(motion_of, scene.targets), *tanks),
        tuple(map(motion_of, scene.lights)),
        tuple(medium_motion(scene, medium) for medium in scene.media),
    )


def refuse_motion(scene: Scene, why: str) -> None:
    """Refuse scenes in which something moves.

    Parameters
    ----------
    scene : Scene
    why : str
        Reason, with what is valid.

    Raises
    ------
    SceneError
    """
    for i, group in enumerate(scene.particles):
        if group.frame_time_s is not None:
            raise SceneError(f"particles[{i}].frame_time_s: the particles move; {why}")
    for where, thing in scene.things_with_motion():
        if is_moving(thing):
            raise SceneError(f"{format_path(where)}: {why}")


def _relative(frames: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return poses relative to the first one, (n, 3, 4); exact where nothing turns."""
    first = frames[0]
    back = frame.inverse(first)
    relative = np.array([frame.compose(each, back) for each in frames])
    for row, each in zip(relative, frames, strict=True):
        if (each[:, :3] == first[:, :3]).all():
            row[:, :3], row[:, 3] = np.eye(3), each[:, 3] - first[:, 3]
    return relative
