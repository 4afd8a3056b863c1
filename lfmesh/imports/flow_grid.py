"""Flow fields of simulations, resampled onto the voxel grids of media.

Files are whatever pyvista reads, such as OpenFOAM cases, VTK and CGNS files.
A value at a voxel's centre is the one that VTK interpolates in the cell around it. The error of the resampling is the
difference between the file and the resampled grid, interpolated as media are, on a grid twice as fine.
"""

import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lfmesh.errors import FileError
from lfmesh.geometry.files.mesh_file import MM_PER_UNIT
from lfmesh.geometry.voxels import INDEX_QUANTITIES, MOST_VOXELS, QUANTITIES, VoxelGrid, voxel_grid
from lfmesh.imports import vtk_child
from lfmesh.optics.index_fields import field_table, index_field, indices_at
from lfmesh.regular_file import read_bytes, why_no_file
from lfmesh.scene.memory import physical_memory_bytes

Array = NDArray[np.float64]

UNIT_OF_FORMAT = {".foam": "m"}
"""Units of the formats that have one."""

SPLINES = ("temperature_k", *INDEX_QUANTITIES)
"""Quantities that are compared by cubic splines, as they set an index; the others are trilinear."""

POINTS_AT_ONCE = 1 << 22

VALID = "vtkValidPointMask"
"""Array of VTK's that tells the points in cells from the others."""


@dataclass(frozen=True)
class FlowArray:
    """An array of a flow file, and the quantity that it gives.

    Attributes
    ----------
    name : str
        In the file.
    quantity : str
        One of `QUANTITIES`, in its unit after multiplication by the factor.
    factor : float
    fill : float or None
        Value of the quantity outside the cells of the file. None: refuse such voxels.
    """

    name: str
    quantity: str
    factor: float = 1.0
    fill: float | None = None


@dataclass(frozen=True)
class Resampling:
    """Voxels onto which a flow is resampled.

    Attributes
    ----------
    spacing_mm : (3,) tuple of float
    units : str or None
        Unit of length of the file. None: that of its format.
    bounds_mm : (6,) tuple of float, or None
        Lowest and highest x, y and z of the outer voxels' centres. None: those of the file.
    time_s : float or None
        Time of the flow. None: the last one.
    """

    spacing_mm: tuple[float, float, float]
    units: str | None = None
    bounds_mm: tuple[float, float, float, float, float, float] | None = None
    time_s: float | None = None


@dataclass(frozen=True, eq=False)
class ResampledFlow:
    """A flow on a voxel grid.

    Attributes
    ----------
    grid : VoxelGrid
    outside : float
        Share of the voxels that lie outside the cells of the file, and were filled.
    largest, rms : mapping of str to float
        Difference between the file and the grid on a grid twice as fine, by quantity and in its unit.
    """

    grid: VoxelGrid
    outside: float
    largest: Mapping[str, float] = field(default_factory=dict)
    rms: Mapping[str, float] = field(default_factory=dict)

    def lines(self) -> list[str]:
        """Describe the grid and its errors."""
        low, high = self.grid.bounds_mm
        counts, sizes = (" × ".join(f"{each:g}" for each in part) for part in (self.grid.shape, self.grid.spacing_mm))
        ends = ", ".join(f"{name} {a:.5g} to {b:.5g}" for name, a, b in zip("xyz", low, high, strict=True))
        lines = [f"{counts} voxels of {sizes} mm: {ends} mm"]
        for name, values in self.grid.values.items():
            least, most = float(values.min()), float(values.max())
            range_ = most - least
            share = f" ({100.0 * self.largest[name] / range_:.3g} % of its range)" if range_ > 0.0 else ""
            lines.append(
                f"{name}: {least:.6g} to {most:.6g}; on a grid twice as fine the file differs by up to "
                f"{self.largest[name]:.3g}{share}, {self.rms[name]:.3g} rms"
            )
        if self.outside > 0.0:
            lines.append(f"{100.0 * self.outside:.3g} % of the voxels lie outside the cells of the file: filled")
        return lines


def resampled(path: Path, arrays: tuple[FlowArray, ...], wanted: Resampling) -> ResampledFlow:
    """Resample arrays of a flow file onto voxels.

    Parameters
    ----------
    path : Path
    arrays : tuple of FlowArray
        Empty: the arrays of the file that are named as quantities.
    wanted : Resampling

    Raises
    ------
    FileError
        The file cannot be read, has no volume or no such array, its unit is unknown, or voxels lie outside its cells.
    """
    mesh = _scaled(_volume(path, wanted.time_s), _mm_per_unit(path, wanted.units))
    mesh, arrays = _with_arrays(mesh, arrays, path)
    axes = _axes(mesh, wanted, path)
    found, inside = _values(mesh, arrays, axes)
    outside = 1.0 - float(inside.mean())
    for each in arrays:
        if outside > 0.0 and each.fill is None:
            raise FileError(
                f"{path}: {100.0 * outside:.3g} % of the voxels lie outside its cells; give smaller bounds, or the "
                f"value of {each.quantity} there"
            )
        found[each.quantity][~inside] = 0.0 if each.fill is None else each.fill
    spacing = np.array(wanted.spacing_mm)
    grid = voxel_grid(found, spacing, np.array([axis[0] for axis in axes]), where=str(path))
    return ResampledFlow(grid, outside, *_differences(mesh, arrays, grid))


def vti_bytes(grid: VoxelGrid) -> bytes:
    """Return a voxel grid as a file of VTK image data, in mm.

    Parameters
    ----------
    grid : VoxelGrid
    """
    import pyvista

    image = pyvista.ImageData(dimensions=grid.shape, spacing=tuple(grid.spacing_mm), origin=tuple(grid.origin_mm))
    for name, values in grid.values.items():
        image.point_data[name] = values.ravel(order="F")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "grid.vti"
        image.save(path)
        return read_bytes(path)


def _mm_per_unit(path: Path, units: str | None) -> float:
    known = UNIT_OF_FORMAT.get(path.suffix.lower())
    if units is None and known is None:
        raise FileError(f"{path}: {path.suffix or 'such'} files carry no unit of length; give one of "
                        f"{', '.join(MM_PER_UNIT)}")  # fmt: skip
    if units is not None and units not in MM_PER_UNIT:
        raise FileError(f"{path}: unknown unit {units!r}; valid are {', '.join(MM_PER_UNIT)}")
    return MM_PER_UNIT[units or str(known)]


def _volume(path: Path, time_s: float | None) -> Any:
    """Return the cells of a flow file that have a volume, as a data set of pyvista's."""
    if not path.is_file():
        raise FileError(f"{path}: cannot be read as a flow: it {why_no_file(path)}")
    if _crashes(path):
        raise FileError(f"{path}: cannot be read as a flow: it is damaged, or larger than this machine's memory")
    import pyvista
    from vtkmodules.vtkCommonCore import vtkObject

    # VTK reports faults on standard error, line by line, and returns something empty.
    shown = vtkObject.GetGlobalWarningDisplay()
    vtkObject.GlobalWarningDisplayOff()
    try:
        reader = pyvista.get_reader(path)
        _set_time(reader, time_s, path)
        data = reader.read()
        mesh = data.combine() if isinstance(data, pyvista.MultiBlock) else data
        if mesh is None or not isinstance(mesh, pyvista.DataSet) or mesh.n_cells == 0:
            raise FileError(f"{path}: holds no cells")
        solid = _is_solid(mesh)
        if not solid.any():
            raise FileError(f"{path}: holds no cells with a volume; a flow on a plane sets no index around it")
        return mesh if solid.all() else mesh.extract_cells(np.flatnonzero(solid))
    except FileError:
        raise
    except Exception as error:
        # Readers may raise anything for a damaged or unknown file.
        why = " ".join(str(error).split())[:200] or type(error).__name__
        raise FileError(f"{path}: cannot be read as a flow: {why}") from None
    finally:
        vtkObject.SetGlobalWarningDisplay(shown)


def _crashes(path: Path) -> bool:
    """Tell whether VTK's reader crashes on a file; what it refuses in words is for the reader here."""
    memory = str(min(physical_memory_bytes(), sys.maxsize))
    # Without -m: see `geometry.files.cad_file`.
    command = [sys.executable, "-P", vtk_child.__file__, str(path), memory, "flow"]
    return subprocess.run(command, capture_output=True, check=False).returncode not in (0, 1)


def _is_solid(mesh: Any) -> NDArray[np.bool_]:
    """Return for each cell whether it has a volume."""
    from vtkmodules.vtkCommonDataModel import vtkGenericCell

    if not hasattr(mesh, "celltypes"):
        # Cells of regular and curvilinear grids are all alike.
        return np.full(mesh.n_cells, mesh.GetCell(0).GetCellDimension() == 3)
    kinds = np.asarray(mesh.celltypes)
    solid = {int(kind): vtkGenericCell.InstantiateCell(int(kind)).GetCellDimension() == 3 for kind in np.unique(kinds)}
    return np.array([solid[int(kind)] for kind in kinds], bool)


def _set_time(reader: Any, time_s: float | None, path: Path) -> None:
    """Set the time that a reader reads: the given one, or the last."""
    times = [float(each) for each in getattr(reader, "time_values", ())]
    if time_s is not None and time_s not in times:
        held = f"times from {min(times):g} to {max(times):g} s" if times else "no times"
        raise FileError(f"{path}: has no time {time_s:g} s; it has {held}")
    if times:
        reader.set_active_time_value(max(times) if time_s is None else time_s)


def _scaled(mesh: Any, mm_per_unit: float) -> Any:
    if mm_per_unit == 1.0:
        return mesh
    return mesh.scale([mm_per_unit] * 3, inplace=False)


def _with_arrays(mesh: Any, arrays: tuple[FlowArray, ...], path: Path) -> tuple[Any, tuple[FlowArray, ...]]:
    """Return a mesh with the wanted arrays at its points, and these arrays."""
    held = dict.fromkeys([*mesh.point_data.keys(), *mesh.cell_data.keys()])
    arrays = arrays or tuple(FlowArray(name, name) for name in held if name in QUANTITIES)
    listed = ", ".join(held) or "none"
    if not arrays:
        raise FileError(f"{path}: no array is named as a quantity ({', '.join(QUANTITIES)}); its arrays are {listed}")
    for each in arrays:
        if each.quantity not in QUANTITIES:
            raise FileError(f"{path}: unknown quantity {each.quantity!r}; valid are {', '.join(QUANTITIES)}")
        if each.name not in held:
            raise FileError(f"{path}: has no array {each.name!r}; its arrays are {listed}")
        data = mesh.point_data if each.name in mesh.point_data else mesh.cell_data
        if data[each.name].ndim != 1:
            raise FileError(f"{path}: {each.name} is a vector; a quantity is one number at each point")
    if any(each.name not in mesh.point_data for each in arrays):
        mesh = mesh.cell_data_to_point_data()
    return mesh, arrays


def _axes(mesh: Any, wanted: Resampling, path: Path) -> tuple[Array, Array, Array]:
    """Return the coordinates of the voxels' centres along each axis, centred in the bounds."""
    bounds = np.array(mesh.bounds if wanted.bounds_mm is None else wanted.bounds_mm, float).reshape(3, 2)
    spacing = np.array(wanted.spacing_mm, float)
    if not (np.isfinite(spacing).all() and (spacing > 0.0).all()):
        raise FileError(f"{path}: the spacing of voxels must be above 0 mm")
    if not (np.isfinite(bounds).all() and (bounds[:, 0] <= bounds[:, 1]).all()):
        raise FileError(f"{path}: the bounds must be the lowest and highest x, y and z, in mm")
    # Bounds that are a multiple of the spacing keep both outer nodes, whatever the rounding.
    counts = np.floor((bounds[:, 1] - bounds[:, 0]) / spacing * (1.0 + 1e-12)).astype(np.int64) + 1
    if counts.astype(float).prod() > MOST_VOXELS:
        raise FileError(f"{path}: {' × '.join(map(str, counts))} voxels; at most {MOST_VOXELS} are read: give a larger "
                        "spacing, or smaller bounds")  # fmt: skip
    first = bounds.mean(axis=1) - 0.5 * spacing * (counts - 1)
    x, y, z = (a + h * np.arange(n) for a, h, n in zip(first, spacing, counts, strict=True))
    return x, y, z


def _values(
    mesh: Any, arrays: tuple[FlowArray, ...], axes: tuple[Array, Array, Array]
) -> tuple[dict[str, Array], NDArray[np.bool_]]:
    """Return the quantities at all nodes, (nx, ny, nz) each, and whether a node lies in a cell."""
    layers = list(_layers(mesh, arrays, axes))
    inside = np.concatenate([valid for _, _, valid in layers])
    names = [each.quantity for each in arrays]
    return {name: np.concatenate([values[name] for _, values, _ in layers]) for name in names}, inside


def _layers(
    mesh: Any, arrays: tuple[FlowArray, ...], axes: tuple[Array, Array, Array]
) -> Iterator[tuple[slice, dict[str, Array], NDArray[np.bool_]]]:
    """Yield layers of nodes across x: their numbers, the quantities at them, and whether they lie in a cell."""
    import pyvista

    x, y, z = axes
    thick = max(POINTS_AT_ONCE // (len(y) * len(z)), 1)
    spacing = [float(axis[1] - axis[0]) if len(axis) > 1 else 1.0 for axis in axes]
    for first in range(0, len(x), thick):
        layer = slice(first, min(first + thick, len(x)))
        shape = layer.stop - first, len(y), len(z)
        image = pyvista.ImageData(dimensions=shape, spacing=spacing, origin=(x[first], y[0], z[0]))
        found = image.sample(mesh, pass_cell_data=False, mark_blank=False)
        valid = np.asarray(found.point_data[VALID], bool).reshape(shape, order="F")
        values = {
            each.quantity: each.factor * np.asarray(found.point_data[each.name], float).reshape(shape, order="F")
            for each in arrays
        }
        yield layer, values, valid


def _differences(
    mesh: Any, arrays: tuple[FlowArray, ...], grid: VoxelGrid
) -> tuple[dict[str, float], dict[str, float]]:
    """Return the largest and the rms difference of each quantity from the file on a grid twice as fine."""
    halves = [
        o + 0.5 * s * np.arange(2 * n - 1)
        for o, s, n in zip(grid.origin_mm, grid.spacing_mm, grid.shape, strict=True)
    ]  # fmt: skip
    x, y, z = halves
    largest, squares, count = dict.fromkeys(grid.values, 0.0), dict.fromkeys(grid.values, 0.0), 0
    between = {name: _interpolation(grid, name) for name in grid.values}
    for layer, values, valid in _layers(mesh, arrays, (x, y, z)):
        points = np.stack(np.meshgrid(x[layer], y, z, indexing="ij"), axis=-1)[valid]
        count += len(points)
        for name, truth in values.items():
            off = np.abs(between[name](points) - truth[valid])
            largest[name] = max(largest[name], float(off.max(initial=0.0)))
            squares[name] += float(off @ off)
    return largest, {name: float(np.sqrt(total / max(count, 1))) for name, total in squares.items()}


def _interpolation(grid: VoxelGrid, name: str) -> Any:
    """Return the function that interpolates a quantity of a grid at points, (n, 3) mm, as media do."""
    values = grid.values[name]
    if name not in SPLINES:
        return lambda points: ndimage.map_coordinates(
            values, ((points - grid.origin_mm) / grid.spacing_mm).T, order=1, mode="nearest"
        )
    # A field of an index 1 + b q, so that no quantity is refused as an index; b undoes the scale.
    scale = 0.5 / max(float(values.max()), 1.0)
    table = field_table([index_field(values, grid.spacing_mm, grid.origin_mm, law=(1.0, scale))])
    return lambda points: (indices_at(table, 0, points)[:, 0] - 1.0) / scale
