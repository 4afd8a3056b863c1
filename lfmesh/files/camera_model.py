"""Camera models on disk: the ray map as OpenEXR or HDF5, with the pinhole camera of each view."""

import json
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import lfmesh
from lfmesh.errors import FileError, LfmeshError
from lfmesh.files import exr
from lfmesh.files.opencv_cameras import refuse_other_cameras, write_cameras
from lfmesh.files.whole import make_like_any_other
from lfmesh.lightfield.rays.camera_model import CameraModel
from lfmesh.lightfield.views.upright import ON_SENSOR

FORMAT = 1
"""Version of the file format."""

OPENEXR, HDF5 = (".exr",), (".h5", ".hdf5")

ABOUT = {
    "origin": "mm, world frame: where the pixel's ray leaves the front of the lens; NaN: no light",
    "direction": "unit vector, world frame, away from the camera",
    "footprint": "covariance of the bundle of a pixel: x, y (mm) where rays cross the plane of the first vertex, "
    "dx/dz, dy/dz (a, b); camera frame",
    "weight": "m^2 sr: W on the pixel through its lenslet for a radiance of 1 W/(m^2 sr)",
    "lenslet": "column and row of the lenslet of the pixel; -1: none",
    "central": "1: the ray goes from the middle of the pixel through the lenslet's apex; 0: mean ray of the bundle",
    "views": "pinhole cameras indexed [v][u] as in lightfield.exr, pixels are the samples (s, t) of a view, the middle "
    "of the first one at (0, 0); OpenCV's convention: x right, y down, z ahead, X_view = rotation X_world + "
    "translation_mm; distortion k1, k2, p1, p2; size: height and width of a view; errors in samples; without values: "
    "the lens stops the view's rays",
    "orientation": f"maps {ON_SENSOR}",
}
"""Meaning of each array."""

COORDINATES = "xyab"
"""Letters of the four ray coordinates in the footprint's channel names."""


def write_camera_model(model: CameraModel, path: str | Path) -> Path:
    """Write a camera model, and its views as OpenCV cameras in ``cameras.json`` beside it.

    OpenEXR stores the ray map as 32-bit channels (origin.x, direction.x, footprint.xa, weight, ...) and the views as
    JSON in the attribute `lfmesh`. HDF5 stores the arrays of `CameraModel` in 64 bits, the views in the group `views`.

    Parameters
    ----------
    model : CameraModel
    path : Path
        Ends in `.exr`, or in `.h5` or `.hdf5`, which needs h5py.

    Returns
    -------
    Path

    Raises
    ------
    FileError
        The file cannot be written.
    LfmeshError
        HDF5 needs h5py, which is missing.
    """
    path = Path(path)
    check_model_path(path)
    unfinished = path.with_name(f".{path.name}.unfinished{path.suffix}")
    try:
        if path.suffix.lower() in OPENEXR:
            exr.write_maps(unfinished, dict(_channels(model)), _metadata(model))
        else:
            _write_hdf5(unfinished, model)
        make_like_any_other(unfinished)
        unfinished.replace(path)
    except OSError as error:
        raise FileError(f"{path} cannot be written: {error.strerror or error}") from None
    except FileError as error:
        raise FileError(str(error).replace(str(unfinished), str(path))) from None
    finally:
        unfinished.unlink(missing_ok=True)
    write_cameras(model, path)
    return path


def check_model_path(path: Path) -> None:
    """Refuse a path where a camera model cannot be written.

    Raises
    ------
    FileError
        The extension is unknown, or the folder is missing or holds ``cameras.json`` of another model.
    LfmeshError
        HDF5 needs h5py, which is missing.
    """
    if path.suffix.lower() not in (*OPENEXR, *HDF5):
        raise FileError(f"{path}: a camera model must end in one of {', '.join((*OPENEXR, *HDF5))}")
    if not path.parent.is_dir() or path.is_dir():
        why = "it is a folder" if path.is_dir() else f"the folder {path.parent} does not exist"
        raise FileError(f"{path} cannot be written: {why}")
    if path.suffix.lower() in HDF5:
        _h5py()
    refuse_other_cameras(path)


def _h5py() -> Any:
    try:
        return import_module("h5py")
    except ImportError:
        raise LfmeshError('HDF5 needs h5py: pip install "lfmesh[data]", or use .exr') from None


def _channels(model: CameraModel) -> Iterator[tuple[str, NDArray[np.floating]]]:
    for name in ("origin", "direction"):
        for i, axis in enumerate("xyz"):
            yield f"{name}.{axis}", getattr(model, name)[..., i]
    for i, one in enumerate(COORDINATES):
        for j, other in enumerate(COORDINATES[i:], start=i):
            yield f"footprint.{one}{other}", model.footprint[..., i, j]
    yield "weight", model.weight
    for i, name in enumerate(("column", "row")):
        yield f"lenslet.{name}", model.lenslet[..., i].astype(np.float32)
    yield "central", model.central.astype(np.float32)


def _facts(model: CameraModel) -> dict[str, Any]:
    return {
        "camera_model_format": FORMAT,
        "lfmesh_version": lfmesh.__version__,
        "scene_digest": model.scene.digest,
        "wavelength_nm": model.wavelength_nm,
        "about": ABOUT,
    }


def _metadata(model: CameraModel) -> dict[str, Any]:
    views = {name: _plain(values) for name, values in model.views._asdict().items()}
    return {**_facts(model), "views": views}


def _plain(values: NDArray[np.float64]) -> list[Any]:
    """Return an array as nested lists, with None for values that are not finite."""
    plain = values.astype(object)
    plain[~np.isfinite(values)] = None
    return list(plain.tolist())


def _write_hdf5(path: Path, model: CameraModel) -> None:
    with _h5py().File(path, "w") as file:
        for name in ("origin", "direction", "footprint", "weight", "lenslet", "central"):
            data = getattr(model, name)
            file.create_dataset(name, data=data, compression="gzip").attrs["about"] = ABOUT[name]
        views = file.create_group("views")
        views.attrs["about"] = ABOUT["views"]
        for name, values in model.views._asdict().items():
            views[name] = values
        for name, value in _facts(model).items():
            file.attrs[name] = json.dumps(value) if isinstance(value, dict) else value
