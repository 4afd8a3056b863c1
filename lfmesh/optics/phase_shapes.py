"""Phases of diffractive surfaces, Φ(x, y) in rad: their kinds, their numbers and their derivatives at the vertex.

A phase is a function of x and y in the surface's own frame, constant along z. An order m adds m λ/2π ∇Φ to the
tangential part of n times the unit direction, and m λ Φ/2π to the optical path. A phase that falls with the distance
from the axis converges in the order 1. `phase_profiles` evaluates phases in kernels.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.optics.zones import Zone

Array = NDArray[np.float64]

RADIAL, XY, GRATING, METALENS, GRID, HOLOGRAM, ZONES = range(7)

SHAPE, GRID_HEADER, ZONE_HEADER = 2, 6, 4
"""Numbers before the coefficients: of `XY` its shape; of `GRID` its shape, origin and samples per mm; of a zone of
`ZONES` its outer border, scale, offset and number of coefficients."""

ROUNDED = 2.0**-40
"""Rounding limit of derivatives of a spline, relative to the terms of their sums."""

LEAST_SAMPLES = 4
"""Smallest number of samples along an axis of a grid: one cubic."""


class PhaseProfile(NamedTuple):
    """A phase, by its kind, scale and numbers.

    Attributes
    ----------
    kind : int
        RADIAL, XY, GRATING, METALENS, GRID, HOLOGRAM or ZONES.
    scale : float, 1/mm
        Factor of x and y in RADIAL and XY; otherwise 1.
    numbers : (n,) float64
        RADIAL: coefficients of r², r⁴, ..., in rad. XY: numbers of powers of x and of y, then their coefficients in
        rad, row by row. GRATING: gradient, rad/mm. METALENS: focal length, mm, and wave number, rad/mm. HOLOGRAM: wave
        number; then for each point +1 (real) or −1 (virtual), and its position, mm. GRID: numbers of samples along x
        and y, position of the first sample, mm, samples per mm along x and y, then the coefficients of the B-splines.
        ZONES: number of zones; then for each, from the vertex outwards, its outer border, mm, scale, 1/mm, offset, rad,
        number of coefficients, and coefficients as of RADIAL.
    """

    kind: int
    scale: float
    numbers: Array


def radial_profile(coefficients_rad: Sequence[float], radius_mm: float) -> PhaseProfile:
    """Return the phase Σ A_i (r/R)^(2i), with i from 1."""
    return PhaseProfile(RADIAL, 1.0 / radius_mm, np.array(coefficients_rad, np.float64))


def zones_profile(zones: Sequence[Zone]) -> PhaseProfile:
    """Return a phase of revolution in zones, offset + Σ A_i (scale r)^(2i) in each.

    Parameters
    ----------
    zones : sequence of Zone
        From the vertex outwards, without conics.
    """
    parts = [
        [zone.outer, zone.scale, zone.offset, len(zone.powers), *(a for _, a in zone.powers)] for zone in zones
    ]  # fmt: skip
    return PhaseProfile(ZONES, 1.0, np.concatenate([[len(zones)], *parts]))


def zones_of(profile: PhaseProfile) -> list[Zone]:
    """Return the zones of a phase of the kind ZONES."""
    zones, at, inner = [], 1, 0.0
    for _ in range(int(profile.numbers[0])):
        outer, scale, offset, count = (float(each) for each in profile.numbers[at : at + ZONE_HEADER])
        end = at + ZONE_HEADER + int(count)
        powers = tuple((2 * i, float(a)) for i, a in enumerate(profile.numbers[at + ZONE_HEADER : end], start=1))
        zones.append(Zone(inner, outer, offset, 0.0, 0.0, powers, scale))
        at, inner = end, outer
    return zones


def xy_profile(terms: Sequence[tuple[int, int, float]], radius_mm: float) -> PhaseProfile:
    """Return the phase Σ A (x/R)^i (y/R)^j of terms (i, j, A), A in rad."""
    shape = 1 + max((term[0] for term in terms), default=0), 1 + max((term[1] for term in terms), default=0)
    table = np.zeros(shape)
    for i, j, coefficient in terms:
        table[i, j] += coefficient
    return PhaseProfile(XY, 1.0 / radius_mm, np.concatenate([shape, table.ravel()]))


def grating_profile(lines_per_mm: float, direction_deg: float) -> PhaseProfile:
    """Return the phase 2π L (x cos δ + y sin δ) of L lines per mm, with the grating vector at δ from +x."""
    size, angle = 2.0 * math.pi * lines_per_mm, math.radians(direction_deg)
    return PhaseProfile(GRATING, 1.0, size * np.array([math.cos(angle), math.sin(angle)]))


def metalens_profile(focal_length_mm: float, wave_number: float) -> PhaseProfile:
    """Return the phase ∓k (√(r² + f²) − |f|) that focuses a plane wave of wave number k, rad/mm; − for f > 0."""
    return PhaseProfile(METALENS, 1.0, np.array([focal_length_mm, wave_number]))


def hologram_profile(
    points_mm: Sequence[Sequence[float]], real: Sequence[bool], wave_number: float
) -> PhaseProfile:  # fmt: skip
    """Return the phase k (±d₂ ∓ d₁) of two construction waves of wave number k, relative to the vertex.

    Parameters
    ----------
    points_mm : (2, 3) float
        Construction points; d are the distances from these.
    real : (2,) bool
        True for a wave that diverges from its point, with the phase k d. False for a wave that converges to it, with
        the phase −k d.
    wave_number : float, rad/mm
    """
    signed = [(1.0 if is_real else -1.0, *point) for is_real, point in zip(real, points_mm, strict=True)]
    return PhaseProfile(HOLOGRAM, 1.0, np.concatenate([[wave_number], *signed]))


def grid_profile(phase_rad: ArrayLike, spacing_mm: ArrayLike, origin_mm: ArrayLike | None = None) -> PhaseProfile:
    """Return the phase of a cubic B-spline through samples, with not-a-knot ends, which reproduces cubics.

    Parameters
    ----------
    phase_rad : (nx, ny) array_like
        At least four samples along x and y.
    spacing_mm : float or (2,) array_like
        Distance between neighbouring samples along x and y.
    origin_mm : (2,) array_like, optional
        Position of the sample [0, 0]. Default: the grid is centred on the vertex.
    """
    values = np.asarray(phase_rad, np.float64)
    spacing = np.broadcast_to(np.asarray(spacing_mm, np.float64).ravel(), (2,))
    centred = -0.5 * spacing * (np.array(values.shape) - 1)
    origin = centred if origin_mm is None else np.asarray(origin_mm, np.float64).reshape(2)
    coefficients = spline_coefficients(spline_coefficients(values).T).T
    return PhaseProfile(GRID, 1.0, np.concatenate([values.shape, origin, 1.0 / spacing, coefficients.ravel()]))


def spline_coefficients(values: Array) -> Array:
    """Return the coefficients (n + 2, m) of the uniform cubic B-splines through samples (n, m) along the first axis.

    The second derivatives M of the samples f, times the squared spacing, satisfy M₋ + 4 M + M₊ = 6 (f₋ − 2 f + f₊), and
    at the ends M₀ − 2 M₁ + M₂ = 0 (C. de Boor, A Practical Guide to Splines, chapter IV), so that M₁ is known at once.
    """
    second = values[:-2] - 2.0 * values[1:-1] + values[2:]
    bent = np.zeros_like(values)
    bent[1:-1] = second
    # Elimination and back substitution between the two known ends.
    factors = [0.0]
    for k in range(2, len(values) - 2):
        factors.append(1.0 / (4.0 - factors[-1]))
        bent[k] = factors[-1] * (6.0 * second[k - 1] - bent[k - 1])
    for k in range(len(values) - 3, 1, -1):
        bent[k] -= factors[k - 1] * bent[k + 1]
    bent[0], bent[-1] = 2.0 * bent[1] - bent[2], 2.0 * bent[-2] - bent[-3]
    middle = values - bent / 6.0
    before, behind = bent[0] + 2.0 * middle[0] - middle[1], bent[-1] + 2.0 * middle[-1] - middle[-2]
    return np.concatenate([before[None], middle, behind[None]])


def grid_coefficients(profile: PhaseProfile) -> Array:
    """Return the coefficients (nx + 2, ny + 2) of the B-splines of a grid, in rad."""
    nx, ny = (int(count) for count in profile.numbers[:2])
    return profile.numbers[GRID_HEADER:].reshape(nx + 2, ny + 2)


def grid_bounds_mm(profile: PhaseProfile) -> tuple[Array, Array]:
    """Return the first and the last sample of a grid, (2,) each, mm."""
    first = profile.numbers[2:4]
    return first, first + (profile.numbers[:2] - 1.0) / profile.numbers[4:6]


def vertex_derivatives(profile: PhaseProfile) -> tuple[float, float, float, float, float]:
    """Return the derivatives of a phase at its vertex: by x, by y, by x twice, by both and by y twice.

    Parameters
    ----------
    profile : PhaseProfile

    Returns
    -------
    tuple of five float
        rad/mm, rad/mm, and rad/mm² each.
    """
    numbers, scale = profile.numbers, profile.scale
    if profile.kind == RADIAL:
        bend = 2.0 * float(numbers[0]) * scale**2 if len(numbers) else 0.0
        return 0.0, 0.0, bend, 0.0, bend
    if profile.kind == ZONES:
        inmost = zones_of(profile)[0]
        bend = 2.0 * inmost.powers[0][1] * inmost.scale**2
        return 0.0, 0.0, bend, 0.0, bend
    if profile.kind == XY:
        table = np.zeros((3, 3))
        nx, ny = (int(count) for count in numbers[:SHAPE])
        low = numbers[SHAPE:].reshape(nx, ny)[:3, :3]
        table[: low.shape[0], : low.shape[1]] = low
        x, y, xx, xy, yy = table[1, 0], table[0, 1], 2.0 * table[2, 0], table[1, 1], 2.0 * table[0, 2]
        scale2 = scale**2
        return float(scale * x), float(scale * y), float(scale2 * xx), float(scale2 * xy), float(scale2 * yy)
    if profile.kind == GRATING:
        return float(numbers[0]), float(numbers[1]), 0.0, 0.0, 0.0
    if profile.kind == METALENS:
        bend = -float(numbers[1] / numbers[0])
        return 0.0, 0.0, bend, 0.0, bend
    if profile.kind == HOLOGRAM:
        return _hologram_at_vertex(numbers)
    return _grid_at_vertex(profile)


def _hologram_at_vertex(numbers: Array) -> tuple[float, float, float, float, float]:
    total = np.zeros(5)
    for sense, (sign, px, py, pz) in zip((-1.0, 1.0), numbers[1:].reshape(2, 4), strict=True):
        d = math.hypot(px, py, pz)
        x, y = -px / d, -py / d
        total += sense * sign * np.array([x, y, (1.0 - x * x) / d, -x * y / d, (1.0 - y * y) / d])
    x, y, xx, xy, yy = (float(each) for each in numbers[0] * total)
    return x, y, xx, xy, yy


def _grid_at_vertex(profile: PhaseProfile) -> tuple[float, float, float, float, float]:
    first, per = profile.numbers[2:4], profile.numbers[4:6]
    bases = []
    for count, at, scale in zip(profile.numbers[:2], first, per, strict=True):
        piece = int(min(max(math.floor(-at * scale), 0), count - 2))
        t = -at * scale - piece
        value = (
            np.array([(1.0 - t) ** 3, (3.0 * t - 6.0) * t * t + 4.0, ((3.0 - 3.0 * t) * t + 3.0) * t + 1.0, t**3]) / 6.0
        )
        rate = np.array([-0.5 * (1.0 - t) ** 2, (1.5 * t - 2.0) * t, (1.0 - 1.5 * t) * t + 0.5, 0.5 * t * t])
        bend = np.array([1.0 - t, 3.0 * t - 2.0, 1.0 - 3.0 * t, t])
        bases.append((piece, value, scale * rate, scale * scale * bend))
    (i, *of_x), (j, *of_y) = bases
    part = grid_coefficients(profile)[i : i + 4, j : j + 4]
    orders = ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
    x, y, xx, xy, yy = (
        _unless_rounded(float(of_x[a] @ part @ of_y[b]), float(np.abs(of_x[a]) @ np.abs(part) @ np.abs(of_y[b])))
        for a, b in orders
    )
    if abs(xx - yy) <= ROUNDED * np.abs(part).max() * (per * per).max():
        xx = yy = 0.5 * (xx + yy)
    return x, y, xx, xy, yy


def _unless_rounded(total: float, size: float) -> float:
    """Return a sum, or 0 if it vanishes within rounding; `size` adds the magnitudes of its terms."""
    return total if abs(total) > ROUNDED * size else 0.0
