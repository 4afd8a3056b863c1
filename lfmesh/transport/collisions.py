"""Refuse cameras whose lens, array and sensor intersect, as poses may make them.

Light would end between them, and the picture be black without a message.
"""

import numpy as np

from lfmesh.errors import SceneError
from lfmesh.geometry import frame
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.surfaces.surface import is_revolved
from lfmesh.geometry.surfaces.tessellation import on_circles
from lfmesh.scene import Scene
from lfmesh.transport.packets.packet import CAMERA_FRAME, MLA_FRAME, SENSOR_FRAME
from lfmesh.transport.tables.tables import LensTables, MlaTables

CIRCLES = 65
"""Circles of a posed last surface that a body behind it must stay clear of."""


def refuse_collisions(scene: Scene, lens: LensTables, mla: MlaTables, moves: Array) -> None:
    """Refuse a camera whose sensor, array and lens intersect.

    Parameters
    ----------
    scene : Scene
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
        _refuse_in_lens("camera.mla", lens, frame.points(moves[MLA_FRAME, CAMERA_FRAME], slab))
    else:
        _refuse_in_lens("camera.sensor", lens, frame.points(moves[SENSOR_FRAME, CAMERA_FRAME], sensor))


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


def _refuse_in_lens(what: str, lens: LensTables, corners: Array) -> None:
    """Refuse a body whose corners (n, 3) (camera frame) reach back to the lens."""
    last = lens.surfaces[-1]
    # A body smaller than a concave last surface may reach into the hollow of that surface.
    beyond_rim = np.hypot(corners[:, 0], corners[:, 1]).max() >= last["semi_diameter"]
    end = last["vertex_z"]
    if last["posed"] or not is_revolved(last):
        circles = on_circles(last, np.linspace(0.0, float(last["semi_diameter"]), CIRCLES)).reshape(-1, 3)
        across = np.hypot(circles[:, 0], circles[:, 1]) <= np.hypot(corners[:, 0], corners[:, 1]).max()
        end = circles[across, 2].max(initial=-np.inf)
    gap = corners[:, 2].min() - (lens.box_high[2] if beyond_rim else end)
    if gap < 0.0:
        raise SceneError(
            f"{what}.pose: it reaches {-gap:.4g} mm into the lens; give smaller shifts and tilts, or a larger "
            f"{what}.distance_mm"
        )
