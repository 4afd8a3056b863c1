"""Packet sources, and the launcher that traces them through a world, chunk by chunk.

Callers that trace packets (a render, `lf.trace`, the viewer, true depth) give a source to a launcher. A new source is a
class with two methods.
"""

import os
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from typing import TypeVar

from lfmesh.transport.engine import CHUNK, FilmRows, Workspace
from lfmesh.transport.threads import Threads

T = TypeVar("T")


class Source(ABC):
    """Sequence of items that start packets: pixels, rays, or numbers of a light's packets."""

    @property
    def each(self) -> int:
        """Number of packets per item."""
        return 1

    @abstractmethod
    def __len__(self) -> int:
        """Return the number of items."""

    @abstractmethod
    def launch(self, work: Workspace, part: range) -> None:
        """Queue the packets of some items in a workspace.

        Parameters
        ----------
        work : Workspace
            Has room for the packets, and keeps the launch's working memory, see `Workspace.kept`.
        part : range
            Range of items.
        """

    def parts(self, chunk: int = CHUNK) -> Iterator[range]:
        """Yield ranges of items that start about `chunk` packets each, without dividing items."""
        step = max(1, chunk // self.each)
        for first in range(0, len(self), step):
            yield range(first, min(first + step, len(self)))

    def pieces(self, chunk: int) -> "Iterator[Source]":
        """Yield sources of the same items that together start their packets, each some of every item's.

        Sources whose items may each start more than `chunk` packets override this.
        """
        yield self


class Launcher:
    """Tracer of sources; each thread has its own workspace.

    Parameters
    ----------
    workspace : callable
        Returns a new workspace.
    """

    def __init__(self, workspace: Callable[[], Workspace]) -> None:
        self._new = workspace
        self._own = threading.local()

    @property
    def workspace(self) -> Workspace:
        """The calling thread's workspace."""
        if not hasattr(self._own, "workspace"):
            self._own.workspace = self._new()
        work: Workspace = self._own.workspace
        return work

    def trace(self, source: Source, part: range | None = None, film: FilmRows | None = None) -> Workspace:
        """Trace the packets of a source, or a part of it; return the workspace with the results.

        Parameters
        ----------
        source, part, film
            See `launches`.
        """
        for work in self.launches(source, part, film):
            work.run()
        return self.workspace

    def launches(self, source: Source, part: range | None = None, film: FilmRows | None = None) -> Iterator[Workspace]:
        """Queue the packets of a source, or a part of it; yield the workspace, ready to run, for each of its pieces.

        Parameters
        ----------
        source : Source
        part : range, optional
            Range of the source's items.
        film : FilmRows, optional
            Adjoint: film that receives the light.
        """
        work, part = self.workspace, range(len(source)) if part is None else part
        pieces = list(source.pieces(work.chunk))
        work.begin(film, len(part) * max(piece.each for piece in pieces), len(part) * source.each)
        for piece in pieces:
            piece.launch(work, part)
            if work.options.record:
                work.record_starts()
            yield work

    def traced(
        self, source: Source, keep: Callable[[Workspace, range], T], threads: int = 0, chunk: int = CHUNK
    ) -> list[T]:
        """Trace a source chunk by chunk in a thread pool; return the chunks' results in order.

        Parameters
        ----------
        source : Source
        keep : callable
            Called with the workspace and item range of each chunk, in the thread that traced it; returns the result to
            keep.
        threads : int
            Number of threads; 0: one per processor.
        chunk : int
            Number of packets started together.
        """
        parts = list(source.parts(chunk))
        if len(parts) == 1:
            # Starting a thread takes longer than tracing a few rays.
            return [keep(self.trace(source, parts[0]), parts[0])]
        with Threads(threads or os.cpu_count() or 1) as pool:
            return list(pool.map(lambda part: keep(self.trace(source, part), part), parts))
