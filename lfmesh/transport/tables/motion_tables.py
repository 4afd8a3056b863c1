"""Tables of motions from a scene: its movers, and the space that their things pass through during the exposure."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import SceneError
from lfmesh.geometry import frame
from lfmesh.geometry.box_corners import corners_between
from lfmesh.geometry.lens.orientation import image_inverts
from lfmesh.geometry.meshes.mesh import Mesh
from lfmesh.geometry.motions import motions_of
from lfmesh.geometry.objects.targets import TargetMesh
from lfmesh.geometry.rigid_motion import resting
from lfmesh.scene import Scene
from lfmesh.transport.packets.packet import CAMERA_FRAME, MOST_MOVERS, OBJECT_FRAME, WORLD_FRAME
from lfmesh.transport.tables.motions import STILL, Motions
from lfmesh.transport.tables.moving_lights import with_moving_lights
from lfmesh.transport.tables.swept import box_round, reach_mm
from lfmesh.transport.tables.tables import ObjectTables
from lfmesh.transport.tables.volumes import IN_FRONT, Volumes, corners_of

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]
Records = NDArray[np.void]

ROOM = 1.0 + 2.0**-10
"""Enlargement of the spheres round targets, which rays of queries must not miss by their rounding."""


def motion_tables(
    scene: Scene, targets: list[TargetMesh], objects: ObjectTables, frames: Array
) -> Motions | None:  # fmt: skip
    """Return the tables of motions; None if nothing moves.

    Parameters
    ----------
    scene : Scene
        Solved.
    targets : list of TargetMesh
        World frame.
    objects : ObjectTables
    frames : (6, 6, 3, 4) float64
        See `tables.frames`.

    Raises
    ------
    SceneError
        There are more movers than packets can tell apart.
    """
    if not scene.moves or scene.exposure is None:
        return None
    movements = motions_of(scene)
    media = [*movements.media, *(movements.bodies[body] for body in _absorbing(scene, objects))]
    camera = resting() if movements.camera is None else movements.camera
    movers = [camera]
    of_target, of_lamp, of_medium = (
        _numbered(movers, kind) for kind in (movements.bodies, movements.lights, media)
    )  # fmt: skip
    if objects.volumes is not None:
        # An unbounded medium ends at the lens.
        of_medium[objects.volumes.rows["bounds"] == IN_FRONT] = STILL
    (at_rest,) = _numbered(movers, [None])
    begin_s, duration_s, end_s = scene.exposure.windows(scene.camera.sensor.pixels[1], inverts=image_inverts(scene))
    to_object = frames[WORLD_FRAME, OBJECT_FRAME]
    return Motions(
        segments=np.concatenate([_seen_in(to_object, mover) for mover in movers]),
        first=np.cumsum([0, *map(len, movers)]),
        of_target=np.append(of_target, STILL),
        of_lamp=of_lamp,
        # Room for bodies that absorb at other wavelengths.
        of_medium=np.append(of_medium, np.full(len(targets), STILL)),
        resting=int(at_rest),
        bounds=_bounds(len(movers), of_target, hulls_of(targets, objects, to_object)),
        begin_s=begin_s,
        duration_s=duration_s,
        end_s=end_s,
        shutter=scene.exposure.shutter_table(),
        camera_moves=movements.camera is not None,
        frames=frames,
    )


def _absorbing(scene: Scene, objects: ObjectTables) -> Numbers:
    """Return the bodies whose absorption is that of media, in the order of their rows behind the scene's media."""
    if objects.volumes is None:
        return np.zeros(0, np.int64)
    return objects.by_rank[objects.volumes.rows["inside"][len(scene.media) :]]


def _numbered(movers: list[Records], motions: Sequence[Records | None]) -> Numbers:
    """Return the mover of each of some motions in the world; None: at rest. New movers are appended to the list."""
    numbers, known = np.zeros(len(motions), np.int64), {mover.tobytes(): k for k, mover in enumerate(movers)}
    rest = resting()
    for i, motion in enumerate(motions):
        own = rest if motion is None else motion
        key = own.tobytes()
        if key not in known:
            known[key] = len(movers)
            movers.append(own)
        # The first one stands still relative to the camera.
        if len(movers) - 1 > MOST_MOVERS:
            raise SceneError(
                f"motion: more than {MOST_MOVERS} things move differently relative to the camera; give some of them "
                "the same motion, with the same center_mm"
            )
        numbers[i] = known[key]
    return numbers


def hulls_of(targets: list[TargetMesh], objects: ObjectTables, to_object: Array) -> list[Array]:
    """Return points of each target whose hull holds it, with the curved patches of glass, (n, 3) mm, object frame.

    Parameters
    ----------
    targets : list of TargetMesh
        World frame.
    objects : ObjectTables
    to_object : (3, 4) float64
        From the world.
    """
    hulls = [frame.points(to_object, target.hull.vertices) for target in targets]
    if objects.glass is not None:
        for i in np.flatnonzero(objects.rank):
            hulls[i] = np.concatenate([hulls[i], corners_between(*objects.glass.boxes[i])])
    return hulls


def _bounds(movers: int, of_target: Numbers, hulls: list[Array]) -> Array:
    """Return a sphere round the targets of each mover, (movers, 4) mm; radius −1 without targets."""
    bounds = np.full((movers, 4), -1.0)
    for mover in np.unique(of_target):
        points = np.concatenate([hulls[i] for i in np.flatnonzero(of_target == mover)])
        if len(points):
            bounds[mover] = _sphere_round(points)
    return bounds


def _seen_in(to_frame: Array, motion: Records) -> Records:
    """Return a motion in the world in the axes of another frame at rest; `to_frame` : (3, 4), from the world."""
    rows, back = motion.copy(), frame.inverse(to_frame)
    for row in rows:
        row["start"] = frame.compose(frame.compose(to_frame, row["start"]), back)
    rows["centre"] = frame.points(to_frame, rows["centre"])
    for name in ("velocity", "axis"):
        rows[name] = frame.directions(to_frame, rows[name])
    return rows


def _sphere_round(points: Array) -> Array:
    """Return centre and radius of a sphere that holds points (n, 3), (4,) mm."""
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    return np.append(centre, ROOM * float(np.linalg.norm(points - centre, axis=1).max()))


def with_motions(
    objects: ObjectTables, motions: Motions | None, hulls: list[Array], scene: Scene, mesh: Mesh
) -> ObjectTables:  # fmt: skip
    """Return tables of objects whose spheres hold everything throughout the exposure.

    Parameters
    ----------
    objects : ObjectTables
    motions : Motions or None
        None: nothing moves.
    hulls : list of (n, 3) float64, mm
        From `hulls_of`.
    scene : Scene
    mesh : Mesh
        Mesh of targets and housing, object frame.
    """
    if motions is None:
        return objects
    reach = [reach_mm(motions, int(mover), hull) for mover, hull in zip(motions.of_target, hulls, strict=False)]
    radius = max([objects.radius, *reach])
    outer, lit = max(objects.outer_radius, radius), max(objects.lit_radius, radius)
    if objects.volumes is not None:
        found = media_corners(objects.volumes)
        bounded = max((reach_mm(motions, int(motions.of_medium[k]), points) for k, points in found), default=0.0)
        outer = max(outer, bounded)
        lit = max(lit, bounded) if objects.volumes.scatters else lit
    objects = objects._replace(radius=radius, outer_radius=outer, lit_radius=lit)
    return with_moving_lights(objects, motions, scene, mesh)


def media_corners(volumes: Volumes | None) -> list[tuple[int, Array]]:
    """Return the bounded media by their rows, each with the corners of a box round it, (8, 3) mm, object frame."""
    found = []
    for number, row in enumerate(volumes.rows if volumes is not None else ()):
        corners = corners_of(row)
        if corners is not None:
            found.append((number, frame.points(frame.inverse(row["to_own"]), corners)))
    return found


def swept_boxes(motions: Motions, hulls: list[Array], objects: ObjectTables, moves: Array) -> Array:
    """Return the corners of boxes that hold targets that move, and media, throughout, camera frame, (n, 3) mm.

    Parameters
    ----------
    motions : Motions
    hulls : list of (n, 3) float64, mm
        From `hulls_of`.
    objects : ObjectTables
    moves : (6, 6, 3, 4) float64
        See `tables.frames`.
    """
    things = [(int(mover), hull) for mover, hull in zip(motions.of_target, hulls, strict=False) if mover != STILL]
    things += [(int(motions.of_medium[number]), corners) for number, corners in media_corners(objects.volumes)]
    move = moves[OBJECT_FRAME, CAMERA_FRAME]
    boxes = [box_round(motions, mover, points, move) for mover, points in things if len(points)]
    return np.concatenate([np.zeros((0, 3)), *boxes])
