"""Stacks: packets wait in order, and their memory has a limit however many children packets may have."""

import numpy as np
import pytest

from lfmesh.transport.packets.packet import LENS, OBJECTS, PACKET, PLATE, POLARISED, SENSOR, STATIONS, TOPS
from lfmesh.transport.packets.stacks import CHILDREN, MOST_BYTES, Stacks

CHUNK = 16_384


def numbered(first: int, count: int) -> np.ndarray:
    packets = np.zeros(count, PACKET)
    packets["source"] = np.arange(first, first + count)
    return packets


def test_a_wave_is_the_top_of_its_stack_and_the_rest_stays() -> None:
    for station in (LENS, OBJECTS):
        stacks = Stacks(PACKET, tops := np.zeros(TOPS, np.int64))
        stacks.make_room(10)
        stacks.queue(station, numbered(0, 10))
        assert stacks.take(station, 4)["source"].tolist() == [6, 7, 8, 9]
        assert stacks.waiting(station)["source"].tolist() == [0, 1, 2, 3, 4, 5]
        wave = stacks.take(station, 6)
        stacks.queue(station, numbered(20, 3))
        assert wave["source"].tolist() == [0, 1, 2, 3, 4, 5]
        assert tops[station] == 3


def test_packets_stay_where_they_wait_when_stacks_grow_and_move() -> None:
    stacks = Stacks(PACKET, np.zeros(TOPS, np.int64))
    stacks.make_room(8)
    for station in range(STATIONS):
        stacks.queue(station, numbered(100 * station, 5))
    assert stacks.fitted(5, 3000) == 5
    for station in range(STATIONS):
        assert stacks.waiting(station)["source"].tolist() == list(range(100 * station, 100 * station + 5))
    stacks.take(SENSOR, 5)
    stacks.move(PLATE, SENSOR)
    assert stacks.waiting(SENSOR)["source"].tolist() == list(range(100 * PLATE, 100 * PLATE + 5))
    assert len(stacks.waiting(PLATE)) == 0


@pytest.mark.parametrize("record", [PACKET, POLARISED])
@pytest.mark.parametrize("children", [3, 30, 1000])
def test_memory_has_a_limit_however_many_children_packets_have(record: np.dtype, children: int) -> None:
    stacks = Stacks(record, tops := np.zeros(TOPS, np.int64))
    stacks.make_room(CHUNK)
    tops[LENS] = CHUNK
    longest = 0
    # Each packet of the lens leads to one of object space, and each of these to all its children, which have none.
    tops[OBJECTS], spawn = CHUNK, CHUNK
    for _ in range(10_000):
        if not tops[OBJECTS]:
            break
        count = stacks.fitted(min(int(tops[OBJECTS]), CHUNK), children)
        assert count >= 1
        assert stacks.memory.nbytes <= MOST_BYTES
        tops[OBJECTS] -= count
        born = min(spawn, count)
        spawn -= born
        tops[OBJECTS] += born * min(children, 8)
        longest = max(longest, count)
        assert stacks.begins.max() <= len(stacks.memory)
    assert longest > CHUNK // 4 or children > 30
    assert tops[OBJECTS] == 0


def test_a_wave_of_few_children_is_a_whole_chunk() -> None:
    stacks = Stacks(PACKET, tops := np.zeros(TOPS, np.int64))
    stacks.make_room(CHUNK)
    tops[OBJECTS] = tops[LENS] = CHUNK
    assert stacks.fitted(CHUNK, CHILDREN + 8) == CHUNK
