"""True if renders of particles and of a flame are as exact, as quick and as small as they are said to be.

    tools/bench media                                 a million particles on the Lytro class's sensor, and the flame
    tools/bench media --of particles --packets 32 64 128 --split both

The error of a particle is that of its light in the whole image, in one render: for particles drawn from all of them,
the packets that a render starts are traced anew with other seeds, and held against rays that start at random points of
the whole front of the lens and are traced by the meshes, without any aim. The error of the flame is that of its pixels
against a render of many samples with another seed. Every render is in a process of its own, whose time and peak memory
are its own too; processor time over two is what two cores that do nothing else take.
"""

import json
import sys
import time
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from bench_report import COLOURS, Report, Table, ask_child, deliver, guarded, parser, peak_mib, say, whole
from numpy.typing import NDArray
from scipy.stats import qmc

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.transport.packets.packet import DEPOSITS
from lfmesh.transport.packets.random import descendant, run_key
from lfmesh.transport.render.tracer import Tracer
from lfmesh.transport.sources.particles import ParticleSource
from lfmesh.transport.tables.lines import FIRST

Array = NDArray[np.float64]

NUMBER, QUICK_NUMBER = 1_000_000, 1_000
CHOSEN, QUICK_CHOSEN = 200, 4
SEEDS, QUICK_SEEDS = 16, 2
RAYS, QUICK_RAYS = 1 << 14, 1 << 10
"""Of each particle's true light, twice, so that their difference tells its error."""
PACKETS = (32, 64, 128)
SAMPLES = (4, 8, 16, 32)
REFERENCE, QUICK_REFERENCE = 1024, 32
QUICK_PIXELS = 32
FRONT_MM = 13.0
"""Radius of the disk in the plane of the first vertex that holds all of the double Gauss's opening."""
DIM_SHARE = 0.02
"""Of the brightest pixels' light: what is darker is not counted as lit by the flame."""

RENDER_COLUMNS = {
    "packets": ("packets each", "d"),
    "processor": ("processor s", ".1f"),
    "seconds": ("wall s", ".1f"),
    "peak_mib": ("peak MiB", ".0f"),
}
PARTICLE_COLUMNS = {
    "packets": ("packets each", "d"),
    "chosen": ("particles", "d"),
    "median": ("median error", ".2%"),
    "most": ("95 % below", ".2%"),
    "worst": ("worst", ".2%"),
    "bias": ("mean deviation", ".3%"),
    "bias_error": ("±", ".3%"),
    "truth_error": ("error of truth", ".3%"),
}
FLAME_COLUMNS = {
    "samples": ("samples", "d"),
    "processor": ("processor s", ".1f"),
    "seconds": ("wall s", ".1f"),
    "peak_mib": ("peak MiB", ".0f"),
    "lit": ("lit pixels", ",d"),
    "median": ("median error", ".2%"),
}


def particle_scene(number: int, packets: int, split: str, pixels: int | None) -> lf.Scene:
    """Return particles of one intensity in the Lytro class's field of view, before the plane in focus and behind it."""
    box = {"kind": "box", "size_mm": (64.0, 44.0, 40.0)}
    group = {"count": number, "seed": 1, "intensity_w_sr": 1.0, "samples": packets, "bounds": box,
             "position_mm": (0.0, 0.0, -500.0)}  # fmt: skip
    changes: dict[str, Any] = {"targets": (), "lights": (), "particles": (group,), "transport.split": split}
    if pixels is not None:
        changes["camera.sensor.pixels"] = [pixels, pixels]
    return lf.load(asset_path("scenes/lytro_class.toml")).changed(changes)


def flame_scene(samples: int, pixels: int | None, seed: int) -> lf.Scene:
    changes: dict[str, Any] = {"transport.samples": samples, "transport.seed": seed}
    if pixels is not None:
        changes["camera.sensor.pixels"] = [pixels, pixels]
    return lf.load(asset_path("scenes/flame.toml")).changed(changes)


def timed(scene: lf.Scene, small: lf.Scene) -> tuple[lf.Image, dict[str, float]]:
    """Render a scene after a small one that compiles its kernels; return the image, and what it took."""
    lf.render(small)
    wall, processor = time.perf_counter(), time.process_time()
    image = lf.render(scene)
    took = {"processor": time.process_time() - processor, "seconds": time.perf_counter() - wall}
    return image, took | {"peak_mib": peak_mib()}


def measure_render(number: int, packets: int, split: str, pixels: int | None) -> dict[str, Any]:
    """Render the particles in this process."""
    small = particle_scene(10, packets, split, 16)
    return {"packets": packets, **timed(particle_scene(number, packets, split, pixels), small)[1]}


def measure_particles(
    number: int, packets: Sequence[int], split: str, chosen: int, seeds: int, rays: int
) -> list[dict[str, Any]]:
    """Return the errors of some particles' light, a row for each number of packets."""
    scene = particle_scene(number, packets[0], split, None)
    tracer = Tracer(lf.build(scene), check=False)
    points = tracer.parts[0].particles.points
    some = np.random.default_rng(7).choice(number, chosen, replace=False)
    twice = np.array([[true_light(scene, points[i], split, rays, seed) for seed in (1, 2)] for i in some])
    lit = (twice > 0.0).all(axis=1)
    some, truth = some[lit], twice[lit].mean(axis=1)
    rows = []
    for each in packets:
        found = np.array([[light(tracer, i, each, seed) for seed in range(seeds)] for i in some])
        off = found / truth[:, None] - 1.0
        error = np.sqrt((off**2).mean(axis=1))
        # What one particle deviates by on the average does not depend on what the next one does.
        bias = off.mean(axis=1)
        rows.append(
            {
                "packets": each,
                "chosen": int(lit.sum()),
                "median": float(np.median(error)),
                "most": float(np.percentile(error, 95.0)),
                "worst": float(error.max()),
                "bias": float(bias.mean()),
                "bias_error": float(bias.std(ddof=1) / np.sqrt(len(bias))),
                "truth_error": float(np.sqrt(((np.diff(twice[lit])[:, 0] / truth) ** 2).mean() / 4.0)),
            }
        )
    return rows


def light(tracer: Tracer, number: int, packets: int, seed: int) -> float:
    """Return the light, W, that one render of some packets finds of a particle, in replicates as it divides them."""
    part = tracer.parts[0]
    table = part.particles
    assert table is not None
    rows = slice(number, number + 1)
    one = table._replace(points=table.points[rows], strength=table.strength[rows], inside=table.inside[rows])
    replicates = tracer.world.scene.transport.replicates
    each = max(1, packets // replicates)
    found = []
    for replicate in range(replicates):
        key = descendant(descendant(run_key(seed), replicate), number)
        work = tracer._launcher(part).trace(ParticleSource(one, 0, each, each, key, FIRST))
        found.append(work.deposits["weight"][: work.tops[DEPOSITS]].sum())
    return float(np.mean(found))


def true_light(scene: lf.Scene, point: Array, split: str, rays: int, seed: int) -> float:
    """Return the light of a particle of 1 W/sr on the sensor, W, by rays to all of the lens's front, without aim."""
    world = _without_aim(scene)
    u, v = qmc.Sobol(2, seed=seed).random(rays).T
    r, phi = FRONT_MM * np.sqrt(u), 2.0 * np.pi * v
    way = np.stack([r * np.cos(phi), r * np.sin(phi), 0.0 * r], axis=1) - point
    length = np.linalg.norm(way, axis=1)
    paths = lf.trace(world, np.tile(point, (rays, 1)), way / length[:, None], split=split)
    fell = paths.status == lf.Status.SENSOR
    # dω = cos dA / distance²
    watts = np.pi * FRONT_MM**2 / rays * -point[2] / length**3
    return float((paths.weight * watts[paths.source])[fell].sum())


_WORLDS: dict[int, Any] = {}


def _without_aim(scene: lf.Scene) -> Any:
    """Return the camera alone, built once."""
    if id(scene) not in _WORLDS:
        _WORLDS[id(scene)] = lf.build(scene.changed({"particles": (), "transport.engine": "mesh"}))
    return _WORLDS[id(scene)]


def measure_flame(samples: int, reference: int, pixels: int | None) -> dict[str, Any]:
    """Render the flame in this process, and hold it against one of many samples."""
    image, took = timed(flame_scene(samples, pixels, 1), flame_scene(8, 16, 1))
    truth = lf.render(flame_scene(reference, pixels, 1001)).mean
    lit = truth > DIM_SHARE * np.percentile(truth, 99.0)
    # A standard error is 1.4826 times the median of the deviations that it makes.
    median = 1.4826 * np.median(np.abs(image.mean - truth)[lit] / truth[lit])
    return {"samples": samples, **took, "lit": int(lit.sum()), "median": float(median)}


CASES = {"render": measure_render, "particles": measure_particles, "flame": measure_flame}


def draw(tables: dict[str, Table], figure: Any) -> None:
    """Draw the errors of particles and of the flame."""
    axes = figure.add_subplot()
    for colour, (name, key) in zip(COLOURS, (("particles", "packets"), ("flame", "samples")), strict=False):
        if name in tables:
            rows = tables[name].rows
            axes.plot([row[key] for row in rows], [row["median"] for row in rows], "o-", color=colour, label=name)
    axes.set(xscale="log", yscale="log", xlabel="packets of a particle, samples of a pixel", ylabel="median error")
    axes.legend()


def main() -> None:
    own = parser("media", "Errors, times and memory of renders of particles and of a flame.")
    own.add_argument("--of", choices=("particles", "flame"), help="one of the two; default: both")
    own.add_argument("--packets", type=whole, nargs="+", default=PACKETS, help="of each particle")
    own.add_argument("--samples", type=whole, nargs="+", default=SAMPLES, help="of each pixel that sees the flame")
    own.add_argument("--split", choices=("both", "transmit"), default="transmit", help="of particles' light")
    given = own.parse_args()
    if given.case is not None:
        kind = given.case.pop("kind")
        print(json.dumps(CASES[kind](**given.case)))
        return
    quick = given.quick
    pixels = QUICK_PIXELS if quick else None
    number = QUICK_NUMBER if quick else NUMBER
    report = Report("media", {"particles": number, "split": given.split})

    def ask(kind: str, **case: Any) -> Any:
        say(" ".join([kind, *(f"{key} {value}" for key, value in case.items())]))
        return ask_child(__file__, {"kind": kind, **case})

    if given.of != "flame":
        counts = list(given.packets)[:1] if quick else list(given.packets)
        rows = [ask("render", number=number, packets=each, split=given.split, pixels=pixels) for each in counts]
        title = f"{number:,} particles on the Lytro class's sensor"
        report.tables["render"] = Table(f"Rendering {title}", RENDER_COLUMNS, rows)
        rows = ask(
            "particles", number=number, packets=counts, split=given.split, chosen=QUICK_CHOSEN if quick else CHOSEN,
            seeds=QUICK_SEEDS if quick else SEEDS, rays=QUICK_RAYS if quick else RAYS,
        )  # fmt: skip
        report.tables["particles"] = Table(f"Light of each of {title}", PARTICLE_COLUMNS, rows)
    if given.of != "particles":
        counts = list(given.samples)[:1] if quick else list(given.samples)
        reference = QUICK_REFERENCE if quick else REFERENCE
        rows = [ask("flame", samples=each, reference=reference, pixels=pixels) for each in counts]
        report.tables["flame"] = Table("The flame of assets", FLAME_COLUMNS, rows)
    deliver(report, given, partial(draw, report.tables))


if __name__ == "__main__":
    sys.exit(guarded(main))
