"""Rays through the main lens: how many a second, and how far from where they should land.

    tools/bench lens                                  the double Gauss, with spheres and with aspheres
    tools/bench lens --quick --json figures.json

Measured in turns on the same rays, all of which pass the lens:
    Embree alone         the very questions that the mesh engine asks, with nothing done about the answers
    mesh, sequential     the engines' work on packets, refracted children with Fresnel's weights, apertures tested
    sequential, blocks   what of that is the lens: blocks of rays through its surfaces, in place
    lf.trace             the whole call with a user's arrays, for each engine
    batoid, optiland, mitsuba   where they are installed; rays in place, without weights or apertures
with one thread, compared by processor time, and with all, compared by the wall clock. A rate is rays times refracting
surfaces a second; the landing error beside it is against the analytic trace of lfmesh.accuracy.analytic, on the plane
of the sensor.
"""

import json
import os
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np
from bench_peers import PEERS, Peer, fault_of, image_plane_mm
from bench_report import (
    COLOURS,
    Clock,
    Contender,
    Ratio,
    Report,
    Table,
    ask_child,
    deliver,
    guarded,
    in_turns,
    parser,
    say,
    whole,
)
from numpy.typing import NDArray

import lfmesh as lf
from lfmesh.accuracy import analytic
from lfmesh.accuracy.lens_accuracy import Bundle, bare, bundle, lens_alone
from lfmesh.assets import asset_path
from lfmesh.geometry.frame import points
from lfmesh.geometry.meshes.levels import SURFACE_LEVEL
from lfmesh.kernels.decorators import kernel
from lfmesh.scene import Scene
from lfmesh.transport.engine import Workspace
from lfmesh.transport.packets.packet import BY_MESH, BY_ORDER, LENS, SENSOR_FRAME, TRANSMIT, WORLD_FRAME
from lfmesh.transport.sequences.bundle import BLOCK, DX, DZ, ROWS, WEIGHT, X, Z
from lfmesh.transport.sequences.follower import ARRAY_AGAIN, IN_LENS, Route, follow_legs, image_route_of
from lfmesh.transport.settings import options_of
from lfmesh.transport.sources.rays import RaySource
from lfmesh.transport.sources.source import Launcher
from lfmesh.transport.tables.tables import Camera

Array = NDArray[np.float64]

LENSES = ("spheres", "aspheres")
CONIC, TERMS_MM = -0.3, (1e-7, 1e-10)
"""Terms that make an asphere of every second surface, and of the others with the opposite sign: some µm of sag."""

RAYS, QUICK_RAYS = 1 << 17, 1 << 12
ROUNDS, QUICK_ROUNDS = 11, 2
QUICK_RINGS = 12
KEY = np.uint64(1)

ENDINGS = ("source", "position", "weight", "status")

Question = tuple[NDArray[np.float32], NDArray[np.float32]]
"""Origins and directions of a wave, as Embree takes them."""

PAIRS = (
    ("mesh, exact", "Embree alone, exact's mesh"),
    ("mesh, exact", "mitsuba"),
    ("sequential", "mesh, exact"),
    ("sequential", "batoid"),
    ("sequential", "optiland"),
    ("sequential", "mitsuba"),
    ("sequential, blocks", "batoid"),
    ("sequential, blocks", "optiland"),
    ("lf.trace, sequential", "batoid"),
    ("lf.trace, sequential", "optiland"),
)
"""Who is compared with whom."""


@dataclass(frozen=True)
class LensRow:
    """One contender on one lens with so many threads.

    Attributes
    ----------
    surface_rays_per_s : float
        Rays times refracting surfaces a second, from the median of the rounds.
    cores : float
        Processor time over wall-clock time.
    per_core : float
        Rays times refracting surfaces a second of processor time.
    triangles : int or None
        A surface; None for exact surfaces.
    of_embree : float or None
        Rate over that of Embree alone on the same questions, median of the rounds' ratios.
    astray : float or None
        Share of the rays that end elsewhere, on an aperture's edge or nowhere, though they should arrive.
    rms_mm, max_mm, max_weight : float or None
        Errors where the others land, and of their weights, relative. None for Embree alone, whose rays do not bend, and
        for the weights of those who carry none.
    """

    lens: str
    threads: int
    contender: str
    triangles: int | None
    rays_per_s: float
    surface_rays_per_s: float
    cores: float
    per_core: float
    of_embree: float | None
    astray: float | None
    rms_mm: float | None
    max_mm: float | None
    max_weight: float | None


COLUMNS = {
    "lens": ("lens", ""),
    "threads": ("threads", "d"),
    "contender": ("", ""),
    "triangles": ("triangles", ",d"),
    "surface_rays_per_s": ("ray-surfaces/s", ".3g"),
    "cores": ("cores", ".2f"),
    "per_core": ("per core", ".3g"),
    "of_embree": ("of Embree", ".2f"),
    "astray": ("astray", ".0e"),
    "rms_mm": ("rms mm", ".1e"),
    "max_mm": ("max mm", ".1e"),
    "max_weight": ("weight", ".1e"),
}


def lens_of(kind: str) -> Scene:
    """Return conventional.toml's camera, with nothing before it, with its spheres or with aspheres for them."""
    scene = lens_alone(bare(lf.load(asset_path("scenes/conventional.toml"))))
    if kind == "spheres":
        return scene
    surfaces = []
    for number, surface in enumerate(scene.camera.lens.surfaces):
        sign = 1.0 if number % 2 else -1.0
        aspheric = {} if surface.stop else {"conic": sign * CONIC, "asphere_mm": [sign * a for a in TERMS_MM]}
        surfaces.append(surface.model_dump() | aspheric)
    return scene.changed({"camera.lens.surfaces": surfaces})


def rays_through(scene: Scene, count: int) -> tuple[Bundle, analytic.Landing]:
    """Return rays from all over the field that fill the pupil and pass the lens, and where they land."""
    wavelength = scene.primary_nm
    # Of the rays sent, the corners of the field lose a third.
    sent = bundle(scene, 3 * count)
    truth = analytic.Camera.of(scene, wavelength).land(*sent)
    through = np.flatnonzero(truth.arrives)[:count]
    landing = analytic.Landing(truth.position[through], truth.weight[through], truth.arrives[through])
    return Bundle(sent.origins[through], sent.directions[through]), landing


class EngineRun:
    """An engine's work on given rays, chunk by chunk in a pool: packets launched, traced and ended; nothing sorted."""

    def __init__(self, world: Any, sent: Bundle, surface: str, sequential: bool, pool: ThreadPoolExecutor) -> None:
        self.world, self.sent, self.pool = world, sent, pool
        self.options = options_of(
            world,
            tracing=True,
            split=TRANSMIT,
            surface=SURFACE_LEVEL[surface],
            faces=BY_ORDER if sequential else BY_MESH,
        )
        rays = len(sent.origins)
        start = np.full(rays, LENS), np.zeros(rays, np.int64)
        self.source = RaySource(sent.origins, sent.directions, *start, np.ones(rays), KEY)
        self.chunks = list(self.source.parts())
        self._launcher = Launcher(lambda: Workspace(world, self.options))

    def trace(self, chunk: range) -> Workspace:
        """Trace one chunk in the workspace of the calling thread, and return that."""
        return self._launcher.trace(self.source, chunk)

    def launched(self, chunk: range) -> Workspace:
        """Start the packets of one chunk in the workspace of the calling thread, and return that."""
        return next(self._launcher.launches(self.source, chunk))

    def run(self, _: Any) -> None:
        """Trace all chunks."""
        list(self.pool.map(self.trace, self.chunks))

    def landing(self) -> tuple[Array, Array]:
        """Return where the rays land, see `landed`."""
        ended = np.concatenate([self.trace(chunk).ends() for chunk in self.chunks])
        body = np.array(self.world.slots)[ended["body"]]
        return landed(
            self.world,
            len(self.sent.origins),
            ended["source"],
            ended["position"],
            ended["weight"],
            ended["status"],
            body,
        )

    def questions(self) -> list[list[Question]]:
        """Return what the mesh engine asks Embree about the lens, chunk by chunk."""
        asked: list[list[Question]] = []
        work = self.trace(self.chunks[0])
        ask = work._find

        def remember(station: int, count: int) -> NDArray[np.int32]:
            if station == LENS:
                asked[-1].append((work.origins[:count].copy(), work.directions[:count].copy()))
            return ask(station, count)

        work._find = remember  # type: ignore[method-assign]
        for chunk in self.chunks:
            asked.append([])
            self.trace(chunk)
        work._find = ask  # type: ignore[method-assign]
        return asked


class EmbreeAlone:
    """The same questions, asked again; nothing is done about the answers."""

    def __init__(self, engine: EngineRun) -> None:
        self.finder, self.pool = engine.world.finders[LENS], engine.pool
        self.questions = engine.questions()

    def ask(self, chunk: list[Question]) -> None:
        """Ask what one chunk did."""
        for origins, directions in chunk:
            self.finder.find(origins, directions)

    def run(self, _: Any) -> None:
        """Ask what all chunks did."""
        list(self.pool.map(self.ask, self.questions))


class Field:
    """All contenders on one lens, with how to see where their rays land."""

    def __init__(self, scene: Scene, threads: int, rays: int, rings: int | None, known: list[str]) -> None:
        self.sent, self.truth = rays_through(scene, rays)
        self.contenders: list[Contender] = []
        self.triangles: dict[str, int | None] = {}
        self.landings: dict[str, Callable[[], tuple[Array, Array]]] = {}
        self.unweighted = {"batoid", "optiland"}
        self._pool = ThreadPoolExecutor(threads)
        wavelength = scene.primary_nm
        for level in SURFACE_LEVEL:
            world = lf.build(scene.changed({"transport.surface": level}), rings=rings)
            triangles = max(len(cap.faces) for cap in world.lens_shape.caps)
            engine = EngineRun(world, self.sent, level, False, self._pool)
            self._enter(f"mesh, {level}", engine.run, triangles, engine.landing)
            self._enter(alone(level), EmbreeAlone(engine).run, triangles)
            if level == "exact":
                sequential = EngineRun(world, self.sent, level, True, self._pool)
                self._enter("sequential", sequential.run, None, sequential.landing)
                blocks = Blocks(world, self.sent, threads, self._pool)
                self._enter("sequential, blocks", blocks.run, None, blocks.landing, blocks.prepare)
                for name, mesh in (("mesh", triangles), ("sequential", None)):
                    call = partial(traced, world, self.sent, wavelength, name, threads)
                    self._enter(f"lf.trace, {name}", call, mesh, partial(landed_paths, world, call))
        self.surfaces = len(world.lens_shape.caps)
        for name in known:
            peer = PEERS[name](scene, self.sent, threads)
            self._enter(name, peer.run, peer.triangles, partial(landed_peer, peer), peer.prepare)

    def _enter(
        self, name: str, run: Callable[[Any], Any], triangles: int | None,
        landing: Callable[[], tuple[Array, Array]] | None = None, prepare: Callable[[], Any] = lambda: None,
    ) -> None:  # fmt: skip
        self.contenders.append(Contender(name, run, prepare))
        self.triangles[name] = triangles
        if landing is not None:
            self.landings[name] = landing

    def errors(self, name: str) -> dict[str, float | None]:
        """Return the errors of a contender, by the names of `LensRow`."""
        if name not in self.landings:
            return dict.fromkeys(("astray", "rms_mm", "max_mm", "max_weight"))
        place, weight = self.landings[name]()
        off = np.linalg.norm(place - self.truth.position, axis=1)
        wrong = np.abs(weight / self.truth.weight - 1.0)
        there = np.isfinite(off)
        return {
            "astray": float(1.0 - there.mean()),
            "rms_mm": float(np.sqrt(np.mean(off[there] ** 2))),
            "max_mm": float(off[there].max()),
            "max_weight": None if name in self.unweighted else float(wrong[there].max()),
        }


class Blocks:
    """Rays in the sequential engine's blocks, taken through the lens in place, as batoid and optiland take theirs."""

    def __init__(self, world: Any, sent: Bundle, threads: int, pool: ThreadPoolExecutor) -> None:
        self.world, self.sent, self.pool, self.threads = world, sent, pool, threads
        rays = len(sent.origins)
        count = -(-rays // BLOCK)
        room = np.zeros(count * ROWS * BLOCK + 8)
        start = (-room.ctypes.data // 8) % 8
        self.blocks = room[start : start + count * ROWS * BLOCK].reshape(count, ROWS * BLOCK)
        self.rows = self.blocks.reshape(count, ROWS, BLOCK)
        # What fills the last block are copies of the last ray.
        ray = np.minimum(np.arange(count * BLOCK), rays - 1).reshape(count, BLOCK)
        self.start = np.zeros((count, ROWS, BLOCK))
        self.start[:, X // BLOCK : Z // BLOCK + 1] = sent.origins[ray].transpose(0, 2, 1)
        self.start[:, DX // BLOCK : DZ // BLOCK + 1] = sent.directions[ray].transpose(0, 2, 1)
        self.start[:, WEIGHT // BLOCK] = 1.0

    def prepare(self) -> None:
        """Put the rays back to their start."""
        self.rows[:] = self.start

    def run(self, _: Any) -> None:
        """Take all blocks through the lens."""
        camera, route = self.world.tables.camera, image_route_of(self.world.tables)
        book, parts = np.zeros(len(self.world.slots)), np.array_split(self.blocks, self.threads)
        list(self.pool.map(lambda part: through_blocks(part, camera, route, book), parts))

    def landing(self) -> tuple[Array, Array]:
        """Return where the rays meet the sensor's plane, and their weights."""
        self.prepare()
        self.run(None)
        x, y, z, dx, dy, dz, weight = (self.rows[:, row].ravel()[: len(self.sent.origins)] for row in range(7))
        along = (image_plane_mm(self.world.scene) - z) / dz
        return np.column_stack([x + along * dx, y + along * dy]), weight


@kernel
def through_blocks(blocks: Array, camera: Camera, route: Route, book: Array) -> None:
    # To numba a block by its number is contiguous, one that it iterates over is not, and its loops are no vectors.
    for i in range(len(blocks)):
        follow_legs(blocks[i], camera, route, IN_LENS, ARRAY_AGAIN, 0, book)


def alone(level: str) -> str:
    return f"Embree alone, {level}'s mesh"


def compared(name: str, faster: Clock, slower: Clock, threads: int) -> Ratio:
    """Compare processor time with one thread, where others on the machine do no harm; with more the wall clock."""
    if threads == 1:
        return Ratio.of(name, faster.processor, slower.processor)
    return Ratio.of(name, faster.wall, slower.wall)


def measure(
    kind: str, threads: int, rays: int, rounds: int, rings: int | None, known: list[str]
) -> dict[str, list[dict[str, Any]]]:
    """Measure every contender on a lens, in this process; return rows and ratios."""
    field = Field(lens_of(kind), threads, rays, rings, known)
    clocks = in_turns(field.contenders, rounds)
    rows = []
    for name, clock in clocks.items():
        level = name.removeprefix("mesh, ")
        share = compared("", clock, clocks[alone(level)], threads).value if level in SURFACE_LEVEL else None
        rows.append(
            LensRow(
                kind,
                threads,
                name,
                field.triangles[name],
                rays / clock.seconds,
                rays * field.surfaces / clock.seconds,
                clock.cores,
                rays * field.surfaces / clock.seconds_of_processor,
                share,
                **field.errors(name),
            )
        )
    threads_used = f"{threads} thread" + ("s" if threads > 1 else "")
    ratios = [
        compared(f"{kind}, {threads_used}: {a} / {b}", clocks[a], clocks[b], threads)
        for a, b in PAIRS
        if a in clocks and b in clocks
    ]
    return {"rows": [asdict(row) for row in rows], "ratios": [asdict(ratio) for ratio in ratios]}


def traced(world: Any, sent: Bundle, wavelength: float, engine: str, threads: int, _: Any = None) -> lf.Paths:
    """Trace with the public call."""
    # The camera has no pose here: its frame is the world's.
    return lf.trace(world, sent.origins, sent.directions, wavelength, "transmit", engine=engine, threads=threads)


def landed_paths(world: Any, call: Callable[[], lf.Paths]) -> tuple[Array, Array]:
    paths = call()
    body = np.array(paths.body)
    return landed(world, paths.ledger.packets, paths.source, paths.position, paths.weight, paths.status, body)


def landed(
    world: Any, rays: int, source: NDArray[np.int64], position: Array, weight: Array, status: NDArray[np.int64],
    body: NDArray[np.str_],
) -> tuple[Array, Array]:  # fmt: skip
    """Return (n, 2) mm on the sensor's plane and (n,) weights by ray; NaN for a ray that does not get there."""
    there = (status == lf.Status.SENSOR) | (body == "beside the sensor")
    place, weights = np.full((rays, 2), np.nan), np.full(rays, np.nan)
    place[source[there]] = points(world.tables.frames[WORLD_FRAME, SENSOR_FRAME], position[there])[:, :2]
    weights[source[there]] = weight[there]
    return place, weights


def landed_peer(peer: Peer) -> tuple[Array, Array]:
    return peer.landing(peer.run(peer.prepare()))


def draw(rows: list[dict[str, Any]], figure: Any) -> None:
    """Draw rate against landing error, one panel a lens, single thread."""
    fewest = min(row["threads"] for row in rows)
    for place, kind in enumerate(LENSES):
        axes = figure.add_subplot(1, len(LENSES), place + 1)
        shown = [r for r in rows if r["lens"] == kind and r["threads"] == fewest and r["rms_mm"] is not None]
        for number, row in enumerate(shown):
            colour = COLOURS[number % len(COLOURS)]
            axes.plot(max(row["rms_mm"], 1e-16), row["surface_rays_per_s"], "o", color=colour)
            axes.annotate(
                row["contender"], (max(row["rms_mm"], 1e-16), row["surface_rays_per_s"]), xytext=(6, 3),
                textcoords="offset points", color=colour, fontsize=8,
            )  # fmt: skip
        axes.set(
            xscale="log", yscale="log", title=f"double Gauss, {kind}, {fewest} thread",
            xlabel="rms landing error / mm", ylabel="ray-surfaces a second",
        )  # fmt: skip
        axes.margins(x=0.25)


def main() -> None:
    own = parser("lens", "Rays through the main lens: rate and landing error of everything a user could pick.")
    own.add_argument("--rays", type=whole, help=f"default {RAYS:,}")
    own.add_argument("--rounds", type=whole, help=f"each contender once a round; default {ROUNDS}")
    given = own.parse_args()
    if given.case:
        print(json.dumps(measure(**given.case)))
        return
    rays = given.rays or (QUICK_RAYS if given.quick else RAYS)
    rounds = given.rounds or (QUICK_ROUNDS if given.quick else ROUNDS)
    faults = {name: fault_of(name) for name in PEERS}
    report = Report("lens", {"rays": rays, "rounds": rounds, "conic": CONIC, "asphere_mm": TERMS_MM})
    report.missing = {name: fault for name, fault in faults.items() if fault is not None}
    common = {
        "rays": rays,
        "rounds": rounds,
        "rings": QUICK_RINGS if given.quick else None,
        "known": [name for name, fault in faults.items() if fault is None],
    }
    rows: list[dict[str, Any]] = []
    for kind in LENSES:
        for threads in sorted({1, 1 if given.quick else os.cpu_count() or 1}):
            say(f"{kind}, threads: {threads}")
            found = ask_child(__file__, {"kind": kind, "threads": threads, **common}, threads)
            rows += found["rows"]
            report.ratios += [Ratio(**ratio) for ratio in found["ratios"]]
    report.tables["lens"] = Table("Rays through the double Gauss; landing errors on the sensor's plane", COLUMNS, rows)
    deliver(report, given, partial(draw, rows))


if __name__ == "__main__":
    sys.exit(guarded(main))
