"""Files written completely or not at all, and folders for results."""

import os
import tempfile
from contextlib import suppress
from pathlib import Path

from lfmesh.errors import FileError


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file beside its final place and move it there when complete; text as UTF-8.

    An existing path that is not a regular file, such as /dev/stdout or a pipe, is written to directly.

    Raises
    ------
    FileError
        The file cannot be written; an earlier one is kept.
    """
    data = content.encode() if isinstance(content, str) else content
    staging = None
    try:
        if path.is_dir():
            raise FileError(f"{path} cannot be written: it is a folder; give the name of a file")
        if path.exists() and not path.is_file():
            path.write_bytes(data)
            return
        handle, staging = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        make_like_any_other(Path(staging))
        Path(staging).replace(path)
    except BaseException as error:
        if staging is not None:
            with suppress(OSError):
                Path(staging).unlink()
        if isinstance(error, OSError):
            raise FileError(f"{path} cannot be written: {error.strerror or error}") from None
        raise


def make_folder(folder: Path) -> None:
    """Make a folder for results.

    Raises
    ------
    FileError
        The folder cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"{folder} cannot be written: {error.strerror or error}") from None


def try_folder(folder: Path) -> None:
    """Check that a folder for results can be made and written, without leaving anything there.

    Raises
    ------
    FileError
        The folder cannot be made or written.
    """
    made: list[Path] = []
    try:
        for path in [*reversed(folder.parents), folder]:
            if not path.exists():
                path.mkdir()
                made.append(path)
        # Only creating a file is conclusive: permissions ignore full disks, and do not bind the superuser.
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise FileError(f"{folder}: cannot be written: {error.strerror or error}") from None
    finally:
        for path in reversed(made):
            path.rmdir()


def make_like_any_other(temporary: Path) -> None:
    """Give a temporary file, readable only by its owner, the permissions of a normal new file."""
    mask = os.umask(0)
    os.umask(mask)
    temporary.chmod(0o666 & ~mask)
