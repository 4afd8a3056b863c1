"""Verdict on each line of an imported file: taken, approximated, without effect, unknown or refused."""

import math
import warnings
from collections import Counter
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path

from lfmesh.errors import LensFileWarning, SceneError
from lfmesh.imports.conditions import Conditions

_MOST_SHOWN = 60
"""Characters of a line that a message quotes."""

_MOST_FAULTS = 20


class Verdict(Enum):
    """Verdict on a line."""

    TAKEN = "taken"
    APPROXIMATED = "approximated"
    WITHOUT_EFFECT = "without effect"
    """It does not change where light goes: names, merit functions, colours of drawings."""
    UNKNOWN = "unknown"
    """A command that this reader does not know: the lens is made without it."""
    REFUSED = "refused"
    """It changes the image in a way that the lens cannot have."""


_BY_WEIGHT = (Verdict.WITHOUT_EFFECT, Verdict.TAKEN, Verdict.APPROXIMATED, Verdict.UNKNOWN, Verdict.REFUSED)
"""Verdicts on one line: a later one outweighs an earlier one."""

OTHER_AIR = Verdict.APPROXIMATED, "indices are those of the catalogue, at its own temperature and pressure"
"""Verdict on a temperature or pressure that is not the catalogues'."""


@dataclass(frozen=True)
class Line:
    """A line of the file, a command on it, or a part of a file without lines, and what became of it."""

    number: int
    """From 1; 0 in a file without lines."""
    text: str
    verdict: Verdict
    how: str = ""

    def joined(self, other: "Line") -> "Line":
        """Return the line with the weightier of its verdict and another's, and that one's reasons."""
        if self.verdict is not other.verdict:
            return max(self, other, key=lambda line: _BY_WEIGHT.index(line.verdict))
        told = [self.how] if other.how in self.how else [self.how, other.how]
        return replace(self, how="; ".join(filter(None, told)))

    def __str__(self) -> str:
        return f"{self.place}: {self.verdict.value}{f': {self.how}' if self.how else ''}"

    @property
    def place(self) -> str:
        """Place of the line, and its text."""
        return f"line {self.number}: {_cut(self.text)}" if self.number else _cut(self.text)


@dataclass
class Report:
    """Verdicts on the lines of one file.

    Attributes
    ----------
    path : Path
        The file.
    lines : list of Line
        In the order of reading, each with the weightiest of its verdicts.
    notes : list of str
        What the file says beside the lens: wavelengths, fields, where the object and the image are.
    focal_length_mm : float
        Of the lens, at the file's primary wavelength; NaN until it is made.
    conditions : Conditions, optional
        In which the file uses its lens; None until it is made.
    """

    path: Path
    lines: list[Line] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    focal_length_mm: float = math.nan
    conditions: Conditions | None = None
    _places: dict[tuple[int, str], int] = field(default_factory=dict, repr=False, compare=False)

    def add(self, number: int, text: str, verdict: Verdict, how: str = "") -> None:
        """Enter what became of a line; a line that stands here already keeps the weightier verdict.

        A part of a file without lines may stand here several times, once for each of its properties.

        Parameters
        ----------
        number : int
            From 1; 0 in a file without lines.
        text : str
            The line, or the command on it.
        verdict : Verdict
        how : str
            What was done with it, or why nothing was.
        """
        line = Line(number, text, verdict, how)
        place = self._places.setdefault((number, text), len(self.lines)) if number else len(self.lines)
        if place < len(self.lines):
            self.lines[place] = self.lines[place].joined(line)
        else:
            self.lines.append(line)

    def refuse(self, number: int, text: str, why: str) -> None:
        """Enter a line that makes the file unusable; `raise_refusals` speaks of all of them at once.

        Parameters
        ----------
        number : int
            From 1.
        text : str
            The line, or the command on it.
        why : str
            What the lens cannot have.
        """
        self.add(number, text, Verdict.REFUSED, why)

    def of(self, verdict: Verdict) -> list[Line]:
        """Return the lines with one verdict."""
        return [line for line in self.lines if line.verdict is verdict]

    def raise_refusals(self) -> None:
        """Raise a SceneError that names every refused line, if there is one."""
        refused = [f"{line.place}: {line.how}" for line in self.of(Verdict.REFUSED)]
        if len(refused) == 1:
            raise SceneError(f"{self.path}: {refused[0]}")
        if refused:
            beyond = [f"and {len(refused) - _MOST_FAULTS} more"] if len(refused) > _MOST_FAULTS else []
            listed = [f"  {line}" for line in refused[:_MOST_FAULTS] + beyond]
            raise SceneError("\n".join([f"{self.path}: {len(refused)} faults", *listed]))

    def warn(self) -> None:
        """Warn of what was approximated and of what is unknown, in one warning."""
        doubtful = [str(line) for line in self.lines if line.verdict in (Verdict.APPROXIMATED, Verdict.UNKNOWN)]
        if doubtful:
            beyond = [f"and {len(doubtful) - _MOST_FAULTS} more"] if len(doubtful) > _MOST_FAULTS else []
            text = "; ".join([*doubtful[:_MOST_FAULTS], *beyond])
            warnings.warn(f"{self.path}: {text}", LensFileWarning, stacklevel=2)

    def text(self, every_line: bool = False) -> list[str]:
        """Return the report as lines, in the file's order: what needs a look, or all of them, then counts and notes."""
        look = (Verdict.APPROXIMATED, Verdict.UNKNOWN, Verdict.REFUSED)
        in_order = sorted(self.lines, key=lambda line: line.number)
        listed = [str(line) for line in in_order if every_line or line.verdict in look]
        counts = Counter(line.verdict for line in self.lines)
        summary = ", ".join(f"{counts[verdict]} {verdict.value}" for verdict in Verdict if counts[verdict])
        return [*listed, *([f"lines: {summary}"] if summary else []), *self.notes]


def _cut(text: str) -> str:
    return text if len(text) <= _MOST_SHOWN else f"{text[: _MOST_SHOWN - 3]}..."
