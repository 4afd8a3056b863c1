"""Refuse cameras whose lens, array and sensor intersect, as poses may make them.

Light would end between them, and the picture be black without a message.
"""

import numpy as np

from lfmesh.errors import SceneError
from lfmesh.geometry import frame
from lfmesh.geometry.lens.lens_shape import LensShape
from lfmesh.geometry.meshes.crossings import segments
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.surfaces.sag import heights
from lfmesh.geometry.surfaces.surface import in_place
from lfmesh.scene import Scene
from lfmesh.transport.packets.packet import CAMERA_FRAME, MLA_FRAME, SENSOR_FRAME
from lfmesh.transport.tables.tables import LensTables, MlaTables

RECTANGLE = np.array([[0, 1, 3], [0, 3, 2]])
"""Facets of a rectangle, by its corners in the order of x and y."""

SLAB = np.array([[0, 1, 3], [0, 3, 2], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4],
                 [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 3, 7], [1, 7, 5]])  # fmt: skip
"""Facets of a slab, by its corners in the order of x, y and z."""


def refuse_collisions(scene: Scene, shape: LensShape, lens: LensTables, mla: MlaTables, moves: Array) -> None:
    """Refuse a camera whose sensor, array and lens intersect.

    Parameters
    ----------
    scene : Scene
    shape : LensShape
    lens : LensTables
    mla : MlaTables
    moves : (6, 6, 3, 4) float64
        Between frames.

    Raises
    ------
    SceneError
        The message says by how much they intersect.
    """
    width, height = (0.5 * size for size in scene.camera.sensor.size_mm)
    cover = scene.camera.sensor.cover
    front = -cover.height_mm if cover is not None else 0.0
    sensor = np.array([[x, y, front] for x in (-width, width) for y in (-height, height)])
    if mla.present:
        _refuse_sensor_in_array(mla, frame.points(moves[SENSOR_FRAME, MLA_FRAME], sensor), cover is not None)
        half_width, half_height = mla.lenslets.lattice.half_extent
        depths = mla.lenslets.top, far_end_mm(mla)
        slab = [[x, y, z] for x in (-half_width, half_width) for y in (-half_height, half_height) for z in depths]
        _refuse_in_lens("camera.mla", lens, shape, frame.points(moves[MLA_FRAME, CAMERA_FRAME], slab))
    else:
        _refuse_in_lens("camera.sensor", lens, shape, frame.points(moves[SENSOR_FRAME, CAMERA_FRAME], sensor))


def far_end_mm(mla: MlaTables) -> float:
    """Return the z, array frame, beyond which nothing of the array stands: of its flat face or other lenslets."""
    return mla.lenslets.thickness - (0.0 if mla.back is None else mla.back.lenslets.top)


def _refuse_sensor_in_array(mla: MlaTables, corners: Array, covered: bool) -> None:
    """Refuse a sensor, or its cover, whose corners (4, 3) (array frame) are not all beyond the array's rear face."""
    inside = np.clip(corners[:, :2], *(np.array([[-1.0], [1.0]]) * mla.lenslets.lattice.half_extent))
    # Of a sensor larger than the array only the part behind the array can intersect it.
    plane = np.linalg.lstsq(np.column_stack([corners[:, :2], np.ones(4)]), corners[:, 2], rcond=None)[0]
    z = inside @ plane[:2] + plane[2]
    gap = (z - far_end_mm(mla) if mla.curved_to_lens else mla.lenslets.top - z).min()
    if gap <= 0.0:
        raise SceneError(
            f"camera.mla.pose, camera.sensor.pose: the array reaches {-gap:.4g} mm through the sensor's "
            f"{'cover' if covered else 'plane'}; give smaller shifts and tilts, "
            f"{'a thinner camera.sensor.cover, ' if covered else ''}or a larger camera.sensor.distance_mm"
        )


def _refuse_in_lens(what: str, lens: LensTables, shape: LensShape, corners: Array) -> None:
    """Refuse a body whose corners, (4, 3) or (8, 3) (camera frame), or whose faces reach back to the lens.

    Parameters
    ----------
    what : str
        Name of the body.
    lens : LensTables
    shape : LensShape
    corners : (4, 3) or (8, 3) float64, mm
        Of a rectangle or a slab, in the order of x, y and z.
    """
    last = lens.surfaces[-1]
    # A body smaller than a concave last surface may reach into the hollow of that surface.
    if np.hypot(corners[:, 0], corners[:, 1]).max() >= last["semi_diameter"]:
        _refuse_depth(what, float(lens.box_high[2] - corners[:, 2].min()))
    cap = shape.caps[-1]
    met = segments(corners[RECTANGLE if len(corners) == 4 else SLAB], cap.vertices[cap.faces])
    if shape.analytic[-1]:
        # With its corners beyond the surface, it reaches into the lens only where the surface comes through a face.
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
    """Return the depth of the deepest of some points, (n, 3), behind a surface, mm; −inf: all are beside it."""
    placed = in_place(surface, points)
    placed = placed[np.hypot(placed[:, 0], placed[:, 1]) <= surface["semi_diameter"]]
    depth = surface["vertex_z"] + heights(surface, placed[:, 0], placed[:, 1]) - placed[:, 2]
    return float(depth.max(initial=-np.inf))


def _refuse_depth(what: str, depth_mm: float) -> None:
    """Refuse a body that reaches into the lens by a depth, if that is positive."""
    if depth_mm > 0.0:
        raise SceneError(
            f"{what}.pose: it reaches {depth_mm:.4g} mm into the lens; give smaller shifts and tilts, or a larger "
            f"{what}.distance_mm"
        )
