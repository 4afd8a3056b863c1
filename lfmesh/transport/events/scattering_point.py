"""Points on a line where media scatter light: random ones, and the density of any other."""

from typing import NamedTuple

import numpy as np

from lfmesh.kernels.decorators import kernel
from lfmesh.transport.events.bounds import span
from lfmesh.transport.events.volume import HIGH, LOW, Array, Line, Passage, coefficients, pass_through, ray_in_medium
from lfmesh.transport.packets.random import uniform
from lfmesh.transport.tables.volumes import Volumes

PLACE, WHICH = 0, 2
"""Dimensions of a scattering point's random numbers besides the step's: its place in the step, and the medium."""


class ScatteringPoint(NamedTuple):
    """Point on a line where light is scattered.

    Attributes
    ----------
    t : float, mm
        Distance.
    share : float
        Scattered share of the initial light; its mean is `Passage.scattered`.
    density : float
        Light scattered there per length, over the initial light, 1/mm.
    medium : int
        Number of the medium.
    """

    t: float
    share: float
    density: float
    medium: int


@kernel
def scattering_point(volumes: Volumes, line: Line, passage: Passage, key: np.uint64) -> ScatteringPoint:
    """Draw a point on a line where light is scattered.

    Parameters
    ----------
    volumes : Volumes
    line : Line
    passage : Passage
        Of the line, with some light scattered.
    key : uint64
        As in `pass_through`.
    """
    u = uniform(key, PLACE)
    depth = passage.extinction * passage.length
    stopped = -np.expm1(-depth)
    way = -np.log1p(-u * stopped) / passage.extinction
    t = passage.begin + min(way, passage.length)
    middle = passage.begin + 0.5 * passage.length if passage.length < np.inf else t
    # Optical depth up to the point, exact in a cell by Gauss's quadrature, and the coefficients there.
    total, before = 0.0, 0.0
    for number in range(len(volumes.rows)):
        ray = ray_in_medium(volumes, number, line)
        first, last, _ = span(volumes.shells, volumes.rows[number], ray, middle)
        if volumes.rows[number].inside != line.place or not first <= middle <= last:
            continue
        ks = coefficients(volumes, number, line.colour, t, middle, ray)[1]
        total += ks
        for at in (LOW, HIGH):
            ka, kt, _ = coefficients(volumes, number, line.colour, passage.begin + at * way, middle, ray)
            before += 0.5 * way * (ka + kt)
    drawn = passage.extinction * np.exp(-passage.extinction * way) / stopped
    density = passage.before * total * np.exp(-before)
    share = density / (drawn * passage.chance) if passage.chance > 0.0 else 0.0
    which = _medium_at(volumes, line, t, middle, uniform(key, WHICH) * total)
    return ScatteringPoint(t, share, density, which)


@kernel
def scattered_at(volumes: Volumes, line: Line, t: float, book: Array, key: np.uint64) -> tuple[float, int]:
    """Return the light scattered at a distance on a line, over the initial light, 1/mm, and a random medium.

    Parameters
    ----------
    volumes : Volumes
    line : Line
    t : float, mm
        Less than the line's length.
    book : (slots,) float64
        Unchanged.
    key : uint64
        As in `pass_through`.
    """
    total = 0.0
    for number in range(len(volumes.rows)):
        total += _scattering_at(volumes, line, number, t, t)
    if total <= 0.0:
        return 0.0, 0
    which = _medium_at(volumes, line, t, t, uniform(key, WHICH) * total)
    return pass_through(volumes, line, t, book, 0.0, key).transmittance * total, which


@kernel
def _medium_at(volumes: Volumes, line: Line, t: float, middle: float, choice: float) -> int:
    """Return the medium selected by a number among the cumulative scattering coefficients at a point."""
    which = 0
    for number in range(len(volumes.rows)):
        ks = _scattering_at(volumes, line, number, t, middle)
        if ks > 0.0 and choice >= 0.0:
            which = number
        choice -= ks
    return which


@kernel
def _scattering_at(volumes: Volumes, line: Line, number: int, t: float, middle: float) -> float:
    """Return a medium's scattering coefficient at a distance on a line, 1/mm; 0 if `middle` is outside it."""
    row = volumes.rows[number]
    if row.inside != line.place:
        return 0.0
    ray = ray_in_medium(volumes, number, line)
    first, last, _ = span(volumes.shells, row, ray, middle)
    return coefficients(volumes, number, line.colour, t, middle, ray)[1] if first <= middle <= last else 0.0
