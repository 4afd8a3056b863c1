"""Export to one folder per tool, moved into place when complete, with a note that explains the files."""

import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

import lfmesh
from lfmesh.errors import FileError, LfmeshError, warn_caller
from lfmesh.files.exports.exr_rgb import write_exr_rgb
from lfmesh.files.exports.hci import write_hci
from lfmesh.files.exports.lftoolbox import write_eslf, write_mat
from lfmesh.files.exports.plenopticam import write_plenopticam
from lfmesh.files.exports.plenpy import write_plenpy
from lfmesh.files.exports.views import write_views
from lfmesh.files.folder import STAGING, recover, staged
from lfmesh.lightfield.calibration.calibration import Calibration
from lfmesh.lightfield.views.field import LightField
from lfmesh.transport.render.image import Image

FieldFormat = Literal["lftoolbox", "eslf", "hci", "views", "exr-rgb"]
RawFormat = Literal["plenopticam", "plenpy"]

NOTE = "export.json"

WITH_WEIGHTS = "lftoolbox"
"""Format that marks each sample as known or unknown."""

HARDLY_DARK = 0.05
"""Fraction of unknown samples, as at the edges of the array, that a view may have without a warning."""

_FIELD_WRITERS: dict[str, Callable[[Path, LightField], dict[str, Any]]] = {
    "lftoolbox": write_mat,
    "eslf": write_eslf,
    "views": write_views,
}
_WITH_DEPTH: dict[str, Callable[[Path, LightField, NDArray[np.floating] | None], dict[str, Any]]] = {
    "hci": write_hci,
    "exr-rgb": write_exr_rgb,
}
_RAW_WRITERS = {"plenopticam": write_plenopticam, "plenpy": write_plenpy}


def export_field(
    field: LightField,
    folder: str | os.PathLike[str],
    kind: FieldFormat,
    *,
    depth_mm: NDArray[np.floating] | None = None,
) -> list[Path]:
    """Write a light field for another tool; ``export.json`` explains the files.

    Parameters
    ----------
    field : LightField
    folder : path
        New or empty.
    kind : {"lftoolbox", "eslf", "hci", "views", "exr-rgb"}
    depth_mm : (t, s) float, optional
        For "hci" and "exr-rgb": distances of the middle view's points before the first vertex of the lens. "exr-rgb"
        accepts any size.

    Returns
    -------
    list of Path
        The files.

    Warns
    -----
    UserWarning
        Views have many unknown samples, which the format can only write as black.

    Raises
    ------
    LfmeshError
        The format cannot hold this light field, or the folder cannot be written.
    """
    if kind not in get_args(FieldFormat):
        raise LfmeshError(f"kind = {kind!r}: must be one of {', '.join(get_args(FieldFormat))}")
    if depth_mm is not None and kind not in _WITH_DEPTH:
        raise LfmeshError(f"depth_mm: {kind} cannot hold depth; hci and exr-rgb can")

    def write(staging: Path) -> dict[str, Any]:
        if kind in _WITH_DEPTH:
            return _WITH_DEPTH[kind](staging, field, depth_mm)
        return _FIELD_WRITERS[kind](staging, field)

    written = _exported(Path(folder), kind, write)
    if kind != WITH_WEIGHTS:
        warn_caller(_black_views(field))
    return written


def _black_views(field: LightField) -> Iterator[UserWarning]:
    """Yield a warning about views with many unknown samples; advise decoding fewer views."""
    unknown = np.mean(~np.isfinite(field.data).all(axis=-1), axis=(2, 3))
    dark = unknown > HARDLY_DARK
    if not dark.any():
        return
    count, black = min(field.views), int((unknown == 1.0).sum())
    rest = [cut for cut in range(1, (count + 1) // 2) if not dark[cut:-cut, cut:-cut].any()]
    advice = f"; decode {_whole_across(count - 2 * rest[0])}" if rest else ""
    yield UserWarning(
        f"{dark.sum()} of {dark.size} views are unknown in more than {HARDLY_DARK:.0%} of their samples, {black} "
        f"of them in all, because no light of their lenslets arrives: the files are black there{advice}"
    )


def _whole_across(count: int) -> str:
    return "1 view, which is whole" if count == 1 else f"{count} views across, which are whole"


def export_raw(
    image: Image, white: Image, calibration: Calibration, folder: str | os.PathLike[str], kind: RawFormat
) -> list[Path]:
    """Write a raw image, its white image and its settings for another decoder.

    Parameters
    ----------
    image, white : Image
        Images of the same camera.
    calibration : Calibration
    folder : path
        New or empty.
    kind : {"plenopticam", "plenpy"}

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    LfmeshError
        The decoder does not support such a camera, or the folder cannot be written.
    """
    if kind not in get_args(RawFormat):
        raise LfmeshError(f"kind = {kind!r}: must be one of {', '.join(get_args(RawFormat))}")
    writer = _RAW_WRITERS[kind]
    return _exported(Path(folder), kind, lambda staging: writer(staging, image, white, calibration))


def _exported(folder: Path, kind: str, write: Callable[[Path], dict[str, Any]]) -> list[Path]:
    try:
        is_new = not folder.exists()
        if is_new:
            folder.parent.mkdir(parents=True, exist_ok=True)
        elif not folder.is_dir():
            raise FileError(f"{folder} is a file: choose an empty or a new folder")
        elif any(not entry.name.startswith(STAGING) for entry in folder.iterdir()):
            raise _is_full(folder)
        home = folder.parent if is_new else folder
        recover(home)
        with staged(home) as staging:
            facts = {"format": kind, "lfmesh_version": lfmesh.__version__, **write(staging)}
            note = json.dumps(facts, indent=2, ensure_ascii=False) + "\n"
            (staging / NOTE).write_text(note, encoding="utf-8")
            if is_new:
                # One step: either the folder appears with all its files, or not at all.
                staging.replace(folder)
            else:
                _move_in(staging, folder)
    except OSError as error:
        raise FileError(f"{folder} cannot be written: {error.strerror or error}") from None
    return [folder / name for name in [*facts["files"], NOTE]]


def _move_in(staging: Path, folder: Path) -> None:
    """Move all files into an existing folder; the note comes last and marks it complete.

    The folder itself stays, as it may be a link, the working directory, or a mount point.
    """
    if any(entry.name != staging.name for entry in folder.iterdir()):
        raise _is_full(folder)
    for entry in sorted(staging.iterdir(), key=lambda entry: (entry.name == NOTE, entry.name)):
        entry.replace(folder / entry.name)


def _is_full(folder: Path) -> FileError:
    return FileError(f"{folder} is not empty: choose an empty or a new folder")
