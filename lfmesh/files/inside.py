"""Changes confined to a folder: no symbolic link is followed.

A folder from elsewhere may hold a link in place of a subfolder, so each subfolder is opened relative to the handle of
its parent, which fails on a link. On Windows, which lacks such handles, each is checked before use.
"""

import errno
import os
import stat
from contextlib import ExitStack
from pathlib import Path, PurePosixPath
from typing import Any

from lfmesh.errors import FileError

NO_LINK: int = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
"""Flags for `os.open` to neither follow a link nor wait for the other end of a pipe."""

_HAS_HANDLES = os.stat in os.supports_dir_fd and hasattr(os, "O_DIRECTORY")


def is_link(path: Path) -> bool:
    """Tell whether a path is a symbolic link or a Windows junction."""
    try:
        state = path.lstat()
    except OSError:
        return False
    junction = getattr(stat, "IO_REPARSE_TAG_MOUNT_POINT", -1)
    return stat.S_ISLNK(state.st_mode) or getattr(state, "st_reparse_tag", 0) == junction


def opened_here(path: str, flags: int) -> int:
    """Open a regular file for writing, as `opener` of `open`; never follow a link.

    Raises
    ------
    OSError
        The path is a link or not a regular file.
    """
    if is_link(Path(path)):
        raise OSError(errno.ELOOP, "it is a link", path)
    handle = os.open(path, flags | NO_LINK, 0o666)
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise OSError(errno.EINVAL, "it is not a regular file", path)
    return handle


def refuse_link(path: Path) -> None:
    """Refuse a link in place of a folder that lfmesh makes.

    Parameters
    ----------
    path : Path

    Raises
    ------
    FileError
        It is a link.
    """
    if is_link(path):
        raise FileError(
            f"{path} is a link, and lfmesh changes nothing outside of {path.parent}: put the folder itself there, or "
            "choose another folder"
        )


class Inside:
    """Context manager for the files inside a folder, by names with / between folders.

    Parameters
    ----------
    folder : Path
        May be reached through links.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._handles: dict[PurePosixPath, int] = {}
        self._closed = ExitStack()

    def __enter__(self) -> "Inside":
        if _HAS_HANDLES:
            self._keep(PurePosixPath(), os.open(self.folder, os.O_RDONLY | os.O_DIRECTORY))
        return self

    def __exit__(self, *_: object) -> None:
        self._closed.close()

    def has(self, name: str) -> bool:
        """Tell whether a name exists.

        Raises
        ------
        FileError
            A folder on the way is a link.
        """
        return self._mode(name) is not None

    def refuse_irregular(self, name: str) -> None:
        """Refuse anything but a regular file or a missing one.

        Raises
        ------
        FileError
            It is a link, folder, pipe etc., or a folder on the way is a link.
        """
        mode = self._mode(name)
        if mode is not None and not stat.S_ISREG(mode):
            raise FileError(f"{self.folder / name} is not a regular file, as lfmesh writes it: delete it")

    def move(self, name: str, other: str) -> None:
        """Move a file, replacing any other; make the folders needed.

        Raises
        ------
        OSError
            It cannot be moved.
        FileError
            A folder on the way is a link.
        """
        self._make(PurePosixPath(other).parent)
        (source, before), (target, after) = self._at(name), self._at(other)
        os.replace(source, target, src_dir_fd=before, dst_dir_fd=after)

    def remove(self, name: str) -> None:
        """Remove a file, or a link itself, if present.

        Raises
        ------
        OSError
            It cannot be removed.
        FileError
            A folder on the way is a link.
        """
        if self.has(name):
            path, handle = self._at(name)
            os.unlink(path, dir_fd=handle)

    def _mode(self, name: str) -> int | None:
        """Return the mode of a name, None if it does not exist."""
        try:
            path, handle = self._at(name)
            return os.stat(path, dir_fd=handle, follow_symlinks=False).st_mode
        except FileNotFoundError:
            return None

    def _make(self, place: PurePosixPath) -> None:
        """Make a folder and its parents."""
        if place.parts and not self.has(place.as_posix()):
            self._make(place.parent)
            path, handle = self._at(place.as_posix())
            os.mkdir(path, dir_fd=handle)

    def _at(self, name: str) -> tuple[Any, int | None]:
        """Return a path and the handle of the folder that it is relative to."""
        place = PurePosixPath(name)
        if _HAS_HANDLES:
            return place.name, self._handle(place.parent)
        for above in reversed(place.parents):
            if above.parts:
                refuse_link(self.folder / above)
        return self.folder / place, None

    def _handle(self, place: PurePosixPath) -> int:
        """Open a subfolder through the handle of its parent."""
        if place not in self._handles:
            above = self._handle(place.parent)
            try:
                handle = os.open(place.name, os.O_RDONLY | os.O_DIRECTORY | NO_LINK, dir_fd=above)
            except FileNotFoundError:
                raise
            except OSError:
                refuse_link(self.folder / place)
                raise
            self._keep(place, handle)
        return self._handles[place]

    def _keep(self, place: PurePosixPath, handle: int) -> None:
        self._handles[place] = handle
        self._closed.callback(os.close, handle)
