"""Motions during the exposure for drawing, in the world frame, mm: ways with arrowheads, and bodies at the end."""

from collections.abc import Iterator

import numpy as np
import pyvista as pv

from lfmesh.geometry import frame as frames
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.motions import Segments, motions_of
from lfmesh.geometry.rigid_motion import pose_at
from lfmesh.transport.packets.packet import CAMERA_FRAME, WORLD_FRAME
from lfmesh.transport.world import World
from lfmesh.view.scene3d.outlines import outline_of_medium
from lfmesh.view.scene3d.ray_lines import line_segments

STEPS = 48
"""Straight parts of a drawn way."""

MOST_POINTS = 300
"""Most points of a body of which the one that goes farthest is drawn."""

TIP = 0.06
"""Length of an arrowhead over that of its way."""


def drawn_motions(world: World) -> Iterator[tuple[str, pv.PolyData, pv.PolyData]]:
    """Yield the name of each thing that moves, the way of the point that goes farthest, and its arrowhead.

    Parameters
    ----------
    world : World
    """
    scene, motions = world.scene, motions_of(world.scene)
    camera = world.tables.frames[CAMERA_FRAME, WORLD_FRAME]
    yield from _way(world, "camera", motions.camera, frames.points(camera, np.zeros((1, 3))))
    for i, motion in enumerate(motions.bodies):
        mesh = world.targets[i].mesh
        yield from _way(world, f"targets[{i}]", motion, mesh.vertices[np.unique(mesh.faces)])
    for i, (motion, light) in enumerate(zip(motions.lights, scene.lights, strict=True)):
        if light.region is not None:
            yield from _way(world, f"lights[{i}]", motion, light.region.corners_mm)
    for i, motion in enumerate(motions.media):
        yield from _way(world, f"media[{i}]", motion, outline_of_medium(world, i).reshape(-1, 3))


def end_pose(world: World, motion: Segments) -> Array:
    """Return the pose of a body at the end of the exposure, relative to that at t = 0, (3, 4), world frame.

    Parameters
    ----------
    world : World
    motion : (n,) SEGMENT
    """
    return pose_at(motion, _end_s(world))


def _end_s(world: World) -> float:
    exposure = world.scene.exposure
    return 0.0 if exposure is None else exposure.end_s(world.scene.camera.sensor.pixels[1])


def _way(
    world: World, name: str, motion: Segments | None, points: Array
) -> Iterator[tuple[str, pv.PolyData, pv.PolyData]]:
    if motion is None or not len(points):
        return
    points = points[:: -(-len(points) // MOST_POINTS)]
    times = np.linspace(0.0, _end_s(world), STEPS + 1)
    tracks = np.stack([frames.points(pose_at(motion, time), points) for time in times.tolist()])
    lengths = np.linalg.norm(np.diff(tracks, axis=0), axis=2).sum(axis=0)
    track, length = tracks[:, lengths.argmax()], float(lengths.max())
    last = track[-1] - track[-2]
    if not length > 0.0 or not last.any():
        return
    way = line_segments(np.stack([track[:-1], track[1:]], axis=1))
    height = TIP * length
    centre = track[-1] - 0.5 * height * last / np.linalg.norm(last)
    yield name, way, pv.Cone(center=centre, direction=last, height=height, radius=0.35 * height, resolution=16)
