"""The checkpoint in a run folder: the state of an interrupted render, from which it goes on to the same bits."""

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
"""Of the file; a reader refuses any other."""

SECONDS = 10.0
"""Between two checkpoints at least."""

SHARE = 0.01
"""Of the time that checkpoints may take."""


class CheckpointWarning(UserWarning):
    """A checkpoint could not be written."""


class Checkpoints:
    """Keeps the state of a render in the folder of its run, seldom enough to cost nothing that one notices.

    Parameters
    ----------
    folder : Path
    facts : dict
        The scene, as `lfmesh.files.image_file.scene_metadata` gives it.

    Attributes
    ----------
    written : bool
        Whether there is a checkpoint of this render.
    """

    def __init__(self, folder: Path, facts: dict[str, Any]) -> None:
        self._folder, self._facts = folder, facts
        self.written = False
        self._due = time.monotonic() + SECONDS

    def __call__(self, state: RenderState, *, last: bool) -> None:
        """Write the state, if it is time or the last chance."""
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
            # Work that is done is not given up for that.
            reason = error.strerror or error
            place = self._folder / CHECKPOINT
            warnings.warn(f"{place} cannot be written: {reason}; the render goes on", CheckpointWarning, stacklevel=2)


def _settled(arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return the arrays of a state with copies of those that other threads may be adding light to."""
    return {name: array.copy() if name.startswith("partial.") else array for name, array in arrays.items()}


@dataclass
class Checkpoint:
    """A checkpoint as it was read.

    Attributes
    ----------
    scene : Scene
        As it was given to the render.
    arrays : dict of arrays
        For `render`'s `saved`.
    """

    scene: Scene
    arrays: dict[str, NDArray[Any]]


def read(folder: Path, scene_from: Callable[[dict[str, Any], Path], Scene]) -> Checkpoint:
    """Read the checkpoint of a run folder.

    Raises
    ------
    FileError
        There is none, it is damaged, or another program wrote it.
    """
    try:
        facts, arrays = read_sealed(folder / CHECKPOINT, FORMAT)
        return Checkpoint(scene_from(facts, folder), arrays)
    except FileNotFoundError:
        raise FileError(f"{folder} has no checkpoint to go on from; render the scene again") from None
    except FileError as error:
        why = str(error)
    except (ValueError, KeyError, TypeError):
        why = f"{folder / CHECKPOINT} is damaged"
    raise FileError(f"{why}; begin anew with lfmesh render --restart, or delete {folder / CHECKPOINT}")
