"""Files of a board fit: corner lists to read; scene, values and residuals to write."""

import csv
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

import lfmesh
from lfmesh.accuracy.figures import finish
from lfmesh.errors import FileError
from lfmesh.files.inputs import within
from lfmesh.files.json_values import plain_json
from lfmesh.files.whole import make_folder
from lfmesh.regular_file import open_text
from lfmesh.scene.literals import plain
from lfmesh.study.fits.board_corners import LEAST_CORNERS, BoardCorners
from lfmesh.study.fits.board_fit import BoardFit
from lfmesh.study.fits.fit_files import (
    ARROW,
    BLUE,
    PICTURE,
    SCENE,
    VALUES,
    as_png,
    facts,
    parameter_facts,
    residuals_picture,
    show_spread,
    two_plots,
    write_files,
)  # fmt: skip

BOARD_PICTURE = "board_residuals.png"

COLUMNS = ("board_x_mm", "board_y_mm", "view_row", "view_column", "row", "column")
"""Columns of a corner list."""


def read_corners(path: Path) -> BoardCorners:
    """Read a corner list: a CSV file with one line per place of a corner in a view.

    The columns are `board_x_mm`, `board_y_mm` (x to the right and y up), `view_row` and `view_column` (v and u from the
    middle view, so −4.5..4.5 for ten views), `row` and `column` (t and s of the view, from the centre of the first
    sample). The views are decoded with the scene fitted to the white image.

    Raises
    ------
    FileError
        The file cannot be read, lacks a column, has a value other than a number, or too few corners.
    """
    try:
        with open_text(path, newline="") as file:
            reader = csv.DictReader(file)
            missing = [name for name in COLUMNS if name not in (reader.fieldnames or ())]
            if missing:
                raise FileError(f"{path}: the column {missing[0]} is missing; needed are {', '.join(COLUMNS)}")
            lines = [[_number(path, reader.line_num, name, line[name]) for name in COLUMNS] for line in reader]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or "not a CSV file"
        raise FileError(f"{path}: the list of corners cannot be read: {reason}") from None
    values = np.array(lines, np.float64).reshape(-1, len(COLUMNS))
    places, corner = np.unique(values[:, :2], axis=0, return_inverse=True)
    if len(places) < LEAST_CORNERS:
        raise FileError(f"{path}: {len(places)} corners of the board; {LEAST_CORNERS} or more are needed")
    if np.linalg.matrix_rank(places - places.mean(axis=0)) < 2:
        raise FileError(f"{path}: all corners lie on one line of the board; give corners on several lines")
    return BoardCorners(np.asarray(corner.ravel(), np.int64), values[:, :2], values[:, [3, 2]], values[:, [5, 4]])


def _number(path: Path, line: int, name: str, text: str | None) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise FileError(f"{path}, line {line}: {name} = {text!r}: must be a finite number")
    return value


def write_board_fit(found: BoardFit, folder: Path) -> list[Path]:
    """Write ``fitted.toml``, ``fit.json``, ``residuals.png`` and ``board_residuals.png``.

    Raises
    ------
    FileError
        The folder cannot be written.
    """
    make_folder(folder)
    contents: dict[str, str | bytes] = {
        SCENE: within(found.scene, folder).dump_toml(),
        VALUES: json.dumps(plain_json(board_facts(found)), indent=1, ensure_ascii=False) + "\n",
        PICTURE: residuals_picture(found.white),
        BOARD_PICTURE: board_picture(found),
    }
    return write_files(contents, folder)


def board_facts(found: BoardFit) -> dict[str, Any]:
    """Return the content of ``fit.json`` for a board fit."""
    boards = []
    for number, (pose, seen, residuals) in enumerate(zip(found.poses, found.corners, found.residuals, strict=True)):
        slope, error = found.traded(number)
        boards.append(
            {
                "position_mm": pose.position_mm,
                "rotation_deg": pose.rotation_deg,
                "standard_error": pose.standard_error,
                "mm_along_z_per_mm_of_focus": slope,
                "z_error_at_known_focus_mm": error,
                "corners": len(np.unique(seen.corner)),
                "places": int(np.isfinite(residuals[:, 0]).sum()),
            }
        )
    return {
        "lfmesh_version": lfmesh.__version__,
        "parameters": parameter_facts(found.estimates),
        "boards": boards,
        "covariance": found.covariance.tolist(),
        "residual_rms_samples": found.rms,
        "corner_residual_rms_samples": found.corner_rms,
        "left_out": found.left_out,
        "white_image": facts(found.white),
    }


def board_picture(found: BoardFit) -> bytes:
    """Return a PNG of the corners' mean residuals as arrows, and the distribution of all residuals."""
    figure, field, spread = two_plots()
    places, means = [], []
    for seen, residuals in zip(found.corners, found.residuals, strict=True):
        for corner in np.unique(seen.corner[np.isfinite(residuals[:, 0])]):
            own = (seen.corner == corner) & np.isfinite(residuals[:, 0])
            places.append(seen.sample[own].mean(axis=0))
            means.append(residuals[own].mean(axis=0))
    place, mean = np.array(places), np.array(means)
    longest = max(float(np.linalg.norm(mean, axis=1).max()), np.finfo(np.float64).tiny)
    reach = float(np.ptp(place, axis=0).max())
    scale = longest / (ARROW * max(reach / math.sqrt(len(place)), 1.0))
    arrows = field.quiver(*place.T, *mean.T, angles="xy", scale_units="xy", scale=scale, color=BLUE, width=0.003)
    field.quiverkey(arrows, 0.86, 1.04, longest, f"{plain(longest, 2)} samples", labelpos="E")
    low, high = place.min(axis=0) - 2.0, place.max(axis=0) + 2.0
    field.set(
        xlim=(low[0], high[0]), ylim=(high[1], low[1]), aspect="equal", xlabel="sample, to the right", ylabel="down"
    )
    finish(field, "mean over the views, by corner")
    every = np.concatenate(found.residuals)
    show_spread(spread, every[np.isfinite(every[:, 0])])
    spread.set(xlabel="residual / samples of a view", ylabel="places of corners in views")
    finish(spread, f"{plain(found.rms, 2)} samples rms, {found.used} places")
    return as_png(figure)
