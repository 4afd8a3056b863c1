"""Portable float maps: one float32 per pixel, bottom row first."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def write_pfm(path: Path, values: NDArray[np.floating]) -> None:
    """Write an (H, W) map, top row first, as PFM; the negative scale in its header means little-endian."""
    height, width = values.shape
    header = f"Pf\n{width} {height}\n-1.0\n".encode("ascii")
    path.write_bytes(header + np.ascontiguousarray(values[::-1], dtype="<f4").tobytes())
