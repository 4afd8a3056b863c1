"""The small study that many tests share: a white plane before a camera of 4 × 4 lenslets that is shifted."""

from typing import Any

import lfmesh as lf
from tests.cameras import close_up_camera

PLANE: dict[str, Any] = {
    "shape": {"kind": "plane", "width_mm": 60.0, "height_mm": 60.0},
    "position_mm": (0.0, 0.0, -60.0),
    "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0},
}

SHIFT = "camera.mla.pose.shift_mm[0]"


def small_scene(**transport: Any) -> lf.Scene:
    """Return the scene; its images take a fifth of a second."""
    settings = {"samples": 16, "replicates": 4, "split": "transmit", "seed": 3, **transport}
    return lf.Scene(name="small", camera=close_up_camera(), targets=[PLANE], transport=settings)


def shifted(points: int = 5, metrics: tuple[str, ...] = ("psnr", "light"), **settings: Any) -> lf.Study:
    """Return a study of array shifts up to a pixel to either side."""
    axes = [{"path": SHIFT, "range": (-0.1, 0.1), "count": points}]
    return lf.Study(small_scene(), axes=axes, metrics=metrics, **settings)
