"""Views and depth as OpenEXR with only the channels R, G and B, which every OpenEXR reader accepts.

OpenCV returns zeros or nothing for channels other than R, G, B, A and Y. So depth, and each camera channel, are written
three times in a separate file.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.files import exr
from lfmesh.files.exports.light import linear_rgb
from lfmesh.lightfield.views.field import LightField
from lfmesh.lightfield.views.upright import UPRIGHT
from lfmesh.scene.camera.bands import channel_labels

DEPTH = "depth.exr"


def write_exr_rgb(folder: Path, field: LightField, depth_mm: NDArray[np.floating] | None = None) -> dict[str, Any]:
    """Write ``view_v00_u00.exr`` etc., plus ``view_v00_u00_c0.exr`` etc. for several channels; return the facts.

    Parameters
    ----------
    folder : Path
    field : LightField
    depth_mm : (H, W) float, optional
        Written unchanged as ``depth.exr``.
    """
    rows, columns = field.views
    rgb, _ = linear_rgb(field)
    light = np.nan_to_num(field.data)
    labels = channel_labels(field.wavelengths_nm)
    channels = list(labels or map(exr.channel_name, field.wavelengths_nm))
    apart = range(len(channels)) if len(channels) > 1 else ()
    facts = {"unit": field.unit, "orientation": UPRIGHT}
    names = []
    for v in range(rows):
        for u in range(columns):
            name, place = f"view_v{v:02d}_u{u:02d}", {**facts, "v": v, "u": u}
            names.append(f"{name}.exr")
            _write(folder / names[-1], rgb[v, u], place)
            for c in apart:
                names.append(f"{name}_c{c}.exr")
                _write(folder / names[-1], light[v, u, :, :, c], {**place, "channel": channels[c]})
    about = {
        "order": "views upright; v counts them as the viewpoint moves down (-y), u as it moves right (+x)",
        "encoding": "channels R, G, B, float32, linear; view_v00_u00.exr: sRGB primaries, R = G = B where the "
        "channels of the camera span no colours; view_v00_u00_c0.exr: R = G = B = light of channel 0; unknown: 0",
        "unit": field.unit,
        "channels": channels,
    }
    if depth_mm is not None:
        _write(folder / DEPTH, depth_mm, {"unit": "mm"})
        names.append(DEPTH)
        about["depth"] = (
            "R = G = B = distance in mm before the first vertex of the lens; NaN: unknown, inf: nothing met"
        )
    return {"files": names, **about}


def _write(path: Path, pixels: NDArray[np.floating], facts: dict[str, Any]) -> None:
    """Write (H, W, 3) as R, G and B, or (H, W) to all three."""
    exr.write_maps(path, {name: pixels[..., c] if pixels.ndim == 3 else pixels for c, name in enumerate("RGB")}, facts)
