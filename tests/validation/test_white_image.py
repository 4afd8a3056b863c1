"""White images: micro-images are where first-order optics and traced chief rays put them, and uniform light is uniform.

Neighbouring micro-images are (p/pixel)(D + d)/D pixels apart: chief rays from the middle of the exit pupil, D before
the lenslets' front principal points, go on d to the sensor behind the rear ones.
"""

from typing import Any

import numpy as np
import pytest
from scipy import stats

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.scene.first_order.lenslets import lenslet_to_sensor_mm

PITCH_TOLERANCE = 2e-4

DOUBLE_GAUSS = {"file": asset_path("lenses/double_gauss_50mm.toml").as_posix(), "stop_semi_diameter_mm": 4.0}
# The stop stands so far behind the lens that micro-images are 4.6 % farther apart than lenslets.
REAR_STOP = {
    "surfaces": [
        {"radius_mm": 75.0, "thickness_mm": 4.0, "index": 1.5, "semi_diameter_mm": 15.0},
        {"radius_mm": -75.0, "thickness_mm": 60.0, "semi_diameter_mm": 15.0},
        {"stop": True, "semi_diameter_mm": 1.0},
    ]
}
ARRAY = {"pitch_mm": 0.125, "index": 1.5, "thickness_mm": 0.3}

CAMERAS: dict[str, dict[str, Any]] = {
    "square": {
        "focus_mm": 500.0,
        "lens": DOUBLE_GAUSS,
        "mla": {**ARRAY, "count": (24, 24), "focal_length_mm": 0.5},
        "sensor": {"pixels": (260, 260), "pixel_mm": 0.0125},
    },
    "hexagonal": {
        "focus_mm": 300.0,
        "lens": {**DOUBLE_GAUSS, "stop_semi_diameter_mm": 3.4},
        "mla": {
            **ARRAY,
            "layout": "hexagonal",
            "count": (24, 28),
            "focal_length_mm": 0.6,
        },
        "sensor": {"pixels": (260, 260), "pixel_mm": 0.0125},
    },
    "near exit pupil": {
        "focus_mm": 220.0,
        "lens": REAR_STOP,
        "mla": {**ARRAY, "count": (20, 20), "focal_length_mm": 2.5},
        "sensor": {"pixels": (290, 290), "pixel_mm": 0.01},
    },
}


@pytest.fixture(scope="module", params=CAMERAS)
def white(request: pytest.FixtureRequest) -> lf.Image:
    transport = {"split": "transmit", "samples": 16, "replicates": 8, "threads": 2}
    return lf.white_image(lf.solved(lf.Scene(camera=CAMERAS[request.param], transport=transport)))


def test_micro_images_are_as_far_apart_as_first_order_optics_says(white: lf.Image) -> None:
    """Measured on the rendered image by the estimator, which is told the pitch to start from, but not to end with."""
    scene = white.scene
    facts, camera = lf.first_order(scene), scene.camera
    D = facts.image_z_mm - facts.exit_pupil_z_mm
    d = lenslet_to_sensor_mm(camera, scene.primary_nm)
    expected = camera.mla.pitch_mm / camera.sensor.pixel_mm * (D + d) / D
    assert lf.estimate_centres(white).pitch_px == pytest.approx(expected, rel=PITCH_TOLERANCE)


def test_centres_found_on_the_image_are_the_traced_ones(white: lf.Image) -> None:
    """To a fiftieth of a pixel on average; the estimator sees the middle of the pupil, the trace its chief ray."""
    truth, found = lf.calibrate(white.scene), lf.estimate_centres(white)
    assert found.origin == "white image"
    assert found.known.sum() > 0.8 * found.known.size
    assert found.error_px(truth).mean() < 0.02
    assert abs(found.rotation_rad - truth.rotation_rad) < 2e-4


def test_divided_by_white_a_uniform_plane_has_its_radiance(white: lf.Image) -> None:
    """Another noise, another distance, 2.5 times the radiance: z-test of the mean of one view, level 1e-3.

    One view only, and every other sample of it: neighbours share pixels.
    """
    (plane,) = white.scene.targets
    near = plane.model_copy(update={"position_mm": (0.0, 0.0, -300.0)})
    other = white.scene.changed({"targets": [near.model_dump()], "transport.seed": 7})
    other = other.changed({"targets[0].material.radiance_w_m2_sr": 2.5})
    field = lf.decode(lf.render(other), white=white)
    v, u = (count // 2 for count in field.views)
    seen, stderr = field.view(v, u)[2:-2:2, 2:-2:2, 0], field.stderr[v, u, 2:-2:2, 2:-2:2, 0]
    assert field.unit == "W/(m² sr)"
    assert seen.size >= 64
    assert abs(seen.mean() - 2.5) < stats.norm.isf(5e-4) * np.sqrt((stderr**2).sum()) / seen.size
    assert np.sqrt((stderr**2).sum()) / seen.size < 0.03
