"""CODE V multilayer files (`.mul`), each with the layers of one coating.

The format is undocumented. The layout follows the authors of TFStudio (github.com/aai2k/TFStudio, its reader of CODE V
coatings), who examined files of CODE V 11.2 and its samples, formats 6 and 5: blocks of integers or reals, each on its
own lines. A block of counts gives the lengths of the following blocks. Media run from the incident one to the
substrate. Each has a thickness in waves, n d / λ at the reference wavelength λ, and either n and k or the place of a
material. The catalogue holds groups of tables (wavelengths in µm, then a word, n and k of each material), then n and k
of the materials in use at the analysis wavelengths. Integers beside it link its parts.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from lfmesh.errors import SceneError
from lfmesh.imports.coatings import FoundCoating, UnreadableCoatingError
from lfmesh.imports.numbers import number, numbers
from lfmesh.imports.text import read_lines
from lfmesh.scene.materials.coatings import Coating, Layer, MeasuredIndex

FORMATS = ("5", "6")
HEAD, COUNTS, UNKNOWN, TARGETS = 5, 45, 12, 4
"""Sizes of the integer blocks before the media, and the number of blocks with one real per wavelength."""
MEDIA, WAVELENGTHS, CATALOGUE, SETTINGS, INTERFACES, SAMPLED = 16, 17, 18, 22, 26, 35
"""Places of lengths among the counts (the media, ...), and of the start of the catalogue's second part."""
REFERENCE = 6
"""Place of the reference wavelength among the settings."""
LABEL = 10
"""Columns of a label, and of the field before the first one of each line."""

_WITHOUT_E = re.compile(r"(?<=[\d.])(?:[Dd]|(?=[+-]))(?=[+-]?\d+$)")
"""Place of the missing E before the exponent of a Fortran real."""

_ORDER = (
    "its layers are read from the incident medium onwards: from the air to the glass, between two glasses from the "
    "object to the sensor"
)


@dataclass(frozen=True)
class _Blocks:
    """Lines of a file, read block by block."""

    lines: Iterator[str]

    def line(self) -> str:
        """Return the next line."""
        for line in self.lines:
            return line
        raise ValueError("it is cut short")

    def reals(self, count: int) -> list[float]:
        """Return the numbers of a block."""
        words = list[str]()
        while len(words) < count:
            words += self.line().split()
        if len(words) > count:
            raise ValueError(f"{len(words)} numbers in a block of {count}")
        return numbers([_WITHOUT_E.sub("E", word) for word in words])

    def integers(self, count: int) -> list[int]:
        """Return the integers of a block."""
        return [int(value) for value in self.reals(count)]

    def labels(self) -> list[str]:
        """Return the labels of a block, arranged in columns after their number."""
        labels, count = list[str](), None
        while count is None or len(labels) < count:
            line = self.line()
            count = int(number(line[:LABEL])) if count is None else count
            columns = range(LABEL, len(line.rstrip()), LABEL)
            labels += [line[place : place + LABEL].strip() for place in columns]
        return labels


def multilayer(path: Path) -> FoundCoating:
    """Return the coating of a multilayer file.

    Parameters
    ----------
    path : Path

    Raises
    ------
    UnreadableCoatingError
        The file is missing or cannot be read.
    """
    try:
        blocks = _Blocks(iter(read_lines(path)))
        return FoundCoating(_coating(blocks), _ORDER)
    except SceneError as error:
        raise UnreadableCoatingError(f"{path.name}: {str(error).removeprefix(f'{path}: ')}") from None
    except (ValueError, IndexError, KeyError, ZeroDivisionError) as error:
        why = error if isinstance(error, ValueError) else "its parts are inconsistent"
        raise UnreadableCoatingError(f"{path.name} is not a readable multilayer file: {why}") from None


def _coating(blocks: _Blocks) -> Coating:
    kind = blocks.line().split()[:1]
    if kind not in ([each] for each in FORMATS):
        raise ValueError(f"its first line does not name the format {' or '.join(FORMATS)}")
    _title, _date = blocks.line(), blocks.line()
    blocks.integers(HEAD)
    counts = blocks.integers(COUNTS)
    blocks.integers(UNKNOWN)
    media, waves, size, start = (counts[place] for place in (MEDIA, WAVELENGTHS, CATALOGUE, SAMPLED))
    if min(waves, size, start) < 1 or media < 3 or counts[INTERFACES] != media - 1:
        raise ValueError("its counts are inconsistent")
    # Thickness codes for the coating's design.
    blocks.integers(media)
    places, links = blocks.integers(media), blocks.integers(size)
    reference_nm = 1e3 * blocks.reals(counts[SETTINGS])[REFERENCE]
    sampled_nm = _nanometres(blocks.reals(waves))
    for _ in range(TARGETS):
        blocks.reals(waves)
    thicknesses, extinctions, indices = (blocks.reals(media) for _ in range(3))
    labels, catalogue = blocks.labels(), blocks.reals(size)
    materials = _materials(catalogue, links, labels, sampled_nm, start)
    layers = []
    for place, waves_thick, k, n in list(zip(places, thicknesses, extinctions, indices, strict=True))[1:-1]:
        own = {"index": n, "extinction": k} if place < 0 else {"measured": materials[place]}
        layers.append(Layer(thickness_nm=waves_thick * reference_nm / n, **own))
    from_glass = indices[-1] == 1.0 < indices[0]
    return Coating(layers=tuple(layers[::-1] if from_glass else layers))


def _materials(
    catalogue: list[float], links: list[int], labels: list[str], sampled_nm: list[float], start: int
) -> dict[int, MeasuredIndex]:
    """Return the materials in use by the place (from 1) of their second part in the catalogue."""
    tables = list(_tables(catalogue, links)) if start > 1 else []
    by_label = dict(zip(labels, tables, strict=False))
    count, materials = len(sampled_nm), dict[int, MeasuredIndex]()
    places = range(start, len(catalogue), 2 * count + 1)
    if len(labels) != len(tables) + len(places):
        raise ValueError("its labels do not match its catalogue")
    for label, place in zip(labels[len(tables) :], places, strict=True):
        rows = _rows(sampled_nm, catalogue, place) | by_label.get(label, {})
        nm = sorted(rows)
        n, k = zip(*(rows[wave] for wave in nm), strict=True)
        materials[place] = MeasuredIndex(wavelengths_nm=nm, index=n, extinction=k)
    return materials


def _rows(nm: list[float], catalogue: list[float], place: int) -> dict[float, tuple[float, float]]:
    """Return n and k by wavelength for the material with its word at a place, from 1."""
    count = len(nm)
    return {nm[i]: (catalogue[place + i], catalogue[place + count + i]) for i in range(count)}


def _tables(catalogue: list[float], links: list[int]) -> Iterator[dict[float, tuple[float, float]]]:
    """Yield the given n and k of each material by wavelength, nm.

    The links at the start of a group give the number of wavelengths and the place of the first material's word. The
    link behind each word gives the next word or group, 0 after the last.
    """
    start, nm = 1, list[float]()
    while start:
        if links[start - 1] > 0:
            word = links[start]
            nm = _nanometres(catalogue[start - 1 : start - 1 + links[start - 1]])
        else:
            word = start
        yield _rows(nm, catalogue, word)
        start, before = links[word], start
        if start and start <= before:
            raise ValueError("its catalogue runs backwards")


def _nanometres(micrometres: list[float]) -> list[float]:
    """Return wavelengths in nm, undoing the rounding to single precision."""
    return [round(1e3 * value, 3) for value in micrometres]
