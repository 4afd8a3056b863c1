"""Locks on folders, and on files that represent a process."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

from lfmesh.files.inside import NO_LINK

# Windows has no fcntl.
fcntl: Any = import_module("fcntl") if os.name == "posix" else None


def held(path: Path) -> int | None:
    """Lock a folder while the returned handle is open; return None if locking is impossible."""
    if fcntl is None:
        return None
    handle, ours = opened_and_locked(path, os.O_RDONLY | os.O_DIRECTORY | NO_LINK, wait=True)
    if ours:
        return handle
    os.close(handle)
    return None


@contextmanager
def locked(path: Path, *, wait: bool = True) -> Iterator[bool | None]:
    """Hold a lock on a folder or, without waiting, on a file or folder inside one.

    Yields False if another process has the lock, None if locking is unavailable.
    """
    if fcntl is None:
        yield None
        return
    # The user's own folder may be reached through a link, its content may not; and never wait for a pipe.
    handle, ours = opened_and_locked(path, os.O_RDONLY | (os.O_DIRECTORY if wait else NO_LINK), wait=wait)
    try:
        yield ours
    finally:
        os.close(handle)


def opened_and_locked(path: Path, flags: int, *, wait: bool) -> tuple[int, bool | None]:
    """Open and lock a path; return its handle and whether the lock is ours, None if locking is unavailable.

    Parameters
    ----------
    path : Path
    flags : int
        Flags for `os.open`.
    wait : bool
        Wait for another process to release the lock.
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
