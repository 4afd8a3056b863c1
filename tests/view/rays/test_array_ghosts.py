"""Ghosts that the array reflects, by sequence: against launched rays of the mesh engine, and closed forms."""

import math
from typing import Any

import numpy as np
import pytest
from scipy import stats

import lfmesh as lf
from lfmesh.view.rays.exact_ghosts import ExactGhosts, exact_ghosts
from lfmesh.view.rays.launch import from_field_point
from tests.instances import instances

SEEDS, LAUNCHED = 8, 1000
LEVEL = 1e-3
"""Of all comparisons together."""

ARRAYS: dict[str, dict[str, Any]] = {
    "square": {},
    "hexagonal, curved side to the sensor": {"layout": "hexagonal", "curved_side": "sensor", "pitch_mm": 0.09},
    "concave": {"focal_length_mm": -0.8},
    "two types, tilted": {"focal_length_mm": (0.6, 1.0), "pose": lf.Pose(tilt_deg=(1.5, -1.0, 4.0))},
    "cylinders": {"cylinder_axis": "y", "conic": -0.5},
    "lenslets on both faces": {"focal_length_mm": None, "radius_mm": 0.4, "back": lf.BackFace(radius_mm=0.6)},
}
POINT = (2.0, -1.0, -180.0)
"""Out of focus, so that many lenslets are lit."""


def camera(**array: Any) -> lf.Camera:
    surfaces = (
        lf.Surface(radius_mm=30.0, thickness_mm=4.0, index=1.6, semi_diameter_mm=6.0, stop=True),
        lf.Surface(radius_mm=-40.0, semi_diameter_mm=6.0),
    )
    keys = {"count": (60, 60), "pitch_mm": 0.125, "focal_length_mm": 0.6, "index": 1.7, "thickness_mm": 0.3} | array
    sensor = lf.Sensor(pixels=(70, 70), pixel_mm=0.125, distance_mm=0.7)
    return lf.Camera(lens=lf.Lens(surfaces=surfaces), focus_mm=300.0, mla=lf.MicrolensArray(**keys), sensor=sensor)


def of_array(row: Any, *, alone: bool) -> bool:
    """Tell whether the array is among a ghost's mirrors, and whether it is the only one."""
    count = sum(name.startswith("MLA") for name in row.mirrors)
    return count == 2 if alone else count == 1


def powers_by_rays(world: lf.World, exact: ExactGhosts) -> np.ndarray:
    """Return the power of ghosts between the array's faces, and of those between array and lens, launch by launch."""
    groups = [[row.words for row in exact.ghosts if of_array(row, alone=alone)] for alone in (True, False)]
    found = []
    for seed in range(SEEDS):
        rays = from_field_point(world, POINT, LAUNCHED, aim="lens", seed=seed, weight_cutoff=1e-4)
        brought = np.where(rays.arrives, rays.end_power, 0.0)
        found.append([float(brought[rays.of_sequences(words)].sum()) for words in groups])
    return np.array(found)


@pytest.mark.parametrize(
    "name", instances(ARRAYS, long=["square", "concave", "cylinders", "hexagonal, curved side to the sensor"])
)
def test_ghosts_of_the_array_have_the_power_that_rays_find(name: str) -> None:
    world = lf.build(lf.Scene(camera=camera(**ARRAYS[name])))
    exact = exact_ghosts(world, POINT)
    found = powers_by_rays(world, exact)
    groups = [[row for row in exact.ghosts if of_array(row, alone=alone)] for alone in (True, False)]
    truth = np.array([sum(row.power for row in rows) for rows in groups])
    stated = np.array([sum(row.error for row in rows) for rows in groups])
    error = np.std(found, axis=0, ddof=1) / math.sqrt(SEEDS)
    assert (error < [0.02 * truth[0], 0.1 * truth[1]]).all()
    assert (stated < 0.02 * truth).all()
    limit = stats.t.isf(0.5 * LEVEL / (2 * len(ARRAYS)), SEEDS - 1)
    assert (np.abs(found.mean(axis=0) - truth) < limit * error + stated).all()


def test_a_flat_plate_reflects_by_fresnel() -> None:
    """Lenslets of next to no curvature, light next to the axis: reflectances at normal incidence."""
    index = 1.7
    scene = lf.Scene(camera=camera(focal_length_mm=1e6, index=index)).changed({"camera.lens.f_number": 60.0})
    exact = exact_ghosts(lf.build(scene), (0.0, 0.0, -300.0))
    of_plate = ((index - 1.0) / (index + 1.0)) ** 2
    found = {row.mirrors: row.power / exact.image.power for row in exact.ghosts}
    assert found["MLAf", "MLAc"] == pytest.approx(of_plate**2, rel=2e-3)
