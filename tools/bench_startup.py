"""Waiting time before the first ray: imports, help, compiling on a fresh install, loading compiled kernels.

    tools/bench startup
    tools/bench startup --rounds 5 --json figures.json

Every step is timed from outside, in fresh processes, from before Python starts. The render is one of 16 × 16 pixels,
whose tracing takes no time to speak of: with an empty folder in place of the cache it shows what compiling costs, in
the second process what comes before the first ray.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from bench_report import COLOURS, Report, Table, deliver, guarded, parser, say, whole

ROUNDS, QUICK_ROUNDS = 3, 1
UNIT = "import numpy"
"""Step whose processor time is the unit of the others', so that figures of several machines can be compared."""
SPLIT = {"all reflections": "both", "image path": "transmit"}

RENDER = """
import lfmesh as lf
from lfmesh.assets import asset_path
changes = {{"camera.sensor.pixels": [16, 16], "transport.samples": 2, "transport.replicates": 2}}
lf.render(lf.load(asset_path("scenes/first_light.toml")).changed(changes | {{"transport.split": "{split}"}}))
"""

COLUMNS = {
    "step": ("step", ""),
    "seconds": ("seconds", ".2f"),
    "processor_s": ("of processor", ".2f"),
    "ratio": ("to import numpy", ".1f"),
}


@dataclass(frozen=True)
class StartupRow:
    """Time of a step in a fresh process: medians over the rounds.

    Attributes
    ----------
    step : str
    seconds, processor_s : float
        By the clock, and of the processor.
    ratio : float
        Processor time over that of `UNIT`, taken in the same round.
    """

    step: str
    seconds: float
    processor_s: float
    ratio: float


def clocked(arguments: Sequence[str], cache: Path | None = None) -> tuple[float, float]:
    """Run Python in a fresh process; return its seconds, of the clock and of the processor.

    Parameters
    ----------
    cache : Path, optional
        Where compiled kernels are kept, in place of the folders of lfmesh.
    """
    environment = os.environ | ({} if cache is None else {"NUMBA_CACHE_DIR": str(cache)})
    before, began = os.times(), time.perf_counter()
    child = subprocess.run([sys.executable, *arguments], stdout=subprocess.DEVNULL, env=environment)
    seconds, after = time.perf_counter() - began, os.times()
    if child.returncode != 0:
        sys.exit(child.returncode if child.returncode > 0 else 1)
    spent = after.children_user - before.children_user + after.children_system - before.children_system
    return seconds, spent


def measure_round() -> dict[str, tuple[float, float]]:
    """Take every step once."""
    found = {
        "Python alone": clocked(["-c", "pass"]),
        UNIT: clocked(["-c", UNIT]),
        "import lfmesh": clocked(["-c", "import lfmesh"]),
        "lfmesh --help": clocked(["-m", "lfmesh", "--help"]),
        "lfmesh --version": clocked(["-m", "lfmesh", "--version"]),
        "lfmesh lens list": clocked(["-m", "lfmesh", "lens", "list"]),
    }
    for paths, split in SPLIT.items():
        code = RENDER.format(split=split)
        with tempfile.TemporaryDirectory() as folder:
            found[f"first render, {paths}"] = clocked(["-c", code], Path(folder))
            found[f"second process, {paths}"] = clocked(["-c", code], Path(folder))
    return found


def measure(rounds: int) -> list[StartupRow]:
    """Take all steps in turn, round after round."""
    found = []
    for number in range(rounds):
        say(f"round {number + 1} of {rounds}")
        found.append(measure_round())
    rows = []
    for step in found[0]:
        seconds, processor_s = (float(np.median([taken[step][clock] for taken in found])) for clock in (0, 1))
        ratio = float(np.median([taken[step][1] / taken[UNIT][1] for taken in found]))
        rows.append(StartupRow(step, seconds, processor_s, ratio))
    return rows


def draw(rows: Sequence[StartupRow], figure: Any) -> None:
    """Draw the seconds of each step."""
    axes = figure.add_subplot()
    axes.barh([row.step for row in rows], [row.seconds for row in rows], color=COLOURS[0])
    axes.invert_yaxis()
    axes.set(xscale="log", xlabel="seconds")


def main() -> None:
    own = parser("startup", "What a user waits for before the first ray.")
    own.add_argument("--rounds", type=whole, help=f"each step once a round; default {ROUNDS}")
    given = own.parse_args()
    rounds = given.rounds or (QUICK_ROUNDS if given.quick else ROUNDS)
    rows = measure(rounds)
    report = Report("startup", {"rounds": rounds})
    report.tables["startup"] = Table("From the start of a fresh process", COLUMNS, [asdict(row) for row in rows])
    deliver(report, given, partial(draw, rows))


if __name__ == "__main__":
    sys.exit(guarded(main))
