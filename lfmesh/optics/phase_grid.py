"""Phases from files: samples on a regular grid, in a `.npz` file of numpy."""

import hashlib
import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import FileError
from lfmesh.optics.phase_shapes import LEAST_SAMPLES, PhaseProfile, grid_profile
from lfmesh.regular_file import Arrays, Header, open_arrays

Array = NDArray[np.float64]

ENDING = ".npz"

MOST_SAMPLES = 1 << 24
"""Largest number of samples of a grid, 4096²."""


@dataclass(frozen=True)
class PhaseGrid:
    """The phase of a file. Two are equal if their contents are.

    Attributes
    ----------
    digest : str
        SHA-256 of the numbers.
    profile : PhaseProfile
    """

    digest: str
    profile: PhaseProfile = field(compare=False, repr=False)


def read_phase_grid(path: Path) -> PhaseGrid:
    """Read a phase from a file.

    Parameters
    ----------
    path : Path
        `.npz` with `phase_rad` [x, y], unwrapped, `spacing_mm` (one or two numbers), and optionally `origin_mm`, the
        position of sample [0, 0]. Without it the grid is centred on the vertex.

    Raises
    ------
    FileError
        The file cannot be read, or its content is no unwrapped phase.
    """
    if path.suffix.lower() != ENDING:
        raise FileError(f"{path}: a phase grid ends in {ENDING}; write it with numpy.savez")
    try:
        with open_arrays(path) as arrays:
            _refuse_headers(path, arrays)
            held = {name: np.asarray(arrays[name], np.float64) for name in arrays.names}
    except FileError:
        raise
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror or error}") from None
    except Exception as error:
        # numpy's and zipfile's readers may raise anything on a damaged file.
        why = " ".join(str(error).split())[:200] or type(error).__name__
        raise FileError(f"{path}: is no {ENDING} file of numpy: {why}; write it with numpy.savez") from None
    _refuse_numbers(path, held)
    profile = grid_profile(held["phase_rad"], held["spacing_mm"], held.get("origin_mm"))
    return PhaseGrid(hashlib.sha256(profile.numbers.tobytes()).hexdigest(), profile)


def _refuse_headers(path: Path, arrays: Arrays) -> None:
    """Raise if a file lacks an array, has an unknown one, or one of a wrong shape or type."""
    known = {"phase_rad": "an array [x, y]", "spacing_mm": "one or two numbers", "origin_mm": "two numbers"}
    for name in arrays.names:
        if name not in known:
            raise FileError(f"{path}: unknown array {name!r}; valid are {', '.join(known)}")
    for name in ("phase_rad", "spacing_mm"):
        if name not in arrays.names:
            raise FileError(f"{path}: has no {name}, {known[name]}")
    for name in arrays.names:
        header = arrays.header(name)
        if header.dtype.kind not in "iuf":
            raise FileError(f"{path}: {name} must hold real numbers, not {header.dtype}")
        if not _fits(name, header):
            least = f", at least {LEAST_SAMPLES} samples along each" if name == "phase_rad" else ""
            raise FileError(f"{path}: {name} has the shape {header.shape}; it must be {known[name]}{least}")
        if header.size > MOST_SAMPLES:
            raise FileError(f"{path}: {name} has {header.size} samples; at most {MOST_SAMPLES} are read")


def _fits(name: str, header: Header) -> bool:
    """Tell whether an array has a valid shape."""
    if name == "phase_rad":
        return len(header.shape) == 2 and min(header.shape) >= LEAST_SAMPLES
    return header.size == 2 or (name == "spacing_mm" and header.size == 1)


def _refuse_numbers(path: Path, held: dict[str, Array]) -> None:
    """Raise if a number is not finite, a spacing is not positive, or the phase is wrapped."""
    for name, values in held.items():
        if not np.isfinite(values).all():
            raise FileError(f"{path}: {name} must be finite everywhere")
    if not (held["spacing_mm"] > 0.0).all():
        raise FileError(f"{path}: spacing_mm must be above 0")
    phase = held["phase_rad"]
    step = max(float(np.abs(np.diff(phase, axis=axis)).max()) for axis in (0, 1))
    if float(np.ptp(phase)) <= 2.0 * math.pi * (1.0 + 1e-9) and step > math.pi:
        raise FileError(
            f"{path}: phase_rad looks wrapped: it stays within 2π, but neighbouring samples differ by up to "
            f"{step:.4g} rad; unwrap it, or give more samples"
        )
