"""Absorption, emission and scattering of media along a straight line in one body, or in air.

A line is divided at the bounds of media and of voxel cells. Along a step between these the sum of all coefficients is
constant, or a cubic polynomial (trilinear along a line), so two-point Gauss quadrature integrates the optical depth
exactly. Transmittance has no noise and no bias, in shadow rays too, without majorants or null collisions.

The emission of a step, ∫ j exp(−τ) dt, is exact for constant coefficients. Otherwise it is evaluated at the two points,
in steps of optical depth up to `THIN`. Its error in a step of length h is at most h⁵ / 4320 times the largest fourth
derivative of the integrand; it falls with the fourth power of the voxel size.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.ray import Ray as Ray
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.events.bounds import cell_end, own_ray, span
from lfmesh.transport.events.moving import mover_of_medium, ray_between
from lfmesh.transport.packets.book import LOST_OUTSIDE, LOST_STUCK
from lfmesh.transport.packets.random import uniform
from lfmesh.transport.tables.volumes import BY_TEMPERATURE, OF_BODY, OF_VOXELS, Volumes

Array = NDArray[np.float64]

LOW, HIGH = 0.5 - np.sqrt(3.0) / 6.0, 0.5 + np.sqrt(3.0) / 6.0
"""Points of two-point Gauss quadrature in [0, 1], of equal weight."""

THIN = 0.5
"""Largest optical depth of a step with varying coefficients."""

CLEAR_DEPTH = 1e-17
"""Optical depth below which float64 loses no light."""

OPAQUE_DEPTH = 700.0
"""Optical depth beyond which no light is left in float64."""

MOST_STEPS = 1_000_000
"""Largest number of steps on a line; light that needs more is lost."""

STEP = 1
"""Dimension of the random number that draws the step with the scattering point."""


class Passage(NamedTuple):
    """Results of a line through media.

    Attributes
    ----------
    transmittance : float
    light : float
        Emission arriving at the line's start, W/(m² sr).
    scattered : float
        Share of the light scattered on the line.
    begin, length : float, mm
        A step, drawn by the share scattered there.
    extinction : float
        Mean extinction coefficient of the step, 1/mm.
    before : float
        Transmittance up to the step.
    chance : float
        Probability of the step: its share of `scattered`.
    first, last : float, mm
        Range of distances with scattering.
    densest : float
        Largest product of transmittance and scattering coefficient over the steps, 1/mm.
    """

    transmittance: float
    light: float
    scattered: float
    begin: float
    length: float
    extinction: float
    before: float
    chance: float
    first: float
    last: float
    densest: float


class Line(NamedTuple):
    """A ray in one body, or in air, at one wavelength.

    Attributes
    ----------
    ray : Ray
        In the frame of the mover.
    place : int
        Rank of the body of glass or liquid around it; 0: air.
    colour : int
        Number of the wavelength.
    moving : Moving or None
    mover : int
        Mover in whose frame the ray is given; 0: the object frame.
    """

    ray: Ray
    place: int
    colour: int
    moving: Any
    mover: int


@inlined
def ray_in_medium(volumes: Volumes, number: int, line: Line) -> Ray:
    """Return the ray of a line in a medium's own frame.

    Parameters
    ----------
    volumes : Volumes
    number : int
        Row of the medium.
    line : Line
    """
    ray = ray_between(line.moving, line.mover, mover_of_medium(line.moving, number), line.ray)
    return own_ray(volumes.rows[number], ray)


class Step(NamedTuple):
    """Part of a line with the same media throughout.

    Attributes
    ----------
    begin, end, middle : float, mm
        Distances.
    active : int
        Number of its media.
    only : int
        The last of them.
    """

    begin: float
    end: float
    middle: float
    active: int
    only: int


@inlined
def _corner(row: Any, axis: int, p: float, middle: float) -> tuple[int, int, float]:
    """Return the two voxels along an axis with a point between their centres, and the share of the second.

    The step's middle decides the voxels, so that points at its ends do not slip into the next cell.
    """
    count = row.cells[axis]
    at = (p - row.origin[axis]) / row.spacing[axis]
    middle = (middle - row.origin[axis]) / row.spacing[axis]
    if row.constant:
        i = min(max(int(np.floor(middle + 0.5)), 0), count - 1)
        return i, i, 0.0
    i = int(np.floor(middle))
    if i < 0:
        return 0, 0, 0.0
    if i >= count - 1:
        return count - 1, count - 1, 0.0
    return i, i + 1, at - i


@kernel
def coefficients(
    volumes: Volumes, number: int, colour: int, t: float, middle: float, ray: Ray
) -> tuple[float, float, float]:
    """Return absorption and scattering, 1/mm, and emission, W/(m² sr mm), of a medium on a ray.

    Parameters
    ----------
    volumes : Volumes
    number : int
        Number of the medium.
    colour : int
    t, middle : float, mm
        Distance of the point, and of the middle of the step through the cell.
    ray : Ray
        In the medium's own frame.
    """
    row = volumes.rows[number]
    absorbs, scatters = volumes.absorption[number, colour], volumes.scattering[number, colour]
    emits, temperature = volumes.emission[number, colour], 0.0
    if row.cells[0] > 0:
        i0, i1, u = _corner(row, 0, ray.x + t * ray.dx, ray.x + middle * ray.dx)
        j0, j1, v = _corner(row, 1, ray.y + t * ray.dy, ray.y + middle * ray.dy)
        k0, k1, w = _corner(row, 2, ray.z + t * ray.dz, ray.z + middle * ray.dz)
        ny, nz = row.cells[1], row.cells[2]
        a, b, c, d = (i0 * ny + j0) * nz, (i0 * ny + j1) * nz, (i1 * ny + j0) * nz, (i1 * ny + j1) * nz
        places = (a + k0, a + k1, b + k0, b + k1, c + k0, c + k1, d + k0, d + k1)
        if row.absorption >= 0:
            absorbs *= _trilinear(volumes.values, row.absorption, places, u, v, w)
        if row.scattering >= 0:
            scatters *= _trilinear(volumes.values, row.scattering, places, u, v, w)
        if row.emission >= 0:
            value = _trilinear(volumes.values, row.emission, places, u, v, w)
            if row.emits == OF_VOXELS:
                emits *= value
            else:
                temperature = value
    if row.emits == BY_TEMPERATURE:
        if temperature > 0.0:
            emits *= absorbs * volumes.planck[0, colour] / np.expm1(volumes.planck[1, colour] / temperature)
        else:
            emits = 0.0
    elif row.emits == OF_BODY:
        emits *= absorbs
    return absorbs, scatters, emits


@inlined
def _trilinear(values: Array, first: int, places: Any, u: float, v: float, w: float) -> float:
    a = values[first + places[0]] * (1.0 - w) + values[first + places[1]] * w
    b = values[first + places[2]] * (1.0 - w) + values[first + places[3]] * w
    c = values[first + places[4]] * (1.0 - w) + values[first + places[5]] * w
    d = values[first + places[6]] * (1.0 - w) + values[first + places[7]] * w
    low = a * (1.0 - v) + b * v
    return low * (1.0 - u) + (c * (1.0 - v) + d * v) * u


@kernel
def pass_through(
    volumes: Volumes, line: Line, reach: float, book: Array, weight: float, key: np.uint64
) -> Passage:  # fmt: skip
    """Follow a line through all media of one body, or of air, and enter their absorption in the book.

    Parameters
    ----------
    volumes : Volumes
    line : Line
    reach : float, mm
        Length of the line; may be inf.
    book : (slots,) float64
    weight : float
        Of the packet, for the book; 0: nothing is entered.
    key : uint64
        For the random numbers that draw the step with the scattering point.
    """
    rows, colour = volumes.rows, line.colour
    t, left, light, scattered = 0.0, 1.0, 0.0, 0.0
    begin, length, mean, before, own = 0.0, 0.0, 0.0, 0.0, 0.0
    scatters_from, scatters_to, densest = 0.0, 0.0, 0.0
    choice = uniform(key, STEP) if volumes.scatters else 0.0
    # The ray in the frame of one medium, mostly the only one, and its span in that medium.
    known, ray, first, last, holds = -1, line.ray, 0.0, 0.0, np.inf
    steps = 0
    while t < reach and left > 0.0:
        steps += 1
        if steps > MOST_STEPS:
            book[LOST_STUCK] += weight * left
            book[LOST_OUTSIDE] += weight * left
            left = 0.0
            break
        until, active, only, grids = reach, 0, -1, 0
        for number in range(len(rows)):
            if rows[number].inside != line.place:
                continue
            if number != known or holds <= t:
                known, ray = number, ray_in_medium(volumes, number, line)
                first, last, holds = span(volumes.shells, rows[number], ray, t)
            until = min(until, holds)
            if last <= t or first >= last:
                continue
            if first > t:
                until = min(until, first)
                continue
            active += 1
            only = number
            until = min(until, last)
            if rows[number].cells[0] > 0:
                grids += 0 if rows[number].constant else 1
                until = min(until, cell_end(rows[number], t, ray))
        if active == 0:
            t = until
            continue
        pieces, piece, from_t, size = 1, 0, t, until - t
        while piece < pieces:
            step = size / pieces
            # An infinite step is a single piece, and 0 · inf is NaN.
            a = from_t + piece * step if piece > 0 else from_t
            middle = 0.5 * (t + until) if until < np.inf else t
            low_t, high_t = (a + LOW * step, a + HIGH * step) if grids > 0 else (middle, middle)
            e1, e2, k1, k2, s1, s2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for number in range(len(rows)):
                if rows[number].inside != line.place or (active == 1 and number != only):
                    continue
                if number != known:
                    known, ray = number, ray_in_medium(volumes, number, line)
                    first, last, holds = span(volumes.shells, rows[number], ray, t)
                if not (first <= t and last >= until and first < last):
                    continue
                ka, ks, j = coefficients(volumes, number, colour, low_t, middle, ray)
                e1, k1, s1 = e1 + j, k1 + ka + ks, s1 + ks
                if grids > 0:
                    ka, ks, j = coefficients(volumes, number, colour, high_t, middle, ray)
                e2, k2, s2 = e2 + j, k2 + ka + ks, s2 + ks
            extinction = 0.5 * (k1 + k2)
            depth = extinction * step if extinction > 0.0 else 0.0
            if grids > 0 and depth > THIN and pieces == 1:
                pieces = int(np.ceil(min(depth, OPAQUE_DEPTH) / THIN))
                continue
            passed = np.exp(-depth)
            stopped = -np.expm1(-depth)
            if e1 > 0.0 or e2 > 0.0:
                light += left * _emitted(e1, e2, k1, k2, step, depth, stopped)
            if depth > 0.0:
                share = 0.5 * (s1 + s2) / extinction * stopped * left
                if share > 0.0:
                    if scattered == 0.0:
                        scatters_from = a
                    scatters_to = a + step
                    densest = max(densest, left * max(s1, s2))
                    scattered += share
                    chance = share / scattered
                    # Reservoir sampling with a single random number; its remainder is used again.
                    if choice < chance:
                        choice /= chance
                        begin, length, mean, before, own = a, step, extinction, left, share
                    else:
                        choice = (choice - chance) / (1.0 - chance)
                if weight > 0.0:
                    _enter_absorbed(
                        volumes, line, Step(t, until, middle, active, only), book, weight * stopped * left,
                        extinction - 0.5 * (s1 + s2), extinction,
                    )  # fmt: skip
                left *= passed
            piece += 1
        t = until
    chance = own / scattered if scattered > 0.0 else 0.0
    return Passage(left, light, scattered, begin, length, mean, before, chance, scatters_from, scatters_to, densest)


@inlined
def _emitted(e1: float, e2: float, k1: float, k2: float, step: float, depth: float, stopped: float) -> float:
    """Return the emission of a step at its begin, from its coefficients at two points."""
    if depth < CLEAR_DEPTH:
        return 0.5 * (e1 + e2) * step
    if e1 == e2 and k1 == k2:
        return e1 / k1 * stopped
    tilt = (k2 - k1) / (HIGH - LOW) * step / 12.0
    # Scaled so that constant mean coefficients give the exact integral, which the two points underestimate.
    exact = stopped / depth / (0.5 * (np.exp(-LOW * depth) + np.exp(-HIGH * depth)))
    return 0.5 * step * exact * (e1 * np.exp(tilt - LOW * depth) + e2 * np.exp(tilt - HIGH * depth))


@kernel
def _enter_absorbed(
    volumes: Volumes, line: Line, step: Step, book: Array, stopped: float, absorption: float, extinction: float
) -> None:  # fmt: skip
    """Enter the absorption of a step in the book, divided among media by their coefficients in its middle."""
    rows = volumes.rows
    absorbed = stopped * max(absorption, 0.0) / extinction
    if step.active == 1:
        book[rows[step.only].slot] += absorbed
        return
    total, last = 0.0, -1
    for number in range(len(rows)):
        takes, ka = _absorbed_in(volumes, line, number, step)
        if takes:
            total += ka
            last = number
    for number in range(len(rows)):
        takes, ka = _absorbed_in(volumes, line, number, step)
        if takes and total > 0.0:
            book[rows[number].slot] += absorbed * ka / total
        elif takes and number == last:
            book[rows[number].slot] += absorbed


@kernel
def _absorbed_in(volumes: Volumes, line: Line, number: int, step: Step) -> tuple[bool, float]:
    """Return whether a medium extends along a whole step, and its absorption in the middle, 1/mm."""
    row = volumes.rows[number]
    if row.inside != line.place:
        return False, 0.0
    ray = ray_in_medium(volumes, number, line)
    first, last, _ = span(volumes.shells, row, ray, step.middle)
    if not (first <= step.begin and last >= step.end and first < last):
        return False, 0.0
    return True, coefficients(volumes, number, line.colour, step.middle, step.middle, ray)[0]
