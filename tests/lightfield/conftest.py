"""Small light-field cameras with the double Gauss, and the raw images they would record, made by hand."""

from collections.abc import Callable

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.scene import Scene, loads, solved

CAMERA = """
schema_version = 1

[camera]
focus_mm = 500.0
lens = {{ file = "{lens}", stop_semi_diameter_mm = 4.77 }}

[camera.mla]
layout = "{layout}"
count = [{columns}, {rows}]
pitch_mm = 0.125
focal_length_mm = 0.5
index = 1.5
thickness_mm = 0.3
curved_side = "{curved_side}"

[camera.sensor]
pixels = [150, 130]
pixel_mm = 0.0125

[transport]
samples = 8
split = "transmit"
threads = 1
"""


@pytest.fixture
def camera() -> Callable[..., Scene]:
    """Build a solved scene of a camera with 14 × 12 lenslets and nothing before it."""

    def build(layout: str = "square", curved_side: str = "lens", columns: int = 14, rows: int = 12) -> Scene:
        lens = asset_path("lenses/double_gauss_50mm.toml").as_posix()
        text = CAMERA.format(lens=lens, layout=layout, curved_side=curved_side, columns=columns, rows=rows)
        return solved(loads(text))

    return build


@pytest.fixture
def image_of() -> Callable[..., lf.Image]:
    """Build an image of a scene from its pixels, (H, W) or (H, W, wavelengths)."""

    def build(scene: Scene, mean: np.ndarray, stderr: np.ndarray | None = None) -> lf.Image:
        mean = mean.reshape(*mean.shape[:2], -1).astype(np.float64)
        stderr = np.zeros_like(mean) if stderr is None else stderr.reshape(mean.shape)
        ledger = lf.Ledger(unit="m² sr", emitted=1.0, escaped=1.0)
        return lf.Image(mean, stderr, scene, ledger, 1.0, scene.transport.replicates, 8.0, "by hand")

    return build
