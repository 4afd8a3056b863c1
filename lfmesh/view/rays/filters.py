"""Filter expressions: choose paths by a one-line condition, in Python, on the command line and in the viewer.

    hits(mla) and not ghost          reflects(lens[2].front) or transmits(L3b)
    status == lost                   last == sensor
    events > 12                      reflections == 2
    power < 1e-6                     wavelength >= 500
    path == 3                        source != 17
    pixel in (300:340, 300:340)      hits("my target")

`not` binds more tightly than `and`, `and` more than `or`; parentheses override. Terms:

hits, reflects, transmits, scatters (a surface)
    The path meets the surface, or has that event there. A surface is one of a prescription (`lens[2].front`, L3a), all
    of a part (`lens[2]`, `lens`, `mla`, `targets`), a target's name, or an end of paths (`sensor`, `stop`, `mount`,
    ...). Quote names with spaces or other signs.
ghost
    At least two reflections by surfaces of lens or array, on a path that reaches the sensor (launched from it: leaves
    the lens or meets a target).
status, last
    How the path ended, and on what.
events, reflections
    Interfaces and scatterings met, and reflections by lens or array.
power
    Power at the path's end, in the rays' unit (W; m² sr if launched from the sensor).
wavelength
    In nm.
source
    Number of the path's launched ray.
path
    Number in the path table: `rays.sequences[number]`.
pixel in (rows, columns)
    Pixel at the path's end, or its start on the sensor. Ranges are Python slices: `300:340` is 300 to 339, `:40` the
    first 40, `300:` the rest, `300` only that one. `pixel == (300, 310)` is one pixel.

A blank expression keeps everything. No Python is evaluated.
"""

import difflib
import operator
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.transport.packets.packet import Event, Status
from lfmesh.view.rays.names import BACK, CURVED, FLAT, FRONT, REAR, aliases, label, target_names
from lfmesh.view.rays.paths import Rays

Mask = NDArray[np.bool_]

COMPARISONS: dict[str, Callable[[NDArray[np.float64], float], Mask]] = {
    "==": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}

FUNCTIONS = {
    "hits": None,
    "reflects": Event.REFLECTED,
    "transmits": Event.TRANSMITTED,
    "scatters": Event.SCATTERED,
}

NUMBERS: dict[str, Callable[[Rays], NDArray[np.float64]]] = {
    "events": lambda rays: rays.events.astype(np.float64),
    "reflections": lambda rays: rays.count_vertices(rays.reflected).astype(np.float64),
    "power": lambda rays: rays.end_power,
    "wavelength": lambda rays: rays.wavelength_nm,
    "source": lambda rays: rays.source.astype(np.float64),
    "path": lambda rays: rays.sequence.astype(np.float64),
}

STATUSES = {status.name.lower(): status for status in Status if status != Status.ROULETTE}

FIELDS = [*NUMBERS, "status", "last", "pixel"]

DEEPEST = 100
"""Maximum nesting of parentheses and negations."""

NO_PLACE = {
    "start", "emitted", "roulette added", "roulette removed", "sampling added", "sampling removed",
    "reflections not followed", "reached", "lit",
}  # fmt: skip
"""Ledger entries on which no path ends."""

OF_ARRAY = {CURVED, FLAT, BACK, "mla edge", "mla wall", "mla mask", "mla mount"}
OF_COVER = {FRONT, REAR}

LONGEST = 20_000
"""Maximum number of characters in an expression."""

MOST_DIGITS = 12
"""Maximum number of digits of a row or column."""

# Possessive quantifiers: otherwise every split of a long digit string would be tried.
_TOKEN = re.compile(
    r"""\s*(?:
        (?P<number>\d++\.?+\d*+(?:[eE][-+]?\d++)?|\.\d++(?:[eE][-+]?\d++)?)(?![\w.])
      | (?P<text>"[^"]*"|'[^']*')
      | (?P<name>[^\W\d]\w*(?:\[\d+\])?(?:\.[^\W\d]\w*)?)
      | (?P<sign>==|!=|<=|>=|[<>():,+-])
    )""",
    re.VERBOSE,
)


class FilterError(LfmeshError):
    """Mistake in a filter expression.

    Attributes
    ----------
    expression : str
    position : int
        Position in the expression, from 0.
    reason : str
        The mistake and its correction, in one sentence.
    """

    # The caret is at its place only if neither line is shortened.
    longest_line = LONGEST + 4

    def __init__(self, expression: str, position: int, reason: str) -> None:
        self.expression, self.position, self.reason = expression, position, reason
        # Line breaks would put the caret under the wrong place.
        shown = re.sub(r"\s", " ", expression)
        super().__init__(f"{reason}\n  {shown}\n  {' ' * position}^")


def parse(expression: str, rays: Rays) -> Mask:
    """Return a mask (n,) of the paths that an expression keeps.

    Raises
    ------
    FilterError
        The expression is invalid, or names something that the scene lacks.
    """
    if len(expression) > LONGEST:
        reason = f"an expression of {len(expression)} characters; the limit is {LONGEST}, and it begins as follows"
        raise FilterError(expression[:60], 0, reason)
    if not expression.strip():
        return np.ones(len(rays), np.bool_)
    reader = _Reader(expression, rays)
    kept = reader.either()
    reader.expect_end()
    return kept


@dataclass(frozen=True)
class _Token:
    kind: str  # number, text, name, sign or end
    text: str
    position: int


def _tokens(expression: str) -> list[_Token]:
    tokens, at = [], 0
    end = len(expression.rstrip())
    while at < end:
        found = _TOKEN.match(expression, at)
        if not found:
            at += len(expression[at:]) - len(expression[at:].lstrip())
            wrong = expression[at]
            if wrong in "\"'":
                raise FilterError(expression, at, "this quotation mark is not closed")
            hint = "; compare with ==" if wrong == "=" else "; use and, or, not" if wrong in "&|!~" else ""
            number = re.match(r"[\w.]+", expression[at:])
            if number:
                raise FilterError(expression, at, f"{number[0]!r} is neither a number nor a name")
            raise FilterError(expression, at, f"{wrong!r} is not valid here{hint}")
        kind = str(found.lastgroup)
        tokens.append(_Token(kind, found[kind], found.start(kind)))
        at = found.end()
    return [*tokens, _Token("end", "", end)]


class _Reader:
    """Recursive-descent parser: one method per rule, each returns the mask of the text read."""

    def __init__(self, expression: str, rays: Rays) -> None:
        self.expression, self.rays = expression, rays
        self.tokens = _tokens(expression)
        self.at = self.depth = 0

    def either(self) -> Mask:
        """Read ``all {"or" all}``."""
        kept = self.all()
        while self.skip("or"):
            kept = kept | self.all()
        return kept

    def all(self) -> Mask:
        """Read ``single {"and" single}``."""
        kept = self.single()
        while self.skip("and"):
            kept = kept & self.single()
        return kept

    def single(self) -> Mask:
        """Read ``"not" single``, a group in parentheses, ghost, a function or a comparison."""
        token = self.next
        if token.text in ("not", "(") and token.kind != "text":
            self.depth += 1
            if self.depth > DEEPEST:
                raise self.mistake(token, f"more than {DEEPEST} conditions inside each other")
            self.at += 1
            kept = ~self.single() if token.text == "not" else self.either()
            if token.text == "(":
                self.expect(")")
            self.depth -= 1
            return kept
        if token.kind != "name" or token.text in ("and", "or", "in"):
            functions = ", ".join(f"{name}(...)" for name in FUNCTIONS)
            fields = ", ".join(FIELDS)
            raise self.mistake(token, f"a condition is missing: {functions}, ghost, or a comparison of {fields}")
        self.at += 1
        if token.text == "ghost":
            return self.rays.ghosts
        if token.text in FUNCTIONS:
            return self.met(FUNCTIONS[token.text])
        if token.text not in FIELDS:
            if token.text in self.places:
                raise self.mistake(token, f"{token.text} is a surface: ask hits({token.text}), or reflects, transmits")
            valid = ["ghost", *FUNCTIONS, *FIELDS]
            raise self.mistake(token, f"unknown name {token.text!r}{self.valid(token.text, valid)}")
        return self.pixel() if token.text == "pixel" else self.comparison(token.text)

    def met(self, event: Event | None) -> Mask:
        """Read ``"(" surface ")"``; return the mask of paths that meet the surface, with an event or any."""
        self.expect("(")
        there = np.isin(self.rays.surface, self.surfaces())
        self.expect(")")
        if event is None:
            return self.rays.any_vertex(there & (self.rays.event != Event.START))
        return self.rays.any_vertex(there & (self.rays.event == event))

    def surfaces(self) -> list[int]:
        """Read the name of a surface or part; return its numbers."""
        token = self.next
        if token.kind not in ("name", "text"):
            raise self.mistake(token, "the name of a surface is missing: lens[0].front, mla, stop, sensor, ...")
        self.at += 1
        name = token.text.strip("\"'") if token.kind == "text" else token.text
        known = self.places
        if name not in known:
            raise self.mistake(token, f"the scene has no {name!r}{self.valid(name, _listed(self.rays), known)}")
        return known[name]

    def comparison(self, field: str) -> Mask:
        """Read ``sign value`` after a field's name."""
        sign = self.next
        if sign.text not in COMPARISONS:
            raise self.mistake(sign, f"{field} must be compared: {field} {' '.join(COMPARISONS)} ...")
        self.at += 1
        if field in NUMBERS:
            return COMPARISONS[sign.text](NUMBERS[field](self.rays), self.number())
        if sign.text not in ("==", "!="):
            raise self.mistake(sign, f"{field} is a name: compare it with == or !=")
        if field == "last":
            kept = np.isin(self.rays.end, self.surfaces())
        else:
            token = self.next
            if token.text.lower() not in STATUSES:
                raise self.mistake(token, f"no path has the status {token.text!r}{self.valid(token.text, STATUSES)}")
            self.at += 1
            kept = self.rays.status == STATUSES[token.text.lower()]
        return kept if sign.text == "==" else ~kept

    def number(self) -> float:
        """Read a number with its sign."""
        negative = self.skip("-")
        if not negative:
            self.skip("+")
        token = self.next
        if token.kind != "number":
            raise self.mistake(token, "a number is missing")
        self.at += 1
        return -float(token.text) if negative else float(token.text)

    def pixel(self) -> Mask:
        """Read ``"in" "(" range "," range ")"`` or ``"==" "(" row "," column ")"`` after "pixel"."""
        sign = self.next
        if sign.text not in ("in", "==", "!="):
            raise self.mistake(sign, "write pixel in (row:row, column:column), or pixel == (row, column)")
        self.at += 1
        self.expect("(")
        sensor = self.rays.world.tables.sensor
        rows = self.range("row", sensor.rows, single=sign.text != "in")
        self.expect(",")
        columns = self.range("column", sensor.columns, single=sign.text != "in")
        self.expect(")")
        row, column = self.rays.pixel.T
        kept = (row >= rows.start) & (row < rows.stop) & (column >= columns.start) & (column < columns.stop)
        return ~kept if sign.text == "!=" else kept

    def range(self, axis: str, size: int, *, single: bool) -> range:
        """Read ``[first] ":" [end]`` or one number; it must include part of the sensor.

        Parameters
        ----------
        axis : str
            Axis of the sensor, in words.
        size : int, pixels
        single : bool
            Only one number is allowed.
        """
        token = self.next
        first = None if token.text == ":" else self.whole(axis)
        if first is not None and (single or self.next.text != ":"):
            chosen = range(first, first + 1)
        elif single:
            raise self.mistake(token, f"give a single {axis} here: pixel == (row, column)")
        else:
            self.expect(":")
            end = size if self.next.text in (",", ")") else self.whole(axis)
            chosen = range(first or 0, end)
        if not len(chosen) or chosen.start >= size:
            what = f"{chosen.start}:{chosen.stop}" if len(chosen) != 1 else str(chosen.start)
            empty = "is empty: a range does not include its end" if not len(chosen) else "is outside"
            raise self.mistake(token, f"{axis} {what} {empty}; the sensor has {axis}s 0 to {size - 1}")
        return chosen

    def whole(self, axis: str) -> int:
        """Read a non-negative integer."""
        token = self.next
        if not token.text.isdecimal():
            raise self.mistake(token, f"the number of a {axis} is missing: a whole number from 0")
        if len(token.text) > MOST_DIGITS:
            raise self.mistake(token, f"the number of a {axis} has at most {MOST_DIGITS} digits")
        self.at += 1
        return int(token.text)

    @cached_property
    def places(self) -> dict[str, list[int]]:
        """Names of all surfaces and parts, with their numbers."""
        return places(self.rays)

    @property
    def next(self) -> _Token:
        """Next token."""
        return self.tokens[self.at]

    def skip(self, text: str) -> bool:
        """Read a sign or word if it comes next; tell whether it did."""
        found = self.next.kind in ("sign", "name") and self.next.text == text
        self.at += found
        return found

    def expect(self, text: str) -> None:
        """Read a sign that must come next."""
        if not self.skip(text):
            raise self.mistake(self.next, f"{text!r} is missing here")

    def expect_end(self) -> None:
        """Check that everything has been read."""
        if self.next.kind != "end":
            raise self.mistake(self.next, f"{self.next.text!r} follows a whole condition; join two with and, or")

    def mistake(self, token: _Token, reason: str) -> FilterError:
        """Return the error that points at a token."""
        if token.kind == "end" and token.position:
            reason += " (the expression ends here)"
        return FilterError(self.expression, token.position, reason)

    @staticmethod
    def valid(wrong: str, listed: Iterable[str], known: Iterable[str] | None = None) -> str:
        """Return the valid words in place of a wrong one, as the end of a message.

        Parameters
        ----------
        wrong : str
        listed : iterable of str
            Words to show.
        known : iterable of str, optional
            All valid words, if more than are shown.
        """
        near = difflib.get_close_matches(wrong, list(known or listed), 1, 0.6)
        hint = f"; did you mean {near[0]!r}?" if near else ";"
        return f"{hint} there are {', '.join(f'{n!r}' if ' ' in n else n for n in listed)}"


def places(rays: Rays) -> dict[str, list[int]]:
    """Return all names of surfaces and parts in a filter, with the numbers of their surfaces."""
    world = rays.world
    known: dict[str, set[int]] = {}
    for number, name in enumerate(rays.surfaces):
        of_absent = OF_ARRAY if not world.tables.mla.present else {BACK if world.tables.mla.back is None else FLAT}
        of_absent = of_absent | OF_COVER if world.tables.cover is None else of_absent
        if name not in NO_PLACE | of_absent:
            known.setdefault(name, set()).add(number)
    known.update({alias: known[name] for alias, name in aliases(world).items() if name in known})
    parts: dict[str, set[int]] = {}
    for name, numbers in known.items():
        if found := re.match(r"(lens)\[\d+\]", name):
            members = [found[0], found[1]]
        else:
            members = ["mla"] if name in OF_ARRAY and name != "mla mount" else []
        for part in members:
            parts.setdefault(part, set()).update(numbers)
    for target in target_names(world):
        parts.setdefault("targets", set()).update(known[target])
    for part, numbers in parts.items():
        known[part] = known.get(part, set()) | numbers
    return {name: sorted(numbers) for name, numbers in known.items()}


def _listed(rays: Rays) -> list[str]:
    """Return a short list of the names of `places`; one element represents all."""
    elements = len(rays.world.lens_shape.elements)
    told = [f"lens[0] to lens[{elements - 1}] (each with .front and .back, in short L1a, L1b, ...)"]
    known = places(rays)
    told += [name for name in known if not name.startswith(("lens[", "targets[")) and label(name) == name]
    short = {alias for alias in aliases(rays.world) if not alias.startswith("targets")}
    return [name for name in told if name not in short] + [
        name for name in (CURVED, FLAT, BACK, FRONT, REAR) if name in known
    ]
