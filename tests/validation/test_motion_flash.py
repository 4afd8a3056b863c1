"""A short flash shows a scene in motion as a still one, also by light that is traced from its sources."""

from typing import Any

import numpy as np
import pytest
from scipy import stats

import lfmesh as lf
from tests.renders import unchecked
from tests.validation.motion_scenes import FOCUS_MM, camera

LEVEL = 1e-3

FLASH: dict[str, Any] = {"duration_s": 0.01, "shutter": [[0.0, 1.0], [1e-5, 1.0], [1.001e-5, 0.0], [0.01, 0.0]]}

WALL = {"shape": {"kind": "plane", "width_mm": 30.0, "height_mm": 30.0}, "position_mm": (0.0, 0.0, -FOCUS_MM)}
BALL = {"refractor": {"shape": {"kind": "sphere", "radius_mm": 2.0}, "index": 1.5}, "position_mm": (0.0, 0.0, -495.0)}
LAMP = {"kind": "point", "position_mm": (0.0, 20.0, -480.0), "power_w": 1.0}
DUST: dict[str, Any] = {
    "count": 20, "bounds": {"kind": "box", "size_mm": [6.0, 3.0, 1.0]}, "position_mm": [0.0, 0.0, -FOCUS_MM],
    "intensity_w_sr": 1e-3, "samples": 400,
}  # fmt: skip
FLOW = {"frame_time_s": 1.0, "displacement": {"kind": "uniform", "vector_mm": [20.0, 0.0, 0.0]}}
DRIFT = {"velocity_mm_s": (20.0, 0.0, 0.0)}

SCENES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    # Parts of the scene at rest and in motion.
    "a ball of glass": (
        {"targets": [WALL, BALL], "lights": [LAMP]}, {"targets": [WALL, BALL | {"motion": DRIFT}], "lights": [LAMP]}
    ),
    "a lamp": ({"targets": [WALL], "lights": [LAMP]}, {"targets": [WALL], "lights": [LAMP | {"motion": DRIFT}]}),
    "particles": ({"particles": [DUST]}, {"particles": [DUST | FLOW]}),
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "method", "samples"),
    [("a ball of glass", "adjoint", 64), ("a lamp", "adjoint", 64), ("a lamp", "forward", 4096),
     ("particles", "adjoint", 8)],
)  # fmt: skip
def test_a_flash_shows_the_scene_as_it_was(name: str, method: str, samples: int) -> None:
    """In a hundredth of a millisecond nothing moves by more than 0.2 µm. Sums of columns, by Welch's z."""
    rest, moving = SCENES[name]
    settings = {"split": "transmit", "samples": samples, "replicates": 8, "method": method}
    still = unchecked(lf.Scene(camera=camera(8, 6, pixel_mm=0.1), transport=settings, **rest))
    flash = unchecked(
        lf.Scene(camera=camera(8, 6, pixel_mm=0.1), transport=settings | {"seed": 9}, exposure=FLASH, **moving)
    )
    sums = [np.append(image.mean.sum(axis=(0, 2)), image.mean.sum()) for image in (still, flash)]
    squares = [np.square(image.stderr) for image in (still, flash)]
    errors = [np.sqrt(np.append(each.sum(axis=(0, 2)), each.sum())) for each in squares]
    assert max(error[-1] / total[-1] for error, total in zip(errors, sums, strict=True)) < 0.02
    z = np.abs(sums[0] - sums[1]) / np.hypot(*errors)
    assert (z < stats.t.ppf(1.0 - LEVEL / (2 * len(z)), 7)).all(), z
