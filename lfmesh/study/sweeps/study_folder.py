"""A study on disk: its plan, one file per finished unit, a log.

out/study.json         the study; the folder accepts no other
out/units/*.npz        one file per unit, complete or absent
out/reference/*.npz    films of the reference, one file per batch
out/log.jsonl          one line per event
"""

import json
import os
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from lfmesh.errors import FileError, LfmeshError
from lfmesh.files.folder import made_inside, recover, staged_file
from lfmesh.files.inside import opened_here
from lfmesh.files.json_values import parse_json, plain_json
from lfmesh.files.sealed import refuse_maker
from lfmesh.provenance import program
from lfmesh.regular_file import read_bytes, read_text
from lfmesh.scene.toml import table
from lfmesh.study.sweeps.plan import Plan
from lfmesh.study.sweeps.unit import Outcome, is_reference, unpacked

FACTS, UNITS, REFERENCE, LOG = "study.json", "units", "reference", "log.jsonl"

FORMAT = 2
"""Format of the folder; a reader refuses any other."""


class StudyFolder:
    """Folder of a study.

    Parameters
    ----------
    path : Path
    plan : Plan
        Plan of the study.

    Raises
    ------
    FileError
        The folder cannot be written.
    LfmeshError
        The folder holds another study, or one begun by another program.
    """

    def __init__(self, path: Path, plan: Plan) -> None:
        self.path, self.plan = path, plan
        try:
            path.mkdir(parents=True, exist_ok=True)
            recover(path)
            for name in (UNITS, REFERENCE):
                made_inside(path, name)
            known = read_facts(path)
            if known is None:
                self._write(path, FACTS, self._facts().encode())
        except OSError as error:
            raise FileError(f"{path}: cannot be written: {error.strerror or error}") from None
        if known is not None:
            refuse_other(known, plan.digest, path)

    def _facts(self) -> str:
        facts = {"format": FORMAT, "program": program(), **_summary_of(self.plan)}
        return json.dumps(plain_json(facts), indent=1, ensure_ascii=False) + "\n"

    def reference_path(self, batch: int) -> Path:
        """Return the file of a batch's reference films."""
        return self.path / REFERENCE / f"batch{batch:03d}.npz"

    def has_reference(self, batch: int) -> bool:
        """Tell whether the films of a batch exist and are complete."""
        return is_reference(self.reference_path(batch), self.plan.digest, batch)

    def keep_reference(self, batch: int, content: bytes) -> None:
        """Write the films of a batch.

        Raises
        ------
        FileError
            The films cannot be written; no part of them is left.
        """
        try:
            self._write(self.path / REFERENCE, self.reference_path(batch).name, content)
        except OSError as error:
            raise FileError(f"{self.reference_path(batch)} cannot be written: {error.strerror or error}") from None

    def unit_path(self, point: int, batch: int) -> Path:
        """Return the file of a unit."""
        return self.path / UNITS / unit_name(point, batch)

    def keep(self, point: int, batch: int, content: bytes) -> None:
        """Write the outcome of a unit: temporary file, sync, rename.

        Parameters
        ----------
        point, batch : int
        content : bytes

        Raises
        ------
        OSError
            The outcome cannot be written; no part of it is left.
        """
        self._write(self.path / UNITS, unit_name(point, batch), content)

    def outcome(self, point: int, batch: int) -> Outcome | None:
        """Return the outcome of a unit; None if there is none yet.

        Raises
        ------
        FileError
            The file exists and cannot be read.
        """
        path = self.unit_path(point, batch)
        try:
            content = read_bytes(path)
        except FileNotFoundError:
            return None
        except OSError as error:
            raise FileError(f"{path} cannot be read: {error.strerror or error}") from None
        return unpacked(content, self.plan.digest, point, batch, self.plan.metrics, str(path))

    def log(self, event: str, **values: Any) -> None:
        """Append a line to the log; failures are ignored."""
        append_event(self.path, event, **values)

    @staticmethod
    def _write(folder: Path, name: str, content: bytes) -> None:
        with staged_file(folder, name) as file:
            file.write(content)


def _summary_of(plan: Plan) -> dict[str, Any]:
    """Return a plan as plain values."""
    return {
        "name": plan.study.name,
        "digest": plan.digest,
        "points": len(plan.points),
        "batches": plan.study.batches,
        "metrics": list(plan.metrics),
        "design": plan.study.design if not plan.scenes else "scenes",
        "paired": plan.study.paired,
        "paths": [axis.path for axis in plan.axes],
        "study": table(plan.study),
    }


def append_event(folder: Path, event: str, **values: Any) -> None:
    """Append a line to the log in a folder; failures are ignored.

    Parameters
    ----------
    folder : Path
    event : str
    **values
        Details of the event.
    """
    line = json.dumps(plain_json({"time": round(time.time(), 3), "event": event, **values}), ensure_ascii=False)
    # Never write through a link or into a pipe in its place.
    to_append = os.O_RDWR | os.O_APPEND | os.O_CREAT
    with suppress(OSError), os.fdopen(opened_here(str(folder / LOG), to_append), "a+b") as file:
        # A killed process may have left half a line.
        file.seek(0, os.SEEK_END)
        if file.tell():
            file.seek(-1, os.SEEK_END)
            line = line if file.read(1) == b"\n" else "\n" + line
        file.write(line.encode() + b"\n")


def unit_name(point: int, batch: int) -> str:
    """Return the name of a unit's file."""
    return f"point{point:06d}-batch{batch:03d}.npz"


def read_facts(path: Path) -> dict[str, Any] | None:
    """Return the description of a study folder; None if the folder is new.

    Raises
    ------
    FileError
        The description is damaged.
    """
    try:
        known = dict(parse_json(read_text(path / FACTS)))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, TypeError):
        raise FileError(f"{path / FACTS} is damaged; delete it to continue with the finished units") from None
    return known


def refuse_other(known: dict[str, Any], digest: str, path: Path) -> None:
    """Refuse a folder that holds another study, or one begun by another program.

    Parameters
    ----------
    known : dict
        Description in the folder.
    digest : str
        Digest of the wanted study.
    path : Path
        Folder of the study.

    Raises
    ------
    LfmeshError
        The message names the folder.
    """
    refuse_maker(str(path), FORMAT, known.get("format"), known.get("program"))
    if known.get("digest") != digest:
        raise LfmeshError(
            f"{path} holds another study, or the scene, a file that it reads or the study file has changed since: give "
            "another folder, or restore the original"
        )


def logged(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the events of a log, without truncated lines."""
    try:
        lines = read_text(path / LOG, errors="replace").splitlines()
    except OSError:
        return
    for line in lines:
        with suppress(ValueError):
            event = parse_json(line)
            if isinstance(event, dict):
                yield event
