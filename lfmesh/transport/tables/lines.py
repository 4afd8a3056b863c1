"""The single wavelengths, lines for short, at which a scene is traced: the columns of all tables by wavelength.

Without bands each wavelength of the scene is a line and a channel of the image. A band is sampled by lines: every
replicate has lines of its own in each band, drawn by the band's response. They come in pairs, one pair for each of
several intervals with equal integrals of the response, and lie at random but symmetrically in it (antithetic
stratified sampling), so that what is linear over an interval is integrated exactly. A path has one line. The samples
of a pixel take the lines in turn. Where they are too few for all, as many neighbouring pixels of a row as it takes
share them, in an order that is drawn anew for each such group and replicate: what one of them lacks of the band the
next one has, and no pattern of pixels sees the same part of it. As the replicates' lines are independent, the spread of
the replicates holds the noise of the wavelengths.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import gcd

import numpy as np
from numpy.typing import NDArray

from lfmesh.optics.curve import Curve
from lfmesh.scene import Scene
from lfmesh.transport.packets.random import GOLDEN, descendant, run_key, start

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]

MOST_IN_BAND = 32
"""Largest number of lines of a replicate in a band; a power of two."""

MOST_LINES = 1024
"""Number of lines in all above which a band gets fewer; with so many bands and replicates each has at least one."""

LEAST_AT_LINE = 2
"""Samples of a pixel that take a line together, where it has so many: what the aim needs to know of a pixel is found
anew for each line."""

FEW = 4
"""Number of lines of a replicate in a band that are enough for a small part of its light."""

LINES_STREAM = 1 << 21
"""Number of the random numbers by which lines are drawn; replicates have others."""


@dataclass(frozen=True)
class Turn:
    """The samples of all pixels that take one line of a band, in one replicate.

    Attributes
    ----------
    line, lines : int
        Number of the line in its band, and number of lines.
    column : int
        Of the tables.
    offset : int
        Line with which the packets of lights begin.
    key : uint64
        Of the random numbers that decide which pixels take which lines.
    """

    line: int
    lines: int
    column: int
    offset: int
    key: np.uint64

    def shares(self, samples: int) -> int:
        """Return the number of lines that a pixel takes for some samples, each for as many of them."""
        return gcd(max(1, samples // LEAST_AT_LINE) if samples % LEAST_AT_LINE == 0 else samples, self.lines)

    def takes(self, pixels: Numbers, samples: int) -> NDArray[np.bool_]:
        """Whether pixels, (n,), with so many samples take the line."""
        return (self.line - self._first_line(pixels, samples)) % (self.lines // self.shares(samples)) == 0

    def begin(self, pixels: Numbers, samples: int) -> Numbers:
        """Return the number of the first sample of each pixel, (n,), that takes the line; as many follow for all."""
        shares = self.shares(samples)
        place = (self.line - self._first_line(pixels, samples)) % self.lines // (self.lines // shares)
        return np.asarray(place * (samples // shares), np.int64)

    def part(self, total: int) -> range:
        """Return the packets of a light that take the line, of `total` in all; none of them if there are too few."""
        shares = self.shares(total)
        ahead = (self.line - self.offset) % self.lines
        if ahead % (self.lines // shares):
            return range(0)
        first = ahead // (self.lines // shares) * (total // shares)
        return range(first, first + total // shares)

    def _first_line(self, pixels: Numbers, samples: int) -> Numbers:
        """Return the line that the first samples of pixels take.

        Pixels come in groups in which each takes other lines: the bits of its place, turned round so that neighbours
        take lines far apart, and flipped at random for each group.
        """
        together = self.lines // self.shares(samples)
        random = _hashed(self.key, pixels // together) % np.uint64(self.lines)
        drawn = random.astype(np.int64)
        return (_reversed(pixels % together, together) ^ (drawn % together)) + drawn // together * together


def _hashed(key: np.uint64, numbers: Numbers) -> NDArray[np.uint64]:
    """Return hashes of numbers, (n,), as `random.derived` has them."""
    with np.errstate(over="ignore"):
        return _mixed(_mixed(np.asarray(key + GOLDEN)) ^ (numbers.astype(np.uint64) * GOLDEN))


def _mixed(z: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return `random.mix` of an array."""
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


def _reversed(numbers: Numbers, count: int) -> Numbers:
    """Return whole numbers below a power of two with their bits in reverse order."""
    turned, rest = np.zeros_like(numbers), numbers
    while count > 1:
        turned, rest, count = 2 * turned + rest % 2, rest // 2, count // 2
    return turned


@dataclass(frozen=True, eq=False)
class Lines:
    """The lines of a scene.

    Attributes
    ----------
    wavelengths_nm : tuple of float
        Of each column; in bands, increasing.
    weight_nm : (columns,) float64, nm
        Integral of the band's response, by which a density per nm becomes a power; 1 without bands.
    columns : (replicates, channels, lines) int64
        Column of each line; without bands a single replicate stands for all.
    offsets : (replicates, channels) int64
        Line with which the packets of lights begin.
    keys : (replicates, channels) uint64
        Of the random numbers that decide which pixels take which lines.
    span_nm : (float, float) or None
        Ends of the range that the bands reach over; None without bands.
    """

    wavelengths_nm: tuple[float, ...]
    weight_nm: Array
    columns: Numbers
    offsets: Numbers
    keys: NDArray[np.uint64]
    span_nm: tuple[float, float] | None

    @classmethod
    def of(cls, scene: Scene) -> "Lines":
        """Return the lines of a scene.

        Raises
        ------
        FileError
            The file of a response cannot be used.
        """
        bands = scene.passbands
        if not bands:
            single = scene.transport.wavelengths_nm
            alone = np.arange(len(single)).reshape(1, -1, 1)
            none = np.zeros((1, len(single)), np.int64)
            return cls(single, np.ones(len(single)), alone, none, none.astype(np.uint64), None)
        transport = scene.transport
        # A second stage has replicates of its own.
        replicates = transport.replicates * (1 if transport.target_error is None else 2)
        count = MOST_IN_BAND
        while count > 1 and count * replicates * len(bands) > MOST_LINES:
            count //= 2
        drawn = np.empty((replicates, len(bands), count))
        offsets = np.empty((replicates, len(bands)), np.int64)
        keys = np.empty(offsets.shape, np.uint64)
        for replicate in range(replicates):
            for channel, band in enumerate(bands):
                key = descendant(run_key(transport.seed), LINES_STREAM, replicate, channel)
                drawn[replicate, channel] = band.response.quantile_nm(_shares(key, count))
                offsets[replicate, channel] = int(count * start(key, count))
                keys[replicate, channel] = descendant(key, count)
        order = np.argsort(drawn, axis=None, kind="stable")
        columns = np.empty(order.size, np.int64)
        columns[order] = np.arange(order.size)
        areas = np.broadcast_to(np.array([[[band.response.area_nm] for band in bands]]), drawn.shape)
        return cls(
            tuple(drawn.ravel()[order].tolist()), areas.ravel()[order], columns.reshape(drawn.shape), offsets, keys,
            scene.reach_nm,
        )  # fmt: skip

    @property
    def in_bands(self) -> bool:
        """Whether channels are bands, each with lines that change from replicate to replicate."""
        return self.span_nm is not None

    def power(self, total: float, shape: Curve | None = None) -> Array:
        """Return the share of a light's power that each line stands for, (columns,).

        Without bands each line has the whole. In bands the power is spread over the range that they reach over, and
        each line stands for what of that its band detects.

        Parameters
        ----------
        total : float
            Power, or irradiance or radiance.
        shape : Curve, optional
            How it is spread by wavelength; evenly if left out.
        """
        if self.span_nm is None:
            return np.full(len(self.weight_nm), total)
        first, last = self.span_nm
        if shape is None:
            return total / (last - first) * self.weight_nm
        return total / shape.integral(first, last) * shape.at(self.wavelengths_nm) * self.weight_nm

    @property
    def channels(self) -> int:
        """Number of channels of the image."""
        return self.columns.shape[1]

    def turns(self, replicate: int, channel: int, *, few: bool = False) -> Iterator[Turn]:
        """Yield the lines of a channel in a replicate.

        Parameters
        ----------
        replicate, channel : int
        few : bool
            Only some of them, evenly spread, for a small part of the light: each line is traced by itself, and short
            waves of packets take longer.
        """
        replicate %= len(self.columns)
        columns, offset = self.columns[replicate, channel], int(self.offsets[replicate, channel])
        key = self.keys[replicate, channel]
        step = max(1, len(columns) // FEW) if few else 1
        columns, offset = columns[offset % step :: step], offset // step
        for line, column in enumerate(columns):
            yield Turn(line, len(columns), int(column), offset, key)

    def nearest(self, wavelength_nm: float) -> int:
        """Return the column whose wavelength is nearest to another."""
        return int(np.argmin(np.abs(np.array(self.wavelengths_nm) - wavelength_nm)))


def _shares(key: np.uint64, count: int) -> Array:
    """Return shares of a band's integral at which its lines lie, (count,): pairs, symmetric in equal intervals."""
    if count == 1:
        return np.array([start(key, 0)])
    pairs = count // 2
    random = np.array([start(key, pair) for pair in range(pairs)])
    return (np.arange(pairs)[:, None] + np.stack([random, 1.0 - random], axis=1)).ravel() / pairs
