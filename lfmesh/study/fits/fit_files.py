"""Files of a fit: fitted scene, values with their errors, picture of the residuals."""

import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import lfmesh
from lfmesh.accuracy.figures import finish
from lfmesh.files.inputs import within
from lfmesh.files.json_values import plain_json
from lfmesh.files.whole import make_folder, write_whole
from lfmesh.lightfield.views.upright import ON_SENSOR, Upright
from lfmesh.scene.literals import plain
from lfmesh.study.fits.fit import Estimate, Fit

Array = NDArray[np.float64]

SCENE, VALUES, PICTURE = "fitted.toml", "fit.json", "residuals.png"

ARROW = 0.8
"""Length of an arrow of three standard deviations, over the spacing of arrows."""

BLUE = "#1f4e8c"


def write_fit(fit: Fit, folder: Path) -> list[Path]:
    """Write ``fitted.toml``, ``fit.json`` and ``residuals.png``.

    Returns
    -------
    list of Path

    Raises
    ------
    FileError
        The folder cannot be written.
    """
    make_folder(folder)
    contents: dict[str, str | bytes] = {
        SCENE: within(fit.scene, folder).dump_toml(),
        VALUES: json.dumps(plain_json(facts(fit)), indent=1, ensure_ascii=False) + "\n",
        PICTURE: residuals_picture(fit),
    }
    return write_files(contents, folder)


def write_files(contents: dict[str, str | bytes], folder: Path) -> list[Path]:
    """Write files into a folder once all of them are made."""
    for name, content in contents.items():
        write_whole(folder / name, content)
    return [folder / name for name in contents]


def facts(fit: Fit) -> dict[str, Any]:
    """Return the content of ``fit.json``."""
    return {
        "lfmesh_version": lfmesh.__version__,
        "parameters": parameter_facts(fit.estimates),
        "covariance": fit.covariance.tolist(),
        "known_together": [
            {"coefficients": each.coefficients, "value": each.value, "standard_error": each.standard_error}
            for each in fit.combinations
        ],
        "micro_image_pitch_px": {"value": fit.pitch_px, "standard_error": fit.pitch_error_px},
        "residual_rms_px": fit.rms_px,
        "sigma_px": fit.sigma_px,
        "micro_images": fit.used,
        "left_out": fit.left_out,
        "warnings": [each.as_dict() for each in fit.warnings],
        "orientation": f"shifts and tilts are those of the camera frame; residuals {ON_SENSOR}",
        "residuals_px": fit.residuals_px.tolist() if fit.used <= LISTED else None,
    }


def parameter_facts(estimates: Sequence[Estimate]) -> list[dict[str, Any]]:
    """Return the parameters' part of ``fit.json``."""
    return [
        {
            "name": each.parameter.name,
            "path": each.parameter.path,
            "unit": each.parameter.unit,
            "value": each.value,
            "standard_error": each.standard_error,
            "scene_value": each.parameter.start,
            "plausible_change": each.parameter.reach,
            "kept": each.kept,
            "known_only_with": [path for path in each.together if path != each.parameter.path],
        }
        for each in estimates
    ]


LISTED = 10000
"""Largest number of micro-images with residuals in the JSON."""


def residuals_picture(fit: Fit) -> bytes:
    """Return a PNG of the residuals over the upright picture, as arrows, and their distribution."""
    upright = Upright.of(fit.scene)
    residuals = upright.picture(fit.residuals_px) * np.array(upright.senses)
    rows, columns = residuals.shape[:2]
    step = max(1, -(-max(rows, columns) // ARROWS))
    row, column = np.mgrid[step // 2 : rows : step, step // 2 : columns : step]
    shown = residuals[row, column]
    figure, field, spread = two_plots()
    scale = 3.0 * max(fit.sigma_px, np.finfo(np.float64).tiny) / (ARROW * step)
    arrows = field.quiver(
        column, row, shown[..., 0], shown[..., 1], angles="xy", scale_units="xy", scale=scale, color=BLUE, width=0.003
    )
    field.quiverkey(arrows, 0.86, 1.04, 3.0 * fit.sigma_px, f"{plain(3.0 * fit.sigma_px, 2)} pixels", labelpos="E")
    field.set(xlim=(-1, columns), ylim=(rows, -1), aspect="equal", xlabel="lenslet, to the right", ylabel="down")
    finish(field, "residuals, upright")
    known = fit.residuals_px[np.isfinite(fit.residuals_px[..., 0])]
    show_spread(spread, known)
    spread.set(xlabel="residual / pixels", ylabel="micro-images")
    finish(spread, f"{plain(fit.rms_px, 2)} pixels rms, {fit.used} micro-images")
    return as_png(figure)


def two_plots() -> tuple[Any, Any, Any]:
    """Return a figure with two plots side by side, for residuals over the field and for their distribution."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 4.6), layout="constrained", dpi=120)
    FigureCanvasAgg(figure)
    field, spread = figure.subplots(1, 2, width_ratios=(1.2, 1.0))
    return figure, field, spread


def show_spread(plot: Any, residuals: Array) -> None:
    """Draw the distribution of (n, 2) residuals."""
    for axis, name, colour in ((0, "x", BLUE), (1, "y", "#b4541a")):
        plot.hist(residuals[:, axis], bins=30, histtype="step", color=colour, label=name)
    plot.legend(frameon=False)


def as_png(figure: Any) -> bytes:
    """Return a figure as PNG."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()


ARROWS = 32
"""Largest number of arrows along the longer side."""
