"""Export of each view as a separate picture."""

from pathlib import Path
from typing import Any

import PIL.Image

from lfmesh.files import exr
from lfmesh.files.colour import srgb_encode
from lfmesh.files.exports.light import linear_rgb
from lfmesh.files.preview import white_point
from lfmesh.lightfield.views.field import LightField
from lfmesh.lightfield.views.upright import UPRIGHT


def write_views(folder: Path, field: LightField) -> dict[str, Any]:
    """Write ``view_v00_u00.png`` etc. (sRGB, one exposure) and ``.exr`` (as measured, with standard errors)."""
    rows, columns = field.views
    rgb, known = linear_rgb(field)
    white = white_point(rgb.max(axis=-1).astype(float), known)
    names = []
    for v in range(rows):
        for u in range(columns):
            name = f"view_v{v:02d}_u{u:02d}"
            picture = PIL.Image.fromarray(srgb_encode(rgb[v, u] / (white or 1.0)))
            picture.save(folder / f"{name}.png", format="PNG")
            parts = {"view": field.data[v, u], "stderr": field.stderr[v, u]}
            facts = {"unit": field.unit, "orientation": UPRIGHT, "v": v, "u": u}
            exr.write(folder / f"{name}.exr", exr.SpectralImage(parts, field.wavelengths_nm, facts))
            names += [f"{name}.png", f"{name}.exr"]
    return {
        "files": names,
        "order": "views upright; v counts them as the viewpoint moves down (-y), u as it moves right (+x)",
        "encoding": "PNG: sRGB, 8 bits, one exposure for all; EXR: float32, as measured, with standard error",
        "unit": field.unit,
        "white": white,
    }
