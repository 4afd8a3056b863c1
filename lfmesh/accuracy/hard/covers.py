"""The sensor's cover glass at the limits of thickness, index and angle of incidence."""

import numpy as np

from lfmesh.accuracy.hard.outcome import (
    SINGLET,
    Outcome,
    case,
    disk,
    images_of,
    lens_scene,
    of_images,
    on_sensor,
    sensor_z,
    tilted,
)
from lfmesh.accuracy.hard.truth import Array, transmittance
from lfmesh.scene.objects.shapes import Plane
from lfmesh.scene.objects.targets import Material, Target
from lfmesh.transport.build import build
from lfmesh.transport.trace import trace

COUNT = 10_000
LEAST_RAD = 1e-3
"""Smallest grazing angle at a cover."""

START_MM = 5.0
"""Distance from the last vertex of the lens to the starts of rays."""


def _through(
    thickness: float, gap: float, index: float, directions: Array, *, outside: float = 1.0, distance: float = 40.0,
    tolerance: float = 1e-12, relative: float = 1e-12,
) -> Outcome:  # fmt: skip
    """Trace rays from behind the lens to the sensor through a cover with a thickness, a gap and an index.

    The index `outside` is that of the medium on both sides.
    """
    cover = {"thickness_mm": thickness, "gap_mm": gap, "index": index}
    scene = lens_scene(SINGLET, sensor_mm=1e13, distance=distance).changed(
        {"camera.sensor.cover": cover, "camera.image_medium": {"index": outside}}
    )
    index /= outside
    z = scene.camera.lens.vertices_mm[-1] + START_MM
    starts = np.column_stack([disk(5.0, COUNT, 3), np.full(COUNT, z)])
    paths = trace(build(scene), starts, directions, split="transmit")
    across, cosine = directions[:, :2], directions[:, 2]
    # From the sine, which keeps its digits for grazing rays.
    inside = np.sqrt(index**2 - np.square(across).sum(axis=1))
    air = sensor_z(scene) - z - thickness
    landing = starts[:, :2] + across * (air / cosine + thickness / inside)[:, None]
    share = transmittance(1.0, index, cosine, inside / index) * transmittance(index, 1.0, inside / index, cosine)
    truth = np.column_stack([landing, np.full(COUNT, sensor_z(scene))])
    return on_sensor(paths, truth, share, tolerance, relative=relative)


@case
def cover_of_air() -> Outcome:
    """Cross a cover of index 1, which has no effect."""
    return _through(2.0, 1.0, 1.0, tilted(COUNT, 1.0))


@case
def cover_of_index_4() -> Outcome:
    """Cross a cover of germanium's index."""
    return _through(2.0, 1.0, 4.0, tilted(COUNT, 1.0))


@case
def cover_of_air_in_oil() -> Outcome:
    """Cross a cover of air between oil, at angles up to total reflection."""
    # The tangent of the critical angle is 1.0206.
    return _through(2.0, 1.0, 1.0, tilted(COUNT, 1.02), outside=1.4, tolerance=1e-9, relative=1e-9)


@case
def cover_of_1_nm() -> Outcome:
    """Cross a cover of 1 nm, 1 nm in front of the sensor."""
    return _through(1e-6, 1e-6, 1.5, tilted(COUNT, 1.0))


@case
def cover_of_10_m() -> Outcome:
    """Cross a cover of 10 m."""
    return _through(1e4, 1.0, 1.5, tilted(COUNT, 1.0), distance=1.1e4, tolerance=1e-8)


@case
def grazing_a_cover() -> Outcome:
    """Graze a cover at angles down to a milliradian, and land far from the axis."""
    draw = np.random.default_rng(4)
    angle, phi = LEAST_RAD * 10.0 ** draw.uniform(0.0, 2.0, COUNT), draw.uniform(0.0, 2.0 * np.pi, COUNT)
    d = np.column_stack([np.cos(angle) * np.cos(phi), np.cos(angle) * np.sin(phi), np.sin(angle)])
    # Behind the plate the angle θ comes from a refraction near the critical angle. There, a rounding error ε of the
    # cosine inside becomes ε n² / θ; the ray lands gap / θ away from its exit point.
    index, gap, rounding = 1.5, 1.0, np.finfo(np.float64).eps * 1.5**2
    return _through(2.0, gap, index, d, tolerance=gap * rounding / LEAST_RAD**3, relative=rounding / LEAST_RAD**2)


@case
def tilted_behind_a_cover() -> Outcome:
    """Reflect light between a lens and the cover of a sensor tilted by up to 20 degrees."""
    glow = Target(
        shape=Plane(width_mm=2.0, height_mm=2.0), position_mm=(0.0, 0.0, -200.0),
        material=Material(reflectance=0.0, radiance_w_m2_sr=1.0),
    )  # fmt: skip
    cover = {"thickness_mm": 0.6, "gap_mm": 0.3, "index": 1.5}
    scene = lens_scene(SINGLET, sensor_mm=60.0, targets=(glow,)).changed(
        {"camera.sensor.cover": cover, "camera.sensor.pixels": (12, 12), "camera.sensor.pixel_mm": 5.0}
    )
    forward, adjoint = [], []
    for tilt in (0.0, 8.0, 20.0):
        stands = scene.changed({"camera.sensor.pose.tilt_deg": (tilt, 0.0, 0.0)})
        forward += images_of(stands, [1], method="forward", samples=64, split="transmit")
        adjoint += images_of(stands.changed({"camera.sensor.reflectance": 0.2}), [1], samples=1024)
    # With the same random numbers the sensor catches all of a small target's light at any tilt. The cover transmits as
    # much of it as on the axis, to 0.1 % up to these angles.
    light = np.array([image.mean.sum() for image in forward])
    off = float(np.abs(light / light[0] - 1.0).max())
    return of_images(
        [*forward, *adjoint], "each packet ends, and a tilted sensor has the light of the upright one to 0.1%",
        f"off by {off:.2%}", off < 1e-3,
    )  # fmt: skip
