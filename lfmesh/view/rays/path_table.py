"""Path table: every distinct sequence of surfaces and events, with its power on the sensor."""

import csv
import difflib
import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.files.whole import write_whole
from lfmesh.scene.literals import counted
from lfmesh.transport.packets.book import LOST_PREFIX
from lfmesh.transport.packets.ledger import loss_in_words
from lfmesh.transport.packets.packet import Event, Status
from lfmesh.view.rays.exact_ghosts import ExactGhosts
from lfmesh.view.rays.filters import parse
from lfmesh.view.rays.names import label
from lfmesh.view.rays.paths import WATT, Rays

NAMED = 4
"""Maximum number of reflections in a sequence's short form."""

ROWS = 20
"""Default number of printed rows."""

DASH = "\N{EN DASH}"


@dataclass(frozen=True)
class PathRow:
    """One sequence.

    Attributes
    ----------
    path : int
        Its number: `rays.sequence` of its paths, as in the filter `path == ...`.
    short : str
        Short form: "image path", "ghost L3b–L1a", with reflections in order.
    sequence : str
        Every surface and event: "L1a T, L1b T, L2a R, ..., sensor".
    events, reflections : int
        Interfaces and scatterings; reflections by lens or array.
    count : int
        Number of paths.
    power : float
        Power on the sensor in the table's unit; 0 if the sequence ends elsewhere.
    share : float
        Fraction of the sensor power of all launched paths.
    irradiance : float
        Largest irradiance on a pixel, in the unit of power per mm². With few paths per pixel, single paths make it too
        large.
    error : float
        Error of the power in the table's unit: the standard error, see `Rays.errors`, or the quadrature's if integrated
        over the pupil.
    exact : bool
        Whether it is integrated over the pupil.
    """

    path: int
    short: str
    sequence: str
    events: int
    reflections: int
    count: int
    power: float
    share: float
    irradiance: float
    error: float = math.inf
    exact: bool = False


COLUMNS = tuple(field.name for field in fields(PathRow))


@dataclass(frozen=True)
class PathTable(Sequence[PathRow]):
    """Rows of a path table, and the rays behind them.

    Attributes
    ----------
    rows : list of PathRow
    rays : Rays
    total : float
        Reference power on the sensor for the shares.
    loss : str or None
        Tracing losses of all launched paths in words, if above rounding.
    exact : ExactGhosts or None
        Powers integrated over the pupil.
    launched : (sequences,) int64, or None
        Number of launched paths of each sequence; if a filter drops some, the power is an estimate from the others.
    """

    rows: list[PathRow]
    rays: Rays
    total: float
    loss: str | None = None
    exact: ExactGhosts | None = None
    launched: NDArray[np.int64] | None = None

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[PathRow]:
        return iter(self.rows)

    def __getitem__(self, place):  # type: ignore[no-untyped-def]  # an index or a slice, as of any sequence
        return self.rows[place]

    @property
    def power(self) -> float:
        """Power of all rows on the sensor."""
        return sum(row.power for row in self.rows)

    def sorted(self, by: str, *, descending: bool | None = None) -> "PathTable":
        """Return the table sorted by a column: numbers in descending, words and path numbers in ascending order.

        Raises
        ------
        LfmeshError
            No column has this name.
        """
        if by not in COLUMNS:
            near = difflib.get_close_matches(by, COLUMNS, 1)
            hint = f"; did you mean {near[0]!r}?" if near else ";"
            raise LfmeshError(f"the path table has no column {by!r}{hint} there are {', '.join(COLUMNS)}")
        if descending is None:
            descending = by not in ("path", "short", "sequence")
        rows = sorted(self.rows, key=lambda row: getattr(row, by), reverse=descending)
        return replace(self, rows=rows)

    def filtered(self, chosen: str | NDArray[np.bool_]) -> "PathTable":
        """Return the table for some of the paths, with the original path numbers and reference power.

        Parameters
        ----------
        chosen : str or (n,) bool
            Filter expression, see `lfmesh.view.rays.filters`, or a mask of paths.

        Raises
        ------
        FilterError
            The expression is invalid.
        """
        mask = parse(chosen, self.rays) if isinstance(chosen, str) else chosen
        return _table(self.rays.keep(mask), self.total, self.loss, self.exact, self.launched)

    def to_csv(self, path: str | Path) -> Path:
        """Write `csv_text` to a file, completely or not at all; return the file.

        Raises
        ------
        FileError
            The file cannot be written.
        """
        write_whole(Path(path), self.csv_text())
        return Path(path)

    def csv_text(self) -> str:
        """Return the table as CSV, with all digits and full sequences."""
        unit = "w" if self.rays.unit == WATT else "m2_sr"
        titles = {
            "power": f"power_{unit}", "irradiance": f"largest_irradiance_{unit}_mm2", "error": f"power_error_{unit}",
        }  # fmt: skip
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(titles.get(name, name) for name in COLUMNS)
        writer.writerows([getattr(row, name) for name in COLUMNS] for row in self.rows)
        return text.getvalue()

    def lines(self, most: int = ROWS, width: int = 80) -> list[str]:
        """Return the first rows for a terminal, one line each, with short sequences."""
        unit = self.rays.unit
        head = f"{'path':>5}{'count':>8}{f'power/{unit}':>13}{'±':>7}{'share':>8}{'max per mm²':>13}  "
        lines = [head + "sequence"]
        for row in self.rows[:most]:
            numbers = f"{row.path:5d}{row.count:8d}{row.power:13.3e}{relative_error(row):>7}{_percent(row.share):>8}"
            numbers += f"{row.irradiance:13.2e}  "
            lines.append(numbers + _clipped(row.short, width - len(numbers)))
        rest = self.rows[most:]
        if rest:
            left = sum(row.power for row in rest)
            lines.append(f"and {counted(len(rest), 'more sequence')} with {left:.3e} {unit}")
        where = "between sensor and scene" if self.rays.from_sensor else "on the sensor"
        paths = sum(row.count for row in self.rows)
        whole = f"{counted(len(self), 'sequence')}, {counted(paths, 'path')}, {self.power:.4e} {unit} {where}"
        if self.exact is not None and any(row.exact for row in self.rows):
            known = f"image path and ghosts of two reflections in the {self.exact.mirrors}"
            lines.append(f"{known} by quadrature, the others from paths")
        return [*lines, whole, *([f"Warning: {self.loss}."] if self.loss else [])]


def path_table(rays: Rays, exact: ExactGhosts | None = None) -> PathTable:
    """Return the path table of some rays, in the order of path numbers: largest power first.

    Parameters
    ----------
    rays : Rays
    exact : ExactGhosts, optional
        Powers from the same field points; they replace the rays' for the sequences they contain.
    """
    total = float(rays.end_power[rays.arrives].sum())
    if exact is not None:
        known = rays.of_sequences(exact.by_words)
        total = exact.image.power + exact.power + float(rays.end_power[rays.arrives & ~known].sum())
    return _table(rays, total, _loss(rays), exact, np.bincount(rays.sequence, minlength=len(rays.sequences)))


def _loss(rays: Rays) -> str | None:
    """Return the tracer's power losses and the bodies concerned, in words."""
    lost = rays.status == Status.LOST
    power = np.bincount(rays.end[lost], rays.end_power[lost], len(rays.surfaces))
    lost_in = {rays.surfaces[i].removeprefix(LOST_PREFIX): float(power[i]) for i in np.flatnonzero(power)}
    return loss_in_words(sum(lost_in.values()), lost_in, float(rays.end_power.sum()))


def _table(
    rays: Rays, total: float, loss: str | None, exact: ExactGhosts | None, launched: NDArray[np.int64] | None
) -> PathTable:
    present, first, place, count = np.unique(rays.sequence, return_index=True, return_inverse=True, return_counts=True)
    arriving = rays.end_power * rays.arrives
    power = np.bincount(place, arriving, len(present))
    irradiance = _largest_irradiance(rays, place, arriving, len(present))
    error = rays.errors(place.reshape(-1), len(present))
    integrated = np.zeros(len(present), np.bool_)
    for row, number in enumerate(present):
        known = exact.by_words.get(rays.sequences[number]) if exact is not None else None
        if known is not None and launched is not None and count[row] == launched[number]:
            power[row], error[row], integrated[row] = known.power, known.error, True
    reflections = rays.count_vertices(rays.reflected)
    rows = [
        PathRow(
            int(number), short_form(rays, path), rays.sequences[number], int(rays.events[path]), int(reflections[path]),
            int(paths), float(watts), float(watts / total) if total > 0.0 else 0.0, float(largest),
            float(off), bool(known),
        )
        for number, path, paths, watts, largest, off, known in zip(
            present, first, count, power, irradiance, error, integrated, strict=True
        )
    ]  # fmt: skip
    return PathTable(rows, rays, total, loss, exact, launched)


def _largest_irradiance(
    rays: Rays, place: NDArray[np.int64], arriving: NDArray[np.float64], rows: int
) -> NDArray[np.float64]:
    """Return each row's largest power on one pixel (rows,), over the pixel's area in mm²."""
    sensor = rays.world.tables.sensor
    pixel = rays.pixel[:, 0] * sensor.columns + rays.pixel[:, 1]
    bins, of_path = np.unique(place * sensor.rows * sensor.columns + pixel, return_inverse=True)
    on_pixel = np.bincount(of_path.reshape(-1), arriving, len(bins))
    largest = np.zeros(rows)
    np.maximum.at(largest, bins // (sensor.rows * sensor.columns), on_pixel)
    return largest / sensor.pixel**2


def short_form(rays: Rays, path: int) -> str:
    """Return a path's sequence in short form: its kind, and its reflections in the order of the light."""
    part = slice(rays.offsets[path], rays.offsets[path + 1])
    surface, event, mirrored = rays.surface[part], rays.event[part], rays.reflected[part]
    names = [label(rays.surfaces[number]) for number in surface]
    mirrors = [name for name, mirror in zip(names, mirrored, strict=True) if mirror]
    if rays.from_sensor:
        mirrors.reverse()
    bodies = [names[i] for i in np.flatnonzero((event == Event.SCATTERED) | (event == Event.REFLECTED) & ~mirrored)]
    reflections = DASH.join(mirrors[:NAMED])
    if len(mirrors) > NAMED:
        reflections += f"{DASH}... ({len(mirrors)} reflections)"
    if rays.arrives[path]:
        kind = "image path" if not mirrors else f"{'ghost' if len(mirrors) > 1 else 'reflection'} {reflections}"
        return kind + (f", {names[-1]}" if rays.from_sensor else "") + (f" by {', '.join(bodies)}" if bodies else "")
    after = f" after {names[-2]}" if len(names) > 2 else ""
    return names[-1] + after + (f", by {reflections}" if mirrors else "")


def relative_error(row: PathRow) -> str:
    """Return a row's standard error in percent of its power; empty if integrated or without power."""
    if row.exact or row.power <= 0.0 or not math.isfinite(row.error):
        return ""
    percent = 100.0 * row.error / row.power
    return f"{percent:.0f} %" if percent >= 9.95 else f"{percent:.1f} %"


def _percent(share: float) -> str:
    """Format a fraction as percent, in at most seven characters."""
    percent = 100.0 * share
    if percent == 0.0 or percent >= 0.01:
        return f"{percent:.2f} %" if percent < 99.995 else "100 %"
    return f"{percent:.0e} %"


def _clipped(text: str, room: int) -> str:
    return text if len(text) <= room else text[: max(room - 3, 0)] + "..."
