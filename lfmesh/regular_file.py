"""Files named by a user, opened for reading only if they are regular files.

A named pipe may wait forever for a writer, and a device may never end: neither is opened. The refusal is an `OSError`
with the kind of file in its `strerror`, reported like a missing file.
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
"""Byte order mark, which some editors write before a text."""

MOST_HEADER = 10_000
"""Largest size of an array's header, in bytes; numpy itself refuses longer ones, but reads them first."""


def why_no_file(path: Path) -> str:
    """Return the reason why a path is not a readable file."""
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
        The file cannot be opened, or is a folder, a pipe, a socket or a device.
    """
    return open(path, "rb", opener=_opened)


def open_text(path: Path, encoding: str = "utf-8-sig", errors: str | None = None, newline: str | None = None) -> TextIO:
    """Open a file for reading its text.

    Parameters
    ----------
    path : Path
    encoding, errors, newline : str, optional
        As for `open`. A byte order mark before UTF-8 is skipped.

    Raises
    ------
    OSError
        As for `open_regular`.
    """
    return open(path, encoding=encoding, errors=errors, newline=newline, opener=_opened)


def read_bytes(path: Path) -> bytes:
    """Return the content of a regular file; errors as for `open_regular`."""
    with open_regular(path) as file:
        return file.read()


def read_text(path: Path, encoding: str = "utf-8-sig", errors: str | None = None) -> str:
    """Return the text of a regular file; errors as for `open_regular`, and of decoding.

    Parameters
    ----------
    path : Path
    encoding, errors : str, optional
        As for `open_text`.
    """
    with open_text(path, encoding, errors) as file:
        return file.read()


def without_mark(content: bytes) -> bytes:
    """Remove a UTF-8 byte order mark from the bytes of a text."""
    return content.removeprefix(MARK.encode())


class Header(NamedTuple):
    """Shape and type announced by an array in numpy's format."""

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
        Name for the array of a `.npy` file, which stores none.

    Raises
    ------
    OSError
        As for `open_regular`.
    BadZipFile
        The file is not an archive.
    """
    with open_regular(path) as file:
        if path.suffix.lower() == ".npy":
            yield Arrays([only], lambda _: nullcontext(file))
            return
        with zipfile.ZipFile(file) as archive:
            names = [name.removesuffix(".npy") for name in archive.namelist()]
            yield Arrays(names, lambda name: archive.open(f"{name}.npy"))


class Arrays:
    """Arrays of a file, each read and unpacked only on access.

    Parameters
    ----------
    names : list of str
    opened : callable
        Opens the array of a name, at its beginning.
    """

    def __init__(self, names: list[str], opened: Callable[[str], AbstractContextManager[IO[bytes]]]) -> None:
        self.names = names
        self._opened = opened

    def header(self, name: str) -> Header:
        """Return the header of an array.

        Raises
        ------
        KeyError
            There is no such array.
        ValueError
            The content is not an array.
        """
        with self._opened(name) as file:
            return _array_header(file)

    def __getitem__(self, name: str) -> np.ndarray[Any, Any]:
        with self._opened(name) as file:
            return _read_array(file)


def _array_header(file: IO[bytes]) -> Header:
    """Return the header of an array in numpy's format, reading at most `MOST_HEADER` bytes.

    Parameters
    ----------
    file : binary file
        File that begins with the array.

    Raises
    ------
    ValueError
        The content is not an array.
    """
    file.seek(0)
    head = BytesIO(file.read(MOST_HEADER))
    old = np.lib.format.read_magic(head) == (1, 0)
    read_header = np.lib.format.read_array_header_1_0 if old else np.lib.format.read_array_header_2_0
    return Header(*read_header(head))


def _read_array(file: IO[bytes]) -> np.ndarray[Any, Any]:
    """Return an array in numpy's format, except of Python objects; otherwise as `_array_header`."""
    _array_header(file)
    file.seek(0)
    array = np.lib.format.read_array(file, allow_pickle=False)
    file.read(1)  # at the end an archive compares the checksum
    return np.asarray(array)


def _opened(path: str, flags: int) -> int:
    """Open a path only if it is a regular file; do not block if a pipe takes its place meanwhile."""
    _refuse_irregular(os.stat(path), path)  # noqa: PTH116  # what `open` passes on is text
    handle = os.open(path, flags | getattr(os, "O_NONBLOCK", 0))
    try:
        _refuse_irregular(os.fstat(handle), path)
    except OSError:
        os.close(handle)
        raise
    return handle


def _refuse_irregular(state: os.stat_result, path: str) -> None:
    """Raise if a path is a pipe, a socket or a device; `open` itself refuses a folder."""
    if not stat.S_ISREG(state.st_mode) and not stat.S_ISDIR(state.st_mode):
        raise OSError(errno.EINVAL, f"it {_why_irregular(state.st_mode)}", path)


def _why_irregular(mode: int) -> str:
    kind = _KINDS.get(stat.S_IFMT(mode), "something else")
    way = ": save what comes through it as a file" if stat.S_ISFIFO(mode) else ""
    return f"is not a regular file but {kind}{way}"
