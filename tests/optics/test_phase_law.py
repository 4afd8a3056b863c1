"""The grating equation in three dimensions."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from lfmesh.optics.phase_law import diffracted

Array = NDArray[np.float64]
RNG = np.random.default_rng(7)


def unit(vector: Array) -> tuple[float, float, float]:
    x, y, z = vector / np.linalg.norm(vector)
    return float(x), float(y), float(z)


@pytest.mark.parametrize(("n_i", "n_t"), [(1.0, 1.5), (1.5, 1.0), (1.0, 1.0), (1.33, 1.7)])
@pytest.mark.parametrize("order", [-2, -1, 0, 1, 3])
def test_a_flat_grating_obeys_the_grating_equation(n_i: float, n_t: float, order: int) -> None:
    """n' sin θ' = n sin θ + m λ L."""
    change = order * 550e-6 * 200.0
    for angle in np.linspace(-0.3, 0.3, 7):
        going, cos_out, ox, oy, oz = diffracted(
            n_i, n_t, (math.sin(angle), 0.0, math.cos(angle)), (0.0, 0.0, 1.0), change, 0.0, False
        )
        sine = (n_i * math.sin(angle) + change) / n_t
        assert going
        assert ox == pytest.approx(sine, abs=1e-12)
        assert oy == 0.0
        assert cos_out == oz == pytest.approx(math.sqrt(1.0 - sine**2), abs=1e-12)


def test_orders_lie_on_a_cone_about_the_lines_of_the_grating() -> None:
    """The component along the lines does not change (conical diffraction), so orders differ across them by λ L."""
    n_i, n_t, change = 1.5, 1.0, 0.21
    direction = unit(np.array([0.1, 0.3, 1.0]))
    across = []
    for order in range(-3, 3):
        going, _, ox, oy, oz = diffracted(n_i, n_t, direction, (0.0, 0.0, 1.0), order * change, 0.0, False)
        assert going
        assert n_t * oy == pytest.approx(n_i * direction[1], abs=1e-15)
        assert ox**2 + oy**2 + oz**2 == pytest.approx(1.0, abs=1e-15)
        across.append(n_t * ox)
    np.testing.assert_allclose(np.diff(across), change, atol=1e-15)


def test_an_order_is_evanescent_beyond_grazing() -> None:
    beneath, beyond = (
        diffracted(1.5, 1.0, (0.0, 0.0, 1.0), (0.0, 0.0, 1.0), g, 0.0, False) for g in (1 - 1e-12, 1 + 1e-12)
    )
    assert beneath[0]
    assert beneath[1] == pytest.approx(math.sqrt(2e-12), rel=1e-3)
    assert beyond == (False, 0.0, 0.0, 0.0, 0.0)
    # A reflected order propagates in the medium that it comes from.
    assert diffracted(1.5, 1.5, (0.0, 0.0, 1.0), (0.0, 0.0, 1.0), 1.2, 0.0, True)[0]


def test_reversed_light_returns_along_its_own_path() -> None:
    """p' = p + G becomes −p = −p' + G, with the same sign of G."""
    tried = 0
    for _ in range(200):
        n_i, n_t = RNG.uniform(1.0, 2.0, 2)
        normal = unit(RNG.normal(size=3))
        direction = unit(RNG.normal(size=3) + 2.0 * np.array(normal))
        gx, gy = RNG.normal(scale=0.3, size=2)
        if np.dot(direction, normal) <= 0.0:
            continue
        going, cos_out, *out = diffracted(n_i, n_t, direction, normal, gx, gy, False)
        if not going or cos_out < 0.05:
            continue
        tried += 1
        back = tuple(-each for each in out)
        against = tuple(-each for each in normal)
        again, _, *returned = diffracted(n_t, n_i, back, against, gx, gy, False)
        assert again
        np.testing.assert_allclose(returned, -np.array(direction), atol=1e-13)
    assert tried > 100


def test_only_the_tangential_part_of_the_gradient_counts() -> None:
    """Snell's law and the grating equation along the surface, and no change across the plane of both."""
    for _ in range(50):
        normal = np.array(unit(np.array([*RNG.normal(scale=0.3, size=2), 1.0])))
        direction = np.array(unit(np.array([*RNG.normal(scale=0.2, size=2), 1.0])))
        g = np.array([*RNG.normal(scale=0.2, size=2), 0.0])
        _, cos_out, *out = diffracted(1.4, 1.6, tuple(direction), tuple(normal), g[0], g[1], False)
        change = 1.6 * np.array(out) - 1.4 * direction - g
        np.testing.assert_allclose(np.cross(change, normal), 0.0, atol=1e-15)
        assert np.dot(out, normal) == pytest.approx(cos_out, abs=1e-15)
        assert np.linalg.norm(out) == pytest.approx(1.0, abs=1e-15)


def test_a_reflected_order_turns_back() -> None:
    """The zeroth order is the mirror's; the first one has its tangential part changed by G."""
    normal, direction = unit(np.array([0.2, -0.1, 1.0])), unit(np.array([0.3, 0.2, 1.0]))
    along = np.dot(direction, normal)
    _, cos_out, *mirrored = diffracted(1.5, 1.5, direction, normal, 0.0, 0.0, True)
    np.testing.assert_allclose(mirrored, np.array(direction) - 2.0 * along * np.array(normal), atol=1e-15)
    assert cos_out == pytest.approx(along, abs=1e-15)
    _, cos_out, *first = diffracted(1.5, 1.5, direction, normal, 0.1, 0.05, True)
    assert np.dot(first, normal) == pytest.approx(-cos_out, abs=1e-15)
    change = 1.5 * (np.array(first) - direction) - [0.1, 0.05, 0.0]
    np.testing.assert_allclose(np.cross(change, normal), 0.0, atol=1e-15)
