"""Progress of jobs: shown to somebody who watches, after two seconds, once, and by no worker."""

import io
import re
import sys
import threading
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from lfmesh import notebook
from lfmesh.view import progress


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> Terminal:
    """Standard error as a terminal, from the test's first line on: pytest sets it anew after its fixtures."""
    shown, test = Terminal(), request.node.obj

    def at_terminal(**arguments: Any) -> None:
        with monkeypatch.context() as during:
            during.setattr(sys, "stderr", shown)
            test(**arguments)

    monkeypatch.setattr(request.node, "obj", at_terminal)
    monkeypatch.setenv("TERM", "xterm")
    return shown


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """Let time pass for the progress alone."""
    now = [100.0]
    monkeypatch.setattr(progress, "time", SimpleNamespace(perf_counter=lambda: now[0], monotonic=lambda: now[0]))

    def passes(seconds: float) -> None:
        now[0] += seconds

    return passes


@pytest.fixture
def cell(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """A notebook, and what is displayed below its cell."""
    pytest.importorskip("IPython")
    shown: list[str] = []

    def display(content: Any, **_: Any) -> Any:
        shown.append(content._repr_html_())
        return SimpleNamespace(update=lambda content: shown.append(content._repr_html_()))

    monkeypatch.setattr("IPython.display.display", display)
    for module in (notebook, progress):
        monkeypatch.setattr(module, "in_notebook", lambda: True)
    return shown


def test_a_job_at_a_terminal_shows_its_words_after_two_seconds(
    terminal: Terminal, clock: Callable[[float], None]
) -> None:
    with notebook.announced(None) as say:
        say("first [step]")
        clock(1.5)
        say("second step")
        assert terminal.getvalue() == ""
        clock(1.0)
        say("third [step]")
    assert "third [step]" in terminal.getvalue(), "brackets are no markup"
    assert "second" not in terminal.getvalue()


def test_a_short_job_says_nothing_unless_it_is_asked(terminal: Terminal, clock: Callable[[float], None]) -> None:
    with notebook.announced(None) as say:
        say("a step")
    assert terminal.getvalue() == ""
    with notebook.announced(False) as say:
        clock(100.0)
        say("a step")
    assert terminal.getvalue() == ""
    with notebook.announced(True) as say:
        say("a step")
    assert terminal.getvalue() != ""


def test_a_render_at_a_terminal_shows_a_bar_after_two_seconds(
    terminal: Terminal, clock: Callable[[float], None]
) -> None:
    from lfmesh.transport.render.progress import Progress

    with notebook.watched(None) as report:
        assert report is not None
        report(Progress(10, 100, 1.0, 0, 4, "tracing"))
        assert terminal.getvalue() == ""
        clock(3.0)
        report(Progress(50, 100, 3.0, 2, 4, "tracing"))
    assert "tracing (replicate 3/4)" in terminal.getvalue()


def test_without_a_terminal_nothing_is_shown_unless_it_is_asked(capsys: pytest.CaptureFixture[str]) -> None:
    with notebook.announced(None) as say:
        say("a step")
    assert capsys.readouterr().err == ""
    with notebook.announced(True) as say:
        say("a step")
        say("another step, too soon for a line")
    assert capsys.readouterr().err == "a step\n"


def test_in_a_notebook_the_words_end_as_the_time(cell: list[str], clock: Callable[[float], None]) -> None:
    with notebook.announced(None) as say:
        say("a <b> step")
        clock(3.0)
        say("a <b> step")
        say("another, too soon")
    assert len(cell) == 2
    assert "a &lt;b&gt; step" in cell[0]
    assert re.search(r">done after 3\.0 s<", cell[1])
    assert all(progress.STATUS_CLASS in each for each in cell)
    with pytest.raises(KeyboardInterrupt):
        _interrupted()
    assert ">stopped after" in cell[-1]


def _interrupted() -> None:
    with notebook.announced(True) as say:
        say("a step")
        raise KeyboardInterrupt


def test_a_job_inside_another_is_silent(terminal: Terminal, clock: Callable[[float], None]) -> None:
    """Also inside one with a function of its own, or that is to be silent."""
    heard: list[str] = []
    for outer in (heard.append, False):
        with notebook.announced(outer), notebook.watched(None) as report, notebook.announced(None) as say:
            assert report is None
            clock(10.0)
            say("inside")
    assert (heard, terminal.getvalue()) == ([], "")
    with progress.status(), notebook.watched(None) as report:
        assert report is None, "as on the command line"
    assert notebook.is_watched()


def test_threads_and_worker_processes_are_silent(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    assert notebook.is_watched()
    told: list[bool] = []
    thread = threading.Thread(target=lambda: told.append(notebook.is_watched()))
    thread.start()
    thread.join()
    monkeypatch.setattr("multiprocessing.parent_process", lambda: "the one that started this")
    assert [*told, notebook.is_watched()] == [False, False]
    assert terminal.isatty()
