"""Bounds of the derivatives of phases over cells, for proofs about rays; see `bounds` for ranges."""

import numpy as np

from lfmesh.optics.bounds import (
    Range,
    known_where,
    meridian_ranges,
    plus,
    quotient,
    revolved_bends,
    scaled,
    squared,
    times,
)
from lfmesh.optics.phase_shapes import (
    GRATING,
    GRID,
    HOLOGRAM,
    METALENS,
    RADIAL,
    SHAPE,
    ZONES,
    PhaseProfile,
    grid_bounds_mm,
    grid_coefficients,
    zones_of,
)
from lfmesh.optics.zones import zones_in_plane, zones_on_meridian

Powers = tuple[tuple[int, float], ...]


def meridian_phase(profile: PhaseProfile, height: Range) -> tuple[Range, Range]:
    """Return bounds of the first and second derivative of a phase of revolution along a meridian.

    Parameters
    ----------
    profile : PhaseProfile
        With the vertex as its centre.
    height : (n,) float64 each, mm

    Returns
    -------
    tuple of two Range
        rad/mm and rad/mm².
    """
    if profile.kind == ZONES:
        return zones_on_meridian(zones_of(profile), height)[1:]
    scale = profile.scale
    slopes, bends = [], []
    for factor, curvature, conic, powers in _revolved(profile):
        _, slope, bend = meridian_ranges(curvature, conic, powers, scaled(scale, height))
        slopes.append(scaled(factor * scale, slope))
        bends.append(scaled(factor * scale * scale, bend))
    return plus(*slopes), plus(*bends)


def phase_bends(profile: PhaseProfile, x: Range, y: Range) -> list[Range]:
    """Return bounds of a phase's derivatives by x, by y, by x twice, by both, and by y twice.

    Parameters
    ----------
    profile : PhaseProfile
    x, y : (n,) float64 each, mm
        Unbounded where unknown, as are then the results.

    Returns
    -------
    list of five Range
        rad/mm, rad/mm, and rad/mm² each.
    """
    known = np.isfinite(x[1] - x[0]) & np.isfinite(y[1] - y[0])
    x, y = ((np.where(known, each[0], 0.0), np.where(known, each[1], 0.0)) for each in (x, y))
    return [known_where(known, each) for each in _bends(profile, x, y)]


def _bends(profile: PhaseProfile, x: Range, y: Range) -> list[Range]:
    if profile.kind == GRATING:
        zero = scaled(0.0, _ones(x))
        return [*(scaled(float(each), _ones(x)) for each in profile.numbers), zero, zero, zero]
    if profile.kind == GRID:
        return _grid_bends(profile, x, y)
    if profile.kind == HOLOGRAM:
        return _hologram_bends(profile, x, y)
    if profile.kind == ZONES:
        return zones_in_plane(zones_of(profile), x, y)[1:]
    scale = profile.scale
    units = scale, scale, scale * scale, scale * scale, scale * scale
    s, t = scaled(scale, x), scaled(scale, y)
    if profile.kind in (RADIAL, METALENS):
        ((factor, curvature, conic, powers),) = _revolved(profile)
        _, *parts = revolved_bends(curvature, conic, powers, s, t)
    else:
        factor, parts = 1.0, _polynomial_bends(profile, s, t)
    return [scaled(factor * unit, part) for unit, part in zip(units, parts, strict=True)]


def _revolved(profile: PhaseProfile) -> list[tuple[float, float, float, Powers]]:
    """Return a phase of revolution as a sum of profiles: a factor, a conic (curvature and constant) and powers.

    √(r² + a²) − |a| is the sag of a conic of curvature 1/|a| and constant −2.
    """
    numbers = profile.numbers
    if profile.kind == RADIAL:
        return [(1.0, 0.0, 0.0, tuple((2 * i, float(a)) for i, a in enumerate(numbers, start=1)))]
    if profile.kind == METALENS:
        focal_length, wave_number = float(numbers[0]), float(numbers[1])
        return [(-np.copysign(wave_number, focal_length), 1.0 / abs(focal_length), -2.0, ())]
    points = zip((-1.0, 1.0), numbers[1:].reshape(2, 4), strict=True)
    return [(float(sense * sign * numbers[0]), 1.0 / abs(z), -2.0, ()) for sense, (sign, _, _, z) in points]


def _polynomial_bends(profile: PhaseProfile, s: Range, t: Range) -> list[Range]:
    rows, columns = (int(count) for count in profile.numbers[:SHAPE])
    table = profile.numbers[SHAPE:].reshape(rows, columns)
    found = [scaled(0.0, _ones(s))] * 5
    for i, j in zip(*np.nonzero(table), strict=True):
        # Factor and powers of each derivative of a term.
        derived = (
            (i, i - 1, j), (j, i, j - 1), (i * (i - 1), i - 2, j), (i * j, i - 1, j - 1), (j * (j - 1), i, j - 2),
        )  # fmt: skip
        for k, (factor, a, b) in enumerate(derived):
            if factor:
                term = scaled(float(factor * table[i, j]), times(_power(s, int(a)), _power(t, int(b))))
                found[k] = plus(found[k], term)
    return found


def _power(each: Range, exponent: int) -> Range:
    if exponent == 0:
        return _ones(each)
    one, other = each[0] ** exponent, each[1] ** exponent
    if exponent % 2:
        return one, other
    return np.where((each[0] < 0.0) & (each[1] > 0.0), 0.0, np.minimum(one, other)), np.maximum(one, other)


def _hologram_bends(profile: PhaseProfile, x: Range, y: Range) -> list[Range]:
    found = [scaled(0.0, _ones(x))] * 5
    for sense, (sign, px, py, pz) in zip((-1.0, 1.0), profile.numbers[1:].reshape(2, 4), strict=True):
        u, v = (plus(each, scaled(-float(at), _ones(each))) for each, at in ((x, px), (y, py)))
        z2 = scaled(float(pz * pz), _ones(x))
        d2 = plus(squared(u), squared(v), z2)
        d = np.sqrt(np.maximum(d2[0], z2[0])), np.sqrt(d2[1])
        over, over3 = quotient(_ones(d), d), quotient(_ones(d), times(d, d, d))
        across = scaled(-1.0, times(u, v, over3))
        parts = [
            times(u, over), times(v, over), times(plus(squared(v), z2), over3), across,
            times(plus(squared(u), z2), over3),
        ]  # fmt: skip
        factor = float(sense * sign * profile.numbers[0])
        found = [plus(old, scaled(factor, part)) for old, part in zip(found, parts, strict=True)]
    return found


def _grid_bends(profile: PhaseProfile, x: Range, y: Range) -> list[Range]:
    """Return the largest bounds on the whole grid: a spline lies between its smallest and largest coefficient."""
    c, per = grid_coefficients(profile), profile.numbers[4:6]
    first, last = grid_bounds_mm(profile)
    inside = (x[0] >= first[0]) & (x[1] <= last[0]) & (y[0] >= first[1]) & (y[1] <= last[1])
    in_x, in_y = per[0] * np.diff(c, axis=0), per[1] * np.diff(c, axis=1)
    derived = (
        in_x, in_y, per[0] * np.diff(in_x, axis=0), per[1] * np.diff(in_x, axis=1), per[1] * np.diff(in_y, axis=1),
    )  # fmt: skip
    one = np.ones_like(x[0])
    return [known_where(inside, (float(part.min()) * one, float(part.max()) * one)) for part in derived]


def _ones(like: Range) -> Range:
    one = np.ones_like(like[0])
    return one, one
