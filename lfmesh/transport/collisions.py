"""Refuse cameras with an intersecting lens, array and sensor, because of their poses.

Their images would be black without a message.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from lfmesh.errors import SceneError
from lfmesh.geometry import frame
from lfmesh.geometry.array.lenslets import Lenslets
from lfmesh.geometry.lens.element_poses import refuse_crossing_elements
from lfmesh.geometry.lens.lens_shape import LEAST_RINGS, LensShape
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.geometry.lens.surface_gaps import farthest_mm
from lfmesh.geometry.meshes.crossings import segments
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.surfaces.sag import heights
from lfmesh.geometry.surfaces.surface import in_place, surface_of
from lfmesh.geometry.surfaces.tessellation import FLOAT32_MARGIN, last_radius, rim_radius
from lfmesh.scene import Scene
from lfmesh.transport.packets.packet import MLA_FRAME, SENSOR_FRAME
from lfmesh.transport.tables.frames import parts_in_camera
from lfmesh.transport.tables.lens import curved_lenslets, other_lenslets, outermost
from lfmesh.transport.tables.tables import MlaTables

RECTANGLE = np.array([[0, 1, 3], [0, 3, 2]])
"""Facets of a rectangle, for corners in the order of x and y."""

SLAB = np.array([[0, 1, 3], [0, 3, 2], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4],
                 [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 3, 7], [1, 7, 5]])  # fmt: skip
"""Facets of a slab, for corners in the order of x, y and z."""


class Slab(NamedTuple):
    """Space taken by an array, in its own frame."""

    half: Array  # (2,) mm, half its extent
    front: float  # mm, z of the lower face
    rear: float  # mm
    curved_to_lens: bool


def slab_of(lenslets: Lenslets, other: Lenslets | None, curved_to_lens: bool) -> Slab:
    """Return the space taken by an array.

    Parameters
    ----------
    lenslets : Lenslets
        Of the face where the array's frame starts.
    other : Lenslets, optional
        Of the other face, unless it is flat.
    curved_to_lens : bool
        The frame starts from the face towards the lens.
    """
    half = np.asarray(lenslets.lattice.half_extent)
    return Slab(half, lenslets.top, _rear_mm(lenslets, other), curved_to_lens)


def slab_of_tables(mla: MlaTables) -> Slab | None:
    """Return the space taken by the array; None without one."""
    back = None if mla.back is None else mla.back.lenslets
    return slab_of(mla.lenslets, back, mla.curved_to_lens) if mla.present else None


def far_end_mm(mla: MlaTables) -> float:
    """Return the z, array frame, of the array's far end: its flat face or its other lenslets."""
    return _rear_mm(mla.lenslets, None if mla.back is None else mla.back.lenslets)


def _rear_mm(lenslets: Lenslets, other: Lenslets | None) -> float:
    return lenslets.thickness - (0.0 if other is None else other.top)


def refuse_impossible_camera(scene: Scene) -> None:
    """Refuse a camera with intersecting elements, array or sensor, as a build would.

    Parameters
    ----------
    scene : Scene
        Solved, with mesh elements measured.

    Raises
    ------
    SceneError
    """
    lens, mla, slab = scene.camera.lens, scene.camera.mla, None
    if lens.elements:
        refuse_crossing_elements(lens)
    if mla is not None:
        own = curved_lenslets(mla)
        other = other_lenslets(mla, own)
        to_lens = mla.curved_side == "lens"
        # The frame of an array with lenslets on both faces starts from the face towards the sensor.
        slab = (
            slab_of(own, None, to_lens)
            if other is None
            else slab_of(*((other, own) if to_lens else (own, other)), False)
        )
    refuse_collisions(scene, slab, lambda: solved_camera(scene).lens_shape())


def refuse_collisions(scene: Scene, slab: Slab | None, shape: Callable[[], LensShape]) -> None:
    """Refuse a camera with intersecting sensor, array and lens.

    Parameters
    ----------
    scene : Scene
    slab : Slab or None
    shape : function that returns a LensShape
        Called if something comes near the lens.

    Raises
    ------
    SceneError
        Gives the depth of the intersection.
    """
    width, height = (0.5 * size for size in scene.camera.sensor.size_mm)
    cover = scene.camera.sensor.cover
    front = -cover.height_mm if cover is not None else 0.0
    corners = np.array([[x, y, front] for x in (-width, width) for y in (-height, height)])
    parts, _ = parts_in_camera(scene.camera)
    what, own = "camera.sensor", SENSOR_FRAME
    if slab is not None:
        to_array = frame.compose(frame.inverse(parts[MLA_FRAME]), parts[SENSOR_FRAME])
        _refuse_sensor_in_array(slab, frame.points(to_array, corners), cover is not None)
        half_width, half_height = slab.half
        depths = slab.front, slab.rear
        corners = np.array(
            [[x, y, z] for x in (-half_width, half_width) for y in (-half_height, half_height) for z in depths]
        )
        what, own = "camera.mla", MLA_FRAME
    corners = frame.points(parts[own], corners)
    if corners[:, 2].min() <= _lens_reaches_mm(scene):
        _refuse_in_lens(what, shape(), corners)


def _lens_reaches_mm(scene: Scene) -> float:
    """Return an upper bound of z, camera frame, of the lens's meshes; inf: unknown."""
    lens, reached = scene.camera.lens, -np.inf
    if lens.elements or any(s.mesh is not None for s in lens.surfaces):
        return np.inf
    for number, s in enumerate(lens.surfaces):
        if not lens.is_pure_stop(number):
            record = surface_of(s, vertex_z=lens.vertices_mm[number], semi_diameter=s.semi_diameter_mm or np.inf)
            farthest = farthest_mm(record, min(rim_radius(record, LEAST_RINGS), last_radius(record)))
            reached = max(reached, lens.vertices_mm[number] + farthest * (1.0 + FLOAT32_MARGIN))
    return reached


def _refuse_sensor_in_array(slab: Slab, corners: Array, covered: bool) -> None:
    """Refuse a sensor or cover with corners (4, 3) (array frame) not all beyond the array's rear face."""
    inside = np.clip(corners[:, :2], *(np.array([[-1.0], [1.0]]) * slab.half))
    # Only the part of the sensor behind the array can intersect it.
    plane = np.linalg.lstsq(np.column_stack([corners[:, :2], np.ones(4)]), corners[:, 2], rcond=None)[0]
    z = inside @ plane[:2] + plane[2]
    gap = (z - slab.rear if slab.curved_to_lens else slab.front - z).min()
    if gap <= 0.0:
        raise SceneError(
            f"camera.mla.pose, camera.sensor.pose: the array reaches {-gap:.4g} mm through the sensor's "
            f"{'cover' if covered else 'plane'}; give smaller shifts and tilts, "
            f"{'a thinner camera.sensor.cover, ' if covered else ''}or a larger camera.sensor.distance_mm"
        )


def _refuse_in_lens(what: str, shape: LensShape, corners: Array) -> None:
    """Refuse a body with corners or faces that reach back to the lens.

    Parameters
    ----------
    what : str
        Name of the body.
    shape : LensShape
    corners : (4, 3) or (8, 3) float64, mm
        Of a rectangle or a slab, camera frame, in the order of x, y and z.
    """
    last = shape.surfaces[-1]
    # A body smaller than a concave last surface may reach into its hollow.
    if np.hypot(corners[:, 0], corners[:, 1]).max() >= last["semi_diameter"]:
        _refuse_depth(what, float(outermost(shape)[:, 2].max() - corners[:, 2].min()))
    cap = shape.caps[-1]
    met = segments(corners[RECTANGLE if len(corners) == 4 else SLAB], cap.vertices[cap.faces])
    if shape.analytic[-1]:
        # If its corners are beyond the surface, it reaches into the lens only where the surface crosses a face.
        _refuse_depth(what, _depth(last, np.concatenate([corners, met.ends.reshape(-1, 3)])))
        return
    if len(met.own):
        x, y, z = met.ends[0].mean(axis=0)
        raise SceneError(
            f"{what}.pose: it reaches into the lens, whose last surface it cuts near ({x:.4g}, {y:.4g}, {z:.4g}) mm; "
            f"give smaller shifts and tilts, or a larger {what}.distance_mm"
        )
    _refuse_depth(what, float(last["vertex_z"] - corners[:, 2].max()))


def _depth(surface: np.void, points: Array) -> float:
    """Return the largest depth, mm, of points (n, 3) behind a surface; −inf: all are beside it."""
    placed = in_place(surface, points)
    placed = placed[np.hypot(placed[:, 0], placed[:, 1]) <= surface["semi_diameter"]]
    depth = surface["vertex_z"] + heights(surface, placed[:, 0], placed[:, 1]) - placed[:, 2]
    return float(depth.max(initial=-np.inf))


def _refuse_depth(what: str, depth_mm: float) -> None:
    """Refuse a body that reaches into the lens by a positive depth."""
    if depth_mm > 0.0:
        raise SceneError(
            f"{what}.pose: it reaches {depth_mm:.4g} mm into the lens; give smaller shifts and tilts, or a larger "
            f"{what}.distance_mm"
        )
