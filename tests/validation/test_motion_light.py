"""Lamps and media that move during an exposure: irradiance, a searchlight, passing fog, against closed forms."""

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import lfmesh as lf
from tests.instances import instances
from tests.validation.motion_scenes import (
    DURATION_S,
    FOCUS_MM,
    WHOLE,
    Array,
    Tables,
    assert_zero,
    borders,
    camera,
    exposure,
    scene_of,
    stack,
)

COLUMNS, ROWS, LARGE_MM = 8, 4, 0.1
SEEDS = range(12)
SAMPLES = 512

WALL: Tables = {
    "shape": {"kind": "plane", "width_mm": 9.0, "height_mm": 6.0}, "position_mm": (0.0, 0.0, -FOCUS_MM),
    "material": {"reflectance": 0.8},
}  # fmt: skip
SUN: Tables = {"kind": "directional", "direction": (0.5, 0.3, -1.0), "irradiance_w_m2": 1.0}
"""Beside the camera, whose shadow does not fall on the wall in view."""

ON_WALL = 1.0 / np.sqrt(1.0 + 0.5**2 + 0.3**2)
"""Irradiance of the wall by SUN, W/m²."""

M2 = 1e6
"""mm² in a square metre."""

LAMP: Tables = {"kind": "point", "power_w": 1.0}
START, HEIGHT = np.array([-18.0, 4.0]), 12.0
"""x and y of a lamp at the begin, and its distance from the wall, mm."""

SPEED = 2000.0


def lit(lamp: Tables, method: str = "adjoint", **keys: Any) -> lf.Scene:
    """Return the wall under a lamp, through a camera with large pixels."""
    settings = {"samples": SAMPLES if method == "adjoint" else 2**14, "method": method}
    return scene_of(
        [WALL | keys.pop("wall", {})], lights=[lamp], transport=settings,
        camera=camera(COLUMNS, ROWS, pixel_mm=LARGE_MM) | keys.pop("camera", {}), **keys,
    )  # fmt: skip


def points() -> Array:
    """Return four points of the wall in each pixel, whose mean is that of cubic polynomials, (ROWS, COLUMNS, 4, 2)."""
    x, y = borders(COLUMNS, LARGE_MM), borders(ROWS, LARGE_MM)
    middle = np.stack(np.meshgrid(0.5 * (x[1:] + x[:-1]), 0.5 * (y[1:] + y[:-1])), axis=-1)
    corners = np.array([(a, b) for a in (-1.0, 1.0) for b in (-1.0, 1.0)]) / np.sqrt(3.0)
    return np.asarray(middle[:, :, None] + 0.5 * abs(x[1] - x[0]) * corners)


def compared(scene: lf.Scene, irradiance: Array, visible: float) -> None:
    """Compare columns of pictures with irradiances of pixels, W/m², by those of the wall under SUN."""
    under_sun = stack(lit(SUN), SEEDS) / ON_WALL
    images = stack(scene, SEEDS)
    expected = (irradiance * under_sun).sum(axis=1)
    scale = expected.mean()
    assert_zero((images.sum(axis=1) - expected) / scale, 1e-4, visible)


@pytest.mark.parametrize("method", instances(["adjoint", "forward"], long=["forward"]))
@pytest.mark.parametrize("mover", ["lamp", "wall and camera"])
def test_a_lamp_that_passes_a_wall_lights_it_by_the_integral_over_its_path(mover: str, method: str) -> None:
    """∫ I h / r³ dt of a point lamp on a straight line is I h u / (a² r v) between the ends, a the distance to it."""
    lamp: Tables = LAMP | {"position_mm": (*START.tolist(), HEIGHT - FOCUS_MM)}
    if mover == "lamp":
        scene = lit(lamp | {"motion": {"velocity_mm_s": (SPEED, 0.0, 0.0)}}, method, exposure=exposure())
    else:
        away = {"motion": {"velocity_mm_s": (-SPEED, 0.0, 0.0)}}
        scene = lit(lamp, method, exposure=exposure(), wall=away, camera=away)
    at = points()
    square = HEIGHT**2 + (at[..., 1] - START[1]) ** 2
    first = at[..., 0] - START[0]
    last = first - SPEED * DURATION_S
    integral = (first / np.sqrt(square + first**2) - last / np.sqrt(square + last**2)) * HEIGHT / (square * SPEED)
    irradiance = M2 / (4.0 * np.pi) * integral.mean(axis=-1) / DURATION_S
    assert irradiance.max() / irradiance.min() > 1.5
    compared(scene, irradiance, 0.002 if method == "adjoint" else 0.02)


HALF_DEG = 20.0
BESIDE = np.array([30.0, 10.0, 30.0 - FOCUS_MM])
"""Where a spotlight is, which nothing of the field of view hides."""


@pytest.mark.parametrize("method", instances(["adjoint", "forward"], long=["forward"]))
@pytest.mark.parametrize(
    ("turns", "first"), [(1.0, (1.0, 0.0, 0.0)), (0.25, (0.6, 0.0, -0.8)), (-0.25, (-0.7, 0.0, -0.7))]
)
def test_a_searchlight_lights_a_wall_while_its_cone_is_there(
    turns: float, first: tuple[float, float, float], method: str
) -> None:
    spin = (0.0, 360.0 * turns / DURATION_S, 0.0)
    spot: Tables = {"kind": "spot", "power_w": 1.0, "half_angle_deg": HALF_DEG, "direction": first,
                    "position_mm": BESIDE.tolist(), "motion": {"spin_deg_s": spin}}  # fmt: skip
    at = points()
    offset = np.concatenate([at, np.full((*at.shape[:-1], 1), -FOCUS_MM)], axis=-1) - BESIDE
    distance = np.linalg.norm(offset, axis=-1)
    times = DURATION_S * (np.arange(20_000) + 0.5) / 20_000
    axis = Rotation.from_rotvec(np.deg2rad(np.multiply.outer(times, spin))).apply(
        np.array(first) / np.linalg.norm(first)
    )
    shares = np.array([
        (axis @ unit > np.cos(np.deg2rad(HALF_DEG))).mean() for unit in (offset / distance[..., None]).reshape(-1, 3)
    ]).reshape(distance.shape)  # fmt: skip
    if abs(turns) == 1.0:
        sine = np.hypot(offset[..., 0], offset[..., 2]) / distance
        np.testing.assert_allclose(shares, np.arccos(np.cos(np.deg2rad(HALF_DEG)) / sine) / np.pi, atol=2e-4)
    intensity = 1.0 / (2.0 * np.pi * (1.0 - np.cos(np.deg2rad(HALF_DEG))))
    irradiance = M2 * intensity * (-offset[..., 2] / distance**3 * shares).mean(axis=-1)
    assert 0.02 < shares.min() < 0.9 * shares.max() or abs(turns) == 1.0
    compared(lit(spot, method, exposure=exposure()), irradiance, 0.01 if method == "adjoint" else 0.04)


DEPTH, WIDTH, ABSORPTION, SOURCE = 10.0, 6.0, 0.1, 3.0
"""Depth and width of fog, mm, its absorption, 1/mm, and its emission over its absorption, W/(m² sr)."""

AWAY = 300.0


def passed(slope: Array, height: Array) -> Array:
    """Return the mean of 1 − e^(−depth) along chief rays over the passage of the fog, times its duration and speed, mm.

    Parameters
    ----------
    slope, height : (...) float64
        |dx/dz| and dy/dz of the rays. The way in the fog is a trapezium of the time.
    """
    run = slope * DEPTH
    depth = ABSORPTION * DEPTH * np.sqrt(1.0 + slope**2 + height**2)
    taken = -np.expm1(-depth)
    return np.asarray((WIDTH - run) * taken + 2.0 * run * (1.0 - taken / depth))


@pytest.mark.parametrize("method", instances(["adjoint", "forward"], long=["forward"]))
@pytest.mark.parametrize("turned", [False, True])
def test_fog_that_passes_by_takes_and_gives_light_for_the_time_of_its_passage(turned: bool, method: str) -> None:
    """A box of it, in front of what shines; it passes through the whole picture, from side to side or upwards."""
    speed = 40.0 / DURATION_S
    along = np.array([0.0, 1.0, 0.0]) if turned else np.array([1.0, 0.0, 0.0])
    size = (14.0, WIDTH, DEPTH) if turned else (WIDTH, 14.0, DEPTH)
    fog: Tables = {
        "bounds": {"kind": "box", "size_mm": size}, "position_mm": [0.0, 0.0, -AWAY] - 20.0 * along,
        "absorption_per_mm": ABSORPTION, "emission_w_mm3_sr": SOURCE * ABSORPTION / M2,
        "motion": {"velocity_mm_s": (speed * along).tolist()},
    }  # fmt: skip
    fog["position_mm"] = fog["position_mm"].tolist()
    settings = {"samples": 4096 if method == "adjoint" else 2**14, "method": method}
    own = camera(COLUMNS, ROWS, pixel_mm=LARGE_MM)
    x, y = (abs(0.5 * (b[1:] + b[:-1])) / FOCUS_MM for b in (borders(COLUMNS, LARGE_MM), borders(ROWS, LARGE_MM)))
    across, up = np.meshgrid(x, y)
    share = passed(*((up, across) if turned else (across, up))) / 40.0
    truth = 1.0 - (1.0 - SOURCE) * share
    assert truth.min() > 1.15
    full = stack(scene_of([WHOLE], camera=own), SEEDS)
    scene = scene_of([WHOLE], camera=own, media=[fog], exposure=exposure(), transport=settings)
    difference = (stack(scene, SEEDS) - truth * full).sum(axis=1)
    # Rays through the rest of the lens are up to 0.2 % steeper; their mean is that of the chief ray to 1e-5.
    assert_zero(difference / full.sum(axis=1).mean(), 2e-4, 0.003 if method == "adjoint" else 0.03)


def test_a_lamp_that_turns_about_its_axis_changes_nothing() -> None:
    """A disk lamp and a cone; their pictures differ by noise alone from those of lamps at rest."""
    for keys in ({"kind": "disk", "radius_mm": 3.0}, {"kind": "spot", "half_angle_deg": 50.0}):
        along = -BESIDE - [0.0, 0.0, FOCUS_MM]
        lamp: Tables = {"power_w": 1.0, "position_mm": BESIDE.tolist(), "direction": along.tolist(), **keys}
        spin = 720.0 / DURATION_S * along / np.linalg.norm(along)
        turning = lit(lamp | {"motion": {"spin_deg_s": spin.tolist()}}, exposure=exposure())
        one, other = (stack(scene, SEEDS).sum(axis=1) for scene in (turning, lit(lamp)))
        assert_zero((one - other) / other.mean(), 1e-4, 0.01)
