"""Refuse targets and lamps that reach into the camera."""

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import SceneError
from lfmesh.geometry import frame
from lfmesh.geometry.meshes.mesh import Array, Mesh
from lfmesh.geometry.objects.targets import TargetMesh, named_target
from lfmesh.scene import Scene
from lfmesh.scene.light.region import Region
from lfmesh.transport.packets.packet import CAMERA_FRAME, WORLD_FRAME

ROUND = 64
"""Corners of the polygon around a disk; it is larger by at most 0.12 % of the radius."""


def refuse_objects_inside(scene: Scene, targets: list[TargetMesh], housing: Mesh, moves: Array) -> None:
    """Refuse a target or a lamp that reaches into the camera.

    Parameters
    ----------
    scene : Scene
    targets : list of TargetMesh
        World frame.
    housing : Mesh
        Camera frame.
    moves : (6, 6, 3, 4) float64
        See `frame_table`.

    Raises
    ------
    SceneError
        Names the target or lamp and the place.
    """
    barrel, front, end = barrel_of(housing)
    to_camera = moves[WORLD_FRAME, CAMERA_FRAME]

    # A lamp between the first vertex and the plane of the rim may be in the first lens.
    def beside(vertices: Array, first: float) -> bool:
        """Tell whether points, camera frame, all lie on one side of the camera."""
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        return bool((low >= [barrel, barrel, end]).any() or (high <= [-barrel, -barrel, first]).any())

    near = [i for i, target in enumerate(targets) if not beside(frame.points(to_camera, target.hull.vertices), front)]
    objects = (
        *((_name(scene, i), (mesh := targets[i].mesh).vertices, mesh.faces, front) for i in near),
        *((*lamp, min(front, 0.0)) for lamp in _lamps(scene, to_camera, min(front, 0.0))),
    )
    for name, places, faces, first in objects:
        vertices = frame.points(to_camera, places)
        if beside(vertices, first):
            continue
        for polygon in _near(vertices[faces], barrel, first, end):
            within = _between(polygon, first, end)
            if len(within) and _distance_to_axis(within) < barrel:
                raise SceneError(
                    f"{name} reaches into the camera, at z = {within[:, 2].mean():.6g} mm in the camera frame; "
                    f"move it in front of z = {first:.6g} mm or beside the barrel (radius {barrel:.6g} mm)"
                )


def barrel_of(housing: Mesh) -> tuple[float, float, float]:
    """Return the radius of the camera's barrel, and z of its front and of the end of the housing, camera frame, mm."""
    radius = np.hypot(housing.vertices[:, 0], housing.vertices[:, 1])
    front, end = housing.vertices[:, 2].min(), housing.vertices[:, 2].max()
    rounding = 4.0 * np.finfo(np.float64).eps * np.abs(housing.vertices).max()
    return float(radius[housing.vertices[:, 2] <= front + rounding].max()), float(front), float(end)


def _name(scene: Scene, number: int) -> str:
    return f"targets[{number}]" if scene.targets[number].refractor is None else named_target(scene, number)


def _lamps(scene: Scene, to_camera: Array, beyond: float) -> Iterator[tuple[str, Array, NDArray[np.int64]]]:
    """Yield the lamps that may reach beyond a z of the camera frame: name, corners (world frame) and polygons."""
    placed = [(i, light.region) for i, light in enumerate(scene.lights)]
    regions = [(i, region) for i, region in placed if region is not None]
    if not regions:
        return
    centres = frame.points(to_camera, np.array([region.centre_mm for _, region in regions]))
    # No outline reaches farther from its centre than the sum of the half axes.
    sizes = np.linalg.norm([region.half_mm for _, region in regions], axis=2).sum(axis=1)
    for k in np.flatnonzero(centres[:, 2] + sizes >= beyond):
        number, region = regions[k]
        corners = outline_of(region)
        name = f"lights[{number}].{scene.lights[number].place_in_words}"
        yield name, corners, np.arange(len(corners), dtype=np.int64)[None]


def outline_of(region: Region) -> Array:
    """Return a polygon that tightly encloses a region."""
    if not region.is_round:
        return region.corners_mm
    turns = 2.0 * np.pi * np.arange(ROUND) / ROUND
    around = np.stack([np.cos(turns), np.sin(turns)], axis=1) / np.cos(np.pi / ROUND)
    return np.asarray(region.centre_mm + around @ region.half_mm)


def _near(corners: Array, barrel: float, front: float, end: float) -> Iterable[Array]:
    """Return the polygons (n, corners, 3) with bounding boxes that meet the barrel's."""
    low, high = corners.min(axis=1), corners.max(axis=1)
    near = (low[:, :2] < barrel).all(axis=1) & (high[:, :2] > -barrel).all(axis=1)
    near &= (low[:, 2] < end) & (high[:, 2] > front)
    return corners[near]


def _between(polygon: Array, front: float, end: float) -> Array:
    """Return the part of a convex polygon (n, 3) between two planes perpendicular to the axis."""
    for sign, plane in ((1.0, front), (-1.0, end)):
        height = sign * (polygon[:, 2] - plane)
        kept = []
        for p, q, a, b in zip(polygon, np.roll(polygon, -1, axis=0), height, np.roll(height, -1), strict=True):
            if a >= 0.0:
                kept.append(p)
            if (a >= 0.0) != (b >= 0.0):
                kept.append(p + a / (a - b) * (q - p))
        polygon = np.array(kept).reshape(-1, 3)
    return polygon


def _distance_to_axis(polygon: Array) -> float:
    """Return the distance of a convex polygon (n, 3) from the axis."""
    p = polygon[:, :2]
    edge = np.roll(p, -1, axis=0) - p
    turn = p[:, 0] * edge[:, 1] - p[:, 1] * edge[:, 0]
    if turn.sum() != 0.0 and ((turn >= 0.0).all() or (turn <= 0.0).all()):
        return 0.0
    square = np.maximum((edge**2).sum(axis=1), np.finfo(np.float64).tiny)
    share = np.clip(-(p * edge).sum(axis=1) / square, 0.0, 1.0)
    return float(np.hypot(*(p + share[:, None] * edge).T).min())
