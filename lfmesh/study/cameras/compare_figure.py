"""Figure of a camera comparison: the picture of each camera, and sharpness against distance."""

from pathlib import Path

import numpy as np

from lfmesh.accuracy.figures import finish
from lfmesh.study.cameras.comparison import Comparison

COLOURS = ("#777777", "#b4541a", "#1f4e8c")
MARKERS = ("o", "s", "D")
SIZE_IN = (10.0, 7.6)


def draw(comparison: Comparison, path: Path) -> None:
    """Draw a comparison as PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, NullLocator

    figure = Figure(figsize=SIZE_IN, layout="constrained", dpi=120)
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 3, height_ratios=(1.0, 1.0))
    for number, (camera, picture) in enumerate(zip(comparison.cameras, comparison.pictures, strict=True)):
        axes = figure.add_subplot(grid[0, number])
        known = picture[np.isfinite(picture)]
        white = float(np.percentile(known, 99.5)) if known.size else 1.0
        # Linear light, shown with a display gamma.
        axes.imshow(np.clip(np.nan_to_num(picture) / (white or 1.0), 0.0, 1.0) ** (1 / 2.2), cmap="gray")
        words = f"{camera.name}, {camera.picture_samples[0]} × {camera.picture_samples[1]}"
        axes.set_title(words, fontsize=10, loc="left", parse_math=False)
        axes.set_xticks([])
        axes.set_yticks([])
    axes = figure.add_subplot(grid[1, :])
    for camera, colour, marker in zip(comparison.cameras, COLOURS, MARKERS, strict=True):
        x = [edge.distance_mm for edge in camera.edges]
        taken, after = [edge.as_taken for edge in camera.edges], [edge.refocused for edge in camera.edges]
        axes.plot(x, taken, marker + "--", color=colour, ms=4, lw=1, label=f"{camera.name}, as taken")
        if np.isfinite(after).any():
            axes.plot(x, after, marker + "-", color=colour, ms=5, label=f"{camera.name}, refocused")
    axes.axvline(comparison.focus_mm, color="#666666", lw=0.8, ls=":")
    axes.set(xscale="log", xlabel="distance of the edge / mm", ylabel="MTF50 / line pairs per picture height")
    axes.set_ylim(bottom=0.0)
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:,.10g}")
    # Users may write $ and ^ in camera names.
    for text in axes.legend(frameon=False, fontsize=9).get_texts():
        text.set_parse_math(False)
    finish(axes, "sharpness of a slanted edge; dotted: the plane in focus")
    figure.savefig(path, metadata={"Software": None})
