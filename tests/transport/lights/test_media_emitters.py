"""Emitting media as light sources: the directions towards their points have the density that is stated."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lfmesh.geometry.ray import Ray
from lfmesh.kernels.decorators import kernel
from lfmesh.transport.events.volume import Line
from lfmesh.transport.lights.media_emitters import density, point_of_media
from lfmesh.transport.packets.random import derived, run_key, uniform
from lfmesh.transport.tables.volumes import Volumes
from tests.transport.events.test_volume import volumes_of

Array = NDArray[np.float64]

COUNT = 40_000


@kernel
def directions(volumes: Any, x: float, y: float, z: float, key: np.uint64, found: Array) -> None:
    """Write unit directions towards random points of media, and the density of each."""
    for i in range(len(found)):
        own = derived(key, i)
        numbers = uniform(own, 0), uniform(own, 1), uniform(own, 2), uniform(own, 3)
        _, px, py, pz = point_of_media(volumes, Line(Ray(x, y, z, 0.0, 0.0, 1.0), 0, 0, None, 0), numbers)
        dx, dy, dz = px - x, py - y, pz - z
        r = np.sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx / r, dy / r, dz / r
        found[i, 0], found[i, 1], found[i, 2] = dx, dy, dz
        found[i, 3] = density(volumes, Line(Ray(x, y, z, dx, dy, dz), 0, 0, None, 0))


@kernel
def densities(volumes: Any, x: float, y: float, z: float, ways: Array, found: Array) -> None:
    """Write the density of directions."""
    for i in range(len(found)):
        found[i] = density(volumes, Line(Ray(x, y, z, ways[i, 0], ways[i, 1], ways[i, 2]), 0, 0, None, 0))


@pytest.fixture(scope="module")
def volumes(tmp_path_factory: pytest.TempPathFactory) -> Volumes:
    """A turned grid of uneven voxels, some of them dark, a ball beside it, and one that is dark altogether."""
    folder: Path = tmp_path_factory.mktemp("grids")
    random = np.random.default_rng(5)
    glow = random.uniform(0.0, 1.0, (5, 4, 6)) ** 3 * (random.random((5, 4, 6)) < 0.6)
    np.savez(folder / "g.npz", emission_w_mm3_sr=glow, spacing_mm=[2.0, 3.0, 1.5])
    return volumes_of(
        {"grid": {"file": "g.npz", "interpolation": "constant"}, "position_mm": [0.0, 0.0, -60.0],
         "rotation_deg": [20.0, -40.0, 10.0]},
        {"bounds": {"kind": "sphere", "radius_mm": 3.0}, "position_mm": [14.0, 0.0, -60.0], "emission_w_mm3_sr": 0.4},
        {"bounds": {"kind": "sphere", "radius_mm": 9.0}, "position_mm": [0.0, 20.0, -60.0], "absorption_per_mm": 0.4},
        folder=folder,
    )  # fmt: skip


@pytest.mark.parametrize("place", [(0.0, 0.0, -60.0), (5.0, -2.0, -55.0), (30.0, 20.0, -40.0), (14.0, 0.0, -60.0)])
def test_directions_to_media_have_the_density_that_is_stated(volumes: Volumes, place: tuple[float, ...]) -> None:
    """In, beside and far from them: moments of directions against those of even directions times the density.

    Nine z-tests a place, 36 in all, at a level of 0.001 together.
    """
    drawn = np.empty((COUNT, 4))
    directions(volumes, *place, run_key(3), drawn)
    assert (drawn[:, 3] > 0.0).all()
    ways = np.random.default_rng(9).normal(size=(20 * COUNT, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    told = np.empty(len(ways))
    densities(volumes, *place, ways, told)

    def moments(d: Array) -> Array:
        x, y, z = d.T
        return np.array([np.ones_like(x), x, y, z, x * y, y * z, x * z, x * x - y * y, (x > y) * (y > z)])

    by_points, by_density = moments(drawn[:, :3]), moments(ways) * told * 4.0 * np.pi
    error = np.hypot(by_points.std(axis=1) / np.sqrt(COUNT), by_density.std(axis=1) / np.sqrt(len(ways)))
    z = (by_points.mean(axis=1) - by_density.mean(axis=1)) / error
    assert (np.abs(z) < 4.2).all(), z
