"""Time in a scene: the exposure, and rigid motions of objects and camera during it."""

from collections.abc import Iterator
from typing import Annotated, Any, Literal, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lfmesh.scene.light.turns import axes_along, rotation
from lfmesh.scene.model import Fault, Model
from lfmesh.scene.quantities import FractionOfOne, NonNegative, Number, Positive, Vector

Array = NDArray[np.float64]

MOST_TIMES = 10_000
"""Largest number of poses of a motion, and of points of a shutter's curve."""

Opening = tuple[NonNegative, FractionOfOne]


class Exposure(Model):
    """The time during which pixels collect light. The scene as given is that at t = 0."""

    duration_s: Positive
    """Time for which each row of pixels collects light, in s. The window of the first row starts at t = 0."""
    shutter: Annotated[tuple[Opening, ...], Field(max_length=MOST_TIMES)] | None = None
    """Opening of the shutter, 0..1, at times from the start of a row's window: [[time_s, open], ...], linear between.
    The times increase from 0 to `duration_s`. Omitted: open throughout."""
    row_time_s: NonNegative = 0.0
    """Rolling shutter: delay of each row's window after that of the row before, in s. 0: all rows together."""
    row_direction: Literal["down", "up"] = "down"
    """Order of the rows: "down" begins with row 0 of the upright picture, at its top; "up" with its last row."""

    def faults(self) -> Iterator[Fault]:
        """Yield times of the shutter that do not run through the window, and a shutter that stays closed."""
        if self.shutter is None:
            return
        times, opening = np.array(self.shutter).reshape(-1, 2).T
        if len(times) < 2 or times[0] != 0.0 or times[-1] != self.duration_s:
            why = f"its times must run from 0 to duration_s = {self.duration_s:g}, so as to cover the window"
            yield Fault(("shutter",), [list(each) for each in self.shutter], why)
        elif not (np.diff(times) > 0.0).all():
            yield Fault(("shutter",), [list(each) for each in self.shutter], "its times must increase")
        elif not opening.any():
            yield Fault(("shutter",), None, "never opens: give an opening above 0")

    @property
    def open_s(self) -> float:
        """Time for which a fully open shutter lets the same light in, s: the integral of the opening."""
        return float(self.shutter_table()[2, -1])

    def end_s(self, rows: int) -> float:
        """Return the end of the last window, s.

        Parameters
        ----------
        rows : int
            Rows of the sensor.

        Returns
        -------
        float
        """
        return self.row_time_s * (rows - 1) + self.duration_s

    def windows(self, rows: int, *, inverts: bool = True) -> tuple[Array, float, float]:
        """Return the windows of all rows of pixels.

        Parameters
        ----------
        rows : int
            Rows of the sensor.
        inverts : bool
            True if the lens inverts, so that row 0 of the sensor is on top of the upright picture. See
            `geometry.lens.orientation`.

        Returns
        -------
        begin_s : (rows,) float64
            Begin of the window of each row of the sensor.
        duration_s : float
        end_s : float
            End of the last window.
        """
        number = np.arange(rows, dtype=np.float64)
        downwards = (self.row_direction == "down") == inverts
        begin = self.row_time_s * (number if downwards else number[::-1])
        return np.ascontiguousarray(begin), self.duration_s, self.end_s(rows)

    def shutter_table(self) -> Array:
        """Return the curve of the shutter.

        Returns
        -------
        (3, k) float64
            Times in the window in s, the opening, and its integral up to there in s.
        """
        times, opening = np.array(self.shutter or ((0.0, 1.0), (self.duration_s, 1.0))).T
        parts = 0.5 * (opening[1:] + opening[:-1]) * np.diff(times)
        return np.stack([times, opening, np.concatenate([[0.0], np.cumsum(parts)])])


class TimedPose(Model):
    """The pose of an object at a time, in the keys of its pose in the scene; omitted keys are as given there."""

    time_s: NonNegative
    """Time, in s, from the start of the first row's window."""
    position_mm: Vector | None = None
    """Position of a target, tank, medium or lamp, in mm."""
    rotation_deg: Vector | None = None
    """Rotations of a target, tank, medium or point lamp about x, then y, then z, in degrees."""
    shift_mm: Vector | None = None
    """Shift of the camera along x, y, z, as in `camera.pose`, in mm."""
    tilt_deg: Vector | None = None
    """Rotations of the camera about x, then y, then z, as in `camera.pose`, in degrees."""
    direction: Vector | None = None
    """Direction of a lamp's light; of any length from 1e-100 to 1e100."""
    turn_deg: Number | None = None
    """Turn of a lamp about its direction, in degrees."""
    start_mm: Vector | None = None
    """One end of a line lamp, in mm."""
    end_mm: Vector | None = None
    """The other end of a line lamp, in mm."""

    @property
    def given(self) -> dict[str, Any]:
        """Keys of the pose that are given, without the time."""
        return {key: value for key in POSE_KEYS if (value := getattr(self, key)) is not None}


POSE_KEYS = tuple(key for key in TimedPose.model_fields if key != "time_s")
"""Keys of the poses of all objects."""

PLACE_KEYS = ("position_mm", "shift_mm")
"""Keys that hold the position of an object, by the kind of object."""


class Motion(Model):
    """Rigid motion during the exposure: a steady velocity and spin, or poses. It needs `[exposure]`."""

    velocity_mm_s: Vector | None = None
    """Velocity in the world, in mm/s. Omitted: 0."""
    spin_deg_s: Vector | None = None
    """Rotation vector in world axes, in degrees/s: its direction is the axis, its length the rate. Omitted: 0."""
    center_mm: Vector | None = None
    """Point at t = 0 that the spin turns about, or that the positions of `poses` place, in mm. It moves along. Omitted:
    the object's own position."""
    poses: Annotated[tuple[TimedPose, ...], Field(max_length=MOST_TIMES)] = ()
    """Poses at times, from 0 to the end of the last row's window, joined by screw motions of less than half a turn. Or
    give `velocity_mm_s` and `spin_deg_s`."""

    def faults(self) -> Iterator[Fault]:
        """Yield missing keys, keys given twice, and times out of order."""
        steady = [key for key in ("velocity_mm_s", "spin_deg_s") if getattr(self, key) is not None]
        if not self.poses:
            if not steady:
                yield Fault((), None, "missing: give velocity_mm_s, spin_deg_s or poses")
            elif self.center_mm is not None and self.spin_deg_s is None:
                why = "needs spin_deg_s, which turns about it, or poses"
                yield Fault(("center_mm",), list(self.center_mm), why)
            return
        for key in steady:
            yield Fault((key,), list(getattr(self, key)), "poses are given too; give one of them")
        times = [pose.time_s for pose in self.poses]
        if times[0] != 0.0:
            yield Fault(("poses", 0, "time_s"), times[0], "must be 0: the scene as given is that at t = 0")
        for k in np.flatnonzero(np.diff(times) <= 0.0).tolist():
            why = f"must be above {times[k]:g}, that of the pose before"
            yield Fault(("poses", k + 1, "time_s"), times[k + 1], why)

    @property
    def in_words(self) -> str:
        """Velocity and spin, or the number of poses and their last time."""
        if self.poses:
            return f"{len(self.poses)} poses in {self.poses[-1].time_s:g} s"
        parts = [(self.velocity_mm_s, "mm/s"), (self.spin_deg_s, "°/s")]
        return ", ".join(
            f"{' '.join(f'{v:zg}' for v in vector)} {unit}" for vector, unit in parts if vector is not None
        )

    def about(self, place: Vector) -> "Motion":
        """Return the motion for the parts of an object that has its own position, (x, y, z) mm.

        Parameters
        ----------
        place : tuple of float

        Returns
        -------
        Motion
        """
        turns = self.spin_deg_s is not None or self.poses
        return self.model_copy(update={"center_mm": place}) if turns and self.center_mm is None else self


def own_pose(thing: Any) -> dict[str, Any]:
    """Return the keys and values of an object's pose at t = 0; the position is that of the centre of its motion.

    Parameters
    ----------
    thing : Target, Tank, Medium, Light or Camera
    """
    holder = getattr(thing, "pose", thing)
    own = {key: getattr(holder, key) for key in POSE_KEYS if key in type(holder).model_fields}
    centre = thing.motion.center_mm if thing.motion is not None else None
    return own | {key: centre for key in PLACE_KEYS if key in own and centre is not None}


def poses_in_full(thing: Any) -> list[dict[str, Any]]:
    """Return the keys and values of each of an object's poses.

    Parameters
    ----------
    thing : Target, Tank, Medium, Light or Camera
    """
    own = own_pose(thing)
    return [own | pose.given for pose in thing.motion.poses]


def is_moving(thing: Any) -> bool:
    """Tell whether an object has a motion that is not at rest.

    Parameters
    ----------
    thing : Target, Tank, Medium, Light or Camera
    """
    motion: Motion | None = thing.motion
    if motion is None:
        return False
    if motion.poses:
        full = poses_in_full(thing)
        return any(pose != full[0] for pose in full)
    return any(motion.velocity_mm_s or ()) or any(motion.spin_deg_s or ())


def at_begin(words: str, *things: Any) -> str:
    """Return a remark on the places of objects, with its time if one of them moves.

    Parameters
    ----------
    words : str
    *things : Target, Tank, Medium, Light or Camera
    """
    return f"{words}, at t = 0" if any(map(is_moving, things)) else words


def centre_of_spin(thing: Any) -> Vector:
    """Return the point that an object's spin turns about at t = 0, world frame, mm.

    Parameters
    ----------
    thing : Target, Tank, Medium, Light or Camera
    """
    if thing.motion.center_mm is not None:
        return cast(Vector, thing.motion.center_mm)
    x, y, z = _place(own_pose(thing))
    return float(x), float(y), float(z)


def pose_frames(thing: Any) -> Array:
    """Return an object's poses as frames, (n, 3, 4) float64, mm: axes and position in the world.

    A lamp whose turn about its direction does not show turns from each direction to the next by the shortest way.

    Parameters
    ----------
    thing : Target, Tank, Medium, Light or Camera
    """
    frames: list[Array] = []
    for pose in poses_in_full(thing):
        heading = _heading(pose)
        if heading is None:
            axes = rotation(pose.get("rotation_deg", pose.get("tilt_deg", (0.0, 0.0, 0.0))))
        elif _shows_turn(thing):
            axes = axes_along(heading, pose["turn_deg"]).T
        else:
            axes = axes_along(heading, 0.0).T if not frames else _turned_to(frames[-1][:, :3], heading)
        frames.append(np.column_stack([axes, _place(pose)]))
    return np.array(frames)


def _place(pose: dict[str, Any]) -> Array:
    """Return the position in a pose, (3,) mm; that of parallel light is the origin."""
    if "start_mm" in pose:
        return 0.5 * (np.array(pose["start_mm"]) + np.array(pose["end_mm"]))
    return np.array(next((pose[key] for key in PLACE_KEYS if key in pose), (0.0, 0.0, 0.0)))


def _heading(pose: dict[str, Any]) -> Array | None:
    """Return the direction in a pose, a unit vector (3,); None if its orientation is a rotation."""
    if "start_mm" in pose:
        vector = np.array(pose["end_mm"]) - np.array(pose["start_mm"])
    elif "direction" in pose:
        vector = np.array(pose["direction"])
    else:
        return None
    vector = vector / np.abs(vector).max()
    return np.asarray(vector / np.linalg.norm(vector))


def _shows_turn(lamp: Any) -> bool:
    """Tell whether a lamp with a direction changes if it is turned about that."""
    region = lamp.region
    flat = region is not None and not region.is_round and region.lengths_mm.min() > 0.0
    return bool(lamp.emission == "profile" or flat)


def _turned_to(axes: Array, heading: Array) -> Array:
    """Return axes, (3, 3) in columns, turned by the shortest way so that the third has a given direction."""
    before = axes[:, 2]
    cosine, across = float(before @ heading), np.cross(before, heading)
    if cosine <= -1.0 + HALF_TURN:
        # Refused elsewhere; any axis will do.
        return np.asarray(axes @ np.diag([1.0, -1.0, -1.0]))
    x, y, z = across
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turn = np.eye(3) + cross + cross @ cross / (1.0 + cosine)
    return np.column_stack([turn @ axes[:, :2], heading])


HALF_TURN = 1e-12
"""1 + cos of the angle between two poses, up to which their axis is unknown: half a turn but for 1e-6 rad."""
