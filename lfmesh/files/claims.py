"""Claims on run folders: one process at a time renders or saves a run there."""

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
"""File in a run folder that names the owning process; locked while that process renders or saves."""


def refuse_claimed(folder: Path) -> None:
    """Refuse a folder in which another process is rendering or saving a run.

    Raises
    ------
    FileError
        Another process, named in the message, owns the folder.
    """
    try:
        # Under the folder's lock nobody else tries to lock the claim.
        with locked(folder), locked(folder / CLAIM, wait=False) as free:
            owner = read_text(folder / CLAIM) if free is False else ""
    except (OSError, ValueError):
        return
    if free is False and owner != _this_process():
        raise _taken(folder, owner)


@contextmanager
def claimed(folder: Path, *, again: bool = False) -> Iterator[None]:
    """Claim a folder for this process while the body renders or saves a run.

    Parameters
    ----------
    folder : Path
    again : bool
        Accept a claim that this process already holds.

    Raises
    ------
    OSError
        The folder cannot be written.
    FileError
        The folder is claimed by another process, or by this one without `again`.
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
            # Under the folder's lock nobody opens the claim before it is removed and locks it afterwards.
            with suppress(OSError), locked(folder):
                (folder / CLAIM).unlink()
            os.close(handle)


def _claim(folder: Path) -> int | str | None:
    """Return the handle of a new claim, the process that holds one, or None without locks."""
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
        f"{folder}: process {owner} is rendering into it or saving a run there: wait until it ends, or give another"
        " folder"
    )


def _this_process() -> str:
    return f"{os.getpid()} on {platform.node()}"
