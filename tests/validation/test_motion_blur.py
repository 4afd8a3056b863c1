"""Blur of edges, shutters, rolling shutters and streaks of particles, against closed forms.

Each picture is compared with that of a plane that fills it and rests, pixel by pixel, so that cos⁴ drops out.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from tests.instances import instances
from tests.validation.motion_scenes import (
    DURATION_S,
    FOCUS_MM,
    OPEN,
    PIXEL_MM,
    SCALE,
    WHOLE,
    Array,
    Tables,
    assert_zero,
    borders,
    camera,
    exposure,
    glowing,
    scene_of,
    stack,
    swept,
)

COLUMNS, ROWS = 16, 8
SEEDS = range(12)
SAMPLES = 1024

SPEED = 300.0
"""mm/s: 6.7 pixels during the exposure."""

START = -1.3
"""x of the edge at the begin, mm."""

FAR = -8.0
"""x of the other edge of what shines."""


def compared(scene: lf.Scene, truth: Array, visible: float = 0.004) -> None:
    """Compare pictures with shares of those of a plane that fills them."""
    whole = scene_of([WHOLE], transport={"samples": SAMPLES})
    full = stack(whole, SEEDS)
    scale = full.mean()
    samples = scene.transport.samples
    assert_zero((stack(scene, SEEDS) - truth * full) / scale, 1.0 / samples, visible)


# Edges

STEADY = np.array([[0.0, DURATION_S], [START, START + SPEED * DURATION_S]])
TIMES, STOPS = (0.0, 0.003, 0.006, DURATION_S), (START, START + 2.0, START + 0.5, START + 3.0)
PAN = 0.4
"""rad/s."""


def panned() -> Array:
    """Return where a camera that turns about y sees the edge, as a path in its plane of focus."""
    times = np.linspace(0.0, DURATION_S, 401)
    return np.array([times, FOCUS_MM * np.tan(np.arctan(START / FOCUS_MM) + PAN * times)])


def at(x: float) -> tuple[float, float, float]:
    """Return the position of the plane with its edge at x."""
    return x - 0.5 * (START - FAR), 0.0, -FOCUS_MM


EDGES: dict[str, tuple[Tables, Tables, Array]] = {
    # Keys of the plane and of the camera, and the path of the edge in the camera's view.
    "a target": ({"motion": {"velocity_mm_s": (SPEED, 0.0, 0.0)}}, {}, STEADY),
    "the camera": ({}, {"motion": {"velocity_mm_s": (-SPEED, 0.0, 0.0)}}, STEADY),
    "both": (
        {"motion": {"velocity_mm_s": (0.25 * SPEED, 90.0, 0.0)}},
        {"motion": {"velocity_mm_s": (-0.75 * SPEED, 90.0, 0.0)}},
        STEADY,
    ),
    "to and fro": (
        {"motion": {"poses": [{"time_s": t, "position_mm": at(x)} for t, x in zip(TIMES, STOPS, strict=True)]}}, {},
        np.array([TIMES, STOPS]),
    ),
    "a camera that pans": ({}, {"motion": {"spin_deg_s": (0.0, np.rad2deg(PAN), 0.0)}}, panned()),
}  # fmt: skip


def edge(name: str, **tables: Any) -> lf.Scene:
    """Return an edge and a camera that move against each other."""
    keys, of_camera, _ = EDGES[name]
    tables = {"camera": camera() | of_camera, "exposure": exposure(), "transport": {"samples": SAMPLES}} | tables
    return scene_of([glowing(FAR, START, **keys)], **tables)


@pytest.mark.parametrize("name", EDGES)
def test_an_edge_that_moves_becomes_a_ramp(name: str) -> None:
    compared(edge(name), swept(borders(COLUMNS), EDGES[name][2]))


@pytest.mark.parametrize("name", instances(["a target", "the camera"], long=["the camera"]))
def test_an_edge_that_moves_becomes_a_ramp_to_packets_from_it(name: str) -> None:
    """In the forward method, sums of columns, whose packets meet the lens at uniform times."""
    settings = {"samples": 4096, "method": "forward"}
    images, whole = (stack(scene, SEEDS) for scene in (edge(name, transport=settings), scene_of([WHOLE])))
    full = whole.sum(axis=1).mean(axis=0)
    truth = swept(borders(COLUMNS), EDGES[name][2])
    assert_zero(images.sum(axis=1) / full - truth, 1e-4, 0.02)


def test_time_is_drawn_jointly_with_the_pixel() -> None:
    """At 256 samples a pixel that an edge crosses has an rms error of 0.005, not the 0.031 of independent samples."""
    scene = edge("a target", transport={"samples": 256})
    full = stack(scene_of([WHOLE], transport={"samples": 4096}), [0])[0]
    truth = swept(borders(COLUMNS), STEADY)
    # The edge passes these from side to side, so that their share is a triangle's of the pixel and the time.
    crossed = np.flatnonzero((truth > 0.12) & (truth < 0.88))
    assert len(crossed) >= 4
    error = (stack(scene, SEEDS) / full - truth)[:, :, crossed]
    assert np.sqrt((error**2).mean()) < 0.0075


# Shutters

SHUTTERS: dict[str, Array] = {
    "open": OPEN,
    "a trapezium": np.array([[0.0, 0.002, 0.006, DURATION_S], [0.0, 1.0, 1.0, 0.2]]),
    "two flashes": np.array(
        [[0.0, 0.001, 0.0011, 0.0085, 0.009, DURATION_S], [0.5, 0.5, 0.0, 0.0, 1.0, 1.0]]
    ),
    "a triangle": np.array([[0.0, 0.004, DURATION_S], [0.0, 0.3, 0.0]]),
}  # fmt: skip

WIDTH = 0.6
"""Of a strip that writes the curve of the shutter on the sensor, mm."""


def strip(**keys: Any) -> Tables:
    """Return a strip that shines, with its right edge at START."""
    return glowing(START - WIDTH, START, **keys)


def seen_strip(path: Array, **window: Any) -> Array:
    """Return the mean share of columns that a strip covers whose right edge follows a path, (COLUMNS,)."""
    left = path - [[0.0], [WIDTH]]
    return swept(borders(COLUMNS), path, **window) - swept(borders(COLUMNS), left, **window)


@pytest.mark.parametrize("name", SHUTTERS)
def test_a_strip_writes_the_curve_of_the_shutter(name: str) -> None:
    moved = strip(motion={"velocity_mm_s": (SPEED, 0.0, 0.0)})
    shutter = SHUTTERS[name]
    # The opening is relative: the picture is its weighted mean.
    scene = scene_of([moved], exposure=exposure(shutter), transport={"samples": SAMPLES})
    compared(scene, seen_strip(STEADY, shutter=shutter))


@pytest.mark.parametrize("name", instances(SHUTTERS, long=["open", "a triangle"]))
def test_packets_from_a_strip_write_the_curve_of_the_shutter(name: str) -> None:
    moved = strip(motion={"velocity_mm_s": (SPEED, 0.0, 0.0)})
    settings = {"samples": 4096, "method": "forward"}
    scene = scene_of([moved], exposure=exposure(SHUTTERS[name]), transport=settings)
    full = stack(scene_of([WHOLE]), SEEDS).sum(axis=1).mean(axis=0)
    truth = seen_strip(STEADY, shutter=SHUTTERS[name])
    assert_zero(stack(scene, SEEDS).sum(axis=1) / full - truth, 1e-4, 0.02)


# Rolling shutters

ROW_S = 0.002


def rolled(row: int, direction: str) -> float:
    """Return the begin of the window of a row of the sensor, s; row 0 is the top of the upright picture."""
    return ROW_S * (row if direction == "down" else ROWS - 1 - row)


@pytest.mark.parametrize("method", ["adjoint", "forward"])
@pytest.mark.parametrize("direction", ["down", "up"])
def test_a_rolling_shutter_shears_a_bar(direction: str, method: str) -> None:
    last = DURATION_S + (ROWS - 1) * ROW_S
    slow = 0.5 * SPEED
    path = np.array([[0.0, last], [START, START + slow * last]])
    truth = np.array([seen_strip(path, begin_s=rolled(row, direction)) for row in range(ROWS)])
    # Rows shear by 0.67 pixels each.
    assert abs(np.diff(truth @ np.arange(COLUMNS) / truth.sum(axis=1))).min() > 0.5
    rolling = exposure(row_time_s=ROW_S, row_direction=direction)
    settings = {"samples": SAMPLES if method == "adjoint" else 4096, "method": method}
    scene = scene_of([strip(motion={"velocity_mm_s": (slow, 0.0, 0.0)})], exposure=rolling, transport=settings)
    compared(scene, truth, 0.004 if method == "adjoint" else 0.04)


def test_a_rolling_shutter_of_a_scene_at_rest_changes_nothing() -> None:
    """Not a bit, and neither does the time of the exposure."""
    scene = scene_of([strip()])
    rolling = scene.changed({"exposure": exposure(SHUTTERS["a triangle"], row_time_s=ROW_S, row_direction="up")})
    np.testing.assert_array_equal(lf.render(rolling).mean, lf.render(scene).mean)


# Streaks

STREAKS: dict[str, tuple[tuple[float, float, float], Tables]] = {
    # Displacement in the exposure, and keys of the exposure.
    "along a row": ((4.05, 0.0, 0.0), {}),
    "across, with a shutter": ((3.0, 2.0, 0.0), {"shutter": SHUTTERS["a trapezium"]}),
    "down a rolling shutter": ((0.6, 1.2, 0.0), {"row_time_s": ROW_S, "row_direction": "up"}),
    "up a rolling shutter": ((-0.6, -1.2, 0.0), {"row_time_s": ROW_S, "row_direction": "up"}),
}
FIRST = np.array([-1.9, -0.7, -FOCUS_MM])
"""Where the particle is at t = 0."""

FRAME_S = 0.004


def streak_of(displacement: Array, shutter: Array, begins: Array) -> Array:
    """Return the light of pixels over that of a particle at FIRST, (ROWS, COLUMNS), by 20,000 moments."""
    opens, opening = shutter
    truth = np.zeros((ROWS, COLUMNS))
    time = opens[-1] * (np.arange(20_000) + 0.5) / 20_000
    weight = np.interp(time, opens, opening)
    for row, begin in enumerate(begins):
        points = FIRST + (begin + time)[:, None] / DURATION_S * displacement
        # Light through the lens, I A cos θ / r².
        bright = (np.linalg.norm(FIRST) / np.linalg.norm(points, axis=1)) ** 3
        column, at_row = (
            np.floor(-points[:, k] / SCALE / PIXEL_MM + 0.5 * n).astype(int) for k, n in ((0, COLUMNS), (1, ROWS))
        )
        seen = (at_row == row) & (column >= 0) & (column < COLUMNS)
        np.add.at(truth[row], column[seen], (bright * weight)[seen])
    return truth / weight.sum()


def particle(folder: Path, **tables: Any) -> lf.Scene:
    """Return a particle in focus."""
    (folder / "particle.csv").write_text(f"x_mm,y_mm,z_mm,intensity_w_sr\n{FIRST[0]},{FIRST[1]},{FIRST[2]},1.0\n")
    keys = {"file": "particle.csv", "samples": 4096} | tables.pop("keys", {})
    return scene_of([], particles=[keys], **tables).in_folder(folder)


@pytest.mark.parametrize("name", STREAKS)
def test_a_particle_leaves_a_streak(name: str, tmp_path: Path) -> None:
    """Its displacement in the exposure, pixel by pixel; the displacement of a frame takes FRAME_S."""
    vector, keys = STREAKS[name]
    shutter = keys.get("shutter", OPEN)
    begins = np.array([rolled(row, "up") if "row_time_s" in keys else 0.0 for row in range(ROWS)])
    truth = streak_of(np.array(vector), shutter, begins)
    assert (truth > 0.0).sum() > 2
    assert truth.sum() == pytest.approx(1.0, abs=1e-3) or "row_time_s" in keys
    still = stack(particle(tmp_path), [0]).sum()
    frame = (np.array(vector) * FRAME_S / DURATION_S).tolist()
    moves = {"displacement": {"kind": "uniform", "vector_mm": frame}, "frame_time_s": FRAME_S}
    images = stack(particle(tmp_path, exposure=exposure(**keys), keys=moves), range(24))
    assert_zero(images / still - truth, 2e-3, 0.01)


def test_a_particle_moves_along_the_chord_of_its_displacement(tmp_path: Path) -> None:
    """A rotation of 90 degrees in a frame that takes as long as the exposure; the streak ends where the frame ends."""
    centre = FIRST + np.array([1.5, 0.0, 0.0])
    turn = {"kind": "rotation", "center_mm": centre.tolist(), "axis": (0.0, 0.0, 1.0), "angle_deg": 90.0}
    moves = {"displacement": turn, "frame_time_s": DURATION_S}
    truth = streak_of(np.array([1.5, -1.5, 0.0]), OPEN, np.zeros(ROWS))
    still = stack(particle(tmp_path), [0]).sum()
    images = stack(particle(tmp_path, exposure=exposure(), keys=moves), range(24))
    assert_zero(images / still - truth, 2e-3, 0.01)
