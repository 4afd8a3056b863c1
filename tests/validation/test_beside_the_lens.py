"""Light from object space that flies towards the lens and passes beside it goes on as if nothing had been asked."""

from typing import Any

import numpy as np
import pytest

import lfmesh as lf

PLATE = (
    {"radius_mm": np.inf, "index": 1.5, "thickness_mm": 3.0, "semi_diameter_mm": 8.0},
    {"radius_mm": np.inf, "thickness_mm": 1.0, "semi_diameter_mm": 8.0},
    {"stop": True, "semi_diameter_mm": 6.0},
)
THIN_LENS = ({"paraxial": True, "focal_length_mm": 20.0, "semi_diameter_mm": 4.0, "stop": True},)
CURVED = (
    {"radius_mm": 40.0, "index": 1.5, "thickness_mm": 3.0, "semi_diameter_mm": 8.0},
    {"radius_mm": -40.0, "semi_diameter_mm": 8.0, "stop": True},
)
FOG_PER_MM = 0.01


def scene(surfaces: Any, **parts: Any) -> lf.Scene:
    camera = {"lens": {"surfaces": surfaces}, "sensor": {"pixels": [8, 8], "pixel_mm": 1.5, "distance_mm": 20.0}}
    return lf.Scene(camera=camera, **parts)


@pytest.mark.parametrize(("engine", "split"), [("auto", "transmit"), ("auto", "both"), ("mesh", "transmit")])
@pytest.mark.parametrize("surfaces", [PLATE, THIN_LENS], ids=["plate", "thin lens"])
def test_an_opaque_sheet_near_the_lens_is_dark_where_it_is_lit_from_behind(
    surfaces: Any, engine: str, split: str
) -> None:
    """At any tilt, with a disk behind it that scatters light: none goes round the sheet, so no path may find any."""
    draw = np.random.default_rng(5)
    for _ in range(3):
        tilt = draw.uniform(-60.0, 60.0, 2)
        sheet = {
            "shape": {"kind": "plane", "width_mm": 120.0, "height_mm": 120.0},
            "position_mm": (*draw.uniform(-4.0, 4.0, 2), -40.0),
            "rotation_deg": (*tilt, draw.uniform(0.0, 90.0)),
            "material": {"reflectance": 0.9},
        }
        behind = {"shape": {"kind": "disk", "radius_mm": 1.0}, "position_mm": (5.0, 0.0, -800.0)}
        lamp = {"kind": "point", "position_mm": (0.0, 0.0, -400.0), "power_w": 1.0}
        given = scene(
            surfaces, targets=[sheet, behind], lights=[lamp],
            transport={"engine": engine, "split": split, "samples": 1024, "replicates": 2},
        )  # fmt: skip
        assert lf.render(given).mean.max() == 0.0, tilt


@pytest.mark.parametrize("engine", ["mesh", "sequential"])
def test_fog_on_the_way_past_the_lens_absorbs_once(engine: str) -> None:
    """Rays aimed at the corners of the lens's box, outside its round face: Bouguer's law over their way in the fog."""
    target = {"shape": {"kind": "plane", "width_mm": 60.0, "height_mm": 60.0}, "position_mm": (0.0, 0.0, -400.0)}
    fog = {
        "bounds": {"kind": "box", "size_mm": (400.0, 400.0, 100.0)},
        "position_mm": (0.0, 0.0, -80.0),
        "absorption_per_mm": FOG_PER_MM,
    }
    given = scene(CURVED, targets=[target], media=[fog], transport={"engine": engine, "split": "transmit"})
    draw = np.random.default_rng(6)
    n = 200
    corner = draw.uniform(5.9, 8.0, (n, 2)) * draw.choice([-1.0, 1.0], (n, 2))
    beside = np.column_stack([corner, draw.uniform(0.5, 2.5, n)])[np.hypot(*corner.T) > 8.3]
    origins = np.column_stack([draw.uniform(-4.0, 4.0, (len(beside), 2)), draw.uniform(-120.0, -40.0, len(beside))])
    directions = beside - origins
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    paths = lf.trace(lf.build(given), origins, directions, split="transmit")
    way = (-30.0 - origins[:, 2]) / directions[:, 2]
    assert len(beside) > 100
    np.testing.assert_allclose(paths.weight, np.exp(-FOG_PER_MM * way), rtol=1e-12)
