"""Starting numbers of pixel samples, drawn in blocks, and working memory of launches."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.by_address import by_address
from lfmesh.kernels.decorators import kernel
from lfmesh.transport.aims.kick_aim import most_listed_after_kick
from lfmesh.transport.aims.lenslet_aim import DISCRETE, LISTED, most_listed
from lfmesh.transport.events.kick import KICK_V
from lfmesh.transport.packets.packet import CAMERA, NO_SURFACE, PACKET
from lfmesh.transport.packets.random import derived, start
from lfmesh.transport.packets.sobol import scramble, scramble_seed, sobol, step
from lfmesh.transport.sequences.bundle import BLOCK
from lfmesh.transport.sources.wavelengths import Entries
from lfmesh.transport.tables.tables import LensletAim

Array = NDArray[np.float64]

STARTS = BLOCK
"""Number of samples drawn together: the capacity of a bundle of the sequential engine."""


@by_address
class StartRoom(NamedTuple):
    """Working memory of a launch, which draws the numbers of `STARTS` samples at a time."""

    point: NDArray[np.uint32]  # (6,) Sobol' point of the last sample, not yet scrambled; (8,) with diffraction
    seeds: NDArray[np.uint32]  # (6,) seeds of the scrambling for its pixel
    points: NDArray[np.uint32]  # (6, STARTS)
    scrambling: NDArray[np.uint32]  # (6, STARTS)
    numbers: Array  # (6, STARTS) starting numbers of each sample
    keys: NDArray[np.uint64]  # (STARTS,)
    near: Array  # (most + 1, LISTED) lenslets that points of a pixel may see, followed by those of a sample
    cells: NDArray[np.int64]  # (most + 1,) lenslets that may show the opening to one point, see `cells_that_show`
    packets: NDArray[np.void]  # (STARTS,) PACKET


def start_room(aim: LensletAim, record: np.dtype[np.void] = PACKET, *, diffracts: bool = False) -> StartRoom:
    """Return working memory for a launch.

    Parameters
    ----------
    aim : LensletAim
    record : dtype
        Packet record.
    diffracts : bool
        Lenslets diffract.
    """
    table = (KICK_V + 1 if diffracts else DISCRETE + 1, STARTS)
    most = most_listed_after_kick(aim) if diffracts else most_listed(aim, aim.search)
    return StartRoom(
        np.zeros(table[0], np.uint32),
        np.zeros(table[0], np.uint32),
        np.zeros(table, np.uint32),
        np.zeros(table, np.uint32),
        np.zeros(table),
        np.zeros(STARTS, np.uint64),
        np.zeros((most + 1, LISTED)),
        np.zeros(most + 1, np.int64),
        np.zeros(STARTS, record),
    )


@kernel
def draw_numbers(
    room: StartRoom, stratified: bool, replicate_key: np.uint64, entries: Entries, which: int, place: int, count: int,
) -> None:  # fmt: skip
    """Draw the starting numbers of `count` samples, from each pixel's Sobol' set or at random.

    Parameters
    ----------
    stratified : bool
        Use Sobol' sets.
    entries : Entries
    which, place : int
        Number of the entry that holds the first sample, and the sample's place in it.
    """
    pixel_key = derived(replicate_key, entries.pixel[which])
    for i in range(count):
        sample = entries.turn.first + (entries.begin[which] + place) * entries.turn.step
        room.keys[i] = derived(pixel_key, sample)
        if stratified:
            if place == 0 or entries.turn.step > 1:
                for dimension in range(len(room.seeds)):
                    # Points come in Gray-code order, see `sobol.step`.
                    room.point[dimension] = sobol(sample ^ (sample >> 1), dimension)
                    room.seeds[dimension] = scramble_seed(pixel_key, dimension)
            else:
                step(room.point, sample)
            for dimension in range(len(room.seeds)):
                room.points[dimension, i], room.scrambling[dimension, i] = room.point[dimension], room.seeds[dimension]
        else:
            for dimension in range(len(room.seeds)):
                room.numbers[dimension, i] = start(room.keys[i], dimension)
        place += 1
        if place == entries.taken[which]:
            which, place = which + 1, 0
            # After the last entry this key is not used; the modulus keeps the index valid.
            pixel_key = derived(replicate_key, entries.pixel[which % len(entries.pixel)])
    if stratified:
        for dimension in range(len(room.seeds)):
            scramble(room.points[dimension], room.scrambling[dimension], room.numbers[dimension])


@kernel
def begin_launch(room: StartRoom, colour: int, lens_surfaces: int) -> None:
    """Set the fields common to all packets of a launch.

    Parameters
    ----------
    room : StartRoom
    colour : int
        Wavelength number.
    lens_surfaces : int
        Number of refracting surfaces of the lens.
    """
    for i in range(STARTS):
        packet = room.packets[i]
        packet.colour = colour
        packet.last = NO_SURFACE
        packet.column = NO_SURFACE
        packet.facet = NO_SURFACE
        packet.node = NO_SURFACE
        packet.kind = CAMERA
        packet.space = lens_surfaces
