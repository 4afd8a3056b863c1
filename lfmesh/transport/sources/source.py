"""A source of packets, and the launcher that drives any of them through a world, chunk by chunk.

Whoever wants packets traced makes a source and hands it to a launcher: a render, `lf.trace`, the viewer's rays, true
depth. A new source is a class with two methods.
"""

import os
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from lfmesh.transport.engine import CHUNK, FilmRows, Workspace

T = TypeVar("T")


class Source(ABC):
    """What packets start from, one thing after the other: pixels, given rays, or numbers of a light's packets."""

    @property
    def each(self) -> int:
        """Packets that start from one of the things."""
        return 1

    @abstractmethod
    def __len__(self) -> int:
        """Return how many things packets start from."""

    @abstractmethod
    def launch(self, work: Workspace, part: range) -> None:
        """Put the packets of some of the things on the stacks of a workspace.

        Parameters
        ----------
        work : Workspace
            Has room for them. Working memory of the launch is kept there, see `Workspace.kept`.
        part : range
            Of the things.
        """

    def parts(self, chunk: int = CHUNK) -> Iterator[range]:
        """Yield the things in parts that start about `chunk` packets; one thing is never taken apart."""
        step = max(1, chunk // self.each)
        for first in range(0, len(self), step):
            yield range(first, min(first + step, len(self)))


class Launcher:
    """Traces the packets of sources, in a workspace of each thread.

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
        """The calling thread's."""
        if not hasattr(self._own, "workspace"):
            self._own.workspace = self._new()
        work: Workspace = self._own.workspace
        return work

    def trace(self, source: Source, part: range | None = None, film: FilmRows | None = None) -> Workspace:
        """Trace a part of a source, or all of it, until no packet is left, and return the workspace with what it wrote.

        Parameters
        ----------
        source : Source
        part : range, optional
        film : FilmRows, optional
            Adjoint: what light is added to.
        """
        work, part = self.workspace, range(len(source)) if part is None else part
        work.begin(film, len(part) * source.each)
        source.launch(work, part)
        if work.options.record:
            work.record_starts()
        work.run()
        return work

    def traced(
        self, source: Source, keep: Callable[[Workspace, range], T], threads: int = 0, chunk: int = CHUNK
    ) -> list[T]:
        """Trace a source in chunks in a pool of threads; return what is kept of each, in their order.

        Parameters
        ----------
        source : Source
        keep : callable
            Returns what is wanted of the workspace in which a part was traced. It is called in the thread that traced.
        threads : int
            0: as many as there are processors.
        chunk : int
            Packets that are started together.
        """
        with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
            return list(pool.map(lambda part: keep(self.trace(source, part), part), source.parts(chunk)))
