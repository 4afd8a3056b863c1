"""Files that a mesh file names, such as materials and pictures: only those beside it or below are opened."""

import os
from pathlib import Path

from lfmesh.errors import MeshError


def check_companion(path: Path, name: str, kind: str) -> None:
    """Raise if a file that a mesh names lies outside its folder: a mesh from elsewhere must not open other files.

    Parameters
    ----------
    path : Path
        Of the mesh.
    name : str
        Name of the other file, as the mesh has it.
    kind : str
        Word for what that file is.
    """
    inside = "\0" not in name and Path(os.path.normpath(path.parent / name)).is_relative_to(
        os.path.normpath(path.parent)
    )
    if not inside:
        raise MeshError(f"{path}: its {kind} {name!r} is outside the mesh's folder; put it beside the mesh")
    try:
        irregular = (path.parent / name).exists() and not (path.parent / name).is_file()
    except OSError as error:
        raise MeshError(f"{path}: its {kind} {name[:200]!r}: {error.strerror}") from None
    if irregular:
        raise MeshError(f"{path}: its {kind} {name} is no regular file")
