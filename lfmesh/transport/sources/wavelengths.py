"""Wavelengths of a channel's samples, one spectral line each; samples of one line start together.

Samples lie evenly over the band, from a random offset. Replicates may form a group of m, which takes the samples of a
single replicate of its size: each replicate every m-th of them.
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
    """Turn of a replicate in a group: its subset of the group's samples."""

    first: int = 0  # number of its first sample
    step: int = 1  # from one of its samples to the next: number of replicates in the group


ALONE = Turn()
"""Turn of a replicate that is a group by itself."""


@by_address
class Entries(NamedTuple):
    """Samples of pixels at one wavelength: each entry is a run of consecutive samples."""

    pixel: Numbers  # (n,) number of the pixel, row by row; it may have several entries
    place: Numbers  # (n,) place of the pixel among those launched together
    begin: Numbers  # (n,) number of the first sample
    taken: Numbers  # (n,) number of samples
    turn: Turn


def entries_of_pixels(
    nodes: Nodes, pixels: Numbers, samples: int, key: np.uint64, turn: Turn = ALONE, some: range | None = None
) -> Iterator[tuple[int, Entries]]:
    """Yield the samples of pixels by wavelength, with their column.

    The samples of a pixel are evenly spaced over the band, with the pixel's own offset.

    Parameters
    ----------
    nodes : Nodes
    pixels : (n,) int64
    samples : int
        Samples per pixel.
    key : uint64
        Random key.
    turn : Turn
    some : range, optional
        Consecutive samples of each pixel. Default: all.
    """
    some = range(samples) if some is None else some
    if len(nodes.until) == 1:
        place = np.arange(len(pixels))
        yield nodes.first, Entries(pixels, place, np.full_like(place, some.start), np.full_like(place, len(some)), turn)
        return
    places = (turn.first + np.arange(some.start, some.stop) * turn.step) / (samples * turn.step)
    columns = nodes.columns((places + wavelength_numbers(key, pixels)[:, None]) % 1.0)
    fresh = np.ones(columns.shape, np.bool_)
    fresh[:, 1:] = columns[:, 1:] != columns[:, :-1]
    place, begin = np.nonzero(fresh)
    taken = np.diff(np.flatnonzero(fresh), append=columns.size)
    for alike in _alike(columns[place, begin]):
        column = int(columns[place[alike[0]], begin[alike[0]]])
        yield column, Entries(pixels[place[alike]], place[alike], some.start + begin[alike], taken[alike], turn)


def order_of_particles(
    nodes: Nodes, numbers: Numbers, particles: int, samples: int, key: np.uint64
) -> tuple[Numbers, Numbers]:
    """Return particle packets ordered by wavelength, and their columns.

    Packet p · n + i is sample p of particle i of n. The packets of a particle are evenly spaced over the band, with the
    particle's own offset.

    Parameters
    ----------
    nodes : Nodes
    numbers : (m,) int64
        Packet numbers in the group of replicates.
    particles, samples : int
        Number of particles, and of packets per particle in the group.
    key : uint64
    """
    return _in_order(nodes, numbers, (numbers // particles) / samples + wavelength_numbers(key, numbers % particles))


def order_of_packets(nodes: Nodes, numbers: Numbers, key: np.uint64) -> tuple[Numbers, Numbers]:
    """Return light packets ordered by wavelength, and their columns.

    Consecutive packets step over the band by the golden ratio, which spreads them evenly.

    Parameters
    ----------
    nodes : Nodes
    numbers : (n,) int64
        Packet numbers.
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
    """Return the indices of each distinct value, by increasing value."""
    order = np.argsort(values, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(values[order])) + 1) if len(values) else []
