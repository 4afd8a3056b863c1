"""Lambertian directions: their frames are orthonormal, their density is cos θ / π."""

import numpy as np
import pytest
from scipy.stats import kstest

from lfmesh.optics.scattering import about, lambertian, tangents

RNG = np.random.default_rng(12)
NORMALS = [
    *(RNG.normal(size=(20, 3)) / 1.0),
    (0.0, 0.0, 1.0),
    (0.0, 0.0, -1.0),
    (0.0, 0.0, 1.0),
    (1e-9, 0.0, -1.0),
    (1.0, 0.0, 0.0),
    (0.0, 1.0, -0.0),
]
LEVEL = 1e-3
"""Of each of the five tests of uniformity; the numbers are seeded, so they cannot fail by chance later."""


@pytest.mark.parametrize("normal", NORMALS)
def test_tangents_and_normal_are_orthonormal_and_right_handed(normal):
    n = np.array(normal) / np.linalg.norm(normal)
    u, v = np.reshape(tangents(*n), (2, 3))
    np.testing.assert_allclose(np.stack([u, v, n]) @ np.stack([u, v, n]).T, np.eye(3), atol=1e-15)
    assert np.dot(np.cross(u, v), n) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize("cos_theta", [1.0, 0.3, 0.0, -0.7])
def test_about_keeps_the_polar_angle_at_unit_length(cos_theta):
    for normal in NORMALS:
        n = np.array(normal) / np.linalg.norm(normal)
        d = np.array(about(*n, cos_theta, 2.0))
        assert np.dot(d, n) == pytest.approx(cos_theta, abs=1e-15)
        assert np.linalg.norm(d) == pytest.approx(1.0, abs=1e-15)


def test_lamberts_law():
    n = np.array([0.48, -0.6, -0.64])
    count = 20_000
    d = np.array([lambertian(*n, u, v) for u, v in RNG.uniform(size=(count, 2))])
    np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1.0, atol=1e-15)
    cosine = d @ n
    assert cosine.min() >= 0.0
    # A density of cos θ / π over solid angle makes cos² θ and the azimuth uniform and independent.
    u, v = np.reshape(tangents(*n), (2, 3))
    turn = np.arctan2(d @ v, d @ u) / (2 * np.pi) % 1.0
    assert kstest(cosine**2, "uniform").pvalue > LEVEL
    assert kstest(turn, "uniform").pvalue > LEVEL
    for half in (cosine**2 < 0.5, cosine**2 >= 0.5):
        assert kstest(turn[half], "uniform").pvalue > LEVEL


def test_zenith_angle_is_the_papers():
    """cos 2θ = 1 - 2u, equation 1."""
    for u in RNG.uniform(size=20):
        x, y, z = lambertian(0.0, 0.0, 1.0, u, 0.3)
        theta = np.arctan2(np.hypot(x, y), z)
        assert np.cos(2 * theta) == pytest.approx(1 - 2 * u, abs=4e-15)
