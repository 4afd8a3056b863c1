"""Emitting targets that light others from where their light is hard to find."""

from typing import Any

import numpy as np

from lfmesh.accuracy.hard.outcome import MOST_SIGMAS, Outcome, case, images_of, surfaces_of
from lfmesh.accuracy.hard.truth import Array
from lfmesh.scene import Camera, Lens, Scene, Sensor, Target
from lfmesh.scene.objects.targets import Material, Plane

HALF_MM = 0.1
"""Half the side of the patch that is lit."""

REFLECTANCE, RADIANCE = 0.6, 7.0
SEEDS = 16
LARGEST_SIGMA = 0.01


def _sheet(start: tuple[float, float], end: tuple[float, float], width: float, **material: Any) -> Target:
    """Return a sheet along y from one point of the xz plane to another."""
    along = np.subtract(end, start)
    return Target(
        shape=Plane(width_mm=float(np.hypot(*along)), height_mm=width),
        position_mm=(0.5 * (start[0] + end[0]), 0.0, 0.5 * (start[1] + end[1])),
        rotation_deg=(0.0, float(np.rad2deg(np.arctan2(-along[1], along[0]))), 0.0),
        material=Material(**material),
    )


def _powers(patch: dict[str, float], others: list[Target]) -> Array:
    """Return the power of images of a small patch and what stands on it, by the same seeds, W."""
    lens = surfaces_of(((20.0, 3.0, 1.5), (-20.0, 0.0, 1.0)), aperture=2.0)
    scene = Scene(
        camera=Camera(focus_mm=60.0, lens=Lens(surfaces=tuple(lens)), sensor=Sensor(pixels=(12, 12), pixel_mm=0.025)),
        targets=(_sheet((-HALF_MM, -60.0), (HALF_MM, -60.0), 2.0 * HALF_MM, **patch), *others),
    ).changed({"transport.samples": 256, "transport.replicates": 1, "transport.split": "transmit"})
    return np.array([image.mean.sum() for image in images_of(scene, range(SEEDS))])


def _irradiance(corners: Array, at: Array) -> float:
    """Return what a polygon (k, 3) of radiance 1 gives an element that faces +z: Lambert's sum over the edges."""
    to = corners - at
    to /= np.linalg.norm(to, axis=1, keepdims=True)
    across = np.cross(to, np.roll(to, -1, axis=0))
    sine = np.linalg.norm(across, axis=1)
    angle = np.arctan2(sine, (to * np.roll(to, -1, axis=0)).sum(axis=1))
    return float(0.5 * abs((angle * across[:, 2] / sine).sum()))


@case
def emitter_on_the_surface() -> Outcome:
    """Light a matt patch by a glowing sheet that touches it along an edge, where 1 / r² has no bound."""
    sheet = _sheet((HALF_MM, -60.0), (HALF_MM + 8.0, -56.0), 10.0, reflectance=0.0, radiance_w_m2_sr=RADIANCE)
    corners = np.array(
        [[HALF_MM, -5.0, 0.0], [HALF_MM, 5.0, 0.0], [HALF_MM + 8.0, 5.0, 4.0], [HALF_MM + 8.0, -5.0, 4.0]]
    )
    nodes, weights = np.polynomial.legendre.leggauss(24)
    places = np.array([(HALF_MM * x, HALF_MM * y, 0.0) for x in nodes for y in nodes])
    shares = 0.25 * np.outer(weights, weights).ravel()
    expected = RADIANCE * sum(share * _irradiance(corners, at) for share, at in zip(shares, places, strict=True))
    # The camera sees the sheet as well, which it sees alone where the patch is black.
    lit, alone = (_powers({"reflectance": reflectance}, [sheet]) for reflectance in (REFLECTANCE, 0.0))
    glow = _powers({"reflectance": 0.0, "radiance_w_m2_sr": 1.0}, [])
    found = np.pi / REFLECTANCE * (lit - alone) / glow
    sigma = float(found.std(ddof=1) / np.sqrt(SEEDS))
    passed = abs(found.mean() - expected) < MOST_SIGMAS * sigma and sigma < LARGEST_SIGMA * expected
    return Outcome(
        "", f"{expected:.4f} W/m²", f"{found.mean():.4f} ± {sigma:.4f} W/m²", bool(passed), 0.0, 3.0 * SEEDS, 0
    )
