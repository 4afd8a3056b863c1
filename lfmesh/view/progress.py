"""Progress of a render as a bar, and of other jobs as a line of words.

Both appear on a terminal or in a notebook, otherwise as plain lines on standard error.
"""

import io
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from lfmesh.notebook import in_notebook, job

if TYPE_CHECKING:
    from rich import progress as bars

    from lfmesh.transport.render.progress import Progress


WAIT_SECONDS = 2.0
"""Time after which the progress of a job appears if nobody asked for it."""

STATUS_SECONDS = 10.0
"""Shortest time between two lines of words without a terminal."""

CELL_SECONDS = 0.2
"""Shortest time between two lines of words in a notebook."""


@contextmanager
def progress(waits: bool = False) -> Iterator[Callable[["Progress"], None]]:
    """Yield a function that shows progress: a bar on a terminal or in a notebook, otherwise occasional lines.

    On a terminal the bar may wait for two seconds.
    """
    with job():
        if in_notebook():
            with _cell() as report:
                yield report
        elif sys.stderr.isatty():
            with _bar(WAIT_SECONDS if waits else 0.0) as report:
                yield report
        else:
            yield _Lines()


@contextmanager
def status(waits: bool = False) -> Iterator[Callable[[str], None]]:
    """Yield a function that shows progress in words: a line on a terminal or in a notebook, otherwise occasional lines.

    On a terminal and in a notebook the line may wait for two seconds.
    """
    with job():
        if in_notebook():
            with _cell_line(WAIT_SECONDS if waits else 0.0) as say:
                yield say
        elif sys.stderr.isatty():
            with _line(WAIT_SECONDS if waits else 0.0) as say:
                yield say
        else:
            yield _Words()


@contextmanager
def _bar(wait_seconds: float) -> Iterator[Callable[["Progress"], None]]:
    from rich.console import Console

    bar = _rich_bar(console=Console(stderr=True), transient=True)
    task = bar.add_task("starting", total=None, rate="", left="")
    begun, shown = time.perf_counter(), wait_seconds <= 0.0

    def report(now: "Progress") -> None:
        nonlocal shown
        bar.update(task, **_told(now))
        if not shown and time.perf_counter() - begun >= wait_seconds:
            shown = True
            bar.start()

    if shown:
        bar.start()
    try:
        yield report
    finally:
        if shown:
            bar.stop()


@contextmanager
def _line(wait_seconds: float) -> Iterator[Callable[[str], None]]:
    """Yield a function that shows words in a terminal's status line."""
    from rich.console import Console
    from rich.markup import escape

    line = Console(stderr=True).status("building")
    begun, shown = time.perf_counter(), wait_seconds <= 0.0

    def say(words: str) -> None:
        nonlocal shown
        if not shown and time.perf_counter() - begun < wait_seconds:
            return
        line.update(escape(words))
        if not shown:
            shown = True
            line.start()

    if shown:
        line.start()
    try:
        yield say
    finally:
        if shown:
            line.stop()


@contextmanager
def _cell() -> Iterator[Callable[["Progress"], None]]:
    """Yield a function that shows progress below a notebook's cell, and leaves the elapsed time there.

    rich's own bar would require ipywidgets.
    """
    from IPython.display import display
    from rich.console import Console

    from lfmesh.files.words import duration

    width, begun = 100, time.perf_counter()
    bar = _rich_bar(console=Console(file=io.StringIO(), width=width, force_jupyter=False), auto_refresh=False)
    task = bar.add_task("starting", total=None, rate="", left="")
    handle = display(_Html("starting"), display_id=True)

    def report(now: "Progress") -> None:
        bar.update(task, **_told(now))
        handle.update(_Html(_html_of(bar.get_renderable(), width)))

    end = "stopped"
    try:
        yield report
        end = "traced"
    finally:
        handle.update(_Html(f"{end} after {duration(time.perf_counter() - begun)}"))


@contextmanager
def _cell_line(wait_seconds: float) -> Iterator[Callable[[str], None]]:
    """Yield a function that shows words below a notebook's cell, and leaves the elapsed time there."""
    from IPython.display import display
    from markupsafe import escape

    from lfmesh.files.words import duration

    begun, said_at = time.perf_counter(), -CELL_SECONDS
    handle: Any = None

    def say(words: str) -> None:
        nonlocal said_at, handle
        passed = time.perf_counter() - begun
        if passed < wait_seconds or passed - said_at < CELL_SECONDS:
            return
        said_at, shown = passed, _Html(escape(words), STATUS_CLASS)
        if handle is None:
            handle = display(shown, display_id=True)
        else:
            handle.update(shown)

    end = "stopped"
    try:
        yield say
        end = "done"
    finally:
        if handle is not None:
            handle.update(_Html(f"{end} after {duration(time.perf_counter() - begun)}", STATUS_CLASS))


STATUS_CLASS = "lfmesh-status"
"""Class of a notebook's line of words, which example notebooks leave out because fast machines do not show it."""


class _Html:
    """HTML text that only notebooks show."""

    def __init__(self, text: str, css_class: str = "lfmesh-progress") -> None:
        self._text, self._class = text, css_class

    def __repr__(self) -> str:
        return self._text if "<" not in self._text else ""

    def _repr_html_(self) -> str:
        return f'<span class="{self._class}" style="opacity: 0.7">{self._text}</span>'


def _html_of(shown: Any, width: int) -> str:
    """Return rich's output as HTML."""
    from rich.console import Console

    console = Console(file=io.StringIO(), record=True, width=width, force_jupyter=False, force_terminal=True)
    console.print(shown)
    return console.export_html(inline_styles=True, code_format='<pre style="margin: 0">{code}</pre>')


def _rich_bar(**settings: Any) -> "bars.Progress":
    from rich import progress as bars

    return bars.Progress(
        bars.TextColumn("{task.description}"),
        bars.BarColumn(bar_width=None),
        bars.TaskProgressColumn(),
        bars.TextColumn("{task.fields[rate]}"),
        bars.TextColumn("{task.fields[left]}"),
        **settings,
    )


def _told(now: "Progress") -> dict[str, Any]:
    """Return a report as the columns of the bar."""
    from lfmesh.files.words import count, duration

    left = now.seconds_left
    replicate = f" (replicate {min(now.replicate + 1, now.replicates)}/{now.replicates})" if now.replicates else ""
    return {
        "description": f"{now.stage}{replicate}",
        "completed": now.done,
        "total": now.total or None,
        "rate": f"{count(now.rate)} packets/s" if now.rate and now.replicates else "",
        "left": f"{duration(left)} left" if left is not None and now.replicates else "",
    }


class _Words:
    """Progress in words as plain lines, the first at once and others now and then."""

    def __init__(self) -> None:
        self._printed_at = -STATUS_SECONDS

    def __call__(self, words: str) -> None:
        if time.monotonic() - self._printed_at >= STATUS_SECONDS:
            self._printed_at = time.monotonic()
            print(words, file=sys.stderr, flush=True)


class _Lines:
    """Progress as plain lines, at most one per tenth of the work and per two seconds."""

    STEPS = 10
    SECONDS = 2.0

    def __init__(self) -> None:
        self._stage = "tracing"
        self._step = 0
        self._printed_at = 0.0

    def __call__(self, now: "Progress") -> None:
        from lfmesh.files.words import count, duration

        step, percent = (n * now.done // now.total if now.total else 0 for n in (self.STEPS, 100))
        if now.stage != self._stage:
            self._stage, self._step = now.stage, 0
        elif step <= self._step or (now.seconds - self._printed_at < self.SECONDS and now.done < now.total):
            return
        self._step, self._printed_at = step, now.seconds
        line = f"{now.stage}: {percent} %"
        if now.replicates:
            line += f", {count(now.rate)} packets/s"
        if now.replicates and now.seconds_left:
            line += f", {duration(now.seconds_left)} left"
        print(line, file=sys.stderr, flush=True)
