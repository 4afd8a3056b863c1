"""Rendering through a medium that bends light against the same scene without it, and the error of the steps in media.

    tools/bench fields
    tools/bench fields --samples 32 --rounds 15 --json figures.json

The demo's scene is rendered with all reflections, on one thread, with and without a weak field of 128³ voxels in front
of all it shows. Building is left out. The second table follows rays through Gaussian balls, weak and strong, by each
scheme and step that a field may get. Its errors are those of the deflection, over the largest one, against steps that
are far finer; `chosen` marks the steps that the program takes.
"""

import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from bench_elements import COLUMNS, Pair, demo, measure
from bench_report import COLOURS, Report, Table, deliver, guarded, parser, say, whole

import lfmesh as lf
from lfmesh.optics.index_field_path import deflections, entries, traced
from lfmesh.optics.index_field_steps import CANDIDATES, probed
from lfmesh.optics.index_fields import LEAPFROG, RUNGE_KUTTA, IndexField, field_table, index_field

VOXELS, QUICK_VOXELS = 128, 16
SIDE_MM, AWAY_MM = 128.0, -250.0
DEPTH = 2e-4
"""Largest change of the index by the field of the demo's scene."""

PIXELS, QUICK_PIXELS = 160, 8
GOAL = 6.0

DELTAS = {"weak": 2e-4, "strong": 0.1}
BALL_VOXELS, BALL_WIDTH = 93, 8.0
RAYS, QUICK_RAYS = 4096, 64
NAMES = {LEAPFROG: "leapfrog", RUNGE_KUTTA: "Runge-Kutta"}
FINEST = 0.25
"""Step of the truth, voxels."""

STEP_COLUMNS = {
    "ball": ("ball", ""),
    "scheme": ("scheme", ""),
    "step": ("step, voxels", ".0f"),
    "error": ("error of the deflection", ".1e"),
    "ns": ("ns per voxel", ".1f"),
    "chosen": ("chosen", ""),
}


def behind_a_field(scene: lf.Scene, voxels: int, folder: Path) -> lf.Scene:
    """Return a scene with warm eddies in front of what it shows."""
    at = (np.arange(voxels) - 0.5 * (voxels - 1)) * (SIDE_MM / voxels)
    draw = np.random.default_rng(1)
    index = np.ones((voxels, voxels, voxels))
    for sign in (1.0, -1.0) * 8:
        width, centre = draw.uniform(8.0, 16.0), draw.uniform(-30.0, 30.0, 3)
        x, y, z = (np.exp(-(((at - c) / width) ** 2)) for c in centre)
        index += 0.5 * sign * DEPTH * x[:, None, None] * y[:, None] * z
    path = folder / "field.npz"
    np.savez(path, index=index, spacing_mm=SIDE_MM / voxels)
    return scene.changed({"media": [{"grid": str(path), "position_mm": (0.0, 0.0, AWAY_MM)}]})


def ball(delta: float) -> IndexField:
    """Return a Gaussian ball on voxels of 1 mm."""
    x2 = (np.arange(BALL_VOXELS) - 0.5 * (BALL_VOXELS - 1)) ** 2
    return index_field(1.0 + delta * np.exp(-(x2[:, None, None] + x2[:, None] + x2) / BALL_WIDTH**2), 1.0)


def rays_past(field: IndexField, rays: int) -> Any:
    """Return rays in all directions at their entries, (n, 8)."""
    draw = np.random.default_rng(2)
    along = draw.normal(size=(rays, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along, draw.normal(size=(rays, 3)))
    across *= draw.uniform(0.0, 1.5 * BALL_WIDTH, (rays, 1)) / np.linalg.norm(across, axis=1, keepdims=True)
    return entries(field_table([field]), 0, across - 200.0 * along, along)


def steps(rays: int, rounds: int) -> list[dict[str, Any]]:
    """Return a row for each ball, scheme and step."""
    rows = []
    for name, delta in DELTAS.items():
        say(f"{name} ball")
        field = ball(delta)
        starts, chosen = rays_past(field, rays), probed(field)
        _, truth = traced(field_table([replace(field, scheme=RUNGE_KUTTA, step_cells=FINEST)]), 0, starts)
        largest = float(deflections(starts, truth).max())
        for scheme, step in CANDIDATES:
            table = field_table([replace(field, scheme=scheme, step_cells=step)])
            taken = []
            for _ in range(rounds):
                begun = time.process_time()
                _, ends = traced(table, 0, starts)
                taken.append(time.process_time() - begun)
            rows.append(
                {
                    "ball": name, "scheme": NAMES[scheme], "step": step,
                    "error": float(deflections(truth, ends).max()) / largest,
                    # Voxels of 1 mm.
                    "ns": 1e9 * float(np.median(taken)) / float(ends[:, 7].sum()),
                    "chosen": "yes" if (scheme, step) == (chosen.scheme, chosen.step_cells) else "no",
                }
            )  # fmt: skip
    return rows


def draw(rows: Sequence[dict[str, Any]], figure: Any) -> None:
    """Draw the errors of the steps against their times."""
    axes = figure.add_subplot()
    for colour, name in zip(COLOURS, DELTAS, strict=False):
        some = [row for row in rows if row["ball"] == name]
        axes.plot([row["ns"] for row in some], [row["error"] for row in some], "o", color=colour, label=f"{name} ball")
    axes.set(xscale="log", yscale="log", xlabel="ns per voxel", ylabel="error of the deflection, over the largest")
    axes.legend()


def main() -> None:
    own = parser("fields", "Rendering through a medium that bends light, and the error of the steps in media.")
    own.add_argument("--samples", type=whole, default=8, help="per pixel, even; default 8")
    own.add_argument("--rounds", type=whole, default=7, help="renders of each scene; default 7")
    given = own.parse_args()
    pixels, voxels, rays = (QUICK_PIXELS, QUICK_VOXELS, QUICK_RAYS) if given.quick else (PIXELS, VOXELS, RAYS)
    rounds = 2 if given.quick else given.rounds
    report = Report("fields", {"samples": given.samples, "pixels": pixels, "rounds": rounds, "voxels": voxels})
    scene = demo(pixels, given.samples)
    with tempfile.TemporaryDirectory(prefix="lfmesh-") as folder:
        pair = Pair(f"weak field of {voxels}³ voxels", GOAL, (behind_a_field(scene, voxels, Path(folder)), scene))
        row, ratio = measure(pair, rounds)
    report.tables["fields"] = Table("Processor time of a render, with all reflections, one thread", COLUMNS, [row])
    report.ratios = [ratio]
    rows = steps(rays, rounds)
    report.tables["steps"] = Table("Steps of rays past Gaussian balls of 16 voxels across", STEP_COLUMNS, rows)
    deliver(report, given, partial(draw, rows))


if __name__ == "__main__":
    sys.exit(guarded(main))
