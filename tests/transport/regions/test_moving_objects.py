"""Packets meet bodies where they are at the packet's time."""

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import lfmesh as lf

EXPOSURE_S = 0.01
VELOCITY, SPIN = (150.0, 60.0, 300.0), (500.0, 800.0, 2000.0)
START = (1.0, 0.0, -85.0)
TIMES = 16

GLASS: dict[str, dict[str, Any]] = {
    "box": {"refractor": {"box_mm": [5.0, 3.0, 4.0], "index": 1.5}},
    "ball": {"refractor": {"shape": {"kind": "sphere", "radius_mm": 3.0}, "index": 1.5}},
    "sheet": {"shape": {"kind": "plane", "width_mm": 3.0, "height_mm": 3.0},
              "material": {"reflectance": 0.0, "opacity": 0.5}},
}  # fmt: skip


def scene(thing: dict[str, Any], **more: Any) -> lf.Scene:
    lens = [{"radius_mm": 50.0, "thickness_mm": 5.0, "index": 1.5, "semi_diameter_mm": 8.0, "stop": True},
            {"radius_mm": -50.0, "semi_diameter_mm": 8.0}]  # fmt: skip
    lit = {"shape": {"kind": "plane", "width_mm": 4.0, "height_mm": 4.0}, "position_mm": [0.0, 0.3, -100.0],
           "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}}  # fmt: skip
    transport = {"samples": 64, "replicates": 4, "threads": 1, "split": "transmit"} | more.pop("transport", {})
    sensor = {"pixels": [2, 2], "pixel_mm": 4.0}
    camera = {"lens": {"surfaces": lens}, "focus_mm": 100.0, "sensor": sensor} | more.pop("camera", {})
    return lf.Scene(**({"camera": camera, "targets": [lit, thing], "transport": transport} | more))


def at_rest(thing: dict[str, Any], time_s: float) -> dict[str, Any]:
    """Return the thing as it is at a time."""
    turn = Rotation.from_rotvec(np.deg2rad(np.multiply(time_s, SPIN))).as_euler("xyz", degrees=True)
    place = np.add(START, np.multiply(time_s, VELOCITY))
    return thing | {"position_mm": place.tolist(), "rotation_deg": turn.tolist()}


@pytest.mark.filterwarnings("ignore::lfmesh.TooFewSamplesWarning")
@pytest.mark.parametrize("kind", GLASS)
def test_a_moving_body_gives_the_mean_of_still_pictures(kind: str) -> None:
    thing = GLASS[kind]
    motion = {"velocity_mm_s": VELOCITY, "spin_deg_s": SPIN}
    moving = thing | {"position_mm": START, "motion": motion}
    many = {"samples": 4096, "replicates": 32}
    own = lf.render(scene(moving, exposure={"duration_s": EXPOSURE_S}, transport=many))
    mean, variance = np.zeros((2, *own.mean.shape))
    for k in range(TIMES):
        still = scene(at_rest(thing, EXPOSURE_S * (k + 0.5) / TIMES), transport={"seed": k + 1})
        image = lf.render(still)
        mean, variance = mean + image.mean / TIMES, variance + (image.stderr / TIMES) ** 2
    # A two-sided test with an error of 1e-4 for all four pixels together.
    assert (np.abs(own.mean - mean) <= 4.2 * np.sqrt(own.stderr**2 + variance)).all()
    first = lf.render(scene(thing | {"position_mm": START}, transport=many))
    assert (np.abs(first.mean - own.mean) > 4.2 * np.hypot(first.stderr, own.stderr)).any()
    assert abs(own.ledger.imbalance) <= 1e-12


def test_a_motion_of_everything_together_with_the_camera_changes_no_bit() -> None:
    motion = {"velocity_mm_s": [500.0, 30.0, 700.0], "spin_deg_s": [900.0, 400.0, 1500.0], "center_mm": [3.0, 4.0, 5.0]}
    thing = GLASS["box"] | {"position_mm": START}
    still = scene(thing)
    moved = still.changed(
        {"exposure": {"duration_s": EXPOSURE_S}, "targets.0.motion": motion, "targets.1.motion": motion,
         "camera.motion": motion}
    )  # fmt: skip
    assert (lf.render(moved).mean == lf.render(still).mean).all()


def test_rays_meet_the_scene_as_given() -> None:
    thing = GLASS["box"] | {"position_mm": START}
    still = scene(thing)
    moving = still.changed(
        {"exposure": {"duration_s": EXPOSURE_S}, "targets.1.motion": {"velocity_mm_s": VELOCITY, "spin_deg_s": SPIN}}
    )
    starts = np.array([[0.2, 0.3, -10.0], [1.5, 0.0, -10.0], [3.0, 1.0, -10.0], [-5.0, 0.0, -10.0]])
    ways = np.array([[0.01, 0.0, -1.0], [0.0, 0.02, -1.0], [-0.02, 0.0, -1.0], [0.0, 0.0, -1.0]])
    one, other = (
        lf.trace(lf.build(each, aimed=False), starts, ways, split="transmit", record=True) for each in (still, moving)
    )  # fmt: skip
    assert (one.status == other.status).all()
    np.testing.assert_allclose(one.position, other.position, rtol=1e-13)
