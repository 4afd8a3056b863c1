"""Files that a user names, opened for reading only if they are regular files.

A named pipe would wait for a writer that may never come, a device may never end: neither is opened at all. The refusal
is an `OSError` whose `strerror` says what stands there, so that it ends in the same words as a file that is missing.
"""

import errno
import math
import os
import stat
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path
from typing import Any, TextIO

import numpy as np

_KINDS = {
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def why_no_file(path: Path) -> str:
    """Return in words why a path is no file that can be read."""
    if path.is_dir():
        return "is a folder"
    if not path.exists():
        return "does not exist"
    return _why_irregular(path.stat().st_mode)


def open_regular(path: Path) -> BufferedReader:
    """Open a file for reading its bytes.

    Raises
    ------
    OSError
        It cannot be opened, or is a folder, a pipe, a socket or a device.
    """
    return open(path, "rb", opener=_opened)


def open_text(path: Path, encoding: str = "utf-8-sig", errors: str | None = None, newline: str | None = None) -> TextIO:
    """Open a file for reading its text.

    Parameters
    ----------
    path : Path
    encoding, errors, newline : str, optional
        As `open` takes them. A byte order mark before UTF-8 is no text.

    Raises
    ------
    OSError
        As from `open_regular`.
    """
    return open(path, encoding=encoding, errors=errors, newline=newline, opener=_opened)


def read_bytes(path: Path) -> bytes:
    """Return what a regular file holds; errors as of `open_regular`."""
    with open_regular(path) as file:
        return file.read()


def read_text(path: Path, encoding: str = "utf-8-sig", errors: str | None = None) -> str:
    """Return the text of a regular file; errors as of `open_regular`, and those of its decoding.

    Parameters
    ----------
    path : Path
    encoding, errors : str, optional
        As for `open_text`.
    """
    with open_text(path, encoding, errors) as file:
        return file.read()


@contextmanager
def open_arrays(path: Path) -> Iterator["Arrays"]:
    """Open numpy's `.npz`; errors as of `open_regular`, and of numpy's and zip's readers."""
    with open_regular(path) as opened, zipfile.ZipFile(opened) as archive:
        yield Arrays(archive)


class Arrays:
    """Arrays of an `.npz` file, each of which is unpacked when it is asked for, and not before.

    Parameters
    ----------
    archive : ZipFile
    """

    def __init__(self, archive: zipfile.ZipFile) -> None:
        self._archive = archive

    @property
    def names(self) -> list[str]:
        """Names of the arrays."""
        return [name.removesuffix(".npy") for name in self._archive.namelist()]

    def announced(self, name: str) -> tuple[tuple[int, ...], int]:
        """Return the shape and the number of bytes of an array, as its header says.

        Raises
        ------
        KeyError
            There is none.
        ValueError
            It is no array.
        """
        with self._archive.open(f"{name}.npy") as member:
            old = np.lib.format.read_magic(member) == (1, 0)
            read_header = np.lib.format.read_array_header_1_0 if old else np.lib.format.read_array_header_2_0
            shape, _, kind = read_header(member)
            return shape, math.prod(shape) * kind.itemsize

    def __getitem__(self, name: str) -> np.ndarray[Any, Any]:
        with self._archive.open(f"{name}.npy") as member:
            return np.asarray(np.lib.format.read_array(member, allow_pickle=False))


def _opened(path: str, flags: int) -> int:
    """Open a path; what is no regular file is not touched, nor waited for if it takes the place of one meanwhile."""
    _refuse_irregular(os.stat(path), path)  # noqa: PTH116  # what `open` passes on is text
    handle = os.open(path, flags | getattr(os, "O_NONBLOCK", 0))
    try:
        _refuse_irregular(os.fstat(handle), path)
    except OSError:
        os.close(handle)
        raise
    return handle


def _refuse_irregular(state: os.stat_result, path: str) -> None:
    """Raise if a path is a pipe, a socket or a device; of a folder `open` speaks itself."""
    if not stat.S_ISREG(state.st_mode) and not stat.S_ISDIR(state.st_mode):
        raise OSError(errno.EINVAL, f"it {_why_irregular(state.st_mode)}", path)


def _why_irregular(mode: int) -> str:
    kind = _KINDS.get(stat.S_IFMT(mode), "something else")
    way = ": save what comes through it as a file" if stat.S_ISFIFO(mode) else ""
    return f"is no regular file but {kind}{way}"
