"""Schlieren evaluation in a run folder: the maps as EXR, and a figure."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import lfmesh
from lfmesh.files import exr, run
from lfmesh.lightfield.photographs.schlieren import Schlieren
from lfmesh.lightfield.views.field import mosaic
from lfmesh.lightfield.views.upright import UPRIGHT

MAPS, FIGURE = "schlieren.exr", "schlieren.png"

FIGURE_IN = (10.0, 6.8)

MOST_ARROWS = 40
"""Largest number of arrows along each axis of the figure."""

ABOUT = (
    "One value per window of the upright picture; t_px and s_px are the windows' middle samples. displacement: of the "
    "background's dots from the reference to the run, in samples; deflection: change of the slopes dx/dz and dy/dz of "
    "light on its way to the camera, in rad; x to the right, y up. Views side by side. NaN where unknown."
)


def save_schlieren(result: Schlieren, folder: Path, reference: Path) -> list[Path]:
    """Add an evaluation to the folder of its run as ``schlieren.exr`` and ``schlieren.png``; return the files.

    Parameters
    ----------
    result : Schlieren
    folder : Path
        Of the run with the flow.
    reference : Path
        Of the run without it.

    Raises
    ------
    FileError
        A folder holds no complete run or cannot be written.
    """
    facts: dict[str, Any] = {
        "lfmesh_version": lfmesh.__version__,
        "about": ABOUT,
        "orientation": UPRIGHT,
        "raw_sha256": run.pixels_digest(folder),
        "reference_sha256": run.pixels_digest(reference),
        "views": list(result.misfit.shape[:-2]),
        "t_px": result.t_px.tolist(),
        "s_px": result.s_px.tolist(),
        "sample_mm": result.sample_mm.tolist(),
        "background_mm": result.background_mm,
        "field_mm": result.field_mm,
    }
    with run.added(folder) as staging:
        exr.write_maps(staging / MAPS, _maps(result), facts)
        _draw(staging / FIGURE, result)
    return [folder / MAPS, folder / FIGURE]


def _maps(result: Schlieren) -> dict[str, NDArray[np.floating]]:
    """Return the maps by channel, views side by side."""
    maps: dict[str, NDArray[np.floating]] = {"misfit": _side_by_side(result.misfit)}
    for name in ("displacement_px", "displacement_error_px", "deflection_rad", "deflection_error_rad"):
        quantity, unit = name.rsplit("_", 1)
        for axis, letter in enumerate("xy"):
            maps[f"{quantity}_{letter}_{unit}"] = _side_by_side(getattr(result, name)[..., axis])
    return maps


def _side_by_side(values: NDArray[np.float64]) -> NDArray[np.floating]:
    return values if values.ndim == 2 else mosaic(values[..., None].astype(np.float32))[..., 0]


def _draw(path: Path, result: Schlieren) -> None:
    """Draw the displacements of the middle view as arrows, the deflections, and their standard error."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=FIGURE_IN, layout="constrained", dpi=120)
    FigureCanvasAgg(figure)
    arrows, across, up, errors = figure.subplots(2, 2).ravel()
    displacement, deflection = result.displacement_px[result.middle], 1e3 * result.deflection_rad[result.middle]
    error = 1e3 * result.deflection_error_rad[result.middle].max(axis=-1)
    every = max(1, -(-max(displacement.shape[:2]) // MOST_ARROWS))
    s, t = np.meshgrid(result.s_px[::every], result.t_px[::every])
    shown = displacement[::every, ::every]
    # Rows count downwards.
    arrows.quiver(s, t, shown[..., 0], shown[..., 1], angles="uv", pivot="mid", color="#1f4e8c")
    largest = float(np.nanmax(np.hypot(*np.moveaxis(displacement, -1, 0)), initial=0.0))
    arrows.set_title(f"displacement of the dots, up to {largest:.3g} samples", fontsize=10, loc="left")
    arrows.set(aspect="equal", xlabel="sample", ylabel="sample")
    arrows.invert_yaxis()
    step = result.s_px[1] - result.s_px[0] if len(result.s_px) > 1 else 1
    rows = result.t_px[1] - result.t_px[0] if len(result.t_px) > 1 else 1
    extent = (
        result.s_px[0] - 0.5 * step, result.s_px[-1] + 0.5 * step,
        result.t_px[-1] + 0.5 * rows, result.t_px[0] - 0.5 * rows,
    )  # fmt: skip
    top = float(np.nanpercentile(np.abs(deflection), 99.0)) if np.isfinite(deflection).any() else 1.0
    signed: dict[str, Any] = {"vmin": -top, "vmax": top, "cmap": "gray"}
    pictures: list[tuple[Any, str, Any, dict[str, Any]]] = [
        (across, "deflection towards +x / mrad", deflection[..., 0], signed),
        (up, "deflection towards +y / mrad", deflection[..., 1], signed),
        (errors, "standard error of the deflection / mrad", error, {"cmap": "viridis"}),
    ]
    for axes, title, values, options in pictures:
        picture = axes.imshow(values, interpolation="nearest", extent=extent, **options)
        figure.colorbar(picture, ax=axes, shrink=0.85)
        axes.set_title(title, fontsize=10, loc="left")
        axes.set_facecolor("#dddddd")
    figure.savefig(path, metadata={"Software": None})
