"""The rigid moves between the frames of camera, array, objects, sensor and world."""

import numpy as np

from lfmesh.geometry import frame
from lfmesh.geometry.mesh import Array
from lfmesh.scene import Scene
from lfmesh.transport.packets.packet import CAMERA_FRAME, MLA_FRAME, OBJECT_FRAME, SENSOR_FRAME


def frame_table(scene: Scene, middle: Array) -> Array:
    """Return the moves between all frames, (5, 5, 3, 4): [a, b] takes points of frame a into frame b.

    Parameters
    ----------
    scene : Scene
    middle : (3,) float64, mm, world frame
        Origin of the object frame.
    """
    camera = scene.camera
    to_world = [frame.IDENTITY] * 5
    to_world[CAMERA_FRAME] = frame.frame(camera.pose.tilt_deg, camera.pose.shift_mm)
    to_world[OBJECT_FRAME] = frame.frame(origin_mm=middle)
    face = camera.lens.vertices_mm[-1]
    array_to_camera = frame.IDENTITY
    if camera.mla is not None:
        mla = camera.mla
        face += mla.distance_mm or 0.0
        placed = frame.frame(mla.pose.tilt_deg, np.add([0.0, 0.0, face], mla.pose.shift_mm))
        turned = frame.IDENTITY
        if mla.curved_side == "sensor":
            turned = np.column_stack([np.diag([1.0, 1.0, -1.0]), [0.0, 0.0, mla.thickness_mm]])
        array_to_camera = frame.compose(placed, turned)
        face += mla.thickness_mm
    sensor = camera.sensor
    face += sensor.distance_mm or 0.0
    sensor_to_camera = frame.frame(sensor.pose.tilt_deg, np.add([0.0, 0.0, face], sensor.pose.shift_mm))
    # Moves between parts of the camera bypass the world frame, whose origin may be so far away that digits are lost.
    to_camera = {CAMERA_FRAME: frame.IDENTITY, MLA_FRAME: array_to_camera, SENSOR_FRAME: sensor_to_camera}
    moves = np.empty((5, 5, 3, 4))
    for here in range(5):
        if here in to_camera:
            to_world[here] = frame.compose(to_world[CAMERA_FRAME], to_camera[here])
    for here in range(5):
        for there in range(5):
            if here in to_camera and there in to_camera:
                moves[here, there] = frame.compose(frame.inverse(to_camera[there]), to_camera[here])
            else:
                moves[here, there] = frame.compose(frame.inverse(to_world[there]), to_world[here])
    return moves
