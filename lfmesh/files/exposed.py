"""An exposed image in a run folder: counts as a 16-bit grey PNG, and the data sheet of the detector."""

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import PIL.Image

import lfmesh
from lfmesh.files import run
from lfmesh.lightfield.detector import PASSBANDS_NM, Exposed
from lfmesh.lightfield.upright import UPRIGHT

COUNTS, FACTS = "exposed.png", "exposed.json"


def save_exposed(exposed: Exposed, folder: Path) -> list[Path]:
    """Add ``exposed.png``, the counts upright, and ``exposed.json`` to a run folder; return the files.

    Raises
    ------
    FileError
        There is no complete run, or the folder cannot be written.
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
        "passbands_nm": PASSBANDS_NM if detector.bayer else None,
        "saturated_share": float(exposed.saturated.mean()),
        "mean_expected_e": float(exposed.expected_e.mean()),
    }
    picture = exposed.upright.picture(exposed.counts)
    with run.added(folder) as staging:
        PIL.Image.fromarray(np.ascontiguousarray(picture)).save(staging / COUNTS, format="PNG")
        (staging / FACTS).write_text(json.dumps(facts, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    return [folder / COUNTS, folder / FACTS]
