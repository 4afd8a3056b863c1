"""Files that a mesh file names, such as materials and pictures: only those beside it or below are opened."""

import os
from pathlib import Path

from lfmesh.errors import MeshError


def check_companion(path: Path, name: str, kind: str) -> None:
    """Raise if a file that a mesh names lies outside its folder: a mesh from elsewhere must not open other files.

    Parameters
    ----------
    path : Path
        The mesh file.
    name : str
        Of the other file, relative to the mesh's folder.
    kind : str
        What it is in messages, such as "picture".

    Raises
    ------
    MeshError
        It lies elsewhere, is no regular file, or its name is impossible.
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
