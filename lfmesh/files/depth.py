"""Depth in a run folder: the traced truth, the estimate from the light field, and a figure that compares them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import lfmesh
from lfmesh.files import exr, run
from lfmesh.lightfield.photographs.depth import DepthMap
from lfmesh.lightfield.photographs.depth_truth import DepthTruth
from lfmesh.lightfield.views.field import mosaic
from lfmesh.lightfield.views.upright import ON_SENSOR, UPRIGHT
from lfmesh.scene.literals import percent, plain

VIEWS, PIXELS, ESTIMATE, FIGURE = "depth_views.exr", "depth_pixels.exr", "depth.exr", "depth.png"

FIGURE_IN = (10.0, 6.4)
COLUMNS = 3
"""Most panels side by side."""

GREY = "#666666"

ABOUT = (
    "Distances in mm before the first vertex of the lens, along its axis; NaN where no ray passes the lens, infinite "
    "where rays meet nothing. True depth is that of targets: media and particles have none."
)


def save_truth(truth: DepthTruth, folder: Path) -> list[Path]:
    """Add the true depth to a run folder; return the files.

    ``depth_views.exr`` holds the views side by side, as in ``lightfield.exr``; ``depth_pixels.exr`` the mean depth, its
    spread and the fraction that meets a target, for the ray bundle of each raw pixel.

    Raises
    ------
    FileError
        The folder holds no complete run or cannot be written.
    """
    rows, columns = truth.views_mm.shape[:2]
    views = {"Z": mosaic(truth.views_mm[..., None])[..., 0]}
    pixels = {"Z": truth.pixels_mm, "spread": truth.spread_mm, "seen": truth.seen}
    with run.added(folder) as staging:
        exr.write_maps(staging / VIEWS, views, _facts(folder, orientation=UPRIGHT, views=[rows, columns]))
        exr.write_maps(staging / PIXELS, pixels, _facts(folder, orientation=ON_SENSOR))
    return [folder / VIEWS, folder / PIXELS]


def save_depth(
    depth: DepthMap, truth_mm: NDArray[np.floating], folder: Path, without_depth: Sequence[str] = ()
) -> list[Path]:
    """Add the depth estimate as ``depth.exr`` and its error as ``depth.png``; return the files.

    Parameters
    ----------
    depth : DepthMap
    truth_mm : (t, s) float
        See `DepthTruth.middle_mm`.
    folder : Path
    without_depth : sequence of str, optional
        `DepthTruth.without_depth`, listed in the figure.

    Raises
    ------
    LfmeshError
        As for `save_truth`, or the truth has another size.
    """
    maps = {"Z": depth.distance_mm, "confidence": depth.confidence, "truth": truth_mm}
    error = depth.error(truth_mm)
    with run.added(folder) as staging:
        exr.write_maps(staging / ESTIMATE, maps, _facts(folder, orientation=UPRIGHT))
        _draw(staging / FIGURE, depth, truth_mm, error, without_depth)
    return [folder / ESTIMATE, folder / FIGURE]


def _facts(folder: Path, **more: Any) -> dict[str, Any]:
    return {"lfmesh_version": lfmesh.__version__, "about": ABOUT, "raw_sha256": run.pixels_digest(folder), **more}


def _draw(
    path: Path, depth: DepthMap, truth_mm: NDArray[np.floating], error: NDArray[np.float64],
    without_depth: Sequence[str],
) -> None:  # fmt: skip
    """Draw truth, estimate, confidence and error side by side, and the error's distribution, where they are known."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    true = np.where(np.isfinite(truth_mm), truth_mm, np.nan)
    pictures = _pictures(depth, true, error)
    compared = bool(np.isfinite(error).any())
    count = len(pictures) + (2 if compared else 0)
    columns = min(count, COLUMNS)
    rows = -(-count // columns)
    width, height = FIGURE_IN
    size = (width * max(columns, 2) / COLUMNS, height * rows / 2)
    figure = Figure(figsize=size, layout="constrained", dpi=120)
    FigureCanvasAgg(figure)
    panels = list(figure.subplots(rows, columns, squeeze=False).ravel())
    for axes, (title, values, shown) in zip(panels, pictures, strict=False):
        picture = axes.imshow(values, interpolation="nearest", **shown)
        figure.colorbar(picture, ax=axes, shrink=0.85, extend="both" if values is not depth.confidence else "neither")
        axes.set_title(title, fontsize=10, loc="left")
        axes.set_xticks([])
        axes.set_yticks([])
        axes.set_facecolor("#dddddd")
    words = [] if np.isfinite(depth.distance_mm).any() else ["the light field gives no depth"]
    words += [f"without true depth: {', '.join(without_depth)}"] if without_depth else []
    if words:
        # Escape $ in the user's names, between which matplotlib expects mathematics.
        panels[0].set_xlabel("; ".join(words).replace("$", r"\$"), fontsize=8, wrap=True)
    if compared:
        _draw_against_truth(panels[-2], depth, true)
        _draw_distribution(panels[-1], error)
    figure.savefig(path, metadata={"Software": None})


def _pictures(
    depth: DepthMap, true: NDArray[np.floating], error: NDArray[np.float64]
) -> list[tuple[str, NDArray[np.floating], dict[str, Any]]]:
    """Return title, values and colours of each picture with a known value; of the confidence if there is none."""
    low, high = shown_range(depth.distance_mm, true) or depth.range_mm
    margin = 0.05 * max(high - low, 0.02 * high)
    scale = {"vmin": low - margin, "vmax": high + margin, "cmap": "viridis"}
    grey = {"vmin": 0.0, "vmax": 1.0, "cmap": "gray"}
    all_pictures: list[tuple[str, NDArray[np.floating], dict[str, Any]]] = [
        ("truth / mm", true, scale),
        ("from the light field / mm", depth.distance_mm, scale),
        ("confidence", depth.confidence, grey),
        ("error / % of depth", 100.0 * error, {"vmin": -5.0, "vmax": 5.0, "cmap": "RdBu_r"}),
    ]
    known = [each for each in all_pictures if np.isfinite(each[1]).any()]
    return known or [("confidence", depth.confidence, grey)]


def shown_range(distance_mm: NDArray[np.floating], truth_mm: NDArray[np.floating]) -> tuple[float, float] | None:
    """Return the colour scale's depth range: the whole truth and 5 % to 95 % of the estimate; None without data.

    Parameters
    ----------
    distance_mm, truth_mm : (t, s) float
        Estimate and truth.
    """
    found, ends = distance_mm[np.isfinite(distance_mm)], truth_mm[np.isfinite(truth_mm)]
    if found.size:
        ends = np.concatenate([ends, np.percentile(found, [5.0, 95.0])])
    return (float(ends.min()), float(ends.max())) if ends.size else None


def _draw_against_truth(axes: Any, depth: DepthMap, true: NDArray[np.floating]) -> None:
    both = np.isfinite(depth.distance_mm) & np.isfinite(true)
    x, y = true[both], depth.distance_mm[both]
    axes.plot(x, y, ".", ms=2, alpha=0.4, color="#1f4e8c")
    if len(x):
        # The whole truth, and at least the middle half of the estimates.
        quarters = np.percentile(y, [25.0, 75.0])
        ends = np.array([min(x.min(), quarters[0]), max(x.max(), quarters[1])])
        axes.plot(ends, ends, color=GREY, lw=0.8, zorder=0)
        margin = 0.1 * max(float(np.ptp(ends)), 0.05 * float(x.max()))
        axes.set(xlim=(ends[0] - margin, ends[1] + margin), ylim=(ends[0] - margin, ends[1] + margin))
        beyond = float(((y < ends[0] - margin) | (y > ends[1] + margin)).mean())
        if beyond:
            axes.set_title(f"{percent(beyond)} of the samples lie outside", fontsize=10, loc="left")
    axes.set(xlabel="truth / mm", ylabel="from the light field / mm")


def _draw_distribution(axes: Any, error: NDArray[np.float64]) -> None:
    """Draw the cumulative distribution of the absolute error."""
    known = np.sort(np.abs(100.0 * error[np.isfinite(error)]))
    if len(known):
        axes.plot(np.maximum(known, 1e-3), (np.arange(len(known)) + 1.0) / len(known), color="#1f4e8c")
        middle = float(np.median(known))
        axes.axvline(middle, color=GREY, lw=0.8, ls="--")
        axes.annotate(
            f"median {plain(middle, 2)} %", (middle, 0.03), xytext=(4, 0), textcoords="offset points", color=GREY
        )
    axes.set(xscale="log", xlabel="absolute error / % of depth", ylabel="share of samples with less", ylim=(0.0, 1.0))
    axes.grid(alpha=0.25)
