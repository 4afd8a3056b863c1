"""Rendering through a gradient-index element or a diffractive face against plain glass, in turns.

    tools/bench elements
    tools/bench elements --samples 32 --rounds 15 --json figures.json

The scene first_light.toml is rendered with all reflections, on one thread. A plate of 12 mm stands in front of the
lens, of a weak radial gradient or of its index on the axis; or the first face of the lens has a weak phase or none.
Both scenes of a pair take about the same paths, so that the ratio of their times is the cost of the element. Building
is left out.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from bench_report import COLOURS, Contender, Ratio, Report, Table, deliver, guarded, in_turns, parser, say, whole

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.transport.render.render import Renderer

PLATE_MM, GAP_MM, SEMI_MM, INDEX = 12.0, 1.0, 16.0, 1.6
PIXELS, QUICK_PIXELS = 160, 8

COLUMNS = {
    "element": ("element", ""),
    "with_s": ("with it, s", ".3f"),
    "without_s": ("without, s", ".3f"),
    "ratio": ("ratio", ".3f"),
    "goal": ("at most", ".2f"),
    "met": ("met", ""),
}


@dataclass(frozen=True)
class Pair:
    """A scene with an element and one without.

    Attributes
    ----------
    element : str
    goal : float
        Largest acceptable ratio of their times.
    scenes : tuple of Scene
        With the element, and without.
    """

    element: str
    goal: float
    scenes: tuple[lf.Scene, lf.Scene]


def demo(pixels: int, samples: int) -> lf.Scene:
    """Return the scene first_light.toml with all reflections, in a crop of the sensor."""
    return lf.load(asset_path("scenes/first_light.toml")).changed(
        {
            "camera.sensor.pixels": [pixels, pixels],
            "transport.split": "both",
            "transport.samples": samples,
            "transport.replicates": 2,
            "transport.threads": 1,
        }
    )


def behind_a_plate(scene: lf.Scene, glass: dict[str, Any]) -> lf.Scene:
    """Return a scene with a plate of glass in front of its lens."""
    front = {"thickness_mm": PLATE_MM, "semi_diameter_mm": SEMI_MM, **glass}
    back = {"thickness_mm": GAP_MM, "semi_diameter_mm": SEMI_MM}
    lens = scene.camera.lens
    tables = [front, back, *(surface.model_dump(exclude_unset=True) for surface in lens.surfaces)]
    stop = {"stop_semi_diameter_mm": lens.stop_semi_diameter_mm}
    return scene.changed({"camera.lens": {"surfaces": tables, **stop}})


def pairs(pixels: int, samples: int) -> list[Pair]:
    """Return the pairs that are compared."""
    scene = demo(pixels, samples)
    gradient = {"kind": "radial_n2", "index": INDEX, "coefficients": [-2e-5]}
    phase = {"kind": "radial", "coefficients_rad": [-60.0], "radius_mm": SEMI_MM}
    plates = [behind_a_plate(scene, glass) for glass in ({"gradient": gradient}, {"index": INDEX})]
    return [
        Pair(f"gradient-index plate of {PLATE_MM:g} mm", 3.0, (plates[0], plates[1])),
        Pair("diffractive face", 1.15, (scene.changed({"camera.lens.surfaces[0].phase": phase}), scene)),
    ]


def measure(pair: Pair, rounds: int) -> tuple[dict[str, Any], Ratio]:
    """Render both scenes of a pair in turns; return a row, and the ratio round by round."""
    say(pair.element)
    worlds = [lf.build(scene) for scene in pair.scenes]
    names = f"{pair.element}, with", f"{pair.element}, without"

    def render(world: lf.World, _: Any) -> None:
        Renderer(world, check=False).image()

    clocks = in_turns(
        [Contender(name, partial(render, world)) for name, world in zip(names, worlds, strict=True)], rounds
    )
    has, lacks = (clocks[name] for name in names)
    # The processor's own time leaves out what other programs took.
    ratio = Ratio.of(f"{pair.element}, with / without", lacks.processor, has.processor)
    row = {
        "element": pair.element, "with_s": has.seconds_of_processor, "without_s": lacks.seconds_of_processor,
        "ratio": ratio.value, "goal": pair.goal, "met": "yes" if ratio.value <= pair.goal else "no",
    }  # fmt: skip
    return row, ratio


def draw(rows: Sequence[dict[str, Any]], figure: Any) -> None:
    """Draw the ratios beside the goals."""
    axes = figure.add_subplot()
    for number, row in enumerate(rows):
        axes.plot(number, row["ratio"], "o", color=COLOURS[0])
        axes.plot(number, row["goal"], "_", color=COLOURS[3], markersize=40)
    axes.set_xticks(range(len(rows)), [row["element"] for row in rows])
    axes.set(ylabel="seconds with / without", ylim=(0, None))


def main() -> None:
    own = parser("elements", "Rendering through a gradient-index element or a diffractive face against plain glass.")
    own.add_argument("--samples", type=whole, default=8, help="per pixel, even; default 8")
    own.add_argument("--rounds", type=whole, default=7, help="renders of each scene; default 7")
    given = own.parse_args()
    pixels = QUICK_PIXELS if given.quick else PIXELS
    rounds = 2 if given.quick else given.rounds
    report = Report("elements", {"samples": given.samples, "pixels": pixels, "rounds": rounds})
    measured = [measure(pair, rounds) for pair in pairs(pixels, given.samples)]
    rows = [row for row, _ in measured]
    report.tables["elements"] = Table("Processor time of a render, with all reflections, one thread", COLUMNS, rows)
    report.ratios = [ratio for _, ratio in measured]
    deliver(report, given, partial(draw, rows))


if __name__ == "__main__":
    sys.exit(guarded(main))
