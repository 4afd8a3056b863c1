"""Samples that a study needs to resolve a small error: points with the same random numbers against their own.

    tools/bench paired
    tools/bench paired --shift-um 0.5 --json figures.json

The array of the default scene is moved sideways. For each number of samples, studies with other seeds say how large
the change of the image is (the squared difference of both images, PSNR) and how well it is known; their mean over its
standard error is the significance. The samples at which that reaches 5 are read off a straight line through the
logarithms.
"""

import math
import sys
import tempfile
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from bench_report import COLOURS, Report, Table, deliver, guarded, parser, say

import lfmesh as lf
from lfmesh.assets import asset_path

SHIFT = "camera.mla.pose.shift_mm[0]"
SAMPLES = {True: (8, 16, 32, 64, 128), False: (32, 128, 512, 1024)}
QUICK_SAMPLES = {True: (8, 16), False: (16, 32)}
REPLICATES, SEEDS, QUICK_SEEDS = 8, 5, 2
PIXELS, QUICK_PIXELS = 160, 40
WANTED = 5.0

COLUMNS = {
    "paired": ("random numbers", ""),
    "samples": ("samples", "d"),
    "significance": ("significance", ".2f"),
    "error": ("±", ".2f"),
}
NEED_COLUMNS = {
    "paired": ("random numbers", ""),
    "samples": ("samples for 5 sigma", ".3g"),
}


def significance(scene: lf.Scene, shift_mm: float, *, paired: bool) -> float:
    """Return how many standard errors the squared difference of two images is away from none."""
    study = lf.Study(scene, axes=[{"path": SHIFT, "values": [shift_mm]}], metrics=["psnr"], paired=paired)
    with tempfile.TemporaryDirectory() as folder:
        found = study.run(folder, workers=0).rows[1].means["psnr_db"]
    return max(found.value, 0.0) / found.stderr if found.stderr > 0.0 else 0.0


def measure(
    scene: lf.Scene, shift_mm: float, counts: Sequence[int], seeds: int, *, paired: bool
) -> list[dict[str, Any]]:
    """Return a row for each number of samples."""
    rows = []
    for samples in counts:
        say(f"{'shared' if paired else 'own'} random numbers, {samples} samples")
        found = [
            significance(
                scene.changed({"transport.samples": samples, "transport.seed": 1 + seed}), shift_mm, paired=paired
            )
            for seed in range(seeds)
        ]
        rows.append(
            {
                "paired": "shared" if paired else "own",
                "samples": samples,
                "significance": float(np.mean(found)),
                "error": float(np.std(found, ddof=1) / math.sqrt(seeds)),
            }
        )
    return rows


def needed(rows: Sequence[dict[str, Any]]) -> float:
    """Return the samples at which the significance is WANTED, by a straight line through the logarithms."""
    known = [(row["samples"], row["significance"]) for row in rows if row["significance"] > 0.0]
    if len(known) < 2:
        return math.nan
    x, y = np.log(np.array(known)).T
    slope, start = np.polyfit(x, y, 1)
    return math.exp((math.log(WANTED) - start) / slope) if slope > 0.0 else math.nan


def draw(rows: Sequence[dict[str, Any]], figure: Any) -> None:
    """Draw the significance against the samples."""
    axes = figure.add_subplot()
    for colour, name in zip(COLOURS, ("shared", "own"), strict=False):
        mine = [row for row in rows if row["paired"] == name]
        axes.errorbar(
            [row["samples"] for row in mine], [row["significance"] for row in mine],
            yerr=[row["error"] for row in mine], fmt="o-", color=colour, label=f"{name} random numbers",
        )  # fmt: skip
    axes.axhline(WANTED, color="#8c8c8c")
    axes.set(xscale="log", yscale="log", xlabel="samples per pixel", ylabel="significance")
    axes.legend()


def main() -> None:
    own = parser("paired", "Samples that a study needs to resolve a small error of the array.")
    own.add_argument("--shift-um", type=float, default=1.0, help="how far the array is moved; default 1 µm")
    given = own.parse_args()
    if not 0.0 < given.shift_um < 1000.0:
        own.error(f"--shift-um {given.shift_um}: must lie between 0 and 1000")
    pixels = QUICK_PIXELS if given.quick else PIXELS
    counts = QUICK_SAMPLES if given.quick else SAMPLES
    scene = lf.load(asset_path("scenes/first_light.toml")).changed(
        {"camera.sensor.pixels": [pixels, pixels], "transport.split": "transmit", "transport.replicates": REPLICATES}
    )
    rows, needs = [], []
    for paired in (True, False):
        found = measure(
            scene, 1e-3 * given.shift_um, counts[paired], QUICK_SEEDS if given.quick else SEEDS, paired=paired
        )
        rows += found
        needs.append({"paired": found[0]["paired"], "samples": needed(found)})
    report = Report("paired", {"shift_um": given.shift_um, "pixels": pixels, "replicates": REPLICATES})
    report.tables["paired"] = Table("How far an error is resolved", COLUMNS, rows)
    report.tables["needed"] = Table("Samples needed", NEED_COLUMNS, needs)
    deliver(report, given, partial(draw, rows))


if __name__ == "__main__":
    sys.exit(guarded(main))
