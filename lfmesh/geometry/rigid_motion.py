"""Rigid motions in time: poses that follow each other along screws.

A motion is a list of segments, each of constant velocity and constant turn about a centre that moves along. Two poses
are joined by a screw: a turn about a fixed axis with a slide along it, which is the same formula with the centre on the
axis (Chasles 1830).
"""

from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.geometry import frame
from lfmesh.kernels.decorators import kernel

Array = NDArray[np.float64]

SEGMENT = np.dtype(
    [
        ("begin_s", "f8"),
        ("start", "f8", (3, 4)),  # pose at the begin
        ("centre", "f8", (3,)),  # mm, of the turn, at the begin
        ("velocity", "f8", (3,)),  # mm/s, of the centre
        ("axis", "f8", (3,)),  # unit
        ("rate", "f8"),  # rad/s about the axis
    ]
)
"""Part of a motion, up to the begin of the next one; the first and the last extend to all earlier and later times."""

STEP = 0.1
"""Turn between neighbouring times of a sweep, rad: the path is off its chord by at most 1/800 of the radius."""

MOST_STEPS = 1024
"""Steps of a sweep along one segment; faster turns take longer steps."""


def steady(velocity_mm_s: ArrayLike, spin_deg_s: ArrayLike, centre_mm: ArrayLike) -> NDArray[np.void]:
    """Return a motion of constant velocity and spin, the identity at t = 0, (1,) SEGMENT.

    Parameters
    ----------
    velocity_mm_s : (3,) array_like
    spin_deg_s : (3,) array_like
        Rotation vector.
    centre_mm : (3,) array_like
        Centre of the turn at t = 0; it moves with the velocity.
    """
    row = np.zeros(1, SEGMENT)
    row["start"][0] = frame.IDENTITY
    row["centre"][0], row["velocity"][0] = centre_mm, velocity_mm_s
    _set_turn(row, np.deg2rad(np.asarray(spin_deg_s, np.float64)))
    return row


def through_poses(times_s: ArrayLike, poses: Array) -> NDArray[np.void]:
    """Return the motion through poses, along a screw from each to the next, (n − 1 or more,) SEGMENT.

    Parameters
    ----------
    times_s : (n,) array_like
        Increasing.
    poses : (n, 3, 4) float64
        Frames of the body. With one pose, the body rests.
    """
    from scipy.spatial.transform import Rotation

    times = np.asarray(times_s, np.float64)
    rows = np.zeros(max(len(times) - 1, 1), SEGMENT)
    rows["axis"] = 0.0, 0.0, 1.0
    rows["begin_s"], rows["start"] = times[: len(rows)], poses[: len(rows)]
    for k in range(len(times) - 1):
        row, time = rows[k : k + 1], times[k + 1] - times[k]
        between = frame.compose(poses[k + 1], frame.inverse(poses[k]))
        turn = Rotation.from_matrix(between[:, :3]).as_rotvec()
        _set_turn(row, turn / time)
        axis, angle, shift = row["axis"][0], float(np.linalg.norm(turn)), between[:, 3]
        slide = axis * (axis @ shift)
        across = shift - slide
        if angle > 0.0:
            # The axis passes the point that the turn moves by `across`.
            row["centre"][0] = 0.5 * (across + np.cross(axis, across) / np.tan(0.5 * angle))
            row["velocity"][0] = slide / time
        else:
            row["velocity"][0] = shift / time
    return rows


def pose_at(motion: NDArray[np.void], time_s: float) -> Array:
    """Return the pose of a body at a time, (3, 4).

    Parameters
    ----------
    motion : (n,) SEGMENT
    time_s : float
    """
    pose = np.empty((3, 4))
    fill_pose(motion, 0, len(motion), time_s, pose)
    return pose


def greatest_speed(motion: NDArray[np.void], points: Array) -> float:
    """Return a bound on the speed of points of a body at any time, mm/s.

    Parameters
    ----------
    motion : (n,) SEGMENT
    points : (m, 3) float64, mm
        In the frame of the body.
    """
    fastest = 0.0
    for row in motion:
        # The distance from the centre does not change, as the centre moves along.
        reach = np.linalg.norm(np.cross(frame.points(row["start"], points) - row["centre"], row["axis"]), axis=1)
        speed = float(np.linalg.norm(row["velocity"])) + abs(float(row["rate"])) * float(reach.max(initial=0.0))
        fastest = max(fastest, speed)
    return fastest


def resting() -> NDArray[np.void]:
    """Return the motion of a body that stays where it is, the identity at all times, (1,) SEGMENT."""
    return steady((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def seen_from(camera: NDArray[np.void] | None, motion: NDArray[np.void], time_s: float) -> Array:
    """Return the pose of a body at a time relative to the camera, (3, 4).

    Parameters
    ----------
    camera : (m,) SEGMENT or None
        Motion of the camera in the world; None: the camera rests.
    motion : (n,) SEGMENT
        Motion of the body in the world.
    time_s : float
    """
    pose = pose_at(motion, time_s)
    return pose if camera is None else frame.compose(frame.inverse(pose_at(camera, time_s)), pose)


def sweep(
    motion: NDArray[np.void],
    points: Array,
    begin_s: float,
    end_s: float,
    camera: NDArray[np.void] | None = None,
) -> tuple[Array, float]:
    """Return places of points of a body at increasing times, and a bound on how far its path leaves their chords.

    At every time from `begin_s` to `end_s`, each point lies within the margin of a straight line between two
    successive places of its own (up to rounding). So the hull of all places, enlarged by the margin, holds the body's
    hull throughout.

    Parameters
    ----------
    motion : (n,) SEGMENT
        In the world.
    points : (m, 3) float64, mm
        In the frame of the body.
    begin_s, end_s : float
    camera : (c,) SEGMENT, optional
        Motion of the camera in the world; the places are then relative to the camera.

    Returns
    -------
    places : (k, m, 3) float64, mm
        At k times, the first at `begin_s` and the last at `end_s`.
    margin_mm : float
    """
    still = resting() if camera is None else camera
    changes = np.concatenate([motion["begin_s"][1:], still["begin_s"][1:]])
    ends = [begin_s, *np.unique(changes[(changes > begin_s) & (changes < end_s)]).tolist(), end_s]
    places, margin = [frame.points(seen_from(camera, motion, begin_s), points)], 0.0
    for first, last in pairwise(ends):
        body, eye = motion[segment_at(motion, first)], still[segment_at(still, first)]
        turn = float(body["rate"] + eye["rate"])
        if turn > 0.0 and not (body["velocity"].any() or eye["velocity"].any() or body["rate"] * eye["rate"]):
            # About one fixed axis; all further turns are the same.
            path_end = min(last, first + 2.0 * np.pi / turn)
        else:
            path_end = last
        steps = min(int(np.ceil(turn * (path_end - first) / STEP)), MOST_STEPS) or 1
        times = np.linspace(first, path_end, steps + 1)
        places += [frame.points(seen_from(camera, motion, float(time)), points) for time in times[1:]]
        if path_end < last:
            places.append(frame.points(seen_from(camera, motion, last), points))
        margin = max(margin, _off_chord(body, eye, points, times))
    return np.array(places), margin


def segment_at(motion: NDArray[np.void], time_s: float) -> int:
    """Return the number of the segment of a motion from a time on."""
    return int(np.searchsorted(motion["begin_s"][1:], time_s, side="right"))


def _off_chord(body: np.void, eye: np.void, points: Array, times: Array) -> float:
    """Return a bound on the distance of paths from their chords between neighbouring times, mm.

    A path with acceleration a leaves the chord over a time T by at most a T²/8. The camera's turn adds Coriolis and
    centrifugal acceleration.

    Parameters
    ----------
    body, eye : SEGMENT
        Present segments of the body and of the camera.
    points : (m, 3) float64, mm
    times : (k,) float64
        Equally spaced.
    """
    step = float(times[1] - times[0])
    placed = frame.points(body["start"], points) - body["centre"]
    radius = np.linalg.norm(np.cross(placed, body["axis"]), axis=1)
    acceleration = body["rate"] ** 2 * radius
    if eye["rate"] > 0.0:
        speed = np.linalg.norm(body["velocity"] - eye["velocity"]) + body["rate"] * radius
        # The body's place about its own centre is as long at all times.
        between = np.array([_centre(body, time) - _centre(eye, time) for time in (times[0], times[-1])])
        farthest = np.linalg.norm(between, axis=1).max() + np.linalg.norm(placed, axis=1)
        acceleration = acceleration + 2.0 * eye["rate"] * speed + eye["rate"] ** 2 * farthest
    return float(acceleration.max(initial=0.0)) * step**2 / 8.0


def _centre(row: np.void, time_s: float) -> Array:
    """Return the centre of the turn of a segment at a time, (3,) mm."""
    return np.asarray(row["centre"] + row["velocity"] * (time_s - row["begin_s"]))


def _set_turn(row: NDArray[np.void], turn_rad_s: Array) -> None:
    """Set axis and rate of one segment from its rotation vector."""
    rate = float(np.linalg.norm(turn_rad_s))
    row["axis"][0] = turn_rad_s / rate if rate > 0.0 else (0.0, 0.0, 1.0)
    row["rate"][0] = rate


@kernel
def fill_pose(motion: NDArray[np.void], first: int, last: int, time_s: float, pose: Array) -> None:
    """Fill the pose of a body at a time.

    Parameters
    ----------
    motion : (n,) SEGMENT
    first, last : int
        The segments of the body are those from `first` up to `last`, exclusive.
    time_s : float
    pose : (3, 4) float64
        Output.
    """
    number = first
    while number + 1 < last and time_s >= motion[number + 1].begin_s:
        number += 1
    row = motion[number]
    time = time_s - row.begin_s
    if row.rate == 0.0:
        for i in range(3):
            for k in range(4):
                pose[i, k] = row.start[i, k]
            pose[i, 3] += row.velocity[i] * time
        return
    angle = row.rate * time
    # 1 − cos without cancellation.
    sine, half = np.sin(angle), np.sin(0.5 * angle)
    rest = 2.0 * half * half
    ax, ay, az = row.axis[0], row.axis[1], row.axis[2]
    for k in range(4):
        x, y, z = row.start[0, k], row.start[1, k], row.start[2, k]
        if k == 3:
            x, y, z = x - row.centre[0], y - row.centre[1], z - row.centre[2]
        # v + sin φ a × v + (1 − cos φ) a × (a × v), Rodrigues' formula.
        cx, cy, cz = ay * z - az * y, az * x - ax * z, ax * y - ay * x
        ex, ey, ez = ay * cz - az * cy, az * cx - ax * cz, ax * cy - ay * cx
        pose[0, k] = x + sine * cx + rest * ex
        pose[1, k] = y + sine * cy + rest * ey
        pose[2, k] = z + sine * cz + rest * ez
    for i in range(3):
        pose[i, 3] += row.centre[i] + row.velocity[i] * time


@kernel
def fill_relative(first: Array, second: Array, pose: Array) -> None:
    """Fill the second pose as seen from the first, first⁻¹ · second.

    Parameters
    ----------
    first, second : (3, 4) float64
    pose : (3, 4) float64
        Output.
    """
    for i in range(3):
        for k in range(4):
            total = 0.0
            for j in range(3):
                shift = first[j, 3] if k == 3 else 0.0
                total += first[j, i] * (second[j, k] - shift)
            pose[i, k] = total
