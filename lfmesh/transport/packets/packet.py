"""Packets, their stacks, and everything that kernels write: the state of one chunk.

A packet is one record of two cache lines.
"""

from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.by_address import by_address
from lfmesh.kernels.decorators import inlined, pasted
from lfmesh.transport.packets.random import derived

# Stations, named for what a packet waits for. Embree is asked at OBJECTS, at stations with MESH in their name and, if a
# run does not use the order of the surfaces, at LENS, CELLS and BACK_CELLS.
LENS = 0  # a surface of the main lens
CELLS = 1  # the curved face of the array, in its cell
OBJECTS = 2  # a target, or the way into the lens
PLATE = 3  # the array from outside its layers of curved faces: entry, or the flat face
SENSOR = 4  # a pixel
LENS_MESH = 5  # a surface of the main lens, by its mesh if the order of the surfaces does not decide
LIGHTS = 6  # a point of a target or a medium from which lights other than lamps are asked
CELLS_MESH = 7  # the curved face in its cell, by its mesh if distances do not decide
BACK_CELLS = 8  # the lenslets of the array's other face, if it has two curved ones, in their cell
BACK_CELLS_MESH = 9  # the same by the mesh
STUCK = 10  # its end, after `MOST_MOVES` moves without an event
STATIONS = 11

MOST_MOVES = 4_096
"""Moves from station to station without an event after which a packet is lost. No straight path takes as many: along
the layer of lenslets a packet crosses one cell per move, elsewhere some ten moves suffice."""

# Frames. A packet says in which frame its ray is given; its station moves it into the station's own.
CAMERA_FRAME, MLA_FRAME, OBJECT_FRAME, SENSOR_FRAME, WORLD_FRAME = 0, 1, 2, 3, 4
BACK_FRAME = 5  # frame of the lenslets on the array's other face
FRAMES = 6
MOVING_FRAME = FRAMES - 1
"""A packet in the frame of mover g has `frame` = MOVING_FRAME + g, g from 1; see `tables.motions`."""

MOST_MOVERS = 120
"""Largest number of movers beside the one at rest relative to the camera, by the size of `frame`."""

# Kinds of packet.
CAMERA = 0  # on the camera's path: leaves the sensor (adjoint), or was aimed at the lens (forward)
LAMP = 1  # straight from a light
SCATTERED = 2  # left a target in a random direction
SPECULAR = 3  # refracted or reflected by glass in object space; may reach the lens without having been aimed
SHADOW = 4  # asks a light from a point; the light that it brings counts, and it has no children

# Lights that shadow packets ask: their `light`.
TO_LAMP = 0  # carries what a lamp adds to the pixel if nothing is in between
TO_FACET = 1  # the same for an emitting facet
TO_MEDIA = 2  # gathers the emission of media along its ray
PAST_LAMP = 3  # gathers a lamp's light that media scatter along its ray

# Counters.
EVENTS, REQUERIES, FALLBACKS = 0, 1, 2
COUNTERS = 3

# Tops: number of entries in use of each growing table; the first are the stations' stacks.
DEPOSITS, ENDED, NODES = STATIONS, STATIONS + 1, STATIONS + 2
TOPS = STATIONS + 3


class Status(IntEnum):
    """End of a packet."""

    SENSOR = 0
    ABSORBED = 1
    ESCAPED = 2
    TARGET = 3
    DEPTH = 4
    LOST = 5
    ROULETTE = 6


class Event(IntEnum):
    """Event at a recorded vertex of a path.

    SENSOR, ABSORBED, ESCAPED and TARGET end a path like the `Status` of the same name, DEPTH after the largest number
    of events allowed, LOST after a numerical failure. BENT is a point of a curve in a medium that bends light, and no
    event of its own.
    """

    START = 0
    TRANSMITTED = 1
    REFLECTED = 2
    SCATTERED = 3
    SENSOR = 4
    ABSORBED = 5
    ESCAPED = 6
    TARGET = 7
    DEPTH = 8
    LOST = 9
    BENT = 10


# Plain integers: numba reads module constants, not the members of an enumeration.
E_START, E_TRANSMITTED, E_REFLECTED, E_SCATTERED, E_BENT = (
    int(event) for event in (Event.START, Event.TRANSMITTED, Event.REFLECTED, Event.SCATTERED, Event.BENT)
)
S_SENSOR, S_ABSORBED, S_ESCAPED, S_TARGET, S_DEPTH, S_LOST = (
    int(s) for s in (Status.SENSOR, Status.ABSORBED, Status.ESCAPED, Status.TARGET, Status.DEPTH, Status.LOST)
)
LAST_EVENT = {
    Status.SENSOR: Event.SENSOR,
    Status.ABSORBED: Event.ABSORBED,
    Status.ESCAPED: Event.ESCAPED,
    Status.TARGET: Event.TARGET,
    Status.DEPTH: Event.DEPTH,
    Status.LOST: Event.LOST,
    Status.ROULETTE: Event.ABSORBED,
}
"""Event recorded at the end of a packet, by its status."""
EVENT_OF_STATUS = np.array([LAST_EVENT[status] for status in Status], dtype=np.int64)

# Numbers in a recorded vertex's `surface`: below FACES_AT a refracting surface of the lens, then one of FACES;
# ENDS_AT + slot: the body that a packet ended on.
FACES_AT, ENDS_AT = 1000, 2000
FACES = (
    "mla curved face", "mla flat face", "target", "glass", "cover front face", "cover rear face", "mla back face",
    "index field",
)  # fmt: skip
CURVED_FACE, FLAT_FACE, ON_TARGET, ON_GLASS, COVER_FRONT, COVER_REAR, BACK_FACE, IN_FIELD = range(
    FACES_AT, FACES_AT + len(FACES)
)

NO_SURFACE = -1
"""Placeholder for the number of a surface, facet, cell or vertex."""

LEFT_LENS, LEFT_FACE = -2, -3
"""`last` of a packet in object space that left the lens, which it cannot meet again on a straight line; and of one that
left a curved face of the array and has not left the layer of faces."""

LEFT_MEDIUM, IN_FOG = -4, -5
"""`facet` of a packet that a medium scattered or emitted: in the forward method, if it has an aimed twin or is one; in
the adjoint method."""

_BASE_RECORD = np.dtype(
    [
        ("x", "f8"), ("y", "f8"), ("z", "f8"),  # mm, in `frame`
        ("dx", "f8"), ("dy", "f8"), ("dz", "f8"),
        ("weight", "f8"),  # W (forward) or m² sr (adjoint)
        ("start", "f8"),  # weight that the weight window is relative to
        ("query_from", "f8"),  # start of Embree's search along the ray
        ("limit", "f8"),  # SHADOW: distance of the light, or inf; else the first query_from, for a query from the start
        ("key", "u8"),
        ("source", "i8"),  # its initial sample (adjoint, see `SAMPLE_SHIFT`), packet (forward) or ray (trace)
        ("node", "i4"),  # its last recorded vertex
        ("column", "i4"), ("row", "i4"),  # cell of the array; elsewhere see SHARED
        ("facet", "i4"),  # target facet it left
        ("last", "i2"),  # lens surface it left
        ("colour", "i2"),  # number of the wavelength
        ("space", "i2"),  # space between two surfaces it travels in; for object space see `events.bodies`
        # Fields that an event writes stand between fields not copied by `put`: the compiler copies neighbours at once,
        # and the processor stalls if a number is read as part of a longer one just after it was written.
        # Queries of this ray whose result was refused; negative: it slipped between facets, and its query's origin is
        # shifted.
        ("tries", "i1"),
        ("frame", "i1"),
        ("medium", "i2"),  # medium at its start and in object space; in lens and array its space gives the medium
        ("kind", "i1"),
        ("path", "i1"),  # its state, see `paths.automaton`
        ("events", "i2"),
        ("moves", "i2"),  # from station to station since its last event
    ],
    align=True,
)  # fmt: skip


SHARED = {
    "density": ("row", "f4"),  # density, 1/sr, of its direction when drawn by the target that it left
    "light": ("path", "i1"),  # SHADOW: the kind of light it asks; the class of its path is decided
    "goal": ("row", "i4"),  # SHADOW: number of the facet or lamp
    "in_medium": ("row", "i4"),  # at LIGHTS, of a point in a medium: the medium
    "bodies": ("column", "i4"),  # in object space: ranks of the bodies round it, see `events.bodies`
}
"""Fields of packets in object space, which are in no cell: the field that shares its memory, and the type."""


def _with_shared(record: np.dtype[np.void], shared: dict[str, tuple[str, str]]) -> np.dtype[np.void]:
    """Return a record type with additional fields that share the memory of existing ones."""
    own = dict(record.fields or {})
    fields = own | {name: (np.dtype(form), own[place][1]) for name, (place, form) in shared.items()}
    return np.dtype(
        {
            "names": list(fields),
            "formats": [field[0] for field in fields.values()],
            "offsets": [field[1] for field in fields.values()],
            "itemsize": record.itemsize,
        }
    )


def _with_vectors(record: np.dtype[np.void], *vectors: tuple[str, tuple[int, ...]]) -> np.dtype[np.void]:
    """Return a record type with float64 vectors, given by names and shapes, before its fields.

    They must come first: otherwise numba would run kernels compiled for the shorter record on the longer one.
    """
    own, size = {}, 0
    for name, shape in vectors:
        own[name] = (np.dtype(("f8", shape)), size)
        size += 8 * shape[0]
    own |= {name: (field[0], field[1] + size) for name, field in (record.fields or {}).items()}
    return np.dtype(
        {
            "names": list(own),
            "formats": [field[0] for field in own.values()],
            "offsets": [field[1] for field in own.values()],
            "itemsize": size + record.itemsize,
        }
    )


PACKET = _with_shared(_BASE_RECORD, SHARED)
"""Record of a packet."""

_STATE = (
    ("stokes", (3,)),  # Q, U and V over I; in the adjoint method, for light in the reverse direction
    ("reference", (3,)),  # unit, perpendicular to the direction, world frame; arbitrary for an unpolarised state
)
"""State of polarisation, see `optics.polarisation` for its conventions."""

_CHILDREN = (
    ("s_axis", (3,)),  # reference direction of both
    ("reflected", (3,)),  # `stokes` of each
    ("refracted", (3,)),
)
"""States of the children at the interface that is dividing a packet."""

POLARISED = _with_vectors(PACKET, *_STATE, *_CHILDREN)
"""Record of a packet in a scene with polarised light."""

CHORD = 11
BENT = _with_vectors(PACKET, ("chord", (CHORD,)))
"""Record of a packet in a scene with media that bend light."""

LENGTH, END_TX, END_TY, END_TZ, END_STATE, EVENT_AT_END, STATE, OPTICAL, PLANE, CHORDS, SHARE = range(CHORD)
"""Elements of `chord`, the straight way to the next node, where a medium changes the direction.

LENGTH, mm, is 0 until the chord is found, and inf if nothing bends the ray ahead. At the end of the chord: the optical
ray vector (END_T...), the state, and an event at a face of a field, or NO_EVENT. STATE at the start is UNKNOWN, OUTSIDE
all fields, k + 1 in field k, or OUTSIDE − (k + 1) just behind field k, which a straight ray does not meet again. In a
field, OPTICAL is the length of the optical ray vector, or 0 for the index of the place; PLANE is the axis plus three
times the slab ahead, or −1; CHORDS counts the chords since the entry. SHARE is above 0 for a packet that a target or a
medium sent into a field in the forward method: the share of a scattered one, beside its aimed twin, in light that
reaches the lens.
"""

UNKNOWN, OUTSIDE = 0.0, -1.0
NO_EVENT, REFRACTED_AT_FACE, REFLECTED_AT_FACE = 0.0, 1.0, 2.0

NO_PLANE = -1.0

SAMPLE_SHIFT = 40
PIXEL_MASK = (1 << SAMPLE_SHIFT) - 1
"""`source` of a packet that began at a pixel: the pixel in the lower bits, above them the number of its sample in the
chunk. The number ensures that a sample that brings light along several paths is counted once."""

DEPOSIT = np.dtype([("pixel", "i8"), ("colour", "i8"), ("weight", "f8")])

END = np.dtype(
    [
        ("position", "f8", (3,)),
        ("direction", "f8", (3,)),
        ("weight", "f8"),
        ("source", "i8"),
        ("status", "i8"),
        ("events", "i8"),
        ("node", "i8"),
        ("body", "i8"),
        ("colour", "i8"),
    ]
)

POLARISED_END = _with_vectors(END, *_STATE)
"""Record of the end of a packet in a scene with polarised light."""

NODE = np.dtype(
    [
        ("parent", "i8"),
        ("position", "f8", (3,)),  # mm, world frame
        ("weight", "f8"),
        ("surface", "i8"),
        ("part", "i8"),  # lenslet (row by row) of the array, or number of the target or medium; −1 elsewhere
        ("event", "i8"),
        ("beyond", "i8"),  # medium on the far side of an interface; at a start, around the packet; −1 elsewhere
    ]
)


@by_address
class Flow(NamedTuple):
    """Tables that the kernels of one chunk write to."""

    stacks: NDArray[np.void]  # (capacity of all,) PACKET
    begins: NDArray[np.int64]  # (stations or more,) start of each station's stack
    tops: NDArray[np.int64]
    book: NDArray[np.float64]
    counts: NDArray[np.int64]
    film: NDArray[np.float64]  # (sources of the chunk, wavelengths): light that adjoint paths gather, W
    hits: NDArray[np.uint32]  # (as `film`): number of samples that gathered light
    counted: NDArray[np.uint8]  # (samples of the chunk,): 1 for samples counted in `hits`
    deposits: NDArray[np.void]  # forward: power deposited on pixels
    ended: NDArray[np.void]  # tracing or recording: the end of every packet
    nodes: NDArray[np.void]  # recording: every vertex
    # PolarisationTables if packets are POLARISED, else None: code for the other case is not even compiled.
    polarised: Any = None
    asked: Any = None  # working memory, see `lights.many_lamps.ASKED`; None if no kernel asks lamps
    bending: Any = None  # BendingFields if packets are BENT, else None, as for `polarised`
    moving: Any = None  # Moving in a scene with motion, else None, as for `polarised`


# Thinning.split
BOTH, ROULETTE, TRANSMIT = 0, 1, 2

# Options.faces: method to find surfaces of lens and array.
BY_MESH = 0  # by their meshes
BY_ORDER_OR_MESH = 1  # by their order if that decides, else by their meshes
BY_ORDER = 2  # by their order, along the image path


@by_address
class Thinning(NamedTuple):
    """Division of packets at interfaces, and the cutoff of weak ones."""

    split: int
    cutoff: float
    unturned_cutoff: float  # replaces `cutoff` at targets, for paths outside the estimated class so far


@by_address
class PixelSamples(NamedTuple):
    """Samples of pixels in a chunk of the adjoint method, and their part of the film."""

    first_source: int = 0  # pixel in row 0 of the film
    channel: int = 0  # column of the film
    samples: int = 0  # number of samples of a pixel, which divides its light
    each: int = 0  # samples of a pixel whose events share Sobol' sets; 0: random numbers
    stream: np.uint64 = np.uint64(0)  # key of the random numbers of the group of replicates at this wavelength
    first: int = 0  # number of the pixel's first sample among those of the group
    step: int = 1  # from one sample of the pixel to the next in the group
    columns: int = 1  # of the sensor


@by_address
class Options(NamedTuple):
    """Transport settings in the form that kernels take."""

    surface: int
    faces: int
    thinning: Thinning
    max_events: int
    adjoint: bool
    tracing: bool  # keep the end of every packet, and end packets at targets
    record: bool  # keep every vertex, and the end of every packet
    bounce: bool  # light may go from target to target
    aimed: bool  # scattered light is aimed at the lens; else it meets the lens by chance
    paths: int  # class of paths that are estimated, see `paths.automaton`
    importance: bool  # weights are importance, which thin lenses change, not power
    pixels: PixelSamples = PixelSamples()
    stream: np.uint64 = np.uint64(0)  # key of a replicate at a wavelength, for the times of its packets
    still: bool = False  # all packets have the time of the scene as given, t = 0


@inlined
def mover_of_frame(frame: int) -> int:
    """Return the mover in whose frame a packet is, from its `frame`; 0 in the object frame and in the camera."""
    return max(frame - MOVING_FRAME, 0)


@inlined
def frame_in_table(frame: int) -> int:
    """Return the place of a packet's frame in the table of frames, where that of its mover is the object frame."""
    return OBJECT_FRAME if frame > MOVING_FRAME else frame


@inlined
def _frame_of_child(moving: Any, parent: Any, frame: int) -> int:
    """Return the frame of a child from that given to `put`: the object frame of an event may be that of a mover."""
    if moving is None:
        return frame
    return parent.frame if frame == OBJECT_FRAME and parent.frame > MOVING_FRAME else frame


@inlined
def sample_of(pixels: PixelSamples, packet: Any) -> tuple[np.uint64, int]:
    """Return the random key of a packet's pixel, and the number of its sample there.

    Parameters
    ----------
    pixels : PixelSamples
        Events share Sobol' sets.
    packet : PACKET
    """
    sample = pixels.first + (packet.source >> SAMPLE_SHIFT) % pixels.each * pixels.step
    return derived(pixels.stream, packet.source & PIXEL_MASK), sample


@inlined
def keep_state(polarised: Any, packet: Any, kept: Any) -> None:
    """Copy a packet's state of polarisation, if any, to another packet or to an end.

    Parameters
    ----------
    polarised : PolarisationTables or None
    packet : POLARISED
    kept : POLARISED or POLARISED_END
    """
    if polarised is None:
        return
    for i in range(3):
        kept.stokes[i], kept.reference[i] = packet.stokes[i], packet.reference[i]


@inlined
def keep_chord(bending: Any, packet: Any, kept: Any) -> None:
    """Copy a packet's chord, if any, to another packet on the same ray.

    Parameters
    ----------
    bending : BendingFields or None
    packet, kept : BENT
    """
    if bending is None:
        return
    for i in range(CHORD):
        kept.chord[i] = packet.chord[i]


@inlined
def _begin_chord(bending: Any, parent: Any, child: Any) -> None:
    """Let a child find its chord in the field, or outside the fields, where its parent is."""
    if bending is None:
        return
    child.chord[LENGTH], child.chord[STATE] = 0.0, max(parent.chord[STATE], OUTSIDE)
    child.chord[OPTICAL], child.chord[PLANE], child.chord[CHORDS], child.chord[SHARE] = 0.0, NO_PLANE, 0.0, 0.0


@inlined
def count_event(packet: Any) -> None:
    """Count an event of a packet, and reset its number of moves.

    Parameters
    ----------
    packet : PACKET
    """
    packet.events += 1
    packet.moves = 0


@pasted
def put(
    flow: Flow, station: int, parent: Any, frame: int,
    x: float, y: float, z: float, dx: float, dy: float, dz: float,
    weight: float, key: np.uint64, query_from: float,
) -> Any:  # fmt: skip
    """Queue a packet at a station and return its record; other fields are inherited from `parent`.

    After `MOST_MOVES` without an event the packet waits at `STUCK` instead.

    Parameters
    ----------
    flow : Flow
    station : int
    parent : PACKET
    frame : int
        Frame of point and direction.
    x, y, z : float, mm
    dx, dy, dz : float
        Unit direction.
    weight : float
        W (forward) or m² sr (adjoint).
    key : uint64
    query_from : float, mm
        Start of Embree's search along the ray.
    """
    moves = parent.moves + 1
    station = station if moves < MOST_MOVES else STUCK
    top = flow.tops[station]
    # Copied field by field, and all read before anything is written: a copy of the whole record, half of which is
    # overwritten, compiles to sixty moves of odd sizes.
    start, source, node, kind = parent.start, parent.source, parent.node, parent.kind
    column, cell_row, facet, last = parent.column, parent.row, parent.facet, parent.last
    colour, space, events, medium, path = parent.colour, parent.space, parent.events, parent.medium, parent.path
    packet = flow.stacks[flow.begins[station] + top]
    packet.x, packet.y, packet.z = x, y, z
    packet.dx, packet.dy, packet.dz = dx, dy, dz
    packet.weight, packet.start = weight, start
    packet.query_from, packet.limit = query_from, query_from
    packet.key, packet.source = key, source
    packet.node = node
    packet.column, packet.row, packet.facet, packet.last = column, cell_row, facet, last
    packet.colour, packet.space, packet.events, packet.medium = colour, space, events, medium
    packet.tries, packet.kind, packet.path, packet.moves = 0, kind, path, moves
    packet.frame = _frame_of_child(flow.moving, parent, frame)
    keep_state(flow.polarised, parent, packet)
    _begin_chord(flow.bending, parent, packet)
    flow.tops[station] = top + 1
    return packet
