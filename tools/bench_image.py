"""A light-field image to equal error: efficiency 1 / (MSE · t) of every way to estimate it.

    tools/bench image                                 first_light.toml; then a small camera beside Mitsuba
    tools/bench image scene.toml --quick --json figures.json

Two tables. In the first, on the scene itself: analog forward (one child by chance, nothing aimed), forward with
splitting and aiming, adjoint with all reflections, and adjoint without them by either engine; the error of each is
against a converged reference of the same light, see lfmesh.accuracy.image_efficiency.

In the second: a glowing chart through 16 × 16 lenslets by the adjoint method, with and without reflections, and by
Mitsuba where it is installed. There the error is each one's own variance from runs with independent seeds, and the
image's whole power is compared in standard errors. The adjoint method's efficiency grows with its samples, which are
Sobol' points; Mitsuba's does not.

Time is processor time throughout, of tracing alone.
"""

import math
import os
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from bench_peers import fault_of
from bench_report import COLOURS, Ratio, Report, Table, deliver, guarded, parser, say, whole
from numpy.typing import NDArray

import lfmesh as lf
from lfmesh.accuracy.image_efficiency import (
    AIMING,
    ANALOG,
    IMAGE_PATH,
    PARTS,
    QUICK,
    SEQUENTIAL,
    SOBOL,
    USUAL,
    Effort,
    ImageRow,
    Way,
    study_images,
)
from lfmesh.assets import asset_path
from lfmesh.scene import Scene
from lfmesh.transport.render.render import Renderer
from lfmesh.transport.world import World

WAYS = (ANALOG, AIMING, SOBOL, PARTS, IMAGE_PATH, SEQUENTIAL)
GAINS = ((AIMING, ANALOG), (SOBOL, AIMING), (PARTS, SOBOL), (SEQUENTIAL, SOBOL), (SEQUENTIAL, IMAGE_PATH))
LENSLETS, PIXELS_A_LENSLET = 16, 10
MITSUBA, MITSUBA_REFLECTIONS = "mitsuba, image path", "mitsuba, reflections"
SEED = 7

Picture = Callable[[], NDArray[np.float64]]

COLUMNS = {
    "way": ("", ""),
    "samples": ("samples", "d"),
    "seconds": ("seconds", ".3g"),
    "rms": ("rms error", ".2%"),
    "efficiency": ("1/(MSE t)", ".3g"),
    "efficiency_error": ("±", ".1g"),
    "bias_z": ("bias / σ", ".1f"),
}
PEER_COLUMNS = {
    "way": ("", ""),
    "samples": ("samples", "d"),
    "seconds": ("seconds", ".3g"),
    "rms": ("rms error", ".2%"),
    "efficiency": ("1/(MSE t)", ".3g"),
    "power_w": ("power W", ".4e"),
    "power_error_w": ("±", ".0e"),
}


@dataclass(frozen=True)
class PeerRow:
    """One way on the small camera.

    Attributes
    ----------
    seconds : float
        Of processor time, median of the runs.
    mse : float
        Mean variance of a pixel over the image's mean square, from the spread of the runs.
    rms : float
        Its root.
    efficiency : float
        1 / (mse · seconds), 1/s.
    power_w, power_error_w : float
        On the whole sensor, mean of the runs and its standard error.
    """

    way: str
    samples: int
    seconds: float
    mse: float
    rms: float
    efficiency: float
    power_w: float
    power_error_w: float


def effort_of(quick: bool, pixels: int | None) -> Effort:
    """Return how much is spent on each way: as `lfmesh accuracy` does, and as the adjoint method with each engine."""
    base = QUICK if quick else USUAL
    samples = base.samples | {way.name: base.samples[SOBOL.name] for way in (IMAGE_PATH, SEQUENTIAL)}
    return replace(base, samples=samples, pixels=pixels or base.pixels)


def own_rows(scene: Scene, effort: Effort) -> tuple[list[ImageRow], list[Ratio]]:
    """Measure lfmesh's ways on a scene; return rows, and how many times more efficient one is than another."""
    study = study_images(scene, effort, say, ways=WAYS)
    ratios = []
    for way, over in GAINS:
        value, error = study.gain(way, over)
        ratios.append(Ratio(f"{way.name} / {over.name}", value, value - error, value + error))
    return list(study.rows), ratios


def small_camera(lenslets: int, way: Way) -> Scene:
    """Return emitting_plane.toml with fewer lenslets, as one of the adjoint ways renders it."""
    return lf.solved(
        lf.load(asset_path("scenes/emitting_plane.toml")).changed(
            {
                "camera.mla.count": [lenslets, lenslets],
                "camera.sensor.pixels": [PIXELS_A_LENSLET * lenslets] * 2,
                "transport.replicates": 1,
                "transport.split": way.split,
                "transport.engine": way.engine,
            }
        )
    )


def beside_mitsuba(
    lenslets: int, samples: int, runs: int, with_mitsuba: bool
) -> tuple[list[PeerRow], list[Ratio], list[dict[str, Any]]]:
    """Measure the adjoint method and Mitsuba on the small camera, in turns; return rows, ratios, agreement of power."""
    # From a seed, what renders a picture: what is built for it is not timed.
    pictures: dict[str, Callable[[int], Picture]] = {}
    for way in (SOBOL, PARTS, IMAGE_PATH, SEQUENTIAL):
        world = lf.build(small_camera(lenslets, way).changed({"transport.samples": samples}))
        pictures[way.name] = partial(own_picture, world)
    if with_mitsuba:
        from bench_mitsuba import Camera

        scene = small_camera(lenslets, IMAGE_PATH)
        for name, reflections in ((MITSUBA, False), (MITSUBA_REFLECTIONS, True)):
            camera = Camera(scene, os.cpu_count() or 1, reflections)
            pictures[name] = partial(partial, camera.image, samples)
    images: dict[str, list[NDArray[np.float64]]] = {name: [] for name in pictures}
    seconds: dict[str, list[float]] = {name: [] for name in pictures}
    for name, picture in pictures.items():
        say(f"beside mitsuba: {name}, warming up")
        picture(SEED)()
    for run in range(runs):
        say(f"beside mitsuba: run {run + 1} of {runs}")
        for name, picture in pictures.items():
            render = picture(SEED + 1 + run)
            began = time.process_time()
            images[name].append(render())
            seconds[name].append(time.process_time() - began)
    rows = {name: peer_row(name, samples, seconds[name], np.array(images[name])) for name in pictures}
    pairs = [(SEQUENTIAL.name, MITSUBA), (IMAGE_PATH.name, MITSUBA), (SOBOL.name, MITSUBA_REFLECTIONS),
             (PARTS.name, MITSUBA_REFLECTIONS)]  # fmt: skip
    pairs = [(own, peer) for own, peer in pairs if peer in rows]
    # The variances are of the runs together; what scatters from run to run is the time.
    cost = {name: np.multiply(row.mse, seconds[name]) for name, row in rows.items()}
    ratios = [Ratio.of(f"{own} / {peer}", cost[own].tolist(), cost[peer].tolist()) for own, peer in pairs]
    pairs += [(SEQUENTIAL.name, IMAGE_PATH.name), (PARTS.name, SOBOL.name)]
    agreement = [agree(rows[own], rows[peer]) for own, peer in pairs]
    return list(rows.values()), ratios, agreement


def own_picture(world: World, seed: int) -> Picture:
    """Return what renders with lfmesh; (rows, columns) W."""
    renderer = Renderer(world.reseeded(seed))
    return lambda: renderer.image().mean[:, :, 0]


def peer_row(way: str, samples: int, seconds: list[float], images: NDArray[np.float64]) -> PeerRow:
    """Sum up the runs of one way; `images` is (runs, rows, columns) W."""
    power = float((images.mean(axis=0) ** 2).mean())
    mean_variance = float(images.var(axis=0, ddof=1).mean())
    # The mean's own variance is in its square.
    mse = mean_variance / (power - mean_variance / len(images))
    whole_sensor = images.sum(axis=(1, 2))
    error = float(whole_sensor.std(ddof=1) / math.sqrt(len(images)))
    time_each = float(np.median(seconds))
    return PeerRow(
        way, samples, time_each, mse, math.sqrt(mse), 1.0 / (mse * time_each), float(whole_sensor.mean()), error
    )


def agree(a: PeerRow, b: PeerRow) -> dict[str, Any]:
    """Return how far the powers of two that model the same light differ, relative and in standard errors."""
    difference = a.power_w - b.power_w
    return {
        "pair": f"{a.way} − {b.way}",
        "relative": difference / b.power_w,
        "z": difference / math.hypot(a.power_error_w, b.power_error_w),
    }


def draw(rows: list[dict[str, Any]], figure: Any) -> None:
    """Draw error against processor time, a line a way."""
    axes = figure.add_subplot()
    for way, colour in zip(dict.fromkeys(row["way"] for row in rows), COLOURS, strict=False):
        own = [row for row in rows if row["way"] == way]
        axes.plot([row["seconds"] for row in own], [row["rms"] for row in own], "o-", color=colour, label=way)
    axes.set(xscale="log", yscale="log", xlabel="processor time / s", ylabel="rms error of a pixel / rms of the image")
    axes.legend(frameon=False)


def main() -> None:
    own = parser("image", "A light-field image to equal error: both methods, both engines, Mitsuba.")
    own.add_argument("scene", nargs="?", default=str(asset_path("scenes/first_light.toml")), help="scene file")
    own.add_argument("--pixels", type=whole, help="of the sensor's shorter side; larger sensors are binned to it")
    own.add_argument("--lenslets", type=whole, help=f"a side of the small camera; default {LENSLETS}")
    own.add_argument("--samples", type=whole, help="a pixel of the small camera, a run; default 32")
    own.add_argument("--runs", type=whole, help="of each on the small camera, 2 at least; default 8")
    given = own.parse_args()
    if given.runs == 1:
        own.error("argument --runs: 1 run has no spread; give 2 or more")
    scene = lf.load(given.scene)
    effort = effort_of(given.quick, given.pixels)
    rows, ratios = own_rows(scene, effort)
    shown = [asdict(row) | {"rms": math.sqrt(row.mse) if row.mse > 0.0 else None} for row in rows]
    report = Report("image", {"scene": given.scene, "pixels": effort.pixels, "reference_samples": effort.reference})
    report.tables["image"] = Table(f"Images of {given.scene}", COLUMNS, shown)
    fault = fault_of("mitsuba")
    if fault is not None:
        report.missing["mitsuba"] = fault
    camera = {
        "lenslets": given.lenslets or (4 if given.quick else LENSLETS),
        "samples": given.samples or (8 if given.quick else 32),
        "runs": given.runs or (2 if given.quick else 8),
    }
    report.settings |= camera
    peer_rows, peer_ratios, agreement = beside_mitsuba(**camera, with_mitsuba=fault is None)
    report.tables["small_camera"] = Table(
        f"A glowing chart through {camera['lenslets']} × {camera['lenslets']} lenslets",
        PEER_COLUMNS,
        [asdict(row) for row in peer_rows],
    )
    columns = {"pair": ("the same light?", ""), "relative": ("difference", ".2%"), "z": ("/ σ", ".1f")}
    report.tables["agreement"] = Table("Power on the whole sensor", columns, agreement)
    report.ratios = ratios + peer_ratios
    deliver(report, given, partial(draw, shown))


if __name__ == "__main__":
    sys.exit(guarded(main))
