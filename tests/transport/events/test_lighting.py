"""Lights light a place as their packets do: what a point is told and what packets bring there are the same watts."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from lfmesh.kernel import kernel
from lfmesh.transport.events.lighting import emitted, illuminate
from lfmesh.transport.packets.random import derived, run_key
from lfmesh.transport.tables.lights import DIRECTIONAL
from lfmesh.transport.tables.tables import ObjectTables
from lfmesh.transport.world import build

Array = NDArray[np.float64]

LENS = {"surfaces": [{"radius_mm": 20.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 5.0},
                     {"radius_mm": -20.0, "thickness_mm": 1.0, "semi_diameter_mm": 5.0},
                     {"stop": True, "semi_diameter_mm": 4.0}]}  # fmt: skip
LIGHTS: dict[str, dict[str, Any]] = {
    "point": {"kind": "point", "position_mm": [30.0, 10.0, -40.0], "power_w": 3.0},
    "point among the targets": {"kind": "point", "position_mm": [1.0, 0.5, -57.0], "power_w": 3.0},
    "directional": {"kind": "directional", "direction": [-0.4, 0.3, -1.0], "irradiance_w_m2": 2.0},
    "disk": {"kind": "disk", "position_mm": [15.0, 5.0, -45.0], "direction": [-1.0, 0.0, -1.0],
             "radius_mm": 6.0, "power_w": 3.0},
    "disk whose back is turned to a part": {"kind": "disk", "position_mm": [1.5, 0.0, -57.0],
                                            "direction": [-1.0, 0.0, 0.0], "radius_mm": 1.0, "power_w": 3.0},
}  # fmt: skip
SIDE = 3.0
"""Half the side of the square that is lit, mm, in the plane z = 0 of the object frame."""

COUNT = 100_000
LEVEL = 1e-3
"""Chance that this file fails though all is right, shared by its comparisons: four quarters of the square a light."""


def tables_of(light: dict[str, Any]) -> ObjectTables:
    """A sphere, so that packets are aimed at all that is round the square, and the camera far off."""
    ball = {"shape": {"kind": "sphere", "radius_mm": 5.0}, "position_mm": [0.0, 0.0, -60.0]}
    scene = lf.Scene(camera={"focus_mm": 60.0, "lens": LENS, "sensor": {"pixels": [4, 4], "pixel_mm": 0.1}},
                     targets=[ball], lights=[light])  # fmt: skip
    return build(scene).tables.objects


@kernel
def asked(lights: NDArray[np.void], places: Array, key: np.uint64, told: Array) -> None:
    """Write what points of the plane z = 0 are told: irradiance of its front, of its back, W/m²."""
    for i in range(len(places)):
        _, _, uz, _, irradiance = illuminate(lights[0], places[i, 0], places[i, 1], 0.0, derived(key, i), 5)
        told[i] = irradiance * abs(uz)


@kernel
def sent(objects: ObjectTables, key: np.uint64, rays: Array) -> None:
    """Write packets: start, direction, share of their power."""
    for i in range(len(rays)):
        rays[i] = emitted(objects, objects.lights[0], derived(key, i))


def quarters(x: Array, y: Array, power: Array) -> Array:
    """Return what falls on each quarter of the square, (4, n)."""
    inside = (np.abs(x) < SIDE) & (np.abs(y) < SIDE)
    return np.array([power * (inside & ((x > 0) == right) & ((y > 0) == up)) for right in (0, 1) for up in (0, 1)])


@pytest.mark.parametrize("name", LIGHTS)
def test_packets_bring_what_points_are_told(name: str) -> None:
    """Watts on the quarters of a square, by t-tests of two estimates."""
    objects = tables_of(LIGHTS[name])
    places = np.random.default_rng(4).uniform(-SIDE, SIDE, (COUNT, 2))
    told, rays = np.empty(COUNT), np.empty((COUNT, 7))
    asked(objects.lights, places, run_key(1), told)
    sent(objects, run_key(2), rays)
    by_points = quarters(*places.T, told * (2.0 * SIDE) ** 2 * 1e-6)
    light = objects.lights[0]
    watts = light["power"] * (np.pi * objects.lit_radius**2 * 1e-6 if light["kind"] == DIRECTIONAL else 1.0)
    p, d, share = rays[:, :3], rays[:, 3:6], rays[:, 6]
    np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1.0, rtol=1e-14)
    t = -p[:, 2] / d[:, 2]
    by_packets = quarters(*(p[:, :2] + t[:, None] * d[:, :2]).T, watts * share * (t > 0.0))
    for one, other in zip(by_points, by_packets, strict=True):
        # Three standard errors see ten per cent.
        assert 3.0 * np.hypot(stats.sem(one), stats.sem(other)) < 0.1 * other.mean()
        assert stats.ttest_ind(one, other, equal_var=False).pvalue > LEVEL / (4 * len(LIGHTS))
