"""Reader of white images: a photograph, an EXR, or an lfmesh run folder."""

from pathlib import Path
from typing import Any

import numpy as np
import PIL
from numpy.typing import NDArray

from lfmesh.errors import FileError
from lfmesh.files import exr, run
from lfmesh.geometry.objects.texture import FORMATS, opened
from lfmesh.regular_file import why_no_file
from lfmesh.transport.render.image import Image

CHANNELS = ("Y", "G", "R")
"""Channels of a foreign EXR, in order of preference."""


def read_white(path: Path) -> Image | NDArray[Any]:
    """Read a white image.

    Parameters
    ----------
    path : Path
        A run folder with a white image, or its white.exr; another EXR, read as luminance, green or red; or a picture of
        raw counts, (H, W) or (H, W, 3). 16-bit colour is reduced to 8 bits, 16-bit grey is not.

    Raises
    ------
    FileError
        The file is missing, not a picture, or broken; or the run has no white image.
    """
    folder = path.parent if path.name == run.WHITE else path
    if folder.is_dir():
        image = run.open_white(folder)
        if image is None:
            raise FileError(f"{folder} has no white.exr; make it with lfmesh white {folder}, or give a picture")
        return image
    return _picture(path, "white image")


def read_picture(path: Path, what: str) -> Image | NDArray[Any]:
    """Read another picture from the camera: a run folder, EXR or picture, as in `read_white`.

    Parameters
    ----------
    path : Path
    what : str
        Subject, for error messages.

    Raises
    ------
    FileError
        The file is missing, not a picture, or broken.
    """
    return run.open_run(path) if path.is_dir() else _picture(path, what)


def _picture(path: Path, what: str) -> NDArray[Any]:
    if not path.is_file():
        raise FileError(f"{path}: the {what} {why_no_file(path)}; give a picture (PNG or TIFF), an EXR or a run")
    if path.suffix.lower() == ".exr":
        return exr.read_map(path, CHANNELS)
    try:
        with opened(path) as picture:
            deep = picture.mode.startswith(("I", "F"))
            return np.asarray(picture if deep else picture.convert("L" if picture.mode in ("1", "L", "LA") else "RGB"))
    except FileError:
        raise
    except Exception as error:  # a damaged file may raise anything inside Pillow's readers
        unknown = isinstance(error, PIL.UnidentifiedImageError)
        reason = "not a picture" if unknown else "a broken picture"
        raise FileError(f"{path}: {reason}; a {what} is one of {', '.join(FORMATS)}, an EXR or a run") from None
