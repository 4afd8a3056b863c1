"""Pictures on targets: files to linear light."""

from pathlib import Path

import numpy as np
import PIL
import PIL.Image
import PIL.ImageOps
from numpy.typing import NDArray

from lfmesh.errors import FileError

Texture = NDArray[np.float32]
"""(h, w, 3) linear light, 0 to 1; row 0 is the top of the picture."""


def load_texture(path: Path, alpha: bool = False) -> Texture:
    """Read a picture as linear light.

    Parameters
    ----------
    path : Path
        PNG, JPEG, or what else Pillow reads; grey or RGB, sRGB-coded. 16-bit grey keeps its depth, 16-bit colour is
        read with 8. A photograph is turned upright by its own record.
    alpha : bool
        Read its transparency too, which is ignored otherwise.

    Returns
    -------
    (h, w, 3) float32
        Linear light, 0 to 1; with `alpha` (h, w, 4), the last being the alpha, as it is.

    Raises
    ------
    FileError
        The file is not there or is no picture.
    """
    path = Path(path)
    if not path.is_file():
        found = "is a folder" if path.is_dir() else "does not exist"
        raise FileError(f"{path}: the texture {found}; give a picture (PNG or JPEG)")
    try:
        with PIL.Image.open(path) as picture:
            upright = PIL.ImageOps.exif_transpose(picture)
            light = linear_light(upright)
            return with_alpha(light, upright) if alpha else light
    except (OSError, SyntaxError, ValueError, PIL.Image.DecompressionBombError) as error:
        unknown = isinstance(error, PIL.UnidentifiedImageError)
        reason = "not a picture" if unknown else f"a broken picture ({error})"
        raise FileError(f"{path}: {reason}; a texture is a PNG or JPEG") from None


def linear_light(picture: PIL.Image.Image) -> Texture:
    """Return a Pillow image as (h, w, 3) linear light.

    16-bit grey is taken as it is; every other mode as 8-bit RGB, without its transparency.
    """
    if picture.mode.startswith("I;16"):
        coded = np.asarray(picture, dtype=np.float64) / 65535.0
        return srgb_to_linear(np.repeat(coded[:, :, None], 3, axis=2))
    linear_of_byte = srgb_to_linear(np.arange(256) / 255.0)
    return np.take(linear_of_byte, np.asarray(picture.convert("RGB")))


def with_alpha(light: Texture, picture: PIL.Image.Image) -> Texture:
    """Return a picture's linear light with its alpha as a fourth channel; 1 where it has none."""
    coded = np.asarray(picture.convert("RGBA"))[:, :, 3:]
    opacity = coded if picture.has_transparency_data else np.full_like(coded, 255)
    return np.concatenate([light, opacity.astype(np.float32) / np.float32(255.0)], axis=2)


def srgb_to_linear(coded: NDArray[np.float64]) -> Texture:
    """Undo the sRGB transfer function (IEC 61966-2-1) of values from 0 to 1."""
    linear = np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)
    return np.asarray(linear, dtype=np.float32)
