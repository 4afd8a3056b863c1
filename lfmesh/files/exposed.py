"""Exposed image in a run folder: counts as a 16-bit grey PNG, and the data sheet of the detector."""

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import PIL.Image
from numpy.typing import NDArray

import lfmesh
from lfmesh.files import run
from lfmesh.files.colour import fitted_weights, srgb_encode, srgb_weights, white_signals
from lfmesh.files.preview import white_point
from lfmesh.lightfield.detector import Exposed
from lfmesh.lightfield.views.demosaic import demosaicked
from lfmesh.lightfield.views.upright import UPRIGHT
from lfmesh.scene.camera.bands import RGB_NM, channel_labels

Array = NDArray[np.float64]

COUNTS, FACTS, PREVIEW = "exposed.png", "exposed.json", "exposed_preview.png"


def save_exposed(exposed: Exposed, folder: Path) -> list[Path]:
    """Add ``exposed.png`` (upright counts), ``exposed.json`` and ``exposed_preview.png``; return the files.

    Raises
    ------
    FileError
        The folder holds no complete run or cannot be written.
    """
    detector = exposed.detector
    facts = {
        "lfmesh_version": lfmesh.__version__,
        "raw_sha256": run.pixels_digest(folder),
        "orientation": UPRIGHT,
        "electrons": "(count - black_level) * electrons_per_count",
        **asdict(detector),
        "electrons_per_count": detector.electrons_per_count,
        "white_level": detector.white_level,
        "passbands_nm": RGB_NM if detector.bayer and not channel_labels(exposed.wavelengths_nm) else None,
        "saturated_share": float(exposed.saturated.mean()),
        "mean_expected_e": float(exposed.expected_e.mean()),
    }
    picture = exposed.upright.picture(exposed.counts)
    shown, white = preview(exposed)
    facts["preview"] = {"orientation": UPRIGHT, "encoding": "sRGB", "white_electrons": white}
    with run.added(folder) as staging:
        PIL.Image.fromarray(np.ascontiguousarray(picture)).save(staging / COUNTS, format="PNG")
        PIL.Image.fromarray(shown).save(staging / PREVIEW, format="PNG")
        (staging / FACTS).write_text(json.dumps(facts, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    return [folder / COUNTS, folder / PREVIEW, folder / FACTS]


def preview(exposed: Exposed) -> tuple[NDArray[np.uint8], float]:
    """Return an upright sRGB picture, (H, W) or (H, W, 3), of an exposure, and the electrons shown as white.

    A mosaic is demosaicked. White is that of `files.colour.srgb_weights`, exposed like other previews.

    Parameters
    ----------
    exposed : Exposed
    """
    detector = exposed.detector
    dark = detector.dark_current_e_s * detector.exposure_s
    electrons = np.ascontiguousarray(exposed.upright.picture(np.maximum(exposed.electrons - dark, 0.0)))
    if detector.bayer is None:
        light = electrons
    else:
        weights = _to_srgb(detector.electrons_per_watt(exposed.wavelengths_nm), exposed.wavelengths_nm)
        light = np.maximum(demosaicked(electrons, detector.bayer) @ weights.T, 0.0)
        light = light if len(weights) == 3 else light[:, :, 0]
    white = white_point(light)
    return srgb_encode(light / white if white > 0.0 else light), white


def _to_srgb(signals: Array, wavelengths_nm: tuple[float, ...]) -> Array:
    """Return the weights, (3, 3) from filter signals to sRGB or (1, 3) to grey.

    Parameters
    ----------
    signals : (3, channels) float64
        Electrons per filter per unit of power in each channel.
    """
    wanted = srgb_weights(wavelengths_nm)
    white = white_signals(wavelengths_nm)
    if wanted is not None:
        found = fitted_weights(signals, wanted, white)
        if found is not None:
            return found
    of_white = signals @ white
    seen = of_white > 0.0
    return np.where(seen, of_white.mean() / np.where(seen, of_white, 1.0), 0.0)[None] / max(seen.sum(), 1)
