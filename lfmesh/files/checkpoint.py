"""Checkpoint in a run folder: the state of an interrupted render, which resumes bit for bit."""

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from lfmesh.errors import FileError
from lfmesh.files.folder import staged_file
from lfmesh.files.sealed import read_sealed, write_sealed
from lfmesh.scene import Scene
from lfmesh.transport.render.tally import RenderState, arrays_of

CHECKPOINT = "lfmesh-checkpoint.npz"

FORMAT = 3
"""Version of the file format; readers refuse any other."""

SECONDS = 10.0
"""Shortest time between two checkpoints."""

SHARE = 0.01
"""Largest fraction of the run time spent on checkpoints."""


class CheckpointWarning(UserWarning):
    """A checkpoint could not be written."""


class Checkpoints:
    """Writer of a render's checkpoints, which take a negligible part of the time.

    Parameters
    ----------
    folder : Path
    facts : dict
        Scene, as returned by `lfmesh.files.image_file.scene_metadata`.

    Attributes
    ----------
    written : bool
        Whether a checkpoint of this render exists.
    """

    def __init__(self, folder: Path, facts: dict[str, Any]) -> None:
        self._folder, self._facts = folder, facts
        self.written = False
        self._due = time.monotonic() + SECONDS

    def __call__(self, state: RenderState, *, last: bool) -> None:
        """Write the state if a checkpoint is due or this is the last chance."""
        began = time.monotonic()
        if began < self._due and not last:
            return
        self._write(state)
        now = time.monotonic()
        self._due = now + max(SECONDS, (now - began) / SHARE)

    def _write(self, state: RenderState) -> None:
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            with staged_file(self._folder, CHECKPOINT) as file:
                write_sealed(file, FORMAT, self._facts, _settled(arrays_of(state)))
            self.written = True
        except OSError as error:
            # A failed checkpoint must not end the render.
            reason = error.strerror or error
            place = self._folder / CHECKPOINT
            warnings.warn(f"{place} cannot be written: {reason}; the render continues", CheckpointWarning, stacklevel=2)


def _settled(arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return the arrays of a state, copying the ones to which other threads may still add light."""
    return {name: array.copy() if name.startswith("partial.") else array for name, array in arrays.items()}


@dataclass
class Checkpoint:
    """Checkpoint read from a file.

    Attributes
    ----------
    scene : Scene
        Scene as passed to the render.
    arrays : dict of arrays
        Argument `saved` of `render`.
    """

    scene: Scene
    arrays: dict[str, NDArray[Any]]


def read(folder: Path, scene_from: Callable[[dict[str, Any], Path], Scene]) -> Checkpoint:
    """Read the checkpoint of a run folder.

    Raises
    ------
    FileError
        No checkpoint exists, it is damaged, or another program wrote it.
    """
    try:
        facts, arrays = read_sealed(folder / CHECKPOINT, FORMAT)
        return Checkpoint(scene_from(facts, folder), arrays)
    except FileNotFoundError:
        raise FileError(f"{folder} has no checkpoint to continue from; render the scene again") from None
    except FileError as error:
        why = str(error)
    except (ValueError, KeyError, TypeError):
        why = f"{folder / CHECKPOINT} is damaged"
    raise FileError(f"{why}; start again with lfmesh render --restart, or delete {folder / CHECKPOINT}")
