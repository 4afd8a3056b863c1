"""The stacks in which packets wait at their stations, in one block of memory that has a limit.

A wave takes the top of a stack. Before it is taken there is room for all packets that may come of it; where these would
not fit within the limit, the wave is shorter. So memory is bounded however many children a packet has, and however many
lamps a point asks.
"""

import numpy as np
from numpy.typing import NDArray

from lfmesh.transport.packets.packet import OBJECTS, STATIONS

MOST_BYTES = 256 << 20
"""Largest size of the stacks of one thread, but for packets that are started all at once."""

CHILDREN = 2
"""Largest number of packets that one adds to a stack, but for that of object space, where points ask lamps."""

_WAVE, _WAVE_OF_OBJECTS = STATIONS, STATIONS + 1
"""Places of the last waves: of object space, whose stack is longer, and of the others."""


class Stacks:
    """The stacks of one thread.

    Parameters
    ----------
    record : dtype
        Of the packets.
    tops : (TOPS,) int64
        Number of packets in each stack; kernels that queue packets count them there.

    Attributes
    ----------
    memory : (n,) PACKET
    begins : (STATIONS + 2,) int64
        Where each stack begins in it.
    """

    def __init__(self, record: np.dtype[np.void], tops: NDArray[np.int64]) -> None:
        self.record = record
        self.memory = np.zeros(0, record)
        self.begins = np.zeros(STATIONS + 2, np.int64)
        self._tops = tops
        self._room, self._room_of_objects = 0, 0

    def waiting(self, station: int) -> NDArray[np.void]:
        """Return the packets that wait at a station, a view until the next wave is taken."""
        begin = self.begins[station]
        return self.memory[begin : begin + self._tops[station]]

    def queue(self, station: int, packets: NDArray[np.void]) -> None:
        """Let packets wait at a station in place of those that do; there is room for them."""
        self._tops[station] = len(packets)
        self.waiting(station)[:] = packets

    def move(self, station: int, to: int) -> None:
        """Let the packets that wait at one station wait at another, where none does; neither is object space."""
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
        """Make room for what as many packets may add that are started at once.

        Parameters
        ----------
        packets : int
        """
        self._grow(*self._need(packets, CHILDREN))

    def fitted(self, count: int, children: int) -> int:
        """Make room for what a wave may add; return the number of its packets, fewer where more would not fit.

        Parameters
        ----------
        count : int
            Largest number of packets, one or more.
        children : int
            Largest number of packets that each of them adds to the stack of object space.
        """
        most = MOST_BYTES // self.record.itemsize
        while count > 1 and _total(*self._need(count, children)) > most:
            count = (count + 1) // 2
        self._grow(*self._need(count, children))
        return count

    def _need(self, packets: int, children: int) -> tuple[int, int]:
        """Return the room that stacks need where packets of a station may add to each: that of any, of object space."""
        tops = self._tops[:STATIONS]
        others = max(int(tops[:OBJECTS].max()), int(tops[OBJECTS + 1 :].max())) + CHILDREN * packets
        return max(self._room, others), max(self._room_of_objects, int(tops[OBJECTS]) + children * packets)

    def _grow(self, room: int, room_of_objects: int) -> None:
        """Give the stacks more room, if they need it, and then a quarter more, so that they seldom do."""
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
    """Return the number of packets that all stacks hold."""
    return STATIONS * room + 2 * room_of_objects
