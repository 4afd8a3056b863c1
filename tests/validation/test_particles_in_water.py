"""Particles in water behind a window against rays that Snell's and Fresnel's laws, written here, lead out of the tank.

What is outside the tank, lens, array and sensor, is traced as in any scene: the rays of the truth start in air.
"""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import qmc

import lfmesh as lf
from lfmesh.geometry import frame
from lfmesh.geometry.frame import rotation
from tests.frames import motion
from tests.validation.test_particles import PIXELS, micro_images, scene_of

Array = NDArray[np.float64]

WATER, GLASS = 1.333, 1.5
WALL = 6.0
SIZE = (160.0, 120.0, 140.0)
RAYS = 1 << 18


def tank(tilt_deg: float, absorbs: float = 0.0) -> dict[str, object]:
    return {
        "size_mm": SIZE, "wall_mm": WALL, "wall": {"index": GLASS},
        "liquid": {"index": WATER, "absorption_per_mm": absorbs},
        "position_mm": (0.0, 0.0, -430.0), "rotation_deg": (0.5 * tilt_deg, tilt_deg, 0.0),
    }  # fmt: skip


def bent(d: Array, normal: Array, n_i: float, n_t: float) -> tuple[Array, Array]:
    """Return refracted directions, by Snell's law in vectors, and transmittances for unpolarised light, by Fresnel's.

    The normal points along the light.
    """
    cos_i = d @ normal
    cos_t = np.sqrt(1.0 - (n_i / n_t) ** 2 * (1.0 - cos_i**2))
    out = n_i / n_t * d + (cos_t - n_i / n_t * cos_i)[:, None] * normal
    s = (n_i * cos_i - n_t * cos_t) / (n_i * cos_i + n_t * cos_t)
    p = (n_t * cos_i - n_i * cos_t) / (n_t * cos_i + n_i * cos_t)
    return out, 1.0 - 0.5 * (s**2 + p**2)


def out_of_tank(point: Array, d: Array, tilt_deg: float) -> tuple[Array, Array, Array, Array]:
    """Return place and direction of rays beyond the front window, the share that is left, and their way in water."""
    normal = rotation((0.5 * tilt_deg, tilt_deg, 0.0))[:, 2]
    outer = np.array([0.0, 0.0, -430.0]) + 0.5 * SIZE[2] * normal
    inner = outer - WALL * normal
    t = ((inner - point) @ normal) / (d @ normal)
    p = point + t[:, None] * d
    in_glass, first = bent(d, normal, WATER, GLASS)
    p = p + (((outer - p) @ normal) / (in_glass @ normal))[:, None] * in_glass
    in_air, second = bent(in_glass, normal, GLASS, 1.0)
    return p, in_air, first * second, t


def truth_of(scene: lf.Scene, point: Array, intensity: float, tilt_deg: float, absorbs: float) -> Array:
    """Return power and squared error of it by pixel, (2, pixels, pixels)."""

    def landing(slope: Array) -> Array:
        d = np.column_stack([slope, np.ones(len(slope))])
        p, out, _, _ = out_of_tank(point, d / np.linalg.norm(d, axis=1)[:, None], tilt_deg)
        return p[:, :2] - p[:, 2:] / out[:, 2:] * out[:, :2]

    slope = -point[:2] / -point[2]
    for _ in range(12):
        here = landing(slope + 1e-4 * np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]))
        change = (here[1:] - here[0]).T / 1e-4
        slope = slope - np.linalg.solve(change, here[0])
    # Slopes in an ellipse that holds all of the lens's opening.
    u, v = qmc.Sobol(2, seed=6).random(RAYS).T
    r, phi = 8.6 * np.sqrt(u), 2.0 * np.pi * v
    slopes = slope + np.linalg.solve(change, np.stack([r * np.cos(phi), r * np.sin(phi)])).T
    d = np.column_stack([slopes, np.ones(RAYS)])
    length = np.linalg.norm(d, axis=1)
    p, out, share, way = out_of_tank(point, d / length[:, None], tilt_deg)
    solid_angle = np.pi * 8.6**2 / abs(np.linalg.det(change)) / length**3
    power = intensity / RAYS * solid_angle * share * np.exp(-absorbs * way)
    air = lf.build(scene.changed({"tanks": (), "particles": ()}))
    paths = lf.trace(air, p, out, split="transmit")
    fell = paths.status == lf.Status.SENSOR
    at = frame.points(motion(air, "world", "sensor"), paths.position[fell])
    columns, rows = (np.floor(at[:, axis] / scene.camera.sensor.pixel_mm + 0.5 * PIXELS).astype(int) for axis in (0, 1))
    watts = (paths.weight * power[paths.source])[fell]
    image = np.zeros((2, PIXELS, PIXELS))
    np.add.at(image[0], (rows, columns), watts)
    np.add.at(image[1], (rows, columns), watts**2)
    return image


@pytest.mark.parametrize(
    ("point", "tilt_deg"),
    [
        ((0.5, 0.7, -375.0), 0.0),
        ((2.0, -3.5, -375.0), 12.0),
        pytest.param((-6.0, 5.0, -440.0), 0.0, marks=pytest.mark.long),
    ],
)
def test_centres_of_light_are_where_snell_sends_them(point, tilt_deg, tmp_path):
    """To 0.05 pixel in every micro-image with a hundredth of the light; the power of all within 4 standard errors."""
    absorbs = 0.01
    bare = scene_of([(point, 2.5)], tmp_path)
    scene = bare.changed({"tanks": [tank(tilt_deg, absorbs)], "particles[0].samples": 1 << 17})
    image = lf.render(scene)
    truth = truth_of(scene, np.array(point), 2.5, tilt_deg, absorbs)
    _, centre = micro_images(image.mean[..., 0])
    true_power, true_centre = micro_images(truth[0])
    lit = true_power > 0.01 * true_power.sum()
    assert lit.sum() >= 2
    np.testing.assert_allclose(centre[:, lit], true_centre[:, lit], rtol=0.0, atol=0.05)
    error = np.sqrt((image.stderr**2).sum() + truth[1].sum())
    assert abs(image.mean.sum() - truth[0].sum()) < 4.0 * error
