"""Wavelengths of a channel's samples: each takes one of the band's lines, and samples of one line start together.

Samples lie evenly over the band, from an offset on that random numbers give. Replicates may be a group, which takes the
samples that a single replicate of its size would take, each every m-th of them.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.by_address import by_address
from lfmesh.transport.packets.random import GOLDEN, wavelength_number, wavelength_numbers
from lfmesh.transport.tables.lines import Nodes

Numbers = NDArray[np.int64]


class Turn(NamedTuple):
    """A replicate's turn in a group: the samples that it takes of those of the whole group."""

    first: int = 0  # number of its first sample
    step: int = 1  # from each of its samples to the next: number of replicates of the group


ALONE = Turn()
"""Of a replicate that is a group by itself."""


@by_address
class Entries(NamedTuple):
    """Samples of pixels at one wavelength: of each entry some that follow each other."""

    pixel: Numbers  # (n,) number of the pixel, row by row; it may have several entries
    place: Numbers  # (n,) its place among the pixels that are launched together
    begin: Numbers  # (n,) number of the first sample
    taken: Numbers  # (n,) samples
    turn: Turn


def entries_of_pixels(
    nodes: Nodes, pixels: Numbers, samples: int, key: np.uint64, turn: Turn = ALONE
) -> Iterator[tuple[int, Entries]]:
    """Yield the samples of pixels, wavelength by wavelength, each with its column.

    Those of a pixel lie at even distances over the band, with an offset of the pixel's own.

    Parameters
    ----------
    nodes : Nodes
    pixels : (n,) int64
    samples : int
        Of each pixel.
    key : uint64
        Key of the random numbers.
    turn : Turn
    """
    if len(nodes.until) == 1:
        place = np.arange(len(pixels))
        yield nodes.first, Entries(pixels, place, np.zeros_like(place), np.full_like(place, samples), turn)
        return
    places = (turn.first + np.arange(samples) * turn.step) / (samples * turn.step)
    columns = nodes.columns((places + wavelength_numbers(key, pixels)[:, None]) % 1.0)
    fresh = np.ones(columns.shape, np.bool_)
    fresh[:, 1:] = columns[:, 1:] != columns[:, :-1]
    place, begin = np.nonzero(fresh)
    taken = np.diff(np.flatnonzero(fresh), append=columns.size)
    for some in _alike(columns[place, begin]):
        column = int(columns[place[some[0]], begin[some[0]]])
        yield column, Entries(pixels[place[some]], place[some], begin[some], taken[some], turn)


def order_of_particles(
    nodes: Nodes, numbers: Numbers, particles: int, samples: int, key: np.uint64
) -> tuple[Numbers, Numbers]:
    """Return packets of particles in the order of their wavelengths, and their columns.

    Packet p · n + i is sample p of particle i of n. Those of a particle lie at even distances over the band, with an
    offset of its own.

    Parameters
    ----------
    nodes : Nodes
    numbers : (m,) int64
        Of the packets, in the group of replicates.
    particles, samples : int
        Number of particles, and of packets of each in the group.
    key : uint64
    """
    return _in_order(nodes, numbers, (numbers // particles) / samples + wavelength_numbers(key, numbers % particles))


def order_of_packets(nodes: Nodes, numbers: Numbers, key: np.uint64) -> tuple[Numbers, Numbers]:
    """Return packets of lights in the order of their wavelengths, and their columns.

    Packets that follow each other lie evenly over the band: at steps of the golden ratio.

    Parameters
    ----------
    nodes : Nodes
    numbers : (n,) int64
        Of the packets.
    key : uint64
    """
    steps = (numbers.astype(np.uint64) * GOLDEN).astype(np.float64) * 2.0**-64
    return _in_order(nodes, numbers, steps + wavelength_number(np.uint64(key)))


def _in_order(nodes: Nodes, numbers: Numbers, places: NDArray[np.float64]) -> tuple[Numbers, Numbers]:
    if len(nodes.until) == 1:
        return numbers, np.full(len(numbers), nodes.first)
    columns = nodes.columns(places % 1.0)
    order = np.argsort(columns, kind="stable")
    return numbers[order], columns[order]


def _alike(values: Numbers) -> list[Numbers]:
    """Return the places of each of some values, by increasing value."""
    order = np.argsort(values, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(values[order])) + 1) if len(values) else []
