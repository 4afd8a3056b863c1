"""The sensor's cover glass at the limits of its thickness, its index and the angle of incidence."""

import numpy as np

from lfmesh.accuracy.hard.outcome import (
    SINGLET,
    Outcome,
    case,
    disk,
    lens_scene,
    on_sensor,
    sensor_z,
    tilted,
)
from lfmesh.accuracy.hard.truth import Array, transmittance
from lfmesh.scene import Material, Plane, Scene, Target
from lfmesh.transport.render.render import render
from lfmesh.transport.trace import trace
from lfmesh.transport.world import build

COUNT = 10_000
LEAST_RAD = 1e-3
"""The smallest angle at which a ray grazes a cover."""

START_MM = 5.0
"""From the last vertex of the lens to where rays start."""


def _through(
    thickness: float, gap: float, index: float, directions: Array, *, distance: float = 40.0,
    tolerance: float = 1e-12, relative: float = 1e-12,
) -> Outcome:  # fmt: skip
    """Trace rays from behind the lens through a cover of a thickness, a gap behind it and an index onto the sensor."""
    cover = {"thickness_mm": thickness, "gap_mm": gap, "index": index}
    scene = lens_scene(SINGLET, sensor_mm=1e13, distance=distance).changed({"camera.sensor.cover": cover})
    z = scene.camera.lens.vertices_mm[-1] + START_MM
    starts = np.column_stack([disk(5.0, COUNT, 3), np.full(COUNT, z)])
    paths = trace(build(scene), starts, directions, split="transmit")
    across, cosine = directions[:, :2], directions[:, 2]
    # From the sine: of rays that graze the plate the root of the other cosine loses nothing.
    inside = np.sqrt(index**2 - np.square(across).sum(axis=1))
    air = sensor_z(scene) - z - thickness
    landing = starts[:, :2] + across * (air / cosine + thickness / inside)[:, None]
    share = transmittance(1.0, index, cosine, inside / index) * transmittance(index, 1.0, inside / index, cosine)
    truth = np.column_stack([landing, np.full(COUNT, sensor_z(scene))])
    return on_sensor(paths, truth, share, tolerance, relative=relative)


@case
def cover_of_air() -> Outcome:
    """Pass a cover of index 1, which is none."""
    return _through(2.0, 1.0, 1.0, tilted(COUNT, 1.0))


@case
def cover_of_index_4() -> Outcome:
    """Pass a cover of germanium's index."""
    return _through(2.0, 1.0, 4.0, tilted(COUNT, 1.0))


@case
def cover_of_1_nm() -> Outcome:
    """Pass a cover of 1 nm that lies 1 nm before the sensor."""
    return _through(1e-6, 1e-6, 1.5, tilted(COUNT, 1.0))


@case
def cover_of_10_m() -> Outcome:
    """Pass a cover of 10 m."""
    return _through(1e4, 1.0, 1.5, tilted(COUNT, 1.0), distance=1.1e4, tolerance=1e-8)


@case
def grazing_a_cover() -> Outcome:
    """Graze a cover, down to a milliradian, and land far from the axis."""
    draw = np.random.default_rng(4)
    angle, phi = LEAST_RAD * 10.0 ** draw.uniform(0.0, 2.0, COUNT), draw.uniform(0.0, 2.0 * np.pi, COUNT)
    d = np.column_stack([np.cos(angle) * np.cos(phi), np.cos(angle) * np.sin(phi), np.sin(angle)])
    # Behind the plate the angle θ comes from a refraction near the critical angle, where a rounding error ε of the
    # cosine inside makes one of ε n² / θ; the landing is gap / θ away from where the ray leaves the plate.
    index, gap, rounding = 1.5, 1.0, np.finfo(np.float64).eps * 1.5**2
    return _through(2.0, gap, index, d, tolerance=gap * rounding / LEAST_RAD**3, relative=rounding / LEAST_RAD**2)


CLOSE_MM = 1e-3
"""Thickness of a cover and of its gap through which the pupil looks as large by every path."""

REFLECTS, STOP_MM = 0.999, 0.5


def _wall(index: float) -> Scene:
    """Return an evenly bright wall before a lens that reflects nothing, and a mirror with pixels behind a cover."""
    wall = Target(
        shape=Plane(width_mm=2e3, height_mm=2e3), position_mm=(0.0, 0.0, -500.0),
        material=Material(reflectance=0.0, radiance_w_m2_sr=1.0),
    )  # fmt: skip
    bare = [
        surface.model_dump(exclude_unset=True) | {"coating": "clear", "semi_diameter_mm": STOP_MM}
        for surface in SINGLET
    ]
    changes = {
        "coatings": {"clear": {"reflectance": 0.0}},
        "camera.lens.surfaces": bare,
        "camera.sensor.cover": {"thickness_mm": CLOSE_MM, "gap_mm": CLOSE_MM, "index": index},
        "camera.sensor.reflectance": REFLECTS,
        "transport": {"samples": 256, "replicates": 16, "wavelengths_nm": [587.6]},
    }
    return lens_scene(SINGLET, sensor_mm=4.0, distance=45.0, targets=(wall,)).changed(changes)


@case
def sensor_that_detects_a_thousandth() -> Outcome:
    """See a wall by a sensor that reflects 0.999 behind a cover of germanium's index, through a small stop."""
    index = 4.0
    scene = _wall(index)
    image, path = render(scene), render(scene.changed({"transport.split": "transmit"}))
    found = float(image.mean.sum() / path.mean.sum())
    error = found * float(np.sqrt((image.stderr**2).sum()) / image.mean.sum())
    # Incoherent plate: what all paths bring over the image path, that is refracted twice and detected at once.
    once = ((index - 1.0) / (index + 1.0)) ** 2
    through, back = (1.0 - once) / (1.0 + once), 2.0 * once / (1.0 + once)
    expected = through / (1.0 - REFLECTS * back) / (1.0 - once) ** 2
    return Outcome(
        "", f"{expected:.4f} times the image path", f"{found:.4f} ± {error:.4f}",
        abs(found - expected) < 4.0 * error and error < 0.02 * expected, 0.0, float(path.mean.sum()), 0,
    )  # fmt: skip
