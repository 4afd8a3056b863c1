"""Export for PlenoptiCam 0.9 (C. Hahne): raw picture, white picture, settings, and true micro-image centres."""

import json
import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image

from lfmesh.files.colour import srgb_encode
from lfmesh.files.exports.exposure import UPRIGHT_ORDER, Exposure
from lfmesh.lightfield.calibration.calibration import Calibration
from lfmesh.lightfield.views.upright import Upright
from lfmesh.scene.literals import plain
from lfmesh.transport.render.image import Image

RAW, WHITE, SETTINGS, CENTRES = "raw.png", "white.png", "settings.json", "centres.json"

LEAST_LENSLETS = 60
"""Smallest number along each side: PlenoptiCam estimates the pitch from the middle third, where it needs about 20."""

LEAST_PATCH = 3

LARGEST_SPOT = 0.85
"""Largest ratio of micro-image diameter to pitch: touching discs hide the gaps that reveal the pitch."""

_SETTINGS: dict[str, Any] = {
    "cal_meta": "",
    "cal_meth": "area",
    "smp_meth": "local",
    "ran_refo": [0, 2],
    "opt_cali": True,
    "opt_vign": True,
    "opt_view": True,
    "opt_refo": True,
    **{f"opt_{name}": False for name in ("lier", "cont", "colo", "awb_", "sat_", "refi", "pflu", "arti", "rota")},
    **{f"opt_{name}": False for name in ("dbug", "prnt", "dpth")},
    "dir_remo": False,
}


def write_plenopticam(folder: Path, image: Image, white: Image, calibration: Calibration) -> dict[str, Any]:
    """Write ``raw.png`` (sRGB, which PlenoptiCam decodes), ``white.png`` (linear) and settings; return the facts.

    ``settings.json`` holds parameters for ``PlenopticamConfig.read_params``. ``centres.json`` holds the true centres
    for its option ``--meta``; without it, PlenoptiCam estimates them.

    Parameters
    ----------
    folder : Path
    image, white : Image
        Images of one camera.
    calibration : Calibration

    Raises
    ------
    LfmeshError
        As for `Exposure.of`.
    """
    exposure = Exposure.of(image, white)
    _warn(calibration)
    PIL.Image.fromarray(srgb_encode(exposure.raw)).save(folder / RAW, format="PNG")
    linear = np.rint(255.0 * exposure.white).astype(np.uint8)
    PIL.Image.fromarray(linear).save(folder / WHITE, format="PNG")
    patch = max(LEAST_PATCH, (math.floor(calibration.pitch_px) - 1) // 2 * 2 + 1)
    settings = {**_SETTINGS, "lfp_path": RAW, "cal_path": WHITE, "ptc_leng": patch}
    (folder / SETTINGS).write_text(json.dumps(settings, indent=2) + "\n", encoding="utf-8")
    (folder / CENTRES).write_text(json.dumps(_centres(calibration, Upright.of(image.scene))) + "\n", encoding="utf-8")
    return {
        "files": [RAW, WHITE, SETTINGS, CENTRES],
        "order": f"pictures {UPRIGHT_ORDER}; centres in them [row, column, lenslet row, lenslet column]",
        "encoding": "raw: sRGB, white: linear; 8 bits, RGB",
        "radiance_w_m2_sr": exposure.radiance,
    }


def _centres(calibration: Calibration, upright: Upright) -> dict[str, Any]:
    columns, rows = calibration.sensor_px
    centres = upright.picture(upright.points_px(calibration.centres_px, (rows, columns)))
    row, column = np.indices(centres.shape[:2])
    places = np.stack([centres[..., 1], centres[..., 0], row, column], axis=-1).reshape(-1, 4)
    return {
        "mic_list": places.tolist(),
        "pat_type": "hex" if calibration.layout == "hexagonal" else "rec",
        "ptc_mean": [calibration.pitch_px, calibration.pitch_px],
    }


def _warn(calibration: Calibration) -> None:
    rows, columns = calibration.known.shape
    if min(rows, columns) < LEAST_LENSLETS:
        warnings.warn(
            f"PlenoptiCam needs about {LEAST_LENSLETS} × {LEAST_LENSLETS} lenslets to find them; these are "
            f"{columns} × {rows}",
            stacklevel=3,
        )
    spot = calibration.microlens_f_number / calibration.f_number
    if spot > LARGEST_SPOT:
        wide, largest = plain(spot, 2), plain(calibration.microlens_f_number / LARGEST_SPOT, 2)
        warnings.warn(
            f"PlenoptiCam may miss the pitch of the micro-images: they are {wide} pitch{'' if wide == '1' else 'es'} "
            f"wide; stop the lens down until they leave gaps, to f/{largest} or a larger f-number",
            stacklevel=3,
        )
