"""Files that a mesh file refers to, such as materials and pictures. Only those in its folder or below are opened."""

import os
from pathlib import Path

from lfmesh.errors import MeshError


def check_companion(path: Path, name: str, kind: str) -> None:
    """Raise if a mesh refers to a file outside its folder: a mesh from elsewhere must not open other files.

    Parameters
    ----------
    path : Path
        The mesh file.
    name : str
        The other file, relative to the mesh's folder.
    kind : str
        Kind of file in messages, such as "picture".

    Raises
    ------
    MeshError
        The file is elsewhere or not regular, or its name is impossible.
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
        raise MeshError(f"{path}: its {kind} {name} is not a regular file")
