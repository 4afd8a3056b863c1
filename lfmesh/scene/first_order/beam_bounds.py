"""Bounds of the meridional rays of a zone: heights that no ray of it exceeds, by interval arithmetic.

A zone is an interval of heights in the plane of the first vertex. Every number of its rays is an interval, too, and so
are derivatives by the height at which rays enter: a height lies within that of the middle ray plus the derivative's
bounds times half the zone (mean value form: R. E. Moore, R. B. Kearfott and M. J. Cloud, Introduction to Interval
Analysis, 2009, chapter 6). The place on a surface is enclosed by the interval Newton method (chapter 8 there), which
proves that there is one. Bounds are not rounded outwards: they hold up to some roundings of float64.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.optics.glass import refractive_index
from lfmesh.scene.camera.lens import Lens, Surface

Array = NDArray[np.float64]

STEPS = 12
"""Of Newton's method towards a surface, for the middles of zones."""

WIDENINGS = 4
"""Largest number of trials to enclose the places at which the rays of a zone meet a surface."""

WIDER = 1.5
"""By how much each is wider than the one before."""

ZONES, HALVINGS, MOST_OPEN = 16, 18, 4096
"""Zones of a beam at first, how often they are divided in two at most, and how many at a time."""

CLOSE = 1e-6
"""Relative error of the width of a beam."""

ENDED = 6
"""Number of halvings from which on a zone is taken to end where the rays on both of its edges do."""


class Zones(NamedTuple):
    """Rays of zones at the surfaces of a lens; NaN from where not all rays of a zone are known to come.

    Attributes
    ----------
    heights_mm : (surfaces, 2, n) float64
        Lower and upper bounds.
    slopes : (surfaces, 2, n) float64
        Of the derivatives of heights by the height at which rays enter.
    """

    heights_mm: Array
    slopes: Array


class _Rays(NamedTuple):
    """Heights in a plane, angles to the axis, and their derivatives by the entries: intervals, (2, n) each."""

    height: Array
    angle: Array
    height_by: Array
    angle_by: Array


def widest_mm(
    lens: Lens, wavelength_nm: float, object_mm: float, entry_mm: float, clear_mm: ArrayLike = 0.0
) -> list[float]:
    """Return the largest height at each surface of the rays up to one that pass the stop, no aperture in their way.

    Zones are divided until no ray of any can be higher, by more than `CLOSE`, than one that was found.

    Parameters
    ----------
    lens, wavelength_nm, object_mm
        As for `followed`.
    entry_mm : float
        Height of the outermost ray in the plane of the first vertex, above 0.
    clear_mm : float or (surfaces,) float, mm
        A beam that is proven to stay below is not followed more closely: its largest height lies between the returned
        value and this.

    Returns
    -------
    list of float
        mm; 0 at surfaces that no ray reaches.
    """
    stop = lens.stop_index or 0
    radius = (1.0 + CLOSE) * (lens.surfaces[stop].semi_diameter_mm or math.nan)
    edges = np.linspace(0.0, entry_mm, ZONES + 1)
    low, high, widest = edges[:-1], edges[1:], np.zeros((len(lens.surfaces), 1))
    clear = np.broadcast_to(np.asarray(clear_mm, np.float64), len(widest))[:, None]
    for halving in range(HALVINGS + 1):
        # Both edges of each zone, and the zone.
        zones = followed(
            lens, wavelength_nm, object_mm, np.concatenate([low, high, low]), np.concatenate([low, high, high])
        )
        *ends, heights = np.split(np.abs(zones.heights_mm), 3, axis=2)
        passing = [np.where(each[stop].max(axis=0) <= radius, each.max(axis=1), np.nan) for each in ends]
        widest = np.fmax(widest, np.fmax.reduce(np.fmax(*passing), axis=1, keepdims=True))
        # Heights that rise or fall all through a zone are largest on an edge.
        steady = (zones.slopes[:, 0] * zones.slopes[:, 1] >= 0.0)[:, 2 * len(low) :]
        passes = steady[stop] & np.isfinite(passing[0][stop] + passing[1][stop])
        settled = steady & (passes | (heights[stop].max(axis=0) <= radius))
        settled |= heights.max(axis=1) <= np.maximum(widest * (1.0 + CLOSE), clear)
        settled |= heights[stop].min(axis=0) > radius
        if halving >= ENDED:
            settled |= np.isnan(ends[0] + ends[1]).any(axis=1)
        low, high = (each[~settled.all(axis=0)][:MOST_OPEN] for each in (low, high))
        if not len(low):
            break
        middle = 0.5 * (low + high)
        low, high = np.append(low, middle), np.append(middle, high)
    return [float(each) for each in widest[:, 0]]


def followed(lens: Lens, wavelength_nm: float, object_mm: float, low_mm: Array, high_mm: Array) -> Zones:
    """Return bounds of the rays of zones at every surface, whatever apertures they pass.

    Parameters
    ----------
    lens : Lens
        Solved, its surfaces all of revolution.
    wavelength_nm : float
    object_mm : float
        As for `meridional.heights_mm`.
    low_mm, high_mm : (n,) float64
        Heights in the plane of the first vertex, between which a zone lies; single rays where both are equal.
    """
    count, half = len(low_mm), 0.5 * (high_mm - low_mm)
    middle = low_mm + half
    # The middle rays of all zones follow these.
    entry = np.stack([np.append(low_mm, middle), np.append(high_mm, middle)])
    vergence = 1.0 / object_mm
    one = np.ones_like(entry)
    angle, angle_by = np.arctan(vergence * entry), vergence / (1.0 + np.square(vergence * entry))
    rays = _Rays(entry, np.sort(angle, axis=0), one, np.sort(angle_by, axis=0))
    heights, slopes = [], []
    index, *behind = (refractive_index(medium, wavelength_nm) for medium in lens.media)
    gaps = np.append(np.diff(lens.vertices_mm), 0.0)
    with np.errstate(all="ignore"):
        for surface, gap, after in zip(lens.surfaces, gaps, behind, strict=True):
            met, met_by, rays = _through(surface, rays, index / after, float(gap), half)
            heights.append(met[:, :count])
            slopes.append(met_by[:, :count])
            index = index if surface.paraxial else after
    return Zones(np.stack(heights), np.stack(slopes))


def _through(surface: Surface, rays: _Rays, ratio: float, gap: float, half: Array) -> tuple[Array, Array, _Rays]:
    """Return heights at a surface, their derivatives, and the rays in the vertex plane of the next one."""
    steep = np.tan(rays.angle)
    met = _met(surface, rays.height, steep)
    sag, rise, bend = _shape(surface, met)
    steep_by = _times(rays.angle_by, 1.0 + _square(steep))
    met_by = _over(rays.height_by + _times(sag, steep_by), 1.0 - _times(rise, steep)[::-1])
    met = _tightened(met, met_by, half)
    sag, rise, bend = _shape(surface, met)
    if surface.paraxial:
        power = surface.thin_lens_power_per_mm
        steep_behind = steep - _scaled(met, power)[::-1]
        angle = np.arctan(steep_behind)
        angle_by = _over(steep_by - _scaled(met_by, power)[::-1], 1.0 + _square(steep_behind))
    else:
        turn, turn_by = np.arctan(rise), _times(_over(bend, 1.0 + _square(rise)), met_by)
        inside = rays.angle + turn
        inside = np.where(np.abs(inside).max(axis=0) < 0.5 * math.pi, inside, np.nan)
        # Beyond total reflection the arc sine is NaN.
        outside = np.arcsin(ratio * np.sin(inside))
        bent = ratio * _over(_cosine(inside), _cosine(outside))
        angle = outside - turn[::-1]
        angle_by = _times(bent, rays.angle_by + turn_by) - turn_by[::-1]
    angle = _tightened(np.where(np.isnan(angle).any(axis=0), np.nan, angle), angle_by, half)
    steep = np.tan(angle)
    way = gap - sag[::-1]
    height = met + _times(way, steep)
    height_by = _times(met_by, 1.0 - _times(rise, steep)[::-1]) + _times(way, _times(angle_by, 1.0 + _square(steep)))
    return met, met_by, _Rays(_tightened(height, height_by, half), angle, height_by, angle_by)


def _met(surface: Surface, height: Array, steep: Array) -> Array:
    """Return an interval that holds the one height at which each ray meets a surface; NaN where that is not proven."""
    h, t = height.mean(axis=0), steep.mean(axis=0)
    middle = h.copy()
    for _ in range(STEPS):
        sag, rise, _ = (each[0] for each in _shape(surface, np.stack([middle, middle])))
        middle = middle - (middle - h - sag * t) / (1.0 - rise * t)
    at_middle = np.stack([middle, middle])
    sag, rise, _ = _shape(surface, at_middle)
    off = middle - height[::-1] - _times(sag, steep)[::-1]
    spare = WIDER * np.abs(off).max(axis=0) / np.abs(1.0 - rise[0] * t) + np.spacing(np.abs(middle)) * 1024.0
    found = np.full_like(height, np.nan)
    open_ = np.ones(len(middle), np.bool_)
    for _ in range(WIDENINGS):
        trial = at_middle + np.array([[-1.0], [1.0]]) * spare
        trial = np.where(np.abs(trial).max(axis=0) <= surface.reach_mm, trial, np.nan)
        _, rise, _ = _shape(surface, trial)
        newton = middle - _over(off, 1.0 - _times(rise, steep)[::-1])[::-1]
        holds = open_ & (newton[0] >= trial[0]) & (newton[1] <= trial[1])
        found[:, holds] = newton[:, holds]
        open_ &= ~holds
        spare = WIDER * np.maximum(spare, np.abs(newton - middle).max(axis=0))
        if not open_.any():
            break
    return found


def _shape(surface: Surface, height: Array) -> tuple[Array, Array, Array]:
    """Return bounds of the sag at heights (2, n), and of its first and second derivative."""
    out = np.abs(height)
    out = np.stack([np.where(height[0] * height[1] <= 0.0, 0.0, out.min(axis=0)), out.max(axis=0)])
    c = surface.curvature_per_mm
    bulge = (1.0 + surface.vertex_conic) * c * c

    def root(of: Array) -> Array:
        return np.sqrt(1.0 - bulge * np.square(of))

    # Each of these rises or falls all the way, so that its bounds are its values at the ends.
    sags, rises = [c * np.square(out) / (1.0 + root(out))], [c * height / root(height)]
    bends = [c / root(out) ** 3]
    for power, factor in surface.powers_mm:
        if factor:
            sags.append(factor * out**power)
            rises.append(factor * power * np.sign(height) * np.abs(height) ** (power - 1))
            bends.append(factor * power * (power - 1) * out ** (power - 2))
    return _sum(sags), _sum(rises), _sum(bends)


def _sum(parts: list[Array]) -> Array:
    """Return the sum of intervals, whose ends may be in either order."""
    return np.asarray(np.sort(np.stack(parts), axis=1).sum(axis=0))


def _tightened(value: Array, slope: Array, half: Array) -> Array:
    """Return intervals (2, 2 n) within those of the mean value form; the second half are those of middle rays."""
    count = len(half)
    reach = half * np.abs(slope[:, :count]).max(axis=0)
    low = np.maximum(value[0, :count], value[0, count:] - reach)
    high = np.minimum(value[1, :count], value[1, count:] + reach)
    return np.stack([np.append(low, value[0, count:]), np.append(high, value[1, count:])])


def _times(one: Array, other: Array) -> Array:
    products = np.stack([one[0] * other[0], one[0] * other[1], one[1] * other[0], one[1] * other[1]])
    return np.stack([products.min(axis=0), products.max(axis=0)])


def _scaled(of: Array, by: float) -> Array:
    return np.sort(of * by, axis=0)


def _over(one: Array, other: Array) -> Array:
    """Return quotients; NaN where the divisor may be zero."""
    divides = other[0] * other[1] > 0.0
    return _times(one, 1.0 / np.where(divides, other[::-1], np.nan))


def _square(of: Array) -> Array:
    square = np.sort(np.square(of), axis=0)
    return np.stack([np.where(of[0] * of[1] <= 0.0, 0.0, square[0]), square[1]])


def _cosine(of: Array) -> Array:
    """Return the cosine of angles within a right angle."""
    cosine = np.sort(np.cos(of), axis=0)
    return np.stack([cosine[0], np.where(of[0] * of[1] <= 0.0, 1.0, cosine[1])])
