"""Colour coding: glass by its index; rays by wavelength, power, events, status or path."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import matplotlib as mpl
import numpy as np
from matplotlib.colors import to_hex, to_rgb
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.files.colour import spectral_srgb
from lfmesh.transport.packets.packet import Status
from lfmesh.view.rays.path_table import short_form

if TYPE_CHECKING:
    from lfmesh.view.rays.paths import Rays

Rgb = NDArray[np.uint8]
"""(n, 3), sRGB."""

ColourBy = Literal["wavelength", "power", "events", "status", "path", "field"]

BACKGROUND, BACKGROUND_TOP = "#0d1117", "#1f2a38"
TEXT, FAINT_TEXT = "#e6edf3", "#9fb0c0"

GLASS = [(1.4, "#5fb4ea"), (1.55, "#6fd0d8"), (1.7, "#9fb7f2"), (1.9, "#c99bea")]
"""Tint of glass by index, from light crowns to dense flints."""

OF_STATUS = {
    Status.SENSOR: "#5ee07f",
    Status.TARGET: "#ffd24a",
    Status.ABSORBED: "#ff6b5e",
    Status.ESCAPED: "#5eb0ff",
    Status.DEPTH: "#d18cff",
    Status.LOST: "#ff3df2",
    Status.ROULETTE: "#9aa7b4",
}

DECADES = 8
"""Decades of the power scale; weaker rays are drawn at its end."""

MOST_ENTRIES = 8
"""Most entries of a legend, as many as PATHS."""

PATHS = ["#ff9d3d", "#4db6ff", "#5ee07f", "#ff6b8a", "#c792ff", "#ffe14d", "#3de0d0", "#ff8ff0"]
"""Colours of the strongest sequences; the others share OTHERS."""
OTHERS = "#566474"


@dataclass(frozen=True)
class Legend:
    """Legend of the ray colours: a title, and a colour (#rrggbb) for each label."""

    title: str
    entries: tuple[tuple[str, str], ...]


def tint(index: float) -> str:
    """Return the colour of glass of a given refractive index."""
    indices = [n for n, _ in GLASS]
    channels = np.array([to_rgb(colour) for _, colour in GLASS])
    red, green, blue = (float(np.interp(index, indices, channel)) for channel in channels.T)
    return to_hex((red, green, blue))


def ray_colours(
    rays: "Rays", paths: NDArray[np.int64], vertices: NDArray[np.int64], by: ColourBy
) -> tuple[Rgb, Legend]:
    """Return the colours of segments and their legend.

    Parameters
    ----------
    rays : Rays
    paths : (m,) int64
        Path of each segment.
    vertices : (m,) int64
        First vertex of each segment, an index into `rays.position`.
    by : {"wavelength", "power", "events", "status", "path"}
    """
    makers: dict[str, Callable[[], tuple[Rgb, Legend]]] = {
        "wavelength": lambda: _by_wavelength(rays.wavelength_nm[paths]),
        "power": lambda: _by_power(rays.power[vertices], rays.unit),
        "events": lambda: _by_number(rays.events[paths]),
        "status": lambda: _by_status(rays.status[paths]),
        "path": lambda: _by_sequence(rays, paths),
        "field": lambda: _by_field(rays, paths),
    }
    if by not in makers:
        raise LfmeshError(f"colour = {by!r}: use one of {', '.join(get_args(ColourBy))}")
    return makers[by]()


def power_share(power: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return powers on a logarithmic scale: 1 for the largest, 0 at `DECADES` below it or less."""
    largest = float(power.max(initial=0.0))
    if largest <= 0.0:
        return np.zeros(len(power))
    floor = largest * 10.0**-DECADES
    return np.asarray(1.0 + np.log10(np.maximum(power, floor) / largest) / DECADES)


def _bytes(colours: list[str]) -> Rgb:
    return np.rint(255.0 * np.array([to_rgb(colour) for colour in colours])).astype(np.uint8).reshape(-1, 3)


def _by_wavelength(wavelength_nm: NDArray[np.float64]) -> tuple[Rgb, Legend]:
    different, which = np.unique(wavelength_nm, return_inverse=True)
    colours = [to_hex(colour) for colour in spectral_srgb(different)]
    shown = np.unique(np.linspace(0, max(0, len(different) - 1), MOST_ENTRIES).round().astype(int))
    entries = tuple((f"{different[i]:.1f} nm", colours[i]) for i in shown if len(different))
    return _bytes(colours)[which], Legend("wavelength", entries)


def _by_power(power: NDArray[np.float64], unit: str) -> tuple[Rgb, Legend]:
    scale = mpl.colormaps["plasma"]
    share = power_share(power)
    rgb = np.asarray(scale(0.1 + 0.9 * share, bytes=True))[:, :3]
    largest = float(power.max(initial=0.0))
    decades = np.arange(0, DECADES + 1, 2)
    entries = tuple((f"{largest * 10.0**-d:.1e} {unit}", to_hex(scale(0.1 + 0.9 * (1 - d / DECADES)))) for d in decades)
    return rgb, Legend("power", entries if largest > 0.0 else ())


def _by_number(numbers: NDArray[np.int64]) -> tuple[Rgb, Legend]:
    low, high = int(numbers.min(initial=0)), int(numbers.max(initial=1))
    scale = mpl.colormaps["turbo"]
    place = 0.1 + 0.8 * (numbers - low) / max(1, high - low)
    shown = np.unique(np.linspace(low, high, MOST_ENTRIES).round().astype(int))
    entries = tuple((f"{n} events", to_hex(scale(0.1 + 0.8 * (n - low) / max(1, high - low)))) for n in shown)
    return np.asarray(scale(place, bytes=True))[:, :3], Legend("number of events", entries)


def _by_status(status: NDArray[np.int64]) -> tuple[Rgb, Legend]:
    present = np.unique(status)
    table = np.zeros((max(OF_STATUS) + 1, 3), np.uint8)
    for code, colour in OF_STATUS.items():
        table[code] = _bytes([colour])
    entries = tuple((Status(code).name.lower(), OF_STATUS[Status(code)]) for code in present)
    return table[status], Legend("how the path ended", entries)


def default_colour(rays: "Rays | None") -> ColourBy:
    """Return the default colour coding: by field point if there are several at one wavelength, else by wavelength."""
    if rays is None or not len(rays) or rays.from_sensor or len(np.unique(rays.wavelength_nm)) > 1:
        return "wavelength"
    return "field" if 1 < len(_starts(rays)[0]) <= MOST_ENTRIES else "wavelength"


def _starts(rays: "Rays") -> tuple[NDArray[Any], NDArray[np.int64]]:
    """Return the start points (x, y, z) or pixels (row, column) of rays, and the index of each path's start."""
    starts = rays.pixel if rays.from_sensor else rays.position[rays.offsets[:-1]].round(9)
    points, which = np.unique(starts, axis=0, return_inverse=True)
    return points, which.reshape(-1)


def _by_field(rays: "Rays", paths: NDArray[np.int64]) -> tuple[Rgb, Legend]:
    """Colour by start point or pixel; too many to distinguish share one colour."""
    points, which = _starts(rays)
    kind, title, unit = ("pixels", "from row, column", "") if rays.from_sensor else ("points", "from x, y, z", " mm")
    if len(points) > MOST_ENTRIES:
        return _bytes(PATHS[:1])[np.zeros(len(paths), int)], Legend(title, ((f"{len(points):,} {kind}", PATHS[0]),))
    labels = [", ".join(f"{value + 0:.4g}" for value in point) + unit for point in points]
    return _bytes(PATHS)[which[paths]], Legend(title, tuple(zip(labels, PATHS, strict=False)))


def _by_sequence(rays: "Rays", paths: NDArray[np.int64]) -> tuple[Rgb, Legend]:
    """Colour the strongest sequences individually."""
    present, first = np.unique(rays.sequence[paths], return_index=True)
    named = present[:MOST_ENTRIES]
    colours = [OTHERS] * len(rays.sequences)
    for rank, sequence in enumerate(named):
        colours[sequence] = PATHS[rank]
    examples = paths[first]
    entries = [(short_form(rays, int(path)), colours[i]) for i, path in zip(named, examples, strict=False)]
    if len(present) > len(named):
        entries.append((f"{len(present) - len(named)} other sequences", OTHERS))
    return _bytes(colours)[rays.sequence[paths]], Legend("path", tuple(entries))
