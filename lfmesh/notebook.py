"""What notebooks ask for: a result's key figures and picture, and the progress of a render.

`lfmesh.view` makes them when they are asked for.
"""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any


def in_notebook() -> bool:
    """Tell whether this process is a notebook's kernel, which shows pictures."""
    shell = sys.modules.get("IPython")
    running = shell.get_ipython() if shell is not None else None
    return running is not None and "IPKernelApp" in getattr(running, "config", {})


class Shown:
    """A result that notebooks show as a table of its key figures, with its picture if it has one."""

    def _repr_html_(self) -> str:
        return _results().html_of(self)


class Pictured(Shown):
    """A result that has a picture."""

    def _repr_png_(self) -> bytes:
        return _results().png_of(self)

    def figure(self) -> Any:
        """Return its picture as a figure of matplotlib, upright, with axes, unit and scale.

        Returns
        -------
        matplotlib.figure.Figure
            `figure().savefig("picture.png")` writes it.
        """
        return _results().figure_of(self)

    def show(self) -> None:
        """Show the picture: in a notebook below the cell, else in a window of matplotlib, until that is closed."""
        _results().show(self)


@contextmanager
def watched(progress: Callable[[Any], None] | bool | None) -> Iterator[Callable[[Any], None] | None]:
    """Yield what a render reports its progress to, None for nobody.

    Parameters
    ----------
    progress : callable, bool or None
        A callable is told itself; True shows a bar, False nothing, and None a bar in a notebook alone.
    """
    if callable(progress):
        yield progress
    elif in_notebook() if progress is None else progress:
        with import_module("lfmesh.view.progress").progress() as report:
            yield report
    else:
        yield None


def _results() -> Any:
    """Import the module that makes pictures: it stands above all results, and brings matplotlib."""
    return import_module("lfmesh.view.results")
