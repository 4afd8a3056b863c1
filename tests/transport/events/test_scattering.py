"""Scattering models: what is drawn has the density that is told, and carries what the BRDF says.

Every model is put to the same tests. A new one is one line in MATERIALS.
"""

from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from lfmesh.kernel import kernel
from lfmesh.optics.scattering import tangents
from lfmesh.scene.targets import Material
from lfmesh.transport.events.scattering import Point, albedo, density, evaluate, sample
from lfmesh.transport.tables.scattering import ScatteringTables, scattering_tables

Array = NDArray[np.float64]

MATERIALS = {"matt": Material(reflectance=0.7), "black": Material(reflectance=0.0)}
"""And after them emission, which no scene states."""

NAMES = [*MATERIALS, "emission"]
TABLES = scattering_tables(list(MATERIALS.values()), (500.0, 600.0))
WAVE = 1
TEXEL = 0.6
NORMALS = [np.array([0.0, 0.0, 1.0]), np.array([0.48, -0.6, -0.64])]
STEEPNESS = [1.0, 0.5, 0.05]
"""Cosines of incidence."""

LEVEL = 1e-3
"""Chance that the chi-square tests of this file fail though all is right, shared by all of them (Bonferroni)."""

DRAWN = 20_000
COSINES, AZIMUTHS = 10, 12
"""Bins of the directions drawn."""


def direction(normal: Array, cosine: float | Array, azimuth: float | Array) -> Array:
    """Return unit directions at an angle from the normal."""
    u, v = np.reshape(tangents(*normal), (2, 3))
    cosine, azimuth = np.broadcast_arrays(cosine, azimuth)
    sine = np.sqrt(1.0 - cosine**2)
    parts = (sine * np.cos(azimuth), sine * np.sin(azimuth), cosine)
    return np.asarray(sum(part[..., None] * axis for part, axis in zip(parts, (u, v, normal), strict=True)))


def point_of(name: str, normal: Array) -> Point:
    return Point(3, 1.0, 2.0, 3.0, *map(float, normal), NAMES.index(name), TEXEL)


def cases() -> Iterator[tuple[Point, Array, Array]]:
    """Yield points of every model, their normals, and directions in which light arrives there."""
    for name in NAMES:
        for normal in NORMALS:
            for cosine in STEEPNESS:
                yield point_of(name, normal), normal, -direction(normal, cosine, 0.7)


@kernel
def tell(scattering: ScatteringTables, point: Point, ways: Array, way: Array, told: Array) -> None:
    """Write density and BRDF of directions (n, 3) into `told` (n, 2)."""
    for i in range(len(ways)):
        ox, oy, oz = ways[i]
        told[i, 0] = density(scattering, point, WAVE, way[0], way[1], way[2], ox, oy, oz)
        told[i, 1] = evaluate(scattering, point, WAVE, way[0], way[1], way[2], ox, oy, oz)


@kernel
def draw(scattering: ScatteringTables, point: Point, way: Array, numbers: Array, drawn: Array) -> None:
    """Write directions, and what each carries, into `drawn` (n, 4)."""
    for i in range(len(numbers)):
        u, v = numbers[i]
        drawn[i] = sample(scattering, point, WAVE, way[0], way[1], way[2], u, v)


def told(point: Point, way: Array, ways: Array) -> tuple[Array, Array]:
    both = np.empty((ways[..., 0].size, 2))
    tell(TABLES, point, np.ascontiguousarray(ways.reshape(-1, 3)), way, both)
    return both[:, 0].reshape(ways.shape[:-1]), both[:, 1].reshape(ways.shape[:-1])


def drawn(point: Point, way: Array, seed: int) -> tuple[Array, Array]:
    """Return DRAWN directions, and what each carries of what arrived."""
    rows = np.empty((DRAWN, 4))
    draw(TABLES, point, way, np.random.default_rng(seed).random((DRAWN, 2)), rows)
    return rows[:, :3], rows[:, 3]


def over_the_side(normal: Array) -> tuple[Array, Array]:
    """Return directions all over the side of a normal, and solid angles: Gauss-Legendre, and evenly in azimuth."""
    x, w = np.polynomial.legendre.leggauss(64)
    azimuth = 2.0 * np.pi * (np.arange(64) + 0.5) / 64
    ways = direction(normal, 0.5 * (x[:, None] + 1.0), azimuth)
    return ways, np.broadcast_to(0.5 * w[:, None] * 2.0 * np.pi / 64, ways.shape[:2])


def test_the_density_of_directions_integrates_to_one() -> None:
    for point, normal, way in cases():
        ways, solid_angle = over_the_side(normal)
        assert (told(point, way, ways)[0] * solid_angle).sum() == pytest.approx(1.0, rel=1e-10), point


def test_nothing_is_drawn_on_the_other_side() -> None:
    for point, normal, way in cases():
        assert not told(point, way, -over_the_side(normal)[0])[0].any(), point
        assert (drawn(point, way, 1)[0] @ normal >= -1e-15).all(), point


def test_directions_that_are_drawn_have_their_density() -> None:
    """Chi-square tests over cells of equal solid angle; the density is integrated over each by 8 x 8 midpoints."""
    p = []
    for seed, (point, normal, way) in enumerate(cases()):
        fine = (np.arange(8 * COSINES) + 0.5) / (8 * COSINES)
        azimuth = 2.0 * np.pi * (np.arange(8 * AZIMUTHS) + 0.5) / (8 * AZIMUTHS)
        expected = told(point, way, direction(normal, fine[:, None], azimuth))[0]
        expected = expected.reshape(COSINES, 8, AZIMUTHS, 8).sum(axis=(1, 3)).ravel()
        ways = drawn(point, way, seed)[0]
        u, v = np.reshape(tangents(*normal), (2, 3))
        turn = np.arctan2(ways @ v, ways @ u) / (2.0 * np.pi) % 1.0
        cell = np.minimum((ways @ normal) * COSINES, COSINES - 1).astype(int) * AZIMUTHS + (turn * AZIMUTHS).astype(int)
        counts = np.bincount(cell, minlength=COSINES * AZIMUTHS)
        p.append(stats.chisquare(counts, DRAWN * expected / expected.sum()).pvalue)
    assert min(p) > LEVEL / len(p)


def test_a_direction_carries_brdf_and_cosine_over_its_density() -> None:
    for point, normal, way in cases():
        ways, carried = drawn(point, way, 2)
        chance, brdf = told(point, way, ways)
        np.testing.assert_allclose(carried * chance, brdf * (ways @ normal), rtol=1e-12, atol=1e-300)


def test_the_albedo_is_the_share_of_light_that_all_directions_carry() -> None:
    for point, normal, way in cases():
        ways, solid_angle = over_the_side(normal)
        scattered = (told(point, way, ways)[1] * (ways @ normal) * solid_angle).sum()
        assert scattered == pytest.approx(albedo(TABLES, point, WAVE, *way), rel=1e-10, abs=1e-300), point
        assert scattered <= 1.0


def test_light_goes_either_way_alike() -> None:
    """Helmholtz reciprocity, by which adjoint and forward see the same target."""
    random = np.random.default_rng(3)
    for point, normal, _ in cases():
        one, other = direction(normal, random.random(2), 2.0 * np.pi * random.random(2))
        there = evaluate(TABLES, point, WAVE, *-one, *other)
        assert there == pytest.approx(evaluate(TABLES, point, WAVE, *-other, *one), rel=1e-12), point


def test_a_matt_target_scatters_by_lamberts_law() -> None:
    """BRDF = albedo / π; its texture dims it."""
    normal = NORMALS[1]
    for name, reflectance in (("matt", 0.7), ("black", 0.0), ("emission", 1.0)):
        point = point_of(name, normal)
        for ways in (direction(normal, 0.9, 1.0), direction(normal, 0.1, 4.0)):
            brdf = evaluate(TABLES, point, WAVE, *-ways, *direction(normal, 0.3, 2.0))
            assert brdf == pytest.approx(reflectance * TEXEL / np.pi, rel=1e-15)


def test_what_is_black_is_known_to_be() -> None:
    assert dict(zip(NAMES, TABLES.models["black"], strict=True)) == {"matt": False, "black": True, "emission": False}
