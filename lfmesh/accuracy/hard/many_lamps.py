"""Thousands of lamps with very unequal powers, near and far, in front of and behind a patch."""

import numpy as np

from lfmesh.accuracy.hard.outcome import MOST_SIGMAS, Outcome, case, images_of, surfaces_of
from lfmesh.accuracy.hard.truth import Array
from lfmesh.scene import Camera, Lens, Scene, Sensor, Target
from lfmesh.scene.light.lights import PointLight
from lfmesh.scene.objects.shapes import Plane
from lfmesh.scene.objects.targets import Material

LAMPS = 3000
HALF_MM, AWAY_MM = 1.0, 60.0
DECADES = 8.0
"""Range of the lamps' powers at equal distances."""

REFLECTANCE = 0.8
SEEDS = 16
LARGEST_SIGMA = 0.01


def _lamps(nearest: float, farthest: float) -> tuple[Array, Array]:
    """Return positions (n, 3) from the patch's centre, mm, and powers (n,), W; every third lamp is behind the patch."""
    random = np.random.default_rng(64)
    distance = np.exp(random.uniform(np.log(nearest), np.log(farthest), LAMPS))
    cosine, phi = random.uniform(0.1, 1.0, LAMPS), random.uniform(0.0, 2.0 * np.pi, LAMPS)
    cosine[::3] *= -1.0
    sine = np.sqrt(1.0 - cosine**2)
    places = distance[:, None] * np.column_stack([sine * np.cos(phi), sine * np.sin(phi), cosine])
    return places, distance**2 * 10.0 ** random.uniform(-DECADES, 0.0, LAMPS)


def _onto_patch(places: Array, powers: Array) -> float:
    """Return the power from lamps on the patch, W: for each, the solid angle of a rectangle over 4 π."""
    x, y, z = places[places[:, 2] > 0.0].T
    solid = np.zeros(len(x))
    for a, one in ((HALF_MM - x, 1.0), (-HALF_MM - x, -1.0)):
        for b, other in ((HALF_MM - y, 1.0), (-HALF_MM - y, -1.0)):
            solid += one * other * np.arctan2(a * b, z * np.sqrt(a * a + b * b + z * z))
    return float((powers[places[:, 2] > 0.0] * solid).sum() / (4.0 * np.pi))


def _powers(lamps: tuple[PointLight, ...], **material: float) -> Array:
    """Return the power of images of the patch for some seeds, W (SEEDS,)."""
    lens = surfaces_of(((20.0, 3.0, 1.5), (-20.0, 0.0, 1.0)), aperture=2.0)
    patch = Target(
        shape=Plane(width_mm=2.0 * HALF_MM, height_mm=2.0 * HALF_MM),
        position_mm=(0.0, 0.0, -AWAY_MM), material=Material(**material),
    )  # fmt: skip
    scene = Scene(
        camera=Camera(focus_mm=AWAY_MM, lens=Lens(surfaces=tuple(lens)), sensor=Sensor(pixels=(12, 12), pixel_mm=0.1)),
        targets=(patch,),
        lights=lamps,
    ).changed({"transport.samples": 128, "transport.replicates": 1, "transport.split": "transmit"})
    return np.array([image.mean.sum() for image in images_of(scene, range(SEEDS))])


def _lit(places: Array, powers: Array) -> Outcome:
    """Compare the light from lamps on the patch with the solid angles that it subtends."""
    # Exclude lamps inside the camera, or hidden from the patch by it.
    free = (np.hypot(places[:, 0], places[:, 1]) > 0.2 * places[:, 2]) | (places[:, 2] < 0.8 * AWAY_MM)
    places, powers = places[free], powers[free]
    lamps = tuple(
        PointLight(position_mm=(x, y, z - AWAY_MM), power_w=power)
        for (x, y, z), power in zip(places.tolist(), powers.tolist(), strict=True)
    )
    glow = _powers((), reflectance=0.0, radiance_w_m2_sr=1.0)
    found = np.pi / REFLECTANCE * _powers(lamps, reflectance=REFLECTANCE) / glow
    expected = 1e6 * _onto_patch(places, powers) / (2.0 * HALF_MM) ** 2
    sigma = float(found.std(ddof=1) / np.sqrt(SEEDS))
    passed = abs(found.mean() - expected) < MOST_SIGMAS * sigma and sigma < LARGEST_SIGMA * expected
    return Outcome(
        "", f"{expected:.5g} W/m²", f"{found.mean():.5g} ± {sigma:.2g} W/m²", bool(passed), 0.0, 2.0 * SEEDS, 0
    )


@case
def thousands_of_unequal_lamps() -> Outcome:
    """Illuminate a matt patch by 3,000 lamps over eight decades of power, from 3 mm to 3 m on both sides."""
    return _lit(*_lamps(3.0, 3e3))


@case
def lamps_from_1_mm_to_100_m() -> Outcome:
    """Illuminate a matt patch by 3,000 lamps over eight decades of power, from 1 mm (half its width) to 100 m."""
    return _lit(*_lamps(1.0, 1e5))
