"""Progress on standard error: a bar or a status line on a terminal, elsewhere plain lines."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lfmesh.transport.render.progress import Progress

STATUS_SECONDS = 10.0
"""Where there is no terminal, what is being done is said no more often."""


@contextmanager
def status() -> Iterator[Callable[[str], None]]:
    """Yield a function that prints what is being done: on a terminal in one status line, elsewhere now and then."""
    from rich.console import Console

    errors = Console(stderr=True)
    if errors.is_terminal:
        with errors.status("building") as line:
            yield line.update
        return
    printed_at = -STATUS_SECONDS

    def say(text: str) -> None:
        nonlocal printed_at
        if time.monotonic() - printed_at >= STATUS_SECONDS:
            printed_at = time.monotonic()
            print(text, file=sys.stderr, flush=True)

    yield say


@contextmanager
def progress() -> Iterator[Callable[["Progress"], None]]:
    """Yield a function that shows progress: a bar on a terminal, elsewhere a line now and then."""
    if sys.stderr.isatty():
        with _bar() as report:
            yield report
    else:
        yield _Lines()


@contextmanager
def _bar() -> Iterator[Callable[["Progress"], None]]:
    from rich import progress as bars
    from rich.console import Console

    from lfmesh.files.words import count, duration

    columns = (
        bars.TextColumn("{task.description}"),
        bars.BarColumn(bar_width=None),
        bars.TaskProgressColumn(),
        bars.TextColumn("{task.fields[rate]}"),
        bars.TextColumn("{task.fields[left]}"),
    )
    with bars.Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("starting", total=None, rate="", left="")

        def report(now: "Progress") -> None:
            left = now.seconds_left
            replicate = min(now.replicate + 1, now.replicates)
            bar.update(
                task,
                description=f"{now.stage} (replicate {replicate}/{now.replicates})",
                completed=now.done,
                total=now.total or None,
                rate=f"{count(now.rate)} packets/s" if now.rate else "",
                left=f"{duration(left)} left" if left is not None else "",
            )

        yield report


class _Lines:
    """Progress as plain lines, at most one every tenth of the work and every two seconds."""

    STEPS = 10
    SECONDS = 2.0

    def __init__(self) -> None:
        self._step = 0
        self._printed_at = 0.0

    def __call__(self, now: "Progress") -> None:
        from lfmesh.files.words import count, duration

        step = self.STEPS * now.done // now.total if now.total else 0
        if step <= self._step or (now.seconds - self._printed_at < self.SECONDS and now.done < now.total):
            return
        self._step, self._printed_at = step, now.seconds
        line = f"{now.stage}: {100 * now.done // now.total} %, {count(now.rate)} packets/s"
        if now.seconds_left:
            line += f", {duration(now.seconds_left)} left"
        print(line, file=sys.stderr, flush=True)
