"""OBJ files: what trimesh passes over in them, and the files of materials and pictures that they name."""

import re
import warnings
from pathlib import Path

from lfmesh.errors import LensFileWarning, MeshError
from lfmesh.geometry.files.companion import check_companion
from lfmesh.regular_file import read_text

_FACET = re.compile(r"^[ \t]*f[ \t]([^#\n]*)", re.MULTILINE)
_CORNER = re.compile(r"(-?\d{1,18})(?:/(-?\d{1,18})?)?(?:/(-?\d{1,18})?)?")
_KINDS = {"v": "vertex", "vt": "texture coordinate", "vn": "normal"}
"""Names of what the numbers of a corner count, by the key of their lines."""

_MATERIAL_FILE = re.compile(r"^[ \t]*mtllib[ \t]+(.+?)\s*$", re.MULTILINE)
_USED, _DEFINED = (re.compile(rf"^[ \t]*{key}[ \t]+(.+?)\s*$", re.MULTILINE) for key in ("usemtl", "newmtl"))
_PICTURE_FILE = re.compile(r"^[ \t]*map_Kd[ \t]+(.+?)\s*$", re.MULTILINE)


def check(path: Path) -> None:
    """Raise what trimesh passes over, corners of nothing or a missing picture; warn of missing materials.

    Raises
    ------
    MeshError
        A facet names a vertex, texture coordinate or normal that is not there, a picture is missing, or a file that
        is named lies elsewhere.
    """
    text = read_text(path, errors="replace")
    _check_corners(path, text)
    missing, defined = [], set[str]()
    for name in _MATERIAL_FILE.findall(text):
        library = path.parent / name
        check_companion(path, name, "material file")
        if not library.is_file():
            missing.append(f"its material file {name} is not there")
            continue
        materials = read_text(library, errors="replace")
        defined.update(_DEFINED.findall(materials))
        for picture in _pictures(materials):
            check_companion(path, (Path(name).parent / picture).as_posix(), "picture")
            if not (library.parent / picture).is_file():
                raise MeshError(f"{library}: its picture {picture} is not there; add it or delete the map_Kd line")
    if not missing and _MATERIAL_FILE.search(text):
        missing = [f"its material {name[:60]} is not defined" for name in sorted(set(_USED.findall(text)) - defined)]
    for what in missing:
        said = f"{path}: {what}: its facets have the material that the scene gives"
        warnings.warn(said, LensFileWarning, stacklevel=2)


def companions(path: Path) -> list[str]:
    """Return the names of the files of materials and pictures that an OBJ file names, relative to its folder."""
    names: list[str] = []
    for name in _MATERIAL_FILE.findall(read_text(path, errors="replace")):
        names.append(name)
        library = path.parent / name
        if library.is_file():
            pictures = _pictures(read_text(library, errors="replace"))
            names += [(Path(name).parent / picture).as_posix() for picture in pictures]
    return names


def _check_corners(path: Path, text: str) -> None:
    """Raise at the first facet that names what the file does not have, counted from 1, or back from -1."""
    given = [(kind, len(re.findall(rf"^[ \t]*{key}[ \t]", text, re.MULTILINE))) for key, kind in _KINDS.items()]
    # Facets share their corners: each is looked at once.
    corners = {corner for facet in _FACET.findall(text) for corner in facet.split()}
    wrong = {corner: fault for corner in corners if (fault := _fault_of(corner, given))}
    if not wrong:
        return
    for facet in _FACET.finditer(text):
        for corner in facet[1].split():
            if corner in wrong:
                line = text.count("\n", 0, facet.start()) + 1
                raise MeshError(f"{path}: line {line}: a facet names {wrong[corner]}")


def _fault_of(corner: str, given: list[tuple[str, int]]) -> str:
    """Return what a corner names that is not there, and how many there are; "" if all is."""
    numbers = _CORNER.fullmatch(corner)
    for number, (kind, count) in zip(numbers.groups() if numbers else (), given, strict=False):
        if number and not 1 <= abs(int(number)) <= count:
            counted = f"there are {count:,}, counted from 1, or back from -1" if count else "there is none"
            return f"{kind} {number}, but {counted}"
    return ""


def _pictures(materials: str) -> list[str]:
    """Return the files of the map_Kd lines of materials: options such as -s 1 1 1 stand before the name."""
    values = _PICTURE_FILE.findall(materials)
    return [value.split()[-1] if value.startswith("-") else value for value in values]
