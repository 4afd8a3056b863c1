"""Material files of OBJ files: colour, opacity and picture of each material.

Wavefront's format has no standard body. The reader follows its description ("MTL material format", Wavefront, 1995):
`Kd` with one number is grey, and the options of `map_Kd` precede the file name.
"""

from dataclasses import dataclass
from pathlib import PurePosixPath

import numpy as np

from lfmesh.geometry.files.piece import Notes
from lfmesh.geometry.files.text_numbers import numbers
from lfmesh.geometry.meshes.mesh import Array

OPTIONS = {
    **dict.fromkeys(("-blendu", "-blendv", "-bm", "-boost", "-cc", "-clamp", "-texres", "-imfchan", "-type"), 1),
    "-mm": 2,
}
"""Options of a picture, and the number of words that follow each. One to three numbers follow -o, -s and -t."""
PLACES = ("-o", "-s", "-t")
WITHOUT_EFFECT = ("-blendu", "-blendv", "-boost", "-texres", "-imfchan", "-type", "-bm")
"""Options that concern filtering, or pictures of heights and single channels."""

MAPS = ("map_", "bump", "norm", "disp", "decal", "refl")
"""Prefixes of keys for pictures."""


@dataclass(frozen=True)
class Map:
    """A picture of a material.

    Attributes
    ----------
    names : tuple of str
        Possible files, relative to the OBJ file's folder.
    offset, scale : (float, float)
        Place in the picture: scale times texture coordinate, plus offset.
    clamped : bool
        True if its edge continues outside.
    """

    names: tuple[str, ...]
    offset: tuple[float, float] = (0.0, 0.0)
    scale: tuple[float, float] = (1.0, 1.0)
    clamped: bool = False


@dataclass
class MtlMaterial:
    """A material of a material file.

    Attributes
    ----------
    name : str
        As written in the file, including a trailing comment.
    colour : (3,) float64
        Linear.
    opacity : float
    picture : Map or None
    """

    name: str
    colour: Array
    opacity: float = 1.0
    picture: Map | None = None


def without_comment(text: str) -> str:
    """Return a value without a trailing comment."""
    return text.partition("#")[0].strip()


def read(text: str, folder: str, notes: Notes) -> list[MtlMaterial]:
    """Return the materials of a material file.

    Parameters
    ----------
    text : str
        Content of the file.
    folder : str
        Its folder, relative to the OBJ file's; "" if the same.
    notes : Notes

    Raises
    ------
    ValueError
        A value is not a number.
    """
    made: list[MtlMaterial] = []
    for line in text.splitlines():
        key, _, value = line.strip().partition(" ") if "\t" not in line else _at_white_space(line)
        key, value = key.lower(), value.strip()
        if key == "newmtl":
            made.append(MtlMaterial(value, np.ones(3)))
        elif made and key and not key.startswith("#"):
            _take(made[-1], key, value, folder, notes)
    return made


def _at_white_space(line: str) -> tuple[str, str, str]:
    words = line.split(None, 1)
    return (words[0] if words else "", " ", words[1] if len(words) > 1 else "")


def _take(material: MtlMaterial, key: str, value: str, folder: str, notes: Notes) -> None:
    """Enter one line into a material."""
    called = f"material {without_comment(material.name)[:60] or '?'}"
    if key == "kd":
        _take_colour(material, without_comment(value), called, notes)
    elif key in ("d", "tr"):
        words = [word for word in without_comment(value).split() if word != "-halo"]
        share = float(np.clip(_finite(" ".join(words[:1]), called, key)[0], 0.0, 1.0))
        material.opacity = share if key == "d" else 1.0 - share
    elif key == "ke":
        if not without_comment(value)[:1].isalpha() and _finite(without_comment(value), called, "Ke").any():
            notes.add(f"{called}: its emission (Ke) is left out")
    elif key == "map_kd":
        material.picture = _map(value, folder, called, notes)
    elif key.startswith(MAPS) and value:
        notes.add(f"{called}: its picture {key} is left out")


def _take_colour(material: MtlMaterial, value: str, called: str, notes: Notes) -> None:
    if value.split(" ")[0] in ("spectral", "xyz"):
        notes.add(f"{called}: Kd {value[:40]} is left out: its facets have the scene's reflectance")
        return
    given = _finite(value, called, "Kd")
    # "If only r is specified, then g and b are assumed to be equal to r."
    colour = np.resize(given, 3) if len(given) == 1 else given[:3]
    if len(colour) != 3:
        raise ValueError(f"{called}: Kd has {len(given)} numbers; valid are 1 or 3")
    if (colour < 0.0).any() or (colour > 1.0).any():
        notes.add(f"{called}: Kd {value[:40]} is taken as the nearest colour from 0 to 1")
    material.colour = np.clip(colour, 0.0, 1.0)


def _finite(value: str, called: str, key: str) -> Array:
    try:
        given = numbers(value)
    except ValueError as error:
        raise ValueError(f"{called}: {key}: {error}") from None
    if not len(given) or not np.isfinite(given).all():
        raise ValueError(f"{called}: {key} is {value[:40]!r}; valid are finite numbers")
    return given


def _map(value: str, folder: str, called: str, notes: Notes) -> Map | None:
    """Return the picture in a line, after its options."""
    words = value.split()
    at = 0
    place: dict[str, tuple[float, float]] = {}
    clamped = False
    while at < len(words) and words[at].lower() in (*OPTIONS, *PLACES):
        option = words[at].lower()
        at += 1
        if option in PLACES:
            given: list[float] = []
            while at < len(words) - 1 and len(given) < 3 and (number := _as_number(words[at])) is not None:
                given.append(number)
                at += 1
            default = 1.0 if option == "-s" else 0.0
            place[option] = (*given, default, default)[:2]  # type: ignore[assignment]
            if option == "-t" and any(given):
                notes.add(f"{called}: the turbulence of its picture (-t) is left out")
            continue
        told = " ".join(words[at : at + OPTIONS[option]]).lower()
        at += OPTIONS[option]
        clamped = clamped or (option, told) == ("-clamp", "on")
        if option == "-mm" and [_as_number(word) for word in told.split()] != [0.0, 1.0]:
            notes.add(f"{called}: the range of its picture (-mm {told[:40]}) is left out")
        if option == "-cc" and told == "on":
            notes.add(f"{called}: the colour correction of its picture (-cc) is left out")
    name = " ".join(words[at:]) if at else value
    names = tuple(named for each in dict.fromkeys((name, without_comment(name))) for named in _beside(each, folder))
    if not names:
        return None
    return Map(names, place.get("-o", (0.0, 0.0)), place.get("-s", (1.0, 1.0)), clamped)


def _beside(name: str, folder: str) -> list[str]:
    """Return the possible places of a file named in a material file: beside it, or beside the OBJ file."""
    name = name.replace("\\", "/").strip("\"' ")
    if not name:
        return []
    return list(dict.fromkeys([(PurePosixPath(folder) / name).as_posix(), name]))


def _as_number(word: str) -> float | None:
    try:
        value = float(word)
    except ValueError:
        return None
    return value if np.isfinite(value) else None
