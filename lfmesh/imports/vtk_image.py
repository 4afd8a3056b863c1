"""VTK image data (.vti): voxel grids of media, as ParaView and pyvista write them."""

from pathlib import Path
from typing import Any

import numpy as np

from lfmesh.errors import FileError

NOT_TURNED = 1e-9
"""Largest entry by which the axes of an image may differ from x, y and z."""


def read_vtk_image(path: Path, known: tuple[str, ...], quantity: str | None) -> dict[str, Any]:
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

    Raises
    ------
    FileError
        The file cannot be read, holds no quantity, or its axes are turned.
    """
    import pyvista
    from vtkmodules.vtkCommonCore import vtkObject

    if not path.is_file():
        raise FileError(f"{path}: cannot be read as VTK image data: no such file")
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
