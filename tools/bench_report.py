"""Common parts of the commands of tools/bench: measuring in turns, and results as table, JSON and figure.

Contenders are measured in turns, round after round, so that whatever else the machine does meets all of them alike. A
ratio of two is the median of its rounds' ratios, each of which compares neighbours in time.
"""

import argparse
import json
import os
import platform
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

import lfmesh as lf

KIB_PER_MIB = 1024
FIGURE_SUFFIXES = (".pdf", ".png", ".svg")
COLOURS = ("#1f4e8c", "#2a7f62", "#c69214", "#b4541a", "#7a4b94", "#8c8c8c", "#3d8fb0", "#a83250")


@dataclass(frozen=True)
class Contender:
    """Something to measure.

    Attributes
    ----------
    name : str
    run : callable
        What is timed; takes what `prepare` returned.
    prepare : callable
        Called before each run, outside the clock: fresh rays for a tracer that moves them in place.
    """

    name: str
    run: Callable[[Any], Any]
    prepare: Callable[[], Any] = lambda: None


@dataclass
class Clock:
    """Times of a contender, round by round, s."""

    wall: list[float] = field(default_factory=list)
    processor: list[float] = field(default_factory=list)

    @property
    def seconds(self) -> float:
        """Median of the rounds."""
        return float(np.median(self.wall))

    @property
    def seconds_of_processor(self) -> float:
        """Median of the rounds."""
        return float(np.median(self.processor))

    @property
    def cores(self) -> float:
        """Processor time over wall-clock time: how many cores were really used."""
        return float(np.median(np.divide(self.processor, self.wall)))


def in_turns(contenders: Sequence[Contender], rounds: int) -> dict[str, Clock]:
    """Run every contender once to warm up, then once a round, every second round in reverse order."""
    clocks = {contender.name: Clock() for contender in contenders}
    for contender in contenders:
        contender.run(contender.prepare())
    for number in range(rounds):
        for contender in contenders if number % 2 == 0 else reversed(contenders):
            given = contender.prepare()
            wall, processor = time.perf_counter(), time.process_time()
            contender.run(given)
            clocks[contender.name].wall.append(time.perf_counter() - wall)
            clocks[contender.name].processor.append(time.process_time() - processor)
    return clocks


@dataclass(frozen=True)
class Ratio:
    """Ratio between two contenders: the median of the rounds, and their quartiles."""

    name: str
    value: float
    low: float
    high: float

    @classmethod
    def of(cls, name: str, faster: Sequence[float], slower: Sequence[float]) -> "Ratio":
        """Compare the seconds of two, round by round."""
        low, value, high = np.percentile(np.divide(slower, faster), (25, 50, 75))
        return cls(name, float(value), float(low), float(high))


@dataclass(frozen=True)
class Table:
    """Rows to show: `columns` gives each one's heading and format; None is shown as a dash."""

    title: str
    columns: Mapping[str, tuple[str, str]]
    rows: Sequence[Mapping[str, Any]]

    def lines(self) -> list[str]:
        """Return title, headings and rows, in columns."""
        cells = [[heading for heading, _ in self.columns.values()]]
        cells += [
            ["–" if row[key] is None else format(row[key], spec) for key, (_, spec) in self.columns.items()]
            for row in self.rows
        ]
        widths = [max(len(line[i]) for line in cells) for i in range(len(self.columns))]
        left = [not any(isinstance(row[key], int | float) for row in self.rows) for key in self.columns]
        return [self.title] + [
            "  "
            + "  ".join(
                cell.ljust(width) if is_left else cell.rjust(width)
                for cell, width, is_left in zip(line, widths, left, strict=True)
            ).rstrip()
            for line in cells
        ]


@dataclass
class Report:
    """Results of a command.

    Attributes
    ----------
    command : str
    settings : dict
        What was measured, in numbers.
    tables : dict
        By the key that holds their rows in the JSON.
    ratios : list of Ratio
    missing : dict
        Peers that could not be asked, and why.
    """

    command: str
    settings: dict[str, Any]
    tables: dict[str, Table] = field(default_factory=dict)
    ratios: list[Ratio] = field(default_factory=list)
    missing: dict[str, str] = field(default_factory=dict)

    def text(self) -> str:
        """Return the report for a terminal."""
        host = machine()
        blocks = [[f"{host['cpu']}, {host['cores']} cores, lfmesh {host['lfmesh']}"]]
        blocks += [table.lines() for table in self.tables.values()]
        if self.ratios:
            rows = [asdict(ratio) for ratio in self.ratios]
            columns = {
                "name": ("", ""),
                "value": ("median", ".3g"),
                "low": ("1st quartile", ".3g"),
                "high": ("3rd quartile", ".3g"),
            }
            blocks.append(Table("Ratios, round by round", columns, rows).lines())
        blocks += [[f"without {name}: {why}" for name, why in self.missing.items()]]
        return "\n\n".join("\n".join(block) for block in blocks if block)

    def json(self) -> str:
        """Return the report with all its digits."""
        figures = {
            "command": self.command,
            "machine": machine(),
            "settings": self.settings,
            **{key: table.rows for key, table in self.tables.items()},
            "ratios": self.ratios,
            "missing": self.missing,
        }
        return json.dumps(figures, indent=2, default=asdict) + "\n"


def machine() -> dict[str, Any]:
    """Say what the figures were measured on."""
    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.is_file():
        cpu = next((s.split(":")[1].strip() for s in info.read_text().splitlines() if s.startswith("model name")), cpu)
    return {"cpu": cpu, "cores": os.cpu_count(), "python": platform.python_version(), "lfmesh": lf.__version__}


class OneLineParser(argparse.ArgumentParser):
    """A parser that says what is wrong in one line."""

    def error(self, message: str) -> NoReturn:
        """End with the message."""
        self.exit(2, f"tools/bench: {message}; {self.prog} --help says more\n")


def peak_mib() -> float:
    """Return the most memory that this process has held."""
    status = Path("/proc/self/status")
    if status.is_file():
        # Of this program only: what `getrusage` says includes the parent, from before the child became itself.
        peak = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return int(peak.split()[1]) / KIB_PER_MIB
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / KIB_PER_MIB


def parser(command: str, description: str) -> argparse.ArgumentParser:
    """Return a parser with the options that all commands have."""
    own = OneLineParser(prog=f"tools/bench {command}", description=description)
    own.add_argument("--quick", action="store_true", help="few and small cases: to see that it works")
    own.add_argument("--json", type=writable, metavar="FILE", help="write the figures there too")
    own.add_argument("--figure", type=drawable, metavar="FILE", help="draw them: .png, .svg or .pdf")
    own.add_argument("--case", type=json.loads, help=argparse.SUPPRESS)
    return own


def writable(text: str) -> Path:
    path = Path(text)
    if path.is_dir() or not path.parent.is_dir():
        raise argparse.ArgumentTypeError(f"{text}: not a file in a folder that exists")
    return path


def drawable(text: str) -> Path:
    path = writable(text)
    if path.suffix.lower() not in FIGURE_SUFFIXES:
        raise argparse.ArgumentTypeError(f"{text}: the name must end in {', '.join(FIGURE_SUFFIXES)}")
    return path


def whole(text: str) -> int:
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{number} is not positive")
    return number


def deliver(report: Report, given: argparse.Namespace, draw: Callable[[Any], None] | None = None) -> None:
    """Print the report, and write the files that were asked for."""
    print(report.text())
    if given.json:
        given.json.write_text(report.json(), encoding="utf-8")
    if given.figure and draw is not None:
        save_figure(given.figure, draw)


def save_figure(path: Path, draw: Callable[[Any], None]) -> None:
    """Write what `draw` puts on an empty figure."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    FigureCanvasAgg(figure)
    draw(figure)
    for axes in figure.axes:
        axes.grid(alpha=0.25)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    figure.savefig(path, dpi=150)


def ask_child(script: str, case: Mapping[str, Any], threads: int | None = None) -> Any:
    """Measure a case in a process of its own and return the JSON that it printed last.

    Parameters
    ----------
    threads : int, optional
        As many are allowed to OpenMP and numba there, whose number is settled when a process starts.
    """
    limits = {} if threads is None else {"OMP_NUM_THREADS": str(threads), "NUMBA_NUM_THREADS": str(threads)}
    child = subprocess.run(
        [sys.executable, script, "--case", json.dumps(case)], stdout=subprocess.PIPE, text=True, env=os.environ | limits
    )
    if child.returncode != 0:
        sys.exit(child.returncode if child.returncode > 0 else 1)
    return json.loads(child.stdout.splitlines()[-1])


def say(what: str) -> None:
    """Tell what is being measured, beside the report."""
    print(f"  {what}", file=sys.stderr, flush=True)


def guarded(main: Callable[[], None]) -> int:
    """Run a command; a user's mistake is one line."""
    try:
        main()
    except lf.LfmeshError as error:
        print(f"tools/bench: {error}", file=sys.stderr)
        return 2
    return 0
