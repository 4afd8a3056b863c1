"""Phases of diffractive surfaces: their closed forms, their derivatives, and the spline through a grid of samples."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.polynomial.polynomial import polyval2d
from numpy.typing import NDArray

from lfmesh.optics.phase_profiles import PhaseProfile, phase_at, phase_bends_at, phase_table, phases_at
from lfmesh.optics.phase_shapes import (
    grating_profile,
    grid_bounds_mm,
    grid_profile,
    hologram_profile,
    metalens_profile,
    radial_profile,
    vertex_derivatives,
    xy_profile,
    zones_profile,
)
from lfmesh.optics.zones import Zone

Array = NDArray[np.float64]
RNG = np.random.default_rng(5)
POINTS = RNG.uniform(-1.5, 1.5, (40, 2))
STEP = 1e-4

CUBIC = RNG.normal(size=(4, 4))
TERMS = [(1, 0, 2.0), (0, 1, -1.5), (2, 0, 3.0), (1, 1, 0.7), (0, 2, -4.0), (3, 2, 1.1), (0, 5, 0.3)]
WAVE_NUMBER = 2.0 * math.pi / 550e-6
REAL, VIRTUAL = (0.4, -1.0, -30.0), (-0.2, 0.3, 25.0)


def cubic_grid() -> PhaseProfile:
    x, y = (-2.0 + step * np.arange(count) for step, count in ((0.25, 17), (0.4, 11)))
    return grid_profile(polyval2d(*np.meshgrid(x, y, indexing="ij"), CUBIC), (0.25, 0.4), (-2.0, -2.0))


def distance(point: tuple[float, float, float], x: Array, y: Array) -> Array:
    return np.sqrt((x - point[0]) ** 2 + (y - point[1]) ** 2 + point[2] ** 2)


def hologram(x: Array, y: Array) -> Array:
    """The wave from the real point becomes the one towards the virtual point."""

    def change(x: Array, y: Array) -> Array:
        return -20.0 * (distance(VIRTUAL, x, y) + distance(REAL, x, y))

    return change(x, y) - change(np.zeros(1), np.zeros(1))


ZONES = [
    Zone(0.0, 0.8, 0.3, 0.0, 0.0, ((2, -40.0), (4, 3.0)), 0.5),
    Zone(0.8, 1.4, -7.0, 0.0, 0.0, ((2, 5.0),), 0.4),
    Zone(1.4, math.inf, 0.0, 0.0, 0.0, ((2, 0.0), (4, -2.0), (6, 0.5)), 0.7),
]


def zoned(x: Array, y: Array) -> Array:
    r = np.hypot(x, y)
    inner, middle = -10.0 * r**2 + 3.0 / 16.0 * r**4 + 0.3, 0.8 * r**2 - 7.0
    outer = -2.0 * (0.7 * r) ** 4 + 0.5 * (0.7 * r) ** 6
    return np.where(r <= 0.8, inner, np.where(r <= 1.4, middle, outer))


KINDS: dict[str, tuple[PhaseProfile, Callable[[Array, Array], Array]]] = {
    "radial": (
        radial_profile((-40.0, 3.0, -0.2), 2.0),
        lambda x, y: sum(a * (np.hypot(x, y) / 2.0) ** (2 * i) for i, a in ((1, -40.0), (2, 3.0), (3, -0.2))),
    ),
    "xy": (xy_profile(TERMS, 1.3), lambda x, y: sum(a * (x / 1.3) ** i * (y / 1.3) ** j for i, j, a in TERMS)),
    "grating": (
        grating_profile(100.0, 30.0),
        lambda x, y: 200.0 * math.pi * (x * math.cos(math.pi / 6) + y * math.sin(math.pi / 6)),
    ),
    "metalens": (
        metalens_profile(5.0, WAVE_NUMBER),
        lambda x, y: -WAVE_NUMBER * (np.sqrt(x * x + y * y + 25.0) - 5.0),
    ),
    "diverging metalens": (
        metalens_profile(-5.0, WAVE_NUMBER),
        lambda x, y: WAVE_NUMBER * (np.sqrt(x * x + y * y + 25.0) - 5.0),
    ),
    "grid": (cubic_grid(), lambda x, y: polyval2d(x, y, CUBIC)),
    "hologram": (hologram_profile((REAL, VIRTUAL), (True, False), 20.0), hologram),
    "zones": (zones_profile(ZONES), zoned),
}


def derivatives(profile: PhaseProfile, points: Array) -> tuple[Array, Array]:
    """Return phase and gradient (n, 3), and the second derivatives (n, 3)."""
    table = phase_table([profile])
    return phases_at(table, 0, *points.T), np.array([phase_bends_at(table, 0, x, y) for x, y in points])


@pytest.mark.parametrize("kind", KINDS)
def test_a_phase_is_its_closed_form(kind: str) -> None:
    profile, truth = KINDS[kind]
    found, _ = derivatives(profile, POINTS)
    wanted = truth(*POINTS.T)
    np.testing.assert_allclose(found[:, 0], wanted, rtol=1e-11, atol=1e-12 * np.abs(wanted).max())


@pytest.mark.parametrize("kind", KINDS)
def test_gradients_are_the_differences_of_the_closed_form(kind: str) -> None:
    profile, truth = KINDS[kind]
    found, _ = derivatives(profile, POINTS)
    for axis in (0, 1):
        steps = STEP * np.eye(2)[axis]
        ahead, behind, far, near = (truth(*(POINTS + k * steps).T) for k in (1, -1, 2, -2))
        wanted = (8.0 * (ahead - behind) - (far - near)) / (12.0 * STEP)
        np.testing.assert_allclose(found[:, 1 + axis], wanted, atol=1e-8 * np.abs(wanted).max())


@pytest.mark.parametrize("kind", KINDS)
def test_second_derivatives_are_the_differences_of_the_gradient(kind: str) -> None:
    profile, _ = KINDS[kind]
    xx, xy, yy = derivatives(profile, POINTS)[1].T
    by_x, by_y = (
        (derivatives(profile, POINTS + step)[0] - derivatives(profile, POINTS - step)[0])[:, 1:] / (2.0 * STEP)
        for step in STEP * np.eye(2)
    )
    size = max(1.0, np.abs(by_x).max(), np.abs(by_y).max())
    for found, wanted in ((xx, by_x[:, 0]), (xy, by_x[:, 1]), (xy, by_y[:, 0]), (yy, by_y[:, 1])):
        np.testing.assert_allclose(found, wanted, atol=1e-6 * size)


@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_at_the_vertex_are_those_of_the_kernel(kind: str) -> None:
    profile, _ = KINDS[kind]
    first, second = derivatives(profile, np.zeros((1, 2)))
    np.testing.assert_allclose(vertex_derivatives(profile), [*first[0, 1:], *second[0]], rtol=1e-12, atol=1e-11)


def test_phases_of_one_table_do_not_mix() -> None:
    profiles = [profile for profile, _ in KINDS.values()]
    together = phase_table(profiles)
    for number, profile in enumerate(profiles):
        alone = phase_table([profile])
        for x, y in POINTS[:5]:
            assert phase_at(together, number, x, y) == phase_at(alone, 0, x, y)


def test_a_hologram_of_distant_points_is_a_grating() -> None:
    """Light from the side, made parallel to the axis."""
    angle = math.radians(20.0)
    far = (1e9 * math.sin(angle), 0.0, -1e9 * math.cos(angle)), (0.0, 0.0, -1e9)
    found, _ = derivatives(hologram_profile(far, (True, True), WAVE_NUMBER), POINTS)
    wanted = WAVE_NUMBER * math.sin(angle) * POINTS[:, 0]
    np.testing.assert_allclose(found[:, 0], wanted, atol=1e-8 * WAVE_NUMBER)


@pytest.mark.parametrize(("nx", "ny"), [(4, 4), (5, 9), (33, 6)])
def test_a_grid_is_met_at_its_samples(nx: int, ny: int) -> None:
    values, spacing = RNG.normal(size=(nx, ny)), np.array([0.3, 0.2])
    profile = grid_profile(values, spacing)
    first, last = grid_bounds_mm(profile)
    np.testing.assert_allclose(first, -last, rtol=1e-14)
    x, y = np.meshgrid(*(f + s * np.arange(n) for f, s, n in zip(first, spacing, (nx, ny), strict=True)), indexing="ij")
    found, _ = derivatives(profile, np.column_stack([x.ravel(), y.ravel()]))
    np.testing.assert_allclose(found[:, 0], values.ravel(), atol=1e-12)


def test_a_grid_is_smooth_up_to_its_second_derivatives() -> None:
    profile = grid_profile(RNG.normal(size=(9, 8)), 0.5)
    beside = 1e-9
    knots = np.array([(-2.0 + 0.5 * i, 0.11) for i in range(1, 8)] + [(0.13, -1.75 + 0.5 * j) for j in range(1, 7)])
    away = np.array([(beside, 0.0)] * 7 + [(0.0, beside)] * 6)
    (before, bent_before), (after, bent_after) = (derivatives(profile, knots + each) for each in (-away, away))
    np.testing.assert_allclose(before, after, atol=1e-6)
    np.testing.assert_allclose(bent_before, bent_after, atol=1e-5)
    assert np.abs(bent_before).max() > 1.0


def test_the_rounding_of_a_grid_is_no_tilt_of_its_vertex() -> None:
    x = np.linspace(-3.0, 3.0, 64)
    for phase in (-1e4 * (x[:, None] ** 2 + x**2), -50.0 * np.cos(x[:, None]) * np.cos(x)):
        by_x, by_y, xx, xy, yy = vertex_derivatives(grid_profile(phase, 6.0 / 63.0))
        assert by_x == by_y == xy == 0.0
        assert xx == yy


def test_a_border_belongs_to_the_zone_inside_it() -> None:
    """A ray at the kink takes the slope of one zone, never a mean."""
    at = np.array([[0.8, 0.0], [np.nextafter(0.8, 1.0), 0.0], [0.0, -1.4], [0.0, -np.nextafter(1.4, 2.0)]])
    found, _ = derivatives(zones_profile(ZONES), at)
    wanted = [-20.0 * 0.8 + 0.75 * 0.8**3, 1.6 * 0.8, -1.6 * 1.4, 8.0 * 0.7**4 * 1.4**3 - 3.0 * 0.7**6 * 1.4**5]
    np.testing.assert_allclose([found[0, 1], found[1, 1], found[2, 2], found[3, 2]], wanted, rtol=1e-12)
