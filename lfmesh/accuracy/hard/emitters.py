"""Emitting targets that illuminate others from places where their light is hard to find."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from lfmesh.accuracy.hard.outcome import MOST_SIGMAS, Outcome, case, images_of, surfaces_of
from lfmesh.accuracy.hard.truth import Array
from lfmesh.scene import Camera, Lens, Scene, Sensor, Target
from lfmesh.scene.objects.shapes import Plane, Sphere
from lfmesh.scene.objects.targets import Material

HALF_MM = 0.1
"""Half the side of the illuminated patch."""

REFLECTANCE, RADIANCE = 0.6, 7.0
SEEDS = 16
LARGEST_SIGMA = 0.01


def _sheet(start: tuple[float, float], end: tuple[float, float], width: float, **material: Any) -> Target:
    """Return a sheet along y between two points of the xz plane."""
    along = np.subtract(end, start)
    return Target(
        shape=Plane(width_mm=float(np.hypot(*along)), height_mm=width),
        position_mm=(0.5 * (start[0] + end[0]), 0.0, 0.5 * (start[1] + end[1])),
        rotation_deg=(0.0, float(np.rad2deg(np.arctan2(-along[1], along[0]))), 0.0),
        material=Material(**material),
    )


def _powers(patch: dict[str, float], others: list[Target]) -> Array:
    """Return the power of images of a small patch and its neighbours, W, with the same seeds."""
    lens = surfaces_of(((20.0, 3.0, 1.5), (-20.0, 0.0, 1.0)), aperture=2.0)
    scene = Scene(
        camera=Camera(focus_mm=60.0, lens=Lens(surfaces=tuple(lens)), sensor=Sensor(pixels=(12, 12), pixel_mm=0.025)),
        targets=(_sheet((-HALF_MM, -60.0), (HALF_MM, -60.0), 2.0 * HALF_MM, **patch), *others),
    ).changed({"transport.samples": 256, "transport.replicates": 1, "transport.split": "transmit"})
    return np.array([image.mean.sum() for image in images_of(scene, range(SEEDS))])


def _irradiance(corners: Array, at: Array) -> float:
    """Return the irradiance of an element facing +z from polygons (n, k, 3) of radiance 1, by Lambert's sum over edges.

    Clockwise polygons, seen from behind, do not count.
    """
    to = corners - at
    to /= np.linalg.norm(to, axis=2, keepdims=True)
    across = np.cross(to, np.roll(to, -1, axis=1))
    sine = np.linalg.norm(across, axis=2)
    angle = np.arctan2(sine, (to * np.roll(to, -1, axis=1)).sum(axis=2))
    return float(0.5 * (-(angle * across[:, :, 2] / sine).sum(axis=1)).clip(0.0).sum())


def _over_patch(corners: Array, order: int) -> float:
    """Return the mean of `_irradiance` over the patch, centred on the origin, by Gauss' rule."""
    nodes, weights = np.polynomial.legendre.leggauss(order)
    places = np.array([(HALF_MM * x, HALF_MM * y, 0.0) for x in nodes for y in nodes])
    shares = 0.25 * np.outer(weights, weights).ravel()
    return sum(share * _irradiance(corners, at) for share, at in zip(shares, places, strict=True))


@case
def emitter_on_the_surface() -> Outcome:
    """Illuminate a matt patch by a glowing sheet touching it along an edge, where 1 / r² is unbounded."""
    sheet = _sheet((HALF_MM, -60.0), (HALF_MM + 8.0, -56.0), 10.0, reflectance=0.0, radiance_w_m2_sr=RADIANCE)
    corners = np.array(
        [[HALF_MM, -5.0, 0.0], [HALF_MM, 5.0, 0.0], [HALF_MM + 8.0, 5.0, 4.0], [HALF_MM + 8.0, -5.0, 4.0]]
    )
    return _outcome(sheet, RADIANCE * _over_patch(corners[None, ::-1], 24))


def _outcome(glowing: Target, expected: float) -> Outcome:
    """Compare the irradiance of the patch from a glowing target with the expected one, W/m²."""
    # The camera sees the target as well; with a black patch it sees only the target.
    lit, alone = (_powers({"reflectance": reflectance}, [glowing]) for reflectance in (REFLECTANCE, 0.0))
    glow = _powers({"reflectance": 0.0, "radiance_w_m2_sr": 1.0}, [])
    found = np.pi / REFLECTANCE * (lit - alone) / glow
    sigma = float(found.std(ddof=1) / np.sqrt(SEEDS))
    passed = abs(found.mean() - expected) < MOST_SIGMAS * sigma and sigma < LARGEST_SIGMA * expected
    return Outcome(
        "", f"{expected:.4f} W/m²", f"{found.mean():.4f} ± {sigma:.4f} W/m²", bool(passed), 0.0, 3.0 * SEEDS, 0
    )


BALLS = (((0.0, 2.0, 1.2), 0.1, 25.0), ((1500.0, 0.0, 1200.0), 300.0, 2.0), ((-30.0, 5.0, 15.0), 8.0, 0.01))
"""Centres from the patch's centre, mm, radii, mm, and radiances of balls that do not hide each other."""


@case
def near_dim_facets_beside_far_bright_ones() -> Outcome:
    """Illuminate a matt patch by 61,440 facets, half its light from balls with a millionth of their power."""
    ball = trimesh.creation.icosphere(subdivisions=5)
    glow = _powers({"reflectance": 0.0, "radiance_w_m2_sr": 1.0}, [])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ball.ply"
        ball.export(path)
        others = [
            Target(
                file=str(path), units="mm", scale=radius, position_mm=(x, y, z - 60.0),
                material=Material(reflectance=0.0, radiance_w_m2_sr=radiance),
            )
            for (x, y, z), radius, radiance in BALLS
        ]  # fmt: skip
        lit = _powers({"reflectance": REFLECTANCE}, others)
    # In a convex mesh all facets facing the patch are visible; the patch is small compared to the distances.
    expected = sum(
        radiance * _over_patch(radius * ball.triangles + np.array(centre), 4) for centre, radius, radiance in BALLS
    )
    found = np.pi / REFLECTANCE * lit / glow
    sigma = float(found.std(ddof=1) / np.sqrt(SEEDS))
    passed = abs(found.mean() - expected) < MOST_SIGMAS * sigma and sigma < LARGEST_SIGMA * expected
    return Outcome(
        "", f"{expected:.4f} W/m²", f"{found.mean():.4f} ± {sigma:.4f} W/m²", bool(passed), 0.0, 2.0 * SEEDS, 0
    )


def _factor_of_ball(radius: float, aside: Array, height: float) -> Array:
    """Return form factors from elements that face +z to a ball that their horizon cuts.

    J. R. Howell, A Catalog of Radiation Heat Transfer Configuration Factors: a differential element to a sphere.

    Parameters
    ----------
    radius : float, mm
    aside : (n,) float64, mm
        Horizontal distance from each element to the ball's centre.
    height : float, mm
        Height of its centre.
    """
    h2 = (aside**2 + height**2) / radius**2
    cosine = height / np.hypot(aside, height)
    sine, edge = np.sqrt(1.0 - cosine**2), np.sqrt(h2 - 1.0)
    through = cosine * np.arccos(-edge * cosine / sine) - edge * np.sqrt(1.0 - h2 * cosine**2)
    return np.asarray(0.5 - np.arcsin(edge / (np.sqrt(h2) * sine)) / np.pi + through / (np.pi * h2))


@case
def ball_cut_by_the_horizon() -> Outcome:
    """Illuminate a matt patch by a glowing ball beside it that reaches below its plane."""
    radius, aside, height = 4.0, 4.4, 1.2
    ball = Target(
        shape=Sphere(radius_mm=radius), position_mm=(aside, 0.0, height - 60.0),
        material=Material(reflectance=0.0, radiance_w_m2_sr=RADIANCE),
    )  # fmt: skip
    nodes, weights = np.polynomial.legendre.leggauss(24)
    x, y = np.meshgrid(HALF_MM * nodes, HALF_MM * nodes)
    factors = _factor_of_ball(radius, np.hypot(x - aside, y), height)
    expected = np.pi * RADIANCE * float((0.25 * np.outer(weights, weights) * factors).sum())
    return _outcome(ball, expected)
