"""The table of errors of white pictures behind hexagonal lenslets, against Fresnel integrals in closed form.

Lengths along the sensor are in pitches. As behind squares, white light comes from a round pupil at infinity, each point
of which sends a plane wave to an array without end, whose picture is a Fourier series over the lattice. Coefficients
are integrals of waves over the parts that two hexagons have in common.
"""

import math
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import j1

from lfmesh.scene.first_order import kick_error
from tests.instances import instances

Array = NDArray[np.float64]

PIXELS, FILL = 10, 0.9
"""Pixels along a pitch; width of micro-images."""
ORDERS, ACROSS = 24, 48
"""Longest wave of the series; places on each side of a cell where pictures are compared. Both change errors by 10⁻⁴."""

LATTICE = np.array([[1.0, 0.0], [0.5, math.sqrt(0.75)]])
AREA = math.sqrt(0.75)
WAVES = np.linalg.inv(LATTICE).T
"""Of the lattice of frequencies."""

ANGLES = np.arange(6) * np.pi / 3.0
SIDES = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)
HEXAGON = np.stack([np.cos(ANGLES + np.pi / 6.0), np.sin(ANGLES + np.pi / 6.0)], axis=1) / math.sqrt(3.0)


def common(shift: Array) -> Array:
    """Return the corners of what the hexagon has in common with one that is shifted, (n, 2); none of too far ones."""
    corners = HEXAGON
    for side in SIDES:
        beyond, kept = (corners - shift) @ side - 0.5, []
        for a, b, off_a, off_b in zip(corners, np.roll(corners, -1, 0), beyond, np.roll(beyond, -1), strict=True):
            if off_a <= 0.0:
                kept.append(a)
            if off_a * off_b < 0.0:
                kept.append(a + (b - a) * off_a / (off_a - off_b))
        corners = np.array(kept).reshape(-1, 2)
    return corners


def integral(corners: Array, cycles: Array) -> complex:
    """Return the integral of exp(2πi cycles · x) over a polygon, by its edges."""
    along = np.roll(corners, -1, 0) - corners
    if not cycles.any():
        return complex(0.5 * (corners[:, 0] * along[:, 1] - corners[:, 1] * along[:, 0]).sum())
    k, normal = 2.0 * np.pi * cycles, np.stack([along[:, 1], -along[:, 0]], axis=1)
    edges = (normal @ k) * np.sinc(along @ cycles) * np.exp(1j * (corners + 0.5 * along) @ k)
    return complex(edges.sum() / (1j * (k @ k)))


def passed(order: Array, fresnel: float, distance: float) -> float:
    """Return a coefficient of the series of the light of a plane wave along the axis, behind lenslets T without end.

    It is ∫ T(x + δ/2) T*(x − δ/2) exp(−2πi order · x) dx over a cell, δ = −order / 4F: with T* in the middle cell and T
    in each one that reaches there, a wave. The array looks alike from both sides, so that coefficients are real.
    """
    shift, total = -order / (4.0 * fresnel), 0j
    nearest = np.round(shift @ WAVES.T)
    for near in np.ndindex(5, 5):
        off = (nearest + np.array(near) - 2.0) @ LATTICE - shift
        corners = common(off)
        if len(corners) > 2:
            bend = 4.0 * fresnel * distance
            total += integral(corners, bend * off - order) * np.exp(-1j * np.pi * (bend * (off @ off) + order @ shift))
    assert abs(total.imag) < 1e-12
    return total.real / AREA


def alike(order: Array) -> tuple[float, float]:
    """Return what orders that turns and mirrors make of each other have in common: length and angle."""
    angle = math.atan2(order[1], order[0]) % (np.pi / 3.0)
    return round(float(np.hypot(*order)), 9), round(min(angle, np.pi / 3.0 - angle), 9)


@cache
def orders() -> tuple[NDArray[np.int64], Array, NDArray[np.int64], Array]:
    """Return numbers and frequencies of the series, and of each the number in a list of those that differ."""
    numbers = np.stack(np.meshgrid(*[np.arange(-ORDERS, ORDERS + 1)] * 2), axis=-1).reshape(-1, 2)
    numbers = numbers[np.hypot(*(numbers @ WAVES).T) <= ORDERS]
    keys = [alike(each) for each in numbers @ WAVES]
    _, first, group = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return numbers, numbers @ WAVES, group.ravel(), numbers[first] @ WAVES


def picture(coefficients: Array, width: float = FILL, pixels: int = PIXELS) -> Array:
    """Return the light on pixels all over a cell by those coefficients of a picture of a point that differ."""
    numbers, frequencies, group, _ = orders()
    x = np.pi * width * np.hypot(*frequencies.T)
    disk = np.divide(2.0 * j1(x), x, out=np.ones_like(x), where=x > 0.0)
    series = np.zeros((ACROSS, ACROSS), np.complex128)
    waves = coefficients[group] * disk * np.sinc(frequencies / pixels).prod(axis=1)
    np.add.at(series, tuple(numbers.T % ACROSS), waves * np.exp(1j * np.pi * numbers.sum(axis=1) / ACROSS))
    return np.asarray(np.fft.fft2(series).real)


def white(fresnel: float, distance: float) -> tuple[float, float]:
    """Return the errors of white pictures without and with the kick."""
    _, _, _, some = orders()
    truth = picture(np.array([passed(order, fresnel, distance) for order in some]))
    # Without waves a lenslet shows a point as a hexagon, and with the kick times the hexagon's transfer function.
    rays = np.array([integral(HEXAGON, (1.0 - distance) * order).real / AREA for order in some])
    both = [common(order / (4.0 * fresnel)) for order in some]
    kick = np.array([integral(each, np.zeros(2)).real / AREA if len(each) > 2 else 0.0 for each in both])
    without, turned = (float(np.abs(picture(each) - truth).sum() / truth.sum()) for each in (rays, rays * kick))
    return without, turned


@pytest.mark.parametrize(("width", "pixels"), [(0.9, 10), (0.5, 8), (1.1, 7)])
def test_errors_in_the_focal_plane_are_those_of_waves_of_all_lenslets(width: float, pixels: int) -> None:
    _, _, _, some = orders()
    truth = picture(np.array([passed(order, 2.0, 1.0) for order in some]), width, pixels)
    without = float(np.abs(picture(np.ones(len(some)), width, pixels) - truth).sum() / truth.sum())
    assert kick_error.hexagon_error(2.0, width, pixels) == pytest.approx(without, rel=0.01)


def test_what_hexagons_have_in_common_is_that_of_their_polygons() -> None:
    shifts = np.random.default_rng(1).uniform(-0.8, 0.8, (50, 2))
    corners = [common(shift) for shift in shifts]
    wanted = [integral(each, np.zeros(2)).real / AREA if len(each) > 2 else 0.0 for each in corners]
    assert sum(share > 0.0 for share in wanted) > 20
    assert kick_error.hexagons_in_common(shifts) == pytest.approx(np.array(wanted), abs=1e-12)


NUMBERS = range(len(kick_error.FRESNEL_NUMBERS))
CASES = [(number, distance) for number in NUMBERS for distance in range(len(kick_error.DISTANCES))]
QUICK = [(0, 2), (2, 1), (4, 0)]


@pytest.mark.parametrize("case", instances(CASES, long=[each for each in CASES if each not in QUICK]))
def test_errors_of_white_pictures_are_those_of_fresnel_integrals(case: tuple[int, int]) -> None:
    number, distance = case
    wanted = kick_error.HEXAGONS_WITHOUT[distance][number], kick_error.HEXAGONS_WITH[distance][number]
    found = white(kick_error.FRESNEL_NUMBERS[number], kick_error.DISTANCES[distance])
    assert found == pytest.approx(wanted, abs=1.5e-4)


def test_the_series_is_that_of_waves_on_a_grid() -> None:
    """Over two cells in a rectangle: hexagons as phase screens, and Fresnel's transfer function to the sensor."""
    fresnel, distance, across = 2.0, 1.2, 288
    rows = 2 * round(across * AREA)
    x, y = np.arange(across)[None, :] / across, np.arange(rows)[:, None] / rows * 2.0 * AREA
    middles = [np.array(each) for each in np.ndindex(2, 2)] @ np.array([[1.0, 0.0], [0.0, 2.0 * AREA]])
    middles = np.concatenate([middles, [[0.5, AREA]]])
    nearest = np.min([(x - a) ** 2 + (y - b) ** 2 for a, b in middles], axis=0)
    waves = np.fft.fft2(np.exp(-4j * np.pi * fresnel * distance * nearest))
    order_x, order_y = np.fft.fftfreq(across, 1.0 / across), np.fft.fftfreq(rows, 1.0 / rows) / (2.0 * AREA)
    waves *= np.exp(-1j * np.pi / (4.0 * fresnel) * (order_x[None, :] ** 2 + order_y[:, None] ** 2))
    light = np.fft.fft2(np.abs(np.fft.ifft2(waves)) ** 2) / (across * rows)
    for column, row in ((1, 1), (2, 0), (3, 1)):
        order = np.array([column, row / (2.0 * AREA)])
        assert passed(order, fresnel, distance) == pytest.approx(light[row, column].real, abs=2e-3)
        assert abs(light[row, column]) > 0.01


def test_waves_of_one_hexagon_add_up_to_the_picture() -> None:
    """In the focal plane, where waves of neighbours leave no trace: the hexagon's transfer function."""
    for order in (WAVES[0], 2.0 * WAVES[0] + WAVES[1]):
        kick = integral(common(order / 8.0), np.zeros(2)).real / AREA
        assert 0.0 < kick < 1.0
        assert passed(order, 2.0, 1.0) == pytest.approx(kick, abs=1e-12)
