"""Folder of the HCI 4D light-field benchmark (K. Honauer et al., ACCV 2016): views, parameters.cfg, PFM maps.

The benchmark's camera is an array of pinhole cameras. All look along z, with their sensors shifted so that points at
the focus distance do not move between views. The views of a plenoptic camera are such pinholes, side by side in its
entrance pupil.
"""

import configparser
import math
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
from numpy.typing import NDArray

import lfmesh
from lfmesh.errors import LfmeshError
from lfmesh.files.colour import srgb_encode
from lfmesh.files.exports.light import linear_rgb
from lfmesh.files.pfm import write_pfm
from lfmesh.files.preview import white_point
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.lightfield.views.field import LightField

PARAMETERS = "parameters.cfg"
DEPTH, DISPARITY = "gt_depth_lowres.pfm", "gt_disp_lowres.pfm"

PROBE = 0.1
"""Shift, in lenslets, at which the baseline is measured; other shifts differ by the lens's aberrations."""


@dataclass(frozen=True)
class CameraArray:
    """Pinhole cameras equivalent to the views of a light field.

    Attributes
    ----------
    baseline_mm : float
        Spacing of neighbouring cameras.
    focal_length_px : float
        Focal length in samples of a view.
    focus_mm : float
        From the cameras to the plane that does not move between views.
    entrance_pupil_mm : float
        Distance of the cameras behind the first vertex of the lens.
    """

    baseline_mm: float
    focal_length_px: float
    focus_mm: float
    entrance_pupil_mm: float

    @classmethod
    def of(cls, field: LightField) -> "CameraArray":
        """Find the cameras by first-order optics.

        Raises
        ------
        LfmeshError
            The camera is focused at infinity, or telecentric on the object side.
        """
        model, pupil = field.model, solved_camera(field.scene).facts.entrance_pupil_z_mm
        focus = model.distance_mm(0.0)
        if not (math.isfinite(focus + pupil) and focus + pupil > 0.0):
            raise LfmeshError(
                f"hci: the format needs cameras before their plane of focus; this one focuses {focus:g} mm before the "
                f"lens, from an entrance pupil at z = {pupil:g} mm"
            )
        focal_length = (focus + pupil) / (field.spacing_mm[1] * abs(model.object_scale(focus)))
        shift = PROBE * model.lenslet_pitch_mm
        inverse = 1.0 / (model.distance_mm(shift) + pupil) - 1.0 / (focus + pupil)
        return cls(shift / field.spacing_mm[1] / (focal_length * inverse), focal_length, focus + pupil, pupil)

    def disparity_px(self, distance_mm: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the shift between neighbouring views, in samples, of points before the first vertex of the lens."""
        depth = np.asarray(distance_mm, dtype=np.float64) + self.entrance_pupil_mm
        return np.asarray(self.baseline_mm * self.focal_length_px * (1.0 / depth - 1.0 / self.focus_mm))


def write_hci(folder: Path, field: LightField, depth_mm: NDArray[np.floating] | None = None) -> dict[str, Any]:
    """Write ``input_Cam000.png`` etc., row by row, ``parameters.cfg``, and depth as PFM; return the facts.

    Parameters
    ----------
    folder : Path
    field : LightField
    depth_mm : (t, s) float, optional
        Distances of the middle view's points before the first vertex of the lens. ``gt_depth_lowres.pfm`` gets them in
        m from the entrance pupil, ``gt_disp_lowres.pfm`` in samples per view, positive nearer than the focus.

    Raises
    ------
    LfmeshError
        As for `CameraArray.of`, or the depth map and a view differ in size.
    """
    if depth_mm is not None and depth_mm.shape != field.size:
        height, width = field.size
        raise LfmeshError(
            f"the depth map has {' × '.join(map(str, depth_mm.shape[::-1]))} samples, a view has {width} × {height}"
        )
    cameras = CameraArray.of(field)
    names = _write_pictures(folder, field)
    reach = field.model.lenslet_pitch_mm / field.spacing_mm[1]
    low, high = -reach, reach
    if depth_mm is not None:
        disparity = cameras.disparity_px(depth_mm)
        write_pfm(folder / DEPTH, (depth_mm + cameras.entrance_pupil_mm) / 1000.0)
        write_pfm(folder / DISPARITY, disparity)
        names += [DEPTH, DISPARITY]
        known = disparity[np.isfinite(disparity)]
        if known.size:
            low, high = float(known.min()), float(known.max())
    with (folder / PARAMETERS).open("w", encoding="utf-8") as file:
        _parameters(field, cameras, low, high).write(file)
    return {
        "files": [*names, PARAMETERS],
        "order": f"input_Cam%03d.png is view v * {field.views[1]} + u: row by row from the highest viewpoint (+y), "
        "each from left to right (+x); views upright",
        "encoding": "sRGB, 8 bits, one exposure for all",
        "depth": "m from the entrance pupil; disparity in samples per view, positive nearer than the focus: such a "
        "point lies further left in the next camera to the right, further up in the next one below",
    }


def _write_pictures(folder: Path, field: LightField) -> list[str]:
    rows, columns = field.views
    rgb, known = linear_rgb(field)
    white = white_point(rgb.max(axis=-1).astype(float), known) or 1.0
    names = [f"input_Cam{number:03d}.png" for number in range(rows * columns)]
    for number, name in enumerate(names):
        view = rgb[number // columns, number % columns]
        PIL.Image.fromarray(srgb_encode(view / white)).save(folder / name, format="PNG")
    return names


def _parameters(field: LightField, cameras: CameraArray, low: float, high: float) -> configparser.ConfigParser:
    (height, width), (rows, columns) = field.size, field.views
    # The benchmark defines the focal length in pixels as focal_length_mm / sensor_size_mm * max(width, height).
    sensor_mm = field.model.efl_mm * max(width, height) / cameras.focal_length_px
    config = configparser.ConfigParser(interpolation=None)
    config["intrinsics"] = {
        "focal_length_mm": repr(field.model.efl_mm),
        "image_resolution_x_px": str(width),
        "image_resolution_y_px": str(height),
        "sensor_size_mm": repr(sensor_mm),
        "fstop": repr(field.model.f_number),
    }
    config["extrinsics"] = {
        "num_cams_x": str(columns),
        "num_cams_y": str(rows),
        "baseline_mm": repr(cameras.baseline_mm),
        "focus_distance_m": repr(cameras.focus_mm / 1000.0),
        **{f"center_cam_{axis}_m": "0.0" for axis in "xyz"},
        **{f"center_cam_r{axis}_rad": "0.0" for axis in "xyz"},
        "offset": repr(cameras.baseline_mm * cameras.focal_length_px / cameras.focus_mm),
    }
    config["meta"] = {
        "scene": field.scene.name,
        "category": "lfmesh",
        "date": date.today().isoformat(),
        "version": lfmesh.__version__,
        "authors": "",
        "contact": "",
        "disp_min": repr(low),
        "disp_max": repr(high),
        "frustum_disp_min": repr(low),
        "frustum_disp_max": repr(high),
        "depth_map_scale": "1.0",
    }
    return config
