"""Rendering with this tree against rendering with another commit, in turns: what a change costs.

    tools/bench against                                    the baseline, first_light.toml
    tools/bench against HEAD~1 assets/scenes/lit_chart.toml --starts 10

The other commit is checked out beside, and each of the two has a process of its own; they render the same scene file
one after the other, pair by pair, and every second pair in reverse order. Both processes are started several times:
where the memory of a process lies decides on some per cent, the same in all its renders. A ratio is the mean of the
starts' mean logarithms, with its standard error: above one, this tree takes longer.

What later work adds to a scene that does not ask for it is held to 3 % of the baseline in all.
"""

import argparse
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from bench_report import COLOURS, Report, Table, deliver, guarded, parser, say, whole

import lfmesh as lf
from lfmesh.assets import asset_path

ROOT = Path(__file__).resolve().parent.parent

BASELINE = "2ad8118870"
"""Pictures are upright, every stop has its light, every path counts once, runs check their aim, errors of single pixels
are true: in 0.73 of the time before (25 pairs against 44e5d86)."""

COLUMNS = {
    "scene": ("scene", ""),
    "pairs": ("pairs", "d"),
    "here": ("here, s", ".2f"),
    "there": ("there, s", ".2f"),
    "ratio": ("ratio", ".3f"),
    "error": ("±", ".3f"),
    "median": ("median", ".3f"),
}


CLOCKS = {"wall": time.perf_counter, "processor": time.process_time}
"""The processor's own time leaves out what other programs took from it, so it resolves smaller differences."""


def render_on_demand() -> None:
    """Render what each line of the input asks for, and answer with the seconds it took."""
    for line in sys.stdin:
        asked = json.loads(line)
        scene = lf.load(asked["scene"]).changed(asked["changes"])
        clock = CLOCKS[asked["clock"]]
        began = clock()
        lf.render(scene)
        print(json.dumps(clock() - began), flush=True)


class Renderer:
    """A process that renders with the lfmesh of a folder."""

    def __init__(self, tree: Path, clock: str) -> None:
        self.clock = clock
        paths = [str(tree), os.environ.get("PYTHONPATH", "")]
        self.process = subprocess.Popen(
            [sys.executable, __file__, "--case", "{}"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))},
        )  # fmt: skip

    def seconds(self, scene: str, changes: dict[str, Any]) -> float:
        """Render a scene file, and return how long that took."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(json.dumps({"scene": scene, "changes": changes, "clock": self.clock}) + "\n")
        self.process.stdin.flush()
        answer = self.process.stdout.readline()
        if not answer:
            sys.exit("tools/bench: a process that renders ended; what it said stands above")
        return float(json.loads(answer))

    def close(self) -> None:
        """End the process."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait()


@contextmanager
def checked_out(commit: str) -> Iterator[Path]:
    """Check a commit out into a folder that is removed afterwards."""
    with tempfile.TemporaryDirectory(prefix="lfmesh-against-") as folder:
        tree = Path(folder) / "tree"
        done = subprocess.run(
            ["git", "-C", str(ROOT), "worktree", "add", "--quiet", "--detach", str(tree), commit],
            capture_output=True, text=True,
        )  # fmt: skip
        if done.returncode != 0:
            raise lf.LfmeshError(f"{commit}: {done.stderr.strip().splitlines()[-1]}")
        try:
            yield tree
        finally:
            subprocess.run(["git", "-C", str(ROOT), "worktree", "remove", "--force", str(tree)], check=False)


def timed_pairs(
    scene: str, changes: dict[str, Any], pairs: int, trees: Sequence[Renderer]
) -> list[tuple[float, float]]:
    """Return the seconds here and there of each pair of renders."""
    # The first render of a process compiles, or loads what is compiled.
    for tree in trees:
        tree.seconds(scene, changes)
    took = []
    for number in range(pairs):
        order = trees if number % 2 == 0 else trees[::-1]
        seconds = {tree: tree.seconds(scene, changes) for tree in order}
        took.append((seconds[trees[0]], seconds[trees[1]]))
        say(f"pair {number + 1} of {pairs}: {took[-1][0] / took[-1][1]:.3f}")
    return took


def compared(scene: str, changes: dict[str, Any], given: argparse.Namespace, folders: Sequence[Path]) -> dict[str, Any]:
    """Return a row: seconds here and there, and their ratio."""
    took = []
    for start in range(given.starts):
        say(f"start {start + 1} of {given.starts}")
        trees = [Renderer(folder, given.clock) for folder in folders]
        took.append(timed_pairs(scene, changes, given.pairs, trees))
        for tree in trees:
            tree.close()
    pairs = [pair for of_start in took for pair in of_start]
    logs = [[math.log(one / other) for one, other in of_start] for of_start in took]
    # Pairs of the same processes share where their memory and code lie, which is worth some per cent.
    apart = [statistics.mean(of_start) for of_start in logs] if given.starts > 1 else logs[0]
    spread = statistics.stdev(apart) / math.sqrt(len(apart)) if len(apart) > 1 else math.nan
    ratio = math.exp(statistics.mean(apart))
    return {
        "scene": Path(scene).stem,
        "pairs": len(pairs),
        "here": statistics.median(one for one, _ in pairs),
        "there": statistics.median(other for _, other in pairs),
        "ratio": ratio,
        "error": ratio * spread,
        "median": math.exp(statistics.median(one for of_start in logs for one in of_start)),
    }


def main() -> None:
    own = parser("against", "Time this tree against another commit, in turns.")
    own.add_argument("commit", nargs="?", default=BASELINE, help=f"default: the baseline, {BASELINE}")
    own.add_argument("scenes", nargs="*", help="scene files; default: first_light.toml")
    own.add_argument("--pairs", type=whole, default=5, help="renders of each tree, for each start of its process")
    own.add_argument("--starts", type=whole, default=5, help="how often both processes are started")
    own.add_argument("--samples", type=whole, default=8)
    own.add_argument("--replicates", type=whole, default=2)
    own.add_argument("--pixels", type=whole, default=None, help="of each side of the sensor; default: the scene's")
    own.add_argument("--threads", type=whole, default=1)
    own.add_argument("--clock", choices=list(CLOCKS), default="wall", help="processor: on a machine that others use")
    given = own.parse_args()
    if given.case is not None:
        render_on_demand()
        return
    changes: dict[str, Any] = {
        "transport.samples": given.samples,
        "transport.replicates": given.replicates,
        "transport.threads": given.threads,
    }
    if given.quick:
        given.pairs, given.starts = 2, 1
    pixels = 16 if given.quick else given.pixels
    if pixels:
        changes["camera.sensor.pixels"] = [pixels, pixels]
    scenes = [str(Path(scene).resolve()) for scene in given.scenes] or [str(asset_path("scenes/first_light.toml"))]
    for scene in scenes:
        lf.load(scene).changed(changes)
    with checked_out(given.commit) as tree:
        rows = [compared(scene, changes, given, (ROOT, tree)) for scene in scenes]
    report = Report("against", {"commit": given.commit, "clock": given.clock, **changes})
    report.tables["against"] = Table(f"Seconds of a render, against {given.commit}", COLUMNS, rows)
    deliver(report, given, partial(draw, rows))


def draw(rows: list[dict[str, Any]], figure: Any) -> None:
    axes = figure.subplots()
    for number, row in enumerate(rows):
        axes.errorbar(number, row["ratio"], row["error"], fmt="o", color=COLOURS[0])
    axes.axhline(1.0, color=COLOURS[5])
    axes.set_xticks(range(len(rows)), [row["scene"] for row in rows])
    axes.set_ylabel("seconds here over seconds there")


if __name__ == "__main__":
    sys.exit(guarded(main))
