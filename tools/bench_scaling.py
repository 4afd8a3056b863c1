"""Growth of time and memory with samples, pixels, lenslets, target triangles, threads, and things in the scene.

    tools/bench scaling                               both engines, every series
    tools/bench scaling --series lenslets --json figures.json

The scene is a lamp-lit ball through the lens and microlenses of emitting_plane.toml, made larger in one way at a time.
Sizes are timed in turns; each one's peak memory is that of a process of its own. Under each series stands the exponent
that fits its times, time ∝ size^exponent, with its standard error. A render has a fixed cost of some hundredths of a
second, mostly memory touched for the first time, so the sequential engine takes more samples throughout.

`--series lamps`, `spheres`, `parts` and `facets` measure scenes of many things, and compare them with their goals, see
`bench_things`.

Threads are held against a control: as many processes of one thread each, which render the same scene at the same time.
They share the processor as the threads do, and nothing else; what the threads fall short of them is lfmesh's own loss.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from bench_report import (
    COLOURS,
    Contender,
    Ratio,
    Report,
    Table,
    ask_child,
    deliver,
    guarded,
    in_turns,
    parser,
    peak_mib,
    say,
    whole,
)
from bench_things import COLUMNS as THING_COLUMNS
from bench_things import EXPONENT_COLUMNS as THING_EXPONENT_COLUMNS
from bench_things import GOAL_COLUMNS, THINGS, exponent_of, goals_of, measure_things

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.scene import Scene
from lfmesh.transport.render.render import Renderer

ENGINES = ("mesh", "sequential")
BALL_RADIUS_MM = 40.0
ROUNDS, QUICK_ROUNDS = 5, 2
ARRAY_MM, SENSOR_MM = 8.0, 8.0
SAMPLES = {"mesh": 16, "sequential": 128}
"""Unless samples are what grows: for renders that take about as long."""
THREADS = "threads"
THREADS_SIDE = 2
"""Pixels a side, times those of the series: while the last chunk of a replicate is traced, the other threads wait."""


@dataclass(frozen=True)
class Series:
    """One way to make the scene larger.

    Attributes
    ----------
    sizes, quick : tuple of int
    changes : callable
        From a size, and the folder where meshes lie, to what changes in the scene.
    """

    sizes: tuple[int, ...]
    quick: tuple[int, ...]
    changes: Callable[[int, Path], dict[str, Any]]


def samples(size: int, _: Path) -> dict[str, Any]:
    return {"transport.samples": size}


def pixels(size: int, _: Path) -> dict[str, Any]:
    side = round(size**0.5)
    return {"camera.sensor.pixels": [side, side], "camera.sensor.pixel_mm": SENSOR_MM / side}


def lenslets(size: int, _: Path) -> dict[str, Any]:
    """Shrink all lenslets alike, so that their f-number stays and the array covers the sensor."""
    side = round(size**0.5)
    pitch = ARRAY_MM / side
    return {
        "camera.mla.count": [side, side],
        "camera.mla.pitch_mm": pitch,
        "camera.mla.focal_length_mm": 4.0 * pitch,
        "camera.mla.thickness_mm": 2.4 * pitch,
    }


def triangles(size: int, folder: Path) -> dict[str, Any]:
    ball = {"file": str(ball_file(size, folder)), "units": "mm", "position_mm": [0.0, 0.0, -500.0]}
    return {"targets": [ball]}


SERIES = {
    "samples": Series((1, 2, 4, 8, 16), (1, 2), samples),  # times those of the engine
    "pixels": Series((120**2, 160**2, 240**2, 320**2, 400**2), (40**2, 80**2), pixels),
    "lenslets": Series((16**2, 32**2, 64**2, 128**2, 256**2, 512**2), (16**2, 64**2), lenslets),
    "triangles": Series((1_280, 5_120, 20_480, 81_920, 327_680, 1_310_720), (1_280, 5_120), triangles),
}

COLUMNS = {
    "series": ("grows", ""),
    "engine": ("engine", ""),
    "size": ("size", ",d"),
    "paths_per_s": ("paths/s", ".3g"),
    "seconds": ("seconds", ".3f"),
    "build_seconds": ("build s", ".2f"),
    "peak_mib": ("peak MiB", ".0f"),
}
THREAD_COLUMNS = {
    "engine": ("engine", ""),
    "way": ("renders in", ""),
    "paths_per_s": ("paths/s", ".3g"),
}
EXPONENT_COLUMNS = {
    "series": ("time against", ""),
    "engine": ("engine", ""),
    "exponent": ("exponent", ".3f"),
    "exponent_error": ("±", ".3f"),
}


@dataclass(frozen=True)
class ScalingRow:
    """One size of one series: paths started a second, seconds of tracing (median), of building, and peak memory."""

    series: str
    engine: str
    size: int
    paths_per_s: float
    seconds: float
    build_seconds: float
    peak_mib: float


def sizes_of(series: str, engine: str, quick: bool) -> tuple[int, ...]:
    """Return the sizes of a series."""
    sizes = SERIES[series].quick if quick else SERIES[series].sizes
    return tuple(size * SAMPLES[engine] for size in sizes) if series == "samples" else sizes


def ball_file(faces: int, folder: Path) -> Path:
    """Return a mesh file of a ball with so many triangles, 20 · 4^k."""
    file = folder / f"ball_{faces}.stl"
    if not file.exists():
        subdivisions = round(np.log(faces / 20) / np.log(4))
        trimesh.creation.icosphere(subdivisions, BALL_RADIUS_MM).export(file)
    return file


def scene_of(series: str, size: int, engine: str, side: int, folder: Path) -> Scene:
    """Return the common scene with `side` pixels a side, made larger in one way."""
    scene = lf.load(asset_path("scenes/emitting_plane.toml"))
    ball = {"shape": {"kind": "sphere", "radius_mm": BALL_RADIUS_MM}, "position_mm": [0.0, 0.0, -500.0]}
    common = {
        "targets": [ball],
        "lights": [{"kind": "point", "position_mm": [-200.0, 300.0, -200.0], "power_w": 1.0}],
        "camera.sensor.distance_mm": None,
        "camera.mla.distance_mm": None,
        "transport.engine": engine,
        "transport.split": "transmit" if engine == "sequential" else "both",
        "transport.samples": SAMPLES[engine],
        "transport.replicates": 2,
    }
    return scene.changed(common | pixels(side * side, folder) | SERIES[series].changes(size, folder))


def measure_memory(series: str, size: int, engine: str, side: int, folder: str) -> dict[str, float]:
    """Render in this process; return its peak memory and the seconds that building took."""
    scene = scene_of(series, size, engine, side, Path(folder))
    # Compile first, on few pixels: what the compiler holds is then in every row alike.
    lf.render(scene_of("pixels", 8 * 8, engine, side, Path(folder)))
    began = time.perf_counter()
    world = lf.build(scene)
    build_seconds = time.perf_counter() - began
    Renderer(world).image()
    return {"build_seconds": build_seconds, "peak_mib": peak_mib()}


def measure(series: str, engine: str, side: int, rounds: int, quick: bool, folder: Path) -> list[ScalingRow]:
    """Measure a series with one engine."""
    sizes = sizes_of(series, engine, quick)
    worlds = {size: lf.build(scene_of(series, size, engine, side, folder)) for size in sizes}
    contenders = [Contender(str(size), lambda _, w=world: Renderer(w).image()) for size, world in worlds.items()]
    clocks = in_turns(contenders, rounds)
    rows = []
    for size, world in worlds.items():
        transport, sensor = world.scene.transport, world.scene.camera.sensor
        seconds = clocks[str(size)].seconds
        case = {"series": series, "size": size, "engine": engine, "side": side, "folder": str(folder)}
        paths = transport.samples * sensor.pixels[0] * sensor.pixels[1]
        rows.append(ScalingRow(series, engine, size, paths / seconds, seconds, **ask_child(__file__, case)))
    return rows


class Renders:
    """A process of its own that renders one scene whenever it is told to."""

    def __init__(self, engine: str, side: int, threads: int) -> None:
        case = {"engine": engine, "side": side, "threads": threads}
        self.process = subprocess.Popen(
            [sys.executable, __file__, "--case", json.dumps(case)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1,
        )  # fmt: skip
        self.paths = int(self.answer())

    def start(self) -> None:
        """Tell it to render."""
        assert self.process.stdin is not None
        self.process.stdin.write("render\n")

    def answer(self) -> str:
        """Wait for what it says next: paths of a render when it is ready, then the seconds of each."""
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            sys.exit(self.process.wait() or 1)
        return line

    def close(self) -> None:
        """Let it end."""
        self.process.communicate()


def render_when_told(engine: str, side: int, threads: int) -> None:
    """Render in this process, once for every line of standard input; print the seconds of each."""
    scene = scene_of("pixels", side * side, engine, side, Path()).changed({"transport.threads": threads})
    world = lf.build(scene)
    Renderer(world).image()
    print(scene.transport.samples * scene.camera.sensor.pixels[0] * scene.camera.sensor.pixels[1], flush=True)
    for _ in sys.stdin:
        print(Renderer(world).image().seconds, flush=True)


def measure_threads(engine: str, side: int, rounds: int) -> tuple[list[dict[str, Any]], list[Ratio]]:
    """Hold one process with a thread a core against one thread, and against as many processes of one thread."""
    cores = os.cpu_count() or 1
    single = [Renders(engine, side, 1) for _ in range(cores)]
    threaded = Renders(engine, side, cores)
    ways = {"1 thread": single[:1], f"{cores} threads": [threaded], f"{cores} processes": single}
    # Seconds for the paths of one render.
    seconds: dict[str, list[float]] = {way: [] for way in ways}
    for number in range(rounds):
        for way in ways if number % 2 == 0 else reversed(ways):
            for process in ways[way]:
                process.start()
            # One that ends first leaves the others more room, so all of their clocks count.
            mean = float(np.mean([float(process.answer()) for process in ways[way]]))
            seconds[way].append(mean / len(ways[way]))
    for process in (*single, threaded):
        process.close()
    rows = [
        {"engine": engine, "way": way, "paths_per_s": threaded.paths / float(np.median(taken))}
        for way, taken in seconds.items()
    ]
    alone, together, apart = seconds.values()
    ratios = [
        Ratio.of(f"{engine}, {cores} threads: efficiency, rate over that of {cores} processes", together, apart),
        Ratio.of(f"{engine}, {cores} threads: rate over that of 1 thread", together, alone),
    ]
    return rows, ratios


def exponent(rows: Sequence[ScalingRow]) -> dict[str, Any]:
    """Fit time ∝ size^exponent through a series of one engine; the error is None for two sizes, which any line fits."""
    x, y = np.log([row.size for row in rows]), np.log([row.seconds for row in rows])
    found = {"series": rows[0].series, "engine": rows[0].engine, "exponent": None, "exponent_error": None}
    if len(rows) < 2:
        return found
    slope, offset = np.polyfit(x, y, 1)
    found["exponent"] = float(slope)
    if len(rows) > 2:
        variance = np.sum((y - offset - slope * x) ** 2) / (len(rows) - 2)
        found["exponent_error"] = float(np.sqrt(variance / np.sum((x - x.mean()) ** 2)))
    return found


def draw(rows: Sequence[ScalingRow], ways: Sequence[dict[str, Any]], figure: Any) -> None:
    """Draw time and memory against size, a panel a series; without series, the rates of threads and processes."""
    if not rows:
        axes = figure.add_subplot()
        axes.barh([f"{row['engine']}, {row['way']}" for row in ways], [row["paths_per_s"] for row in ways])
        axes.set(xlabel="paths / s")
        return
    names = list(dict.fromkeys(row.series for row in rows))
    for place, series in enumerate(names):
        for line, (key, label) in enumerate((("seconds", "tracing / s"), ("peak_mib", "peak memory / MiB"))):
            axes = figure.add_subplot(2, len(names), line * len(names) + place + 1)
            for engine, colour in zip(ENGINES, COLOURS, strict=False):
                own = [row for row in rows if row.series == series and row.engine == engine]
                axes.plot(
                    [row.size for row in own], [getattr(row, key) for row in own], "o-", color=colour, label=engine
                )
            axes.set(xscale="log", yscale="log" if key == "seconds" else "linear", xlabel=series)
            if key == "peak_mib":
                axes.set_ylim(0, None)
            if place == 0:
                axes.set_ylabel(label)
                axes.legend(frameon=False)


def measure_many(thing: str, quick: bool, folder: str) -> list[dict[str, Any]]:
    """Measure a scene with each number of things, each in a process of its own."""
    rows = []
    for number in THINGS[thing].quick if quick else THINGS[thing].sizes:
        say(f"{thing}, {number:,}")
        case = {"thing": thing, "number": number, "folder": folder}
        rows.append({"thing": thing, "size": number} | ask_child(__file__, case))
    return rows


def main() -> None:
    own = parser("scaling", "Time and memory against samples, pixels, lenslets, triangles, threads and many things.")
    own.add_argument(
        "--series", choices=(*SERIES, THREADS, *THINGS), action="append", help="only this one; may be given again"
    )
    own.add_argument("--engine", choices=ENGINES, action="append", help="only this one; may be given again")
    own.add_argument("--side", type=whole, help="pixels a side, where they are not what grows; default 160")
    own.add_argument("--rounds", type=whole, help=f"each size once a round; default {ROUNDS}")
    given = own.parse_args()
    if given.case:
        if "thing" in given.case:
            print(json.dumps(measure_things(**given.case)))
        elif "series" in given.case:
            print(json.dumps(measure_memory(**given.case)))
        else:
            render_when_told(**given.case)
        return
    side = given.side or (40 if given.quick else 160)
    rounds = given.rounds or (QUICK_ROUNDS if given.quick else ROUNDS)
    wanted = given.series or (*SERIES, THREADS, *THINGS)
    engines = given.engine or ENGINES
    rows: list[ScalingRow] = []
    exponents = []
    report = Report("scaling", {"side": side, "rounds": rounds, "samples": SAMPLES})
    with tempfile.TemporaryDirectory() as folder:
        for series in (name for name in SERIES if name in wanted):
            for engine in engines:
                say(f"{series}, {engine}")
                found = measure(series, engine, side, rounds, given.quick, Path(folder))
                rows += found
                exponents.append(exponent(found))
        things = {name: measure_many(name, given.quick, folder) for name in THINGS if name in wanted}
    if rows:
        report.tables["scaling"] = Table("Time and memory", COLUMNS, [asdict(row) for row in rows])
        report.tables["exponents"] = Table("Fitted over each series", EXPONENT_COLUMNS, exponents)
    if things:
        report.tables["things"] = Table(
            "Many things", THING_COLUMNS, [row for found in things.values() for row in found]
        )
        growth = [exponent_of(name, found) for name, found in things.items()]
        report.tables["growth"] = Table("Fitted over the largest numbers", THING_EXPONENT_COLUMNS, growth)
        goals = [goal for name, found in things.items() for goal in goals_of(name, found)]
        report.tables["goals"] = Table("Goals", GOAL_COLUMNS, goals)
    ways: list[dict[str, Any]] = []
    if THREADS in wanted:
        for engine in engines:
            say(f"{THREADS}, {engine}")
            found_ways, ratios = measure_threads(engine, side if given.quick else THREADS_SIDE * side, rounds)
            ways += found_ways
            report.ratios += ratios
        report.tables[THREADS] = Table("Threads, and processes of one thread at the same time", THREAD_COLUMNS, ways)
    deliver(report, given, partial(draw, rows, ways))


if __name__ == "__main__":
    sys.exit(guarded(main))
