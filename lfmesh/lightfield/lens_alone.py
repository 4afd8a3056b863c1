"""The main lens by itself: real rays through it to the plane of the array, and where they focus."""

import math
from functools import lru_cache

import numpy as np

from lfmesh.scene import Paraxial, Scene, first_order
from lfmesh.transport.trace import Status, trace
from lfmesh.transport.world import World, build

FAN = 64
"""Rays that the focus is found by, at the radii of as many rings of equal area in the entrance pupil."""

FAR = 1e3
"""In focal lengths: stands for infinity, where a camera is focused on that or beyond."""

NEARER = 0.1
"""The nearer object lies this share of the way from the plane in focus to the front focal point, by vergence."""


def lens_alone(scene: Scene) -> World:
    """Build the lens with a plane where the array stands, in its own camera frame and with nothing to look at."""
    mla, sensor = scene.camera.mla, scene.camera.sensor
    assert mla is not None
    assert mla.distance_mm is not None
    # So wide that whatever leaves the lens towards the array meets it.
    wide = 100.0 * (max(mla.size_mm) + max(sensor.size_mm) + mla.distance_mm)
    return build(
        scene.changed(
            {
                "targets": (),
                "lights": (),
                "camera.pose": {},
                "camera.mla": None,
                "camera.sensor": {"pixels": (2, 2), "pixel_mm": wide, "distance_mm": mla.distance_mm},
                "transport.engine": "auto",
            }
        )
    )


@lru_cache(maxsize=8)
def focus_shift(scene: Scene) -> tuple[float, float]:
    """Return how far from its paraxial image a point of the axis is imaged most sharply, by real rays.

    Where a bundle that fills the aperture has its smallest rms radius, from the paraxial image along z, for objects
    nearer and farther than the plane in focus; between them it goes as the inverse distance.

    Parameters
    ----------
    scene : Scene
        Solved, with a microlens array; elements given as meshes measured.

    Returns
    -------
    shift : float, mm
        For a distant object.
    slope : float, mm²
        Over the object's distance from the front principal plane: added.
    """
    facts = first_order(scene)
    in_focus = 1.0 / (facts.object_distance_mm + facts.front_principal_plane_z_mm)
    if not 1.0 / (FAR * facts.efl_mm) < in_focus < 1.0 / facts.efl_mm:
        in_focus = 1.0 / (FAR * facts.efl_mm)
    near, far = (1.0 - NEARER) * in_focus + NEARER / facts.efl_mm, 0.5 * in_focus
    world = lens_alone(scene)
    at_near, at_far = (
        _focus_shift_mm(scene, world, 1.0 / vergence - facts.front_principal_plane_z_mm) for vergence in (near, far)
    )
    slope = (at_near - at_far) / (near - far)
    return at_far - slope * far, slope


def _focus_shift_mm(scene: Scene, world: World, distance_mm: float) -> float:
    """Return the shift of the sharpest image of a point of the axis, from rings of equal area in the entrance pupil."""
    facts, lens = first_order(scene), scene.camera.lens
    pupil_z, pupil_radius = facts.entrance_pupil_z_mm, 0.5 * facts.entrance_pupil_diameter_mm
    if not math.isfinite(pupil_z) or facts.efl_mm < 0.0:
        return 0.0
    ring = pupil_radius * np.sqrt((np.arange(FAN) + 0.5) / FAN)
    toward = np.column_stack([ring, np.zeros(FAN), np.full(FAN, pupil_z + distance_mm)])
    # From close before the lens: the object may be far, and rays are as exact as the place they start from.
    ahead = max(distance_mm - facts.efl_mm, 0.5 * distance_mm)
    start = np.array([0.0, 0.0, -distance_mm]) + toward * (ahead / toward[:, 2:])
    paths = trace(world, start, toward, scene.transport.primary_nm, split="transmit")
    arrived = paths.status == Status.SENSOR
    x, z = paths.position[arrived, 0], paths.position[arrived, 2]
    slope = paths.direction[arrived, 0] / paths.direction[arrived, 2]
    if not slope.any():
        return 0.0
    sharpest = float(z[0] - (x * slope).sum() / (slope * slope).sum())
    paraxial = Paraxial.of(lens, scene.transport.primary_nm).image_mm(distance_mm)
    return sharpest - lens.vertices_mm[-1] - paraxial
