"""Orientation of the image on the sensor, by first-order optics."""

import numpy as np

from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.scene import Scene
from lfmesh.scene.first_order.relay import relay_of
from lfmesh.scene.first_order.solve import image_plane_mm


def image_inverts(scene: Scene) -> bool:
    """Tell whether a scene's lens images upside down onto array or sensor, as all but relays do.

    By the plane in focus or, if it is at infinity or virtual, by chief rays of distant objects. A single
    gradient-index rod before the sensor counts as a part of the lens.

    Parameters
    ----------
    scene : Scene
    """
    camera = solved_camera(scene)
    lens = camera.paraxial
    image = image_plane_mm(camera.scene.camera, camera.scene.primary_nm)
    relay = relay_of(camera.scene.camera, camera.scene.primary_nm)
    behind = 1.0 if relay is None else relay.magnification
    distance = lens.object_mm(image)
    if 0.0 < distance < np.inf:
        return lens.magnification(distance) * behind < 0.0
    # A rising chief ray comes from a distant object at negative height.
    return lens.chief_scale_mm(np.inf, image) * behind < 0.0
