"""Bounds of skew rays of the axial point over cells of the first vertex plane, for lenses without rotational symmetry.

As in `beam_bounds`, but every quantity of a cell's rays is a `Jet`: a range with the ranges of its derivatives by both
entry coordinates.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.optics.bounds import (
    Array,
    Range,
    known_where,
    overlap,
    plus,
    quotient,
    revolved_bends,
    scaled,
    squared,
    times,
)
from lfmesh.optics.phase_ranges import phase_bends
from lfmesh.scene.camera.lens import Lens
from lfmesh.scene.camera.phase import Phase
from lfmesh.scene.camera.surface import Surface
from lfmesh.scene.first_order.beam_bounds import CLOSE, STEPS, WIDER, Beam, enclosed, known_indices

Jet = Range
"""Bounds (3, n) of a quantity and of its derivatives by the entry's x and y."""

CELLS, HALVINGS, MOST_OPEN = 24, 8, 3072
"""Initial number of cells on each side of the entry plane, number of bisections, and maximum number of cells left to
bisect."""

BEYOND = 1.05
"""Size of all cells together, relative to the beam of traced rays."""


class _Followed(NamedTuple):
    """Squared heights at surfaces, as jets (surfaces, 3, cells and as many centres), and whether all rays continue."""

    squares: Jet
    pass_on: NDArray[np.bool_]


def widest_mm(
    lens: Lens, wavelength_nm: float, object_mm: float, entry_mm: Array, found_mm: Array, clear_mm: ArrayLike
) -> Beam:
    """Return the largest height at each surface of the rays of the beam that fills the stop.

    Parameters
    ----------
    lens, wavelength_nm, object_mm
        As in `axial_beam.beam_mm`.
    entry_mm : (2,) float64
        Largest x and y of traced rays in the plane of the first vertex.
    found_mm : (surfaces,) float64
        Largest heights of these rays; inf where some end.
    clear_mm : float or (surfaces,) float, mm
        As in `beam_bounds.widest_mm`.
    """
    stop = lens.stop_index or 0
    size = BEYOND * entry_mm
    symmetric = all(surface.is_symmetric for surface in lens.surfaces)
    sides = [np.linspace(0.0 if symmetric else -each, each, CELLS + 1) for each in size]
    low, high = (
        np.stack(np.meshgrid(*ends, indexing="ij"), axis=-1).reshape(-1, 2)
        for ends in zip(*((side[:-1], side[1:]) for side in sides), strict=True)
    )
    clear = np.broadcast_to(np.asarray(clear_mm, np.float64), len(found_mm))
    radius = lens.surfaces[stop].semi_diameter_mm or math.nan
    edge = (radius * (1.0 + CLOSE)) ** 2
    for halving in range(HALVINGS + 1):
        squares, pass_on = _followed(lens, wavelength_nm, object_mm, low, high)
        count, half = len(low), 0.5 * (high - low).T
        highest = np.where(pass_on, squares[1][:, 0, :count], np.inf)
        beside = squares[0][stop, 0, :count] > edge
        # With a non-negative multiplier, this function bounds the heights of all rays inside the stop.
        middle, at_stop = (squares[1][:, :, count:], squares[1][stop, :, count:])
        ray = (at_stop[0] <= radius * radius) & np.isfinite(middle[:, 0]).all(axis=0)
        found_mm = np.maximum(found_mm, np.sqrt(np.max(middle[:, 0], axis=1, where=ray, initial=0.0)))
        levels = np.square(np.maximum(found_mm * (1.0 + CLOSE), clear))[:, None]
        with np.errstate(all="ignore"):
            gradient = (at_stop[1:] ** 2).sum(axis=0)
            multiplier = np.maximum((middle[:, 1:] * at_stop[1:]).sum(axis=1) / gradient, 0.0)
            multiplier = np.where(np.isfinite(multiplier), multiplier, 0.0)
            excess = middle[:, 0] - multiplier * (squares[0][stop, 0, count:] - edge)
            for k in (1, 2):
                rates = plus(
                    (squares[0][:, k, :count], squares[1][:, k, :count]),
                    times((-multiplier, -multiplier), (squares[0][stop, k, :count], squares[1][stop, k, :count])),
                )
                excess = excess + half[k - 1] * np.maximum(-rates[0], rates[1])
            bounds = np.where(np.isfinite(excess) & pass_on, np.minimum(excess, highest), highest)
        # Light beyond the cells would have to cross their border.
        border = (high == size).any(axis=1) | (~np.bool_(symmetric) & (low == -size).any(axis=1))
        settled = beside | ((bounds <= levels) & (bounds < np.inf) & ~border)
        settled[stop] |= (highest[stop] < np.inf) & ~border
        settled |= np.maximum.accumulate(found_mm == np.inf)[:, None]
        open_ = ~settled.all(axis=0)
        low, high = low[open_], high[open_]
        if halving == HALVINGS or not 0 < 4 * len(low) <= MOST_OPEN:
            break
        middles = 0.5 * (low + high)
        quarters = [(i, j) for i in (0, 1) for j in (0, 1)]
        low, high = (
            np.concatenate([np.where(np.array(which, bool), one, other) for which in quarters])
            for one, other in ((middles, low), (high, middles))
        )
    proven = found_mm
    if np.prod(high - low, axis=1).sum() > CLOSE * np.prod(size):
        at_border = np.where(border & ~beside, np.inf, bounds)
        left = np.where(settled, 0.0, at_border)[:, open_].max(axis=1)
        proven = np.maximum(proven, np.sqrt(np.maximum(left, 0.0)))
    return Beam([float(each) for each in found_mm], [float(each) for each in proven])


def _followed(lens: Lens, wavelength_nm: float, object_mm: float, low: Array, high: Array) -> _Followed:
    """Trace the rays of cells with corners (n, 2) mm, and of their centres."""
    half = 0.5 * (high - low).T
    middle = (low + 0.5 * (high - low)).T
    x, y = (
        _jet((np.append(low[:, k], middle[k]), np.append(high[:, k], middle[k])), k) for k in (0, 1)
    )  # fmt: skip
    indices = known_indices(lens, wavelength_nm)
    gaps = np.append(np.diff(lens.vertices_mm), 0.0)
    squares, pass_on = [], []
    with np.errstate(all="ignore"):
        p, q = _from_slopes(scaled(1.0 / object_mm, x), scaled(1.0 / object_mm, y), indices[0])
        for number, (surface, gap) in enumerate(zip(lens.surfaces, gaps, strict=True)):
            before, behind = indices[number], indices[number + 1]
            u, v = _slopes(p, q, before)
            z = _met(surface, x, y, u, v)
            x, y = (_tightened(plus(at, _product(along, z)), half) for at, along in ((x, u), (y, v)))
            bends = _bends(surface, _value(x), _value(y))
            if surface.paraxial:
                power = -surface.thin_lens_power_per_mm
                p, q = _from_slopes(plus(u, scaled(power, x)), plus(v, scaled(power, y)), behind)
            else:
                turn = _turn_by_phase(surface.phase, wavelength_nm, x, y) if surface.phase is not None else None
                p, q = _refracted(bends, (x, y), (p, q), (before, behind), turn)
            p, q = _tightened(p, half), _tightened(q, half)
            height2 = plus(_power2(x), _power2(y))
            squares.append(height2)
            u, v = _slopes(p, q, behind)
            pass_on.append(np.isfinite(u[1] - u[0]).all(axis=0) & np.isfinite(height2[1]).all(axis=0))
            way = plus(_constant(gap, z), scaled(-1.0, z))
            x, y = (_tightened(plus(at, _product(along, way)), half) for at, along in ((x, u), (y, v)))
    reached = np.logical_and.accumulate(np.array(pass_on))
    return _Followed(
        (np.array([each[0] for each in squares]), np.array([each[1] for each in squares])), reached[:, : len(low)]
    )


def _turn_by_phase(phase: Phase, wavelength_nm: float, x: Jet, y: Jet) -> tuple[Jet, Jet]:
    """Return the change of the optical direction cosines by a phase, before its projection onto the surface."""
    in_x, in_y, xx, xy, yy = (
        scaled(phase.path_per_rad_mm(wavelength_nm), each)
        for each in phase_bends(phase.profile(), _value(x), _value(y))
    )
    return tuple(  # type: ignore[return-value]
        _stacked(value, [plus(times(one, _by(x)[k]), times(other, _by(y)[k])) for k in (0, 1)])
        for value, one, other in ((in_x, xx, xy), (in_y, xy, yy))
    )


def _refracted(
    bends: list[Range], place: tuple[Jet, Jet], cosines: tuple[Jet, Jet], indices: tuple[float, float],
    turn: tuple[Jet, Jet] | None,
) -> tuple[Jet, Jet]:  # fmt: skip
    """Return the optical direction cosines p′ = p − Γ z_x and q′ = q − Γ z_y behind a surface.

    With m = (−z_x, −z_y, 1), r = √(n² − p² − q²) and g = r − p z_x − q z_y, Snell's law gives
    Γ = (n′² − n²) / (g + √(g² + m² (n′² − n²))). A phase first adds its change G to p and q, and n² becomes
    n² + 2 (p G_x + q G_y) + G².
    """
    (x, y), (p, q), (before, behind) = place, cosines, indices
    _, by_x, by_y, xx, xy, yy = bends
    slope_x, slope_y = (
        _stacked(value, [plus(times(one, _by(x)[k]), times(other, _by(y)[k])) for k in (0, 1)])
        for value, one, other in ((by_x, xx, xy), (by_y, xy, yy))
    )
    more = behind * behind - before * before
    r = _ahead(p, q, before)
    step: Jet | None = None
    if turn is not None:
        changed = plus(_product(p, turn[0]), _product(q, turn[1]))
        squares = plus(_power2(turn[0]), _power2(turn[1]))
        step = plus(_constant(more, r), scaled(-2.0, changed), scaled(-1.0, squares))
        p, q = plus(p, turn[0]), plus(q, turn[1])
    g = plus(r, scaled(-1.0, plus(_product(p, slope_x), _product(q, slope_y))))
    steep = plus(_constant(1.0, g), _power2(slope_x), _power2(slope_y))
    root = _root(plus(_power2(g), scaled(more, steep) if step is None else _product(step, steep)))
    over = _inverse(plus(g, root))
    gamma = scaled(more, over) if step is None else _product(step, over)
    ahead = plus(_value(r), _value(gamma))
    known = (_value(g)[0] > 0.0) & (ahead[0] > 0.0)
    return tuple(  # type: ignore[return-value]
        known_where(known, plus(along, scaled(-1.0, _product(gamma, slope))))
        for along, slope in ((p, slope_x), (q, slope_y))
    )


def _met(surface: Surface, x: Jet, y: Jet, u: Jet, v: Jet) -> Jet:
    """Return the sag at the points where rays from the vertex plane, along slopes, meet a surface."""
    at_x, at_y, at_u, at_v = (0.5 * (each[0][0] + each[1][0]) for each in (x, y, u, v))

    def off(z: Array) -> Array:
        return z - surface.sag_at_mm(at_x + at_u * z, at_y + at_v * z)

    before = np.zeros_like(at_x)
    off_before, middle = off(before), -off(before)
    for _ in range(STEPS):
        here = off(middle)
        step = np.nan_to_num(here * (middle - before) / (here - off_before), nan=0.0, posinf=0.0, neginf=0.0)
        before, off_before, middle = middle, here, middle - step
        if not (np.abs(step) > np.spacing(np.abs(middle))).any():
            break
    point = middle, middle

    def at(z: Range) -> list[Range]:
        places = [plus(_value(each), times(_value(along), z)) for each, along in ((x, u), (y, v))]
        return _bends(surface, places[0], places[1])

    def falls(bends: list[Range]) -> Range:
        return plus(_ones(middle), scaled(-1.0, plus(times(bends[1], _value(u)), times(bends[2], _value(v)))))

    apart = plus(point, scaled(-1.0, at(point)[0]))
    spare = WIDER * np.maximum(-apart[0], apart[1]) + np.spacing(np.abs(middle)) * 1024.0
    found = enclosed(middle, apart, lambda trial: falls(at(trial)), spare)
    bends = at(found)
    fall = falls(bends)
    rates = []
    for k in (0, 1):
        moves = [plus(_by(each)[k], times(_by(along)[k], found)) for each, along in ((x, u), (y, v))]
        rates.append(quotient(plus(times(bends[1], moves[0]), times(bends[2], moves[1])), fall))
    return _stacked(found, rates)


def _bends(surface: Surface, x: Range, y: Range) -> list[Range]:
    """Return bounds of the sag, its slopes and second derivatives; unbounded where the surface may have ended."""
    r2 = plus(squared(x), squared(y))
    r = np.sqrt(np.maximum(r2[0], 0.0)), np.sqrt(r2[1])
    known = r[1] <= surface.reach_mm
    known &= np.isfinite(r[1])
    x, y = (_zero_unless(known, each) for each in (x, y))
    if surface.form is not None:
        return [known_where(known, each) for each in surface.form.bends_in(surface, x, y)]
    parts = revolved_bends(surface.curvature_per_mm, surface.vertex_conic, surface.powers_mm, x, y)
    return [known_where(known, each) for each in parts]


def _zero_unless(known: NDArray[np.bool_], each: Range) -> Range:
    """Return ranges, set to zero where unknown."""
    return np.where(known, each[0], 0.0), np.where(known, each[1], 0.0)


def _from_slopes(u: Jet, v: Jet, index: float) -> tuple[Jet, Jet]:
    """Return optical direction cosines from slopes."""
    over = scaled(index, _inverse(_root(plus(_constant(1.0, u), _power2(u), _power2(v)))))
    return _product(u, over), _product(v, over)


def _slopes(p: Jet, q: Jet, index: float) -> tuple[Jet, Jet]:
    """Return slopes from optical direction cosines."""
    over = _inverse(_ahead(p, q, index))
    return _product(p, over), _product(q, over)


def _ahead(p: Jet, q: Jet, index: float) -> Jet:
    return _root(plus(_constant(index * index, p), scaled(-1.0, plus(_power2(p), _power2(q)))))


def _jet(value: Range, number: int) -> Jet:
    """Return a coordinate of the entry."""
    by = np.zeros((2, len(value[0])))
    by[number] = 1.0
    return np.vstack([value[0], by]), np.vstack([value[1], by])


def _value(jet: Jet) -> Range:
    return jet[0][0], jet[1][0]


def _by(jet: Jet) -> list[Range]:
    return [(jet[0][k], jet[1][k]) for k in (1, 2)]


def _stacked(value: Range, rates: list[Range]) -> Jet:
    return np.stack([value[0], *(r[0] for r in rates)]), np.stack([value[1], *(r[1] for r in rates)])


def _ones(like: Array) -> Range:
    one = np.ones_like(like)
    return one, one


def _constant(value: float, like: Jet) -> Jet:
    constant = np.zeros_like(like[0])
    constant[0] = value
    return constant, constant


def _product(one: Jet, other: Jet) -> Jet:
    return _stacked(
        times(_value(one), _value(other)),
        [plus(times(_value(one), b), times(_value(other), a)) for a, b in zip(_by(one), _by(other), strict=True)],
    )


def _power2(of: Jet) -> Jet:
    return _stacked(squared(_value(of)), [scaled(2.0, times(_value(of), rate)) for rate in _by(of)])


def _root(of: Jet) -> Jet:
    """Return square roots; unbounded where the radicand may be negative."""
    low, high = _value(of)
    known = low > 0.0
    root = known_where(known, (np.sqrt(np.where(known, low, 1.0)), np.sqrt(np.where(known, high, 1.0))))
    return _stacked(root, [known_where(known, scaled(0.5, quotient(rate, root))) for rate in _by(of)])


def _inverse(of: Jet) -> Jet:
    over = quotient(_ones(of[0][0]), _value(of))
    return _stacked(over, [scaled(-1.0, times(rate, squared(over))) for rate in _by(of)])


def _tightened(jet: Jet, half: Array) -> Jet:
    """Intersect the values of a jet with their mean value form; the second half belongs to the centres."""
    count = half.shape[1]
    moves = sum(
        np.where(half[k] > 0.0, half[k] * np.maximum(-rate[0], rate[1])[:count], 0.0) for k, rate in enumerate(_by(jet))
    )
    low, high = overlap((jet[0][0, :count], jet[1][0, :count]), (jet[0][0, count:] - moves, jet[1][0, count:] + moves))
    tight = jet[0].copy(), jet[1].copy()
    tight[0][0, :count], tight[1][0, :count] = low, high
    return tight
