"""Real rays of the axial beam through the rim of the stop, for lenses without rotational symmetry.

From these samples `skew_bounds` finds the outermost ray and proves that none lies farther out.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.optics.glass import refractive_index
from lfmesh.optics.ray_aiming import continue_rays
from lfmesh.scene.camera.lens import Lens
from lfmesh.scene.camera.surface import Surface
from lfmesh.scene.first_order.beam_bounds import Beam
from lfmesh.scene.first_order.gradient_rays import GradientSpace, space_behind
from lfmesh.scene.first_order.phase_turns import turn_by_phase
from lfmesh.scene.first_order.skew_bounds import widest_mm

Array = NDArray[np.float64]

AZIMUTHS = 96
"""Number of rays through the rim of the stop; a parabola through three gives the largest height between them."""

RINGS = 2
"""Number of rings of rays in the stop, including its rim; they are starting points for other rays of the beam."""

STEPS = 20
"""Maximum number of Newton steps to a surface."""

DIFFERENCE = 1e-6
"""Finite-difference step: of a surface's slope, over its clear aperture; of rays, over the stop's radius."""


def beam_mm(lens: Lens, wavelength_nm: float, object_mm: float, clear_mm: ArrayLike = 0.0) -> Beam:
    """Return the largest height at each surface of the beam that fills the stop, ignoring other apertures.

    Parameters
    ----------
    lens : Lens
        Solved; poses of its elements are ignored.
    wavelength_nm, object_mm : float
        As in `meridional.heights_mm`.
    clear_mm : float or (surfaces,) float, mm
        As in `beam_bounds.widest_mm`.

    Returns
    -------
    Beam
        Without heights if no ray reaches the rim of the stop. Through gradient-index glass, nothing is proven beyond
        the traced rays.
    """
    stop = lens.stop_index or 0
    radius = lens.surfaces[stop].semi_diameter_mm or math.nan
    angle = 2.0 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS
    ring = radius * np.arange(1, RINGS + 1) / RINGS
    points = (ring[:, None, None] * np.column_stack([np.sin(angle), np.cos(angle)])).reshape(-1, 2)
    middle = _crossings(lens, wavelength_nm, object_mm, np.zeros((1, 2)))[stop]

    def miss(entry: Array, share: Array, which: NDArray[np.int64]) -> Array:
        wanted = middle + share[:, None] * (points[which] - middle)
        return _crossings(lens, wavelength_nm, object_mm, entry)[stop] - wanted

    rays = continue_rays(miss, np.zeros_like(points), DIFFERENCE * radius, radius)
    if not rays.arrived[-AZIMUTHS:].any():
        return Beam([], [])
    met = np.hypot(*np.moveaxis(_crossings(lens, wavelength_nm, object_mm, rays.start), 2, 0))
    found = np.array([max(_largest(each) for each in heights.reshape(RINGS, AZIMUTHS)) for heights in met[:-1]])
    # A ray ends at the surface that it misses, or beyond which it does not continue.
    goes_on = np.isfinite(met[:-1]) & np.isfinite(met[1:])
    ends = ~goes_on & np.logical_and.accumulate(np.vstack([goes_on[:1] | True, goes_on]))[:-1]
    found[ends[:, np.isfinite(met[stop])].any(axis=1)] = np.inf
    if lens.has_gradients:
        return Beam([float(each) for each in found], [float(each) for each in found])
    return widest_mm(lens, wavelength_nm, object_mm, np.abs(rays.start).max(axis=0), found, clear_mm)


def _largest(heights: Array) -> float:
    """Return the largest height around a circle, by a parabola through the highest samples."""
    k = int(np.nanargmax(heights)) if np.isfinite(heights).any() else 0
    before, top, behind = heights[k - 1], heights[k], heights[(k + 1) % len(heights)]
    bend = 2.0 * top - before - behind
    rise = (before - behind) ** 2 / (8.0 * bend) if bend > 0.0 else 0.0
    return float(top + rise)


def _crossings(lens: Lens, wavelength_nm: float, object_mm: float, entry: Array) -> Array:
    """Return the points where axial-point rays entering at (n, 2) meet the surfaces, (surfaces + 1, n, 2) mm.

    NaN after a miss or total reflection; the last entry holds slopes behind all surfaces.
    """
    p, met = np.column_stack([entry, np.zeros(len(entry))]), []
    d = np.column_stack([entry / object_mm, np.ones(len(entry))])
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    media, space = [refractive_index(medium, wavelength_nm) for medium in lens.media], None
    before: float | Array = media[0]
    with np.errstate(all="ignore"):
        for surface, vertex, index in zip(lens.surfaces, lens.vertices_mm, media[1:], strict=True):
            behind: float | Array = index
            p = p - np.array([0.0, 0.0, vertex])
            if space is not None:
                p, d, before = _through(space, surface, p, d)
            p = _met(surface, p, d)
            met.append(p[:, :2])
            space = space_behind(surface, wavelength_nm)
            if space is not None:
                behind = space.index_at(p)[:, None]
            if surface.paraxial:
                d = d / d[:, 2:] - np.pad(surface.thin_lens_power_per_mm * p[:, :2], ((0, 0), (0, 1)))
                d /= np.linalg.norm(d, axis=1, keepdims=True)
            elif surface.phase is None:
                d = _bent(_normal(surface, p), d, before / behind)
            else:
                turn = turn_by_phase(surface.phase, wavelength_nm, p[:, 0], p[:, 1])
                d = _turned(_normal(surface, p), before * d, turn, behind)
            before = behind
            p = p + np.array([0.0, 0.0, vertex])
        met.append(d[:, :2] / d[:, 2:])
    return np.stack(met)


def _through(space: GradientSpace, surface: Surface, p: Array, d: Array) -> tuple[Array, Array, Array]:
    """Return the straight rays that end on a surface as those through gradient-index glass do.

    Parameters
    ----------
    space : GradientSpace
        Glass before the surface.
    surface : Surface
    p, d : (n, 3) float64
        Points on the face in front of the glass, from the vertex of `surface`, and directions.

    Returns
    -------
    tuple of (n, 3), (n, 3) and (n, 1) float64
        Points at the end and directions, and the indices there; NaN of rays that do not reach the surface.
    """
    front = np.array([0.0, 0.0, space.length_mm])
    p, d = space.followed(p + front, d, lambda at, along: _met(surface, at - front, along) + front)
    return p - front, d, space.index_at(p)[:, None]


def _met(surface: Surface, p: Array, d: Array) -> Array:
    p = p - (p[:, 2] / d[:, 2])[:, None] * d
    last = np.full(len(p), np.inf)
    for _ in range(STEPS):
        normal = _normal(surface, p)
        above = p[:, 2] - surface.sag_at_mm(p[:, 0], p[:, 1])
        # The normal is the gradient of the height above the surface, times its z component.
        step = above * normal[:, 2] / (normal * d).sum(axis=1)
        p = p - step[:, None] * d
        if not (np.abs(step) < 0.5 * last).any():
            break  # no step shrinks any more, but for rounding
        last = np.abs(step)
    return p


def _normal(surface: Surface, p: Array) -> Array:
    """Return unit normals (n, 3), pointing to +z at the vertex."""
    x, y = p[:, 0], p[:, 1]
    step = DIFFERENCE * (surface.semi_diameter_mm or 1.0)
    by_x = (surface.sag_at_mm(x + step, y) - surface.sag_at_mm(x - step, y)) / (2.0 * step)
    by_y = (surface.sag_at_mm(x, y + step) - surface.sag_at_mm(x, y - step)) / (2.0 * step)
    normal = np.column_stack([-by_x, -by_y, np.ones(len(p))])
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)


def _bent(normal: Array, d: Array, ratio: float | Array) -> Array:
    """Return refracted directions, NaN under total reflection; the ratio of the indices is one, or (n, 1)."""
    cosine = (normal * d).sum(axis=1, keepdims=True)
    along = np.sqrt(1.0 - ratio**2 * (1.0 - cosine**2)) - ratio * cosine
    return np.asarray(ratio * d + along * normal)


def _turned(normal: Array, optical: Array, turn: Array, index: float | Array) -> Array:
    """Return directions behind a phase, NaN of evanescent light.

    Parameters
    ----------
    normal : (n, 3) float64
    optical : (n, 3) float64
        Index times direction before the surface.
    turn : (n, 2) float64
        Its change along x and y.
    index : float or (n, 1) float64
        Behind the surface.
    """
    optical = optical + np.pad(turn, ((0, 0), (0, 1)))
    along = optical - (normal * optical).sum(axis=1, keepdims=True) * normal
    ahead = np.sqrt(index**2 - (along * along).sum(axis=1, keepdims=True))
    return np.asarray((along + ahead * normal) / index)
