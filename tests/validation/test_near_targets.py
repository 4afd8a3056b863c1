"""Targets so near to the lens that most of their light meets it at grazing angles, beside a far one."""

from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.scene import load_lens

FAR: dict[str, Any] = {
    "shape": {"kind": "plane", "width_mm": 30.0, "height_mm": 30.0},
    "position_mm": [0.0, -200.0, -500.0],
    "material": {"reflectance": 0.0},
}
"""Beside the field and black: it only makes the distances of targets differ."""


@pytest.mark.parametrize("distance_mm", [0.02, 0.2, 0.9, 3.0, 4.1, 20.0])
def test_forward_equals_adjoint_for_a_target_close_to_the_lens(distance_mm: float) -> None:
    """A z-test of the whole light at 3.5 sigma, for six distances a level of 0.3 %."""
    near = {
        "shape": {"kind": "plane", "width_mm": 10.0, "height_mm": 10.0},
        "position_mm": [8.0, 4.0, -distance_mm],
        "material": {"radiance_w_m2_sr": 1.0},
    }
    lens = load_lens(asset_path("lenses/double_gauss_50mm.toml"))
    camera = lf.Camera(lens=lens, focus_mm=500.0, sensor=lf.Sensor(pixels=(12, 12), pixel_mm=1.5))
    sums, errors = [], []
    for method, samples in (("adjoint", 256), ("forward", 4096)):
        transport = {"method": method, "samples": samples, "replicates": 16, "split": "transmit", "seed": 4}
        image = lf.render(lf.Scene(camera=camera, targets=[near, FAR], transport=transport))
        sums.append(float(image.mean.sum()))
        errors.append(float(np.sqrt((image.stderr**2).sum())))
    assert max(errors) < 0.05 * sums[0], (sums, errors)
    assert abs(sums[0] - sums[1]) < 3.5 * np.hypot(*errors), (sums, errors)
