"""Pictures of voxels by the point spreads of their centres, for cameras treated with waves."""

import math

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import (
    DiffractionWarning,
    LfmeshError,
    PictureWarning,
    warn_caller,
)
from lfmesh.geometry import frame as frames
from lfmesh.lightfield.volumes.voxel_box import VoxelBox
from lfmesh.scene import Scene
from lfmesh.scene.memory import fits_into_memory
from lfmesh.waves.pictures import pictures_of_points
from lfmesh.waves.point_spread import warnings_of

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]
WIDE_VOXELS = 0.02
"""Difference between pictures of a voxel and of its centre, over the light, above which a wave matrix warns."""


def voxel_pictures(
    scene: Scene, grid: VoxelBox, to_camera: Array, wavelength_nm: float, tolerance: float
) -> tuple[Array, list[PictureWarning]]:
    """Compute the power on each pixel for each voxel by the point spread of its centre, with warnings.

    Parameters
    ----------
    scene : Scene
    grid : VoxelBox
    to_camera : (3, 4) float64
        World frame to camera frame.
    wavelength_nm : float
    tolerance : float
        Of point spreads, see `lf.point_spread`.

    Returns
    -------
    pictures : (pixels, voxels) float64, mm³ sr
    warnings : list of PictureWarning

    Raises
    ------
    LfmeshError
        The point spreads do not fit into memory.
    """
    centres = grid.centres_mm().reshape(-1, 3)
    points = frames.points(to_camera, np.concatenate([centres, _within_middle_voxel(grid)]))
    pixels = math.prod(scene.camera.sensor.pixels)
    size = 8.0 * len(points) * pixels
    if not fits_into_memory(3.0 * size):
        raise LfmeshError(
            f"{len(points):,} point spreads on {pixels:,} pixels take {size / 1e9:.3g} GB: give fewer voxels or pixels"
        )
    pictures = pictures_of_points(scene, points, wavelength_nm, tolerance=tolerance)
    warnings = [*warnings_of(pictures.beyond), *_wide_voxels(pictures.mean, grid.shape)]
    warn_caller(warnings)
    own = pictures.mean[: len(centres)]
    return own.reshape(len(own), -1).T * float(np.prod(grid.spacing_mm)), warnings


def _within_middle_voxel(grid: VoxelBox) -> Array:
    """Return two Gauss points in the middle voxel along each axis of one or two voxels, (n, 3) mm, world frame."""
    middle = grid.centres_mm()[tuple(count // 2 for count in grid.shape)]
    step = grid.to_world[:, :3] * grid.spacing_mm / np.sqrt(12.0)
    few = [axis for axis, count in enumerate(grid.shape) if count < 3]
    return np.array([middle + way * step[:, axis] for axis in few for way in (-1.0, 1.0)]).reshape(-1, 3)


def _wide_voxels(pictures: Array, shape: tuple[int, int, int]) -> list[DiffractionWarning]:
    """Warn if pictures of whole voxels and of their centres differ.

    The mean over a voxel differs from its centre by 1/24 of the second differences between neighbours, along each axis.
    Along axes of one or two voxels, two Gauss points in the middle voxel give the difference.

    Parameters
    ----------
    pictures : (voxels + n, rows, columns) float64
        Of the centres, and of `_within_middle_voxel`.
    shape : (int, int, int)
    """
    voxels = math.prod(shape)
    mean, pairs = pictures[:voxels].reshape(*shape, -1), pictures[voxels:].reshape(-1, 2, *pictures.shape[1:])
    middle = pictures[np.ravel_multi_index(tuple(count // 2 for count in shape), shape)]
    off = sum(float(np.abs(pair.mean(axis=0) - middle).sum() / middle.sum()) for pair in pairs)
    for axis, count in enumerate(shape):
        if count > 2:
            off += float(np.abs(np.diff(mean, 2, axis=axis)).sum() / mean.sum()) / 24.0 * count / (count - 2)
    if off <= WIDE_VOXELS:
        return []
    return [
        DiffractionWarning(
            "a wave matrix has the point spreads of voxel centres, which differ from those of whole voxels by about "
            f"{off:.1%} of the light: use smaller voxels"
        )
    ]
