"""Tallies: results of a render's replicates, and their running sum.

The flow is chunk → tally of a replicate → sum of a stage → state of the render → image. Each part of an image has its
own films and means up to the image. All are numbers and numpy arrays, which can be pickled, saved by `arrays_of` and
loaded by `filled`. Sums are folded in a fixed order, chunk by chunk and replicate by replicate, so the result does not
depend on the processes and their timing.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.transport.checks.blind_check import BlindSamples

Array = NDArray[np.float64]
Shape = tuple[int, int, int]
"""Rows and columns of the sensor, and wavelengths."""


@dataclass
class Film:
    """Light of a part in one replicate, or in a block of its pixels.

    Attributes
    ----------
    power : (pixels, wavelengths) float64, W
    hits : (pixels, wavelengths) uint32
        Number of samples that brought light; forward: of packets.
    origin : int
        Pixel number of the first row.
    """

    power: Array
    hits: NDArray[np.uint32]
    origin: int = 0

    @classmethod
    def empty(cls, pixels: int, colours: int, origin: int = 0) -> "Film":
        """Return a film without light.

        Parameters
        ----------
        pixels, colours : int
            Numbers of pixels and of wavelengths.
        origin : int
            Number of the first pixel.
        """
        return cls(np.zeros((pixels, colours)), np.zeros((pixels, colours), np.uint32), origin)

    def clear(self) -> None:
        """Remove all light."""
        self.power[:] = 0.0
        self.hits[:] = 0

    def clear_pixels(self, pixels: NDArray[np.int64], colour: int) -> None:
        """Remove the light of some pixels at a wavelength."""
        self.power[pixels, colour] = 0.0
        self.hits[pixels, colour] = 0

    def deposit(self, fallen: NDArray[np.void]) -> None:
        """Add packets that fell on pixels: fields pixel, colour and weight, W."""
        np.add.at(self.power, (fallen["pixel"], fallen["colour"]), fallen["weight"])
        np.add.at(self.hits, (fallen["pixel"], fallen["colour"]), np.uint32(1))

    def part(self, first: int, last: int) -> "Film":
        """Return a copy of the pixels from number `first` to `last` (excluded)."""
        rows = slice(first - self.origin, last - self.origin)
        return Film(self.power[rows].copy(), self.hits[rows].copy(), first)


@dataclass
class Work:
    """Counts and times of work.

    Attributes
    ----------
    counts : (COUNTERS,) int64
        Counters of `lfmesh.transport.packets.packet`.
    packets : int
        Packets started.
    queries : int
        Rays that Embree was queried for.
    embree_seconds, thread_seconds : float
        Summed over threads.
    """

    counts: NDArray[np.int64]
    packets: int = 0
    queries: int = 0
    embree_seconds: float = 0.0
    thread_seconds: float = 0.0

    def add(self, other: "Work") -> None:
        """Add other work."""
        self.counts += other.counts
        self.packets += other.packets
        self.queries += other.queries
        self.embree_seconds += other.embree_seconds
        self.thread_seconds += other.thread_seconds


@dataclass
class ChunkTally:
    """Result of one chunk, except for the light that it added to a film.

    Attributes
    ----------
    number : int
        Number of the chunk in its replicate.
    book : (BOOKS, slots) float64
        Entries of the books.
    work : Work
    deposits : (n,) DEPOSIT
        Forward packets that fell on pixels.
    part : int
        Place of its part in the image.
    """

    number: int
    book: Array
    work: Work
    deposits: NDArray[np.void]
    part: int


@dataclass
class Piece:
    """Block's share of a replicate, not yet folded because of chunks of other blocks in between.

    Attributes
    ----------
    replicate : int
    first, last : int
        The block's pixels, from number `first` to `last` (excluded).
    films : tuple of Film
        Light of these pixels, for each part that starts from pixels.
    chunks : list of ChunkTally
        Chunks that begin in the block.
    blind : BlindSamples or None
    """

    replicate: int
    first: int
    last: int
    films: tuple[Film, ...]
    chunks: list[ChunkTally]
    blind: BlindSamples | None = None


def joined(pieces: Sequence[Piece]) -> Piece:
    """Return neighbouring pieces of a replicate as one, without sums, so the bits stay the same.

    Parameters
    ----------
    pieces : sequence of Piece
        In the order of their pixels.
    """
    films = tuple(
        Film(np.concatenate([film.power for film in row]), np.concatenate([film.hits for film in row]), row[0].origin)
        for row in zip(*(piece.films for piece in pieces), strict=True)
    )
    chunks = [chunk for piece in pieces for chunk in piece.chunks]
    blind = next((piece.blind for piece in pieces if piece.blind is not None), None)
    return Piece(pieces[0].replicate, pieces[0].first, pieces[-1].last, films, chunks, blind)


@dataclass
class Tally:
    """Result of one replicate.

    Attributes
    ----------
    replicate : int
    films : tuple of Film
        Film of all pixels for each part; parts that start from pixels first.
    book : (BOOKS, slots) float64
    work : Work
    blind : BlindSamples or None
        Unaimed samples to check the image.
    chunks : int
        Number of chunks folded in, the first ones of the plan.
    """

    replicate: int
    films: tuple[Film, ...]
    book: Array
    work: Work
    blind: BlindSamples | None = None
    chunks: int = 0

    def restart(self, replicate: int) -> None:
        """Clear the tally for another replicate, in the same memory."""
        self.replicate = replicate
        for film in self.films:
            film.clear()
        self.book[:] = 0.0
        self.work = Work(np.zeros_like(self.work.counts))
        self.blind = None
        self.chunks = 0

    def add(self, chunk: ChunkTally) -> None:
        """Add the next chunk; its light from pixels is already on the film."""
        self.book += chunk.book
        self.work.add(chunk.work)
        self.films[chunk.part].deposit(chunk.deposits)
        self.chunks += 1

    def merge(self, pieces: Iterable[Piece]) -> None:
        """Fold the pieces of the tally's replicate, in any order, to the bits of a single process.

        Raises
        ------
        ValueError
            The pieces do not make up this replicate: a pixel or chunk is missing or given twice.
        """
        chunks: list[ChunkTally] = []
        covered = np.zeros(len(self.films[0].power), np.uint8)
        for piece in pieces:
            if piece.replicate != self.replicate:
                raise ValueError(f"a piece of replicate {piece.replicate} does not belong to {self.replicate}")
            rows = slice(piece.first, piece.last)
            covered[rows] += 1
            for film, block in zip(self.films, piece.films, strict=False):
                film.power[rows] = block.power
                film.hits[rows] = block.hits
            chunks += piece.chunks
            self.blind = piece.blind if piece.blind is not None else self.blind
        chunks.sort(key=lambda chunk: chunk.number)
        if (covered != 1).any() or [chunk.number for chunk in chunks] != list(range(len(chunks))):
            raise ValueError(f"the pieces do not make up replicate {self.replicate}: some are missing or there twice")
        for chunk in chunks:
            self.add(chunk)


@dataclass
class Mean:
    """Running mean and sum of squared deviations over replicates (Welford 1962), and sum of hits.

    For replicates in groups, the deviations are of the groups' sums.
    """

    mean: Array
    squares: Array
    hits: NDArray[np.uint32]
    count: int = 0
    final: bool = False
    """True once `squares` has become the variance."""
    groups: Array | None = None
    """Sums of the replicates of each group; None if each replicate is a group."""

    @classmethod
    def empty(cls, shape: Shape, groups: int | None = None) -> "Mean":
        """Return the mean over no replicates; `groups`: number of groups that they belong to in turn."""
        sums = None if groups is None else np.zeros((groups, *shape))
        return cls(np.zeros(shape), np.zeros(shape), np.zeros(shape, np.uint32), groups=sums)

    def add(self, film: Film) -> None:
        """Add one replicate's film."""
        sample = film.power.reshape(self.mean.shape)
        if self.groups is not None:
            self.groups[self.count % len(self.groups)] += sample
        self.count += 1
        self.hits += film.hits.reshape(self.hits.shape)
        # Row by row, to avoid large temporary arrays.
        for mean, squares, row in zip(self.mean, self.squares, sample, strict=True):
            change = row - mean
            mean += change / self.count
            if self.groups is None:
                squares += change * (row - mean)

    def add_estimate(self, other: "Mean") -> None:
        """Add an independent estimate of other light: means, variances of the mean, and hits."""
        variance = self.variance()
        variance += other.variance()
        self.mean += other.mean
        self.hits += other.hits

    def variance(self) -> Array:
        """Return the variance of the mean, in place of `squares`; NaN from fewer than two replicates.

        For groups with sums S of m replicates each it is Σ (S − m mean)² / ((Σ m)² − Σ m²). That is unbiased if the
        variance of a sum is proportional to m, or if all m are equal.
        """
        if not self.final:
            freedom = self.count * (self.count - 1)
            if self.groups is not None:
                sizes = [len(range(group, self.count, len(self.groups))) for group in range(len(self.groups))]
                freedom = self.count**2 - sum(size**2 for size in sizes)
                for sums, size in zip(self.groups, sizes, strict=True):
                    for squares, row, mean in zip(self.squares, sums, self.mean, strict=True):
                        squares += (row - size * mean) ** 2
            self.squares /= freedom or np.nan
            self.final = True
        return self.squares


@dataclass
class StageSum:
    """Sum over the replicates of a stage so far.

    Attributes
    ----------
    means : tuple of Mean
        Mean of each part; parts that start from pixels first.
    book : (BOOKS, slots) float64
    work : Work
    blind : BlindSamples or None
    """

    means: tuple[Mean, ...]
    book: Array
    work: Work
    blind: BlindSamples | None = None

    @property
    def count(self) -> int:
        """Replicates summed."""
        return self.means[0].count

    def add(self, tally: Tally) -> None:
        """Add the next replicate."""
        for mean, film in zip(self.means, tally.films, strict=True):
            mean.add(film)
        self.book += tally.book
        self.work.add(tally.work)
        if self.blind is not None and tally.blind is not None:
            self.blind.join(tally.blind)


@dataclass
class RenderState:
    """State of a render, complete enough to continue it.

    Attributes
    ----------
    first : StageSum
    second : StageSum or None
        Second stage, of adaptive sampling, once the first is complete.
    seconds : float
        Wall-clock time spent.
    partial : Tally or None
        Replicate in progress, of the current stage. Its films may hold light of chunks not yet folded.
    """

    first: StageSum
    second: StageSum | None = None
    seconds: float = 0.0
    partial: Tally | None = None


@dataclass(frozen=True)
class Layout:
    """Sizes of all sums of a render.

    Attributes
    ----------
    shape : (rows, columns, wavelengths)
    book : (books, slots)
    counters : int
    parts, from_pixels : int
        Parts of the image, and the number of parts, the first ones, that start from pixels.
    blind : bool
        Samples without aim check the image.
    groups : int, optional
        Number of groups that the replicates belong to in turn; None if each is a group.
    """

    shape: Shape
    book: tuple[int, int]
    counters: int
    parts: int = 1
    from_pixels: int = 1
    blind: bool = False
    groups: int | None = None

    def tally(self, *, second: bool = False) -> Tally:
        """Return an empty tally of a first- or second-stage replicate."""
        pixels, colours = self.shape[0] * self.shape[1], self.shape[2]
        films = tuple(Film.empty(pixels, colours) for _ in range(self._parts(second)))
        return Tally(0, films, np.zeros(self.book), self._work())

    def stage(self, *, second: bool = False) -> StageSum:
        """Return the empty sum of the first or second stage."""
        means = tuple(Mean.empty(self.shape, self.groups) for _ in range(self._parts(second)))
        blind = BlindSamples(*self.shape) if self.blind and not second else None
        return StageSum(means, np.zeros(self.book), self._work(), blind)

    def _parts(self, second: bool) -> int:
        """Return the number of parts of a stage; a second stage has only pixel samples."""
        return self.from_pixels if second else self.parts

    def state(self, saved: Mapping[str, NDArray[Any]] | None = None) -> RenderState:
        """Return the state of a new render, or the state saved by `arrays_of`.

        Raises
        ------
        LfmeshError
            The arrays belong to another render.
        """
        if saved is None:
            return RenderState(self.stage())

        def has(part: str) -> bool:
            return any(name.startswith(f"{part}.") for name in saved)

        second = self.stage(second=True) if has("second") else None
        partial = self.tally(second=second is not None) if has("partial") else None
        try:
            state: RenderState = filled(RenderState(self.stage(), second, partial=partial), saved)
        except ValueError as error:
            raise LfmeshError(f"the saved state belongs to another render: {error}") from None
        return state

    def _work(self) -> Work:
        return Work(np.zeros(self.counters, np.int64))


def arrays_of(value: Any, name: str = "") -> dict[str, NDArray[Any]]:
    """Return dataclasses of this file as named arrays for `np.savez`, without fields that are None."""
    if is_dataclass(value) or isinstance(value, tuple):
        found: dict[str, NDArray[Any]] = {}
        for key, each in _items(value):
            found |= arrays_of(each, f"{name}.{key}" if name else key)
        return found
    if value is None:
        return {}
    return {name: np.concatenate(value) if isinstance(value, list) and value else np.asarray(value)}


def filled(template: Any, arrays: Mapping[str, NDArray[Any]], name: str = "") -> Any:
    """Fill empty dataclasses with arrays from `arrays_of`; return them.

    Parameters
    ----------
    template : dataclass, or tuple of them
        Has the required shapes and types.
    arrays : dict of arrays
    name : str
        Prefix of the names.

    Raises
    ------
    ValueError
        The arrays do not fit the template.
    """
    if isinstance(template, tuple):
        return tuple(filled(each, arrays, f"{name}.{key}" if name else key) for key, each in _items(template))
    if is_dataclass(template):
        for key, each in _items(template):
            setattr(template, key, filled(each, arrays, f"{name}.{key}" if name else key))
        return template
    if template is None:
        return None
    try:
        array = arrays[name]
    except KeyError:
        raise ValueError(f"{name} is missing") from None
    if isinstance(template, list):
        return [array] if array.size else []
    if isinstance(template, np.ndarray):
        if (array.shape, array.dtype) != (template.shape, template.dtype):
            raise ValueError(f"{name} has another size")
        return array
    return type(template)(array.item())


def _items(value: Any) -> list[tuple[str, Any]]:
    """Return a dataclass's fields, or a tuple's members, by name."""
    if isinstance(value, tuple):
        return [(str(number), each) for number, each in enumerate(value)]
    return [(each.name, getattr(value, each.name)) for each in fields(value)]
