"""Claims on run folders: one process at a time renders into a folder or saves a run there."""

import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from lfmesh.errors import FileError
from lfmesh.files.inside import NO_LINK
from lfmesh.files.locks import fcntl, locked, opened_and_locked
from lfmesh.regular_file import read_text

CLAIM = ".lfmesh-rendering"
"""Stands in a run folder and is locked while a run is saved there, or rendered that will be; it names the process."""


def refuse_claimed(folder: Path) -> None:
    """Refuse a folder into which another process renders or saves a run.

    Raises
    ------
    FileError
        Naming the process.
    """
    try:
        # Under the folder's lock nobody else tries the claim's own.
        with locked(folder), locked(folder / CLAIM, wait=False) as free:
            owner = read_text(folder / CLAIM) if free is False else ""
    except (OSError, ValueError):
        return
    if free is False and owner != _this_process():
        raise _taken(folder, owner)


@contextmanager
def claimed(folder: Path, *, again: bool = False) -> Iterator[None]:
    """Claim a folder for a run of this process while the body renders or saves it.

    Parameters
    ----------
    folder : Path
    again : bool
        Let this process in where it has claimed the folder already, as a render that saves.

    Raises
    ------
    OSError
        It cannot be written.
    FileError
        Another process has claimed it, or this one has.
    """
    handle = _claim(folder)
    if isinstance(handle, str):
        if handle != _this_process():
            raise _taken(folder, handle)
        if not again:
            raise FileError(f"{folder}: this process is rendering into it already: give another folder")
        handle = None
    try:
        yield
    finally:
        if handle is not None:
            # Nobody opens the claim before it is gone and locks it afterwards.
            with suppress(OSError), locked(folder):
                (folder / CLAIM).unlink()
            os.close(handle)


def _claim(folder: Path) -> int | str | None:
    """Return the handle of a new claim, or the process that has claimed a folder; None where there are no locks."""
    if fcntl is None:
        return None
    path = folder / CLAIM
    with locked(folder):
        handle, ours = opened_and_locked(path, os.O_RDWR | os.O_CREAT | NO_LINK, wait=False)
        if ours:
            try:
                os.ftruncate(handle, 0)
                os.write(handle, _this_process().encode())
            except BaseException:
                os.close(handle)
                raise
            return handle
        with os.fdopen(handle, encoding="utf-8", errors="replace") as file:
            if ours is False:
                return file.read()
        path.unlink()
        return None


def _taken(folder: Path, owner: str) -> FileError:
    return FileError(
        f"{folder}: process {owner} is rendering into it or saving a run there: wait for its end, or give another"
        " folder"
    )


def _this_process() -> str:
    return f"{os.getpid()} on {platform.node()}"
