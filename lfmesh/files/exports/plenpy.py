"""Export for `RayTracerLF` of plenpy 0.9 (M. Schambach): a camera folder of pictures with JSON side files."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from lfmesh.errors import LfmeshError
from lfmesh.files.exports.exposure import UPRIGHT_ORDER, Exposure
from lfmesh.files.exports.light import COUNTS
from lfmesh.files.png16 import write_rgb16
from lfmesh.lightfield.calibration.calibration import Calibration
from lfmesh.transport.render.image import Image

RAW, WHITE, SETTINGS = "Images/raw.png", "Calibration/WhiteImages/white.png", "camera.json"


def write_plenpy(folder: Path, image: Image, white: Image, calibration: Calibration) -> dict[str, Any]:
    """Write 16-bit linear raw and white pictures with their side files; return the facts.

    ``camera.json`` holds the arguments of `RayTracerLF`. From its ``imageDistance`` D and focal length d, plenpy
    derives the ratio of micro-image pitch to lenslet pitch.

    Parameters
    ----------
    folder : Path
    image, white : Image
        Images of one camera.
    calibration : Calibration

    Raises
    ------
    LfmeshError
        As for `Exposure.of`; square lenslets, which plenpy does not decode; an exit pupil at infinity or behind the
        array.
    """
    if calibration.layout != "hexagonal":
        raise LfmeshError("plenpy decodes hexagonal arrays only; this one is square: export to plenopticam")
    distance = calibration.pupil_to_array_mm
    if not (math.isfinite(distance) and distance > 0.0):
        raise LfmeshError(
            f"plenpy needs an exit pupil in front of the array, at a finite distance; here it is {distance:g} mm"
        )
    exposure = Exposure.of(image, white)
    side = {"camera": {"imageDistance": distance / 1000.0, "focusDistance": distance / 1000.0}}
    for name, picture in ((RAW, exposure.raw), (WHITE, exposure.white)):
        path = folder / name
        path.parent.mkdir(parents=True)
        write_rgb16(path, np.rint(picture * COUNTS).astype(np.uint16))
        path.with_suffix(".json").write_text(json.dumps(side) + "\n", encoding="utf-8")
    settings = {
        "grid_type": "hex",
        "ml_size": round(calibration.pitch_px),  # an integer: plenpy picks a filter by comparison with 14 and 15
        "ml_focal_length": calibration.lenslet_to_sensor_mm / 1000.0,
        "format": "PNG-PIL",
    }
    (folder / SETTINGS).write_text(json.dumps(settings, indent=2) + "\n", encoding="utf-8")
    return {
        "files": [RAW, WHITE, SETTINGS, *(name.replace(".png", ".json") for name in (RAW, WHITE))],
        "order": f"pictures {UPRIGHT_ORDER}",
        "encoding": "linear, 16 bits, RGB; lengths in the side files in m",
        "radiance_w_m2_sr": exposure.radiance,
    }
