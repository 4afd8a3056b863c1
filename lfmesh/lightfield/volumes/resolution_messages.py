"""Messages on the resolution of a camera in a box of voxels."""

import numpy as np

from lfmesh.errors import FineVoxelsWarning
from lfmesh.lightfield.volumes.projection_matrix import ProjectionMatrix

MOST_HIDDEN = 0.1
"""Fraction of a volume's features below the noise above which voxels count as too fine."""


def fine_voxels(matrix: ProjectionMatrix, seen: int) -> list[FineVoxelsWarning]:
    """Return a warning if voxels are finer than the camera resolves.

    Parameters
    ----------
    matrix : ProjectionMatrix
    seen : int
        Number of voxels seen by any pixel.
    """
    if matrix.effective_rank >= (1.0 - MOST_HIDDEN) * seen:
        return []
    axes = "".join(
        f"; along {name} {_length(length)} are resolved, with voxels of {spacing:.3g} mm"
        for name, spacing, length in zip("xyz", matrix.grid.spacing_mm, matrix.resolved_mm, strict=True)
        if length > spacing
    )
    return [
        FineVoxelsWarning(
            f"voxels are finer than the camera resolves: of {seen:,} voxels only {matrix.effective_rank:,} independent "
            f"features exceed noise of 1 %{axes}; finer details come from the method, not from the image: use coarser "
            "voxels"
        )
    ]


def _length(length: float) -> str:
    return f"{length:.3g} mm" if np.isfinite(length) else "an unlimited length"


def resolution_message(matrix: ProjectionMatrix) -> str:
    """Return the resolution of a camera in a box of voxels as one line.

    Parameters
    ----------
    matrix : ProjectionMatrix
    """
    lengths = ", ".join(
        f"{name} {_length(length)}" for name, length in zip("xyz", matrix.resolved_mm, strict=True) if length == length
    )
    along = f"resolved along the box's own {lengths}; " if lengths else ""
    return f"{along}effective rank {matrix.effective_rank:,} of {matrix.grid.voxels:,} voxels at 1 % noise"
