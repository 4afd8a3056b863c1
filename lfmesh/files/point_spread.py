"""Files of a point spread: power as EXR, a logarithmic picture, facts as JSON."""

import io
import json
import os
from pathlib import Path

import numpy as np
import PIL.Image

from lfmesh.errors import FileError
from lfmesh.files.exr import write_maps
from lfmesh.files.json_values import plain_json
from lfmesh.files.whole import make_folder, write_whole
from lfmesh.waves.point_spread import PointSpread

DECADES = 4.0
"""Range of the picture below its brightest pixel."""

LEAST_PX = 480
"""Pictures whose longer side is shorter are enlarged to about this."""


NAMES = tuple(f"spread.{kind}" for kind in ("exr", "png", "json"))


def prepare(folder: Path) -> None:
    """Check that a point spread can be written into a folder; leave nothing behind.

    Raises
    ------
    FileError
        It holds one already, or cannot be written.
    """
    there = next((name for name in NAMES if (folder / name).exists()), None)
    if there is not None:
        raise FileError(f"{folder / there} is there already: move it, or choose another folder")
    nearest = next(each for each in (folder, *folder.absolute().parents) if each.exists())
    if not nearest.is_dir() or not os.access(nearest, os.W_OK):
        raise FileError(f"{folder} cannot be written: {nearest} is no folder that takes files")


def write_point_spread(spread: PointSpread, folder: Path) -> list[Path]:
    """Write spread.exr, spread.png (upright, logarithmic) and spread.json into a folder; return their paths.

    Parameters
    ----------
    spread : PointSpread
    folder : Path
        Made if it is not there.

    Raises
    ------
    FileError
        It cannot be written.
    """
    make_folder(folder)
    exr, png, facts = (folder / name for name in NAMES)
    known = plain_json(spread.facts())
    write_maps(exr, {"W": spread.mean}, known)
    floor = 10.0**-DECADES
    shown = 1.0 + np.log10(np.maximum(spread.mean / max(float(spread.mean.max()), 1e-300), floor)) / DECADES
    picture = PIL.Image.fromarray(np.round(255.0 * shown[:, ::-1]).astype(np.uint8))
    larger = max(1, round(LEAST_PX / max(picture.size)))
    drawn = io.BytesIO()
    picture.resize((larger * picture.width, larger * picture.height), PIL.Image.Resampling.NEAREST).save(drawn, "PNG")
    write_whole(png, drawn.getvalue())
    write_whole(facts, json.dumps(known, indent=2) + "\n")
    return [exr, png, facts]
