"""Reflections between lens, cover and sensor, in cameras drawn at random: the parts of an image find all of them.

The image by parts is compared with that of the mesh engine, which follows every path packet by packet, by tests of the
whole power, two halves and a quarter of the picture (Welch's test with the fewest degrees of freedom that it can have).
LEVEL is the chance that this file fails though all is right, shared by its comparisons (Bonferroni). Without the ghosts
by sequence the whole power is off by 7 to 89 standard errors. A plate, cover and sensor have a closed form.
"""

from typing import Any

import numpy as np
import pytest
from scipy import stats

import lfmesh as lf
from tests.instances import instances
from tests.renders import unchecked

LEVEL = 1e-3
CAMERAS = range(8)
AREAS = 4
SEEDS = range(6)
COMPARISONS = len(CAMERAS) * AREAS + 2 + 2 * len(SEEDS)
REPLICATES = 32


def drawn(number: int) -> lf.Scene:
    """Return a camera drawn at random before a wide glowing plane: two elements, a cover, a sensor that reflects.

    Every second one has an array. Clear apertures are at most three times as wide as the stop.
    """
    draw = np.random.default_rng(number)
    surfaces: list[dict[str, Any]] = [{"stop": True, "thickness_mm": 1.0, "semi_diameter_mm": draw.uniform(2.5, 6.0)}]
    for _ in range(2):
        radius = draw.uniform(40.0, 80.0)
        other = draw.choice([-1.0, 1.0, np.inf]) * draw.uniform(90.0, 200.0)
        surfaces += [
            {"radius_mm": radius, "thickness_mm": 3.5, "index": draw.uniform(1.5, 1.9), "semi_diameter_mm": 7.0},
            {"radius_mm": other, "thickness_mm": draw.uniform(1.0, 3.0), "semi_diameter_mm": 7.0},
        ]
    surfaces[1]["conic"] = draw.uniform(-1.0, 0.3)
    surfaces[-1]["thickness_mm"] = 0.0
    sensor: dict[str, Any] = {
        "pixels": [6, 6], "pixel_mm": 0.4, "reflectance": draw.uniform(0.05, 0.6),
        "cover": {
            "thickness_mm": draw.uniform(0.02, 0.1), "gap_mm": 10.0 ** draw.uniform(-6.0, -1.5),
            "index": draw.uniform(1.4, 1.9),
        },
        "pose": {"tilt_deg": [draw.normal(), draw.normal(), 10.0 * draw.normal()]},
    }  # fmt: skip
    camera: dict[str, Any] = {"focus_mm": 400.0, "lens": {"surfaces": surfaces}, "sensor": sensor}
    if number % 2:
        camera["mla"] = {
            "count": [12, 12], "pitch_mm": 0.2, "focal_length_mm": 1.0, "index": 1.5, "thickness_mm": 0.4,
            "curved_side": str(draw.choice(["lens", "sensor"])), "layout": str(draw.choice(["square", "hexagonal"])),
        }  # fmt: skip
    # Enough for the parts' shares of the samples to be measured.
    samples = (512 if number % 2 else 128) * REPLICATES
    return lf.Scene(
        camera=camera,
        targets=[
            {"shape": {"kind": "plane", "width_mm": 600.0, "height_mm": 600.0}, "position_mm": [0.0, 0.0, -400.0]}
            | {"material": {"reflectance": 0.0, "radiance_w_m2_sr": 1000.0}}
        ],
        transport={"samples": samples, "replicates": REPLICATES, "threads": 2, "wavelengths_nm": [587.6]},
    )


def z_of(one: lf.Image, other: lf.Image, area: tuple[slice, slice] = (slice(None), slice(None))) -> float:
    """Return by how many standard errors the power of two images differs on an area of the sensor."""
    variance = sum(float(np.square(image.stderr[area]).sum()) for image in (one, other))
    return float(one.mean[area].sum() - other.mean[area].sum()) / variance**0.5


@pytest.mark.parametrize("number", instances(CAMERAS, long=[0, 1, 2, 3, 5, 6, 7]))
def test_the_parts_of_an_image_find_what_the_mesh_engine_finds(number: int) -> None:
    scene = drawn(number)
    parts, mesh = unchecked(scene), unchecked(scene.changed({"transport.engine": "mesh", "transport.seed": 1}))
    half = slice(None, 3)
    bound = float(stats.t.isf(0.5 * LEVEL / COMPARISONS, REPLICATES - 1))
    whole = slice(None)
    for area in ((whole, whole), (half, whole), (whole, half), (slice(3, None), slice(3, None))):
        assert abs(z_of(parts, mesh, area)) < bound
    # What a part left out would change shows: the image path alone is darker by many errors.
    path = unchecked(scene.changed({"transport.split": "transmit"}))
    assert z_of(mesh, path) > 2.0 * bound
    assert abs(parts.ledger.imbalance) < 1e-12


def test_plates_and_a_sensor_that_reflects_are_a_geometric_series() -> None:
    """Light square to an uncoated plate, cover and sensor: each interface adds (1 - T) / T, as incoherent plates do.

    The sensor takes the share (1 - R) T' / (1 - (1 - T') R) of what falls on plate and cover with a joint
    transmittance T'. The plate is 20 mm before the sensor and the stop 2 m before it, so that no ray is more than
    0.5 degrees off; shares differ by less than 1e-4 from those at normal incidence. What sensor and plate throw back is
    at most 0.4 mm aside, of 10 mm of sensor, and sees the stop from 2 % farther away: 2e-3 of all that is detected.
    """
    reflectance, plate, cover, pixel = 0.4, 1.5, 1.8, 5.0
    wide = {"semi_diameter_mm": 30.0}
    scene = lf.Scene(
        camera={
            "focus_mm": 1e6,
            "lens": {"surfaces": [
                {"stop": True, "thickness_mm": 1980.0, "semi_diameter_mm": 10.0},
                {"radius_mm": np.inf, "thickness_mm": 1.0, "index": plate} | wide,
                {"radius_mm": np.inf, "thickness_mm": 0.0} | wide,
            ]},
            "sensor": {
                "pixels": [2, 2], "pixel_mm": pixel, "reflectance": reflectance, "distance_mm": 19.0,
                "cover": {"thickness_mm": 1.0, "gap_mm": 1.0, "index": cover},
            },
        },
        targets=[
            {"shape": {"kind": "plane", "width_mm": 100.0, "height_mm": 100.0}, "position_mm": [0.0, 0.0, -1.0]}
            | {"material": {"reflectance": 0.0, "radiance_w_m2_sr": 1000.0}}
        ],
        transport={"samples": 512 * REPLICATES, "replicates": REPLICATES, "threads": 2, "wavelengths_nm": [587.6]}
        | {"max_events": 200},
    )  # fmt: skip
    once = [((n - 1.0) / (n + 1.0)) ** 2 for n in (plate, plate, cover, cover)]
    joint = 1.0 / (1.0 + sum(r / (1.0 - r) for r in once))
    share = (1.0 - reflectance) * joint / (1.0 - (1.0 - joint) * reflectance)
    # A pixel sees the stop behind 2 mm of glass, which brings it nearer by t (1 - 1 / n).
    away = 2000.0 - (1.0 - 1.0 / plate) - (1.0 - 1.0 / cover)
    unreflected = 1000.0 * 1e-6 * 4 * pixel**2 * np.pi * 10.0**2 / (away**2 + 10.0**2)
    for changes in ({}, {"transport.engine": "mesh"}):
        image = unchecked(scene.changed(changes))
        error = float(np.sqrt(np.square(image.stderr).sum()))
        bound = float(stats.t.isf(0.5 * LEVEL / COMPARISONS, REPLICATES - 1))
        assert abs(image.mean.sum() - share * unreflected) < bound * error + 2e-3 * unreflected
        assert error < 0.01 * unreflected


@pytest.mark.parametrize("distance", [60.0, 400.0])
def test_a_small_opening_in_wide_glass_is_not_missed(distance: float) -> None:
    """The pupil of a stop is a small part of the disk at the lens; images that miss what comes there err unseen."""
    scene = lf.Scene(
        camera={
            "focus_mm": 1e4,
            "lens": {"surfaces": [
                {"stop": True, "semi_diameter_mm": 5.0, "thickness_mm": 0.1},
                {"radius_mm": np.inf, "thickness_mm": 1.0, "index": 1.5, "semi_diameter_mm": 60.0},
                {"radius_mm": np.inf, "thickness_mm": 0.0, "semi_diameter_mm": 60.0},
            ]},
            "sensor": {"pixels": [3, 3], "pixel_mm": 2.0, "reflectance": 0.5, "distance_mm": distance},
        },
        targets=[
            {"shape": {"kind": "plane", "width_mm": 4e3, "height_mm": 4e3}, "position_mm": [0.0, 0.0, -100.0]}
            | {"material": {"reflectance": 0.0, "radiance_w_m2_sr": 1000.0}}
        ],
        transport={"samples": 4096, "replicates": 16, "wavelengths_nm": [587.6], "threads": 2},
    )  # fmt: skip
    mesh = unchecked(scene.changed({"transport.engine": "mesh", "transport.samples": 65536}))
    bound = float(stats.t.isf(0.5 * LEVEL / COMPARISONS, 15))
    for seed in SEEDS:
        assert abs(z_of(unchecked(scene.changed({"transport.seed": 1 + seed})), mesh)) < bound
