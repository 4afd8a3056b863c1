"""Phases of diffractive surfaces as kernels read and evaluate them."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.by_address import by_address
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.phase_shapes import (
    GRATING,
    GRID,
    GRID_HEADER,
    HOLOGRAM,
    METALENS,
    RADIAL,
    SHAPE,
    XY,
    ZONE_HEADER,
    ZONES,
    PhaseProfile,
)

__all__ = [
    "GRATING",
    "GRID",
    "HOLOGRAM",
    "METALENS",
    "PHASE",
    "RADIAL",
    "XY",
    "ZONES",
    "PhaseProfile",
    "Phases",
    "phase_at",
    "phase_bends_at",
    "phase_table",
    "phases_at",
]

Array = NDArray[np.float64]

PHASE = np.dtype(
    [
        ("kind", "i8"),
        ("first", "i8"),  # first of its numbers
        ("count", "i8"),  # and how many they are
        ("scale", "f8"),
    ]
)


@by_address
class Phases(NamedTuple):
    """Phases in the form that kernels read."""

    rows: NDArray[np.void]  # (phases,) PHASE
    numbers: Array  # of all phases, as in `PhaseProfile`


def phase_table(profiles: Sequence[PhaseProfile]) -> Phases:
    """Return phases in the form that kernels read.

    Parameters
    ----------
    profiles : sequence of PhaseProfile
    """
    rows = np.zeros(len(profiles), PHASE)
    end = 0
    for row, profile in zip(rows, profiles, strict=True):
        row["kind"], row["scale"] = profile.kind, profile.scale
        row["first"], row["count"] = end, len(profile.numbers)
        end += len(profile.numbers)
    return Phases(rows, np.concatenate([np.zeros(0), *(profile.numbers for profile in profiles)]))


@kernel
def phase_at(phases: Phases, number: int, x: float, y: float) -> tuple[float, float, float]:
    """Return a phase at a point of its surface, in rad, and its derivatives by x and y, in rad/mm.

    Parameters
    ----------
    phases : Phases
    number : int
        Row of the phase.
    x, y : float, mm
        In the surface's own frame.
    """
    value, by_x, by_y, _, _, _ = _derived(phases, number, x, y)
    return value, by_x, by_y


def phases_at(phases: Phases, number: int, x: Array, y: Array) -> Array:
    """Return a phase and its derivatives by x and y at points, (n, 3): rad, rad/mm and rad/mm.

    Parameters
    ----------
    phases : Phases
    number : int
        Row of the phase.
    x, y : (n,) float64, mm
    """
    found = np.empty((len(x), 3))
    _fill(phases, number, np.ascontiguousarray(x, np.float64), np.ascontiguousarray(y, np.float64), found)
    return found


@kernel
def _fill(phases: Phases, number: int, x: Array, y: Array, found: Array) -> None:
    for k in range(len(x)):
        found[k, 0], found[k, 1], found[k, 2] = phase_at(phases, number, x[k], y[k])


@kernel
def phase_bends_at(phases: Phases, number: int, x: float, y: float) -> tuple[float, float, float]:
    """Return the second derivatives of a phase by x twice, by x and y, and by y twice, in rad/mm².

    Parameters
    ----------
    phases, number, x, y
        As in `phase_at`.
    """
    _, _, _, xx, xy, yy = _derived(phases, number, x, y)
    return xx, xy, yy


@inlined
def _derived(
    phases: Phases, number: int, x: float, y: float
) -> tuple[float, float, float, float, float, float]:  # fmt: skip
    """Return a phase, its derivatives by x and by y, and those by x twice, by both and by y twice."""
    row = phases.rows[number]
    if row.kind == RADIAL:
        return _radial(phases.numbers, row.first, row.count, row.scale, x, y)
    if row.kind == XY:
        return _polynomial(phases.numbers, row, x, y)
    if row.kind == GRATING:
        by_x, by_y = phases.numbers[row.first], phases.numbers[row.first + 1]
        return by_x * x + by_y * y, by_x, by_y, 0.0, 0.0, 0.0
    if row.kind == METALENS:
        return _metalens(phases.numbers[row.first], phases.numbers[row.first + 1], x, y)
    if row.kind == GRID:
        return _spline(phases.numbers, row.first, x, y)
    if row.kind == ZONES:
        return _in_zone(phases.numbers, row.first, x, y)
    return _hologram(phases.numbers, row.first, x, y)


@inlined
def _radial(
    numbers: Array, first: int, count: int, scale: float, x: float, y: float
) -> tuple[float, float, float, float, float, float]:
    """Derive u q(u), with u = (r/R)² and q = Σ A_i u^(i−1) and its derivatives by Horner's scheme."""
    per2 = scale * scale
    u = (x * x + y * y) * per2
    value, rate, half = 0.0, 0.0, 0.0
    for i in range(count - 1, -1, -1):
        half = half * u + rate
        rate = rate * u + value
        value = value * u + numbers[first + i]
    by_u = value + u * rate
    bent = 2.0 * (rate + u * half)
    along, across = 2.0 * per2 * by_u, 4.0 * per2 * per2 * bent
    return u * value, along * x, along * y, along + across * x * x, across * x * y, along + across * y * y


@inlined
def _in_zone(
    numbers: Array, first: int, x: float, y: float
) -> tuple[float, float, float, float, float, float]:  # fmt: skip
    """Derive the radial phase of the zone that contains a point; a border belongs to the zone inside it."""
    r2, at = x * x + y * y, first + 1
    for _ in range(int(numbers[first]) - 1):
        if r2 <= numbers[at] * numbers[at]:
            break
        at += ZONE_HEADER + int(numbers[at + 3])
    value, by_x, by_y, xx, xy, yy = _radial(numbers, at + ZONE_HEADER, int(numbers[at + 3]), numbers[at + 1], x, y)
    return numbers[at + 2] + value, by_x, by_y, xx, xy, yy


@inlined
def _polynomial(numbers: Array, row: Any, x: float, y: float) -> tuple[float, float, float, float, float, float]:
    """Derive Σ A s^i t^j with s = x/R and t = y/R, by Horner's scheme in t within the one in s."""
    scale, first = row.scale, row.first
    s, t = x * scale, y * scale
    powers_x, powers_y = int(numbers[first]), int(numbers[first + 1])
    value, by_s, half_ss, by_t, by_st, half_tt = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(powers_x - 1, -1, -1):
        p, p_t, p_half = 0.0, 0.0, 0.0
        for j in range(powers_y - 1, -1, -1):
            p_half = p_half * t + p_t
            p_t = p_t * t + p
            p = p * t + numbers[first + SHAPE + i * powers_y + j]
        half_ss = half_ss * s + by_s
        by_s = by_s * s + value
        value = value * s + p
        by_st = by_st * s + by_t
        by_t = by_t * s + p_t
        half_tt = half_tt * s + p_half
    scale2 = scale * scale
    return value, scale * by_s, scale * by_t, 2.0 * scale2 * half_ss, scale2 * by_st, 2.0 * scale2 * half_tt


@inlined
def _metalens(
    focal_length: float, wave_number: float, x: float, y: float
) -> tuple[float, float, float, float, float, float]:
    r2, f2 = x * x + y * y, focal_length * focal_length
    root = np.sqrt(r2 + f2)
    factor = -wave_number if focal_length > 0.0 else wave_number
    over = factor / root
    over3 = over / (r2 + f2)
    return (
        factor * r2 / (root + abs(focal_length)),
        over * x,
        over * y,
        over3 * (y * y + f2),
        -over3 * x * y,
        over3 * (x * x + f2),
    )


@inlined
def _hologram(numbers: Array, first: int, x: float, y: float) -> tuple[float, float, float, float, float, float]:
    """Derive k (±d₂ ∓ d₁), as the sum over both points of the rise of their distance."""
    value, by_x, by_y, xx, xy, yy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for point in range(2):
        at = first + 1 + 4 * point
        factor = numbers[first] * numbers[at] * (1.0 if point == 1 else -1.0)
        px, py, pz = numbers[at + 1], numbers[at + 2], numbers[at + 3]
        u, v = x - px, y - py
        d2 = u * u + v * v + pz * pz
        d = np.sqrt(d2)
        # The difference from the distance at the vertex, without cancellation for distant points.
        value += factor * (x * (u - px) + y * (v - py)) / (d + np.sqrt(px * px + py * py + pz * pz))
        over = factor / d
        by_x += over * u
        by_y += over * v
        over3 = over / d2
        xx += over3 * (v * v + pz * pz)
        xy -= over3 * u * v
        yy += over3 * (u * u + pz * pz)
    return value, by_x, by_y, xx, xy, yy


@inlined
def _spline(numbers: Array, first: int, x: float, y: float) -> tuple[float, float, float, float, float, float]:
    """Derive the cubic B-spline of a grid; beyond its ends the outer pieces go on."""
    samples_y = int(numbers[first + 1])
    per_x, per_y = numbers[first + 4], numbers[first + 5]
    piece_x, s = _piece((x - numbers[first + 2]) * per_x, numbers[first])
    piece_y, t = _piece((y - numbers[first + 3]) * per_y, numbers[first + 1])
    of_x, rate_x, bend_x = _basis(s), _basis_rate(s), _basis_bend(s)
    of_y, rate_y, bend_y = _basis(t), _basis_rate(t), _basis_bend(t)
    value, by_x, by_y, xx, xy, yy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(4):
        at = first + GRID_HEADER + (piece_x + i) * (samples_y + 2) + piece_y
        p, p_t, p_tt = 0.0, 0.0, 0.0
        for j in range(4):
            p += of_y[j] * numbers[at + j]
            p_t += rate_y[j] * numbers[at + j]
            p_tt += bend_y[j] * numbers[at + j]
        value += of_x[i] * p
        by_x += rate_x[i] * p
        by_y += of_x[i] * p_t
        xx += bend_x[i] * p
        xy += rate_x[i] * p_t
        yy += of_x[i] * p_tt
    return value, per_x * by_x, per_y * by_y, per_x * per_x * xx, per_x * per_y * xy, per_y * per_y * yy


@inlined
def _piece(place: float, samples: float) -> tuple[int, float]:
    """Return the piece between samples that contains a place, in units of their distance, and the rest."""
    piece = min(max(np.floor(place), 0.0), samples - 2.0)
    return int(piece), place - piece


@inlined
def _basis(t: float) -> tuple[float, float, float, float]:
    u = 1.0 - t
    return (
        u * u * u / 6.0,
        ((3.0 * t - 6.0) * t * t + 4.0) / 6.0,
        ((3.0 * u - 6.0) * u * u + 4.0) / 6.0,
        t * t * t / 6.0,
    )


@inlined
def _basis_rate(t: float) -> tuple[float, float, float, float]:
    u = 1.0 - t
    return -0.5 * u * u, (1.5 * t - 2.0) * t, (2.0 - 1.5 * u) * u, 0.5 * t * t


@inlined
def _basis_bend(t: float) -> tuple[float, float, float, float]:
    u = 1.0 - t
    return u, 3.0 * t - 2.0, 3.0 * u - 2.0, t
