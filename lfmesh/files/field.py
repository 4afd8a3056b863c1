"""lightfield.exr: the views of a light field side by side, with standard errors and axes."""

from pathlib import Path
from typing import Any

import numpy as np

import lfmesh
from lfmesh.errors import FileError
from lfmesh.files import exr, image_file, run
from lfmesh.files.folder import saved
from lfmesh.files.picture import write_picture
from lfmesh.lightfield.views.field import LightField, from_mosaic, mosaic
from lfmesh.lightfield.views.upright import UPRIGHT

FORMAT = 2
"""Version of the file format; readers refuse any other."""

FIELD, VIEWS = "lightfield.exr", "views.png"
PARTS = ("views", "stderr", "sharing")

_AXES = ("v_rad", "u_rad", "t_mm", "s_mm")


def save_field(field: LightField, folder: Path) -> list[Path]:
    """Add a light field to the run folder from which it was decoded; return the files.

    ``lightfield.exr`` holds the upright views side by side, row v = 0 on top, with axes as JSON. ``views.png`` shows
    them.

    Raises
    ------
    FileError
        The folder holds no complete run or cannot be written.
    """
    metadata: dict[str, Any] = {
        "lightfield_format": FORMAT,
        "lfmesh_version": lfmesh.__version__,
        "orientation": UPRIGHT,
        "about": "Views side by side, (v·t, u·s), upright: s and columns towards +x, t and rows towards -y, as seen "
        "from behind the camera; u grows as the viewpoint moves towards +x, v as it moves towards -y. Part 'stderr' "
        "holds their standard errors; part 'sharing', the same for all views, by what factor the variance of a mean "
        "over neighbouring views exceeds that of independent ones.",
        "unit": field.unit,
        "sampling": field.sampling,
        "views": list(field.views),
        **{name: getattr(field, name).tolist() for name in _AXES},
        "raw_sha256": run.pixels_digest(folder),
        **image_file.scene_metadata(field.scene, folder),
    }
    # All parts of an EXR have the same size.
    sharing = np.broadcast_to(field.sharing[:, :, None], field.data.shape)
    parts = {"views": field.views_mosaic(), "stderr": mosaic(field.stderr), "sharing": mosaic(sharing)}
    with run.added(folder) as staging:
        exr.write(staging / FIELD, exr.SpectralImage(parts, field.wavelengths_nm, metadata))
        write_picture(staging / VIEWS, field.views_mosaic(), field.wavelengths_nm)
    return [folder / FIELD, folder / VIEWS]


def open_field(folder: Path) -> LightField | None:
    """Read the light field of a run folder; return None if none belongs to its raw image.

    Raises
    ------
    FileError
        The folder holds no complete run, or the light field is damaged or of another version.
    """
    digest = run.pixels_digest(folder)
    path = saved(folder, FIELD)
    if path is None:
        return None
    spectral = exr.read(path, PARTS)
    metadata = spectral.metadata
    version = metadata.get("lightfield_format")
    if version != FORMAT:
        reason = run.WHY_OTHERS_ARE_REFUSED.get(version) if isinstance(version, int) else None
        raise FileError(
            f"{path} has light field format {version}; this lfmesh {lfmesh.__version__} reads {FORMAT}"
            + (f": {reason}; decode the run again" if reason else "")
        )
    if metadata.get("raw_sha256") != digest:
        return None
    with image_file.fitting(path, "decode the run again"):
        scene = image_file.scene_from(metadata, folder)
        of_scene = scene.wavelengths_nm
        axes = {name: np.asarray(metadata[name], dtype=np.float64) for name in _AXES}
        rows, columns = metadata["views"]
        field = LightField(
            data=from_mosaic(spectral.parts["views"], (rows, columns)),
            stderr=from_mosaic(spectral.parts["stderr"], (rows, columns)),
            **axes,
            # The scene's wavelengths know their bands.
            wavelengths_nm=of_scene if of_scene == spectral.wavelengths_nm else spectral.wavelengths_nm,
            unit=metadata["unit"],
            scene=scene,
            sampling=metadata["sampling"],
            sharing=from_mosaic(spectral.parts["sharing"], (rows, columns))[0, 0, :, :, 0].copy(),
        )
        lengths = tuple(len(axis) if axis.ndim == 1 else -1 for axis in axes.values())
        if field.data.shape[:4] != lengths:
            raise ValueError(f"its views are {field.data.shape[:4]}, its axes {lengths} long")
        if not all(np.isfinite(axis).all() for axis in axes.values()):
            raise ValueError("its axes hold values that are not finite")
    return field
