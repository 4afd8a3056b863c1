"""Rigid moves between the frames of camera, array, objects, sensor and world."""

import numpy as np

from lfmesh.geometry import frame
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.scene import Camera, Scene
from lfmesh.transport.packets.packet import BACK_FRAME, CAMERA_FRAME, FRAMES, MLA_FRAME, OBJECT_FRAME, SENSOR_FRAME


def parts_in_camera(camera: Camera) -> tuple[dict[int, frame.Frame], frame.Frame]:
    """Return the frames of a camera's parts relative to the lens, and of the array's back relative to the array.

    Parameters
    ----------
    camera : Camera
        Solved.
    """
    face = camera.lens.vertices_mm[-1]
    array_to_camera = back_to_camera = back_to_array = frame.IDENTITY
    if camera.mla is not None:
        mla = camera.mla
        face += mla.distance_mm or 0.0
        placed = frame.frame(mla.pose.tilt_deg, np.add([0.0, 0.0, face], mla.pose.shift_mm))
        shift = mla.back.decenter_mm if mla.back is not None else (0.0, 0.0)
        # The shifted face is the one described by `back`; the array's frame may start from it.
        starts_from_back = mla.frame_side != mla.curved_side
        turned = frame.IDENTITY
        if mla.frame_side == "sensor":
            at = shift if starts_from_back else (0.0, 0.0)
            turned = np.column_stack([np.diag([1.0, 1.0, -1.0]), [*at, mla.thickness_mm]])
        array_to_camera = frame.compose(placed, turned)
        other = np.multiply(-1.0 if starts_from_back else 1.0, shift)
        back_to_array = np.column_stack([np.diag([1.0, 1.0, -1.0]), [*other, mla.thickness_mm]])
        back_to_camera = frame.compose(array_to_camera, back_to_array)
        face += mla.thickness_mm
    sensor = camera.sensor
    face += sensor.distance_mm or 0.0
    sensor_to_camera = frame.frame(sensor.pose.tilt_deg, np.add([0.0, 0.0, face], sensor.pose.shift_mm))
    parts = {
        CAMERA_FRAME: frame.IDENTITY, MLA_FRAME: array_to_camera, BACK_FRAME: back_to_camera,
        SENSOR_FRAME: sensor_to_camera,
    }  # fmt: skip
    return parts, back_to_array


def frame_table(scene: Scene, middle: Array) -> Array:
    """Return the moves between all frames, (6, 6, 3, 4): [a, b] transforms points from frame a to frame b.

    Parameters
    ----------
    scene : Scene
    middle : (3,) float64, mm, world frame
        Origin of the object frame.
    """
    camera = scene.camera
    to_world = [frame.IDENTITY] * FRAMES
    to_world[CAMERA_FRAME] = frame.frame(camera.pose.tilt_deg, camera.pose.shift_mm)
    to_world[OBJECT_FRAME] = frame.frame(origin_mm=middle)
    # Moves between parts of the camera bypass the world frame: its origin may be so far away that digits are lost.
    to_camera, back_to_array = parts_in_camera(camera)
    moves = np.empty((FRAMES, FRAMES, 3, 4))
    for here in range(FRAMES):
        if here in to_camera:
            to_world[here] = frame.compose(to_world[CAMERA_FRAME], to_camera[here])
    for here in range(FRAMES):
        for there in range(FRAMES):
            if here in to_camera and there in to_camera:
                moves[here, there] = frame.compose(frame.inverse(to_camera[there]), to_camera[here])
            else:
                moves[here, there] = frame.compose(frame.inverse(to_world[there]), to_world[here])
    # Exact, as rays move to and fro between the two faces of the array.
    moves[BACK_FRAME, MLA_FRAME], moves[MLA_FRAME, BACK_FRAME] = back_to_array, frame.inverse(back_to_array)
    return moves
