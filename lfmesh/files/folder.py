"""Run folders: manifest and atomic changes, which survive the death of a process at any moment.

New files and the new manifest are written to a staging folder inside the run folder. Then a journal of the files to
move and remove appears in one step, which decides the change. The next process to open the folder finishes any journal
and removes the staging of dead processes, recognised by a lock that the system releases with the process.

Journals and links may come from elsewhere: entries are carried out inside the folder or not at all.
"""

import json
import os
import secrets
import shutil
import stat
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import lfmesh
from lfmesh.errors import FileError
from lfmesh.files.inside import NO_LINK, Inside, refuse_link
from lfmesh.files.json_values import parse_json
from lfmesh.files.locks import fcntl, held, locked
from lfmesh.files.whole import make_like_any_other
from lfmesh.regular_file import read_text
from lfmesh.scene.inputs import COPIES, digest_of

MANIFEST, JOURNAL = "manifest.json", ".lfmesh-journal.json"
STAGING = ".lfmesh-"

FORMAT = 1
"""Version of the manifest's format; readers refuse any other."""

FORGOTTEN_SECONDS = 86_400.0
"""Age at which staging counts as abandoned where files cannot be locked."""


class Entry(NamedTuple):
    """Size and digest of a saved file."""

    bytes: int
    sha256: str

    @classmethod
    def of(cls, path: Path) -> "Entry":
        """Return the entry of a file."""
        return cls(path.stat().st_size, digest_of(path))

    def fits(self, path: Path) -> bool:
        """Tell whether a file still has the saved size and digest."""
        return path.stat().st_size == self.bytes and digest_of(path) == self.sha256


Manifest = dict[str, Entry]
"""Entries by file name in the run folder, with / between folders."""


def is_safe(name: Any) -> bool:
    """Tell whether a name stays inside the run: a plain name, or a copied input."""
    if not isinstance(name, str) or not name or {"\\", ":", "\0"} & set(name):
        return False
    try:
        os.fsencode(name)
    except UnicodeEncodeError:
        return False
    parts = PurePosixPath(name).parts
    inside = not ({"..", "/", "."} & set(parts)) and not name.startswith("/")
    return inside and (len(parts) == 1 or parts[0] == COPIES) and parts[0] != JOURNAL


def manifest_of(folder: Path) -> Manifest | None:
    """Return the manifest of a run folder; None if it has none, as in runs of older versions.

    Raises
    ------
    FileError
        It is damaged or of another version.
    """
    path = folder / MANIFEST
    try:
        document = parse_json(read_text(path))
        if document["format"] != FORMAT:
            raise FileError(
                f"{path} has format {document['format']}, written by lfmesh {document['lfmesh_version']}; this lfmesh"
                f" {lfmesh.__version__} reads format {FORMAT}"
            )
        entries = {name: Entry(int(entry["bytes"]), str(entry["sha256"])) for name, entry in document["files"].items()}
    except FileNotFoundError:
        return None
    except OSError as error:
        raise FileError(f"{path} cannot be read: {error.strerror or error}") from None
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError):
        raise FileError(f"{path} is damaged; render the scene again") from None
    return {name: entry for name, entry in entries.items() if is_safe(name)}


def saved(folder: Path, name: str) -> Path | None:
    """Return the path of a saved file of a run; None if the run has none.

    Raises
    ------
    FileError
        The file differs from the one saved.
    """
    manifest, path = manifest_of(folder), folder / name
    if not path.is_file() or (manifest is not None and name not in manifest):
        return None
    if manifest is not None and not manifest[name].fits(path):
        raise FileError(f"{path} is truncated or damaged: it is not what was saved")
    return path


def is_forgotten(path: Path) -> bool:
    """Tell whether a staging folder or staged file is abandoned; links, pipes and devices never are."""
    mode = path.lstat().st_mode
    if not stat.S_ISDIR(mode) and not stat.S_ISREG(mode):
        return False
    with locked(path, wait=False) as free:
        if free is None:
            return time.time() - path.stat().st_mtime > FORGOTTEN_SECONDS
        return free


def recover(folder: Path) -> None:
    """Finish a change decided by a journal; remove the staging of dead processes.

    Raises
    ------
    FileError
        A change is unfinished, and the folder cannot be written.
    """
    try:
        left = [entry for entry in folder.iterdir() if entry.name.startswith(STAGING)]
    except OSError:
        return
    if not left:
        return
    try:
        with locked(folder):
            if (folder / JOURNAL).exists():
                _finish(folder)
            for entry in left:
                # Another process may have removed it, or it belongs to somebody else.
                with suppress(OSError):
                    if entry.name != JOURNAL and is_forgotten(entry):
                        _remove(entry)
    except OSError as error:
        if (folder / JOURNAL).exists():
            raise FileError(
                f"{folder} holds a save that was cut short, and cannot be written to finish it:"
                f" {error.strerror or error}"
            ) from None


def made_inside(folder: Path, name: str) -> Path:
    """Make a subfolder in a folder of results if missing; finish or clear interrupted work in it.

    Parameters
    ----------
    folder : Path
        As the user names it.
    name : str
        Subfolder.

    Raises
    ------
    OSError
        The subfolder cannot be made.
    FileError
        The subfolder is a link.
    """
    inner = folder / name
    refuse_link(inner)
    inner.mkdir(parents=True, exist_ok=True)
    recover(inner)
    return inner


def write_inside(folder: Path, name: str, content: str | bytes) -> None:
    """Write or replace a file in a folder of results, completely or not at all; text as UTF-8.

    Parameters
    ----------
    folder : Path
    name : str
    content : str or bytes

    Raises
    ------
    FileError
        The file cannot be written; an earlier one is kept.
    """
    try:
        with staged_file(folder, name) as file:
            file.write(content.encode() if isinstance(content, str) else content)
    except OSError as error:
        raise FileError(f"{folder / name} cannot be written: {error.strerror or error}") from None


@contextmanager
def staged(parent: Path) -> Iterator[Path]:
    """Yield an empty folder inside another, owned by this process while it lives; remove it at the end."""
    with locked(parent):
        staging = parent / f"{STAGING}{os.getpid()}-{secrets.token_hex(4)}"
        staging.mkdir()
        handle = held(staging)
    try:
        yield staging
    finally:
        if not (parent / JOURNAL).exists():
            shutil.rmtree(staging, ignore_errors=True)
        if handle is not None:
            os.close(handle)


@contextmanager
def staged_file(folder: Path, name: str) -> Iterator[Any]:
    """Yield a new binary file, which replaces the named one when the body is done."""
    with locked(folder):
        handle, temporary = tempfile.mkstemp(prefix=STAGING, dir=folder)
        if fcntl is not None:
            with suppress(OSError):
                fcntl.flock(handle, fcntl.LOCK_EX)
    try:
        with os.fdopen(handle, "wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
            make_like_any_other(Path(temporary))
            os.replace(temporary, folder / name)  # noqa: PTH105
    except BaseException:
        with suppress(OSError):
            os.unlink(temporary)  # noqa: PTH108
        raise


class Change(NamedTuple):
    """Effects of a change besides moving in the staged files.

    Attributes
    ----------
    manifest : dict
        Entire content of the folder after the change.
    removed : iterable of str
        Files to remove.
    moved : dict
        Files to rename first.
    """

    manifest: Manifest
    removed: Iterable[str] = ()
    moved: Mapping[str, str] = {}


def commit(folder: Path, staging: Path, decide: Callable[[Manifest], Change]) -> None:
    """Make staged files part of a folder, permanently, all or none.

    Parameters
    ----------
    folder : Path
    staging : Path
        From `staged`, with the new files.
    decide : callable
        Called with the new files while no other process changes the folder.
    """
    names = sorted(path.relative_to(staging).as_posix() for path in staging.rglob("*") if path.is_file())
    new = {name: Entry.of(staging / name) for name in names}
    for name in names:
        _to_disk(staging / name)
    with locked(folder):
        # First finish a change that another process decided but did not complete.
        if (folder / JOURNAL).exists():
            _finish(folder)
        change = decide(new)
        # Report links before the change is decided.
        with Inside(folder) as inside:
            for name in [*names, *change.removed, *change.moved, *change.moved.values()]:
                inside.has(name)
        _write_json(
            staging / MANIFEST,
            {
                "format": FORMAT,
                "lfmesh_version": lfmesh.__version__,
                "about": "Every file of this run with its size and SHA-256; files not named here do not belong to it.",
                "files": {name: entry._asdict() for name, entry in sorted(change.manifest.items())},
            },
        )
        prepared = staging / JOURNAL
        # The manifest comes last, as it defines the folder's content.
        journal = {"staging": staging.name, "files": [*names, MANIFEST], "removed": sorted(change.removed)}
        _write_json(prepared, {**journal, "moved": dict(change.moved)})
        os.replace(prepared, folder / JOURNAL)  # noqa: PTH105
        try:
            _finish(folder)
        except KeyboardInterrupt:
            _finish(folder)
            raise


def _write_json(path: Path, document: dict[str, Any]) -> None:
    path.write_text(json.dumps(document, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    _to_disk(path)


def _finish(folder: Path) -> None:
    """Carry out the journal; any step may have been done before."""
    with Inside(folder) as inside:
        staging, files, removed, moved = _journal(inside)
        # Check everything before changing anything.
        for name in files:
            inside.refuse_irregular(f"{staging}/{name}")
        for name in [*files, *removed, *moved, *moved.values()]:
            inside.has(name)
        for name, other in moved.items():
            if inside.has(f"{staging}/{name}") and inside.has(name) and not inside.has(other):
                inside.move(name, other)
        for name in files:
            if inside.has(f"{staging}/{name}"):
                inside.move(f"{staging}/{name}", name)
        for name in removed:
            inside.remove(name)
        _remove_empty(folder / COPIES)
        _to_disk(folder)
        shutil.rmtree(folder / staging, ignore_errors=True)
        inside.remove(JOURNAL)


def _journal(inside: Inside) -> tuple[str, list[str], list[str], dict[str, str]]:
    """Return a journal's staging folder, new files, removed files and renamed files."""
    path = inside.folder / JOURNAL
    inside.refuse_irregular(JOURNAL)
    try:
        journal = parse_json(read_text(path))
        staging, files, removed = str(journal["staging"]), list(journal["files"]), list(journal["removed"])
        moved = dict(journal["moved"])
    except (ValueError, KeyError, TypeError):
        # Journals appear in one step, so an incomplete one is not lfmesh's.
        raise FileError(f"{path} is damaged; delete it, and render the scene again") from None
    names = [staging, *files, *removed, *moved, *moved.values()]
    if not all(map(is_safe, names)) or "/" in staging or not staging.startswith(STAGING):
        raise FileError(f"{path} names files outside of the run; delete it, and render the scene again")
    return staging, files, removed, moved


def _remove(entry: Path) -> None:
    if entry.is_dir() and not entry.is_symlink():
        shutil.rmtree(entry, ignore_errors=True)
    else:
        entry.unlink(missing_ok=True)


def _remove_empty(folder: Path) -> None:
    """Remove a folder and its subfolders, as far as they are empty."""
    if folder.is_dir() and not folder.is_symlink():
        for inner in folder.iterdir():
            _remove_empty(inner)
        with suppress(OSError):
            folder.rmdir()


def _to_disk(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk, if supported."""
    try:
        handle = os.open(path, os.O_RDONLY | NO_LINK)
    except OSError:
        return
    try:
        with suppress(OSError):
            os.fsync(handle)
    finally:
        os.close(handle)
