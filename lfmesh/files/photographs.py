"""Photographs computed from a light field: EXR with standard errors, and pictures."""

import math
from pathlib import Path
from typing import Any

import numpy as np

import lfmesh
from lfmesh.files import exr, run
from lfmesh.files.picture import write_animation, write_picture
from lfmesh.lightfield.photographs.photograph import AllInFocus, FocalStack, Photograph
from lfmesh.lightfield.views.upright import UPRIGHT

STACK, ALL_IN_FOCUS = "stack", "all_in_focus"


def save_photograph(photograph: Photograph, folder: Path) -> list[Path]:
    """Add a photograph to a run folder as upright ``refocused_480mm.exr`` and ``.png``; return the files.

    Names include methods other than "shift": ``refocused_480mm_fourier.exr``.

    Raises
    ------
    FileError
        The folder holds no complete run or cannot be written.
    """
    method = "" if photograph.method == "shift" else f"_{photograph.method}"
    name = f"refocused_{photograph.distance_mm:.10g}mm{method}"
    parts = {"mean": photograph.mean, "stderr": photograph.stderr}
    with run.added(folder) as staging:
        _write(staging / f"{name}.exr", parts, photograph, _facts(photograph))
        write_picture(staging / f"{name}.png", photograph.mean, photograph.wavelengths_nm)
    return [folder / f"{name}.exr", folder / f"{name}.png"]


def save_stack(stack: FocalStack, folder: Path) -> list[Path]:
    """Add a focal stack: ``stack.exr`` with one part per plane, and an animated ``stack.png``; return the files.

    Raises
    ------
    FileError
        As for `save_photograph`.
    """
    first = stack.photographs[0]
    facts = {"planes": [_facts(photograph) for photograph in stack.photographs]}
    parts = {f"{photograph.distance_mm:.10g} mm": photograph.mean for photograph in stack.photographs}
    with run.added(folder) as staging:
        _write(staging / f"{STACK}.exr", parts, first, facts)
        pictures = [photograph.mean for photograph in stack.photographs]
        write_animation(staging / f"{STACK}.png", pictures, first.wavelengths_nm)
    return [folder / f"{STACK}.exr", folder / f"{STACK}.png"]


def save_all_in_focus(picture: AllInFocus, folder: Path) -> list[Path]:
    """Add ``all_in_focus.exr``, including the distance of each sample, and ``.png``; return the files.

    Raises
    ------
    FileError
        As for `save_photograph`.
    """
    distance = np.repeat(picture.distance_mm[:, :, None], len(picture.wavelengths_nm), axis=2)
    parts = {"mean": picture.mean, "stderr": picture.stderr, "distance_mm": distance}
    with run.added(folder) as staging:
        _write(staging / f"{ALL_IN_FOCUS}.exr", parts, picture, {"distance": "of the sharpest plane, mm"})
        write_picture(staging / f"{ALL_IN_FOCUS}.png", picture.mean, picture.wavelengths_nm)
    return [folder / f"{ALL_IN_FOCUS}.exr", folder / f"{ALL_IN_FOCUS}.png"]


def _facts(photograph: Photograph) -> dict[str, Any]:
    values = {
        "distance_mm": photograph.distance_mm,
        "f_number": photograph.f_number,
        "sample_mm": photograph.sample_mm,
    }
    return {name: value if math.isfinite(value) else None for name, value in values.items()}


def _write(path: Path, parts: dict[str, Any], picture: Photograph | AllInFocus, facts: dict[str, Any]) -> None:
    metadata = {"lfmesh_version": lfmesh.__version__, "orientation": UPRIGHT, "unit": picture.unit, **facts}
    pixels = {name: np.asarray(values, dtype=np.float32) for name, values in parts.items()}
    exr.write(path, exr.SpectralImage(pixels, picture.wavelengths_nm, metadata))
