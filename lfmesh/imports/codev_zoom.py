"""Zoom positions of CODE V sequence files: the commands that set a lens to one of them.

`ZOO 3` gives their number. `ZOO THI S5 2.0 8.0 14.0` gives the values of `THI S5` at each position, as do `THI S5 Z1
2.0`, `THI S5 Z2 8.0` and `THI S5 Z3 14.0`.
"""

import re
from collections.abc import Collection, Iterator

from lfmesh.errors import SceneError
from lfmesh.imports.numbers import is_number, number
from lfmesh.imports.prescription import MOST_CONFIGURATIONS
from lfmesh.imports.report import Report, Verdict

Command = tuple[int, list[str]]
"""Line (from 1) and words of a command."""

_SURFACE = re.compile(r"S(O|I|S|\d+)", re.IGNORECASE)


def zoom_word(words: list[str]) -> int | None:
    """Return the index of the word that names a zoom position, such as `Z2` in `THI S5 Z2 8.0`, or None."""
    return next((k for k in (1, 2) if k < len(words) and re.fullmatch(r"[Zz]\d+", words[k])), None)


class ZoomPositions:
    """Zoom positions of a file.

    Attributes
    ----------
    count : int
    """

    def __init__(self, report: Report, without_effect: Collection[str]) -> None:
        self.count = 1
        self._report, self._without_effect = report, without_effect
        self._counts: list[Command] = []
        self._rows: list[Command] = []
        self._single: list[tuple[int, list[str], int]] = []

    def add_row(self, at: int, words: list[str]) -> None:
        """Add the words after `ZOO`; ValueError for an impossible number of positions."""
        if len(words) == 1 and is_number(words[0]):
            count = number(words[0])
            if count != int(count) or not 1 <= count <= MOST_CONFIGURATIONS:
                raise ValueError(f"the number of zoom positions must be a whole number from 1 to {MOST_CONFIGURATIONS}")
            self.count = int(count)
            self._counts.append((at, words))
        else:
            self._rows.append((at, words))

    def add_single(self, at: int, words: list[str], where: int) -> None:
        """Add a command for a single position.

        Parameters
        ----------
        at : int
            Line, from 1.
        words : list of str
        where : int
            Index of the word that names the position.
        """
        self._single.append((at, words, where))

    def commands(self, wanted: int | None) -> Iterator[Command]:
        """Yield the commands that set the lens to one position; report on the others.

        Parameters
        ----------
        wanted : int, optional
            From 1; by default the values in the surfaces stay.

        Raises
        ------
        SceneError
            The file has no such position.
        """
        count = self.count
        if wanted is not None and not 1 <= wanted <= count:
            has = "has one configuration" if count == 1 else f"has configurations 1 to {count}"
            raise SceneError(f"{self._report.path}: configuration = {wanted}: the file {has}")
        for at, words in self._counts:
            if count > 1 and wanted is None:
                how = f"{count} configurations: the values in the surfaces are taken"
                self._report.add(at, f"ZOO {words[0]}", Verdict.APPROXIMATED, how)
            else:
                self._report.add(at, f"ZOO {words[0]}", Verdict.TAKEN if count > 1 else Verdict.WITHOUT_EFFECT)
        for at, words in self._rows:
            yield from self._of_row(at, words, wanted)
        for at, words, where in self._single:
            position = int(words[where][1:])
            if len(words) < where + 2 or not 1 <= position <= count:
                self._report.refuse(at, " ".join(words), f"it must give a value at one of {count} positions")
            elif position == wanted and words[0].upper() not in self._without_effect:
                yield at, [*words[:where], *words[where + 1 :]]
            else:
                self._report.add(at, " ".join(words), Verdict.WITHOUT_EFFECT)

    def _of_row(self, at: int, words: list[str], wanted: int | None) -> Iterator[Command]:
        """Yield the command of a row at a position, if any."""
        text = " ".join(["ZOO", *words])
        if len(words) < 2 or self.count == 1 or wanted is None or words[0].upper() in self._without_effect:
            self._report.add(at, text, Verdict.WITHOUT_EFFECT)
        elif len(words) == 2 and _SURFACE.fullmatch(words[1]):
            # It only announces different values at each position.
            self._report.add(at, text, Verdict.TAKEN)
        else:
            command, values = words[: -self.count], words[-self.count :]
            misplaced = any(_SURFACE.fullmatch(value) for value in values)
            if not 1 <= len(command) <= 2 or is_number(command[0]) or misplaced:
                self._report.refuse(at, text, f"it must name one command and its values at {self.count} positions")
            else:
                yield at, [*command, values[wanted - 1]]
