"""Files that a scene reads, and files that a run was rendered with."""

import hashlib
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

from pydantic import AfterValidator, BaseModel

from lfmesh.errors import FileError
from lfmesh.regular_file import open_regular
from lfmesh.scene.quantities import FilePath

COPIES = "inputs"
"""Folder of a run that holds copies of the scene's input files."""

FRESH_NS = 3_000_000_000
"""Age below which file times cannot show that a file was written twice (FAT's resolution is two seconds)."""

STAMPED_FILES = 1024
"""Number of files that a cache keyed by stamps remembers."""

_MARKS = [mark for mark in get_args(FilePath) if isinstance(mark, AfterValidator)]


def files_of(model: BaseModel, where: str = "") -> Iterator[tuple[str, str]]:
    """Yield the files that a model and its parts name, as pairs of key path (see `Scene.changed`) and file path.

    Lens files are excluded: the scene contains their contents.
    """
    for key, field in type(model).model_fields.items():
        value = getattr(model, key)
        place = f"{where}.{key}" if where else key
        if isinstance(value, str):
            if any(mark in field.metadata for mark in _MARKS) or _names_a_file(field.annotation):
                yield place, value
        elif isinstance(value, BaseModel):
            yield from files_of(value, place)
        elif isinstance(value, dict):
            for name, item in value.items():
                if isinstance(item, BaseModel):
                    yield from files_of(item, f"{place}.{name}")
        elif isinstance(value, tuple):
            for number, item in enumerate(value):
                if isinstance(item, BaseModel):
                    yield from files_of(item, f"{place}[{number}]")


def _names_a_file(annotation: Any) -> bool:
    """Tell whether a type is `FilePath` or a union that contains it."""
    arguments = get_args(annotation)
    return any(mark in arguments for mark in _MARKS) or any(_names_a_file(argument) for argument in arguments)


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a file's bytes."""
    with open_regular(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def file_stamp(path: Path) -> tuple[object, ...]:
    """Return a stamp that changes with a file's contents, or () if the file is missing.

    Two writes within one clock tick leave the same times, so the stamp of a file that just changed includes its digest.
    """
    try:
        state = path.stat()
        stamp = state.st_dev, state.st_ino, state.st_size, state.st_mtime_ns, state.st_ctime_ns
        fresh = abs(time.time_ns() - max(state.st_mtime_ns, state.st_ctime_ns)) < FRESH_NS
        return (*stamp, digest_of(path)) if fresh else stamp
    except OSError:
        return ()


def found(path: Path, digest: str, folder: Path) -> Path:
    """Find the file that a run was rendered with: at its path, or by name in the run's folder or beside it.

    Parameters
    ----------
    path : Path
        Path that the scene gives.
    digest : str
        SHA-256 of the file when the run began.
    folder : Path
        Folder of the run.

    Raises
    ------
    FileError
        The file is missing or its contents have changed.
    """
    places = dict.fromkeys([path, folder / COPIES / path.name, folder / path.name, folder.parent / path.name])
    present = [place for place in places if place.is_file()]
    for place in present:
        if digest_of(place) == digest:
            return place
    if present:
        raise FileError(f"{present[0]} has changed since the run began; restore the original")
    raise FileError(f"{path} is missing, but the run began with it; restore it, or put it beside {folder}")
