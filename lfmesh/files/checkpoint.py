"""The checkpoint in a run folder: the state of an interrupted render, from which it goes on to the same bits."""

import json
import time
import warnings
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import lfmesh
from lfmesh.errors import FileError
from lfmesh.files.folder import staged_file
from lfmesh.regular_file import read_arrays
from lfmesh.scene import Scene
from lfmesh.transport.render.tally import RenderState, arrays_of

CHECKPOINT = "lfmesh-checkpoint.npz"

FORMAT = 2
"""Of the file; a reader refuses any other."""

SECONDS = 10.0
"""Between two checkpoints at least."""

SHARE = 0.01
"""Of the time that checkpoints may take."""

_FACTS = "facts"


class CheckpointWarning(UserWarning):
    """A checkpoint could not be written."""


class Checkpoints:
    """Keeps the state of a render in the folder of its run, seldom enough to cost nothing that one notices.

    Parameters
    ----------
    folder : Path
    facts : dict
        The scene, as `lfmesh.files.run.scene_metadata` gives it.
    """

    def __init__(self, folder: Path, facts: dict[str, Any]) -> None:
        self._folder, self._facts = folder, facts
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
        facts = json.dumps({"format": FORMAT, "lfmesh_version": lfmesh.__version__, **self._facts})
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            with staged_file(self._folder, CHECKPOINT) as file:
                np.savez(file, **{_FACTS: np.array(facts)}, **arrays_of(state))  # type: ignore[arg-type]
        except OSError as error:
            # Work that is done is not given up for that.
            reason = error.strerror or error
            place = self._folder / CHECKPOINT
            warnings.warn(f"{place} cannot be written: {reason}; the render goes on", CheckpointWarning, stacklevel=2)


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
        There is none, it is damaged, or another version of lfmesh wrote it.
    """
    path = folder / CHECKPOINT
    try:
        arrays = read_arrays(path)
        facts = json.loads(str(arrays.pop(_FACTS)))
        version = facts["format"], facts["lfmesh_version"]
        scene = scene_from(facts, folder) if version == (FORMAT, lfmesh.__version__) else None
    except FileNotFoundError:
        raise FileError(f"{folder} has no checkpoint to go on from; render the scene again") from None
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, zlib.error):
        raise FileError(f"{path} is damaged; delete it, and render the scene again") from None
    if scene is None:
        raise FileError(
            f"{path} was written by lfmesh {version[1]} (format {version[0]}); this lfmesh {lfmesh.__version__} may not"
            " go on to the same bits: render the scene again"
        )
    return Checkpoint(scene, arrays)
