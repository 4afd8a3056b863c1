"""Lamps with a size light a scene alike in both methods: in air, in fog, behind glass, in a tank.

The forward method starts packets at points of the lamp, the adjoint method asks for points of it: nothing is shared but
the lamp's row in the table.
"""

from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from tests.instances import instances

LENS = {"surfaces": [{"radius_mm": 20.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 5.0},
                     {"radius_mm": -20.0, "thickness_mm": 1.0, "semi_diameter_mm": 5.0},
                     {"stop": True, "semi_diameter_mm": 4.0}]}  # fmt: skip
CAMERA = {"focus_mm": 60.0, "lens": LENS, "sensor": {"pixels": [2, 2], "pixel_mm": 2.0}}
WALL = {"shape": {"kind": "plane", "width_mm": 20.0, "height_mm": 20.0}, "position_mm": [0.0, 0.0, -60.0],
        "material": {"reflectance": 0.8}}  # fmt: skip
LAMPS: dict[str, dict[str, Any]] = {
    "line": {"kind": "line", "start_mm": [15.0, 8.0, -45.0], "end_mm": [9.0, -12.0, -50.0], "power_w": 3.0},
    "rectangle": {"kind": "rectangle", "position_mm": [12.0, 3.0, -46.0], "direction": [-1.0, 0.0, -0.8],
                  "width_mm": 10.0, "height_mm": 2.0, "turn_deg": 40.0, "power_w": 3.0},
}  # fmt: skip
THROUGH = {"kind": "line", "start_mm": [6.0, 8.0, -55.0], "end_mm": [7.0, 6.0, -70.0], "power_w": 3.0}
FOG = {"bounds": {"kind": "sphere", "radius_mm": 25.0}, "position_mm": [0.0, 0.0, -50.0], "scattering_per_mm": 0.02}
PLATE = {"refractor": {"box_mm": [16.0, 16.0, 3.0], "index": 1.5}, "position_mm": [0.0, 0.0, -54.0]}
TANK = {"size_mm": [18.0, 18.0, 12.0], "wall_mm": 1.0, "position_mm": [0.0, 0.0, -58.0], "wall": {"index": 1.5},
        "liquid": {"index": 1.33, "absorption_per_mm": 0.02}}  # fmt: skip
SHEET = WALL | {"shape": {"kind": "plane", "width_mm": 12.0, "height_mm": 12.0}}
PLACES: dict[str, dict[str, Any]] = {
    "air": {"targets": [WALL]},
    "fog": {"targets": [WALL], "media": [FOG]},
    "glass": {"targets": [WALL, PLATE]},
    "tank": {"targets": [SHEET], "tanks": [TANK]},
}
CASES = [(place, name) for place in PLACES for name in LAMPS]


def watts(samples: int, method: str, **scene: Any) -> tuple[float, float]:
    """Return the light of a picture and its standard error, from 32 replicates."""
    settings = {"method": method, "samples": samples, "replicates": 32, "split": "both"}
    image = lf.render(lf.Scene(camera=CAMERA, transport=settings, **scene))  # type: ignore[arg-type]
    return float(image.mean.sum()), float(np.sqrt((image.stderr**2).sum()))


def agree(one: tuple[float, float], other: tuple[float, float], known: float) -> None:
    """Hold two totals against each other, at a level of 1e-4, both known to some share."""
    assert max(one[1] / one[0], other[1] / other[0]) < known
    assert abs(one[0] - other[0]) < 3.9 * np.hypot(one[1], other[1])


@pytest.mark.filterwarnings("ignore::lfmesh.PictureWarning")
@pytest.mark.parametrize("case", instances(CASES, long=CASES[2:]))
def test_forward_equals_adjoint(case: tuple[str, str]) -> None:
    place, name = case
    scene = PLACES[place] | {"lights": [LAMPS[name]]}
    more = 1 if place in ("air", "fog") else 32
    agree(watts(512 * more, "adjoint", **scene), watts(65_536 * min(more, 4), "forward", **scene), 0.03)


@pytest.mark.filterwarnings("ignore::lfmesh.PictureWarning")
@pytest.mark.long
def test_a_tube_through_a_sheet_lights_it_alike_in_both_methods() -> None:
    scene = {"targets": [WALL], "lights": [THROUGH]}
    agree(watts(4096, "adjoint", **scene), watts(262_144, "forward", **scene), 0.03)


@pytest.mark.filterwarnings("ignore::lfmesh.PictureWarning")
@pytest.mark.long
def test_lamps_in_the_plane_of_a_target_leave_it_dark() -> None:
    """A panel there shines along the target's plane or away; a tube there shines at no angle above it."""
    panel = {"kind": "rectangle", "position_mm": [15.0, 0.0, -60.0], "direction": [0.0, 0.0, -1.0], "width_mm": 6.0,
             "height_mm": 4.0, "power_w": 1.0}  # fmt: skip
    tube = {"kind": "line", "start_mm": [12.0, 0.0, -60.0], "end_mm": [18.0, 2.0, -60.0], "power_w": 1.0}
    for lamp in (panel, tube):
        for method in ("adjoint", "forward"):
            assert watts(64, method, targets=[WALL], lights=[lamp])[0] == 0.0
