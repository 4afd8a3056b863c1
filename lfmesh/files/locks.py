"""Locks on folders, and on files that stand for a process."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

from lfmesh.files.inside import NO_LINK

# Windows has none.
fcntl: Any = import_module("fcntl") if os.name == "posix" else None


def held(path: Path) -> int | None:
    """Lock a folder as long as this process has the handle open; None where that cannot be done."""
    if fcntl is None:
        return None
    handle, ours = opened_and_locked(path, os.O_RDONLY | os.O_DIRECTORY | NO_LINK, wait=True)
    if ours:
        return handle
    os.close(handle)
    return None


@contextmanager
def locked(path: Path, *, wait: bool = True) -> Iterator[bool | None]:
    """Hold a lock on a folder, or without waiting on a file or folder inside one.

    Yields False where another has the lock, None where there are no locks.
    """
    if fcntl is None:
        yield None
        return
    # The user's own folder may be reached through a link; what lies in it may not. Neither is a pipe waited for.
    handle, ours = opened_and_locked(path, os.O_RDONLY | (os.O_DIRECTORY if wait else NO_LINK), wait=wait)
    try:
        yield ours
    finally:
        os.close(handle)


def opened_and_locked(path: Path, flags: int, *, wait: bool) -> tuple[int, bool | None]:
    """Open a path and lock it; return its handle and whether the lock is ours, None where there are no locks.

    Parameters
    ----------
    path : Path
    flags : int
        As `os.open` takes them.
    wait : bool
        Wait until another process releases the lock.
    """
    handle = os.open(path, flags, 0o666)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        return handle, True
    except BlockingIOError:
        return handle, False
    except OSError:
        return handle, None
    except BaseException:
        os.close(handle)
        raise
