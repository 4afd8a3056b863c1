"""VTK image data (.vti): voxel grids of media, as ParaView and pyvista write them."""

import math
import re
import subprocess
import sys
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from lfmesh.errors import FileError
from lfmesh.imports import vtk_child
from lfmesh.regular_file import open_regular, why_no_file
from lfmesh.scene.inputs import file_stamp

NOT_TURNED = 1e-9
"""Largest entry by which the axes of an image may differ from x, y and z."""


HEAD = 1 << 20
"""Bytes at the beginning of a file in which it says how large it is."""

LIBRARY_BYTES, BYTES_A_POINT, BYTES_A_BYTE = 4 << 30, 64, 20
"""Memory that reading a file may take: whatever it holds, for each point, for each byte of the file."""

MOST_SECONDS = 600
"""To read it."""

_EXTENT = re.compile(rb"""WholeExtent\s*=\s*["']([^"']*)["']""")


def read_vtk_image(path: Path, known: tuple[str, ...], quantity: str | None, most: int) -> dict[str, Any]:
    """Read the quantities of a grid, with `spacing_mm` and `origin_mm`; lengths in the file are mm.

    Values at points are those of voxels about the points; values in cells those of voxels that are the cells. Arrays
    with other names are left alone.

    Parameters
    ----------
    path : Path
    known : tuple of str
        Names of quantities.
    quantity : str, optional
        What the file's only array is, where it has another name.
    most : int
        Largest number of voxels.

    Raises
    ------
    FileError
        The file cannot be read, announces more voxels, holds no quantity, or its axes are turned.
    """
    import pyvista
    from vtkmodules.vtkCommonCore import vtkObject

    if not path.is_file():
        raise FileError(f"{path}: cannot be read as VTK image data: it {why_no_file(path)}")
    if (cells := math.prod(max(points - 1, 1) for points in _announced(path))) > most:
        raise FileError(
            f"{path}: has {cells} voxels or more; at most {most} are read: crop the grid, or make its voxels larger"
        )
    if not _is_survived(path.resolve(), file_stamp(path)):
        raise FileError(f"{path}: cannot be read as VTK image data: it is damaged")
    # VTK says on standard error what is wrong with a file, line by line, and returns something empty.
    shown = vtkObject.GetGlobalWarningDisplay()
    vtkObject.GlobalWarningDisplayOff()
    try:
        image = pyvista.read(path)
    except Exception as error:
        # Of a damaged file the reader may raise anything.
        raise FileError(f"{path}: cannot be read as VTK image data: {' '.join(str(error).split())}") from None
    finally:
        vtkObject.SetGlobalWarningDisplay(shown)
    if not isinstance(image, pyvista.ImageData) or 0 in image.dimensions:
        raise FileError(f"{path}: cannot be read as VTK image data: it is damaged, or no image")
    if np.abs(np.asarray(image.direction_matrix) - np.eye(3)).max() > NOT_TURNED:
        raise FileError(f"{path}: its axes are turned; write it along x, y and z, and give rotation_deg to the medium")
    dimensions = np.array(image.dimensions)
    spacing, origin = np.array(image.spacing, float), np.array(image.origin, float)
    # The numbers of the first points, of a part that was cut out of a larger image.
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
        raise FileError(f"{path}: {what}; there are {', '.join(known)}, and in the file {held}")
    arrays, shape, first = found[0]
    for name, array in arrays.items():
        if array.shape != (int(np.prod(shape)),):
            raise FileError(f"{path}: {name} must have one number for each voxel, and has the shape {array.shape}")
    # VTK counts x fastest.
    read: dict[str, Any] = {name: array.reshape(tuple(shape), order="F") for name, array in arrays.items()}
    return read | {"spacing_mm": spacing, "origin_mm": first}


@lru_cache(maxsize=64)
def _is_survived(path: Path, stamp: tuple[object, ...]) -> bool:
    """Tell whether VTK can read the file with this stamp without crashing and in the memory that it may need."""
    points = math.prod(_announced(path))
    most = LIBRARY_BYTES + BYTES_A_POINT * points + BYTES_A_BYTE * path.stat().st_size
    # Not by -m: see `geometry.files.cad_file`.
    command = [sys.executable, "-P", vtk_child.__file__, str(path), str(min(most, sys.maxsize))]
    try:
        return subprocess.run(command, capture_output=True, timeout=MOST_SECONDS, check=False).returncode == 0
    except subprocess.TimeoutExpired:
        return False


def _announced(path: Path) -> tuple[int, ...]:
    """Return the number of points along each axis that a file announces; (0,) if it does not say."""
    with open_regular(path) as file:
        found = _EXTENT.search(file.read(HEAD))
    words = found[1].split() if found else []
    if len(words) != 6 or not all(re.fullmatch(rb"-?[0-9]{1,18}", word) for word in words):
        # VTK is told to keep to what every file may take.
        return (0,)
    first, last = ([int(word) for word in words[i::2]] for i in (0, 1))
    return tuple(max(b - a + 1, 0) for a, b in zip(first, last, strict=True))
