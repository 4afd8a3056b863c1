"""Motions at their limits: thousands of turns, flashes, bodies from far away, through each other, a hundred at once.

Light is compared with that of a scene at rest, times the share of the exposure that it is seen.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from lfmesh.accuracy.hard.outcome import MOST_SIGMAS, Outcome, case, images_of, of_images
from lfmesh.scene import Scene

FOCUS_MM = 500.0
SEEDS = 8
SAMPLES = 256
SECOND = {"duration_s": 1.0}

Tables = dict[str, Any]


def _plane(width_mm: float, height_mm: float, radiance: float = 1.0, **keys: Any) -> Tables:
    """Return a plane in focus that shines."""
    return {
        "shape": {"kind": "plane", "width_mm": width_mm, "height_mm": height_mm},
        "position_mm": (0.0, 0.0, -FOCUS_MM), "material": {"reflectance": 0.0, "radiance_w_m2_sr": radiance}, **keys,
    }  # fmt: skip


WHOLE = _plane(40.0, 40.0)
"""Fills the picture."""


def _scene(targets: Sequence[Tables], exposure: Tables | None = None, **camera: Any) -> Scene:
    """Return targets before a camera with an ideal lens, whose pixels are 0.9 mm wide there."""
    lens: Tables = {"paraxial": True, "focal_length_mm": 50.0, "semi_diameter_mm": 0.5, "stop": True}
    sensor: Tables = {"pixels": (8, 8), "pixel_mm": 0.1}
    tables: Tables = {
        "camera": {"focus_mm": FOCUS_MM, "lens": {"surfaces": [lens]}, "sensor": sensor, **camera},
        "targets": list(targets), "transport": {"split": "transmit", "samples": SAMPLES, "replicates": 1},
    }  # fmt: skip
    return Scene.model_validate(tables if exposure is None else tables | {"exposure": exposure})


def _judged(moving: Scene, resting: Scene, shares: tuple[float, float] = (1.0, 1.0), largest: float = 0.01) -> Outcome:
    """Compare the light of two scenes, and that of the four pixels in the middle, by the scatter over seeds.

    Parameters
    ----------
    moving, resting : Scene
    shares : tuple of float
        True ratio of their light, in all and in the middle.
    largest : float
        Largest acceptable standard error, relative.
    """
    images, others = images_of(moving, range(SEEDS)), images_of(resting, range(100, 100 + SEEDS))
    passed, said = True, []
    for share, where in zip(shares, (slice(None), slice(3, 5)), strict=True):
        one, other = (np.array([image.mean[where, where].sum() for image in each]) for each in (images, others))
        ratio = float(one.mean() / other.mean())
        # Pictures without noise differ by rounding.
        sigma = max(float(np.hypot(*(p.std(ddof=1) / np.sqrt(SEEDS) / p.mean() for p in (one, other)))), 1e-9)
        passed &= sigma < largest and abs(ratio / share - 1.0) < MOST_SIGMAS * sigma
        said.append(f"{ratio:.4f} ± {sigma:.4f}")
    return of_images(
        [*images, *others], f"{shares[0]:.4g} times the light, {shares[1]:.4g} in the middle, to {largest:.1%}",
        ", ".join(said), passed,
    )  # fmt: skip


@case
def ten_thousand_turns() -> Outcome:
    """Turn a bar ten thousand times in the exposure; a pixel near the axis sees it at all times."""
    bar = _plane(5.0, 2.0)
    # Points of the middle are seen for 2 asin(1 / r) / π of the time if they are farther from the axis than the bar is
    # high.
    x, y = np.meshgrid(*[(np.arange(400) + 0.5) * 0.9 / 400] * 2)
    seen = float((2.0 / np.pi * np.arcsin(np.minimum(1.0 / np.hypot(x, y), 1.0))).mean())
    turning = _scene([bar | {"motion": {"spin_deg_s": (0.0, 0.0, 3.6e6)}}], SECOND)
    return _judged(turning, _scene([bar]), (1.0, seen))


@case
def flash_of_a_nanosecond() -> Outcome:
    """Open the shutter for 2 ns of a second, while an edge passes at 10 m/s: it is as sharp as at rest."""
    edge = {"position_mm": (-5000.0, 0.0, -FOCUS_MM), "motion": {"velocity_mm_s": (1e4, 0.0, 0.0)}}
    shutter = [[0.0, 0.0], [0.5, 0.0], [0.5 + 1e-9, 1.0], [0.5 + 2e-9, 0.0], [1.0, 0.0]]
    moving = _scene([_plane(3.0, 40.0) | edge], SECOND | {"shutter": shutter})
    return _judged(moving, _scene([_plane(3.0, 40.0)]))


@case
def motion_of_a_picometre() -> Outcome:
    """Move a bar by 1e-9 mm and turn it by 1e-9 degrees."""
    motion = {"motion": {"velocity_mm_s": (1e-9, 0.0, 0.0), "spin_deg_s": (0.0, 0.0, 1e-9)}}
    return _judged(_scene([_plane(3.0, 5.0) | motion], SECOND), _scene([_plane(3.0, 5.0)]))


@case
def wall_from_half_a_kilometre() -> Outcome:
    """Let a wall of 250 m pass at 1 km/s, from 500 m beside the axis to 500 m on the other side."""
    wall = _plane(2.5e5, 40.0) | {
        "position_mm": (-5e5, 0.0, -FOCUS_MM), "motion": {"velocity_mm_s": (1e6, 0.0, 0.0)}
    }  # fmt: skip
    return _judged(_scene([wall], SECOND), _scene([WHOLE]), (0.25, 0.25))


@case
def exposures_of_a_picosecond_and_a_year() -> Outcome:
    """Let a wall pass that hides the picture for half of an exposure of 1e-12 s, and of a year."""
    outcomes = []
    for duration in (1e-12, 3.2e7):
        poses = [{"time_s": t * duration, "position_mm": (x, 0.0, -400.0)} for t, x in ((0.0, -500.0), (1.0, 500.0))]
        wall = _plane(500.0, 40.0, 0.0) | {"position_mm": (-500.0, 0.0, -400.0), "motion": {"poses": poses}}
        outcomes.append(_judged(_scene([WHOLE, wall], {"duration_s": duration}), _scene([WHOLE]), (0.5, 0.5)))
    return max(outcomes, key=lambda outcome: not outcome.passed)


@case
def walls_through_each_other() -> Outcome:
    """Move a black wall through one that shines, from behind it to its front, by 1 µm on either side."""
    black = _plane(60.0, 60.0, 0.0) | {
        "position_mm": (0.0, 0.0, -FOCUS_MM - 1e-3), "motion": {"velocity_mm_s": (0.0, 0.0, 2e-3)}
    }  # fmt: skip
    return _judged(_scene([WHOLE, black], SECOND), _scene([WHOLE]), (0.5, 0.5))


@case
def poses_almost_half_a_turn_apart() -> Outcome:
    """Turn a bar by 179.9999 degrees from one pose to the next, three times, instead of by a steady spin."""
    bar, step = _plane(5.0, 2.0), 179.9999
    poses = [
        {"time_s": k / 3.0, "position_mm": bar["position_mm"], "rotation_deg": (0.0, 0.0, k * step)} for k in range(4)
    ]
    moving = _scene([bar | {"motion": {"poses": poses}}], SECOND)
    steady = _scene([bar | {"motion": {"spin_deg_s": (0.0, 0.0, 3.0 * step)}}], SECOND)
    return _judged(moving, steady)


@case
def a_hundred_motions_at_once() -> Outcome:
    """Spin a hundred balls, each in its own way: they look as at rest."""
    draw = np.random.default_rng(3)
    balls = [
        {
            "shape": {"kind": "sphere", "radius_mm": 0.3},
            "position_mm": (0.7 * (k % 10 - 4.5), 0.7 * (k // 10 - 4.5), -FOCUS_MM),
            "material": {"reflectance": 0.0, "radiance_w_m2_sr": float(draw.uniform(0.2, 1.0))},
        }
        for k in range(100)
    ]  # fmt: skip
    spinning = [ball | {"motion": {"spin_deg_s": draw.uniform(-1e4, 1e4, 3).tolist()}} for ball in balls]
    return _judged(_scene(spinning, SECOND), _scene(balls), largest=0.03)


@case
def camera_that_turns_in_a_room() -> Outcome:
    """Turn a camera ten times about its vertical axis in a closed room that shines: nothing shows it."""
    half = 1000.0
    walls = [_plane(2.0 * half, 2.0 * half) | {"position_mm": (0.0, 0.0, z)} for z in (-half, half)]
    for side in (-half, half):
        walls += [
            _plane(2.0 * half, 2.0 * half) | {"position_mm": (side, 0.0, 0.0), "rotation_deg": (0.0, 90.0, 0.0)},
            _plane(2.0 * half, 2.0 * half) | {"position_mm": (0.0, side, 0.0), "rotation_deg": (90.0, 0.0, 0.0)},
        ]
    turning = _scene(walls, SECOND, motion={"spin_deg_s": (0.0, 3600.0, 0.0)})
    return _judged(turning, _scene(walls))
