"""VTK image data (.vti): voxel grids of media, as written by ParaView and pyvista."""

import math
import re
import subprocess
import sys
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any
from xml.parsers.expat import ExpatError, ParserCreate

import numpy as np

from lfmesh.errors import FileError
from lfmesh.imports import vtk_child
from lfmesh.regular_file import open_regular, why_no_file
from lfmesh.scene.inputs import file_stamp

NOT_TURNED = 1e-9
"""Largest deviation of the image axes' direction cosines from x, y and z."""


LIBRARY_BYTES, BYTES_A_POINT, BYTES_A_BYTE = 4 << 30, 64, 20
"""Memory limit of a reader: fixed part, per point, and per byte of the file."""

MOST_SECONDS = 600
"""Time limit of a reader."""

NOTHING = (0, -1, 0, -1, 0, -1)
"""Empty extent."""

_NUMBER = re.compile(r"-?[0-9]{1,18}")


class _DataReachedError(Exception):
    """The parser has reached data that may not be text."""


def read_vtk_image(path: Path, known: tuple[str, ...], quantity: str | None, most: int) -> dict[str, Any]:
    """Read the quantities of a grid, with `spacing_mm` and `origin_mm`; lengths in the file are mm.

    Point data are values of voxels centred on the points, cell data of voxels equal to the cells. Arrays with other
    names are ignored.

    Parameters
    ----------
    path : Path
    known : tuple of str
        Names of quantities.
    quantity : str, optional
        Meaning of the file's only array if it has another name.
    most : int
        Largest number of voxels.

    Raises
    ------
    FileError
        The file cannot be read, declares more voxels, holds no quantity, or has rotated axes.
    """
    if not path.is_file():
        raise FileError(f"{path}: cannot be read as VTK image data: it {why_no_file(path)}")
    extents = _extents(path, file_stamp(path))
    if (voxels := _cells(extents[0])) > most:
        raise FileError(
            f"{path}: has {voxels} voxels or more; at most {most} are read: crop the grid, or make its voxels larger"
        )
    _check_pieces(path, *extents)
    if not _is_survived(path.resolve(), file_stamp(path)):
        raise FileError(f"{path}: cannot be read as VTK image data: it is damaged")
    import pyvista
    from vtkmodules.vtkCommonCore import vtkObject

    # VTK reports faults on standard error, line by line, and returns something empty.
    shown = vtkObject.GetGlobalWarningDisplay()
    vtkObject.GlobalWarningDisplayOff()
    try:
        image = pyvista.read(path)
    except Exception as error:
        # The reader may raise anything for a damaged file.
        raise FileError(f"{path}: cannot be read as VTK image data: {' '.join(str(error).split())}") from None
    finally:
        vtkObject.SetGlobalWarningDisplay(shown)
    if not isinstance(image, pyvista.ImageData) or 0 in image.dimensions:
        raise FileError(f"{path}: cannot be read as VTK image data: it is damaged, or no image")
    if np.abs(np.asarray(image.direction_matrix) - np.eye(3)).max() > NOT_TURNED:
        raise FileError(f"{path}: its axes are rotated; write it along x, y and z, and give rotation_deg to the medium")
    dimensions = np.array(image.dimensions)
    spacing, origin = np.array(image.spacing, float), np.array(image.origin, float)
    # First point numbers of a part cut from a larger image.
    origin = origin + spacing * np.array(image.GetExtent()[::2])
    kinds = (
        (image.point_data, dimensions, origin),
        (image.cell_data, np.maximum(dimensions - 1, 1), origin + 0.5 * spacing),
    )
    found = []
    for data, shape, first in kinds:
        names = [name for name in data if name in known]
        arrays = {name: np.asarray(data[name]) for name in names}
        if quantity is not None and not names and len(data.keys()) == 1:
            arrays = {quantity: np.asarray(data[data.keys()[0]])}
        if arrays:
            found.append((arrays, shape, first))
    if len(found) != 1:
        what = "holds quantities both at points and in cells" if found else "holds no quantity"
        held = ", ".join([*image.point_data.keys(), *image.cell_data.keys()]) or "no arrays"
        raise FileError(f"{path}: {what}; known are {', '.join(known)}; the file has {held}")
    arrays, shape, first = found[0]
    for name, array in arrays.items():
        if array.shape != (int(np.prod(shape)),):
            raise FileError(f"{path}: {name} must have one number for each voxel, but has the shape {array.shape}")
    # In VTK, x varies fastest.
    read: dict[str, Any] = {name: array.reshape(tuple(shape), order="F") for name, array in arrays.items()}
    return read | {"spacing_mm": spacing, "origin_mm": first}


@lru_cache(maxsize=64)
def _is_survived(path: Path, stamp: tuple[object, ...]) -> bool:
    """Tell whether VTK can read the file with this stamp within its memory limit and without crashing."""
    extent = _extents(path, stamp)[0]
    points = math.prod(max(last - first + 1, 0) for first, last in zip(extent[::2], extent[1::2], strict=True))
    most = LIBRARY_BYTES + BYTES_A_POINT * points + BYTES_A_BYTE * path.stat().st_size
    # Without -m: see `geometry.files.cad_file`.
    command = [sys.executable, "-P", vtk_child.__file__, str(path), str(min(most, sys.maxsize))]
    try:
        return subprocess.run(command, capture_output=True, timeout=MOST_SECONDS, check=False).returncode == 0
    except subprocess.TimeoutExpired:
        return False


@lru_cache(maxsize=64)
def _extents(path: Path, _: tuple[object, ...]) -> tuple[tuple[int, ...], ...]:
    """Return the extents of the whole image and of its pieces, for the file with this stamp.

    An extent holds the first and last point along x, y and z; (0, -1, 0, -1, 0, -1) if unreadable, which limits VTK to
    the memory of an empty image.
    """
    found: dict[str, list[tuple[int, ...]]] = {"ImageData": [], "Piece": []}

    def begin(name: str, attributes: dict[str, str]) -> None:
        if name == "AppendedData":
            raise _DataReachedError
        if name in found:
            found[name].append(_extent(attributes.get("WholeExtent" if name == "ImageData" else "Extent", "")))

    parser = ParserCreate()
    parser.StartElementHandler = begin
    # VTK reports damage in more detail.
    with suppress(_DataReachedError, ExpatError), open_regular(path) as file:
        parser.ParseFile(file)
    return (found["ImageData"] or [NOTHING])[0], *found["Piece"]


def array_names(path: Path) -> tuple[str, ...]:
    """Return the names of the arrays of an image, without reading data; none if the file cannot be read.

    Parameters
    ----------
    path : Path
    """
    return _array_names(path, file_stamp(path))


@lru_cache(maxsize=64)
def _array_names(path: Path, _: tuple[object, ...]) -> tuple[str, ...]:
    """Return the names of the arrays of the file with this stamp."""
    names: list[str] = []

    def begin(name: str, attributes: dict[str, str]) -> None:
        if name == "AppendedData":
            raise _DataReachedError
        if name == "DataArray" and "Name" in attributes:
            names.append(attributes["Name"])

    parser = ParserCreate()
    parser.StartElementHandler = begin
    with suppress(_DataReachedError, ExpatError, OSError), open_regular(path) as file:
        parser.ParseFile(file)
    return tuple(names)


def _extent(text: str) -> tuple[int, ...]:
    words = text.split()
    known = len(words) == 6 and all(_NUMBER.fullmatch(word) for word in words)
    return tuple(map(int, words)) if known else NOTHING


def _cells(extent: tuple[int, ...]) -> int:
    """Return the number of cells in an extent; a direction with a single point counts as one."""
    ends = zip(extent[::2], extent[1::2], strict=True)
    return math.prod(0 if last < first else max(last - first, 1) for first, last in ends)


def _check_pieces(path: Path, whole: tuple[int, ...], *pieces: tuple[int, ...]) -> None:
    """Raise if the pieces do not make up the image: VTK would leave voxels uninitialised, or data unread."""
    for piece in pieces:
        for axis in range(3):
            (first, last), (low, high) = whole[2 * axis : 2 * axis + 2], piece[2 * axis : 2 * axis + 2]
            if low < first or high > last:
                raise FileError(
                    f"{path}: its Piece has the points {low} to {high} along {'xyz'[axis]}, but its WholeExtent "
                    f"{first} to {last}: they must agree; write it again"
                )
    held, wanted = sum(map(_cells, pieces)), _cells(whole)
    if pieces and held != wanted:
        raise FileError(
            f"{path}: its pieces have {held} voxels, but its WholeExtent {wanted}: they must agree; write it again"
        )
