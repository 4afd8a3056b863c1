"""Files are written whole or not at all, and what is no file stays what it is."""

import os
import stat
import threading
from pathlib import Path

import pytest

from lfmesh.errors import FileError
from lfmesh.files.whole import write_whole


def test_a_pipe_is_written_into_and_stays_a_pipe(tmp_path: Path) -> None:
    """As /dev/stdout; a file in its place would break the machine if it were /dev/null."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    read: list[bytes] = []
    reader = threading.Thread(target=lambda: read.append(pipe.read_bytes()))
    reader.start()
    write_whole(pipe, "words")
    reader.join(10.0)
    assert read == [b"words"]
    assert stat.S_ISFIFO(pipe.stat().st_mode)


def test_a_device_that_takes_nothing_is_said_and_stays(tmp_path: Path) -> None:
    full = Path("/dev/full")
    if not (full.exists() and stat.S_ISCHR(full.stat().st_mode)):
        pytest.skip("there is no /dev/full")
    link = tmp_path / "full"
    link.symlink_to(full)
    with pytest.raises(FileError, match="No space left"):
        write_whole(link, "words")
    assert stat.S_ISCHR(full.stat().st_mode)
    assert link.is_symlink()


def test_a_file_is_replaced_and_a_folder_refused(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text("old")
    write_whole(path, b"new")
    assert path.read_text() == "new"
    with pytest.raises(FileError, match="it is a folder"):
        write_whole(tmp_path, "words")
    assert [each.name for each in tmp_path.iterdir()] == ["file"]
