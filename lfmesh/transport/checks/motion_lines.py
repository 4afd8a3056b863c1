"""The exposure and the motions of a scene in words: ways in mm, and the blur of the picture in pixels and lenslets."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from lfmesh.geometry import frame
from lfmesh.geometry.meshes.mesh import Mesh
from lfmesh.geometry.motions import Segments, motions_of
from lfmesh.geometry.objects.targets import named_target, target_mesh
from lfmesh.geometry.rigid_motion import pose_at
from lfmesh.scene import FirstOrder, Scene
from lfmesh.scene.light.particles import particle_velocities
from lfmesh.scene.literals import counted
from lfmesh.scene.motion import Exposure
from lfmesh.transport.packets.packet import OBJECT_FRAME, WORLD_FRAME
from lfmesh.transport.tables.volumes import corners_of
from lfmesh.transport.world import World

Array = NDArray[np.float64]

STEPS = 128
"""Steps of the exposure in which ways are measured, besides the times of poses."""

DIRECTIONS = 300
"""Directions in which a body's outermost points are taken."""

RAYS = 9
"""Chief rays along each side of the field."""

MOST_FACETS = 50_000
"""Largest number of facets that chief rays are traced to; the corners of more are close together."""

MOST_NAMED = 4
"""Largest number of parts that are named as moving together."""

MOST_PARTICLES = 2000
"""Largest number of particles whose streaks are measured."""


@dataclass
class _Mover:
    """Parts of a scene with one motion, and their points at t = 0 in the world, mm."""

    motion: Segments | None
    names: list[str] = field(default_factory=list)
    meshes: list[Mesh] = field(default_factory=list)
    lamps: list[Array] = field(default_factory=list)


def motion_lines(world: World) -> list[str]:
    """Describe the exposure of a scene, and the motion of each group of parts that move together.

    Parameters
    ----------
    world : World
    """
    scene = world.scene
    if scene.exposure is None:
        return []
    rows = scene.camera.sensor.pixels[1]
    lines = [f"{'exposure':<23}{_exposure(scene.exposure, rows)}"]
    if not scene.moves:
        return [*lines, "Note: nothing moves, so the exposure does not change the picture"]
    camera = motions_of(scene).camera
    movers = [each for each in _movers(world) if each.motion is not None or camera is not None]
    return [*lines, *(_line(each, camera, scene, world.facts) for each in movers), *_streaks(world)]


def _exposure(exposure: Exposure, rows: int) -> str:
    parts = [f"{_time(exposure.duration_s)} for each row of pixels"]
    if exposure.shutter:
        parts.append(f"the shutter is open for {_time(exposure.open_s)} of it")
    if exposure.row_time_s > 0.0:
        first = "top" if exposure.row_direction == "down" else "bottom"
        begin = f"{counted(rows, 'row')} begin {_time(exposure.row_time_s)} apart, from the {first} of the picture"
        parts.append(f"{begin}, and end after {_time(exposure.end_s(rows))}")
    return "; ".join(parts)


def _time(seconds: float) -> str:
    for factor, unit in ((1.0, "s"), (1e3, "ms"), (1e6, "µs")):
        if factor * seconds >= 1.0:
            return f"{factor * seconds:.4g} {unit}"
    return f"{1e9 * seconds:.4g} ns"


def _movers(world: World) -> Iterator[_Mover]:
    """Yield the parts of a scene by their motions, in the order of the scene; those at rest are one mover, too."""
    scene, motions, movers = world.scene, motions_of(world.scene), dict[bytes, _Mover]()

    def mover(motion: Segments | None, name: str) -> _Mover:
        found = movers.setdefault(b"" if motion is None else motion.tobytes(), _Mover(motion))
        found.names.append(name)
        return found

    for i, (motion, target) in enumerate(zip(motions.bodies, scene.targets, strict=True)):
        mover(motion, named_target(scene, i)).meshes.append(target_mesh(target, scene).mesh)
    volumes, to_world = world.tables.objects.volumes, world.tables.frames[OBJECT_FRAME, WORLD_FRAME]
    for i, (motion, medium) in enumerate(zip(motions.media, scene.media, strict=True)):
        corners = corners_of(volumes.rows[i])
        if corners is not None:
            own = frame.compose(to_world, frame.inverse(volumes.rows[i]["to_own"]))
            name = f"media[{i}]" + (f" ({medium.name})" if medium.name else "")
            box = frame.points(own, corners)
            mover(motion, name).meshes.append(Mesh(box, ConvexHull(box).simplices.astype(np.int64)))
    for i, (motion, light) in enumerate(zip(motions.lights, scene.lights, strict=True)):
        found = mover(motion, f"lights[{i}] ({light.kind})")
        if light.region is not None:
            found.lamps.append(light.region.corners_mm)
    yield from movers.values()


def _outermost(points: Array) -> Array:
    """Return the points that lie farthest in one of many directions, (n, 3)."""
    if len(points) <= DIRECTIONS:
        return points
    k = np.arange(DIRECTIONS) + 0.5
    z, turn = 1.0 - 2.0 * k / DIRECTIONS, np.pi * (1.0 + np.sqrt(5.0)) * k
    across = np.sqrt(1.0 - z**2)
    directions = np.stack([across * np.cos(turn), across * np.sin(turn), z])
    return np.asarray(points[np.unique(np.argmax((points - points.mean(axis=0)) @ directions, axis=0))])


def _line(mover: _Mover, camera: Segments | None, scene: Scene, facts: FirstOrder) -> str:
    """Describe the motion of parts that move together, relative to the camera."""
    exposure = _exposure_of(scene)
    times = _times(exposure, scene, mover.motion, camera)
    poses = [_relative(mover.motion, camera, time) for time in times.tolist()]
    seen = _points(mover.meshes, [poses[0], poses[len(poses) // 2], poses[-1]], scene, facts)
    points = np.concatenate([seen, *mover.lamps])
    tracks = np.stack([frame.points(pose, points) for pose in poses])
    names = ", ".join(mover.names[:MOST_NAMED])
    if (more := len(mover.names) - MOST_NAMED) > 0:
        names += f" and {more} more"
    if mover.motion is None:
        names = "what stands still"
    way = float(np.linalg.norm(np.diff(tracks, axis=0), axis=2).sum(axis=0).max(initial=0.0))
    words = [f"moves by up to {way:.4g} mm"] if len(points) else []
    if (turn := _turn_deg(poses)) > 0.0:
        words.append(f"turns by {turn:.4g}°")
    beside = " relative to the camera" if camera is not None else ""
    line = f"{names}: {' and '.join(words)}{beside}"
    if not len(seen):
        return line
    blur = _blur(tracks[:, : len(seen)], times, scene, facts)
    if blur is None:
        return f"{line}; out of the field"
    return f"{line}; its picture moves by up to {blur} while a row collects light"


def _points(meshes: list[Mesh], poses: list[Array], scene: Scene, facts: FirstOrder) -> Array:
    """Return the outermost points of meshes, and points where chief rays meet them at some poses, (n, 3), world, mm."""
    start, way = _chief_rays(scene, facts)
    found = [np.zeros((0, 3))]
    for mesh in meshes:
        found.append(_outermost(mesh.vertices[np.unique(mesh.faces)]))
        if len(mesh.faces) <= MOST_FACETS:
            for pose in poses:
                back = frame.inverse(pose)
                found.append(_met(mesh, frame.points(back, start), frame.directions(back, way)))
    return np.concatenate(found)


def _chief_rays(scene: Scene, facts: FirstOrder) -> tuple[Array, Array]:
    """Return starts and directions of chief rays all over the field, (n, 3), world."""
    if not np.isfinite(facts.field.slope).all():
        return np.zeros((0, 3)), np.zeros((0, 3))
    shares = np.linspace(-0.499, 0.499, RAYS)
    places = np.stack(np.meshgrid(shares, shares), axis=-1).reshape(-1, 2)
    start = np.column_stack([places * facts.field.at_vertex_mm, np.zeros(len(places))])
    way = np.column_stack([-places * facts.field.slope, np.full(len(places), -1.0)])
    pose = scene.camera.pose
    to_world = frame.frame(pose.tilt_deg, pose.shift_mm)
    return frame.points(to_world, start), frame.directions(to_world, way)


def _met(mesh: Mesh, start: Array, way: Array) -> Array:
    """Return the points where rays meet the facets of a mesh, (n, 3)."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    found = [np.zeros((0, 3))]
    for one, along in zip(start, way, strict=True):
        # Möller and Trumbore 1997.
        across = np.cross(along, c - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            over = 1.0 / ((b - a) * across).sum(axis=1)
            u = ((one - a) * across).sum(axis=1) * over
            turned = np.cross(one - a, b - a)
            v, t = turned @ along * over, (turned * (c - a)).sum(axis=1) * over
            meets = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 0.0)
        found.append(one + t[meets, None] * along)
    return np.concatenate(found)


def _exposure_of(scene: Scene) -> Exposure:
    assert scene.exposure is not None
    return scene.exposure


def _times(exposure: Exposure, scene: Scene, *motions: Segments | None) -> Array:
    """Return the times at which ways are measured, s."""
    end = exposure.end_s(scene.camera.sensor.pixels[1])
    begins = [motion["begin_s"] for motion in motions if motion is not None]
    times = np.unique(np.concatenate([np.linspace(0.0, end, STEPS + 1), *begins]))
    return np.asarray(times[(times >= 0.0) & (times <= end)])


def _relative(body: Segments | None, camera: Segments | None, time_s: float) -> Array:
    """Return the pose of a body, (3, 4), as the camera at rest would see it."""
    pose = frame.IDENTITY if body is None else pose_at(body, time_s)
    return pose if camera is None else frame.compose(frame.inverse(pose_at(camera, time_s)), pose)


def _turn_deg(poses: list[Array]) -> float:
    """Return the sum of the turns from pose to pose, degrees."""
    turns = np.stack([other[:, :3] @ one[:, :3].T for one, other in pairwise(poses)])
    off = np.stack([turns[:, 2, 1] - turns[:, 1, 2], turns[:, 0, 2] - turns[:, 2, 0], turns[:, 1, 0] - turns[:, 0, 1]])
    angles = np.arctan2(np.linalg.norm(off, axis=0), np.trace(turns, axis1=1, axis2=2) - 1.0)
    # Rounded, as what turns with the camera does so to rounding.
    return round(float(np.degrees(angles.sum())), 6)


def _blur(tracks: Array, times: Array, scene: Scene, facts: FirstOrder) -> str | None:
    """Return the longest way of a point's picture while a row of pixels collects light; None out of the field.

    Parameters
    ----------
    tracks : (times, n, 3) float64, mm
        Places in the world, as the camera at rest would see them.
    times : (times,) float64, s
    scene : Scene
    facts : FirstOrder
    """
    camera, exposure = scene.camera, _exposure_of(scene)
    to_camera = frame.inverse(frame.frame(camera.pose.tilt_deg, camera.pose.shift_mm))
    pictures, seen = _pictures(frame.points(to_camera, tracks.reshape(-1, 3)), scene, facts)
    pictures, seen = pictures.reshape(*tracks.shape[:2], 2), seen.reshape(tracks.shape[:2])
    steps = np.linalg.norm(np.diff(pictures, axis=0), axis=2) * (seen[1:] | seen[:-1])
    way = np.concatenate([np.zeros((1, steps.shape[1])), np.cumsum(steps, axis=0)])
    longest = 0.0
    for point in way.T:
        ends = np.interp(times + exposure.duration_s, times, point)
        longest = max(longest, float((ends - point).max()))
    if not seen.any():
        return None
    pixels = f"{longest / camera.sensor.pixel_mm:.3g} pixels"
    return pixels if camera.mla is None else f"{pixels}, {longest / camera.mla.pitch_mm:.3g} lenslets,"


def _pictures(points: Array, scene: Scene, facts: FirstOrder) -> tuple[Array, NDArray[np.bool_]]:
    """Return the places of points on array or sensor, (n, 2) mm, by chief rays, and which are in the field.

    Parameters
    ----------
    points : (n, 3) float64, mm
        Camera frame.
    scene : Scene
    facts : FirstOrder
    """
    sensor, mla = scene.camera.sensor, scene.camera.mla
    size = np.array(sensor.size_mm if mla is None else np.minimum(sensor.size_mm, mla.size_mm))
    width = np.add(facts.field.at_vertex_mm, points[:, 2:] * np.array(facts.field.slope))
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = np.where(points[:, 2:] < 0.0, points[:, :2] / width, np.inf)
    seen = np.asarray((np.abs(shares) <= 0.5).all(axis=1), np.bool_)
    return np.clip(np.nan_to_num(shares, posinf=0.5, neginf=-0.5), -0.5, 0.5) * size, seen


def _streaks(world: World) -> Iterator[str]:
    """Describe the streaks of particles."""
    scene, camera = world.scene, motions_of(world.scene).camera
    exposure = _exposure_of(scene)
    for group in world.particles:
        entry: Any = scene.particles[group.entry]
        velocities = particle_velocities(entry, group.points, scene)
        if velocities is None:
            continue
        kept = slice(None, None, -(-len(group.points) // MOST_PARTICLES))
        start, speeds = group.points[kept], velocities[kept]
        times = _times(exposure, scene, camera)
        tracks = np.stack([
            frame.points(_relative(None, camera, time), start + time * speeds) for time in times.tolist()
        ])  # fmt: skip
        way = float(np.linalg.norm(speeds, axis=1).max(initial=0.0)) * times[-1]
        blur = _blur(tracks, times, scene, world.facts)
        of_picture = "out of the field" if blur is None else f"streaks of up to {blur} while a row collects light"
        yield f"particles[{group.entry}]: move by up to {way:.4g} mm; {of_picture}"
