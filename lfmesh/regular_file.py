"""Files that a user names, opened for reading only if they are regular files.

A named pipe would wait for a writer that may never come, a device may never end: neither is opened at all. The refusal
is an `OSError` whose `strerror` says what stands there, so that it ends in the same words as a file that is missing.
"""

import errno
import math
import os
import stat
import zipfile
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from io import BufferedReader, BytesIO
from pathlib import Path
from typing import IO, Any, NamedTuple, TextIO

import numpy as np

_KINDS = {
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}

MARK = "\ufeff"
"""Byte order mark, which some editors put before a text and which is no part of it."""

MOST_HEADER = 10_000
"""Bytes of an array's header; numpy itself refuses longer ones, but reads them first."""


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


def without_mark(content: bytes) -> bytes:
    """Return the bytes of a text without a byte order mark of UTF-8, for readers that parse bytes."""
    return content.removeprefix(MARK.encode())


class Header(NamedTuple):
    """Shape and kind that an array in numpy's format announces."""

    shape: tuple[int, ...]
    in_columns: bool
    dtype: np.dtype[Any]

    @property
    def size(self) -> int:
        """Number of elements."""
        return math.prod(self.shape)

    @property
    def nbytes(self) -> int:
        """Number of bytes of all elements."""
        return self.size * self.dtype.itemsize


@contextmanager
def open_arrays(path: Path, only: str = "") -> Iterator["Arrays"]:
    """Open numpy's `.npz`, or its `.npy` with a single array.

    Parameters
    ----------
    path : Path
    only : str
        Name of the array of a `.npy` file, which has none.

    Raises
    ------
    OSError
        As from `open_regular`.
    BadZipFile
        It is no archive.
    """
    with open_regular(path) as file:
        if path.suffix.lower() == ".npy":
            yield Arrays([only], lambda _: nullcontext(file))
            return
        with zipfile.ZipFile(file) as archive:
            names = [name.removesuffix(".npy") for name in archive.namelist()]
            yield Arrays(names, lambda name: archive.open(f"{name}.npy"))


class Arrays:
    """Arrays of a file, each of which is read and unpacked when it is asked for, and not before.

    Parameters
    ----------
    names : list of str
    opened : callable
        Opens the array with some name; it begins where that file does.
    """

    def __init__(self, names: list[str], opened: Callable[[str], AbstractContextManager[IO[bytes]]]) -> None:
        self.names = names
        self._opened = opened

    def header(self, name: str) -> Header:
        """Return what the header of an array announces.

        Raises
        ------
        KeyError
            There is none.
        ValueError
            It is no array.
        """
        with self._opened(name) as file:
            return _array_header(file)

    def __getitem__(self, name: str) -> np.ndarray[Any, Any]:
        with self._opened(name) as file:
            return _read_array(file)


def _array_header(file: IO[bytes]) -> Header:
    """Return the header of an array in numpy's format, for which at most `MOST_HEADER` bytes are read.

    Parameters
    ----------
    file : binary file
        The array begins where the file does.

    Raises
    ------
    ValueError
        It is no array.
    """
    file.seek(0)
    head = BytesIO(file.read(MOST_HEADER))
    old = np.lib.format.read_magic(head) == (1, 0)
    read_header = np.lib.format.read_array_header_1_0 if old else np.lib.format.read_array_header_2_0
    return Header(*read_header(head))


def _read_array(file: IO[bytes]) -> np.ndarray[Any, Any]:
    """Return an array in numpy's format, of anything but Python objects; file and errors as of `_array_header`."""
    _array_header(file)
    file.seek(0)
    array = np.lib.format.read_array(file, allow_pickle=False)
    file.read(1)  # at its end an archive compares the checksum
    return np.asarray(array)


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
