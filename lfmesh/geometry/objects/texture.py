"""Picture files of targets, read as linear light."""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

import numpy as np
import PIL
import PIL.Image
import PIL.ImageOps
from numpy.typing import NDArray

from lfmesh.errors import FileError
from lfmesh.regular_file import why_no_file

Texture = NDArray[np.float32]
"""(h, w, 3) linear light, 0 to 1, row 0 at the top. Do not write to it: see `is_grey`."""

Transfer = Callable[[NDArray[np.float64]], Texture]
"""Function from a picture's codes, 0..1, to texture values."""

FORMATS = ("PNG", "JPEG", "TIFF", "BMP", "WEBP", "GIF")
"""Formats that are opened, by Pillow's names, whatever the file's ending. Excluded are PostScript, for which Pillow
starts another program, and formats with readers that break on damaged files."""

MOST_PIXELS = 2**26
"""Largest number of pixels of a picture: 0.8 GB as linear light."""

_BAND_PIXELS = 2**20
"""Pixels converted at a time, so that only the result takes memory."""


def load_texture(path: Path, alpha: bool = False) -> Texture:
    """Read a picture as linear light.

    Parameters
    ----------
    path : Path
        PNG, JPEG, TIFF, BMP, WebP or GIF of up to 67 million pixels; grey or RGB, sRGB-coded. 16-bit grey keeps its
        depth; 16-bit colour is read with 8 bits. A photograph is turned upright by its EXIF orientation.
    alpha : bool
        Read the transparency too.

    Returns
    -------
    (h, w, 3) float32
        Linear light, 0 to 1; with `alpha` (h, w, 4), the last channel the alpha as coded.

    Raises
    ------
    FileError
        The file is missing, broken, no picture, or has too many pixels.
    """
    path = Path(path)
    if not path.is_file():
        raise FileError(f"{path}: the texture {why_no_file(path)}; give a picture (PNG or JPEG)")
    try:
        with opened(path) as picture:
            upright = PIL.ImageOps.exif_transpose(picture)
            light = linear_light(upright)
            return with_alpha(light, upright) if alpha else light
    except FileError:
        raise
    except Exception as error:  # a damaged file may raise anything inside Pillow's readers
        unknown = isinstance(error, PIL.UnidentifiedImageError)
        reason = f"{error}" if str(error) else type(error).__name__
        reason = "not a picture" if unknown else f"a broken picture ({reason.splitlines()[0]})"
        raise FileError(f"{path}: {reason}; a texture is one of {', '.join(FORMATS)}") from None


@contextmanager
def opened(path: Path | BytesIO) -> Iterator[PIL.Image.Image]:
    """Open a picture of one of `FORMATS`, from a file or its content, without reading its pixels.

    Raises
    ------
    FileError
        It has more than `MOST_PIXELS`.
    """
    with warnings.catch_warnings():
        # Pillow's own limit is higher, and its warning would stand before the refusal.
        warnings.simplefilter("ignore", PIL.Image.DecompressionBombWarning)
        # A damaged file is read or refused all the same; warnings about its metadata help nobody.
        warnings.filterwarnings("ignore", module=r"PIL\.")
        try:
            picture = PIL.Image.open(path, formats=FORMATS)
        except PIL.Image.DecompressionBombError:
            raise FileError(f"{path}: has more than {MOST_PIXELS} pixels; give a smaller picture") from None
        with picture:
            width, height = picture.size
            if width * height > MOST_PIXELS:
                raise FileError(f"{path}: has {width} × {height} pixels; give a picture of at most {MOST_PIXELS}")
            yield picture


def linear_light(picture: PIL.Image.Image, transfer: Transfer | None = None) -> Texture:
    """Return a Pillow image as (h, w, 3) linear light, or by another transfer function than sRGB's.

    16-bit grey keeps its depth; every other mode is read with 8 bits, without transparency. The three channels of grey
    light are one array in memory, which is read-only.
    """
    deep = picture.mode.startswith("I;16")
    linear_of_code = (transfer or srgb_to_linear)(np.arange(65536) / 65535.0 if deep else np.arange(256) / 255.0)
    coded = np.asarray(picture if deep or picture.mode == "L" else picture.convert("RGB"))
    height, width = coded.shape[:2]
    linear = np.empty(coded.shape, np.float32)
    rows = max(1, _BAND_PIXELS // max(1, width))
    for start in range(0, height, rows):
        band = slice(start, start + rows)
        # Every code is in the table; without "clip", numpy writes to a copy of the band first.
        np.take(linear_of_code, coded[band], out=linear[band], mode="clip")
    return linear if linear.ndim == 3 else np.broadcast_to(linear[:, :, None], (height, width, 3))


def is_grey(light: Texture) -> bool:
    """Tell whether all channels of a texture share one array in memory, as in a grey picture."""
    return light.strides[2] == 0


def with_alpha(light: Texture, picture: PIL.Image.Image) -> Texture:
    """Return a picture's linear light with its alpha, 1 if it has none, as a fourth channel."""
    coded = np.asarray(picture.convert("RGBA"))[:, :, 3:]
    opacity = coded if picture.has_transparency_data else np.full_like(coded, 255)
    return np.concatenate([light, opacity.astype(np.float32) / np.float32(255.0)], axis=2)


def srgb_to_linear(coded: NDArray[np.float64]) -> Texture:
    """Undo the sRGB transfer function (IEC 61966-2-1) of values from 0 to 1."""
    linear = np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)
    return np.asarray(linear, dtype=np.float32)


def as_coded(coded: NDArray[np.float64]) -> Texture:
    """Return values from 0 to 1 unchanged, for pictures of other quantities than light."""
    return np.asarray(coded, dtype=np.float32)
