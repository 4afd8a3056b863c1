"""calibration.json: the geometry of a light-field camera, each number with its unit and meaning."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

import lfmesh
from lfmesh.errors import FileError
from lfmesh.files.json_values import parse_json
from lfmesh.lightfield.calibration.calibration import Calibration
from lfmesh.lightfield.views.upright import ON_SENSOR
from lfmesh.regular_file import read_text

FORMAT = 2
"""Version of the file format; readers refuse any other."""

MOST_PIXELS = 2**31
"""More columns or rows than any sensor has."""

ABOUT = (
    "Positions of the micro-images of a light-field camera on its sensor, and the first-order optics that give its "
    "pixels directions. Pixel positions are [column, row] with the middle of the first pixel at [0, 0], as on the "
    "sensor and in raw.exr, not in upright pictures; arrays are indexed [row of lenslets][column of lenslets]. An "
    "infinite length, such as that of a telecentric lens's exit pupil, is null."
)

MEANINGS = {
    "layout": ("", "Square lenslets in rows and columns, or hexagonal ones, with odd rows shifted by half a pitch."),
    "centres_px": ("pixel", "Centre of every micro-image: the landing point of the ray from the middle of the stop "
    "through the lenslet's apex or, from a white image, the middle of its light."),
    "known": ("", "False for a lenslet that is dark or that no such ray reaches; its centre is then extrapolated from "
    "the others by a polynomial."),
    "kinds": ("", "Index of each lenslet's focal length, from 0."),
    "focal_lengths_mm": ("mm", "Focal length of each type of lenslet, in the medium around the array."),
    "lenslet_pitch_mm": ("mm", "Distance of the centres of neighbouring lenslets, including the pitch error."),
    "pixel_mm": ("mm", "Width of a pixel."),
    "sensor_px": ("pixel", "Columns and rows of the sensor."),
    "f_number": ("", "Distance of the exit pupil from the array over its diameter: in air, the working f-number."),
    "microlens_f_number": ("", "Distance of the lenslets from the sensor over their pitch: in air, their f-number."),
    "exit_pupil_z_mm": ("mm", "Position of the exit pupil, the image of the stop that the array sees, along the axis "
    "from the first vertex of the lens."),
    "exit_pupil_diameter_mm": ("mm", "Diameter of the exit pupil."),
    "pupil_to_array_mm": ("mm", "From the exit pupil to the lenslets' front principal points: D."),
    "lenslet_to_sensor_mm": ("mm", "From the lenslets' rear principal points to the sensor, seen through the cover: "
                             "d. Neighbouring micro-images are (pitch/pixel)(D + d)/D pixels apart."),
    "wavelength_nm": ("nm", "Wavelength of the traced light."),
    "origin": ("", "Source of the centres: traced, or found on a white image."),
}  # fmt: skip
"""Unit and meaning of each field of `Calibration`."""

DERIVED = {
    "pitch_px": ("pixel", "Mean distance of neighbouring micro-images, from all known centres."),
    "rotation_rad": ("rad", "Rotation of the rows of micro-images relative to the sensor's, from columns to rows."),
}
"""Derived from the fields above; not read back."""


def write_calibration(path: Path, calibration: Calibration) -> None:
    """Write a calibration as self-explanatory JSON.

    Raises
    ------
    FileError
        The file cannot be written.
    """
    entries = {}
    for name, (unit, meaning) in {**MEANINGS, **DERIVED}.items():
        entries[name] = {"value": _plain(getattr(calibration, name)), "unit": unit, "meaning": meaning}
    document = {
        "format": FORMAT,
        "lfmesh_version": lfmesh.__version__,
        "orientation": ON_SENSOR,
        "about": ABOUT,
        "fields": entries,
    }
    try:
        path.write_text(json.dumps(document, allow_nan=False, ensure_ascii=False) + "\n", encoding="utf-8")
    except OSError as error:
        raise FileError(f"{path} cannot be written: {error.strerror or error}") from None


def read_calibration(path: Path) -> Calibration:
    """Read a file made by `write_calibration`.

    Raises
    ------
    FileError
        The file is missing, damaged, or of another format.
    """
    try:
        document = parse_json(read_text(path))
    except OSError as error:
        raise FileError(f"{path} cannot be read: {error.strerror or error}") from None
    except ValueError:
        raise FileError(f"{path} is damaged or not a calibration: it is not JSON") from None
    version = document.get("format") if isinstance(document, dict) else None
    if version != FORMAT:
        raise FileError(
            f"{path} has calibration format {version}; this lfmesh {lfmesh.__version__} reads {FORMAT}: older "
            "ones do not state the order of their pixels; make it again with lfmesh white"
        )
    try:
        values = {name: document["fields"][name]["value"] for name in MEANINGS}
        calibration = Calibration(
            **{
                **values,
                "centres_px": np.asarray(values["centres_px"], dtype=np.float64),
                "known": np.asarray(values["known"], dtype=np.bool_),
                "kinds": np.asarray(values["kinds"], dtype=np.int64),
                "focal_lengths_mm": tuple(values["focal_lengths_mm"]),
                "sensor_px": tuple(values["sensor_px"]),
                **{name: math.inf for name in ("exit_pupil_z_mm", "exit_pupil_diameter_mm", "pupil_to_array_mm")
                   if values[name] is None},
            }
        )  # fmt: skip
        whole = _is_whole(calibration)
    except (KeyError, TypeError, ValueError, OverflowError, ZeroDivisionError):
        whole = False
    if not whole:
        raise FileError(f"{path} is damaged or incomplete: it must hold {', '.join(MEANINGS)}")
    return calibration


def _is_whole(calibration: Calibration) -> bool:
    """Tell whether the arrays fit together and the numbers are possible for a camera.

    Raises
    ------
    TypeError, ValueError, OverflowError, ZeroDivisionError
        A value is not a number, or is too large or too small.
    """
    c = calibration
    above_zero = (c.lenslet_pitch_mm, c.pixel_mm, c.f_number, c.wavelength_nm)
    finite = (c.microlens_f_number, c.lenslet_to_sensor_mm, c.pitch_px, c.nominal_pitch_px, *c.focal_lengths_mm)
    # A telecentric lens has its pupil at infinity.
    pupil = (c.exit_pupil_z_mm, c.exit_pupil_diameter_mm, c.pupil_to_array_mm)
    return (
        c.centres_px.shape == (*c.known.shape, 2) == (*c.kinds.shape, 2)
        and bool((np.abs(c.centres_px) < MOST_PIXELS).all())
        and bool(((c.kinds >= 0) & (c.kinds < len(c.focal_lengths_mm))).all())
        and c.layout in ("square", "hexagonal")
        and c.origin in ("traced", "white image")
        and len(c.sensor_px) == 2
        and all(isinstance(count, int) and 0 < count < MOST_PIXELS for count in c.sensor_px)
        and all(math.isfinite(value) and value > 0.0 for value in above_zero)
        and all(math.isfinite(value) for value in finite)
        and not any(math.isnan(value) for value in pupil)
    )


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
