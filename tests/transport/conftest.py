"""Cameras that the tests of this folder share."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.geometry.lattice import ROW_SPACING

RandomCamera = Callable[[int], lf.Scene]

TARGET = {"shape": {"kind": "plane", "width_mm": 120.0, "height_mm": 120.0}, "position_mm": [0, 0, -300.0],
          "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}}  # fmt: skip


@pytest.fixture(scope="session")
def emitting_plane() -> dict[str, Any]:
    """Return a target that shines evenly, as a scene's table."""
    return TARGET


@pytest.fixture(scope="session")
def random_camera() -> RandomCamera:
    """Return the camera of a seed, before an evenly shining plane."""
    return drawn_camera


def drawn_camera(seed: int) -> lf.Scene:
    """Draw a lens, a stop before, inside or behind it, and an array of any kind, near hemispheres among them."""
    draw = np.random.default_rng(seed)
    focal, index = draw.uniform(20.0, 80.0), draw.uniform(1.45, 1.9)
    widest = focal / draw.uniform(2.2, 6.0) / 2.0
    radius = 4.0 * focal * (index - 1.0) * draw.uniform(0.95, 1.05)
    glass = {"index": index, "semi_diameter_mm": 1.15 * widest}
    conic = {"conic": draw.uniform(-1.5, 0.5)} if draw.random() < 0.4 else {}
    thick = widest**2 / radius * 1.5 + 1.0
    element = [
        {"radius_mm": radius, "thickness_mm": thick} | glass | conic,
        {"radius_mm": -radius, "thickness_mm": draw.uniform(1.0, 8.0), "semi_diameter_mm": 1.15 * widest},
    ]
    stop = {"stop": True, "thickness_mm": draw.uniform(1.0, 8.0),
            "semi_diameter_mm": widest * 10.0 ** draw.uniform(-2.0, 0.0)}  # fmt: skip
    where = int(draw.integers(0, 3))
    surfaces = [*element, *element]
    surfaces.insert(2 * where, stop)
    surfaces[-1] = {key: value for key, value in surfaces[-1].items() if key != "thickness_mm"}
    hexagonal, to_lens = draw.random() < 0.5, draw.random() < 0.5
    pitch = 10.0 ** draw.uniform(-1.7, -0.3)
    corner = pitch / np.sqrt(3.0 if hexagonal else 2.0)
    curved = draw.choice([0.1, 0.3, 0.6, 0.9, 0.98])
    mla: dict[str, Any] = {
        "layout": "hexagonal" if hexagonal else "square",
        "count": [20, 20],
        "pitch_mm": pitch,
        "radius_mm": corner / curved,
        "index": draw.uniform(1.4, 1.9),
        "thickness_mm": corner * draw.uniform(1.1, 3.0),
        "curved_side": "lens" if to_lens else "sensor",
    }
    if draw.random() < 0.4:
        shift = draw.uniform(-0.3, 0.3, 3) * pitch * [1.0, 1.0, 0.1]
        mla["pose"] = {"tilt_deg": list(draw.uniform(-1.0, 1.0, 3)), "shift_mm": list(shift)}
    if curved < 0.9 and draw.random() < 0.4:
        mla["form"] = {"decenter_mm": 0.01 * pitch, "radius_error": 0.005, "seed": seed}
    rows = ROW_SPACING if hexagonal else 1.0
    pixel = pitch / draw.uniform(6.0, 15.0)
    sensor = {"pixels": [int(20 * pitch / pixel), int(20 * rows * pitch / pixel)], "pixel_mm": pixel}
    if curved > 0.2:
        # Steep lenslets in a thick plate have their focal plane inside it; any distance is as good here.
        sensor["distance_mm"] = corner * draw.uniform(0.8, 3.0)
    return lf.Scene(
        camera={"focus_mm": 300.0, "lens": {"surfaces": surfaces}, "mla": mla, "sensor": sensor},
        targets=[TARGET],
        transport={"split": "transmit"},
    )
