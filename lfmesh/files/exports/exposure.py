"""Exposure of a raw and a white image for a decoder that divides one by the other."""

from dataclasses import dataclass

import numpy as np

from lfmesh.errors import LfmeshError
from lfmesh.files.exports.light import picture_rgb
from lfmesh.files.preview import WHITE_PERCENTILE, white_point
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.lightfield.calibration.white import refuse_other_white
from lfmesh.lightfield.views.field import Samples
from lfmesh.lightfield.views.upright import Upright
from lfmesh.transport.render.image import Image

UPRIGHT_ORDER = "upright: columns to the right (+x), rows down (-y), as seen from behind the camera"
"""Order of pixels, as stated in ``export.json``."""

LIT = 0.1
"""Pixels whose white exceeds this fraction of the bright pixels set the exposure of the raw image."""


@dataclass(frozen=True)
class Exposure:
    """Upright raw and white image, scaled so that raw / white is 1 where the scene is brightest.

    Attributes
    ----------
    raw, white : (H, W, 3) float32
        Linear RGB, 0 to 1.
    radiance : float
        Radiance at raw / white = 1, W/(m² sr).
    """

    raw: Samples
    white: Samples
    radiance: float

    @classmethod
    def of(cls, image: Image, white: Image) -> "Exposure":
        """Expose both images; clip a few bright pixels so that noise does not set the exposure.

        Raises
        ------
        LfmeshError
            The images do not belong together, or one of them is black.
        """
        refuse_other_white(white, image, solved_camera(image.scene).scene.camera)
        upright = Upright.of(image.scene).picture
        raw_rgb = picture_rgb(upright(image.mean), image.wavelengths_nm)
        white_rgb = picture_rgb(upright(white.mean), white.wavelengths_nm)
        peak = white_point(white_rgb.max(axis=-1).astype(np.float64))
        lit = white_rgb.min(axis=-1) > LIT * peak
        bright = float(np.percentile(raw_rgb[lit] / white_rgb[lit], WHITE_PERCENTILE)) if lit.any() else 0.0
        if not (peak > 0.0 and bright > 0.0):
            raise LfmeshError(f"the {'raw' if peak > 0.0 else 'white'} image is black: there is nothing to decode")
        raw = np.clip(raw_rgb / (peak * bright), 0.0, 1.0)
        return cls(raw, np.clip(white_rgb / peak, 0.0, 1.0), bright)
