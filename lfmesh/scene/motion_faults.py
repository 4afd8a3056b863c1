"""Faults of motions beside the exposure, the sensor, and the objects that move."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np

from lfmesh.scene.model import Fault, Location
from lfmesh.scene.motion import HALF_TURN, PLACE_KEYS, own_pose, pose_frames, poses_in_full
from lfmesh.scene.quantities import no_direction
from lfmesh.scene.scene_parts import SceneParts

ROUNDING = 1e-9
"""Relative difference of times that counts as rounding."""

STRETCHED = 1e-6
"""Relative change of a line lamp's length that counts as rounding of its ends."""


def motion_faults(scene: SceneParts) -> Iterator[Fault]:
    """Yield the faults of motions that concern other parts of a scene.

    Parameters
    ----------
    scene : SceneParts
    """
    for i, group in enumerate(scene.particles):
        if group.frame_time_s is not None and scene.exposure is None:
            yield Fault(("particles", i, "frame_time_s"), group.frame_time_s, "needs [exposure] with duration_s")
    for where, thing in scene.things_with_motion():
        if scene.exposure is None:
            yield Fault(where, None, "needs [exposure] with duration_s, the time for which pixels collect light")
        yield from _unplaced(where, thing)
        yield from _pose_faults(scene, where, thing)


def _unplaced(where: Location, thing: Any) -> Iterator[Fault]:
    """Yield motions of objects that fill all space, and velocities of those without a position."""
    motion, own = thing.motion, own_pose(thing)
    if where[0] == "media" and thing.bounds is None and thing.grid is None and thing.inside is None:
        yield Fault(where, None, "the medium fills all space, where motion has no effect; give bounds, or omit it")
    if not any(key in own for key in (*PLACE_KEYS, "start_mm")):
        for key in ("velocity_mm_s", "center_mm"):
            if getattr(motion, key) is not None:
                why = "parallel light has no position; give spin_deg_s, or poses with direction"
                yield Fault((*where, key), list(getattr(motion, key)), why)
    elif "start_mm" in own and motion.poses and motion.center_mm is not None:
        why = "has no effect beside poses with start_mm and end_mm; omit it"
        yield Fault((*where, "center_mm"), list(motion.center_mm), why)


def _pose_faults(scene: SceneParts, where: Location, thing: Any) -> Iterator[Fault]:
    """Yield poses in other keys than the object's, or that differ from it at t = 0, are ambiguous or end early."""
    poses, own = thing.motion.poses, own_pose(thing)
    if not poses:
        return
    found = False
    for k, pose in enumerate(poses):
        for key, value in pose.given.items():
            why = _key_fault(thing, key, value, own)
            if why or (k == 0 and value != own[key]):
                at_begin = f"{_holder(thing, key)} = {_text(own.get(key))}"
                why = why or f"must be {at_begin}, the pose at t = 0; change one of them, or omit this"
                found = True
                yield Fault((*where, "poses", k, key), _text(value), why)
    if not found:
        yield from _stretched(where, thing)
        yield from _half_turns(where, thing)
    if scene.exposure is not None:
        end = scene.exposure.end_s(scene.camera.sensor.pixels[1])
        if poses[-1].time_s < end * (1.0 - ROUNDING):
            why = f"must be {end:.10g} or more, the end of the last row's window; add a pose"
            yield Fault((*where, "poses", len(poses) - 1, "time_s"), poses[-1].time_s, why)


def _holder(thing: Any, key: str) -> str:
    """Return the key that holds a value of the pose at t = 0."""
    if key in PLACE_KEYS and thing.motion.center_mm is not None:
        return "center_mm"
    return f"pose.{key}" if hasattr(thing, "pose") else key


def _key_fault(thing: Any, key: str, value: Any, own: dict[str, Any]) -> str:
    """Return why an object cannot have a key in a pose, or ""."""
    if key not in own:
        return f"is no key of this object's pose; valid are {', '.join(own)}"
    if key == "direction" and (why := no_direction(value)):
        return why
    profile = getattr(thing, "profile", "")
    if profile is None and (
        (key == "rotation_deg" and any(value)) or (key == "turn_deg" and value and own[key] == 0.0)
    ):
        return "" if _has_sides(thing) else "turns a profile, but none is given; omit it"
    return ""


def _has_sides(lamp: Any) -> bool:
    region = lamp.region
    return bool(region is not None and not region.is_round and region.area_mm2 > 0.0)


def _stretched(where: Location, thing: Any) -> Iterator[Fault]:
    """Yield poses in which a line lamp has another length."""
    full = poses_in_full(thing)
    if "start_mm" not in full[0]:
        return
    lengths = [float(np.linalg.norm(np.subtract(pose["end_mm"], pose["start_mm"]))) for pose in full]
    for k, length in enumerate(lengths):
        if not abs(length - lengths[0]) <= STRETCHED * lengths[0]:
            why = f"makes the lamp {length:.9g} mm long; it must keep its length, {lengths[0]:.9g} mm"
            yield Fault((*where, "poses", k, "end_mm"), list(full[k]["end_mm"]), why)


def _half_turns(where: Location, thing: Any) -> Iterator[Fault]:
    """Yield poses half a turn from the one before, whose axis is unknown."""
    full = poses_in_full(thing)
    if "start_mm" in full[0] and any(pose["start_mm"] == pose["end_mm"] for pose in full):
        return
    axes = pose_frames(thing)[:, :, :3]
    for k, (one, other) in enumerate(pairwise(axes)):
        if np.trace(other @ one.T) <= -1.0 + 2.0 * HALF_TURN:
            why = "is half a turn from the pose before, so the sense of the turn is unknown; add a pose between them"
            yield Fault((*where, "poses", k + 1), None, why)


def _text(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value
