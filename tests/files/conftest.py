"""Small images made by hand, so that files and words are tested without a render."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.scene import Scene, loads, solved
from tests.cameras import bench_camera

PLENOPTIC = f"""name = "test bench"{bench_camera(8, 6)}[[targets]]
shape = {{ kind = "plane", width_mm = 100.0, height_mm = 100.0 }}
position_mm = [0.0, 0.0, -500.0]

[[lights]]
kind = "point"
position_mm = [100.0, -100.0, -50.0]
power_w = 1.0

[transport]
samples = 64
replicates = 8
"""


@pytest.fixture
def scene() -> Scene:
    """A light-field camera of 8 × 6 lenslets with 10 × 10 pixels each."""
    return solved(loads(PLENOPTIC))


@pytest.fixture
def image_of(scene: Scene) -> Callable[..., lf.Image]:
    """Build an image of a scene (default: the one above) with noisy pixels and a ledger that closes."""

    def build(of: Scene = scene, **changes: Any) -> lf.Image:
        width, height = of.camera.sensor.pixels
        rng = np.random.default_rng(5)
        shape = (height, width, len(of.transport.wavelengths_nm))
        mean = rng.uniform(1.0, 2.0, shape) * 1e-12
        values: dict[str, Any] = {
            "mean": mean,
            "stderr": 0.1 * mean,
            "scene": of,
            "ledger": lf.Ledger(
                unit="m² sr",
                emitted=2.0,
                absorbed={"stop": 1.25, "targets[0]": 0.5},
                escaped=0.25,
                packets=4_100_000,
                events=70_000_000,
                reached_target=0.5,
                lit=0.25,
            ),
            "seconds": 7.0,
            "replicates": of.transport.replicates,
            "samples": float(of.transport.samples),
            "engine": "mesh engine",
        }
        return lf.Image(**{**values, **changes})

    return build
