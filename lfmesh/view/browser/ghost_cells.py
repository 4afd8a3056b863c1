"""Ghosts of a launch for the page's narrow panel: a picture with legible labels, and table rows, pair by pair."""

import math
from typing import TYPE_CHECKING, Any

from lfmesh.view.rays.ghosts import GhostMatrix, GhostPair

if TYPE_CHECKING:
    from matplotlib.figure import Figure

GHOST_HEADS = ("ghost", "power in {unit}", "±", "share of the power on the sensor", "origin")

SIZE_IN = (6.4, 3.0)
"""Size of the picture, about that of the panel at 80 px an inch."""

LETTERS_PT, PITCH_PT = 8.5, 9.5
"""Size of the letters, and least distance of two labels."""

PART = 0.72
"""Fraction of the picture along which labels stand; the rest is for titles, labels and colour bar."""

UPRIGHT = 10
"""Most surfaces with upright labels at the columns."""


def ghost_picture(matrix: GhostMatrix) -> "Figure":
    """Return the figure of the ghosts in a smaller size, without the numbers that the table has.

    If the labels are too close together, some of them are missing.

    Raises
    ------
    LfmeshError
        There is no ghost of two reflections.
    """
    figure = matrix.figure()
    axes, bar = figure.axes
    figure.set_size_inches(*SIZE_IN)
    for text in list(axes.texts):
        text.remove()
    title = axes.get_title(loc="left").splitlines()[0]
    axes.set_title(title, fontsize=LETTERS_PT, loc="left", parse_math=False)
    labels = matrix.labels
    across, down = (max(1, math.ceil(len(labels) * PITCH_PT / (PART * 72.0 * size))) for size in SIZE_IN)
    turned = 90 if len(labels) > UPRIGHT else 0
    letters: dict[str, Any] = {"fontsize": LETTERS_PT, "parse_math": False}
    axes.set_xticks(range(0, len(labels), across), labels[::across], rotation=turned, **letters)
    axes.set_yticks(range(0, len(labels), down), labels[::down], **letters)
    for axis in (axes.xaxis, axes.yaxis, bar.yaxis):
        axis.label.set_fontsize(LETTERS_PT)
    bar.tick_params(labelsize=LETTERS_PT)
    bar.set_ylabel("share / %")
    return figure


def ghost_cells(pair: GhostPair) -> list[str]:
    """Return a pair as a table row, in the order of `GHOST_HEADS`."""
    origin = "rays" if pair.integrated == 0.0 else "quadrature" if pair.integrated == 1.0 else "quadrature and rays"
    percent = 100.0 * pair.error / pair.power
    return [
        pair.label,
        f"{pair.power:.4g}",
        f"{percent:.1f} %" if percent >= 0.05 else f"{percent:.0e} %",
        f"{100.0 * pair.share:.3g} %",
        origin,
    ]
