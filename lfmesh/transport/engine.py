"""The loop of both engines: a chunk of packets is traced wave by wave.

A wave is a batch of packets at the same station. At a station that queries Embree, the packets are admitted (moved into
its frame, their rays written in float32), and Embree finds a facet for each. The station's kernel decides in float64
and queues the children at their next stations. The station with the most packets comes next, from the top of its stack,
so a chunk's memory stays bounded however often packets split.

Exact surfaces of lens and array are found by their order and their roots; Embree is asked only if these do not decide.
The sequential engine takes the waves of lens and array through both at once (`image_path`).
"""

import time
from collections.abc import Callable
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.geometry import frame as frame_moves
from lfmesh.geometry.meshes.levels import EXACT
from lfmesh.transport.events.object_space import ObjectSpace
from lfmesh.transport.lights.combine import ask_lights
from lfmesh.transport.lights.many_lamps import ASKED, MOST_NODES
from lfmesh.transport.packets.packet import (
    BACK_CELLS,
    BACK_CELLS_MESH,
    BENT,
    BY_MESH,
    BY_ORDER,
    CELLS,
    CELLS_MESH,
    COUNTERS,
    DEPOSIT,
    DEPOSITS,
    E_START,
    END,
    ENDED,
    LENS,
    LENS_MESH,
    LIGHTS,
    MOVING_FRAME,
    NO_SURFACE,
    NODE,
    NODES,
    OBJECT_FRAME,
    OBJECTS,
    PACKET,
    PLATE,
    POLARISED,
    POLARISED_END,
    SENSOR,
    STATIONS,
    STUCK,
    TOPS,
    WORLD_FRAME,
    Flow,
    Options,
)
from lfmesh.transport.packets.stacks import CHILDREN, Stacks
from lfmesh.transport.paths.automaton import GHOSTS
from lfmesh.transport.regions.cover import through_cover
from lfmesh.transport.regions.lens import admit_to_lens, shade_lens
from lfmesh.transport.regions.lens_block import empty_block
from lfmesh.transport.regions.mla import admit_to_cells, shade_cells
from lfmesh.transport.regions.mla_plate import through_plate
from lfmesh.transport.regions.objects import admit_to_objects, shade_objects
from lfmesh.transport.regions.sensor import onto_reflecting_sensor, onto_sensor
from lfmesh.transport.regions.stuck import lose_stuck
from lfmesh.transport.sequences.bundle import BLOCK, empty_bundle
from lfmesh.transport.sequences.follower import image_route_of
from lfmesh.transport.sequences.ghosts import GhostRoom, follow_ghosts, ghost_room
from lfmesh.transport.sequences.image_path import follow_image_path
from lfmesh.transport.tables.lamp_tree import MOST_ASKED
from lfmesh.transport.tables.media import clear
from lfmesh.transport.tables.motions import STILL, forget_moment, moving
from lfmesh.transport.tables.phase_faces import carrying, most_orders
from lfmesh.transport.tables.tables import Tables
from lfmesh.transport.threads import stop_if_unwanted
from lfmesh.transport.world import World

CHUNK = 16_384
"""Packets that start a chunk, and largest wave: few enough for the cache, enough to outweigh the calls."""

MOST_VERTICES = 2_000_000
"""Largest number of recorded vertices. They take 150 MB, and a few times that as paths. Without roulette, the children
of a single ray can exceed it."""

MOST_ENDS = 4_000_000
"""Largest number of ends of a chunk's rays. Without roulette each ray may have one per sequence of reflections, far
more than can be traced."""

MOST_EVENTS_EACH = 20_000
"""Events allowed per packet of a render with all its children, averaged over a chunk. Reflections followed down to 1e-4
of the light need a few thousand; without roulette they double with every other surface."""

T = TypeVar("T")


class FilmRows(Protocol):
    """Film of the adjoint method, with one row per pixel.

    Attributes
    ----------
    power : (pixels, wavelengths) float64, W
    hits : (pixels, wavelengths) uint32
        Number of samples that brought light.
    origin : int
        Number of the pixel in the first row.
    """

    power: NDArray[np.float64]
    hits: NDArray[np.uint32]
    origin: int


class Workspace:
    """Stacks and tables of one thread, kept from chunk to chunk."""

    def __init__(self, world: World, options: Options, chunk: int = CHUNK, tables: Tables | None = None) -> None:
        self.world = world
        self.tables = carrying(tables or world.tables, importance=options.importance)
        self.options = options
        self.chunk = chunk
        polarised = self.tables.polarised is not None
        packet, ended = (POLARISED, POLARISED_END) if polarised else (PACKET, END)
        if self.tables.objects.fields is not None:
            packet = BENT
        self.tops = np.zeros(TOPS, np.int64)
        self.stacks = Stacks(packet, self.tops, max(CHILDREN, most_orders(self.tables)))
        self.asked = np.zeros(MOST_NODES, ASKED)
        from_sensor = options.adjoint and not (options.tracing or options.record or polarised)
        self.moving = moving(self.tables.motions, chunk, all_frames=not from_sensor)
        self.origins = np.zeros((chunk, 3), np.float32)
        self.directions = np.zeros((chunk, 3), np.float32)
        self.deposits = np.zeros(0, DEPOSIT)
        self.ended = np.zeros(0, ended)
        self.nodes = np.zeros(0, NODE)
        # Vertices recorded in earlier chunks, set by the caller that collects them.
        self.recorded = 0
        self._kept: dict[type, Any] = {}
        self.template = np.zeros(1, packet)
        self.book = np.zeros(len(world.slots))
        self.counts = np.zeros(COUNTERS, np.int64)
        self.film = np.zeros((0, 1))
        self.hits = np.zeros((0, 1), np.uint32)
        self.counted = np.zeros(0, np.uint8)
        self.bundle = empty_bundle()
        # One per region, as a block's unused places hold numbers of its region's interfaces.
        self.block, self.mla_block = empty_block(), empty_block()
        self.numbers = np.zeros(BLOCK, np.int64)
        self.unasked = np.zeros(0, np.int32)
        self.embree_seconds = 0.0
        self.queries = 0
        # If a list, it collects copies of the packets that the order of the surfaces processes.
        self.sampled: list[NDArray[np.void]] | None = None

    def kept(self, kind: type[T], make: Callable[[], T]) -> T:
        """Return the working memory of a type; the first call makes it."""
        if kind not in self._kept:
            self._kept[kind] = make()
        memory: T = self._kept[kind]
        return memory

    def begin(self, film: FilmRows | None = None, packets: int = 0, samples: int = 0) -> None:
        """Clear the book and make room for the next chunk.

        Parameters
        ----------
        film : FilmRows, optional
            Adjoint: film that receives the light.
        packets : int
            Number of packets to start at once.
        samples : int
            Number of samples of the film's pixels, if more.
        """
        self.tops[:] = 0
        forget_moment(self.moving)
        pixels = self.options.pixels._replace(each=0)
        self.book[:] = 0.0
        self.counts[:] = 0
        if film is not None:
            self.film, self.hits = film.power, film.hits
            pixels = pixels._replace(first_source=film.origin)
            samples = max(samples, packets)
            if samples > len(self.counted):
                self.counted = np.zeros(samples, np.uint8)
            self.counted[:samples] = 0
        self.embree_seconds = 0.0
        self.queries = 0
        self.options = self.options._replace(pixels=pixels)
        self.stacks.make_room(max(self.chunk, packets))
        self._reserve(max(self.chunk, packets))

    def flow(self) -> Flow:
        """Return the tables that kernels write to."""
        return Flow(
            stacks=self.stacks.memory,
            begins=self.stacks.begins,
            tops=self.tops,
            book=self.book,
            counts=self.counts,
            film=self.film,
            hits=self.hits,
            counted=self.counted,
            deposits=self.deposits,
            ended=self.ended,
            nodes=self.nodes,
            polarised=self.tables.polarised,
            asked=self.asked,
            bending=self.tables.objects.fields,
            moving=self.moving,
        )

    @property
    def frames_of_objects(self) -> NDArray[np.float64]:
        """Table of frames for kernels of object space, (6, 6, 3, 4)."""
        return self.tables.frames if self.moving is None else self.moving.frames

    def ends(self) -> NDArray[np.void]:
        """Return the ends of the chunk's packets, (n,) END."""
        return self.ended[: self.tops[ENDED]].copy()

    def vertices(self) -> NDArray[np.void]:
        """Return the vertices that the chunk recorded, (n,) NODE."""
        return self.nodes[: self.tops[NODES]].copy()

    def record_starts(self) -> None:
        """Record a vertex at the start of every waiting packet that has none yet."""
        for station in range(STATIONS):
            packets = self.stacks.waiting(station)
            for frame in np.unique(packets["frame"]):
                fresh = np.flatnonzero((packets["frame"] == frame) & (packets["node"] == NO_SURFACE))
                top = int(self.tops[NODES])
                number = np.arange(top, top + len(fresh))
                p = np.stack([packets[axis][fresh] for axis in "xyz"], axis=-1)
                nodes = self.nodes
                move = self.tables.frames[OBJECT_FRAME if frame > MOVING_FRAME else frame, WORLD_FRAME]
                nodes["position"][number] = frame_moves.points(move, p)
                nodes["weight"][number] = packets["weight"][fresh]
                for name in ("parent", "surface", "part"):
                    nodes[name][number] = NO_SURFACE
                nodes["event"][number] = E_START
                nodes["beyond"][number] = packets["medium"][fresh]
                packets["node"][fresh] = number
                self.tops[NODES] = top + len(fresh)

    def run(self) -> None:
        """Trace until every stack is empty.

        Raises
        ------
        LfmeshError
            The packets have too many children.
        """
        handled, most = 0, MOST_EVENTS_EACH * max(1, int(self.tops[:STATIONS].sum()))
        while self.tops[:STATIONS].any():
            station = int(np.argmax(self.tops[:STATIONS]))
            handled += self.advance(station)
            if handled > most:
                raise LfmeshError(
                    f"packets have more than {MOST_EVENTS_EACH:,} events each, children included: raise weight_cutoff "
                    f"above {self.options.thinning.cutoff:g}, or lower max_events below {self.options.max_events}"
                )

    def advance(self, station: int) -> int:
        """Process a station's next wave (the top of its stack, at most a chunk); return its number of packets.

        Raises
        ------
        TracingStopped
            The main thread no longer waits for the packets.
        """
        stop_if_unwanted()
        tables, options = self.tables, self.options
        frames, lens, mla = tables.frames, tables.lens, tables.mla
        lens_surfaces = len(lens.surfaces)
        origins, directions = self.origins, self.directions
        taken = count = self.stacks.fitted(min(int(self.tops[station]), self.chunk), self._children)
        self._reserve(count)
        flow = self.flow()
        wave = self.stacks.take(station, count)
        if options.paths == GHOSTS and station in (LENS, PLATE, SENSOR):
            room = self.kept(GhostRoom, lambda: ghost_room(self.chunk, len(tables.ghosts.lengths)))
            for some in self._by_colour(wave):
                follow_ghosts(some, tables.camera, tables.ghosts, options, flow, room)
        elif options.faces == BY_ORDER and station in (LENS, PLATE):
            for some in self._by_colour(wave):
                camera, route = tables.camera_of_packets, image_route_of(tables)
                follow_image_path(some, station, camera, route, self.bundle, self.numbers, options, flow)
        elif station == LENS and options.faces != BY_MESH:
            count = admit_to_lens(wave, origins, directions, lens, frames, options, flow, False)
            wave = wave[:count]
            self._sample(wave)
            shade_lens(wave, self.unasked, self.block, self.numbers, lens, mla.present, frames, options, flow, True)
        elif station in (LENS, LENS_MESH):
            count = admit_to_lens(wave, origins, directions, lens, frames, options, flow, True)
            found = self._find(LENS, count)
            wave = wave[:count]
            shade_lens(wave, found, self.block, self.numbers, lens, mla.present, frames, options, flow, False)
        elif station in (CELLS, CELLS_MESH, BACK_CELLS, BACK_CELLS_MESH):
            face = mla if station in (CELLS, CELLS_MESH) else mla.back
            in_order = station == face.cells and options.faces != BY_MESH and options.surface == EXACT
            if in_order:
                self._sample(wave)
                found = self.unasked
            else:
                admit_to_cells(wave, origins, directions, face)
                found = self._find(face.cells, count)
            shade_cells(wave, found, self.mla_block, self.numbers, face, frames, lens_surfaces, options, flow, in_order)
        elif station == OBJECTS:
            admit_to_objects(wave, origins, directions, frames, tables.objects.fields, options, self.moving)
            found = self._find(OBJECTS, count)
            self._find_moved(found)
            # Only the box of the lens is used there: one compiled kernel for all lenses.
            shade_objects(wave, found, clear(lens), self._object_space(flow))
        elif station == LIGHTS:
            ask_lights(wave, self._object_space(flow))
        elif station == PLATE:
            through_plate(wave, self.mla_block, self.numbers, mla, frames, lens_surfaces, options, flow)
        elif station == STUCK:
            lose_stuck(wave, lens.lost_slot, self.frames_of_objects, options, flow)
        elif tables.cover is not None:
            through_cover(wave, tables.sensor, tables.cover, mla.present, lens_surfaces, frames, options, flow)
        elif tables.sensor.reflectance > 0.0:
            onto_reflecting_sensor(wave, tables.sensor, mla.present, lens_surfaces, frames, options, flow)
        else:
            onto_sensor(wave, tables.sensor, frames, options, flow)
        return taken

    def _object_space(self, flow: Flow) -> ObjectSpace:
        tables = self.tables
        return ObjectSpace(self.options, flow, self.frames_of_objects, tables.objects, tables.aim.entrance)

    def _by_colour(self, wave: NDArray[np.void]) -> list[NDArray[np.void]]:
        """Return the packets of a wave grouped by wavelength: a block of rays has one."""
        colours = wave["colour"]
        if not self.world.lines.in_bands or not (colours != colours[:1]).any():
            return [wave]
        if (colours[1:] < colours[:-1]).any():
            wave = wave[np.argsort(colours, kind="stable")]
        return np.split(wave, np.flatnonzero(np.diff(wave["colour"])) + 1)

    def _sample(self, wave: NDArray[np.void]) -> None:
        if self.sampled is not None:
            self.sampled.append(wave.copy())

    def _find(self, station: int, count: int) -> NDArray[np.int32]:
        began = time.perf_counter()
        moves = station == OBJECTS and self.moving is not None
        finder = self.world.moving_finders[STILL] if moves else self.world.finders[station]
        found = finder.find(self.origins[:count], self.directions[:count])
        self.embree_seconds += time.perf_counter() - began
        self.queries += count
        return found

    def _find_moved(self, found: NDArray[np.int32]) -> None:
        """Find the facets of movers that move, for the queries of admission; `found` holds those of the others."""
        if self.moving is None:
            return
        memory, began = self.moving, time.perf_counter()
        memory.found[STILL, : len(found)] = found
        for mover, finder in enumerate(self.world.moving_finders):
            count = int(memory.queried[mover]) if mover != STILL else 0
            if count:
                facets = finder.find(memory.origins[mover, :count], memory.directions[mover, :count])
                memory.found[mover, memory.packet[mover, :count]] = facets
                self.queries += count
        self.embree_seconds += time.perf_counter() - began

    @property
    def _children(self) -> int:
        """Most packets that one packet adds to the stack of object space."""
        # At an interface there are two; at a target one for each lamp that it asks, an aimed and a scattered one.
        asked = min(len(self.tables.objects.lamps.rows), MOST_ASKED)
        if self.tables.objects.volumes is None:
            return asked + self.stacks.children
        # A medium on its way may also scatter it, and ask lamps from two points.
        return 3 * asked + 2 * self.stacks.children

    def _reserve(self, packets: int) -> None:
        """Make room for the deposits, ends and vertices of a wave of packets."""
        if not self.options.adjoint and not self.options.tracing:
            self.deposits = _grown(self.deposits, int(self.tops[DEPOSITS]) + packets)
        if self.options.tracing or self.options.record:
            ends = int(self.tops[ENDED]) + self.stacks.children * packets
            if ends > MOST_ENDS:
                raise LfmeshError(
                    f"{self.chunk:,} rays or fewer end in more than {MOST_ENDS:,} packets: raise weight_cutoff above "
                    f"{self.options.thinning.cutoff:g}, or lower max_events below {self.options.max_events}"
                )
            self.ended = _grown(self.ended, ends)
        if self.options.record:
            need = int(self.tops[NODES]) + 2 * self.stacks.children * packets
            if self.recorded + need > MOST_VERTICES:
                raise LfmeshError(
                    f"the paths have more than {MOST_VERTICES:,} vertices: launch fewer rays, or raise weight_cutoff "
                    f"above {self.options.thinning.cutoff:g}"
                )
            self.nodes = _grown(self.nodes, need)


def _grown(table: NDArray[np.void], need: int) -> NDArray[np.void]:
    """Return the table, or a larger copy if it is too short."""
    if need <= len(table):
        return table
    larger = np.zeros(max(need, 2 * len(table)), table.dtype)
    larger[: len(table)] = table
    return larger
