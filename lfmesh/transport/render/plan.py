"""Plan of a replicate: chunks in a fixed order, and blocks of pixels.

A chunk is the work of one thread at a time. Chunks do not depend on the blocks; they are numbered in folding order.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfmesh.transport.render.adaptive import Counts, total_samples
from lfmesh.transport.render.parts import Part
from lfmesh.transport.tables.lines import Lines

PIXELS_SORTED = 1 << 20
"""Number of pixels of a second stage that are sorted by their samples together."""


Piece = tuple[int, int, int, NDArray[np.int64] | None]
"""First pixel or packet and their number, samples per pixel, and pixel numbers, as in `Chunk`."""


@dataclass(frozen=True)
class Chunk:
    """Consecutive pixels (adjoint) or packets (forward) of one replicate, part and channel.

    In a second stage, pixels with the same number of samples.

    Attributes
    ----------
    number : int
        Place in the order of folding.
    part : Part
    first, count : int
        Number of the first pixel or packet, and their count.
    channel : int
        Channel of the image.
    packets : int
        Number of packets that the chunk starts.
    samples : int
        Samples per pixel.
    pixels : (count,) int64, or None
        Pixel numbers; None for consecutive ones from `first`.
    owner : int
        Pixel in the block that books the chunk.
    place : int
        Place of its part in the image.
    """

    number: int
    part: Part
    first: int
    count: int
    channel: int
    packets: int
    samples: int = 1
    pixels: NDArray[np.int64] | None = None
    owner: int = 0
    place: int = 0

    def pixel_numbers(self) -> NDArray[np.int64]:
        """Return the numbers of the chunk's pixels."""
        return np.arange(self.first, self.first + self.count) if self.pixels is None else self.pixels


@dataclass(frozen=True)
class Block:
    """Pixels from `first` to `last` (excluded), and the same share of packets from lights."""

    first: int
    last: int

    def owns(self, chunk: Chunk) -> bool:
        """Tell whether the chunk begins in this block, which then books it."""
        return self.first <= chunk.owner < self.last

    def touches(self, chunk: Chunk) -> bool:
        """Tell whether the chunk adds anything to this block."""
        if self.owns(chunk) or not chunk.part.options.adjoint:
            return self.owns(chunk)
        if chunk.pixels is None:
            return chunk.first < self.last and chunk.first + chunk.count > self.first
        return bool(((chunk.pixels >= self.first) & (chunk.pixels < self.last)).any())


@dataclass(frozen=True)
class Plan:
    """Division of a scene's replicates into chunks.

    Attributes
    ----------
    parts : tuple of Part
    pixels : int
    lines : Lines
        Wavelengths of the channels.
    samples : int
        Samples per pixel in each replicate of the first stage.
    chunk : int
        Number of packets that start a chunk.
    replicates : int
    """

    parts: tuple[Part, ...]
    pixels: int
    lines: Lines
    samples: int
    chunk: int
    replicates: int = 1

    def chunks(self, replicate: int, levels: Counts | None = None) -> Iterator[Chunk]:
        """Yield a replicate's chunks in folding order; `levels` (pixels,) selects the second stage."""
        number = 0
        for place, part in enumerate(self.parts):
            for channel in range(self.lines.channels):
                for first, count, samples, pixels in (
                    self._first(part) if levels is None else self._second(part, levels)
                ):
                    chunk = Chunk(number, part, first, count, channel, count, samples, pixels, place=place)
                    if part.options.adjoint:
                        yield replace(chunk, packets=count * samples, owner=first)
                    else:
                        yield replace(chunk, owner=first * self.pixels // self._packets(part))
                    number += 1

    def _first(self, part: Part) -> Iterator[Piece]:
        samples = part.samples(self.samples)
        if not part.options.adjoint:
            packets = self._packets(part)
            samples = samples if part.particles is None else part.per_particle(self.replicates)
            for first in range(0, packets, self.chunk):
                yield first, min(self.chunk, packets - first), samples, None
            return
        per_chunk = max(1, self.chunk // samples)
        for first in range(0, self.pixels, per_chunk):
            yield first, min(per_chunk, self.pixels - first), samples, None

    def _second(self, part: Part, levels: Counts) -> Iterator[Piece]:
        """Yield the chunks of a second-stage replicate, of pixels with equal samples."""
        if not part.options.adjoint:
            return
        for block in range(0, self.pixels, PIXELS_SORTED):
            sorted_here = levels[block : block + PIXELS_SORTED]
            for level in np.unique(sorted_here[sorted_here > 0]):
                samples = part.samples(1 << (int(level) - 1))
                pixels = block + np.flatnonzero(sorted_here == level)
                per_chunk = max(1, self.chunk // samples)
                for first in range(0, len(pixels), per_chunk):
                    some = pixels[first : first + per_chunk]
                    yield int(some[0]), len(some), samples, some

    def _packets(self, part: Part) -> int:
        """Return a part's packets per channel in a first-stage replicate."""
        return part.packets(self.pixels, self.samples, self.replicates)

    def packets(self, levels: Counts | None = None) -> int:
        """Return the number of packets that a replicate starts."""
        if levels is None:
            return sum(self.lines.channels * self._packets(part) for part in self.parts)
        adjoint = [part for part in self.parts if part.options.adjoint]
        return sum(self.lines.channels * total_samples(levels, part.samples) for part in adjoint)

    def whole(self) -> Block:
        """Return the block of all pixels."""
        return Block(0, self.pixels)

    def blocks(self, wanted: int, *, second: bool = False) -> list[Block]:
        """Cut the pixels into about the wanted number of blocks.

        Any cut gives the same bits. Borders lie between chunks of the first stage, if the number of samples is a power
        of two, and between the pixels that a second stage sorts together, so hardly any chunk is traced twice.
        """
        adjoint = [part.samples(self.samples) for part in self.parts if part.options.adjoint]
        step = max(max(1, self.chunk // samples) for samples in adjoint or [self.samples])
        step = PIXELS_SORTED if second else step
        each = step * max(1, round(self.pixels / (step * wanted)))
        return [Block(first, min(first + each, self.pixels)) for first in range(0, self.pixels, each)]
