"""The bodies that a packet is in are a set, ordered by rank, whatever the order in which they are entered and left."""

from itertools import permutations

import numpy as np
import pytest

from lfmesh.kernels.decorators import kernel
from lfmesh.transport.events.bodies import (
    BITS,
    MOST_AT_ONCE,
    MOST_BODIES,
    RANK,
    TOO_MANY,
    bodies_round,
    is_in,
    set_bodies,
    with_body,
    without_body,
)
from lfmesh.transport.packets.packet import NO_SURFACE, PACKET


def ranks(inside: int) -> list[int]:
    """Return the ranks that a number holds, as they stand in it."""
    return [(inside >> (BITS * place)) & RANK for place in range(MOST_AT_ONCE) if (inside >> (BITS * place)) & RANK]


def entered(*each: int) -> int:
    inside = 0
    for rank in each:
        inside = with_body(inside, rank)
    return inside


def test_the_highest_rank_comes_first_in_whatever_order_bodies_are_entered() -> None:
    for order in permutations([3, 17, 500, MOST_BODIES]):
        assert ranks(entered(*order)) == [MOST_BODIES, 500, 17, 3]


def test_bodies_are_left_in_any_order() -> None:
    for order in permutations([3, 17, 500, MOST_BODIES]):
        inside, rest = entered(17, MOST_BODIES, 3, 500), {3, 17, 500, MOST_BODIES}
        for rank in order:
            inside = without_body(inside, rank)
            rest.remove(rank)
            assert set(ranks(inside)) == rest
            assert ranks(inside) == sorted(rest, reverse=True)
        assert inside == 0


def test_a_packet_is_in_what_it_has_entered_and_in_nothing_else() -> None:
    draw = np.random.default_rng(1)
    for _ in range(200):
        own = set(draw.integers(1, 40, MOST_AT_ONCE).tolist())
        inside = entered(*own)
        assert {rank for rank in range(1, 40) if is_in(inside, rank)} == own
    assert not is_in(0, 1)


def test_there_is_room_for_so_many_and_no_more() -> None:
    full = entered(*range(1, MOST_AT_ONCE + 1))
    assert full != TOO_MANY
    assert with_body(full, MOST_AT_ONCE + 1) == TOO_MANY


@kernel
def kept(packets, inside):
    set_bodies(packets[0], inside)
    return bodies_round(packets[0])


@pytest.mark.parametrize("own", [(), (1,), (MOST_BODIES,), (1, 2, 3, 4), (MOST_BODIES, MOST_BODIES - 1, 1500, 1000)])
def test_a_packet_keeps_its_bodies_in_fields_that_lens_and_array_use(own: tuple[int, ...]) -> None:
    packets = np.zeros(1, PACKET)
    assert kept(packets, entered(*own)) == entered(*own)
    assert (packets["bodies"][0] == NO_SURFACE) == (not own)


@kernel
def round_the_first(packets):
    return bodies_round(packets[0])


def test_a_packet_outside_all_glass_is_in_no_body_whatever_space_it_came_from() -> None:
    packets = np.zeros(1, PACKET)
    packets["bodies"], packets["space"] = NO_SURFACE, 123
    assert round_the_first(packets) == 0


def test_the_density_of_a_direction_stands_in_no_field_of_the_bodies() -> None:
    packets = np.zeros(1, PACKET)
    inside = entered(MOST_BODIES, MOST_BODIES - 1, 1500, 1000)
    kept(packets, inside)
    packets["density"] = 0.3
    assert round_the_first(packets) == inside
    assert packets["density"][0] == np.float32(0.3)
