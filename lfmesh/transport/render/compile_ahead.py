"""Compile the kernels of a first render in two processes at once.

A fresh install has no compiled kernels, and numba compiles one function at a time. A second process therefore compiles
the kernels of the regions, which trace packets that wait at a station. Meanwhile this process builds the world and
compiles the kernels that aim packets and follow the image path and ghosts. The render loads all from numba's cache on
disk, and compiles them itself if the second process fails. Progress is reported step by step.
"""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from threading import Thread
from typing import IO, Any

import numpy as np

from lfmesh.geometry.index_media import any_bends
from lfmesh.geometry.objects.targets import is_met_exactly
from lfmesh.kernels.accelerator import private
from lfmesh.kernels.cache import is_cached
from lfmesh.scene import Scene
from lfmesh.transport.build import build
from lfmesh.transport.choice import engine_of
from lfmesh.transport.engine import Workspace
from lfmesh.transport.packets.packet import (
    BY_MESH,
    BY_ORDER,
    BY_ORDER_OR_MESH,
    CELLS,
    LENS,
    LENS_MESH,
    OBJECTS,
    PLATE,
    SENSOR,
)
from lfmesh.transport.paths.automaton import GHOSTS
from lfmesh.transport.regions.lens import shade_lens
from lfmesh.transport.regions.mla import shade_cells
from lfmesh.transport.regions.objects import shade_objects
from lfmesh.transport.render.parts import parts_of
from lfmesh.transport.render.progress import Progress
from lfmesh.transport.render.tally import Film
from lfmesh.transport.settings import options_of
from lfmesh.transport.sources.lights import LightSource
from lfmesh.transport.sources.particles import ParticleSource
from lfmesh.transport.sources.pixels import PixelSource
from lfmesh.transport.tables.gradient_spaces import has_gradients
from lfmesh.transport.tables.lines import FIRST
from lfmesh.transport.tables.phase_faces import has_phases
from lfmesh.transport.world import World

ON_IMAGE_PATH = ((OBJECTS, False), (LENS, True))
EVERYWHERE = tuple((station, False) for station in (OBJECTS, LENS, LENS_MESH, CELLS, PLATE, SENSOR))
"""Stations whose kernels the second process compiles for a render without and with paths off the image path, and
whether they take packets along the image path only."""

_CHILD = """
import gc, os, sys
# It ends before its memory matters: collecting the compiler's cycles would take a tenth of its time.
gc.disable()
sys.path[:] = {path!r}
from {module} import compile_stations
compile_stations({stations!r}, glass={glass!r}, rounds={rounds!r}, done=lambda: os.write(1, b"."))
os._exit(0)
"""

POLL_SECONDS = 0.05
STAGE = "compiling kernels, once for this installation"

Report = Callable[[Progress], None]


@contextmanager
def compiled_ahead(scene: Scene, report: Report | None = None) -> Iterator["Ahead"]:
    """Compile a render's kernels in a second process, unless they are cached.

    The process is stopped if the block raises.

    Parameters
    ----------
    scene : Scene
        Scene to be rendered next.
    report : callable, optional
        Receives the progress.
    """
    ahead = Ahead(scene, report)
    try:
        yield ahead
    except BaseException:
        ahead.stop()
        raise


class Ahead:
    """Second process that compiles the kernels of stations; none if it would not pay.

    Parameters
    ----------
    scene : Scene
        Scene to be rendered next.
    report : callable, optional
        Receives the progress if kernels are not cached.
    """

    def __init__(self, scene: Scene, report: Report | None = None) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._steps = self._own = self._others = 0
        self._said = -1
        self._began = time.perf_counter()
        alone = engine_of(scene)[0] == "sequential"
        kernels = (shade_objects,) if alone else (shade_objects, shade_lens, shade_cells)
        cached = any(map(is_cached, kernels))
        self._report = None if cached else report
        self._say()
        # Polarised and diffracted light, phases, gradients, media that bend light and motion have other kernels, and
        # few scenes have them.
        plain = not scene.transport.polarisation and scene.transport.diffraction == "none"
        usual = (
            plain and not has_phases(scene) and not has_gradients(scene) and not any_bends(scene) and not scene.moves
        )
        if processors() > 1 and usual and not cached:
            stations = ON_IMAGE_PATH if alone else EVERYWHERE
            glass = len(scene.bodies()) > 0
            rounds = any(is_met_exactly(target, scene) for target in scene.targets)
            code = _CHILD.format(path=sys.path, module=__name__, stations=stations, glass=glass, rounds=rounds)
            try:
                self._process = subprocess.Popen(
                    [sys.executable, "-c", code],
                    stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, bufsize=0,
                )  # fmt: skip
                self._steps = len(stations)
            except OSError:
                self._process = None

    def join(self, world: World) -> None:
        """Compile the kernels that launch a world's packets, and wait for the other process."""
        if (process := self._process) is None:
            return
        self._steps += 1 + len(parts_of(world))
        self._step()
        counting = Thread(target=self._count_others, args=(process.stdout,), daemon=True)
        counting.start()
        listening = private("listening")
        with listening.told_of_kernels(self._say) if listening is not None else nullcontext():
            compile_launches(world, self._step)
        while counting.is_alive():
            counting.join(POLL_SECONDS)
            self._say()
        process.wait()

    def _step(self) -> None:
        """Count a step of this process, and report it."""
        self._own += 1
        self._say()

    def _count_others(self, finished: IO[bytes]) -> None:
        """Count the steps of the other process, one byte each, until it ends."""
        with finished:
            while finished.read(1):
                self._others += 1

    def _say(self) -> None:
        """Report the steps of both processes, if there are new ones."""
        done = self._own + self._others
        if self._report is not None and done > self._said:
            self._said = done
            self._report(Progress(done, self._steps, time.perf_counter() - self._began, 0, 0, STAGE))

    def stop(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.terminate()
            self._process.wait()


def processors() -> int:
    """Return the number of processors that this process may use."""
    available = getattr(os, "sched_getaffinity", None)
    return len(available(0)) if available is not None else os.cpu_count() or 1


def compile_launches(world: World, done: Callable[[], object] = object) -> None:
    """Compile a render's launch, image-path and ghost kernels without packets.

    Parameters
    ----------
    world : World
    done : callable
        Called after each part of the image.
    """
    alone = engine_of(world.scene)[0] == "sequential"
    for part in parts_of(world):
        work = Workspace(world, part.options, 1, part.tables)
        work.begin(Film.empty(0, 1), 0)
        if part.options.adjoint:
            PixelSource(np.zeros(0, np.int64), 1, np.uint64(0)).launch(work, range(0))
        elif part.particles is not None:
            ParticleSource(part.particles, 0, 0, 1, np.uint64(0), FIRST).launch(work, range(0))
        else:
            LightSource(0, 0, 1, np.uint64(0), FIRST).launch(work, range(0))
        if part.options.paths == GHOSTS or (part.options.faces == BY_ORDER and not alone):
            work.advance(LENS)
        done()


def compile_stations(
    stations: tuple[tuple[int, bool], ...],
    *,
    glass: bool = False,
    rounds: bool = False,
    done: Callable[[], object] = object,
) -> None:
    """Compile the kernels of stations by an empty wave at each, in a scene without aim.

    Parameters
    ----------
    stations : tuple of (int, bool)
        As `EVERYWHERE`.
    glass : bool
        The scene has bodies of glass.
    rounds : bool
        Rays meet spheres, cylinders or disks of the scene exactly.
    done : callable
        Called after each station.
    """
    targets = [GLASS if glass else WALL, *([BALL] if rounds else [])]
    world = build(Scene.model_validate(BARE | {"targets": targets}), aimed=False)
    options = options_of(world)
    work = Workspace(world, options, 1)
    work.begin(Film.empty(0, 1), 0)
    for station, sequential in stations:
        by_mesh = BY_ORDER_OR_MESH if station == LENS else BY_MESH
        work.options = options._replace(faces=BY_ORDER if sequential else by_mesh)
        work.advance(station)
        done()


BARE = {
    "camera": {
        "focus_mm": 500.0,
        "lens": {
            "surfaces": [
                {"radius_mm": 50.0, "thickness_mm": 5.0, "index": 1.5, "semi_diameter_mm": 10.0},
                {"radius_mm": -50.0, "thickness_mm": 1.0, "semi_diameter_mm": 10.0},
                {"stop": True, "thickness_mm": 0.0, "semi_diameter_mm": 5.0},
            ]
        },
        "sensor": {"pixels": [1, 1], "pixel_mm": 0.1},
    },
    "transport": {"samples": 1, "replicates": 1},
}
"""Camera that compiles nothing when built without aim."""

WALL: dict[str, Any] = {
    "shape": {"kind": "plane", "width_mm": 1.0, "height_mm": 1.0},
    "position_mm": [0.0, 0.0, -500.0],
}
BALL: dict[str, Any] = {"shape": {"kind": "sphere", "radius_mm": 1.0}, "position_mm": [0.0, 0.0, -550.0]}
GLASS: dict[str, Any] = {"refractor": {"box_mm": [1.0, 1.0, 1.0], "index": 1.5}, "position_mm": [0.0, 0.0, -500.0]}
