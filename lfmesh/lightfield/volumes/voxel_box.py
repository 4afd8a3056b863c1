"""A box of uniformly emitting voxels in the world: the columns of a projection matrix."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.errors import FileError, LfmeshError
from lfmesh.geometry import frame as frames
from lfmesh.geometry.frame import Frame
from lfmesh.regular_file import Arrays, open_arrays
from lfmesh.scene.literals import literal

Array = NDArray[np.float64]

MOST_VOXELS = 2**31 - 1
"""Most voxels of a box, with 32-bit numbers."""


@dataclass(frozen=True, eq=False)
class VoxelBox:
    """A box of equal voxels, ordered [x, y, z]: voxel (i, j, k) has the number (i ny + j) nz + k.

    Attributes
    ----------
    shape : (int, int, int)
        Number of voxels along its own x, y and z.
    spacing_mm : (3,) float64
        Size of a voxel.
    origin_mm : (3,) float64
        Centre of voxel (0, 0, 0) in the box's own frame.
    position_mm, rotation_deg : (3,) float64
        World position of its origin, and its rotation about x, then y, then z.
    """

    shape: tuple[int, int, int]
    spacing_mm: Array
    origin_mm: Array
    position_mm: Array
    rotation_deg: Array

    def __post_init__(self) -> None:
        with np.errstate(over="ignore", invalid="ignore"):
            reaches = np.isfinite(self.corners_mm()).all()
        if not reaches:
            raise LfmeshError("the box of voxels exceeds the range of float64: make it smaller, or move it closer")

    @classmethod
    def of_size(
        cls, counts: ArrayLike, size_mm: ArrayLike, position_mm: ArrayLike = (0.0, 0.0, 0.0),
        rotation_deg: ArrayLike = (0.0, 0.0, 0.0),
    ) -> "VoxelBox":  # fmt: skip
        """Return a box of given size centred at a position.

        Parameters
        ----------
        counts : (3,) int
        size_mm : (3,) float, mm
            Lengths of its edges.
        position_mm, rotation_deg : (3,) float

        Returns
        -------
        VoxelBox

        Raises
        ------
        LfmeshError
            There is no voxel, or a number is invalid.
        """
        shape = _counts(counts)
        spacing = _numbers("size_mm", size_mm, positive=True) / shape
        return cls(
            shape, spacing, -0.5 * spacing * (np.array(shape) - 1.0), _numbers("position_mm", position_mm),
            _numbers("rotation_deg", rotation_deg),
        )  # fmt: skip

    @classmethod
    def of(
        cls, grid: Any, position_mm: ArrayLike = (0.0, 0.0, 0.0), rotation_deg: ArrayLike = (0.0, 0.0, 0.0)
    ) -> "VoxelBox":
        """Return the box of a voxel grid (`shape`, `spacing_mm`, `origin_mm`) in a pose; a box is returned as is.

        Parameters
        ----------
        grid : VoxelBox, or a voxel grid
        position_mm, rotation_deg : (3,) float
            Of a voxel grid's origin.

        Returns
        -------
        VoxelBox

        Raises
        ------
        LfmeshError
            It is neither, has no voxels, or a number is invalid.
        """
        if isinstance(grid, cls):
            return grid
        missing = [name for name in ("shape", "spacing_mm", "origin_mm") if not hasattr(grid, name)]
        if missing:
            raise LfmeshError(
                f"grid is {type(grid).__name__}, without {missing[0]}: give lf.VoxelBox.of_size(counts, size_mm, "
                "position_mm), or a voxel grid"
            )
        return cls(
            _counts(grid.shape), _numbers("spacing_mm", grid.spacing_mm, positive=True),
            _numbers("origin_mm", grid.origin_mm), _numbers("position_mm", position_mm),
            _numbers("rotation_deg", rotation_deg),
        )  # fmt: skip

    @property
    def voxels(self) -> int:
        """Number of voxels."""
        return int(np.prod(self.shape, dtype=np.int64))

    @property
    def to_world(self) -> Frame:
        """Transformation from the box's frame to the world, (3, 4)."""
        return frames.frame(self.rotation_deg, self.position_mm)

    @property
    def axes_mm(self) -> tuple[Array, Array, Array]:
        """Centres of the voxels along its own x, y and z."""
        x, y, z = (o + s * np.arange(n) for o, s, n in zip(self.origin_mm, self.spacing_mm, self.shape, strict=True))
        return x, y, z

    def centres_mm(self) -> Array:
        """Return the centres of all voxels, world frame.

        Returns
        -------
        (nx, ny, nz, 3) float64
            mm.
        """
        own = np.stack(np.meshgrid(*self.axes_mm, indexing="ij"), axis=-1)
        return frames.points(self.to_world, own.reshape(-1, 3)).reshape(own.shape)

    def corners_mm(self) -> Array:
        """Return the corners of the box, world frame.

        Returns
        -------
        (8, 3) float64
            mm.
        """
        low = self.origin_mm - 0.5 * self.spacing_mm
        ends = np.stack([low, low + self.spacing_mm * self.shape])
        own = np.array([[ends[i, 0], ends[j, 1], ends[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
        return frames.points(self.to_world, own)

    def in_voxels(self, p: Array, d: Array) -> tuple[Array, Array]:
        """Return rays in units of voxels, from one corner of the box at (0, 0, 0) to the opposite one at `shape`.

        Parameters
        ----------
        p, d : (n, 3) float64
            Position, mm, and direction, world frame. Lengths along the ray stay in mm.

        Returns
        -------
        p, d : (n, 3) float64
            Position and direction.
        """
        inverse = frames.inverse(self.to_world)
        low = self.origin_mm - 0.5 * self.spacing_mm
        places = (frames.points(inverse, p) - low) / self.spacing_mm
        return np.ascontiguousarray(places), np.ascontiguousarray(frames.directions(inverse, d) / self.spacing_mm)


_PLACE = ("spacing_mm", "origin_mm")


class GridFile(NamedTuple):
    """Position and number of the voxels of a grid in a file."""

    shape: tuple[int, ...]
    spacing_mm: Array
    origin_mm: Array


def read_box(path: Path) -> GridFile:
    """Read the voxel positions of a grid from a `.npz` file: `spacing_mm`, `origin_mm`, and arrays [x, y, z].

    Raises
    ------
    FileError
        The file cannot be read, or lacks them.
    """
    try:
        with open_arrays(path) as arrays:
            shapes = {shape for name in arrays.names if len(shape := arrays.header(name).shape) == 3}
            # The values in the voxels are not needed.
            place = {name: arrays[name] for name in _PLACE if name in arrays.names and _is_place(arrays, name)}
    except FileNotFoundError:
        raise FileError(f"{path}: no such file") from None
    except Exception:  # numpy's and zip's readers may raise anything for a damaged file
        raise FileError(f"{path}: cannot be read as numpy's .npz") from None
    if "spacing_mm" not in place or len(shapes) != 1:
        missing = "spacing_mm" if "spacing_mm" not in place else "one shape of its arrays [x, y, z]"
        raise FileError(f"{path}: missing {missing}; a voxel grid has spacing_mm, origin_mm and arrays [x, y, z]")
    shape = shapes.pop()
    spacing = _numbers("spacing_mm", np.broadcast_to(place["spacing_mm"], 3), positive=True)
    origin = place.get("origin_mm", -0.5 * spacing * (np.array(shape) - 1.0))
    return GridFile(shape, spacing, origin)


def _is_place(arrays: Arrays, name: str) -> bool:
    """Tell from its header whether an array holds one or three numbers."""
    header = arrays.header(name)
    return header.size in (1, 3) and header.nbytes <= 3 * np.dtype(np.complex128).itemsize


def _counts(given: Any) -> tuple[int, int, int]:
    counts = np.asarray(given)
    whole = counts.dtype.kind in "iu" and counts.shape == (3,)
    if not whole or (counts < 1).any() or np.prod(counts, dtype=np.float64) > MOST_VOXELS:
        raise LfmeshError(
            f"counts = {literal(np.asarray(given).tolist())}: must be three whole numbers from 1, with at most "
            f"{MOST_VOXELS:,} voxels"
        )
    return int(counts[0]), int(counts[1]), int(counts[2])


def _numbers(name: str, given: Any, *, positive: bool = False) -> Array:
    try:
        values = np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        values = np.full(0, np.nan)
    if values.shape != (3,) or not np.isfinite(values).all() or (positive and not (values > 0.0).all()):
        raise LfmeshError(f"{name} = {literal(given)}: must be three numbers{' above 0' if positive else ''}")
    return values
