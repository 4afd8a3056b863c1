"""Measure the mesh engine: rates, the share of the time inside Embree, and memory that does not grow with samples.

    tools/bench render                                  the demo's scene, small numbers of samples
    tools/bench render scene.toml --surface flat --json figures.json

Every case renders in a process of its own, whose peak memory is its own too, after a warm-up that compiles the kernels.
"The lens alone" sends rays that fill the pupil through the main lens of conventional.toml, refracted children only, on
one thread, and compares with asking Embree the very same questions and doing nothing with the answers.
"""

import argparse
import json
import os
import platform
import resource
import statistics
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.geometry.levels import SURFACE_LEVEL

FACTORS = (1, 4, 16)
RAYS = 16_384
"""Of one pass through the lens: what a chunk holds."""
KIB_PER_MIB = 1024


@dataclass(frozen=True)
class RenderFigures:
    """What one render took."""

    samples: int
    threads: int
    seconds: float
    packets_per_s: float
    events_per_s: float
    embree_share: float
    peak_mib: float


@dataclass(frozen=True)
class LensFigures:
    """What tracing through the lens alone took, medians over the repeats; one thread."""

    rays: int
    waves: int
    events_per_s: float
    queries_per_s: float
    raw_queries_per_s: float
    embree_share: float


def measure_render(scene_file: str, samples: int, threads: int, surface: str | None) -> RenderFigures:
    """Render a scene in this process, after a warm-up."""
    changes: dict[str, Any] = {"transport.samples": samples, "transport.replicates": 2, "transport.threads": threads}
    if surface is not None:
        changes["transport.surface"] = surface
    scene = lf.load(scene_file).changed(changes)
    lf.render(scene.changed({"camera.sensor.pixels": (16, 16)}))
    image = lf.render(scene)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / KIB_PER_MIB
    return RenderFigures(
        samples,
        threads,
        image.seconds,
        image.ledger.packets / image.seconds,
        image.ledger.events / image.seconds,
        image.timings["embree_seconds"] / image.timings["thread_seconds"],
        peak,
    )


def in_own_process(scene_file: str, samples: int, threads: int, surface: str | None) -> RenderFigures:
    """Run `measure_render` in a child."""
    case = json.dumps({"scene_file": scene_file, "samples": samples, "threads": threads, "surface": surface})
    child = subprocess.run([sys.executable, __file__, "--case", case], stdout=subprocess.PIPE, text=True)
    if child.returncode != 0:
        sys.exit(child.returncode)
    return RenderFigures(**json.loads(child.stdout.splitlines()[-1]))


def pupil_rays(world: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return rays (camera frame) from points all over the field of view that fill the entrance pupil."""
    report = world.first_order
    rng = np.random.default_rng(7)
    field = np.column_stack(
        [(rng.random((RAYS, 2)) - 0.5) * report.field_of_view_mm, np.full(RAYS, -report.object_distance_mm)]
    )
    radius, azimuth = np.sqrt(rng.random(RAYS)), 2 * np.pi * rng.random(RAYS)
    radius *= 0.5 * report.entrance_pupil_diameter_mm
    pupil = np.column_stack(
        [radius * np.cos(azimuth), radius * np.sin(azimuth), np.full(RAYS, report.entrance_pupil_z_mm)]
    )
    directions = pupil - field
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    # Start just before the lens: object space is no part of what is measured here.
    start = world.tables.lens.box_low[2] - 1.0
    return field + directions * ((start - field[:, 2:]) / directions[:, 2:]), directions


def measure_lens(surface: str | None, repeats: int) -> LensFigures:
    """Trace through the main lens on one thread, and ask Embree the same without tracing, in turns."""
    from lfmesh.transport.engine import Workspace
    from lfmesh.transport.packet import EVENTS, LENS, TRANSMIT
    from lfmesh.transport.settings import options_of
    from lfmesh.transport.trace import _launch_rays

    scene = lf.load(asset_path("scenes/conventional.toml"))
    scene = scene.changed({"transport.surface": surface}) if surface else scene
    world = lf.build(scene)
    origins, directions = pupil_rays(world)
    stations, spaces = np.full(RAYS, LENS), np.zeros(RAYS, np.int64)
    work = Workspace(world, options_of(world, tracing=True, split=TRANSMIT))
    finder = world.finders[LENS]

    def trace() -> float:
        work.begin(np.zeros((0, 1)))
        _launch_rays(
            0,
            origins,
            directions,
            stations,
            spaces,
            np.uint64(1),
            work.tables.frames,
            False,
            work.flow(),
            work.template,
        )
        began = time.perf_counter()
        work.run()
        return time.perf_counter() - began

    questions: list[tuple[np.ndarray, np.ndarray]] = []
    ask = work._find

    def remember(station: int, count: int) -> Any:
        if station == LENS:
            questions.append((work.origins[:count].copy(), work.directions[:count].copy()))
        return ask(station, count)

    trace()
    work._find = remember  # type: ignore[method-assign]
    trace()
    work._find = ask  # type: ignore[method-assign]

    def raw() -> float:
        began = time.perf_counter()
        for question in questions:
            finder.find(*question)
        return time.perf_counter() - began

    raw()
    traced, shares, asked = [], [], []
    for _ in range(repeats):
        traced.append(trace())
        shares.append(work.embree_seconds / traced[-1])
        asked.append(raw())
    queries = sum(len(question[0]) for question in questions)
    seconds = statistics.median(traced)
    return LensFigures(
        RAYS,
        len(questions),
        int(work.counts[EVENTS]) / seconds,
        queries / seconds,
        queries / statistics.median(asked),
        statistics.median(shares),
    )


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="tools/bench render", description="Measure the mesh engine.")
    parser.add_argument("scene", nargs="?", default=str(asset_path("scenes/first_light.toml")), help="scene file")
    parser.add_argument("--surface", choices=tuple(SURFACE_LEVEL), help="in place of the scene's")
    parser.add_argument("--samples", type=whole, default=2, help="a pixel, in the smallest case (even); default 2")
    parser.add_argument("--repeats", type=whole, default=30, help="passes through the lens alone; default 30")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there too")
    parser.add_argument("--case", help=argparse.SUPPRESS)
    return parser.parse_args()


def whole(text: str) -> int:
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{number} is not positive")
    return number


def machine() -> dict[str, Any]:
    """Say what the figures were measured on."""
    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.is_file():
        cpu = next((s.split(":")[1].strip() for s in info.read_text().splitlines() if s.startswith("model name")), cpu)
    return {"cpu": cpu, "cores": os.cpu_count(), "python": platform.python_version(), "lfmesh": lf.__version__}


def show_render(cases: list[RenderFigures]) -> None:
    print(
        f"{'samples':>8} {'threads':>8} {'seconds':>8} {'packets/s':>10} {'events/s':>10} {'Embree':>7} {'peak MiB':>9}"
    )
    for c in cases:
        print(
            f"{c.samples:>8} {c.threads:>8} {c.seconds:>8.1f} {c.packets_per_s:>10,.0f} {c.events_per_s:>10.3g}"
            f" {c.embree_share:>7.1%} {c.peak_mib:>9.0f}"
        )


def show_lens(lens: LensFigures) -> None:
    print(
        f"The lens alone, one thread, {lens.rays:,} rays, refracted children only:\n"
        f"  {lens.events_per_s:.3g} ray-surface events a second, {lens.embree_share:.1%} of the time inside Embree;\n"
        f"  {lens.queries_per_s:.3g} queries a second against {lens.raw_queries_per_s:.3g} of Embree alone"
        f" ({lens.queries_per_s / lens.raw_queries_per_s:.1%})"
    )


def main() -> int:
    given = arguments()
    try:
        if given.case:
            print(json.dumps(asdict(measure_render(**json.loads(given.case)))))
            return 0
        lf.load(given.scene)
        host = machine()
        print(f"{host['cpu']}, {host['cores']} cores; {given.scene}\n", flush=True)
        cores = host["cores"] or 1
        cases = [in_own_process(given.scene, f * given.samples, cores, given.surface) for f in FACTORS]
        if cores > 1:
            cases += [in_own_process(given.scene, FACTORS[1] * given.samples, 1, given.surface)]
        show_render(cases)
        growth = cases[len(FACTORS) - 1].peak_mib - cases[0].peak_mib
        print(f"Peak memory, {FACTORS[-1]} times the samples: {growth:+.0f} MiB\n", flush=True)
        lens = measure_lens(given.surface, given.repeats)
        show_lens(lens)
        if given.json:
            figures = {"machine": host, "scene": given.scene, "render": cases, "lens_alone": lens}
            given.json.write_text(json.dumps(figures, indent=2, default=asdict) + "\n")
    except lf.LfmeshError as error:
        print(f"tools/bench: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
