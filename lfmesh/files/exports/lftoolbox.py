"""The Light Field Toolbox for MATLAB (D. Dansereau), and the light-field PNG of Lytro's archives."""

from pathlib import Path
from typing import Any

import numpy as np

from lfmesh.errors import FileError
from lfmesh.files.exports.light import COUNTS, linear_rgb, to_counts
from lfmesh.files.png16 import write_rgb16
from lfmesh.lightfield.views.field import LightField

MAT, ESLF = "lightfield.mat", "lightfield.eslf.png"

MOST_BYTES = 2**31 - 1
"""Largest variable in a version 5 MAT-file."""


def write_mat(folder: Path, field: LightField) -> dict[str, Any]:
    """Write ``lightfield.mat`` with LF[j, i, l, k, c] as the toolbox's own decoder does; return the facts.

    The type is linear uint16. Channels c = 1 to 3 are red, green and blue; c = 4 is the weight, 65535 for a known
    sample, else 0.

    Raises
    ------
    FileError
        The light field is too large for a MAT-file.
    """
    from scipy.io import savemat

    rgb, known = linear_rgb(field)
    if 8 * known.size > MOST_BYTES:
        raise FileError(
            f"{MAT}: {known.size} samples take {8 * known.size} bytes, but a MAT-file holds {MOST_BYTES} per variable; "
            "decode fewer views"
        )
    counts, unit_per_count = to_counts(rgb)
    weight = np.where(known, COUNTS, 0).astype(np.uint16)
    facts = {
        "order": "LF(j, i, l, k, c) = data[v, u, t, s]: l and t down (-y), k and s right (+x) in every view; j and v "
        "grow as the viewpoint moves down (-y), i and u as it moves right (+x)",
        "encoding": "linear, 16 bits; c = 4 is the weight",
        **_scale(field, unit_per_count),
    }
    axes = {name: getattr(field, name) for name in ("v_rad", "u_rad", "t_mm", "s_mm")}
    content = {"LF": np.concatenate([counts, weight[..., None]], axis=-1), "LFMetadata": {**facts, **axes}}
    savemat(folder / MAT, content, do_compression=True)
    return {"files": [MAT], **facts}


def write_eslf(folder: Path, field: LightField) -> dict[str, Any]:
    """Write ``lightfield.eslf.png``: 16-bit linear RGB, micro-images side by side; return the facts."""
    rgb, _ = linear_rgb(field)
    v, u, t, s, _ = rgb.shape
    counts, unit_per_count = to_counts(rgb.transpose(2, 0, 3, 1, 4).reshape(t * v, s * u, 3))
    write_rgb16(folder / ESLF, counts)
    return {
        "files": [ESLF],
        "order": f"picture[t * {v} + v, s * {u} + u]: every lenslet a tile of {u} x {v} views; view v, u is every "
        f"{v}th row from v and every {u}th column from u; t and rows of a view down (-y), s and columns right (+x); v "
        "grows as the viewpoint moves down (-y), u as it moves right (+x)",
        "encoding": "linear, 16 bits per colour",
        **_scale(field, unit_per_count),
    }


def _scale(field: LightField, unit_per_count: float) -> dict[str, Any]:
    return {"unit": field.unit, "unit_per_count": unit_per_count}
