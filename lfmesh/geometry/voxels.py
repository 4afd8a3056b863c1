"""Voxel grids: quantities of a medium on a regular lattice, read from files.

Arrays are ordered [x, y, z]. A voxel is a box of size `spacing_mm`, and `origin_mm` is the centre of voxel [0, 0, 0] in
the medium's frame. Values are either constant in each voxel, or trilinear between the centres and constant from the
outer centres to the grid's faces.
"""

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.errors import FileError
from lfmesh.regular_file import Header, open_arrays, open_regular

Array = NDArray[np.float64]
Interpolation = Literal["trilinear", "constant"]

INDEX_QUANTITIES = ("index", "density_kg_m3", "pressure_kpa")
"""Quantities that set the index; a pressure does so together with temperature_k."""

OF_LINES = ("absorption_per_mm", "scattering_per_mm", "emission_w_mm3_sr")
"""Quantities by which light changes along straight lines."""

QUANTITIES = (*OF_LINES, "temperature_k", *INDEX_QUANTITIES)
"""Quantities that a grid may hold, by the names of their arrays."""

PLACE = ("spacing_mm", "origin_mm")
VTK = ".vti"
ENDINGS = (".npz", ".npy", VTK)

BEGINNINGS = {".npz": (b"PK\x03\x04", b"PK\x05\x06"), ".npy": (b"\x93NUMPY",)}
"""First bytes of numpy's files, by file ending: zip archives and single arrays."""

MOST_VOXELS = 1 << 27
"""Largest number of voxels in a grid, 512³. Each quantity then takes 1 GiB."""

WRITERS = {".npz": "numpy.savez", ".npy": "numpy.save"}

_NO_NUMBERS = {"c": "complex numbers", "O": "Python objects", "S": "text", "U": "text", "V": "records",
               "M": "dates", "m": "times"}  # fmt: skip
"""Names of the array contents that are not real numbers, by numpy's dtype kind."""


@dataclass(frozen=True, eq=False)
class VoxelGrid:
    """Quantities on a regular lattice.

    Attributes
    ----------
    values : mapping of str to (nx, ny, nz) float64
        Keyed by the names in `QUANTITIES`, which give the units.
    spacing_mm : (3,) float64
        Distance between the centres of neighbouring voxels along x, y and z.
    origin_mm : (3,) float64
        Centre of voxel [0, 0, 0].
    interpolation : str
        "trilinear" between the centres, or "constant" in each voxel.
    """

    values: Mapping[str, Array]
    spacing_mm: Array
    origin_mm: Array
    interpolation: Interpolation = "trilinear"

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of voxels along x, y and z."""
        nx, ny, nz = next(iter(self.values.values())).shape
        return nx, ny, nz

    @property
    def bounds_mm(self) -> tuple[Array, Array]:
        """Lowest and highest corner, (3,) each, of the box filled by the voxels."""
        low = self.origin_mm - 0.5 * self.spacing_mm
        return low, low + self.spacing_mm * self.shape

    def centres_mm(self) -> Array:
        """Return the centres of all voxels, (nx, ny, nz, 3)."""
        axes = [o + s * np.arange(n) for o, s, n in zip(self.origin_mm, self.spacing_mm, self.shape, strict=True)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def voxel_grid(
    values: Mapping[str, ArrayLike], spacing_mm: ArrayLike, origin_mm: ArrayLike | None = None,
    interpolation: Interpolation = "trilinear", where: str = "voxel grid",
) -> VoxelGrid:  # fmt: skip
    """Check the numbers of a grid and return it.

    Parameters
    ----------
    values : mapping of str to (nx, ny, nz) array_like
    spacing_mm : float or (3,) array_like
    origin_mm : (3,) array_like, optional
        Default: the grid is centred on the origin.
    interpolation : str
    where : str
        Prefix of error messages.

    Raises
    ------
    FileError
        A name is unknown or a number invalid.
    """
    spacing = _spacing(spacing_mm, where)
    unknown = [name for name in values if name not in QUANTITIES]
    if unknown:
        raise FileError(f"{where}: unknown quantity {unknown[0]!r}; valid are {', '.join(QUANTITIES)}")
    arrays = {name: _real(array, name, where) for name, array in values.items()}
    shape = _common_shape({name: array.shape for name, array in arrays.items()}, where)
    checked = {name: _checked(array, name, where) for name, array in arrays.items()}
    origin = -0.5 * spacing * (np.array(shape) - 1) if origin_mm is None else _origin(origin_mm, where)
    return VoxelGrid(checked, spacing, origin, interpolation)


def read_voxels(
    path: Path, spacing_mm: ArrayLike | None = None, origin_mm: ArrayLike | None = None,
    interpolation: Interpolation = "trilinear", quantity: str | None = None,
) -> VoxelGrid:  # fmt: skip
    """Read a voxel grid from a file.

    Parameters
    ----------
    path : Path
        `.npz` or `.vti` (VTK image data) with arrays named as in `QUANTITIES`, or `.npy` with a single array. An `.npz`
        may also hold `spacing_mm` and `origin_mm`.
    spacing_mm, origin_mm : array_like, optional
        For files that do not hold them.
    interpolation : str
    quantity : str, optional
        Quantity in a `.npy` file, or in the only array of a `.vti` file.

    Raises
    ------
    FileError
        The file cannot be read, or its content is invalid.
    """
    if path.suffix.lower() not in ENDINGS:
        raise FileError(f"{path}: a voxel grid ends in {', '.join(ENDINGS[:-1])} or {ENDINGS[-1]}")
    if path.suffix.lower() == VTK:
        _refuse_place(PLACE, path, spacing_mm, origin_mm)
        # Imports VTK, which takes long and which no other format needs.
        found: dict[str, Any] = import_module("lfmesh.imports.vtk_image").read_vtk_image(
            path, QUANTITIES, quantity, MOST_VOXELS
        )
        return voxel_grid(found, found.pop("spacing_mm"), found.pop("origin_mm"), interpolation, str(path))
    return _read_numpy(path, spacing_mm, origin_mm, interpolation, quantity)


def quantities_in(path: Path, quantity: str | None = None) -> tuple[str, ...]:
    """Return the names of the quantities in a file, without reading voxels; none if the file cannot be read.

    Parameters
    ----------
    path : Path
    quantity : str, optional
        As for `read_voxels`.
    """
    if path.suffix.lower() == VTK:
        names: tuple[str, ...] = import_module("lfmesh.imports.vtk_image").array_names(path)
        held = tuple(name for name in names if name in QUANTITIES)
        return held or ((quantity,) if quantity is not None else ())
    if path.suffix.lower() == ".npy":
        return (quantity,) if quantity is not None else ()
    # `read_voxels` says what is wrong with a file.
    with suppress(Exception), open_arrays(path) as arrays:
        return tuple(name for name in arrays.names if name in QUANTITIES)
    return ()


def _read_numpy(
    path: Path, spacing_mm: ArrayLike | None, origin_mm: ArrayLike | None, interpolation: Interpolation,
    quantity: str | None,
) -> VoxelGrid:  # fmt: skip
    """Read a `.npz` or `.npy` file; voxels are read only after the headers and the position have been checked."""
    ending = path.suffix.lower()
    where = str(path)
    try:
        with open_regular(path) as file:
            _check_beginning(path, file.read(max(len(first) for first in BEGINNINGS[".npy"])))
        if ending == ".npy" and quantity is None:
            raise FileError(f"{path}: missing the name of its quantity; give quantity = one of {', '.join(QUANTITIES)}")
        with open_arrays(path, quantity or "") as arrays:
            headers = {name: arrays.header(name) for name in arrays.names}
            _refuse_headers(headers, path)
            _refuse_place(headers, path, spacing_mm, origin_mm)
            spacing_mm = arrays["spacing_mm"] if "spacing_mm" in headers else spacing_mm
            origin_mm = arrays["origin_mm"] if "origin_mm" in headers else origin_mm
            if spacing_mm is None:
                raise FileError(f"{path}: missing spacing_mm, the distance between its voxels")
            spacing = _spacing(spacing_mm, where)
            origin = None if origin_mm is None else _origin(origin_mm, where)
            values = {name: arrays[name] for name in headers if name not in PLACE}
    except FileError:
        raise
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror or error}") from None
    except MemoryError:
        raise FileError(f"{path}: declares more numbers than fit into memory") from None
    except Exception as error:
        # numpy's and zipfile's readers may raise anything on a damaged file.
        why = " ".join(str(error).split())[:200] or type(error).__name__
        raise FileError(f"{path}: cannot be read as numpy's {ending}: {why}") from None
    return voxel_grid(values, spacing, origin, interpolation, where)


def _refuse_headers(headers: Mapping[str, Header], path: Path) -> None:
    """Raise if the headers have an unknown name, a wrong type or shape, or too many voxels."""
    _refuse_unknown(headers, path)
    for name, header in headers.items():
        shape = " × ".join(map(str, header.shape))
        if name in PLACE and header.size > 3:
            raise FileError(f"{path}: {name} has {shape} numbers; it must have three, or one if all spacings are equal")
        if header.size > MOST_VOXELS:
            raise FileError(
                f"{path}: {name} has {shape} = {header.size} voxels; at most {MOST_VOXELS} are read: "
                "crop the grid, or make its voxels larger"
            )
        _refuse_no_numbers(header.dtype, name, str(path))
    _common_shape({name: header.shape for name, header in headers.items() if name not in PLACE}, str(path))


def _refuse_unknown(names: Iterable[str], path: Path) -> None:
    """Raise if a file has an unknown array."""
    unknown = [name for name in names if name not in QUANTITIES + PLACE]
    if unknown:
        raise FileError(f"{path}: unknown array {unknown[0]!r}; valid are {', '.join((*QUANTITIES, *PLACE))}")


def _check_beginning(path: Path, beginning: bytes) -> None:
    """Raise if a file's first bytes do not match its ending: numpy would take it for pickled objects."""
    ending = path.suffix.lower()
    is_a = [other for other, firsts in BEGINNINGS.items() if beginning.startswith(firsts)]
    if ending not in is_a:
        kind = f"a {is_a[0]} file" if is_a else "no file of numpy's"
        why = f"it is {kind} by its content" if beginning else "it is empty"
        raise FileError(f"{path}: cannot be read as numpy's {ending}: {why}; write it with {WRITERS[ending]}")


def _refuse_place(held: Iterable[str], path: Path, spacing_mm: ArrayLike | None, origin_mm: ArrayLike | None) -> None:
    """Raise if a position that the file holds is also given by the caller."""
    for key, given in (("spacing_mm", spacing_mm), ("origin_mm", origin_mm)):
        if key in held and given is not None:
            raise FileError(f"{path}: holds {key} itself; omit it beside the file")


def _common_shape(shapes: Mapping[str, tuple[int, ...]], where: str) -> tuple[int, ...]:
    """Return the shape shared by all quantities of a grid."""
    if not shapes:
        raise FileError(f"{where}: holds no quantity; valid are {', '.join(QUANTITIES)}")
    for name, shape in shapes.items():
        if len(shape) != 3 or 0 in shape:
            raise FileError(f"{where}: {name} must be an array [x, y, z], but has the shape {shape}")
    if len({*shapes.values()}) > 1:
        different = ", ".join(str(shape) for shape in sorted({*shapes.values()}))
        raise FileError(f"{where}: its arrays differ in shape: {different}")
    if "emission_w_mm3_sr" in shapes and "temperature_k" in shapes:
        raise FileError(f"{where}: emission_w_mm3_sr and temperature_k are both given; give one of them")
    laws = [name for name in INDEX_QUANTITIES if name in shapes]
    if len(laws) > 1:
        raise FileError(f"{where}: {laws[0]} and {laws[1]} are both given, and both set the index; give one of them")
    return next(iter(shapes.values()))


def _spacing(spacing_mm: ArrayLike, where: str) -> Array:
    spacing = _real(spacing_mm, "spacing_mm", where)
    if spacing.size not in (1, 3) or not (np.isfinite(spacing).all() and (spacing > 0.0).all()):
        raise FileError(f"{where}: spacing_mm must be one or three numbers above 0, not {_short(spacing_mm)}")
    return np.broadcast_to(spacing.ravel(), (3,)).copy()


def _origin(origin_mm: ArrayLike, where: str) -> Array:
    origin = _real(origin_mm, "origin_mm", where).copy()
    if origin.shape != (3,) or not np.isfinite(origin).all():
        raise FileError(f"{where}: origin_mm must be three numbers, not {_short(origin_mm)}")
    return origin


def _checked(array: Array, name: str, where: str) -> Array:
    values = np.ascontiguousarray(array)
    bad = ~(np.isfinite(values) & (values >= 0.0))
    if bad.any():
        place = [int(i) for i in np.argwhere(bad)[0]]
        value = values[tuple(place)]
        raise FileError(f"{where}: {name} is {value:g} at voxel {place}; it must be finite and 0 or more")
    return values


def _real(array: ArrayLike, name: str, where: str) -> Array:
    """Return a float64 array; complex numbers and text are refused, not cast."""
    try:
        given = np.asarray(array)
    except (TypeError, ValueError):
        raise FileError(f"{where}: {name} holds no regular array; it must hold real numbers") from None
    _refuse_no_numbers(given.dtype, name, where)
    return given.astype(np.float64, copy=False)


def _refuse_no_numbers(kind: np.dtype[Any], name: str, where: str) -> None:
    """Raise unless an array holds real numbers."""
    if kind.kind not in "buif":
        what = _NO_NUMBERS.get(kind.kind, str(kind))
        raise FileError(f"{where}: {name} holds {what}; it must hold real numbers")


def _short(value: object) -> str:
    return np.array2string(np.asarray(value), threshold=4)
