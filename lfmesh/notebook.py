"""Display of results and progress in notebooks: key figures, pictures, bars.

The display code imports all result classes and matplotlib; `show_by` registers it.
"""

import sys
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
        Returns the module for the progress of a render.
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


@contextmanager
def watched(progress: Callable[[Any], None] | bool | None) -> Iterator[Callable[[Any], None] | None]:
    """Yield the function that receives a render's progress, or None.

    Parameters
    ----------
    progress : callable, bool or None
        A callable is used itself. True shows a bar, False nothing, and None a bar only in a notebook.
    """
    if callable(progress):
        yield progress
    elif in_notebook() if progress is None else progress:
        with _shown_by["progress"]().progress() as report:
            yield report
    else:
        yield None
