"""Views of a camera model as OpenCV cameras in `cameras.json`, ready for OpenCV's functions."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import lfmesh
from lfmesh.errors import FileError
from lfmesh.files.json_values import parse_json
from lfmesh.files.whole import write_whole
from lfmesh.lightfield.rays.camera_model import CameraModel
from lfmesh.regular_file import read_text

NAME = "cameras.json"

FORMAT = 1
"""Version of the file format."""

ABOUT = {
    "cameras": "one pinhole per view, v and u as in lightfield.exr; view_v00_u00 is the highest and leftmost viewpoint",
    "image_size": "width and height in samples; the middle of the first sample of a picture is at (0, 0)",
    "camera_matrix": "fx 0 cx, 0 fy cy, 0 0 1; in samples",
    "distortion_coefficients": "k1, k2, p1, p2, k3",
    "rvec, tvec": "X_view = R X_world + tvec, R by Rodrigues' formula from rvec; tvec in mm; x right, y down, z ahead",
    "errors": "distance of the pinhole's projection from the sample that sees a point, in samples; over rays of the "
    "view and points on them at distances_mm before the first vertex of the lens",
    "without_pinhole": "[v, u] of views whose rays the lens stops",
}
"""Meaning of each field."""


def write_cameras(model: CameraModel, ray_map: Path) -> Path:
    """Write the pinhole cameras of all views beside the ray map.

    Parameters
    ----------
    model : CameraModel
    ray_map : Path
        Rays of the pixels.

    Returns
    -------
    Path
        The file ``cameras.json``.

    Raises
    ------
    FileError
        The file cannot be written, or as for `refuse_other_cameras`.
    """
    refuse_other_cameras(ray_map)
    path, views = ray_map.with_name(NAME), model.views
    has_rays = np.isfinite(views.rms_error)
    document = {
        "cameras_format": FORMAT,
        "lfmesh_version": lfmesh.__version__,
        "scene_digest": model.scene.digest,
        "ray_map": ray_map.name,
        "wavelength_nm": model.wavelength_nm,
        "distances_mm": views.distances_mm.tolist(),
        "about": ABOUT,
        "cameras": [_camera(model, v, u) for v, u in np.argwhere(has_rays).tolist()],
        "without_pinhole": np.argwhere(~has_rays).tolist(),
    }
    write_whole(path, json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False) + "\n")
    return path


def _camera(model: CameraModel, v: int, u: int) -> dict[str, Any]:
    views = model.views
    height, width = views.size.tolist()
    return {
        "name": f"view_v{v:02d}_u{u:02d}",
        "v": v,
        "u": u,
        "image_size": [width, height],
        "camera_matrix": views.intrinsics[v, u].tolist(),
        "distortion_coefficients": [*views.distortion[v, u].tolist(), 0.0],
        "rvec": Rotation.from_matrix(views.rotation[v, u]).as_rotvec().tolist(),
        "tvec": views.translation_mm[v, u].tolist(),
        "rms_error": float(views.rms_error[v, u]),
        "largest_error": float(views.largest_error[v, u]),
    }


def refuse_other_cameras(ray_map: Path) -> None:
    """Refuse a place for a ray map beside the pinhole cameras of another one.

    Parameters
    ----------
    ray_map : Path

    Raises
    ------
    FileError
        ``cameras.json`` there belongs to another ray map or was not written by lfmesh.
    """
    path = ray_map.with_name(NAME)
    if not path.exists():
        return
    try:
        other = str(parse_json(read_text(path))["ray_map"])
    except (OSError, ValueError, KeyError, TypeError):
        other = ""
    if Path(other).stem != ray_map.stem:
        whose = f"belongs to {other}" if other else "was not written by lfmesh"
        raise FileError(
            f"{path} {whose}, and would be replaced: choose another folder for {ray_map.name}, or delete it"
        )
