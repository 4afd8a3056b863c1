"""Tallies: the results of a render's replicates, and their running sum.

The flow is chunk → tally of a replicate → sum of a stage → state of the render → image. All of it is numbers and numpy
arrays, which can be pickled, and saved and loaded with `arrays_of` and `filled`. Every sum is folded in a fixed order,
chunk by chunk and replicate by replicate, so that the result does not depend on which process traced what and when.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.transport.render.blind_check import BlindSamples

Array = NDArray[np.float64]
Shape = tuple[int, int, int]
"""Rows and columns of the sensor, and wavelengths."""


@dataclass
class Film:
    """The light of one replicate, or of a block of its pixels.

    Attributes
    ----------
    power : (pixels, wavelengths) float64, W
    hits : (pixels, wavelengths) uint32
        Number of samples that brought light; forward: of packets.
    origin : int
        Number of the pixel in the first row.
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

    def deposit(self, fallen: NDArray[np.void]) -> None:
        """Add packets that fell on pixels: fields pixel, colour and weight, W."""
        np.add.at(self.power, (fallen["pixel"], fallen["colour"]), fallen["weight"])
        np.add.at(self.hits, (fallen["pixel"], fallen["colour"]), np.uint32(1))

    def part(self, first: int, last: int) -> "Film":
        """Return a copy of the pixels from number `first` up to `last`, not included."""
        rows = slice(first - self.origin, last - self.origin)
        return Film(self.power[rows].copy(), self.hits[rows].copy(), first)


@dataclass
class Work:
    """Counts and times of the work done.

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
    """Result of one chunk, apart from the light that it added to a film.

    Attributes
    ----------
    number : int
        Number of the chunk in its replicate.
    book : (BOOKS, slots) float64
        Entries of the books.
    work : Work
    deposits : (n,) DEPOSIT
        Packets traced forward that fell on pixels.
    from_lamps : bool
        Whether the deposits are packets of particles or, in the adjoint method, lamps' own.
    """

    number: int
    book: Array
    work: Work
    deposits: NDArray[np.void]
    from_lamps: bool = False


@dataclass
class Piece:
    """A block's share of a replicate, not yet folded, as chunks of other blocks may come in between.

    Attributes
    ----------
    replicate : int
    film : Film
        The block's pixels, without deposits.
    chunks : list of ChunkTally
        Chunks that begin in the block.
    blind : BlindSamples or None
    """

    replicate: int
    film: Film
    chunks: list[ChunkTally]
    blind: BlindSamples | None = None


def joined(pieces: Sequence[Piece]) -> Piece:
    """Return neighbouring pieces of a replicate as one; that adds nothing up, so that the bits are the same.

    Parameters
    ----------
    pieces : sequence of Piece
        In the order of their pixels.
    """
    films = [piece.film for piece in pieces]
    film = Film(
        np.concatenate([film.power for film in films]), np.concatenate([film.hits for film in films]), films[0].origin
    )
    chunks = [chunk for piece in pieces for chunk in piece.chunks]
    blind = next((piece.blind for piece in pieces if piece.blind is not None), None)
    return Piece(pieces[0].replicate, film, chunks, blind)


@dataclass
class Tally:
    """Result of one replicate.

    Attributes
    ----------
    replicate : int
    film : Film
        Film of all pixels.
    lamps : Film or None
        Light of lamps' own packets and of particles, kept separate: it is not weighted with the pixels' number of
        samples.
    book : (BOOKS, slots) float64
    work : Work
    blind : BlindSamples or None
        Samples that are not aimed, by which the image is checked.
    """

    replicate: int
    film: Film
    lamps: Film | None
    book: Array
    work: Work
    blind: BlindSamples | None = None

    def restart(self, replicate: int) -> None:
        """Clear the tally for another replicate, in the same memory."""
        self.replicate = replicate
        for film in (self.film, self.lamps):
            if film is not None:
                film.clear()
        self.book[:] = 0.0
        self.work = Work(np.zeros_like(self.work.counts))
        self.blind = None

    def add(self, chunk: ChunkTally) -> None:
        """Add the next chunk, whose light from pixels is already on the film."""
        self.book += chunk.book
        self.work.add(chunk.work)
        film = self.lamps if chunk.from_lamps and self.lamps is not None else self.film
        film.deposit(chunk.deposits)

    def merge(self, pieces: Iterable[Piece]) -> None:
        """Fold the pieces of the tally's replicate, given in any order, to the same bits as in a single process.

        Raises
        ------
        ValueError
            The pieces do not make up this replicate: a pixel or chunk is missing or given twice.
        """
        chunks: list[ChunkTally] = []
        covered = np.zeros(len(self.film.power), np.uint8)
        for piece in pieces:
            if piece.replicate != self.replicate:
                raise ValueError(f"a piece of replicate {piece.replicate} does not belong to {self.replicate}")
            rows = slice(piece.film.origin, piece.film.origin + len(piece.film.power))
            covered[rows] += 1
            self.film.power[rows] = piece.film.power
            self.film.hits[rows] = piece.film.hits
            chunks += piece.chunks
            self.blind = piece.blind if piece.blind is not None else self.blind
        chunks.sort(key=lambda chunk: chunk.number)
        if (covered != 1).any() or [chunk.number for chunk in chunks] != list(range(len(chunks))):
            raise ValueError(f"the pieces do not make up replicate {self.replicate}: some are missing or there twice")
        for chunk in chunks:
            self.add(chunk)


@dataclass
class Mean:
    """Running mean and sum of squared deviations over replicates (Welford 1962), with the sum of their hits."""

    mean: Array
    squares: Array
    hits: NDArray[np.uint32]
    count: int = 0
    final: bool = False
    """Whether `squares` has become the variance."""

    @classmethod
    def empty(cls, shape: Shape) -> "Mean":
        """Return the mean over no replicates."""
        return cls(np.zeros(shape), np.zeros(shape), np.zeros(shape, np.uint32))

    def add(self, film: Film) -> None:
        """Add one replicate's film."""
        self.count += 1
        self.hits += film.hits.reshape(self.hits.shape)
        # Row by row, to avoid temporary arrays of the size of the film, which may be large.
        sample = film.power.reshape(self.mean.shape)
        for mean, squares, row in zip(self.mean, self.squares, sample, strict=True):
            change = row - mean
            mean += change / self.count
            squares += change * (row - mean)

    def variance(self) -> Array:
        """Return the variance of the mean, in place of `squares`; NaN from fewer than two replicates."""
        if not self.final:
            self.squares /= self.count * (self.count - 1) if self.count > 1 else np.nan
            self.final = True
        return self.squares


@dataclass
class StageSum:
    """The sum over the replicates of a stage so far.

    Attributes
    ----------
    mean : Mean
    lamps : Mean or None
        Mean of the light of lamps' own packets and of particles.
    book : (BOOKS, slots) float64
    work : Work
    blind : BlindSamples or None
    """

    mean: Mean
    lamps: Mean | None
    book: Array
    work: Work
    blind: BlindSamples | None = None

    @property
    def count(self) -> int:
        """Replicates summed."""
        return self.mean.count

    def add(self, tally: Tally) -> None:
        """Add the next replicate."""
        self.mean.add(tally.film)
        if self.lamps is not None and tally.lamps is not None:
            self.lamps.add(tally.lamps)
        self.book += tally.book
        self.work.add(tally.work)
        if self.blind is not None and tally.blind is not None:
            self.blind.join(tally.blind)


@dataclass
class RenderState:
    """State of a render: all that is needed to continue it.

    Attributes
    ----------
    first : StageSum
    second : StageSum or None
        Second stage, of adaptive sampling, once the first is complete.
    seconds : float
        Wall-clock time spent.
    """

    first: StageSum
    second: StageSum | None = None
    seconds: float = 0.0


@dataclass(frozen=True)
class Layout:
    """Sizes of all sums of a render.

    Attributes
    ----------
    shape : (rows, columns, wavelengths)
    book : (books, slots)
    counters : int
    lamps, blind : bool
        Whether lamps' own packets are kept separate, and whether the image is checked by samples without aim.
    """

    shape: Shape
    book: tuple[int, int]
    counters: int
    lamps: bool = False
    blind: bool = False

    def tally(self) -> Tally:
        """Return an empty tally."""
        pixels, colours = self.shape[0] * self.shape[1], self.shape[2]
        lamps = Film.empty(pixels, colours) if self.lamps else None
        return Tally(0, Film.empty(pixels, colours), lamps, np.zeros(self.book), self._work())

    def first(self) -> StageSum:
        """Return the sum of a first stage that has not begun."""
        lamps = Mean.empty(self.shape) if self.lamps else None
        blind = BlindSamples(*self.shape) if self.blind else None
        return StageSum(Mean.empty(self.shape), lamps, np.zeros(self.book), self._work(), blind)

    def second(self) -> StageSum:
        """Return the sum of a second stage that has not begun; it has no packets of lamps."""
        return StageSum(Mean.empty(self.shape), None, np.zeros(self.book), self._work())

    def state(self, saved: Mapping[str, NDArray[Any]] | None = None) -> RenderState:
        """Return the state of a render that has not begun, or the state that was saved by `arrays_of`.

        Raises
        ------
        LfmeshError
            The arrays belong to another render.
        """
        if saved is None:
            return RenderState(self.first())
        second = self.second() if any(name.startswith("second.") for name in saved) else None
        try:
            state: RenderState = filled(RenderState(self.first(), second), saved)
        except ValueError as error:
            raise LfmeshError(f"the state that was saved is not that of this scene's render: {error}") from None
        return state

    def _work(self) -> Work:
        return Work(np.zeros(self.counters, np.int64))


def arrays_of(value: Any, name: str = "") -> dict[str, NDArray[Any]]:
    """Return a dataclass of this file as named arrays, as `np.savez` takes them; fields that are None are left out."""
    if is_dataclass(value):
        found: dict[str, NDArray[Any]] = {}
        for each in fields(value):
            found |= arrays_of(getattr(value, each.name), f"{name}.{each.name}" if name else each.name)
        return found
    if value is None:
        return {}
    return {name: np.concatenate(value) if isinstance(value, list) and value else np.asarray(value)}


def filled(template: Any, arrays: Mapping[str, NDArray[Any]], name: str = "") -> Any:
    """Fill an empty dataclass with arrays from `arrays_of`, and return it.

    Parameters
    ----------
    template : dataclass
        Has the shapes and types that the arrays must have.
    arrays : dict of arrays
    name : str
        Prefix of the names.

    Raises
    ------
    ValueError
        The arrays do not fit the template.
    """
    if is_dataclass(template):
        for each in fields(template):
            inner = f"{name}.{each.name}" if name else each.name
            setattr(template, each.name, filled(getattr(template, each.name), arrays, inner))
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
