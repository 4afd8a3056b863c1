"""The main lens by itself: real rays through it to the plane of the array, and their focus."""

import math
from functools import lru_cache

import numpy as np

from lfmesh.geometry.lens.main_order import with_main_orders
from lfmesh.geometry.lens.solved_camera import SolvedCamera, solved_camera
from lfmesh.scene import FirstOrder, Scene
from lfmesh.transport.build import build
from lfmesh.transport.trace import Status, trace
from lfmesh.transport.world import World

FAN = 64
"""Rays for the focus, one per ring of equal area in the paraxial stop."""

FAR = 1e3
"""Substitute for infinity, in focal lengths, for a camera focused at or beyond infinity."""

ASIDE = 0.2
"""Relative offset of the test objects before and behind the plane in focus, if vergences give none."""

NEARER = 0.1
"""Vergence of the nearer test object: this fraction of the way from the plane in focus to the front focal point."""


def lens_alone(scene: Scene) -> World:
    """Build only the main lens, with a wide plane in place of the array, in the camera frame.

    Diffractive faces send the light of their main order alone.
    """
    mla, sensor = scene.camera.mla, scene.camera.sensor
    assert mla is not None
    assert mla.distance_mm is not None
    # Wide enough to catch everything that leaves the lens towards the array.
    wide = 100.0 * (max(mla.size_mm) + max(sensor.size_mm) + mla.distance_mm)
    alone = scene.camera_alone(
        {
            "camera.pose": {},
            "camera.mla": None,
            "camera.sensor": {"pixels": (2, 2), "pixel_mm": wide, "distance_mm": mla.distance_mm},
            "transport.engine": "auto",
        }
    )
    return _built(solved_camera(with_main_orders(alone)))


@lru_cache(maxsize=4)
def _built(camera: SolvedCamera) -> World:
    return build(camera.scene)


def focus_shift(scene: Scene) -> tuple[float, float]:
    """Return the axial distance from the paraxial image of an axial point to its sharpest image by real rays.

    The sharpest image has the smallest rms radius of a bundle that fills the aperture. It is found for one object on
    each side of the plane in focus, and linear in the inverse distance between.

    Parameters
    ----------
    scene : Scene
        Solved, with a microlens array; elements given as meshes measured.

    Returns
    -------
    shift : float, mm
        For a distant object.
    slope : float, mm²
        Added after division by the object's distance from the front principal plane.
    """
    return _focus_shift(solved_camera(scene))


@lru_cache(maxsize=8)
def _focus_shift(camera: SolvedCamera) -> tuple[float, float]:
    facts = camera.report
    principal_z = facts.front_principal_plane_z_mm
    distances = _probed_mm(facts)
    world = lens_alone(camera.scene)
    at_near, at_far = (_focus_shift_mm(camera, world, distance) for distance in distances)
    near, far = (1.0 / (distance + principal_z) for distance in distances)
    slope = (at_near - at_far) / (near - far)
    return at_far - slope * far, slope


def _probed_mm(facts: FirstOrder) -> tuple[float, float]:
    """Return the distances of two objects before the first vertex, on both sides of the plane in focus.

    They are chosen by vergence from the principal plane or, for relays with a remote principal plane, around the plane
    in focus.
    """
    principal_z, focus = facts.front_principal_plane_z_mm, facts.object_distance_mm
    in_focus, focal = 1.0 / (focus + principal_z), facts.object_index * facts.efl_mm
    if focal > 0.0 and not 1.0 / (FAR * focal) < in_focus < 1.0 / focal:
        in_focus = 1.0 / (FAR * focal)
        focus = 1.0 / in_focus - principal_z
    near = 1.0 / ((1.0 - NEARER) * in_focus + NEARER / focal) - principal_z
    far = 2.0 / in_focus - principal_z
    if abs(principal_z) < focus and 0.0 < near < focus < far:
        return near, far
    return (1.0 - ASIDE) * focus, focus / (1.0 - ASIDE)


def _focus_shift_mm(camera: SolvedCamera, world: World, distance_mm: float) -> float:
    """Return the focus shift for a point on the axis, by rays through rings of equal area in the stop."""
    facts, lens, paraxial = camera.report, camera.scene.camera.lens, camera.paraxial
    # Slope of the ray to the edge of the stop, finite even for an entrance pupil at infinity.
    stop_radius = lens.surfaces[paraxial.stop].semi_diameter_mm or 1.0
    steepest = paraxial.marginal_ray(distance_mm, stop_radius).angle / paraxial.indices[0]
    # A lens without a real image has no focus; one of negative focal length may be a relay.
    front_focus = -facts.ffl_mm
    if not math.isfinite(steepest) or (facts.efl_mm < 0.0 and not 0.0 < distance_mm < front_focus):
        return 0.0
    share = np.sqrt((np.arange(FAN) + 0.5) / FAN)
    toward = np.column_stack([steepest * share, np.zeros(FAN), np.ones(FAN)])
    # Start close before the lens: the object may be far, and rays are only as exact as their start.
    ahead = max(distance_mm - abs(facts.efl_mm), 0.5 * distance_mm)
    start = np.array([0.0, 0.0, -distance_mm]) + toward * ahead
    paths = trace(world, start, toward, facts.wavelength_nm, split="transmit")
    arrived = paths.status == Status.SENSOR
    x, z = paths.position[arrived, 0], paths.position[arrived, 2]
    slope = paths.direction[arrived, 0] / paths.direction[arrived, 2]
    if not slope.any():
        return 0.0
    sharpest = float(z[0] - (x * slope).sum() / (slope * slope).sum())
    return sharpest - lens.vertices_mm[-1] - paraxial.image_mm(distance_mm)
