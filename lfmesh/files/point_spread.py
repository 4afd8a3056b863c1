"""Files of a point spread: power as EXR, a scaled picture, facts as JSON."""

import io
import json
from pathlib import Path

from lfmesh.errors import FileError
from lfmesh.files.exr import write_maps
from lfmesh.files.json_values import plain_json
from lfmesh.files.whole import make_folder, try_folder, write_whole
from lfmesh.waves.point_spread import PointSpread

PNG_DPI = 150
"""Pixels per inch of the picture."""

NAMES = tuple(f"spread.{kind}" for kind in ("exr", "png", "json"))


def prepare(folder: Path) -> None:
    """Check that a point spread can be written into a folder, without leaving anything there.

    Raises
    ------
    FileError
        The folder already holds one or cannot be written.
    """
    there = next((name for name in NAMES if (folder / name).exists()), None)
    if there is not None:
        raise FileError(f"{folder / there} already exists: move it, or choose another folder")
    try_folder(folder)


def write_point_spread(spread: PointSpread, folder: Path) -> list[Path]:
    """Write spread.exr, spread.png (the figure) and spread.json to a folder; return their paths.

    Parameters
    ----------
    spread : PointSpread
    folder : Path
        Created if missing.

    Raises
    ------
    FileError
        A file cannot be written.
    """
    make_folder(folder)
    exr, png, facts = (folder / name for name in NAMES)
    known = plain_json(spread.facts())
    write_maps(exr, {"W": spread.mean}, known)
    drawn = io.BytesIO()
    spread.figure().savefig(drawn, format="png", dpi=PNG_DPI, metadata={"Software": None})
    write_whole(png, drawn.getvalue())
    write_whole(facts, json.dumps(known, indent=2) + "\n")
    return [exr, png, facts]
