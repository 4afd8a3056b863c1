"""Progress of a render: a bar on a terminal or in a notebook, otherwise plain lines on standard error."""

import io
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from lfmesh.notebook import in_notebook

if TYPE_CHECKING:
    from rich import progress as bars

    from lfmesh.transport.render.progress import Progress


@contextmanager
def progress() -> Iterator[Callable[["Progress"], None]]:
    """Yield a function that shows progress: a bar on a terminal or in a notebook, otherwise occasional lines."""
    if in_notebook():
        with _cell() as report:
            yield report
    elif sys.stderr.isatty():
        with _bar() as report:
            yield report
    else:
        yield _Lines()


@contextmanager
def _bar() -> Iterator[Callable[["Progress"], None]]:
    from rich.console import Console

    with _rich_bar(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("starting", total=None, rate="", left="")
        yield lambda now: bar.update(task, **_told(now))


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


class _Html:
    """HTML text that only notebooks show."""

    def __init__(self, text: str) -> None:
        self._text = text

    def __repr__(self) -> str:
        return self._text if "<" not in self._text else ""

    def _repr_html_(self) -> str:
        return f'<span style="opacity: 0.7">{self._text}</span>'


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
