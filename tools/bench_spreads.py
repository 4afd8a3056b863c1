"""Processor time of point spreads against their error, by the tolerance that is asked for.

    tools/bench spreads
    tools/bench spreads --scene lit_chart --json figures.json

The error is the sum of absolute differences from the spread of the finest tolerance, over its light; `changed` is what
a spread says of itself, the change with its last grid.
"""

import sys
import time
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from bench_report import COLOURS, Report, Table, deliver, guarded, parser, say

import lfmesh as lf
from lfmesh.assets import asset_path

POINTS: dict[str, tuple[float, float, float]] = {
    "conventional": (0.0, 0.0, -500.0),
    "lit_chart": (0.0, 0.0, -480.0),
    "light_field_microscope": (0.003, 0.001, -18.05),
}
"""Scenes in assets, and a point of each."""

TOLERANCES, QUICK_TOLERANCES = (0.1, 0.02, 0.003, 0.001), (0.5, 0.1)
"""The last one is the reference."""

COLUMNS = {
    "scene": ("scene", ""),
    "tolerance": ("tolerance", "g"),
    "processor": ("processor s", ".1f"),
    "changed": ("changed", ".2%"),
    "error": ("error", ".2%"),
    "beyond": ("beyond the grid", ".2%"),
}


def rows_of(name: str, tolerances: Sequence[float]) -> list[dict[str, Any]]:
    """Return a row for each tolerance but the last, whose spread is the reference."""
    scene = lf.load(asset_path(f"scenes/{name}.toml")).changed({"targets": ()})
    found = []
    for tolerance in tolerances:
        say(f"{name}, tolerance {tolerance:g}")
        began = time.process_time()
        found.append((lf.point_spread(scene, POINTS[name], tolerance=tolerance), time.process_time() - began))
    truth = found[-1][0].mean
    return [
        {
            "scene": name, "tolerance": tolerance, "processor": seconds, "changed": spread.change,
            "error": float(np.abs(spread.mean - truth).sum() / truth.sum()), "beyond": spread.beyond,
        }
        for tolerance, (spread, seconds) in zip(tolerances[:-1], found[:-1], strict=True)
    ]  # fmt: skip


def draw(rows: Sequence[dict[str, Any]], figure: Any) -> None:
    """Draw the error over the processor time of each scene."""
    axes = figure.add_subplot()
    for name, colour in zip(dict.fromkeys(row["scene"] for row in rows), COLOURS, strict=False):
        own = [row for row in rows if row["scene"] == name]
        axes.plot([row["processor"] for row in own], [row["error"] for row in own], "o-", color=colour, label=name)
    axes.set(xscale="log", yscale="log", xlabel="processor time, s", ylabel="error over the light")
    axes.legend()


def main() -> None:
    own = parser("spreads", "Processor time of point spreads against their error, by tolerance.")
    own.add_argument("--scene", choices=sorted(POINTS), help="one of the scenes in assets; default: all of them")
    given = own.parse_args()
    tolerances = QUICK_TOLERANCES if given.quick else TOLERANCES
    names = [given.scene] if given.scene else ["conventional"] if given.quick else list(POINTS)
    report = Report("spreads", {"reference_tolerance": tolerances[-1]})
    rows = [row for name in names for row in rows_of(name, tolerances)]
    report.tables["spreads"] = Table("Processor time against error", COLUMNS, rows)
    deliver(report, given, partial(draw, rows))


if __name__ == "__main__":
    sys.exit(guarded(main))
