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
"""Most characters of a line quoted in a message."""

_MOST_FAULTS = 20


class Verdict(Enum):
    """Verdict on a line."""

    TAKEN = "taken"
    APPROXIMATED = "approximated"
    WITHOUT_EFFECT = "without effect"
    """Does not change the path of light: names, merit functions, drawing colours."""
    UNKNOWN = "unknown"
    """Command unknown to this reader; the lens is made without it."""
    REFUSED = "refused"
    """Changes the image in a way that the lens cannot reproduce."""


_BY_WEIGHT = (Verdict.WITHOUT_EFFECT, Verdict.TAKEN, Verdict.APPROXIMATED, Verdict.UNKNOWN, Verdict.REFUSED)
"""Verdicts on one line in ascending weight."""

OTHER_AIR = Verdict.APPROXIMATED, "indices are those of the catalogue, at its own temperature and pressure"
"""Verdict on temperatures and pressures other than the catalogue's."""


@dataclass(frozen=True)
class Line:
    """Line, command or part of a file, with its verdict."""

    number: int
    """From 1; 0 in a file without lines."""
    text: str
    verdict: Verdict
    how: str = ""

    def joined(self, other: "Line") -> "Line":
        """Return the line with the weightier of two verdicts; for equal verdicts, join the reasons."""
        if self.verdict is not other.verdict:
            return max(self, other, key=lambda line: _BY_WEIGHT.index(line.verdict))
        told = [self.how] if other.how in self.how else [self.how, other.how]
        return replace(self, how="; ".join(filter(None, told)))

    def __str__(self) -> str:
        return f"{self.place}: {self.verdict.value}{f': {self.how}' if self.how else ''}"

    @property
    def place(self) -> str:
        """Place and text of the line."""
        return f"line {self.number}: {_cut(self.text)}" if self.number else _cut(self.text)


@dataclass
class Report:
    """Verdicts on the lines of a file.

    Attributes
    ----------
    path : Path
    lines : list of Line
        In reading order, each with its weightiest verdict.
    notes : list of str
        Conditions of use in the file: wavelengths, fields, positions of object and image.
    focal_length_mm : float
        Focal length at the file's primary wavelength; NaN until the lens is made.
    conditions : Conditions, optional
        Conditions under which the file uses its lens; None until the lens is made.
    """

    path: Path
    lines: list[Line] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    focal_length_mm: float = math.nan
    conditions: Conditions | None = None
    _places: dict[tuple[int, str], int] = field(default_factory=dict, repr=False, compare=False)

    def add(self, number: int, text: str, verdict: Verdict, how: str = "") -> None:
        """Add the verdict on a line; an existing entry keeps the weightier verdict.

        In files without lines, a part may have several entries, one per property.

        Parameters
        ----------
        number : int
            From 1; 0 in a file without lines.
        text : str
            Line, or the command on it.
        verdict : Verdict
        how : str
            Treatment of the line, or reason for none.
        """
        line = Line(number, text, verdict, how)
        place = self._places.setdefault((number, text), len(self.lines)) if number else len(self.lines)
        if place < len(self.lines):
            self.lines[place] = self.lines[place].joined(line)
        else:
            self.lines.append(line)

    def refuse(self, number: int, text: str, why: str) -> None:
        """Add a line that makes the file unusable; `raise_refusals` reports them together.

        Parameters
        ----------
        number : int
            From 1.
        text : str
            Line, or the command on it.
        why : str
            Property that the lens cannot have.
        """
        self.add(number, text, Verdict.REFUSED, why)

    def of(self, verdict: Verdict) -> list[Line]:
        """Return the lines with a given verdict."""
        return [line for line in self.lines if line.verdict is verdict]

    def raise_refusals(self) -> None:
        """Raise a SceneError that names every refused line, if any."""
        refused = [f"{line.place}: {line.how}" for line in self.of(Verdict.REFUSED)]
        if len(refused) == 1:
            raise SceneError(f"{self.path}: {refused[0]}")
        if refused:
            beyond = [f"and {len(refused) - _MOST_FAULTS} more"] if len(refused) > _MOST_FAULTS else []
            listed = [f"  {line}" for line in refused[:_MOST_FAULTS] + beyond]
            raise SceneError("\n".join([f"{self.path}: {len(refused)} faults", *listed]))

    def warn(self) -> None:
        """Issue one warning about approximated and unknown lines."""
        doubtful = [str(line) for line in self.lines if line.verdict in (Verdict.APPROXIMATED, Verdict.UNKNOWN)]
        if doubtful:
            beyond = [f"and {len(doubtful) - _MOST_FAULTS} more"] if len(doubtful) > _MOST_FAULTS else []
            text = "; ".join([*doubtful[:_MOST_FAULTS], *beyond])
            warnings.warn(f"{self.path}: {text}", LensFileWarning, stacklevel=2)

    def text(self, every_line: bool = False) -> list[str]:
        """Return the report as lines in file order (doubtful lines only, or all), then counts and notes."""
        look = (Verdict.APPROXIMATED, Verdict.UNKNOWN, Verdict.REFUSED)
        in_order = sorted(self.lines, key=lambda line: line.number)
        listed = [str(line) for line in in_order if every_line or line.verdict in look]
        counts = Counter(line.verdict for line in self.lines)
        summary = ", ".join(f"{counts[verdict]} {verdict.value}" for verdict in Verdict if counts[verdict])
        return [*listed, *([f"lines: {summary}"] if summary else []), *self.notes]


def _cut(text: str) -> str:
    return text if len(text) <= _MOST_SHOWN else f"{text[: _MOST_SHOWN - 3]}..."
