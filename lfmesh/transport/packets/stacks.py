"""Stacks for packets that wait at their stations, in one block of memory of limited size.

A wave takes the top of a stack, after room is made for all its possible children. It is shorter if these would not fit
within the limit. So memory is bounded for any number of children per packet and of lamps per point.
"""

import numpy as np
from numpy.typing import NDArray

from lfmesh.transport.packets.packet import OBJECTS, STATIONS

MOST_BYTES = 256 << 20
"""Largest size of the stacks of one thread, except for packets that are started all at once."""

CHILDREN = 2
"""Most packets that one packet adds to a stack, except the stack of object space, where points ask lamps, and except at
phases with several orders."""

_WAVE, _WAVE_OF_OBJECTS = STATIONS, STATIONS + 1
"""Places of the last waves: of stations other than object space, and of object space, which has a longer stack."""


class Stacks:
    """The stacks of one thread.

    Parameters
    ----------
    record : dtype
        Of the packets.
    tops : (TOPS,) int64
        Number of packets in each stack, updated by kernels.
    children : int
        Most packets that one packet adds to a stack other than that of object space.

    Attributes
    ----------
    memory : (n,) PACKET
    begins : (STATIONS + 2,) int64
        Start of each stack in `memory`.
    """

    def __init__(self, record: np.dtype[np.void], tops: NDArray[np.int64], children: int = CHILDREN) -> None:
        self.record = record
        self.children = children
        self.memory = np.zeros(0, record)
        self.begins = np.zeros(STATIONS + 2, np.int64)
        self._tops = tops
        self._room, self._room_of_objects = 0, 0

    def waiting(self, station: int) -> NDArray[np.void]:
        """Return the packets that wait at a station, a view valid until the next wave is taken."""
        begin = self.begins[station]
        return self.memory[begin : begin + self._tops[station]]

    def queue(self, station: int, packets: NDArray[np.void]) -> None:
        """Replace the packets that wait at a station; there must be room."""
        self._tops[station] = len(packets)
        self.waiting(station)[:] = packets

    def move(self, station: int, to: int) -> None:
        """Move all packets to another, empty station; neither may be object space."""
        begins, tops = self.begins, self._tops
        begins[station], begins[to] = begins[to], begins[station]
        tops[to], tops[station] = tops[station], 0

    def take(self, station: int, count: int) -> NDArray[np.void]:
        """Take packets off the top of a station's stack; the wave is valid until the next one is taken.

        Parameters
        ----------
        station : int
        count : int
            Number of packets.
        """
        top, begins = self._tops[station], self.begins
        spare = _WAVE_OF_OBJECTS if station == OBJECTS else _WAVE
        self._tops[station] = top - count
        if count == top:
            # The whole stack becomes the wave without a copy; the place of the last wave becomes the station's stack.
            begins[station], begins[spare] = begins[spare], begins[station]
            return self.memory[begins[spare] : begins[spare] + count]
        wave, first = self.memory[begins[spare] : begins[spare] + count], begins[station] + top - count
        wave[:] = self.memory[first : first + count]
        return wave

    def make_room(self, packets: int) -> None:
        """Make room for the children of packets that are started at once.

        Parameters
        ----------
        packets : int
        """
        self._grow(*self._need(packets, self.children))

    def fitted(self, count: int, children: int) -> int:
        """Make room for a wave's children; return the number of its packets, fewer if more would not fit.

        Parameters
        ----------
        count : int
            Largest number of packets, one or more.
        children : int
            Most packets that each adds to the stack of object space.
        """
        most = MOST_BYTES // self.record.itemsize
        while count > 1 and _total(*self._need(count, children)) > most:
            count = (count + 1) // 2
        self._grow(*self._need(count, children))
        return count

    def _need(self, packets: int, children: int) -> tuple[int, int]:
        """Return the room that packets of one station may need in any stack, and in that of object space."""
        tops = self._tops[:STATIONS]
        others = max(int(tops[:OBJECTS].max()), int(tops[OBJECTS + 1 :].max())) + self.children * packets
        return max(self._room, others), max(self._room_of_objects, int(tops[OBJECTS]) + children * packets)

    def _grow(self, room: int, room_of_objects: int) -> None:
        """Give the stacks more room if needed, with a quarter to spare."""
        if (room, room_of_objects) == (self._room, self._room_of_objects):
            return
        ample = (5 * room) // 4, (5 * room_of_objects) // 4
        if _total(*ample) <= MOST_BYTES // self.record.itemsize:
            room, room_of_objects = ample
        larger = np.full(STATIONS + 2, room)
        larger[[OBJECTS, _WAVE_OF_OBJECTS]] = room_of_objects
        begins = np.cumsum(larger) - larger
        # Only waiting packets are copied: memory that is never written to is not allocated by the system.
        memory = np.zeros(int(larger.sum()), self.record)
        for station in range(STATIONS):
            waiting = self.waiting(station)
            memory[begins[station] : begins[station] + len(waiting)] = waiting
        self.memory, self.begins[:] = memory, begins
        self._room, self._room_of_objects = room, room_of_objects


def _total(room: int, room_of_objects: int) -> int:
    """Return the total capacity of all stacks, in packets."""
    return STATIONS * room + 2 * room_of_objects
