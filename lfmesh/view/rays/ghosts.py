"""Ghost power by pair of reflecting surfaces.

Only paths with exactly two reflections by lens or array count: with three, for example, light returns to the scene, and
four-reflection ghosts of uncoated glass are some hundred times weaker.

All pairs can be integrated by sequence, without noise (see `exact_ghosts`), but paths that meet the curved faces of two
lenslets in turn are estimated from rays.
"""

import math
import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.files.whole import write_whole
from lfmesh.scene.literals import plain
from lfmesh.view.figure_file import checked_kind, encoded_figure
from lfmesh.view.rays.exact_ghosts import DASH, ExactGhosts
from lfmesh.view.rays.names import label, mirror_names
from lfmesh.view.rays.paths import Rays

if TYPE_CHECKING:
    from matplotlib.figure import Figure

GHOST_RAYS, GHOST_CUTOFF = 500, 1e-4
"""Default number of rays and cutoff for a launch that resolves ghosts well."""

DECADES = 6
"""Decades of power below the strongest ghost in the colour scale."""

LEAST_SHOWN = 1e-3
"""Smaller percentages are shown only by their colour."""

PRINTED = 16
"""Largest number of surfaces with numbers in the cells of the figure."""


SIZE_IN, DPI = (10.6, 6.5), 120
"""Fits a screen of 1280 x 800."""

LETTERS_A_LINE = 130

DARK = "no light of these rays reaches the sensor, so there is no ghost to draw; check for a target in their way"
"""Reason for a missing figure."""


class GhostPair(NamedTuple):
    """Pair of reflecting surfaces, with its power on the sensor."""

    label: str  # such as "L3b–L1a", in order of reflection
    power: float
    error: float  # standard error and the quadrature's together
    share: float  # fraction of the power on the sensor
    integrated: float  # fraction of its own power that is integrated over the pupil


@dataclass(frozen=True)
class GhostMatrix:
    """Power of two-reflection paths at the sensor.

    Attributes
    ----------
    names : list of str
        Surfaces of the camera from object to sensor: "lens[0].front", ..., "mla.curved", "mla.flat", "cover.front",
        "cover.rear", "sensor".
    labels : list of str
        Short names: "L1a", ..., "MLAc", "MLAf", "CVa", "CVb", "sensor".
    power : (k, k) float64
        By first reflection (row) and second (column).
    total : float
        Power of all paths on the sensor.
    unit : str
    source : str
        Origin of the powers in words.
    error : (k, k) float64
        Standard error of each power estimated from rays; 0 where integrated over the pupil.
    integrated, quadrature_error : (k, k) float64
        Part of each power that is integrated over the pupil, and its error.
    """

    names: list[str]
    labels: list[str]
    power: NDArray[np.float64]
    total: float
    unit: str
    source: str
    error: NDArray[np.float64]
    integrated: NDArray[np.float64]
    quadrature_error: NDArray[np.float64]

    def pairs(self) -> list[GhostPair]:
        """Return the pairs with power, strongest first.

        Raises
        ------
        LfmeshError
            There is no two-reflection ghost.
        """
        share, off = self._share(), np.hypot(self.error, self.quadrature_error)
        order = np.argsort(-self.power, axis=None, kind="stable")
        places = [divmod(int(place), len(self.names)) for place in order]
        return [
            GhostPair(
                f"{self.labels[i]}{DASH}{self.labels[j]}", float(self.power[i, j]), float(off[i, j]),
                float(share[i, j]), float(self.integrated[i, j] / self.power[i, j]),
            )
            for i, j in places if self.power[i, j] > 0.0
        ]  # fmt: skip

    def strongest(self, most: int = 10) -> list[tuple[str, str, float]]:
        """Return the strongest pairs: first and second surface, and power."""
        order = np.argsort(-self.power, axis=None, kind="stable")[:most]
        pairs = [divmod(int(place), len(self.names)) for place in order]
        return [(self.names[i], self.names[j], float(self.power[i, j])) for i, j in pairs if self.power[i, j] > 0.0]

    def figure(self) -> "Figure":
        """Return the matrix as a matplotlib figure, coloured by the logarithm of the fraction of the sensor's power.

        Raises
        ------
        LfmeshError
            The rays contain no two-reflection ghost.
        """
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.colors import LogNorm
        from matplotlib.figure import Figure

        percent = 100.0 * self._share()
        off = 100.0 * self.error / self.total
        largest = percent.max()
        count = len(self.labels)
        figure = Figure(figsize=SIZE_IN, layout="constrained", dpi=DPI)
        FigureCanvasAgg(figure)
        axes = figure.add_subplot()
        norm = LogNorm(max(percent[percent > 0.0].min(), largest * 10.0**-DECADES) * 0.999, largest)
        shown = np.ma.masked_equal(percent, 0.0)
        image = axes.imshow(shown, norm=norm, cmap="viridis", interpolation="nearest", aspect="auto")
        small = min(10.0, 160.0 / count)
        # Surface names and the title come from the user.
        own: dict[str, Any] = {"parse_math": False}
        axes.set_xticks(range(count), self.labels, rotation=90 if count > PRINTED else 0, fontsize=small, **own)
        axes.set_yticks(range(count), self.labels, fontsize=small, **own)
        axes.set_xlabel("second reflection")
        axes.set_ylabel("first reflection")
        axes.set_xticks(np.arange(count + 1) - 0.5, minor=True)
        axes.set_yticks(np.arange(count + 1) - 0.5, minor=True)
        axes.grid(which="minor", color="#dddddd", lw=0.5)
        axes.tick_params(which="minor", length=0)
        noise = np.hypot.reduce(off, axis=None)
        whole = f"{plain(percent.sum(), 3)} %" + (f" ± {plain(noise, 1)} %" if noise > 0.0 else "")
        title = f"ghosts of two reflections: {whole} of the power on the sensor"
        lines = [line for text in (title, self.source) for line in textwrap.wrap(text, LETTERS_A_LINE)]
        axes.set_title("\n".join(lines), fontsize=10, loc="left", **own)
        if count <= PRINTED:
            for i, j in zip(*np.nonzero(percent), strict=True):
                dark = norm(percent[i, j]) < 0.6
                axes.text(
                    j, i, in_cell(percent[i, j], off[i, j]), ha="center", va="center", fontsize=7.5,
                    linespacing=1.0, color="white" if dark else "black",
                )  # fmt: skip
        bar = figure.colorbar(
            image,
            ax=axes,
            pad=0.01,
            format=lambda value, _: np.format_float_positional(value, precision=3, fractional=False, trim="-"),
        )
        bar.set_label("share of the power on the sensor / %")
        return figure

    def save(self, path: str | Path) -> Path:
        """Write the figure as PNG, SVG or PDF, by extension; return the file.

        Raises
        ------
        LfmeshError
            The rays contain no ghost, or the extension is unknown.
        FileError
            The file cannot be written.
        """
        path = Path(path)
        kind = checked_kind(path, "a figure of ghosts")
        write_whole(path, encoded_figure(self.figure(), kind, "ghosts", DPI))
        return path

    def _share(self) -> NDArray[np.float64]:
        if self.total == 0.0:
            raise LfmeshError(DARK)
        if not (self.power > 0.0).any():
            raise LfmeshError('the rays contain no ghost of two reflections: launch more of them, with split = "both"')
        return np.asarray(self.power / self.total)


def in_cell(percent: float, error: float) -> str:
    """Return a percentage and its standard error, as decimals, for a cell of the figure.

    Parameters
    ----------
    percent : float
    error : float
        0 if unknown; the percentage then has two digits.
    """
    if percent < LEAST_SHOWN:
        return f"< {LEAST_SHOWN:g}"
    if error <= 0.0:
        return f"{plain(percent, 2)}"
    digits = max(0, -math.floor(math.log10(error)))
    return f"{percent:.{digits}f}\n±{error:.{digits}f}"


def ghost_matrix(rays: Rays, exact: ExactGhosts | None = None) -> GhostMatrix:
    """Return the power of two-reflection paths at the sensor by pair of reflecting surfaces.

    Parameters
    ----------
    rays : Rays
    exact : ExactGhosts, optional
        Results for the same field points: they replace the rays for the pairs they contain, and for the image path in
        the total.
    """
    names = mirror_names(rays.world)
    places = {name: place for place, name in enumerate(names)}
    known = rays.of_sequences(exact.by_words if exact is not None else ())
    power = np.zeros((len(names), len(names)))
    chosen = rays.arrives & ~known & (rays.count_vertices(rays.reflected) == 2)
    pairs = rays.keep(chosen)
    place = np.array([places.get(name, -1) for name in rays.surfaces])
    first, second = place[pairs.surface[pairs.reflected]].reshape(-1, 2).T
    if rays.from_sensor:
        first, second = second, first
    np.add.at(power, (first, second), pairs.end_power)
    # Every path counts: rays that contribute nothing to a pair are part of its spread.
    cell = np.full(len(rays), power.size)
    cell[chosen] = first * len(names) + second
    error = rays.errors(cell, power.size + 1)[:-1].reshape(power.shape)
    total = float(rays.end_power[rays.arrives & ~known].sum())
    source = f"from {rays.launched:,} rays"
    integrated, quadrature_error = np.zeros_like(power), np.zeros_like(power)
    if exact is not None:
        if not rays.reflected.any():
            source = "left out, because no ray was followed through a reflection"
        total += exact.image.power + exact.power
        for row in exact.ghosts:
            integrated[row.path.mirrors] += row.power
            quadrature_error[row.path.mirrors] += row.error
        power += integrated
        within = f"by quadrature over the pupil, to {_percent(exact.error, exact.power)} of their power"
        source = f"two reflections in the {exact.mirrors} {within}; others {source}"
    return GhostMatrix(names, [label(name) for name in names], power, total, rays.unit, source, error,
                       integrated, quadrature_error)  # fmt: skip


def _percent(part: float, whole: float) -> str:
    return f"{plain(100.0 * part / whole, 1)} %" if whole > 0.0 else "0 %"
