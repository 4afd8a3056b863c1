"""Coatings named in lens files: OpticStudio's built-in ones, and entries of a coating file beside the lens file.

A coating file (OpticStudio's help, "Defining Coatings") holds materials (`MATE`), layers (`COAT`), constant reflectance
and transmittance (`IDEAL`, or `COAT` with a name like `I.95`), and tables by angle and wavelength (`TABLE`). `!` starts
a comment. Layers are listed from air to glass, as in a scene; between two glasses, from object to sensor.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path

from lfmesh.errors import SceneError
from lfmesh.imports.numbers import nanometres, number, numbers
from lfmesh.imports.text import read_lines
from lfmesh.scene.materials.coatings import Coating, Layer, MeasuredIndex, MeasuredReflectance

USUAL_FILE = "COATING.DAT"
"""Default name of the coating file."""

MGF2_INDEX = 1.38
"""Index of the quarter-wave layer of magnesium fluoride that `AR` denotes."""

BARE = ("NONE", "NULL")
"""Names that mean no coating."""

_IDEAL = re.compile(r"I(?:\.(?=\d*\.))?(\d*\.\d+|1)")
"""Name of an ideal coating by its transmittance: `I.95`, `I0.95` or `I.0.95`."""

_KINDS = ("MATE", "COAT", "IDEAL", "IDEAL2", "TABLE", "TAPR", "ENCRYPTED")

_LOST = 1e-6
"""Absorbed fraction of the light above which the report says so."""


class UnreadableCoatingError(Exception):
    """A coating cannot be read; the message says why."""


@dataclass(frozen=True)
class FoundCoating:
    """Coating of a lens file.

    Attributes
    ----------
    coating : Coating
    how : str
        Description of approximations; empty if exact.
    """

    coating: Coating
    how: str = ""


@dataclass
class CoatingFile:
    """Entries of a coating file.

    Attributes
    ----------
    path : Path
    materials : dict
        Complex index by name.
    unusable : dict
        Fault of each invalid material, by name.
    entries : dict of str to (str, list of list of str)
        Kind of each coating, and the words of its lines after the first; of `IDEAL`, the only line.
    """

    path: Path
    materials: dict[str, MeasuredIndex] = field(default_factory=dict)
    unusable: dict[str, str] = field(default_factory=dict)
    entries: dict[str, tuple[str, list[list[str]]]] = field(default_factory=dict)

    @classmethod
    def beside(cls, lens_file: Path, name: str | Path | None) -> "CoatingFile | None":
        """Read the coating file in a lens file's folder, if any; an exact match of case comes first.

        Parameters
        ----------
        lens_file : Path
        name : str or Path, optional
            Name given by the lens file (default: the usual one), or the path of a required file.

        Raises
        ------
        SceneError
            As for `read`.
        """
        if isinstance(name, Path):
            return cls.read(name)
        wanted = (name or USUAL_FILE).upper()
        try:
            found = [path for path in sorted(lens_file.parent.iterdir()) if path.name.upper() == wanted]
            found.sort(key=lambda path: path.name != (name or USUAL_FILE))
        except OSError:
            found = []
        return cls.read(found[0]) if found else None

    @classmethod
    def read(cls, path: Path) -> "CoatingFile":
        """Read a coating file.

        Parameters
        ----------
        path : Path

        Raises
        ------
        SceneError
            The file cannot be read.
        """
        file = cls(path)
        for kind, name, lines in _blocks(path):
            if kind != "MATE":
                file.entries[name] = kind, lines
                continue
            try:
                file.materials[name] = _material(lines)
            except (ValueError, SceneError) as error:
                file.unusable[name] = f"MATE {name}: {error}"
        return file

    def coating(self, name: str, primary_nm: float) -> FoundCoating:
        """Return a coating of the file.

        Parameters
        ----------
        name : str
            In capitals.
        primary_nm : float
            Reference wavelength of thicknesses.

        Raises
        ------
        UnreadableCoatingError
            The file has no such coating, or a scene cannot have its kind.
        """
        if name not in self.entries:
            raise UnreadableCoatingError(f"{self.path.name} has no such coating")
        kind, lines = self.entries[name]
        try:
            if kind == "COAT" and not lines and (ideal := _ideal(name)) is not None:
                return ideal
            if kind == "COAT":
                return self._layers(lines, primary_nm)
            if kind == "IDEAL":
                transmitted, reflected = numbers([*lines[0], "", ""][:2])
                if not min(transmitted, reflected) >= 0.0:
                    raise ValueError("a share below 0")
                return _fixed(reflected, transmitted)
            if kind == "TABLE":
                return _by_angle(lines)
        except (ValueError, IndexError, SceneError) as error:
            cut = isinstance(error, IndexError)
            raise UnreadableCoatingError(f"{self.path.name}: {'it is cut short' if cut else error}") from None
        raise UnreadableCoatingError(f"{self.path.name} has it as {kind}, which is not read")

    def _layers(self, lines: list[list[str]], primary_nm: float) -> FoundCoating:
        """Return a stack, each line with a material, thickness, whether it is in µm, group number and taper."""
        layers, groups, tapers = [], [], []
        for words in lines:
            material = self.materials.get(words[0].upper())
            if material is None:
                raise ValueError(self.unusable.get(words[0].upper(), f"material {words[0]} is not in the file"))
            if len(words) < 2:
                raise ValueError(f"a layer of {words[0]} has no thickness")
            thickness = number(words[1])
            if len(words) > 2 and number(words[2]):
                nm = nanometres(words[1])
            else:
                nm = thickness * primary_nm / material.at(primary_nm).real
            layers.append(_layer(material, nm))
            groups.append(int(number(words[3])) if len(words) > 3 else 0)
            tapers += words[4:5]
        how = f"layers of taper {tapers[0]} get the thickness at the middle everywhere" if tapers else ""
        return FoundCoating(Coating(layers=tuple(_repeated(layers, groups))), how)


def found_coating(
    name: str, primary_nm: float, file: CoatingFile | None, wanted: str = USUAL_FILE
) -> FoundCoating | None:
    """Return the coating that a name means in a Zemax file, None for a bare surface.

    Parameters
    ----------
    name : str
    primary_nm : float
        Reference wavelength of quarter waves.
    file : CoatingFile, optional
        Coating file; its definitions precede the built-in ones.
    wanted : str
        Name of the coating file.

    Raises
    ------
    UnreadableCoatingError
        It is neither in the file nor built in, or a scene cannot have its kind.
    """
    name = name.upper()
    if name in BARE:
        return None
    if file is not None and name in file.entries:
        return file.coating(name, primary_nm)
    where = f"{file.path.name} has no such coating" if file is not None else f"no {wanted} beside the file"
    if name == "AR":
        quarter = Layer(index=MGF2_INDEX, thickness_nm=primary_nm / MGF2_INDEX / 4.0)
        usual = file is None and wanted.upper() == USUAL_FILE
        how = "" if usual else f"{where}; replaced by a quarter wave of MgF2"
        return FoundCoating(Coating(layers=(quarter,)), how)
    if name == "MIRROR":
        return FoundCoating(Coating(reflectance=1.0), "a metal coating; taken as a perfect reflector")
    if (ideal := _ideal(name)) is not None:
        return ideal
    raise UnreadableCoatingError(where)


def _ideal(name: str) -> FoundCoating | None:
    """Return the ideal coating whose transmittance is given by its name; None for other names."""
    found = _IDEAL.fullmatch(name)
    return None if found is None else _fixed(float(f"{1.0 - float(found[1]):.12g}"), float(found[1]))


def numbered(name: str) -> Iterator[str]:
    """Yield a name, then numbered variants from 2, to find a free one."""
    yield name
    yield from (f"{name}-{number}" for number in count(2))


def _blocks(path: Path) -> Iterator[tuple[str, str, list[list[str]]]]:
    """Yield the kind, name in capitals, and words of the lines of each entry."""
    kind, name, lines = "", "", list[list[str]]()
    for line in read_lines(path):
        words = line.partition("!")[0].split()
        if not words:
            continue
        if words[0].upper() in _KINDS and len(words) > 1:
            if kind:
                yield kind, name, lines
            kind, name, lines = words[0].upper(), words[1].upper(), [words[2:]] if words[2:] else []
        elif kind:
            lines.append(words)
    if kind:
        yield kind, name, lines


def _layer(material: MeasuredIndex, thickness_nm: float) -> Layer:
    """Return a layer; a material with a single row becomes a constant index."""
    if len(material.index) > 1:
        return Layer(measured=material, thickness_nm=thickness_nm)
    extinction = material.extinction[0] if material.extinction else 0.0
    return Layer(index=material.index[0], extinction=extinction, thickness_nm=thickness_nm)


def _material(lines: list[list[str]]) -> MeasuredIndex:
    """Return a material from rows of wavelength in µm, n and k; negative k absorbs."""
    rows = sorted((nanometres(words[0]), *numbers([*words, "0"][1:3])) for words in lines)
    if not rows:
        raise ValueError("it has no rows")
    if min(map(len, rows)) < 3:
        raise ValueError("a row needs a wavelength and an index")
    if any(row[2] > 0.0 for row in rows):
        raise ValueError("an extinction above 0, which amplifies light")
    return MeasuredIndex(
        wavelengths_nm=tuple(row[0] for row in rows),
        index=tuple(row[1] for row in rows),
        extinction=tuple(0.0 - row[2] for row in rows) if any(row[2] for row in rows) else (),
    )


def _repeated(layers: list[Layer], groups: list[int]) -> list[Layer]:
    """Expand groups of layers; the first and last layer of a group carry its repeat count."""
    made: list[Layer] = []
    at = 0
    while at < len(layers):
        times = groups[at]
        if times < 1:
            made.append(layers[at])
            at += 1
            continue
        end = next((i for i in range(at + 1, len(groups)) if groups[i] == times), None)
        if end is None:
            raise ValueError(f"a group of layers with number {times} has no end")
        made += layers[at : end + 1] * times
        at = end + 1
    return made


def _fixed(reflected: float, transmitted: float) -> FoundCoating:
    """Return a coating with the same reflectance and transmittance at all angles."""
    lost = 1.0 - reflected - transmitted
    if lost < -_LOST:
        raise ValueError(f"it reflects {reflected:g} and transmits {transmitted:g}, together more than 1")
    how = f"it absorbs {lost:.3g} of the light, which is transmitted here" if lost > _LOST else ""
    return FoundCoating(Coating(reflectance=min(1.0, max(0.0, reflected))), how)


def _by_angle(lines: list[list[str]]) -> FoundCoating:
    """Return a tabulated coating: `ANGL` in degrees, then `WAVE` in µm with Rs, Rp, Ts, Tp at that angle."""
    rows: dict[float, dict[float, float]] = {}
    angle, lost = 0.0, 0.0
    for words in lines:
        if words[0].upper() == "ANGL":
            angle = number(words[1])
        elif words[0].upper() == "WAVE":
            shares = numbers(words[2:6])
            if len(shares) < 4 or not 0.0 <= min(shares) <= max(shares) <= 1.0:
                raise ValueError("a line WAVE needs a wavelength and four shares from 0 to 1")
            reflected, passed = 0.5 * (shares[0] + shares[1]), 0.5 * (shares[2] + shares[3])
            lost = max(lost, 1.0 - reflected - passed)
            rows.setdefault(nanometres(words[1]), {})[angle] = reflected
    angles = sorted({angle for row in rows.values() for angle in row})
    if not angles or any(sorted(row) != angles for row in rows.values()):
        raise ValueError("every wavelength must have every angle")
    said = []
    if angles[-1] < 90.0 or any(row[90.0] != 1.0 for row in rows.values()):
        said.append("at 90 degrees it reflects everything, as every surface does")
    if angles[0] > 0.0:
        said.append(f"below {angles[0]:g} degrees it is taken as constant")
    if lost > _LOST:
        said.append(f"it absorbs up to {lost:.3g} of the light, which is transmitted here")
    wavelengths = sorted(rows)
    inner = [angle for angle in angles if 0.0 < angle < 90.0]
    table = MeasuredReflectance(
        wavelengths_nm=tuple(wavelengths),
        angles_deg=(0.0, *inner, 90.0),
        reflectance=tuple(
            (rows[wave][angles[0]], *(rows[wave][angle] for angle in inner), 1.0) for wave in wavelengths
        ),
    )
    return FoundCoating(Coating(measured=table), "; ".join(said))
