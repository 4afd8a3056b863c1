"""Portable float maps: one float32 a pixel, the bottom row first."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def write_pfm(path: Path, values: NDArray[np.floating]) -> None:
    """Write an (H, W) map whose first row is the top one; the negative scale of the format says little-endian."""
    height, width = values.shape
    header = f"Pf\n{width} {height}\n-1.0\n".encode("ascii")
    path.write_bytes(header + np.ascontiguousarray(values[::-1], dtype="<f4").tobytes())
