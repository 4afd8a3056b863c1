"""Light on its way through media: what they absorb, emit and scatter along a straight line in one body, or in air.

A line is divided where it enters or leaves a medium and where it crosses from one voxel cell into the next. Along a
step between two such places the sum of all coefficients is constant, or a cubic polynomial (trilinear along a line), of
which two points of Gauss's quadrature integrate the optical depth exactly. So transmittance has no noise and no bias,
in shadow rays too, and neither majorants nor null collisions are needed.

The emission of a step, ∫ j exp(−τ) dt, is exact where the coefficients are constant. Elsewhere it is taken at the two
points, in steps of optical depth up to `THIN`: its error in a step of length h is at most h⁵ / 4320 times the largest
fourth derivative of the integrand, so that it falls with the fourth power of the voxels' size.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.frame import direction_through, point_through
from lfmesh.geometry.meshes.shell_tree import next_crossing
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.packets.book import LOST_OUTSIDE, LOST_STUCK
from lfmesh.transport.packets.random import uniform
from lfmesh.transport.tables.volumes import (
    BOX,
    BY_TEMPERATURE,
    CYLINDER,
    IN_FRONT,
    OF_BODY,
    OF_VOXELS,
    SHELL,
    Volumes,
)

Array = NDArray[np.float64]

LOW, HIGH = 0.5 - np.sqrt(3.0) / 6.0, 0.5 + np.sqrt(3.0) / 6.0
"""Points of Gauss's quadrature in [0, 1], of equal weight."""

THIN = 0.5
"""Largest optical depth of a step in which coefficients vary."""

OPAQUE_DEPTH = 700.0
"""Optical depth beyond which float64 has no light left."""

MOST_STEPS = 1_000_000
"""Largest number of steps on a line; light that needs more is lost."""

PLACE, STEP, WHICH = 0, 1, 2
"""Dimensions of a scattering point's random numbers: its place in a step, the step, and the medium."""


class Passage(NamedTuple):
    """A line through media.

    Attributes
    ----------
    transmittance : float
    light : float
        Emission that arrives at the line's start, W/(m² sr).
    scattered : float
        Share of the light that is scattered on the line.
    begin, length : float, mm
        Of a step, drawn by the share that is scattered there.
    extinction : float
        Mean coefficient of the step, 1/mm.
    before : float
        Transmittance up to the step.
    chance : float
        Share of `scattered` with which the step was drawn.
    first, last : float, mm
        Between these distances light is scattered.
    densest : float
        Largest share of the light that is scattered per length at the begin of a step, 1/mm.
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


class ScatteringPoint(NamedTuple):
    """A point of a line at which light is scattered.

    Attributes
    ----------
    t : float, mm
        Its distance.
    share : float
        Of the light that set out, which is scattered there; its mean is `Passage.scattered`.
    density : float
        Of the light that is scattered there, over that which set out, 1/mm.
    medium : int
        Number of the medium.
    """

    t: float
    share: float
    density: float
    medium: int


class Ray(NamedTuple):
    """A ray in the object frame or in a medium's own, mm; the direction is a unit vector."""

    x: float
    y: float
    z: float
    dx: float
    dy: float
    dz: float


class Line(NamedTuple):
    """A ray in one body, or in air, at one wavelength.

    Attributes
    ----------
    ray : Ray
        In the object frame.
    place : int
        Rank of the body of glass or liquid that it is in; 0: air.
    colour : int
        Number of the wavelength.
    """

    ray: Ray
    place: int
    colour: int


class Step(NamedTuple):
    """A part of a line along which the same media reach.

    Attributes
    ----------
    begin, end, middle : float, mm
        Distances.
    active : int
        Number of media.
    only : int
        The last of them.
    """

    begin: float
    end: float
    middle: float
    active: int
    only: int


@inlined
def ray_of(packet: Any) -> Ray:
    """Return the ray of a packet.

    Parameters
    ----------
    packet : PACKET
    """
    return Ray(packet.x, packet.y, packet.z, packet.dx, packet.dy, packet.dz)


@inlined
def along(ray: Ray, t: float) -> tuple[float, float, float]:
    """Return the point at a distance on a ray, mm.

    Parameters
    ----------
    ray : Ray
    t : float, mm
    """
    return ray.x + t * ray.dx, ray.y + t * ray.dy, ray.z + t * ray.dz


@inlined
def own_ray(row: Any, ray: Ray) -> Ray:
    """Return a ray of the object frame in the own frame of a medium.

    Parameters
    ----------
    row : VOLUME
    ray : Ray
    """
    x, y, z = point_through(row.to_own, ray.x, ray.y, ray.z)
    dx, dy, dz = direction_through(row.to_own, ray.dx, ray.dy, ray.dz)
    return Ray(x, y, z, dx, dy, dz)


@inlined
def slab(low: float, high: float, o: float, d: float) -> tuple[float, float]:
    """Return the distances between which a ray is between two planes of a coordinate.

    Parameters
    ----------
    low, high : float
        The planes.
    o, d : float
        Start and direction of the ray.
    """
    if d == 0.0:
        return (-np.inf, np.inf) if low <= o <= high else (np.inf, -np.inf)
    a, b = (low - o) / d, (high - o) / d
    return (a, b) if a <= b else (b, a)


@kernel
def span(shells: Any, row: Any, ray: Ray, t: float) -> tuple[float, float, float]:
    """Return the distances between which a ray, in the own frame, is in a medium, as they are seen from one distance.

    Parameters
    ----------
    shells : ShellTree or None
        None: no mesh bounds a medium, and numba compiles nothing for it.
    row : VOLUME
    ray : Ray
    t : float, mm

    Returns
    -------
    first, last : float, mm
        The first is larger if the ray is never in it.
    holds : float, mm
        Distance beyond t up to which this is so: the next crossing of a mesh, else inf.
    """
    holds = np.inf
    if shells is not None:
        inside = True
        if row.bounds == SHELL:
            inside, holds = next_crossing(
                shells, row.nodes[0], row.nodes[1], t, ray.x, ray.y, ray.z, ray.dx, ray.dy, ray.dz
            )
        if not inside:
            return np.inf, -np.inf, holds
    first, last = _span(row, ray)
    return first, last, holds


@kernel
def _span(row: Any, ray: Ray) -> tuple[float, float]:
    """Return the distances between which a ray is in the bounds of a medium, but for those of a mesh, and its grid."""
    x, y, z, dx, dy, dz = ray
    first, last = -np.inf, np.inf
    if row.bounds == IN_FRONT:
        return slab(-np.inf, 0.0, z, dz) if dz != 0.0 or z < 0.0 else (np.inf, -np.inf)
    if row.bounds == BOX:
        for axis in range(3):
            o, d = (x, y, z)[axis], (dx, dy, dz)[axis]
            a, b = slab(-row.size[axis], row.size[axis], o, d)
            first, last = max(first, a), min(last, b)
    elif row.bounds != SHELL:
        cut = 0.0 if row.bounds == CYLINDER else 1.0
        a = dx * dx + dy * dy + cut * dz * dz
        middle = -(x * dx + y * dy + cut * z * dz)
        radius2 = row.size[0] * row.size[0]
        if a > 0.0:
            # The discriminant by the distance of the ray from the axis: far starts lose no digits.
            s = middle / a
            px, py, pz = x + s * dx, y + s * dy, cut * (z + s * dz)
            rest = radius2 - (px * px + py * py + pz * pz)
            if rest <= 0.0:
                return np.inf, -np.inf
            half = np.sqrt(rest / a)
            first, last = s - half, s + half
        elif x * x + y * y > radius2:
            return np.inf, -np.inf
        if row.bounds == CYLINDER:
            c, d = slab(-row.size[2], row.size[2], z, dz)
            first, last = max(first, c), min(last, d)
    if row.cells[0] > 0:
        for axis in range(3):
            o, d = (x, y, z)[axis], (dx, dy, dz)[axis]
            a, b = slab(row.low[axis], row.high[axis], o, d)
            first, last = max(first, a), min(last, b)
    return first, last


@kernel
def cell_end(row: Any, t: float, ray: Ray) -> float:
    """Return the distance, beyond t, at which a ray leaves the present cell of a medium's grid.

    Cells of a trilinear grid have the centres of eight voxels as corners.

    Parameters
    ----------
    row : VOLUME
    t : float, mm
    ray : Ray
    """
    x, y, z, dx, dy, dz = ray
    shift = 0.5 if row.constant else 0.0
    nearest = np.inf
    for axis in range(3):
        o, d = (x, y, z)[axis], (dx, dy, dz)[axis]
        if d == 0.0:
            continue
        o, d = (o - row.origin[axis]) / row.spacing[axis] + shift, d / row.spacing[axis]
        plane = np.floor(o + t * d) + (1.0 if d > 0.0 else 0.0)
        ends = (plane - o) / d
        if ends <= t:
            # The ray is on this plane, to rounding, or has just passed it.
            plane += 1.0 if d > 0.0 else -1.0
            ends = (plane - o) / d
        if ends > t:
            nearest = min(nearest, ends)
    return nearest


@inlined
def _corner(row: Any, axis: int, p: float, middle: float) -> tuple[int, int, float]:
    """Return the two voxels along an axis between whose centres a point lies, and the share of the second.

    Which ones, the middle of the step decides, so that points at its ends do not slip into the next cell.
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
        Of the medium.
    colour : int
        Number of the wavelength.
    t, middle : float, mm
        Distance, and that of the middle of the step through a cell.
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
    """Follow a line through all media of one body, or of air, and enter in the book what each absorbs.

    Parameters
    ----------
    volumes : Volumes
    line : Line
    reach : float, mm
        Its length; may be inf.
    book : (slots,) float64
    weight : float
        Of the packet, for the book; 0: nothing is entered.
    key : uint64
        Of the random numbers by which a step is drawn in which light is scattered.
    """
    rows, colour = volumes.rows, line.colour
    t, left, light, scattered = 0.0, 1.0, 0.0, 0.0
    begin, length, mean, before, own = 0.0, 0.0, 0.0, 0.0, 0.0
    scatters_from, scatters_to, densest = 0.0, 0.0, 0.0
    choice = uniform(key, STEP) if volumes.scatters else 0.0
    # The ray in the frame of one of the media, mostly the only one, and where it is in it.
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
                known, ray = number, own_ray(rows[number], line.ray)
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
            # A step without an end is a single piece, and 0 · inf is no number.
            a = from_t + piece * step if piece > 0 else from_t
            middle = 0.5 * (t + until) if until < np.inf else t
            low_t, high_t = (a + LOW * step, a + HIGH * step) if grids > 0 else (middle, middle)
            e1, e2, k1, k2, s1, s2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for number in range(len(rows)):
                if rows[number].inside != line.place or (active == 1 and number != only):
                    continue
                if number != known:
                    known, ray = number, own_ray(rows[number], line.ray)
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
                    # Reservoir sampling with a single random number, of which what is left is used again.
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
    """Return the emission of a step that leaves it at its begin, from its coefficients at two points."""
    if e1 == e2 and k1 == k2:
        return e1 / k1 * stopped if k1 > 0.0 else e1 * step
    tilt = (k2 - k1) / (HIGH - LOW) * step / 12.0
    if depth <= 0.0:
        return 0.5 * (e1 + e2) * step
    # As for constant coefficients in the mean, where the two points are short of the exact integral.
    exact = stopped / depth / (0.5 * (np.exp(-LOW * depth) + np.exp(-HIGH * depth)))
    return 0.5 * step * exact * (e1 * np.exp(tilt - LOW * depth) + e2 * np.exp(tilt - HIGH * depth))


@kernel
def _enter_absorbed(
    volumes: Volumes, line: Line, step: Step, book: Array, stopped: float, absorption: float, extinction: float
) -> None:  # fmt: skip
    """Enter in the book what media absorb of the light that a step stops, each by its share in the step's middle."""
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
    """Tell whether a medium reaches all along a step, and return its absorption in the middle, 1/mm."""
    row = volumes.rows[number]
    if row.inside != line.place:
        return False, 0.0
    ray = own_ray(row, line.ray)
    first, last, _ = span(volumes.shells, row, ray, step.middle)
    if not (first <= step.begin and last >= step.end and first < last):
        return False, 0.0
    return True, coefficients(volumes, number, line.colour, step.middle, step.middle, ray)[0]


@kernel
def scattering_point(volumes: Volumes, line: Line, passage: Passage, key: np.uint64) -> ScatteringPoint:
    """Return a random point of a line at which light is scattered.

    Parameters
    ----------
    volumes : Volumes
    line : Line
    passage : Passage
        Of the line, of which some light is scattered.
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
        ray = own_ray(volumes.rows[number], line.ray)
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
    choice, which = uniform(key, WHICH) * total, 0
    for number in range(len(volumes.rows)):
        ray = own_ray(volumes.rows[number], line.ray)
        first, last, _ = span(volumes.shells, volumes.rows[number], ray, middle)
        if volumes.rows[number].inside != line.place or not first <= middle <= last:
            continue
        ks = coefficients(volumes, number, line.colour, t, middle, ray)[1]
        if ks > 0.0 and choice >= 0.0:
            which = number
        choice -= ks
    return ScatteringPoint(t, share, density, which)


@kernel
def scattered_at(volumes: Volumes, line: Line, t: float, book: Array, key: np.uint64) -> tuple[float, int]:
    """Return the light that is scattered at a distance on a line, over that which set out, 1/mm, and a random medium.

    Parameters
    ----------
    volumes : Volumes
    line : Line
    t : float, mm
        Less than the line's length.
    book : (slots,) float64
        Nothing is entered.
    key : uint64
        As in `pass_through`.
    """
    total = 0.0
    for number in range(len(volumes.rows)):
        total += _scattering_at(volumes, line, number, t)
    if total <= 0.0:
        return 0.0, 0
    choice, which = uniform(key, WHICH) * total, 0
    for number in range(len(volumes.rows)):
        ks = _scattering_at(volumes, line, number, t)
        if ks > 0.0 and choice >= 0.0:
            which = number
        choice -= ks
    return pass_through(volumes, line, t, book, 0.0, key).transmittance * total, which


@kernel
def _scattering_at(volumes: Volumes, line: Line, number: int, t: float) -> float:
    """Return the scattering coefficient of a medium at a distance on a line, 1/mm; 0 outside of it."""
    row = volumes.rows[number]
    if row.inside != line.place:
        return 0.0
    ray = own_ray(row, line.ray)
    first, last, _ = span(volumes.shells, row, ray, t)
    return coefficients(volumes, number, line.colour, t, t, ray)[1] if first <= t <= last else 0.0
