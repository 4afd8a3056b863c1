"""Display of results and progress in notebooks: key figures, pictures, bars.

The display code imports all result classes and matplotlib; `show_by` registers it.
"""

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

_shown_by: dict[str, Callable[[], Any]] = {}


def show_by(results: Callable[[], Any], progress: Callable[[], Any]) -> None:
    """Register the modules that display results and progress.

    Parameters
    ----------
    results : callable
        Returns the module for tables and pictures, when first needed.
    progress : callable
        Returns the module for the progress of renders and other jobs.
    """
    _shown_by.update(results=results, progress=progress)


def in_notebook() -> bool:
    """Tell whether this process is a notebook's kernel."""
    shell = sys.modules.get("IPython")
    running = shell.get_ipython() if shell is not None else None
    return running is not None and "IPKernelApp" in getattr(running, "config", {})


class Shown:
    """A result that notebooks show as a table of key figures, with its picture if any."""

    def _repr_html_(self) -> str:
        return _shown_by["results"]().html_of(self)


class Pictured(Shown):
    """A result with a picture."""

    def _repr_png_(self) -> bytes:
        return _shown_by["results"]().png_of(self)

    def figure(self) -> Any:
        """Return the picture as a matplotlib figure, upright, with axes, unit and scale.

        Returns
        -------
        matplotlib.figure.Figure
            `figure().savefig("picture.png")` writes it.
        """
        return _shown_by["results"]().figure_of(self)

    def show(self) -> None:
        """Show the picture: in a notebook below the cell, otherwise in a matplotlib window, until it is closed."""
        _shown_by["results"]().show(self)


Say = Callable[[str], None]

_jobs = threading.local()


def is_watched() -> bool:
    """Tell whether somebody in a notebook or at a terminal watches a job that begins now, unless it is part of another.

    Jobs of worker processes and threads are parts of others.
    """
    from multiprocessing import parent_process

    if getattr(_jobs, "number", 0) or threading.current_thread() is not threading.main_thread():
        return False
    if in_notebook():
        return True
    return parent_process() is None and sys.stderr is not None and sys.stderr.isatty()


@contextmanager
def job() -> Iterator[None]:
    """Mark a job in this thread, inside which no other shows its progress without being asked."""
    _jobs.number = getattr(_jobs, "number", 0) + 1
    try:
        yield
    finally:
        _jobs.number -= 1


@contextmanager
def watched(progress: Callable[[Any], None] | bool | None) -> Iterator[Callable[[Any], None] | None]:
    """Yield the function that receives a render's progress, or None.

    Parameters
    ----------
    progress : callable, bool or None
        A callable is used itself. True shows a bar, False nothing, and None a bar in a notebook, or at a terminal if
        the render takes more than two seconds.
    """
    shows = is_watched() if progress is None else progress
    with job():
        if callable(progress):
            yield progress
        elif shows:
            with _shown_by["progress"]().progress(waits=progress is None) as report:
                yield report
        else:
            yield None


def silent(_: str) -> None:
    """Say nothing."""


@contextmanager
def announced(progress: Say | bool | None) -> Iterator[Say]:
    """Yield the function that receives a job's progress in words.

    Parameters
    ----------
    progress : callable, bool or None
        A callable is used itself. True shows a line, False nothing, and None a line in a notebook or at a terminal if
        the job takes more than two seconds.
    """
    shows = is_watched() if progress is None else progress
    with job():
        if callable(progress):
            yield progress
        elif shows:
            with _shown_by["progress"]().status(waits=progress is None) as say:
                yield say
        else:
            yield silent
