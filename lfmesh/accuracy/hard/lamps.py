"""Lamps that shine onto a rough surface of the camera from the smallest and largest distances."""

from collections.abc import Sequence

import numpy as np

from lfmesh.accuracy.hard.outcome import Outcome, case
from lfmesh.accuracy.hard.truth import Array
from lfmesh.scene import Camera, Lens, Light, Scene, Sensor, Surface, Target
from lfmesh.scene.light.lights import LineLight, PointLight
from lfmesh.scene.objects.shapes import Plane
from lfmesh.scene.objects.targets import Material
from lfmesh.transport.build import build
from lfmesh.transport.render.render import Renderer

DISTANCES_MM = (1e-9, 1e-4, 0.1, 1.0, 100.0, 1e5)
APERTURE_MM, TO_SENSOR_MM, WINDOW_MM, SENSOR_MM = 6.0, 5.0, 1.0, 4.0
ALMOST_AIR = 1.0 + 1e-9
"""Index of a window that neither reflects nor refracts, but scatters at its front."""

SAMPLES, REPLICATES = 2048, 16
MOST_SIGMAS, LARGEST_SIGMA = 4.0, 0.015


TUBE_MM = 10.0


def _scene(lamp: Light, samples: int) -> Scene:
    """Return a lamp in front of an opal window, with the sensor close behind."""
    window = (
        Surface(
            thickness_mm=WINDOW_MM, index=ALMOST_AIR, semi_diameter_mm=APERTURE_MM, finish="diffuse", stop=True
        ),
        Surface(semi_diameter_mm=4.0 * APERTURE_MM),
    )  # fmt: skip
    sensor = Sensor(pixels=(8, 8), pixel_mm=SENSOR_MM / 8, distance_mm=TO_SENSOR_MM - WINDOW_MM)
    black = Target(
        shape=Plane(width_mm=1.0, height_mm=1.0), position_mm=(0.0, 0.0, -2e5), material=Material(reflectance=0.0)
    )
    return Scene(
        camera=Camera(lens=Lens(surfaces=window), sensor=sensor),
        targets=(black,),
        lights=(lamp,),
    ).changed({"transport.samples": samples, "transport.replicates": REPLICATES})


def _expected(distance_mm: float) -> float:
    """Return the power on the sensor by quadrature: each ring of the window scatters its light evenly."""
    widest = 0.5 * np.arctan2(APERTURE_MM, distance_mm)
    angles = widest * (NODES + 1.0)
    return _on_sensor(widest * WEIGHTS * 0.5 * np.sin(angles), distance_mm * np.tan(angles))


def _expected_of_tube(distance_mm: float) -> float:
    """Return the power on the sensor from a tube along the axis that starts at a distance.

    Its irradiance at a radius ρ is the largest intensity over the length, times ∫ sin θ cos θ / r² along it. The
    integral is ρ/2 (1 / (ρ² + a²) − 1 / (ρ² + b²)), with a and b the distances of the ends.
    """
    near, far = distance_mm, distance_mm + TUBE_MM
    # In pieces that grow with the radius, from well inside the near end's distance.
    edges = np.concatenate([[0.0], np.geomspace(min(1e-3 * near, 1e-3), APERTURE_MM, 24)])
    half = 0.5 * np.diff(edges)[:, None]
    radii = (edges[:-1, None] + half * (NODES + 1.0)).ravel()
    # 1 / (ρ² + a²) − 1 / (ρ² + b²), without cancellation far away.
    apart = TUBE_MM * (near + far) / ((radii**2 + near**2) * (radii**2 + far**2))
    return _on_sensor((half * WEIGHTS).ravel() * radii**2 * apart / (np.pi * TUBE_MM), radii)


NODES, WEIGHTS = np.polynomial.legendre.leggauss(48)


def _on_sensor(rings: Array, radii: Array) -> float:
    """Return the power on the sensor from rings of the window with given powers, W, and radii, mm."""
    half = 0.5 * SENSOR_MM
    x, y = np.meshgrid(half * NODES, half * NODES)
    areas = half * half * np.outer(WEIGHTS, WEIGHTS)
    phi = 2.0 * np.pi * (np.arange(32) + 0.5) / 32
    total = 0.0
    for ring, radius in zip(rings, radii, strict=True):
        to2 = (
            TO_SENSOR_MM**2
            + (x - radius * np.cos(phi)[:, None, None]) ** 2
            + (y - radius * np.sin(phi)[:, None, None]) ** 2
        )
        total += ring * (TO_SENSOR_MM**2 / (np.pi * to2**2) * areas).sum() / len(phi)
    return float(total)


@case
def lamps_at_an_opal_front() -> Outcome:
    """Illuminate a scattering window by a lamp 1 pm to 100 m in front of it."""
    lamps = [PointLight(position_mm=(0.0, 0.0, -distance), power_w=1.0) for distance in DISTANCES_MM]
    return _outcome(lamps, [_expected(distance) for distance in DISTANCES_MM])


@case
def tubes_at_an_opal_front() -> Outcome:
    """Illuminate a scattering window by an axial tube of 10 mm that ends 1 pm to 100 m in front of it."""
    lamps = [
        LineLight(start_mm=(0.0, 0.0, -distance), end_mm=(0.0, 0.0, -distance - TUBE_MM), power_w=1.0)
        for distance in DISTANCES_MM
    ]
    return _outcome(lamps, [_expected_of_tube(distance) for distance in DISTANCES_MM], 3 * SAMPLES)


def _outcome(lamps: Sequence[Light], expected: list[float], samples: int = SAMPLES) -> Outcome:
    """Compare the light of each lamp on the sensor with the expected power."""
    found, errors, lost = [], [], 0.0
    for lamp in lamps:
        image = Renderer(build(_scene(lamp, samples))).image()
        found.append(float(image.mean.sum()))
        errors.append(float(np.sqrt((image.stderr**2).sum())))
        lost = max(lost, image.ledger.lost_share)
    sigmas = np.array(errors) / expected
    off = np.abs(np.array(found) / expected - 1.0) / sigmas
    passed = bool((off < MOST_SIGMAS).all() and (sigmas < LARGEST_SIGMA).all())
    return Outcome(
        "", f"the integral over the window within {MOST_SIGMAS:g} σ, σ below {LARGEST_SIGMA:.1%}",
        f"off by {off.max():.1f} σ at most, σ = {sigmas.max():.1%}", passed, lost, float(len(found)), 0,
    )  # fmt: skip
