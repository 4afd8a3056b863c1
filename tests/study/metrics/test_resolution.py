"""MTF50 of slanted edges against the closed form of square samples and a Gaussian blur, for all phases and slants."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import erf

from lfmesh.study.metrics.resolution import edge_mtf50
from tests.instances import instances

Array = NDArray[np.float64]

DARK, BRIGHT = 0.2, 1.0
SLANTS_DEG = (2.0, 3.5, 5.0, 7.0, 10.0)
PHASES = np.linspace(0.0, 1.0, 40, endpoint=False)


def edge(size: tuple[int, int], slant: float, phase: float, blur: float) -> Array:
    """Return the exact picture of an edge by square samples: second differences of the twice integrated profile.

    Parameters
    ----------
    size : (int, int)
        Rows and columns.
    slant : float, rad
    phase : float
        Shift of the edge, samples.
    blur : float
        Standard deviation of the blur, samples.
    """
    rows, columns = (np.arange(n) - 0.5 * (n - 1) for n in size)
    a, b = np.cos(slant), np.sin(slant)
    u = (columns - phase) * a + rows[:, None] * b

    def twice(v: Array) -> Array:
        if blur == 0.0:
            return 0.5 * np.maximum(v, 0.0) ** 2
        z = v / blur
        below, density = 0.5 * (1.0 + erf(z / np.sqrt(2.0))), np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi)
        return 0.5 * blur**2 * ((z * z + 1.0) * below + z * density)

    p, m = 0.5 * (a + b), 0.5 * (a - b)
    return DARK + (BRIGHT - DARK) * (twice(u + p) - twice(u + m) - twice(u - m) + twice(u - p)) / (a * b)


def truth(slant: float, blur: float) -> float:
    """Return the MTF50 across the edge, cycles a sample, of square samples and a Gaussian blur."""
    a, b = np.cos(slant), np.sin(slant)
    return float(
        brentq(lambda f: np.sinc(f * a) * np.sinc(f * b) * np.exp(-2.0 * (np.pi * blur * f) ** 2) - 0.5, 1e-3, 0.9)
    )


@pytest.mark.parametrize(("size", "blur"), [((60, 60), 0.0), ((60, 60), 0.3), ((24, 24), 0.3), ((24, 24), 1.2)])
def test_the_edge_of_every_phase_and_slant_has_the_mtf_of_the_closed_form(size: tuple[int, int], blur: float) -> None:
    off = np.array([
        edge_mtf50(edge(size, slant, phase, blur)) / truth(slant, blur) - 1.0
        for slant in np.radians(SLANTS_DEG)
        for phase in PHASES[:: 1 if blur == 0.0 else 8]
    ])  # fmt: skip
    assert abs(off.mean()) < 0.01
    assert np.abs(off).max() < (0.02 if blur == 0.0 else 0.001)


@pytest.mark.parametrize("blur", instances([0.0, 0.6], long=[0.6]))
def test_noise_of_a_thousandth_moves_it_by_less_than_two_thousandths_in_200_draws(blur: float) -> None:
    draw = np.random.default_rng(5)
    exact = edge((40, 40), np.radians(5.0), 0.3, blur)
    found = [edge_mtf50(exact * (1.0 + 1e-3 * draw.standard_normal(exact.shape))) for _ in range(200)]
    assert np.std(found) / np.mean(found) < 2e-3


@pytest.mark.parametrize("turned", [lambda p: p[:, ::-1], lambda p: p[::-1], lambda p: 1.2 - p])
def test_a_mirrored_edge_and_its_negative_have_the_same_mtf(turned: object) -> None:
    exact = edge((40, 32), np.radians(4.0), 0.2, 0.5)
    assert edge_mtf50(turned(exact)) == pytest.approx(edge_mtf50(exact), rel=1e-6)  # type: ignore[operator]


def test_no_edge_has_no_mtf() -> None:
    draw = np.random.default_rng(2)
    for picture in (np.ones((30, 30)), draw.normal(1.0, 0.01, (30, 30)), np.full((30, 30), np.nan), np.ones((5, 30))):
        assert np.isnan(edge_mtf50(picture))
