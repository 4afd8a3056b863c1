"""The projection matrix of a camera: power on each pixel for the emission of each voxel."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.errors import (
    LfmeshError,
    PictureWarning,
)
from lfmesh.lightfield.volumes.resolution import effective_rank, resolved_lengths
from lfmesh.lightfield.volumes.voxel_box import VoxelBox

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class ProjectionMatrix:
    """Matrix from the emission of voxels to the power on pixels.

    Attributes
    ----------
    matrix : (rows, voxels) scipy.sparse csr_array of float64, W/(W mm⁻³ sr⁻¹) = mm³ sr
        Power in W on each pixel for a voxel that emits 1 W/(mm³ sr): A in b = A x.
    stderr : (entries,) float32
        Standard error of each entry, ordered like `matrix.data`; NaN for a single replicate, 0 for point spreads.
        Errors of a row are not independent, as its entries share rays.
    row_stderr : (rows,) float64
        Standard error of each row's sum, a pixel's view of uniform emission.
    dropped : (rows,) float64
        Sum of each row's dropped entries.
    pixels : (rows,) int64
        Pixel number of each row, counted row by row of the sensor.
    grid : VoxelBox
    threshold : float
        Entries below this fraction of their row's largest were dropped.
    wavelength_nm : float
        For a band, its centroid.
    warnings : tuple of PictureWarning
        Reasons why it is or may be wrong.
    sensor_pixels : (int, int), optional
        Columns and rows of the sensor of the pixel numbers.
    """

    matrix: "csr_array"
    stderr: NDArray[np.float32]
    row_stderr: Array
    dropped: Array
    pixels: Numbers
    grid: VoxelBox
    threshold: float
    wavelength_nm: float
    warnings: tuple[PictureWarning, ...] = ()
    sensor_pixels: tuple[int, int] | None = None

    def __repr__(self) -> str:
        voxels = " × ".join(map(str, self.grid.shape))
        entries = f"{self.matrix.nnz:,} entries, {self.wavelength_nm:g} nm"
        return f"<ProjectionMatrix: {len(self.pixels):,} pixels by {voxels} voxels, {entries}>"

    @property
    def image_shape(self) -> tuple[int, int] | None:
        """Rows and columns of the rectangle that the pixels fill, row by row; None if there is none or unknown."""
        if self.sensor_pixels is None:
            return None
        y, x = np.divmod(self.pixels, self.sensor_pixels[0])
        rows, columns = int(np.ptp(y)) + 1, int(np.ptp(x)) + 1
        return (rows, columns) if rows * columns == len(self.pixels) else None

    @property
    def dropped_share(self) -> float:
        """Dropped fraction of the sum of all entries."""
        left_out = float(self.dropped.sum())
        return left_out / (left_out + float(self.matrix.data.sum())) if left_out > 0.0 else 0.0

    @cached_property
    def resolved_mm(self) -> Array:
        """Distance between two voxels with half-alike images, along each axis of the grid, (3,) float64, mm.

        See `lfmesh.lightfield.volumes.resolution.resolved_lengths`.
        """
        return resolved_lengths(self.matrix, self.grid.shape, self.grid.spacing_mm)

    @cached_property
    def effective_rank(self) -> int:
        """Number of independent features of a volume above noise of 1 % of the brightest one.

        Singular values above 1/100 of the largest; see `lfmesh.lightfield.volumes.resolution.effective_rank`.
        """
        return effective_rank(self.matrix)

    def image(self, emission: ArrayLike) -> Array:
        """Return the image of an emission.

        Parameters
        ----------
        emission : (nx, ny, nz) or (voxels,) float64, W/(mm³ sr)

        Returns
        -------
        (rows,) float64
            W.

        Raises
        ------
        LfmeshError
            The emission has another number of voxels.
        """
        x = np.asarray(emission, dtype=np.float64)
        if x.shape not in (self.grid.shape, (self.grid.voxels,)):
            raise LfmeshError(f"the emission has the shape {x.shape}, but the grid {self.grid.shape} voxels")
        return np.asarray(self.matrix @ x.reshape(-1))
