"""Rendering a scene that moves during its exposure against the same scene at rest, to equal error.

    tools/bench motion
    tools/bench motion --samples 32 --rounds 15 --json figures.json

Both scenes of a pair are rendered in turns on one thread, each round with another seed. The ratio of their costs is
that of processor time times mean squared error: the time to reach the same error. Errors are the scatter over rounds,
relative to the picture's mean square. The demo's scene is rendered with all reflections; lit_chart.toml, whose image
path alone is rendered by the sequential engine at rest, is reported without a goal. Building is left out.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from bench_elements import demo
from bench_report import COLOURS, Contender, Ratio, Report, Table, deliver, guarded, in_turns, parser, say, whole

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.transport.render.render import Renderer

PIXELS, QUICK_PIXELS = 160, 8
DURATION_S = 0.01
GOAL = 1.3

BRACKET = {"velocity_mm_s": [150.0, 80.0, 0.0], "spin_deg_s": [0.0, 400.0, 900.0]}
CAMERA = {"velocity_mm_s": [60.0, 0.0, 0.0], "spin_deg_s": [0.0, 15.0, 0.0]}
CHART = {"velocity_mm_s": [150.0, 80.0, 0.0]}
LAMP = {"velocity_mm_s": [3000.0, 0.0, 0.0]}
"""Motions of 1 to 2 mm in the exposure, which is a few lenslets; of the lamp, 30 mm."""

COLUMNS = {
    "scene": ("scene", ""),
    "moving": ("in motion", ""),
    "moving_s": ("in motion, s", ".3f"),
    "still_s": ("at rest, s", ".3f"),
    "time": ("time", ".2f"),
    "error": ("squared error", ".2f"),
    "typical": ("median error", ".2f"),
    "cost": ("cost", ".2f"),
    "goal": ("at most", ".2f"),
    "met": ("met", ""),
}


@dataclass(frozen=True)
class Pair:
    """A scene in motion and at rest.

    Attributes
    ----------
    scene : str
    moving : str
        What moves.
    goal : float or None
        Largest acceptable ratio of the costs.
    scenes : tuple of Scene
        In motion, and at rest.
    """

    scene: str
    moving: str
    goal: float | None
    scenes: tuple[lf.Scene, lf.Scene]

    @property
    def name(self) -> str:
        """Scene, and what moves in it."""
        return f"{self.scene}, {self.moving}"


@dataclass
class Rendered:
    """A world that is rendered with one seed after another.

    Attributes
    ----------
    world : World
    images : list of (H, W) arrays, W
    """

    world: lf.World
    images: list[Any] = field(default_factory=list)

    def reseeded(self) -> lf.World:
        """Return the world with the next seed."""
        self.world = self.world.reseeded(len(self.images) + 1)
        return self.world

    def render(self, world: lf.World) -> None:
        """Keep an image."""
        self.images.append(Renderer(world, check=False).image().mean[..., 0])

    def squared_error(self) -> tuple[float, float]:
        """Return the mean and the median over lit pixels of the scatter's variance, over the picture's mean square."""
        stack = np.array(self.images)
        mean, variance = stack.mean(axis=0), stack.var(axis=0, ddof=1)
        square = float((mean**2).mean())
        return float(variance.mean()) / square, float(np.median(variance[mean > 0.0])) / square


def pairs(pixels: int, samples: int) -> list[Pair]:
    """Return the pairs that are compared."""
    settings = {
        "camera.sensor.pixels": [pixels, pixels], "transport.samples": samples, "transport.replicates": 2,
        "transport.threads": 1,
    }  # fmt: skip
    first_light, lit_chart = demo(pixels, samples), lf.load(asset_path("scenes/lit_chart.toml")).changed(settings)
    rows = (
        ("first_light", first_light, "the bracket", GOAL, "targets[0].motion", BRACKET),
        ("first_light", first_light, "the camera", GOAL, "camera.motion", CAMERA),
        ("first_light", first_light, "the lamp", GOAL, "lights[0].motion", LAMP),
        ("lit_chart", lit_chart, "the chart", None, "targets[0].motion", CHART),
    )
    exposed = {"exposure": {"duration_s": DURATION_S}}
    return [Pair(name, moving, goal, (still.changed(exposed | {key: motion}), still))
            for name, still, moving, goal, key, motion in rows]  # fmt: skip


def measure(pair: Pair, rounds: int) -> tuple[dict[str, Any], Ratio]:
    """Render both scenes of a pair in turns; return a row, and the ratio of their times round by round."""
    say(pair.name)
    moving, still = (Rendered(lf.build(scene)) for scene in pair.scenes)
    clocks = in_turns(
        [Contender("moving", moving.render, moving.reseeded), Contender("still", still.render, still.reseeded)], rounds
    )
    ratio = Ratio.of(f"{pair.name}: time in motion / at rest", clocks["still"].processor, clocks["moving"].processor)
    (mean, typical), (still_mean, still_typical) = moving.squared_error(), still.squared_error()
    cost = ratio.value * mean / still_mean
    met = None if pair.goal is None else "yes" if cost <= pair.goal else "no"
    row = {
        "scene": pair.scene, "moving": pair.moving,
        "moving_s": clocks["moving"].seconds_of_processor, "still_s": clocks["still"].seconds_of_processor,
        "time": ratio.value, "error": mean / still_mean, "typical": typical / still_typical, "cost": cost,
        "goal": pair.goal, "met": met,
    }  # fmt: skip
    return row, ratio


def draw(rows: Sequence[dict[str, Any]], figure: Any) -> None:
    """Draw the costs beside the goals."""
    axes = figure.add_subplot()
    for number, row in enumerate(rows):
        axes.plot(number, row["cost"], "o", color=COLOURS[0])
        if row["goal"] is not None:
            axes.plot(number, row["goal"], "_", color=COLOURS[3], markersize=40)
    axes.set_xticks(range(len(rows)), [f"{row['scene']},\n{row['moving']}" for row in rows])
    axes.set(ylabel="time to equal error, in motion / at rest", ylim=(0, None))


def main() -> None:
    own = parser("motion", "Rendering a scene that moves during its exposure against the same scene at rest.")
    own.add_argument("--samples", type=whole, default=8, help="per pixel, even; default 8")
    own.add_argument("--rounds", type=whole, default=7, help="renders of each scene; default 7")
    given = own.parse_args()
    pixels = QUICK_PIXELS if given.quick else PIXELS
    rounds = 2 if given.quick else given.rounds
    report = Report("motion", {"samples": given.samples, "pixels": pixels, "rounds": rounds})
    measured = [measure(pair, rounds) for pair in pairs(pixels, given.samples)]
    rows = [row for row, _ in measured]
    report.tables["motion"] = Table("Cost of motion, one thread", COLUMNS, rows)
    report.ratios = [ratio for _, ratio in measured]
    deliver(report, given, partial(draw, rows))


if __name__ == "__main__":
    sys.exit(guarded(main))
