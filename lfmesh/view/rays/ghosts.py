"""Power of ghosts by the pair of surfaces that reflect them.

Only paths with exactly two reflections by lens or array are counted: with three, for one, light goes back to the scene,
and the four-reflection ghosts of uncoated glass are some hundred times weaker.

Pairs of lens surfaces can be had by sequence, without noise (see `exact_ghosts`); pairs with a face of the array are
estimated from rays.
"""

import io
import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.files.whole import write_whole
from lfmesh.view.rays.exact_ghosts import ExactGhosts
from lfmesh.view.rays.names import CURVED, FLAT, label, lens_names
from lfmesh.view.rays.paths import Rays

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MINUS = "\N{MINUS SIGN}"

DECADES = 6
"""Of power that the colours span below the strongest ghost."""

PRINTED = 16
"""Surfaces up to which the cells of the figure hold their numbers."""


LETTERS_AN_INCH = 11


@dataclass(frozen=True)
class GhostMatrix:
    """Power at the sensor of two-reflection paths.

    Attributes
    ----------
    names : list of str
        The surfaces, in the order from object to sensor: "lens[0].front", ..., "mla.curved", "mla.flat".
    labels : list of str
        In short: "L1a", ..., "MLAc", "MLAf".
    power : (k, k) float64
        By first reflection (row) and second (column), in the order in which light meets them.
    total : float
        Power on the sensor of all paths.
    unit : str
    source : str
        Where the powers come from, in words.
    """

    names: list[str]
    labels: list[str]
    power: NDArray[np.float64]
    total: float
    unit: str
    source: str = "from rays"

    def strongest(self, most: int = 10) -> list[tuple[str, str, float]]:
        """Return the strongest pairs: first and second surface, and the power."""
        order = np.argsort(-self.power, axis=None, kind="stable")[:most]
        pairs = [divmod(int(place), len(self.names)) for place in order]
        return [(self.names[i], self.names[j], float(self.power[i, j])) for i, j in pairs if self.power[i, j] > 0.0]

    def figure(self) -> "Figure":
        """Return the matrix as a matplotlib figure: colours by the logarithm of the share of the sensor's power.

        Raises
        ------
        LfmeshError
            There is no ghost of two reflections among the rays.
        """
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.colors import LogNorm
        from matplotlib.figure import Figure

        share = self._share()
        largest = share.max()
        count = len(self.labels)
        side = 2.6 + 0.42 * count
        figure = Figure(figsize=(side + 1.0, side), layout="constrained", dpi=120)
        FigureCanvasAgg(figure)
        axes = figure.add_subplot()
        norm = LogNorm(max(share[share > 0.0].min(), largest * 10.0**-DECADES) * 0.999, largest)
        shown = np.ma.masked_equal(share, 0.0)
        image = axes.imshow(shown, norm=norm, cmap="viridis", interpolation="nearest")
        axes.set_xticks(range(count), self.labels, rotation=90)
        axes.set_yticks(range(count), self.labels)
        axes.set_xlabel("second reflection")
        axes.set_ylabel("first reflection")
        axes.set_xticks(np.arange(count + 1) - 0.5, minor=True)
        axes.set_yticks(np.arange(count + 1) - 0.5, minor=True)
        axes.grid(which="minor", color="#dddddd", lw=0.5)
        axes.tick_params(which="minor", length=0)
        title = f"ghosts of two reflections: {100.0 * share.sum():.2g} % of the power on the sensor"
        lines = [line for text in (title, self.source) for line in textwrap.wrap(text, round(LETTERS_AN_INCH * side))]
        axes.set_title("\n".join(lines), fontsize=10, loc="left")
        if count <= PRINTED:
            for i, j in zip(*np.nonzero(share), strict=True):
                dark = norm(share[i, j]) < 0.6
                axes.text(
                    j, i, f"{np.log10(share[i, j]):.1f}".replace("-", MINUS), ha="center", va="center", fontsize=6,
                    color="white" if dark else "black",
                )  # fmt: skip
        bar = figure.colorbar(image, ax=axes, shrink=0.8)
        numbers = " (numbers: its logarithm)" if count <= PRINTED else ""
        bar.set_label(f"share of the power on the sensor{numbers}")
        return figure

    def save(self, path: str | Path) -> Path:
        """Write the figure as PNG, SVG or PDF, by the file's ending; return the file.

        Raises
        ------
        LfmeshError
            There is no ghost among the rays, or the ending is another.
        FileError
            The file cannot be written.
        """
        path = Path(path)
        form = path.suffix.lower().lstrip(".")
        if form not in ("png", "svg", "pdf"):
            raise LfmeshError(f"{path}: a figure is written as .png, .svg or .pdf")
        picture = io.BytesIO()
        self.figure().savefig(picture, format=form)
        write_whole(path, picture.getvalue())
        return path

    def _share(self) -> NDArray[np.float64]:
        if not (self.power > 0.0).any():
            raise LfmeshError(
                'no ghost of two reflections is among the rays: launch with split = "both", and more of them'
            )
        return np.asarray(self.power / self.total)


def ghost_matrix(rays: Rays, exact: ExactGhosts | None = None) -> GhostMatrix:
    """Return the power at the sensor by the pair of surfaces that reflect, of paths with exactly two reflections.

    Parameters
    ----------
    rays : Rays
    exact : ExactGhosts, optional
        Of the same field points: then the pairs of lens surfaces, and the image path in the total, are taken from it,
        and the rays give the other paths alone.
    """
    names = lens_names(rays.world)
    if rays.world.tables.mla.present:
        names += [CURVED, FLAT]
    known = rays.of_sequences(exact.by_words if exact is not None else ())
    power = np.zeros((len(names), len(names)))
    pairs = rays.keep(rays.arrives & ~known & (rays.count_vertices(rays.reflected) == 2))
    # Numbers of lens and array come first among the surfaces, after the start.
    first, second = (pairs.surface[pairs.reflected] - 1).reshape(-1, 2).T
    if rays.from_sensor:
        first, second = second, first
    np.add.at(power, (first, second), pairs.end_power)
    total = float(rays.end_power[rays.arrives & ~known].sum())
    source = f"from {rays.launched:,} rays"
    if exact is not None:
        total += exact.image.power + exact.power
        for row in exact.ghosts:
            power[row.path.mirrors] += row.power
        within = f"by quadrature over the pupil, to {_percent(exact.error, exact.power)} of their power"
        source = f"pairs of lens surfaces {within}; others {source}"
    return GhostMatrix(names, [label(name) for name in names], power, total, rays.unit, source)


def _percent(part: float, whole: float) -> str:
    return f"{100.0 * part / whole:.1g} %" if whole > 0.0 else "0 %"
