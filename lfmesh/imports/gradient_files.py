"""Materials of gradient-index glass in the files that OpticStudio keeps among its glass catalogues.

The file's layout, not its name, determines its kind (OpticStudio's help, 24.2, "Gradient 5", "GRADIUM", "Gradient 9"):

- SGRIN.DAT, dispersion: name; lowest and highest wavelength; reference wavelength, all in µm; K_MAX and L_MAX; three
  lines of K_MAX numbers K_ij; three lines of L_MAX numbers L_ij.
- GRADIENT_9.DAT, SELFOC rods: name; B, C, K₀, K₁ and K₂ on a line each.
- PROFILE.GRD, GRADIUM blanks: name, material of SGRIN.DAT and length on a line; n₀ to n₁₁ on a line each.

Names differ in more than their case. Blank lines are skipped.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from lfmesh.errors import SceneError
from lfmesh.imports.numbers import is_number, nanometres, number, numbers
from lfmesh.imports.text import read_lines

DISPERSIONS, RODS, BLANKS = "SGRIN.DAT", "GRADIENT_9.DAT", "PROFILE.GRD"
"""Usual names of the files."""

MOST_TERMS = 8
"""Largest K_MAX and L_MAX."""

_SELLMEIER_TERMS = 3
_ROD_NUMBERS, _BLANK_NUMBERS = 5, 12
_MOST_LISTED = 20


class MissingMaterialError(ValueError):
    """The files lack a material; the message says which file has it."""


class FileDispersion(NamedTuple):
    """Dispersion of a material of SGRIN.DAT.

    Attributes
    ----------
    range_nm : (2,) tuple of float
        Lowest and highest wavelength of its data.
    reference_nm : float
    strengths, resonances_um2 : tuples of tuples of float
        K_ij and L_ij.
    """

    range_nm: tuple[float, float]
    reference_nm: float
    strengths: tuple[tuple[float, ...], ...]
    resonances_um2: tuple[tuple[float, ...], ...]

    @property
    def keys(self) -> dict[str, object]:
        """Keys of a scene's dispersion."""
        named = {"strengths": self.strengths, "resonances_um2": self.resonances_um2}
        return {"reference_nm": self.reference_nm, **named}


@dataclass(frozen=True)
class FileRod:
    """A SELFOC rod: B and C of its index, K₀ to K₂ of √A."""

    index: tuple[float, ...]
    gradient_constant_per_mm: tuple[float, ...]


class FileBlank(NamedTuple):
    """A GRADIUM blank.

    Attributes
    ----------
    family : str
        Its material in SGRIN.DAT.
    length_mm : float
    coefficients : tuple of float
        From the power 0 up.
    """

    family: str
    length_mm: float
    coefficients: tuple[float, ...]


@dataclass
class GradientFiles:
    """Files of gradient-index materials: those that the user names, else those beside the lens file.

    Attributes
    ----------
    folder : Path
        Folder of the lens file.
    given : tuple of Path
        Files that the user names.
    profiles : str
        Name of the file of GRADIUM blanks beside the lens file.
    """

    folder: Path
    given: tuple[Path, ...] = ()
    profiles: str = BLANKS
    _read: dict[Path, "_Table"] = field(default_factory=dict, init=False, repr=False)

    def dispersion(self, name: str) -> FileDispersion:
        """Return the dispersion of a material; MissingMaterialError if no file has it.

        Raises
        ------
        SceneError
            A file cannot be read.
        """
        found: FileDispersion = self._found(DISPERSIONS, name, DISPERSIONS)
        return found

    def rod(self, name: str) -> FileRod:
        """Return a SELFOC rod, with the errors of `dispersion`."""
        found: FileRod = self._found(RODS, name, RODS)
        return found

    def blank(self, name: str) -> FileBlank:
        """Return a GRADIUM blank, with the errors of `dispersion`."""
        found: FileBlank = self._found(BLANKS, name, self.profiles)
        return found

    def _found(self, kind: str, name: str, usual: str) -> Any:
        """Return a material of a kind, from the given files or the usual one beside the lens file."""
        tables = [table for path in self.given if (table := self._table(path)).kind == kind]
        beside = None if tables else self._beside(usual)
        if beside is not None:
            tables = [table for table in [self._table(beside)] if table.kind == kind]
        for table in tables:
            if name.upper() in table.materials:
                return table.materials[name.upper()]
        if not tables:
            raise MissingMaterialError(
                f"the numbers of {name} stand in OpticStudio's file {usual}, which does not lie beside the lens file; "
                "put it there, or give it with camera.lens.gradient_files or --gradients FILE"
            )
        names = [each for table in tables for each in table.materials]
        listed = ", ".join([*names[:_MOST_LISTED], *(["..."] if len(names) > _MOST_LISTED else [])])
        held = ", ".join(table.path.name for table in tables)
        raise MissingMaterialError(f"{held} has no {name}; it has {listed or 'no material'}")

    def _table(self, path: Path) -> "_Table":
        if path not in self._read:
            self._read[path] = _Table(path)
        return self._read[path]

    def _beside(self, name: str) -> Path | None:
        """Return the file of a name, in any case, in the lens file's folder."""
        try:
            found = [path for path in sorted(self.folder.iterdir()) if path.name.upper() == name.upper()]
        except OSError:
            return None
        return min(found, key=lambda path: path.name != name, default=None)


class _Table:
    """Materials of a file.

    Attributes
    ----------
    path : Path
    kind : str
        Usual name of such a file.
    materials : dict
        By name, in capitals.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lines = [(at, line.split()) for at, line in enumerate(read_lines(path), 1) if line.split()]
        self._at = 0
        self.kind = self._kind()
        readers: dict[str, Callable[[list[str]], FileDispersion | FileRod | FileBlank]] = {
            DISPERSIONS: self._dispersion,
            RODS: self._rod,
            BLANKS: self._blank,
        }
        self.materials: dict[str, FileDispersion | FileRod | FileBlank] = {}
        at = 0
        try:
            while self._at < len(self._lines):
                at = self._lines[self._at][0]
                words = self._next()
                material = readers[self.kind](words)
                self.materials.setdefault(words[0].upper(), material)
        except ValueError as error:
            last = self._lines[min(self._at, len(self._lines)) - 1][0]
            raise SceneError(f"{path}: line {last}: {error}; the material starts in line {at}") from None

    def _kind(self) -> str:
        """Return the kind of the file by its first two lines."""
        first, second = (words for _, words in [*self._lines, (0, []), (0, [])][:2])
        if len(first) > 2 and not is_number(first[1]) and is_number(first[2]):
            return BLANKS
        if len(first) == 1 and not is_number(first[0]) and len(second) in (1, 2) and all(map(is_number, second)):
            return DISPERSIONS if len(second) == 2 else RODS
        kinds = f"{DISPERSIONS}, {RODS} or {BLANKS}"
        raise SceneError(f"{self.path}: no file of gradient-index materials like OpticStudio's {kinds}")

    def _next(self) -> list[str]:
        """Return the words of the next line."""
        if self._at == len(self._lines):
            raise ValueError("the file ends inside a material")
        self._at += 1
        return self._lines[self._at - 1][1]

    def _row(self, count: int) -> tuple[float, ...]:
        """Return the next line as a number of numbers."""
        words = self._next()
        if len(words) != count:
            raise ValueError(f"{len(words)} words in place of {count} number{'' if count == 1 else 's'}")
        return tuple(numbers(words))

    def _dispersion(self, words: list[str]) -> FileDispersion:
        _only_a_name(words)
        spread, reference = self._next(), self._next()
        if len(spread) != 2 or len(reference) != 1:
            raise ValueError("the range of wavelengths must be two numbers, the reference wavelength one")
        lowest, highest, reference_nm = (nanometres(word) for word in (*spread, *reference))
        if not (0.0 < lowest < highest and reference_nm > 0.0):
            raise ValueError("wavelengths must be above 0, and rise")
        counts = self._row(2)
        if any(each not in range(1, MOST_TERMS + 1) for each in counts):
            raise ValueError(f"K_MAX and L_MAX must be whole numbers from 1 to {MOST_TERMS}")
        strengths, resonances = (tuple(self._row(int(each)) for _ in range(_SELLMEIER_TERMS)) for each in counts)
        return FileDispersion((lowest, highest), reference_nm, strengths, resonances)

    def _rod(self, words: list[str]) -> FileRod:
        _only_a_name(words)
        values = self._column(_ROD_NUMBERS)
        return FileRod(values[:2], values[2:])

    def _blank(self, words: list[str]) -> FileBlank:
        if len(words) < 3:
            raise ValueError("a profile starts with its name, its material and the length of the blank")
        length = number(words[2])
        if not length > 0.0:
            raise ValueError("the length of the blank must be above 0")
        return FileBlank(words[1], length, self._column(_BLANK_NUMBERS))

    def _column(self, count: int) -> tuple[float, ...]:
        """Return numbers on a line each."""
        return tuple(value for _ in range(count) for value in self._row(1))


def _only_a_name(words: Sequence[str]) -> None:
    if len(words) != 1:
        raise ValueError(f"{len(words)} words in place of the name of a material")
