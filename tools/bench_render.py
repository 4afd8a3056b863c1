"""Rendering a scene: rates, the share of the time inside Embree, and memory that does not grow with samples.

    tools/bench render                                  first_light.toml, small numbers of samples
    tools/bench render scene.toml --engine sequential --json figures.json

Every case renders in a process of its own, whose peak memory is its own too, after a warm-up that compiles the kernels.
The double Gauss alone is traced by the mesh engine on one thread, refracted rays only, one chunk again and again. The
demo's paths with reflections are traced on one thread, lens surfaces found by meshes and by their order in turn; the
least time of each chunk counts.
"""

import json
import os
import statistics
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np
from bench_lens import EngineRun, lens_of, rays_through
from bench_report import COLOURS, Report, Table, ask_child, deliver, guarded, parser, peak_mib, say, whole

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.geometry.meshes.levels import SURFACE_LEVEL
from lfmesh.transport.engine import CHUNK, Workspace
from lfmesh.transport.packets.packet import EVENTS
from lfmesh.transport.packets.random import descendant
from lfmesh.transport.render.plan import Chunk
from lfmesh.transport.render.tally import Film
from lfmesh.transport.render.tracer import Tracer
from lfmesh.transport.sources.source import Launcher

FACTORS = (1, 4, 16)
QUICK_PIXELS = [40, 40]
LENS_ROUNDS, QUICK_ROUNDS = 60, 3
ORDER_CHUNKS, ORDER_ROUNDS = 14, 8
ORDER_SAMPLES = 8

COLUMNS = {
    "samples": ("samples", "d"),
    "threads": ("threads", "d"),
    "seconds": ("seconds", ".2f"),
    "paths_per_s": ("paths/s", ",.0f"),
    "events_per_s": ("events/s", ".3g"),
    "embree_share": ("Embree", ".1%"),
    "peak_mib": ("peak MiB", ".0f"),
}


LENS_COLUMNS = {
    "surface": ("level", ""),
    "rays": ("rays", ",d"),
    "events_per_s": ("events/s", ".3g"),
    "embree_share": ("Embree", ".1%"),
}


WAY_COLUMNS = {
    "way": ("paths of the picture", ""),
    "paths_per_s": ("paths/s", ",.0f"),
    "embree_share": ("Embree", ".1%"),
    "queries_per_path": ("queries a path", ".2f"),
}


@dataclass(frozen=True)
class RenderFigures:
    """Time and memory of one render."""

    samples: int
    threads: int
    seconds: float
    paths_per_s: float
    events_per_s: float
    embree_share: float
    peak_mib: float


def measure_render(
    scene_file: str, samples: int, threads: int, engine: str | None, surface: str | None, pixels: list[int] | None
) -> RenderFigures:
    """Render a scene in this process, after a warm-up."""
    changes: dict[str, Any] = {"transport.samples": samples, "transport.replicates": 2, "transport.threads": threads}
    if engine is not None:
        changes["transport.engine"] = engine
    if engine == "sequential":
        changes["transport.split"] = "transmit"
    if surface is not None:
        changes["transport.surface"] = surface
    if pixels is not None:
        changes["camera.sensor.pixels"] = pixels
    scene = lf.load(scene_file).changed(changes)
    lf.render(scene.changed({"camera.sensor.pixels": [16, 16]}))
    image = lf.render(scene)
    return RenderFigures(
        samples,
        threads,
        image.seconds,
        image.ledger.packets / image.seconds,
        image.ledger.events / image.seconds,
        image.timings["embree_seconds"] / image.timings["thread_seconds"],
        peak_mib(),
    )


def measure_lens(surface: str, rounds: int) -> dict[str, Any]:
    """Trace through the double Gauss alone; return medians of the rate and of the share of the time inside Embree."""
    scene = lens_of("spheres").changed({"transport.surface": surface})
    sent, _ = rays_through(scene, CHUNK)
    rates, shares = [], []
    with ThreadPoolExecutor(1) as pool:
        run = EngineRun(lf.build(scene), sent, surface, False, pool)
        run.trace(run.chunks[0])
        for _ in range(rounds):
            work = run.launched(run.chunks[0])
            began = time.perf_counter()
            work.run()
            seconds = time.perf_counter() - began
            rates.append(int(work.counts[EVENTS]) / seconds)
            shares.append(work.embree_seconds / seconds)
    return {
        "surface": surface,
        "rays": len(sent.origins),
        "events_per_s": statistics.median(rates),
        "embree_share": statistics.median(shares),
    }


def measure_ways(chunks: int, rounds: int) -> list[dict[str, Any]]:
    """Trace the image path and, both ways, the paths with reflections, in turn; return a row for each."""
    world = lf.build(lf.load(asset_path("scenes/first_light.toml")).changed({"transport.threads": 1}))
    tracer = Tracer(world, check=False)
    image, reflections, *ghosts = tracer.parts
    ways = {
        "image path": image,
        "reflections, by meshes": reflections.by_meshes(),
        "reflections, by order": reflections,
    }
    if ghosts:
        ways["ghosts of the lens"] = ghosts[0]
    launchers = {
        name: Launcher(partial(Workspace, world, part.options, CHUNK, part.tables)) for name, part in ways.items()
    }
    count = CHUNK // ORDER_SAMPLES
    firsts = np.linspace(0, tracer.pixels - count, chunks).astype(np.int64)
    seconds = {name: np.full(chunks, np.inf) for name in ways}
    embree, queries = ({name: np.zeros(chunks) for name in ways} for _ in range(2))
    for _ in range(rounds):
        for number, first in enumerate(firsts):
            for name, part in ways.items():
                chunk = Chunk(0, part, int(first), count, 0, CHUNK, ORDER_SAMPLES)
                source = tracer._source(chunk, descendant(tracer.seed, part.number), 0)
                began = time.perf_counter()
                work = launchers[name].trace(source, film=Film.empty(count, tracer.channels, int(first)))
                took = time.perf_counter() - began
                if took < seconds[name][number]:
                    seconds[name][number], embree[name][number] = took, work.embree_seconds
                queries[name][number] = work.queries
    return [
        {
            "way": name,
            "paths_per_s": chunks * CHUNK / seconds[name].sum(),
            "embree_share": embree[name].sum() / seconds[name].sum(),
            "queries_per_path": queries[name].sum() / (chunks * CHUNK),
        }
        for name in ways
    ]


def draw(rows: list[dict[str, Any]], figure: Any) -> None:
    """Draw seconds and peak memory against samples, all threads."""
    most = max(row["threads"] for row in rows)
    shown = [row for row in rows if row["threads"] == most]
    for place, (key, label) in enumerate((("seconds", "tracing / s"), ("peak_mib", "peak memory / MiB"))):
        axes = figure.add_subplot(1, 2, place + 1)
        axes.plot([row["samples"] for row in shown], [row[key] for row in shown], "o-", color=COLOURS[0])
        axes.set(xlabel="samples a pixel", ylabel=label, ylim=(0, None))


def main() -> None:
    own = parser("render", "Rendering a scene: rates, the share of the time inside Embree, and peak memory.")
    own.add_argument("scene", nargs="?", default=str(asset_path("scenes/first_light.toml")), help="scene file")
    own.add_argument(
        "--engine", choices=("mesh", "sequential"), help="in place of the scene's; sequential: reflections left out"
    )
    own.add_argument("--surface", choices=tuple(SURFACE_LEVEL), help="in place of the scene's")
    own.add_argument("--samples", type=whole, default=2, help="a pixel, in the smallest case; even, default 2")
    given = own.parse_args()
    if given.case:
        print(json.dumps(asdict(measure_render(**given.case))))
        return
    lf.load(given.scene)
    cores = os.cpu_count() or 1
    factors = FACTORS[:1] if given.quick else FACTORS
    cases = [(factor, cores) for factor in factors]
    if cores > 1:
        cases.append((factors[-1] if given.quick else FACTORS[1], 1))
    rows = []
    for factor, threads in cases:
        say(f"{factor * given.samples} samples a pixel, threads: {threads}")
        case = {
            "scene_file": given.scene,
            "samples": factor * given.samples,
            "threads": threads,
            "engine": given.engine,
            "surface": given.surface,
            "pixels": QUICK_PIXELS if given.quick else None,
        }
        rows.append(ask_child(__file__, case))
    report = Report("render", {"scene": given.scene, "engine": given.engine, "surface": given.surface})
    report.tables["render"] = Table(f"Rendering {given.scene}", COLUMNS, rows)
    say("the double Gauss alone")
    lens = measure_lens(given.surface or "exact", QUICK_ROUNDS if given.quick else LENS_ROUNDS)
    report.tables["lens"] = Table("The double Gauss alone, mesh engine, one thread", LENS_COLUMNS, [lens])
    say("paths with reflections, lens surfaces by their order and by meshes")
    ways = measure_ways(2 if given.quick else ORDER_CHUNKS, 2 if given.quick else ORDER_ROUNDS)
    report.tables["ways"] = Table("Paths of the picture of first_light.toml, one thread", WAY_COLUMNS, ways)
    deliver(report, given, partial(draw, rows))


if __name__ == "__main__":
    sys.exit(guarded(main))
