"""Sources of packets, and the launcher that traces any of them through a world, chunk by chunk.

Every caller that traces packets (a render, `lf.trace`, the viewer, true depth) makes a source and gives it to a
launcher. A new source is a class with two methods.
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
    """A sequence of items that packets start from: pixels, given rays, or numbers of a light's packets."""

    @property
    def each(self) -> int:
        """Number of packets that start from one item."""
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
            Has room for the packets, and keeps working memory of the launch, see `Workspace.kept`.
        part : range
            Of the items.
        """

    def parts(self, chunk: int = CHUNK) -> Iterator[range]:
        """Yield the items in ranges that start about `chunk` packets each; one item is never divided."""
        step = max(1, chunk // self.each)
        for first in range(0, len(self), step):
            yield range(first, min(first + step, len(self)))


class Launcher:
    """Traces the packets of sources; each thread has its own workspace.

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
        """Trace all packets of a source, or of a part of it, to their ends; return the workspace with the results.

        Parameters
        ----------
        source, part, film
            See `launch`.
        """
        work = self.launch(source, part, film)
        work.run()
        return work

    def launch(self, source: Source, part: range | None = None, film: FilmRows | None = None) -> Workspace:
        """Queue all packets of a source, or of a part of it; return the workspace, ready to run.

        Parameters
        ----------
        source : Source
        part : range, optional
            Of the source's items.
        film : FilmRows, optional
            Adjoint: film that light is added to.
        """
        work, part = self.workspace, range(len(source)) if part is None else part
        work.begin(film, len(part) * source.each)
        source.launch(work, part)
        if work.options.record:
            work.record_starts()
        return work

    def traced(
        self, source: Source, keep: Callable[[Workspace, range], T], threads: int = 0, chunk: int = CHUNK
    ) -> list[T]:
        """Trace a source chunk by chunk in a pool of threads; return the result of each chunk, in order.

        Parameters
        ----------
        source : Source
        keep : callable
            Called with the workspace and the range of items of each chunk, in the thread that traced it; returns the
            result to keep.
        threads : int
            0: one for each processor.
        chunk : int
            Number of packets that are started together.
        """
        parts = list(source.parts(chunk))
        if len(parts) == 1:
            # To start a thread takes longer than to trace a few rays.
            return [keep(self.trace(source, parts[0]), parts[0])]
        with Threads(threads or os.cpu_count() or 1) as pool:
            return list(pool.map(lambda part: keep(self.trace(source, part), part), parts))
