"""Fog and hot gas that bend light: both methods against the same fog without a field, and against a black body."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from tests.cameras import close_up_camera
from tests.renders import unchecked
from tests.validation.field_scenes import Tables, box_of, grid_of, nodes
from tests.validation.test_kirchhoff import HOT

pytestmark = pytest.mark.filterwarnings("ignore::lfmesh.errors.CoarseFieldWarning")

SIGMAS = 4.0
"""Level of each z-test: 6e-5."""

FOG: Tables = {
    "position_mm": (0.5, -0.3, -40.0), "rotation_deg": (10.0, 25.0, 40.0), "absorption_per_mm": 0.015,
    "scattering_per_mm": 0.05,
}  # fmt: skip
WALL: Tables = {
    "shape": {"kind": "plane", "width_mm": 30.0, "height_mm": 30.0}, "position_mm": (20.0, 0.0, -40.0),
    "rotation_deg": (0.0, -90.0, 0.0), "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0},
}  # fmt: skip
BALL: Tables = {
    "shape": {"kind": "sphere", "radius_mm": 3.0}, "position_mm": (1.0, 0.0, -41.0), "material": {"reflectance": 0.7}
}  # fmt: skip
LIT: dict[str, Tables] = {
    "by a lamp in it": {"lights": [{"kind": "point", "position_mm": (4.0, 1.0, -41.0), "power_w": 1.0}]},
    "by a wall": {"targets": [WALL]},
    "by a wall, a matt ball in it": {"targets": [WALL, BALL]},
}


def light(scene: lf.Scene, method: str, samples: int, seed: int) -> tuple[float, float]:
    """Return the sum of the picture and its standard error."""
    settings = {"method": method, "samples": samples, "replicates": 16, "seed": seed}
    image = unchecked(scene.changed({f"transport.{key}": value for key, value in settings.items()}))
    assert abs(image.ledger.imbalance) < 1e-12
    return float(image.mean.sum()), float(np.sqrt((image.stderr**2).sum()))


def close_up(bands: tuple[Tables, ...] | None = None, **tables: Any) -> lf.Scene:
    """Return a plenoptic camera before the tables of a scene."""
    camera = close_up_camera()
    sensor = camera["sensor"] | {"bands": bands}
    return lf.Scene(camera=camera | {"sensor": sensor}, transport={"split": "transmit", "threads": 1}, **tables)


@cache
def without_field(case: str) -> tuple[float, float]:
    return light(close_up(media=[box_of(18.0) | FOG], **LIT[case]), "adjoint", 256, 9)


RUNS = [
    ("by a lamp in it", "forward", 4096),
    ("by a wall, a matt ball in it", "adjoint", 1024),
    pytest.param("by a wall", "forward", 65536, marks=pytest.mark.long),
    pytest.param("by a wall, a matt ball in it", "forward", 65536, marks=pytest.mark.long),
]


@pytest.mark.parametrize(("case", "method", "samples"), RUNS)
def test_fog_that_bends_no_ray_is_as_bright_as_without_its_index(case: str, method: str, samples: int) -> None:
    """A field stops shadow packets, so that all light takes other ways than without it."""
    found, error = light(close_up(media=[box_of(18.0, index=1.0) | FOG], **LIT[case]), method, samples, 8)
    truth, its_error = without_field(case)
    assert np.hypot(error, its_error) < 0.015 * truth
    assert abs(found - truth) < SIGMAS * np.hypot(error, its_error)


def hot_gas(folder: Path, rise: float) -> lf.Scene:
    """Return thick hot gas in a cold room, whose index rises by `rise` behind its faces."""
    along = np.abs(nodes(25))
    inside = (0.5 * (1.0 - np.tanh((along - 7.0) / 1.5))).prod(axis=-1)
    gas = grid_of(folder, 1.0, index=1.0 + rise * inside, absorption_per_mm=0.4 * inside)
    gas |= HOT | {"position_mm": (0.0, 0.0, -45.0), "rotation_deg": (0.0, 0.0, 0.0)}
    return seen_hot(media=[gas]).in_folder(folder)


def seen_hot(**tables: Any) -> lf.Scene:
    """Return a camera for a narrow band before the tables of a scene."""
    return close_up(({"name": "R", "center_nm": 650.0, "fwhm_nm": 0.02},), **tables)


@pytest.mark.parametrize(
    ("method", "samples", "sigma"),
    [("adjoint", 256, 2e-3), pytest.param("forward", 1024, 0.025, marks=pytest.mark.long)],
)
def test_thick_hot_gas_that_bends_light_is_black(method: str, samples: int, sigma: float, tmp_path: Path) -> None:
    """Its emission grows as n², which the way out takes away again; 1.1² would be seen at once."""
    shape = {"kind": "plane", "width_mm": 60.0, "height_mm": 60.0}
    body = {"shape": shape, "position_mm": (0.0, 0.0, -45.0), "material": HOT | {"reflectance": 0.0}}
    black, of_black = light(seen_hot(targets=[body]), "adjoint", 256, 5)
    found, error = light(hot_gas(tmp_path, 0.1), method, samples, 5)
    error = float(np.hypot(error, of_black))
    assert error < sigma * black
    # Through 15 mm of gas, 0.3 % of a background would be seen.
    assert 0.994 * black - SIGMAS * error < found < black + SIGMAS * error
