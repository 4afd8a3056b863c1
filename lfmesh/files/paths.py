"""Paths from one folder to another."""

import os
from pathlib import Path


def relative(path: Path, folder: Path) -> str:
    """Return a path relative to a folder, so that a project can be moved; absolute on another drive."""
    try:
        return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()
    except ValueError:
        return path.resolve().as_posix()
