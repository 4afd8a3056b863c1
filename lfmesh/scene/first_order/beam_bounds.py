"""Bounds on the heights of a zone's meridional rays, by interval arithmetic.

A zone is an interval of entry heights in the plane of the first vertex. All quantities of its rays, and their
derivatives by the entry height, are intervals too. A height differs from the middle ray's by at most the derivative's
bound times half the zone (mean value form: R. E. Moore, R. B. Kearfott and M. J. Cloud, Introduction to Interval
Analysis, 2009, chapter 6). The interval Newton method (chapter 8) proves and encloses the point on a surface. Unbounded
intervals stand for rays that may have ended.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.optics.bounds import (
    Array,
    Range,
    known_where,
    meridian_ranges,
    overlap,
    plus,
    quotient,
    scaled,
    squared,
    times,
)
from lfmesh.optics.glass import refractive_index
from lfmesh.optics.phase_ranges import meridian_phase
from lfmesh.optics.phase_shapes import PhaseProfile
from lfmesh.scene.camera.gradient import Gradient
from lfmesh.scene.camera.lens import Lens
from lfmesh.scene.camera.surface import Surface

STEPS = 24
"""Maximum number of secant steps to a surface, for the middles of zones."""

WIDENINGS = 4
"""Maximum number of trials to enclose the points where the rays of a zone meet a surface."""

WIDER = 1.5
"""Factor by which each trial widens the previous one."""

ZONES, HALVINGS, MOST_OPEN = 16, 18, 4096
"""Initial number of zones of a beam, maximum number of bisections, and maximum number of zones left to bisect."""

CLOSE = 1e-6
"""Relative error of the width of a beam, and fraction of its light that may remain undecided."""


class Beam(NamedTuple):
    """Largest heights of the rays of a beam at each surface of a lens.

    Attributes
    ----------
    found_mm : list of float
        Of traced rays. 0: none arrives. inf: some end there, by a miss or total reflection; surfaces behind are not
        examined.
    proven_mm : list of float
        No ray is higher than this or a given `clear_mm`, within `CLOSE`; inf if nothing is proven.
    """

    found_mm: list[float]
    proven_mm: list[float]


class Zones(NamedTuple):
    """Rays of zones at the surfaces of a lens.

    Attributes
    ----------
    heights_mm : (surfaces, 2, n) float64
        Lower and upper bounds; infinite once some rays of a zone may have ended.
    slopes : (surfaces, 2, n) float64
        Bounds of the derivatives of heights by the entry height.
    pass_on : (surfaces, n) bool
        True if all rays of the zone are known to continue behind the surface.
    """

    heights_mm: Array
    slopes: Array
    pass_on: NDArray[np.bool_]


class _Rays(NamedTuple):
    """Heights in a plane, angles to the axis, and their derivatives by the entry heights: two arrays (n,) each."""

    height: Range
    angle: Range
    height_by: Range
    angle_by: Range


class _Turn(NamedTuple):
    """Phase of a surface, and the change of sine by the index behind it and its derivative."""

    profile: PhaseProfile
    per_index_mm: float

    def along(self, height: Range, height_by: Range, turn: Range, turn_by: Range) -> tuple[Range, Range]:
        """Return the change of the sine to the normal, G cos τ / n', and its derivative by the entry height.

        Parameters
        ----------
        height, height_by : Range, mm and 1
        turn, turn_by : Range, rad and rad/mm
            Angle τ of the normal.
        """
        slope, bend = (scaled(self.per_index_mm, each) for each in meridian_phase(self.profile, height))
        cosine = _cosine(turn)
        sine = np.sin(turn[0]), np.sin(turn[1])
        by = plus(times(bend, height_by, cosine), scaled(-1.0, times(slope, sine, turn_by)))
        return times(slope, cosine), by


def widest_mm(
    lens: Lens, wavelength_nm: float, object_mm: float, entry_mm: float, clear_mm: ArrayLike = 0.0
) -> tuple[Beam, bool]:  # fmt: skip
    """Return the largest height at each surface of rays that pass the stop, ignoring other apertures.

    Zones are bisected until no ray can be higher than a traced one by more than `CLOSE`. The second value is True if
    all rays up to the outermost are proven to pass the stop.

    Parameters
    ----------
    lens, wavelength_nm, object_mm
        As in `followed`.
    entry_mm : float
        Entry height of the outermost ray, above 0.
    clear_mm : float or (surfaces,) float, mm
        Limit below which a beam is not refined further: its largest height lies between that of the traced rays and
        this.
    """
    stop = lens.stop_index or 0
    radius = (1.0 + CLOSE) * (lens.surfaces[stop].semi_diameter_mm or math.nan)
    edges = np.linspace(0.0, entry_mm, ZONES + 1)
    low, high, widest = edges[:-1], edges[1:], np.zeros((len(lens.surfaces), 1))
    clear = np.broadcast_to(np.asarray(clear_mm, np.float64), len(widest))[:, None]
    all_pass = True
    for halving in range(HALVINGS + 1):
        # Both edges of each zone, then the zone itself.
        zones = followed(
            lens, wavelength_nm, object_mm, np.concatenate([low, high, low]), np.concatenate([low, high, high])
        )
        count = len(low)
        highest = np.abs(zones.heights_mm).max(axis=1)
        beside = (zones.heights_mm[stop, 0] > radius) | (zones.heights_mm[stop, 1] < -radius)
        inside = highest[stop] <= radius
        # A ray that passes the stop ends at the first surface that it does not continue from.
        going = np.logical_and.accumulate(np.concatenate([np.ones_like(inside)[None], zones.pass_on]))
        reached = np.where(going[1:], highest, np.where(going[:-1], np.inf, 0.0))[:, : 2 * count]
        widest = np.maximum(widest, np.max(np.where(inside[: 2 * count], reached, 0.0), axis=1, keepdims=True))
        bounds = np.where(zones.pass_on, highest, np.inf)[:, 2 * count :]
        # Heights that are monotonic in a zone are largest on an edge.
        steady = (zones.slopes[:, 0] * zones.slopes[:, 1] >= 0.0)[:, 2 * count :] & (bounds < np.inf)
        whole = inside[2 * count :] | (steady[stop] & inside[:count] & inside[count : 2 * count])
        low_enough = (bounds < np.inf) & (bounds <= np.maximum(widest * (1.0 + CLOSE), clear))
        settled = low_enough | (steady & whole) | beside[2 * count :] | (np.maximum.accumulate(widest) == np.inf)
        open_ = ~settled.all(axis=0)
        all_pass &= bool(whole[~open_].all())
        low, high = low[open_], high[open_]
        if halving == HALVINGS or not 0 < 2 * len(low) <= MOST_OPEN:
            break
        middle = 0.5 * (low + high)
        low, high = np.append(low, middle), np.append(middle, high)
    proven = widest[:, 0].copy()
    # Zones around a ray that ends stay open but hold hardly any light. If they hold more, only bounds are known.
    if float((high - low) @ (high + low)) > CLOSE * entry_mm**2:
        proven = np.maximum(proven, np.where(settled, 0.0, bounds)[:, open_].max(axis=1))
    found = Beam([float(each) for each in widest[:, 0]], [float(each) for each in proven])
    return found, all_pass and not len(low)


def known_indices(lens: Lens, wavelength_nm: float) -> list[float]:
    """Return the index before the first surface and behind each; NaN of gradient-index glass, so nothing is proven.

    Parameters
    ----------
    lens : Lens
    wavelength_nm : float
    """
    return [
        math.nan if isinstance(medium, Gradient) else refractive_index(medium, wavelength_nm) for medium in lens.media
    ]


def followed(lens: Lens, wavelength_nm: float, object_mm: float, low_mm: Array, high_mm: Array) -> Zones:
    """Return bounds of the rays of zones at every surface, ignoring apertures.

    Parameters
    ----------
    lens : Lens
        Solved, with surfaces of revolution only.
    wavelength_nm : float
    object_mm : float
        As in `meridional.heights_mm`.
    low_mm, high_mm : (n,) float64
        Limits of each zone; equal limits give a single ray.
    """
    count, half = len(low_mm), 0.5 * (high_mm - low_mm)
    middle = low_mm + half
    # The middle rays of all zones follow these.
    entry = np.append(low_mm, middle), np.append(high_mm, middle)
    vergence = 1.0 / object_mm
    with np.errstate(all="ignore"):
        steep = scaled(vergence, entry)
        angle = np.arctan(steep[0]), np.arctan(steep[1])
        rays = _Rays(entry, angle, _ones(entry), quotient(scaled(vergence, _ones(entry)), _one_and_square(steep)))
        heights, slopes, pass_on = [], [], []
        index, *behind = known_indices(lens, wavelength_nm)
        gaps = np.append(np.diff(lens.vertices_mm), 0.0)
        for surface, gap, after in zip(lens.surfaces, gaps, behind, strict=True):
            turn = None
            if surface.phase is not None:
                turn = _Turn(surface.phase.profile(), surface.phase.path_per_rad_mm(wavelength_nm) / after)
            met, met_by, rays = _through(surface, rays, index / after, float(gap), half, turn)
            heights.append([end[:count] for end in met])
            slopes.append([end[:count] for end in met_by])
            pass_on.append(np.isfinite(rays.angle[1] - rays.angle[0])[:count])
            index = index if surface.paraxial else after
    return Zones(np.array(heights), np.array(slopes), np.array(pass_on))


def _through(
    surface: Surface, rays: _Rays, ratio: float, gap: float, half: Array, phase: _Turn | None = None
) -> tuple[Range, Range, _Rays]:
    """Return heights at a surface, their derivatives, and the rays in the vertex plane of the next one."""
    steep = _tangent(rays.angle)
    met = _met(surface, rays.height, steep)
    sag, rise, _ = _shape(surface, met)
    steep_by = times(rays.angle_by, _one_and_square(steep))
    met_by = quotient(plus(rays.height_by, times(sag, steep_by)), _one_less(times(rise, steep)))
    met = _tightened(met, met_by, half)
    sag, rise, bend = _shape(surface, met)
    if surface.paraxial:
        power = surface.thin_lens_power_per_mm
        steep_behind = plus(steep, scaled(-power, met))
        angle = np.arctan(steep_behind[0]), np.arctan(steep_behind[1])
        angle_by = quotient(plus(steep_by, scaled(-power, met_by)), _one_and_square(steep_behind))
    else:
        turn = np.arctan(rise[0]), np.arctan(rise[1])
        turn_by = times(quotient(bend, _one_and_square(rise)), met_by)
        inside = plus(rays.angle, turn)
        sines: Sequence[Array] = [ratio * np.sin(end) for end in inside]
        if phase is not None:
            change, change_by = phase.along(met, met_by, turn, turn_by)
            sines = plus((sines[0], sines[1]), change)
        # Past a right angle the ray meets the surface from behind; past a sine of 1 it is totally reflected.
        bends = (inside[0] > -0.5 * math.pi) & (inside[1] < 0.5 * math.pi) & (sines[0] >= -1.0) & (sines[1] <= 1.0)
        inside = known_where(bends, inside)
        outside = known_where(bends, [np.arcsin(each) for each in sines])
        bent = scaled(ratio, quotient(_cosine(inside), _cosine(outside)))
        angle = plus(outside, scaled(-1.0, turn))
        angle_by = plus(times(bent, plus(rays.angle_by, turn_by)), scaled(-1.0, turn_by))
        if phase is not None:
            angle_by = plus(angle_by, quotient(change_by, _cosine(outside)))
    angle = _tightened(angle, angle_by, half)
    steep = _tangent(angle)
    way = plus(scaled(gap, _ones(sag)), scaled(-1.0, sag))
    height = plus(met, times(way, steep))
    height_by = plus(times(met_by, _one_less(times(rise, steep))), times(way, times(angle_by, _one_and_square(steep))))
    return met, met_by, _Rays(_tightened(height, height_by, half), angle, height_by, angle_by)


def _met(surface: Surface, height: Range, steep: Range) -> Range:
    """Enclose the height of each ray's intersection with a surface; unbounded if unproven."""
    h, t = (0.5 * (each[0] + each[1]) for each in (height, steep))
    before, middle = h, h + surface.sag_mm(h) * t
    off_before = before - h - surface.sag_mm(before) * t
    for _ in range(STEPS):
        off = middle - h - surface.sag_mm(middle) * t
        step = np.nan_to_num(off * (middle - before) / (off - off_before), nan=0.0, posinf=0.0, neginf=0.0)
        before, off_before, middle = middle, off, middle - step
        if not (np.abs(step) > np.spacing(np.abs(middle))).any():
            break
    _, rise, _ = _shape(surface, (middle, middle))
    sag = surface.sag_mm(middle)
    apart = plus((middle, middle), scaled(-1.0, height), scaled(-1.0, times((sag, sag), steep)))
    spare = WIDER * np.maximum(-apart[0], apart[1]) / np.abs(1.0 - rise[0] * t) + np.spacing(np.abs(middle)) * 1024.0

    def falls(trial: Range) -> Range:
        exists = (trial[0] >= -surface.reach_mm) & (trial[1] <= surface.reach_mm)
        _, rise, _ = _shape(surface, known_where(exists, trial))
        return _one_less(times(rise, steep))

    return enclosed(middle, apart, falls, spare)


def enclosed(middle: Array, apart: Range, falls: Callable[[Range], Range], spare: Array) -> Range:
    """Enclose the zero of each of several functions by interval Newton; ranges are unbounded if unproven.

    Parameters
    ----------
    middle : (n,) float64
        Points near the zeros.
    apart : (n,) float64 each
        Bounds of the functions at these points.
    falls : callable
        Returns bounds of their derivatives over ranges.
    spare : (n,) float64
        Half widths of the first trial ranges.
    """
    found = np.full_like(middle, -np.inf), np.full_like(middle, np.inf)
    open_ = np.ones(len(middle), np.bool_)
    for _ in range(WIDENINGS):
        trial = middle - spare, middle + spare
        newton = plus((middle, middle), scaled(-1.0, quotient(apart, falls(trial))))
        holds = open_ & (newton[0] >= trial[0]) & (newton[1] <= trial[1])
        for end, of_newton in zip(found, newton, strict=True):
            end[holds] = of_newton[holds]
        open_ &= ~holds
        spare = WIDER * np.maximum(spare, np.maximum(middle - newton[0], newton[1] - middle))
        if not open_.any():
            break
    return found


def _shape(surface: Surface, height: Range) -> tuple[Range, Range, Range]:
    """Return bounds of the sag at heights and of its first two derivatives; unbounded where it may end."""
    return meridian_ranges(surface.curvature_per_mm, surface.vertex_conic, surface.powers_mm, height)


def _tightened(value: Range, slope: Range, half: Array) -> Range:
    """Intersect ranges (2 n,) with their mean value form; the second half belongs to the middle rays."""
    count = len(half)
    reach = half * np.maximum(-slope[0], slope[1])[:count]
    reach = np.where(half > 0.0, reach, 0.0)
    low, high = overlap((value[0][:count], value[1][:count]), (value[0][count:] - reach, value[1][count:] + reach))
    return np.append(low, value[0][count:]), np.append(high, value[1][count:])


def _ones(like: Range) -> Range:
    one = np.ones_like(like[0])
    return one, one


def _one_less(each: Range) -> Range:
    return plus(_ones(each), scaled(-1.0, each))


def _one_and_square(each: Range) -> Range:
    return plus(_ones(each), squared(each))


def _tangent(angle: Range) -> Range:
    inside = (angle[0] > -0.5 * math.pi) & (angle[1] < 0.5 * math.pi)
    return known_where(inside, (np.tan(angle[0]), np.tan(angle[1])))


def _cosine(of: Range) -> Range:
    """Return the cosine of angles within ±90 degrees."""
    one, other = np.cos(of[0]), np.cos(of[1])
    cosine = np.minimum(one, other), np.where((of[0] <= 0.0) & (of[1] >= 0.0), 1.0, np.maximum(one, other))
    return np.nan_to_num(cosine[0], nan=0.0), np.nan_to_num(cosine[1], nan=1.0)
