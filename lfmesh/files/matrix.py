"""Projection matrices on disk: written in blocks of pixels, and resumed after an interruption.

Finished blocks are kept in a folder beside the final file until it is complete. Only one block is in memory at a time.
`scipy.sparse.load_npz` reads the `.npz`, which has axes and errors as further arrays; HDF5 holds the same arrays as
data sets.
"""

import json
import shutil
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import lfmesh
from lfmesh.errors import FileError, LfmeshError, PictureWarning
from lfmesh.files.folder import made_inside, staged_file
from lfmesh.files.json_values import parse_json
from lfmesh.files.whole import make_like_any_other
from lfmesh.lightfield.volumes.projection import (
    computed,
    not_seen,
    pixels_of,
    size_in_words,
)
from lfmesh.lightfield.volumes.projection_matrix import ProjectionMatrix
from lfmesh.lightfield.volumes.projector import THRESHOLD, Projector
from lfmesh.lightfield.volumes.voxel_box import VoxelBox
from lfmesh.notebook import Say, announced
from lfmesh.regular_file import Header, open_arrays, open_regular, read_text
from lfmesh.scene import Scene

NUMPY, HDF5 = (".npz",), (".h5", ".hdf5")

FACTS, WHOLE = "facts.json", "whole"
"""Files in the folder of blocks: the matrix to which they belong, and the joined file."""

PER_ROW = {"row_error": "row_stderr", "dropped": "dropped"}
PER_ENTRY = {"value": "data", "column": "indices", "error": "stderr"}
"""Names of a block's arrays, and their names in the file."""

BY_ROW = "row_stderr", "dropped", "pixels"
"""Arrays with one number per row of the matrix."""

SMALL_BYTES, BYTES_A_NUMBER = 1 << 24, 16
"""Limits on reading: bytes of an array that is neither per row nor per entry, and bytes per number of the others."""

UNIT = "mm^3 sr: W on a pixel for 1 W/(mm^3 sr) of a voxel"


def write_projection_matrix(
    scene: Scene, grid: Any, path: str | Path, *, channel: int = 0, pixels: ArrayLike | None = None,
    threshold: float = THRESHOLD, absorption: bool = False, inside: str | None = None, say: Say | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Path:  # fmt: skip
    """Trace a projection matrix into a file, block by block; see `lf.projection_matrix`.

    After an interruption, another call resumes and gives a bitwise identical result.

    Parameters
    ----------
    scene, grid, channel, pixels, threshold, absorption, inside
        As for `lf.projection_matrix`.
    path : Path
        Ends in `.npz`, or in `.h5` or `.hdf5`, which needs h5py.
    say : callable, optional
        Called with messages, the expected size first.
    progress : callable, optional
        Called with the numbers of finished and of all pixels. Without these two, the progress is shown at a terminal or
        in a notebook after two seconds.

    Returns
    -------
    Path

    Raises
    ------
    FileError
        The file cannot be written, the disk is too full, or the blocks beside it are of another matrix.
    LfmeshError
        As for `lf.projection_matrix`.
    """
    path = Path(path)
    _check_ending(path)
    if not path.parent.is_dir() or path.is_dir():
        why = "it is a folder" if path.is_dir() else f"the folder {path.parent} does not exist"
        raise FileError(f"{path} cannot be written: {why}")
    with announced(None if say is None and progress is None else False) as shown:
        projector = Projector(scene.pinned(), grid, channel, threshold, absorption=absorption, inside=inside)
        percent = progress or (lambda done, total: shown(f"{100 * done // total} % of the pixels"))
        return _written(path, projector, pixels_of(projector, pixels), say or shown, percent)


def _written(
    path: Path, projector: Projector, chosen: NDArray[np.int64], say: Say, progress: Callable[[int, int], None]
) -> Path:
    """Trace the rows of the chosen pixels into a file."""
    size = size_in_words(projector, chosen)
    say(size.words)
    # Blocks and the file itself stand beside each other until the file is whole.
    free = shutil.disk_usage(path.parent).free
    if 2.0 * size.bytes > free:
        raise FileError(f"{path}: {size.words}, and twice that while it is written; only {free / 1e9:.3g} GB are free")
    parts = blocks_folder(path)
    blocks = list(projector.blocks(chosen))
    with _told(path):
        done = _begin(parts, _facts(projector, chosen), len(blocks))
        if done:
            say(f"continues after {done} finished blocks of {len(blocks)}")
        finished = sum(len(block) for block in blocks[:done])
        for number, block in enumerate(computed(projector, blocks[done:]), start=done):
            with staged_file(parts, _name(number)) as file:
                np.savez(file, **block._asdict())
            finished += len(block.entries)
            progress(finished, len(chosen))
        words = _join(path, parts, len(blocks), projector, chosen)
        shutil.rmtree(parts)
        say(words)
    return path


def blocks_folder(path: Path) -> Path:
    """Return the folder of blocks for the file at `path`."""
    return path.with_name(path.name + ".parts")


def finished_blocks(path: Path) -> int:
    """Return the number of finished blocks of an interrupted matrix."""
    return sum(1 for block in blocks_folder(path).glob("*.npz") if block.stem.isdigit())


def open_projection_matrix(path: str | Path) -> ProjectionMatrix:
    """Read a projection matrix written by `write_projection_matrix`.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    ProjectionMatrix

    Raises
    ------
    FileError
        The file is not a projection matrix, or is damaged.
    """
    path = Path(path)
    _check_ending(path)
    try:
        if path.suffix.lower() in NUMPY:
            with open_arrays(path) as arrays:
                return _matrix(arrays.names, arrays.header, arrays.__getitem__)
        with open_regular(path), _h5py().File(path, "r") as file:
            return _matrix(list(file), lambda name: _header(file[name]), lambda name: file[name][()])
    except FileNotFoundError:
        raise FileError(f"{path}: no such file") from None
    except Exception:  # numpy's and HDF5's readers may raise anything for a damaged file
        raise FileError(f"{path} is not a projection matrix, or is damaged") from None


def _matrix(names: list[str], announced: Callable[[str], Header], read: Callable[[str], Any]) -> ProjectionMatrix:
    """Return the matrix of a file.

    A compressed file may declare arrays a thousand times its size; only arrays of consistent size are unpacked.

    Parameters
    ----------
    names : list of str
    announced : callable
        Returns the shape and type of an array by its name.
    read : callable
        Returns an array.

    Raises
    ------
    ValueError
        The arrays do not fit together.
    """
    from scipy.sparse import csr_array

    def small(name: str) -> Any:
        if announced(name).nbytes > SMALL_BYTES:
            raise ValueError(f"{name} is too large")
        return read(name)

    def refuse_misfit(name: str, count: int) -> None:
        header = announced(name)
        if header.shape[:1] != (count,) or header.nbytes > count * BYTES_A_NUMBER:
            raise ValueError(f"{name} has the shape {header.shape}, not one number for each of {count}")

    rows, voxels = (int(n) for n in small("shape"))
    counts = tuple(int(n) for n in small("grid_shape"))
    across, down = (int(n) for n in small("sensor_pixels"))
    if not 0 <= rows <= across * down:
        raise ValueError(f"{rows} rows for {across} × {down} pixels")
    place = [small(name) for name in ("spacing_mm", "origin_mm", "position_mm", "rotation_deg")]
    grid = VoxelBox((counts[0], counts[1], counts[2]), *place)
    numbers = float(small("threshold")), float(small("wavelength_nm"))
    told = parse_json(bytes(small("warnings") if "warnings" in names else b"[]"))
    warnings = tuple(map(PictureWarning.from_dict, told))
    # Read the large arrays last, after all else has been validated.
    for name, count in {"indptr": rows + 1, **dict.fromkeys(BY_ROW, rows)}.items():
        refuse_misfit(name, count)
    ends = read("indptr")
    for name in PER_ENTRY.values():
        refuse_misfit(name, int(ends[-1]))
    data, indices, stderr = map(read, PER_ENTRY.values())
    matrix = csr_array((data, indices, ends), shape=(rows, voxels))
    row_stderr, dropped, pixels = map(read, BY_ROW)
    return ProjectionMatrix(matrix, stderr, row_stderr, dropped, pixels, grid, *numbers, warnings, (across, down))


def _header(array: Any) -> Header:
    """Return the header of an array in an HDF5 file."""
    return Header(array.shape, False, array.dtype)


def _check_ending(path: Path) -> None:
    if path.suffix.lower() not in (*NUMPY, *HDF5):
        raise FileError(f"{path}: a projection matrix must end in one of {', '.join((*NUMPY, *HDF5))}")
    if path.suffix.lower() in HDF5:
        _h5py()


def _h5py() -> Any:
    try:
        return import_module("h5py")
    except ImportError:
        raise LfmeshError('HDF5 needs h5py: pip install "lfmesh[data]", or use .npz') from None


@contextmanager
def _told(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise FileError(f"{path} cannot be written: {error.strerror or error}; finished blocks are kept") from None


def _name(number: int) -> str:
    return f"{number:06}.npz"


def _facts(projector: Projector, pixels: NDArray[np.int64]) -> dict[str, Any]:
    """Return the facts that determine the contents of every block."""
    grid, scene = projector.grid, projector.world.scene
    return {
        "lfmesh_version": lfmesh.__version__,
        "scene": scene.digest,
        "waves": projector.waves,
        "inputs": scene.digests,
        "grid": [list(grid.shape), *(a.tolist() for a in (grid.spacing_mm, grid.origin_mm, grid.to_world))],
        "channel": projector.channel,
        "threshold": projector.threshold,
        "absorption": projector.absorption,
        "inside": projector.inside,
        "pixels": [
            len(pixels),
            int(pixels[0]),
            int(pixels[-1]),
            int(pixels @ np.arange(1, len(pixels) + 1) % (1 << 61)),
        ],
        "pixels_at_once": projector.pixels_at_once,
    }


def _begin(parts: Path, facts: dict[str, Any], blocks: int) -> int:
    """Make the folder of blocks, or find that of an interrupted run; return the number of finished blocks."""
    made_inside(parts.parent, parts.name)
    file = parts / FACTS
    if not file.exists():
        with staged_file(parts, FACTS) as new:
            new.write(json.dumps(facts).encode())
        return 0
    try:
        held = parse_json(read_text(file))
    except ValueError:
        held = None
    if held != facts:
        raise FileError(f"{parts} holds blocks of another matrix, or is damaged; delete it, or give another file")
    return next((number for number in range(blocks) if not (parts / _name(number)).exists()), blocks)


def _join(path: Path, parts: Path, blocks: int, projector: Projector, pixels: NDArray[np.int64]) -> str:
    """Join the blocks into the file, array by array; return a summary in words."""
    entries = [_array(parts, number, "entries") for number in range(blocks)]
    end = np.concatenate([[0], np.cumsum(np.concatenate(entries))])
    if end[-1] == 0:
        raise LfmeshError(not_seen(projector))
    grid = projector.grid
    x, y, z = grid.axes_mm
    columns, rows = projector.world.scene.camera.sensor.pixels
    small: dict[str, Any] = {
        "format": np.array(b"csr"), "_is_array": np.array(True), "shape": np.array([len(pixels), grid.voxels]),
        "indptr": end if end[-1] >= 1 << 31 else end.astype(np.int32), "pixels": pixels,
        "sensor_pixels": np.array([columns, rows]), "grid_shape": np.array(grid.shape), "x_mm": x, "y_mm": y, "z_mm": z,
        "spacing_mm": grid.spacing_mm, "origin_mm": grid.origin_mm, "position_mm": grid.position_mm,
        "rotation_deg": grid.rotation_deg, "to_world": grid.to_world, "threshold": np.array(projector.threshold),
        "wavelength_nm": np.array(projector.wavelength_nm), "unit": np.array(UNIT.encode()),
    }  # fmt: skip
    book = np.sum([_array(parts, number, "book") for number in range(blocks)], axis=0)
    told = json.dumps([each.as_dict() for each in projector.warnings(book)])
    small["warnings"] = np.array(told.encode())
    for own, name in PER_ROW.items():
        small[name] = np.concatenate([_array(parts, number, own) for number in range(blocks)])
    whole = parts / WHOLE
    if path.suffix.lower() in NUMPY:
        _write_npz(whole, parts, blocks, small, int(end[-1]))
    else:
        _write_hdf5(whole, parts, blocks, small, int(end[-1]))
    make_like_any_other(whole)
    whole.replace(path)
    kept = sum(float(_array(parts, number, "value").sum()) for number in range(blocks))
    left_out = float(small["dropped"].sum())
    return (
        f"{int(end[-1]):,} entries at {projector.wavelength_nm:.6g} nm; {left_out / (kept + left_out):.2g} of their "
        f"sum dropped, in entries below {projector.threshold:g} of their row's largest"
    )


def _array(parts: Path, number: int, name: str) -> NDArray[Any]:
    try:
        with open_regular(parts / _name(number)) as opened, np.load(opened, allow_pickle=False) as file:
            array: NDArray[Any] = file[name]
            return array
    except (ValueError, KeyError, EOFError, zipfile.BadZipFile):
        raise FileError(f"{parts / _name(number)} is damaged; delete {parts}, and start again") from None


def _write_npz(whole: Path, parts: Path, blocks: int, small: dict[str, Any], entries: int) -> None:
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_STORED) as archive:
        for name, array in small.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.asarray(array), allow_pickle=False)
        for own, name in PER_ENTRY.items():
            dtype = _array(parts, 0, own).dtype
            header = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": (entries,)}
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array_header_1_0(member, header)
                for number in range(blocks):
                    member.write(_array(parts, number, own).tobytes())


def _write_hdf5(whole: Path, parts: Path, blocks: int, small: dict[str, Any], entries: int) -> None:
    with _h5py().File(whole, "w") as file:
        for name, array in small.items():
            file.create_dataset(name, data=array)
        for own, name in PER_ENTRY.items():
            data = file.create_dataset(name, shape=(entries,), dtype=_array(parts, 0, own).dtype)
            first = 0
            for number in range(blocks):
                array = _array(parts, number, own)
                data[first : first + len(array)] = array
                first += len(array)
