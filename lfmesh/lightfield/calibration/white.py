"""The white image: raw image of a uniform Lambertian plane that fills the field of the same camera."""

from collections.abc import Callable

import numpy as np

from lfmesh.errors import LfmeshError
from lfmesh.geometry import frame as frames
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.scene import Camera, Scene
from lfmesh.transport.render.image import Image
from lfmesh.transport.render.progress import Progress
from lfmesh.transport.render.render import render

RADIANCE = 1.0
"""Radiance of the plane, W/(m² sr); a raw image divided by the white one is then a radiance."""

WIDTH_OVER_DISTANCE = 12.0
"""Width of the plane over its distance; it catches rays up to 80° from the axis."""

FOCAL_LENGTHS_AWAY = 10.0
"""Distance of the plane; a uniform plane looks the same from anywhere."""


def white_scene(scene: Scene) -> Scene:
    """Return a scene with the same camera and transport, and a glowing plane as its only object.

    It is always traced from the sensor, as hardly any of the plane's light would find the lens.

    Parameters
    ----------
    scene : Scene

    Raises
    ------
    SceneError
        As from `solved_camera`.
    """
    camera = solved_camera(scene)
    scene = camera.scene
    # For afocal lenses, without a focal length to scale by.
    distance = FOCAL_LENGTHS_AWAY * min(abs(camera.report.efl_mm), 100.0 * max(scene.camera.sensor.size_mm))
    pose = scene.camera.pose
    (place,) = frames.points(frames.frame(pose.tilt_deg, pose.shift_mm), np.array([[0.0, 0.0, -distance]]))
    width = WIDTH_OVER_DISTANCE * distance
    plane = {
        "name": "white",
        "shape": {"kind": "plane", "width_mm": width, "height_mm": width},
        "position_mm": tuple(place.tolist()),
        "rotation_deg": pose.tilt_deg,
        "material": {"reflectance": 0.0, "radiance_w_m2_sr": RADIANCE},
    }
    return scene.camera_alone(
        {
            "name": f"{scene.name}, white".lstrip(", "),
            "targets": (plane,),
            "transport.method": "adjoint",
        }
    )


def refuse_other_white(white: Image, image: Image, camera: Camera) -> None:
    """Refuse a white image that does not belong to a raw image.

    Parameters
    ----------
    white, image : Image
    camera : Camera
        The raw image's, solved.

    Raises
    ------
    LfmeshError
        The white image has other pixels or wavelengths, or another camera.
    """
    if white.mean.shape != image.mean.shape or white.wavelengths_nm != image.wavelengths_nm:
        raise LfmeshError(
            f"the white image has the shape {white.mean.shape} at {list(white.wavelengths_nm)} nm, the raw image "
            f"{image.mean.shape} at {list(image.wavelengths_nm)} nm; render the white image of the same scene"
        )
    # The white image of a moving camera is of the camera at rest.
    at_rest = {"motion": None}
    if solved_camera(white.scene).scene.camera.model_copy(update=at_rest) != camera.model_copy(update=at_rest):
        raise LfmeshError("the white image is of another camera; render the white image of the same scene")


def white_image(scene: Scene, progress: Callable[[Progress], None] | bool | None = None) -> Image:
    """Render the white image of a scene's camera, with the scene's transport settings.

    Parameters
    ----------
    scene : Scene
    progress : callable or bool, optional
        As for `lf.render`.

    Returns
    -------
    Image
        With the scene of the white plane.

    Raises
    ------
    LfmeshError
        The scene cannot be built.
    """
    return render(white_scene(scene), progress)
