"""Lens's opening (effective pupil) as seen from points on either side, found by real rays.

From a table of points, rays are traced through the exact surfaces of the lens. A disk in the lens's outermost plane
bounds the rays that get through at any wavelength of the scene, with vignetting and pupil aberrations. By rotational
symmetry, a point is given by its distance from that plane and the tangent of its field angle or, close to the plane,
its height over the axis.

Points, spokes and wavelengths are samples. They decide only the directions of rays, never the amount of light: some
rays go beside the opening, and rays from the stop prove or widen it (`transport/checks/aim_proof.py`).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.aims.disk import Vector
from lfmesh.transport.aims.disks import covering, disk_at, no_disks
from lfmesh.transport.aims.near_points import NearViewpoints, near_disks
from lfmesh.transport.sequences.bundle import (
    BLOCK,
    DROPPED,
    DX,
    DY,
    DZ,
    ENDED_ON,
    ROWS,
    X,
    Y,
    Z,
    empty_bundle,
    load,
    pad,
)
from lfmesh.transport.sequences.lens_surfaces import at_surface
from lfmesh.transport.sequences.ray_tables import unread_book
from lfmesh.transport.tables.gradient_spaces import without_edges
from lfmesh.transport.tables.phase_faces import weighing
from lfmesh.transport.tables.tables import Disks, LensTables, Opening

Array = NDArray[np.float64]

_OBSTRUCTION = ROWS * BLOCK
"""Row beyond those of a bundle: closest approach of a ray to the edge of an aperture."""

ANGLES = 33
"""Number of field angles at which the opening is measured, evenly spaced in their tangent."""

DISTANCES = 6
"""Number of distances at which it is measured unless all points lie in one plane, evenly spaced in their inverse."""

DISTANCES_TO_NEAR = 24
"""The same if some points lie close before the lens."""

SEARCH = 49
"""Number of rays along the meridian of the outermost plane that start the search for the opening."""

CLOSE_UP = np.ldexp(1.0, -np.arange(4, 28))
"""Further trial rays: distances from the opening of first-order optics, in radii of the wide disk."""

NARROWINGS = 44
"""Golden-section steps of the search for the clearest ray, which narrow its interval to a billionth."""

SLOPES = np.tan(np.radians(np.linspace(-85.0, 85.0, 35)))
"""Slopes of further trial rays from points close before the lens."""

GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)

SPOKES = 20
"""Number of directions in the half-plane about the clearest ray in which the opening's edge is measured."""

OUTERMOST = 40
"""Largest number of halvings of a spoke, inwards from beyond the lens, until a ray on it gets through."""

HALVINGS = 7
"""Bisections of the interval that then holds the edge, to a hundredth of the opening."""

PARAXIAL_MARGIN = 1.15
"""Factor on the paraxial pupil's radius, for pupil aberrations, if real rays cannot be traced."""

MARGIN = 1.02
"""Factor on the measured radius, for light between the measured points, spokes and wavelengths."""


class Viewpoints(NamedTuple):
    """Grid of viewpoints of one side of the lens, by field angle and distance.

    Attributes
    ----------
    plane_z : float, mm
        The lens's outermost plane on that side, camera frame.
    wide_radius : float, mm
        Radius of the disk in that plane that every ray to the lens crosses.
    to_sensor : bool
        Rays from the points travel towards the sensor; else towards the objects.
    tangent : (m,) float64
        Tangents of the field angles, from 0, evenly spaced.
    distance : (n,) float64, mm
        Distances from the plane, far to near, evenly spaced in their inverse.
    """

    plane_z: float
    wide_radius: float
    to_sensor: bool
    tangent: Array
    distance: Array


def viewpoints(
    plane_z: float, wide_radius: float, points: Array, *, to_sensor: bool, near: NearViewpoints | None = None
) -> Viewpoints | None:
    """Return the grid of viewpoints that covers points; None if none lies before the lens.

    Parameters
    ----------
    plane_z, wide_radius, to_sensor
        See `Viewpoints`.
    points : (n, 3) float64, mm, camera frame
    near : NearViewpoints, optional
        Points close before the lens, which have their own table.
    """
    distance = (plane_z - points[:, 2]) * (1.0 if to_sensor else -1.0)
    before = distance > 1e-6 * wide_radius if near is None else distance >= near.depth
    distance = distance[before]
    tangent = np.hypot(points[before, 0], points[before, 1]) / distance
    steps = DISTANCES
    if near is not None and (near.extends_beyond or not len(distance)):
        # Shapes that reach up to the near points begin where these end.
        distance, tangent = np.append(distance, near.depth), np.append(tangent, near.height[-1] / near.depth)
        steps = DISTANCES_TO_NEAR
    if not len(distance):
        return None
    nearest, farthest = float(distance.min()), float(distance.max())
    # One distance is enough if all points lie in one plane.
    many = steps if farthest - nearest > 1e-9 * farthest else 1
    inverse = np.linspace(1.0 / farthest, 1.0 / nearest, many)
    # If all points lie on the axis, the table still needs a width.
    widest = float(tangent.max()) or 1.0
    return Viewpoints(plane_z, wide_radius, to_sensor, np.linspace(0.0, widest, ANGLES), 1.0 / inverse)


def closed_opening(plane_z: float, *, to_sensor: bool, near_depth: float = 0.0) -> Opening:
    """Return an opening that no point sees.

    Parameters
    ----------
    plane_z : float, mm, camera frame
        The lens's outermost plane.
    to_sensor : bool
        It is seen from object space.
    near_depth : float, mm
        From points closer than this, half of the rays go everywhere towards the lens.
    """
    return Opening(plane_z, 1.0 if to_sensor else -1.0, no_disks(), near_depth, no_disks())


def paraxial_opening(seen: Viewpoints, pupil_z: float, pupil_radius: float) -> Opening:
    """Return the first-order pupil, projected from viewpoints into the outermost plane, with a margin.

    It is never wider than the disk that every ray to the lens crosses.

    Parameters
    ----------
    seen : Viewpoints
    pupil_z, pupil_radius : float, mm
        Camera frame.
    """
    return _opening(seen, *_paraxial_disks(seen, *_places(seen), pupil_z, pupil_radius))


def paraxial_near(seen: Viewpoints, near: NearViewpoints, pupil_z: float, pupil_radius: float) -> Disks:
    """Return the first-order pupil seen from close points.

    Parameters
    ----------
    seen : Viewpoints
        Viewpoints of the lens's outermost plane.
    near : NearViewpoints
    pupil_z, pupil_radius : float, mm
        Camera frame.
    """
    return near_disks(near, *_paraxial_disks(seen, *np.meshgrid(near.height, near.measured), pupil_z, pupil_radius))


def _places(seen: Viewpoints) -> tuple[Array, Array]:
    """Return height and distance of every viewpoint, (n, m) mm."""
    return np.outer(seen.distance, seen.tangent), np.repeat(seen.distance[:, None], len(seen.tangent), axis=1)


def _paraxial_disks(
    seen: Viewpoints, height: Array, distance: Array, pupil_z: float, pupil_radius: float
) -> tuple[Array, Array]:
    """Return centre (along the meridian) and radius of the paraxial pupil, mm, by height and distance."""
    depth = (pupil_z - seen.plane_z) * (1.0 if seen.to_sensor else -1.0)
    with np.errstate(divide="ignore"):
        share = distance / (distance + depth)
    radius = np.abs(PARAXIAL_MARGIN * pupil_radius * share)
    fits = radius < seen.wide_radius
    middle = np.where(fits, height * (1.0 - np.where(fits, share, 0.0)), 0.0)
    return middle, np.where(fits, radius, seen.wide_radius)


def real_opening(seen: Viewpoints, lens: LensTables, pupil_z: float, pupil_radius: float) -> Opening:
    """Return the opening of the lens's exact surfaces for real rays of any wavelength.

    The table omits field angles beyond which no light gets through.

    Parameters
    ----------
    seen : Viewpoints
    lens : LensTables
    pupil_z, pupil_radius : float, mm
        Paraxial pupil: start of the search, and the result if real rays cannot decide.
    """
    middle, radius = _measured(seen, lens, *_places(seen), pupil_z, pupil_radius)
    open_columns = np.flatnonzero((radius > 0.0).any(axis=0))
    if not len(open_columns):
        return paraxial_opening(seen, pupil_z, pupil_radius)
    last = min(int(open_columns[-1]) + 1, ANGLES - 1)
    if last < ANGLES - 1:
        seen = seen._replace(tangent=np.linspace(0.0, seen.tangent[last], ANGLES))
        middle, radius = _measured(seen, lens, *_places(seen), pupil_z, pupil_radius)
    return _opening(seen, middle, radius)


def real_near(
    seen: Viewpoints, near: NearViewpoints, lens: LensTables, pupil_z: float, pupil_radius: float
) -> tuple[NearViewpoints, Disks | None]:
    """Return the opening of real rays from close points; None if it is closed to all.

    The table and the returned viewpoints omit heights beyond which no light gets through.

    Parameters
    ----------
    seen : Viewpoints
        Gives plane and side; trial rays go to its wide disk.
    near : NearViewpoints
    lens, pupil_z, pupil_radius
        As for `real_opening`.
    """
    while True:
        places = np.meshgrid(near.height, near.measured)
        middle, radius = _measured(seen, lens, *places, pupil_z, pupil_radius, SLOPES)
        open_columns = np.flatnonzero((radius > 0.0).any(axis=0))
        if not len(open_columns):
            return near, None
        last = int(open_columns[-1]) + 1
        if last > len(near.height) // 2:
            return near, near_disks(near, middle, radius)
        near = near._replace(height=np.linspace(0.0, near.height[last], len(near.height)))


def _measured(
    seen: Viewpoints, lens: LensTables, heights: Array, distances: Array, pupil_z: float, pupil_radius: float,
    slopes: Array | None = None,
) -> tuple[Array, Array]:  # fmt: skip
    """Return the opening's centre (along the meridian) and radius from viewpoints, (n, m) mm; −1: closed.

    Parameters
    ----------
    heights, distances : (n, m) float64, mm
    slopes : (k,) float64, optional
        Slopes of further trial rays from each viewpoint.
    """
    height, distance = heights.ravel(), distances.ravel()
    paraxial = _paraxial_disks(seen, heights, distances, pupil_z, pupil_radius)
    paraxial_middle, paraxial_radius = (disks.ravel() for disks in paraxial)
    further = np.zeros((len(height), 0)) if slopes is None else height[:, None] + distance[:, None] * slopes
    start, obstruction, decided = _clearest_ray(seen, lens, height, distance, paraxial_middle, further)
    is_open = obstruction < 1.0
    edge = np.zeros((len(height), SPOKES))
    edge[is_open] = _edge(seen, lens, height[is_open], distance[is_open], start[is_open])
    angle = np.linspace(0.0, np.pi, SPOKES)
    px, py = start[:, None] + edge * np.cos(angle), edge * np.sin(angle)
    # The smallest disk with its centre on the meridian, found to a hundredth of the opening's extent.
    low, high = px.min(axis=1), px.max(axis=1)
    trial = low + np.linspace(0.0, 1.0, 101)[:, None] * (high - low)
    reach = np.sqrt(((px[None] - trial[..., None]) ** 2 + py[None] ** 2).max(axis=2))
    best = reach.argmin(axis=0)
    points = np.arange(len(height))
    # If real rays fail and so cannot decide, first-order optics gives the opening.
    closed_radius = np.where(decided, -1.0, paraxial_radius)
    radius = np.where(is_open, MARGIN * reach[best, points], closed_radius)
    middle = np.where(is_open | decided, trial[best, points], paraxial_middle)
    return middle.reshape(heights.shape), radius.reshape(heights.shape)


def _clearest_ray(
    seen: Viewpoints, lens: LensTables, height: Array, distance: Array, expected: Array, further: Array
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Find each point's meridional ray that stays farthest from every aperture's edge.

    The obstruction (see `_obstruction`) has a single minimum, which a golden-section search finds however small the
    stop. A search for rays that get through would need the size of the opening first.

    Parameters
    ----------
    height, distance : (points,) float64, mm
    expected : (points,) float64, mm
        Centre of the opening by first-order optics.
    further : (points, n) float64, mm
        Places of further trial rays.

    Returns
    -------
    place : (points,) float64, mm
        Intersection of the ray with the outermost plane, along the meridian.
    obstruction : (points,) float64
    decided : (points,) bool
        False if the clearest ray is blocked and rays next to it fail, so that the search is inconclusive.
    """
    steps = np.concatenate([-CLOSE_UP, [0.0], CLOSE_UP]) * seen.wide_radius
    across = np.broadcast_to(np.linspace(-1.0, 1.0, SEARCH) * seen.wide_radius, (len(height), SEARCH))
    trial = np.sort(np.concatenate([across, expected[:, None] + steps, further], axis=1), axis=1)
    found = _obstruction(seen, lens, height, distance, trial, np.zeros_like(trial))
    points, last = np.arange(len(height)), trial.shape[1] - 1
    best = found.argmin(axis=1)
    before, after = np.maximum(best - 1, 0), np.minimum(best + 1, last)
    decided = np.isfinite(found[points, before]) & np.isfinite(found[points, after])
    low, high = trial[points, before], trial[points, after]

    def at(place: Array) -> Array:
        return _obstruction(seen, lens, height, distance, place[:, None], np.zeros((len(height), 1)))[:, 0]

    left, right = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
    at_left, at_right = at(left), at(right)
    for _ in range(NARROWINGS):
        lower = at_left <= at_right
        low, high = np.where(lower, low, left), np.where(lower, right, high)
        new = np.where(lower, high - GOLDEN * (high - low), low + GOLDEN * (high - low))
        at_new = at(new)
        left, right = np.where(lower, new, right), np.where(lower, left, new)
        at_left, at_right = np.where(lower, at_new, at_right), np.where(lower, at_left, at_new)
    narrowed, coarse = np.minimum(at_left, at_right), found[points, best]
    place = np.where(narrowed <= coarse, np.where(at_left <= at_right, left, right), trial[points, best])
    obstruction = np.minimum(narrowed, coarse)
    return place, obstruction, decided | (obstruction < 1.0)


def _edge(seen: Viewpoints, lens: LensTables, height: Array, distance: Array, start: Array) -> Array:
    """Return the distance from `start` to the opening's edge along each spoke, (points, SPOKES) mm."""
    angle = np.linspace(0.0, np.pi, SPOKES)

    def gets_through(reach: Array) -> NDArray[np.bool_]:
        x, y = start[:, None] + reach * np.cos(angle), reach * np.sin(angle)
        return _obstruction(seen, lens, height, distance, x, y) < 1.0

    outside = np.full((len(height), SPOKES), 4.0 * seen.wide_radius)
    inside = 0.5 * outside
    for _ in range(OUTERMOST):
        blocked = ~gets_through(inside)
        if not blocked.any():
            break
        outside = np.where(blocked, inside, outside)
        inside = np.where(blocked, 0.5 * inside, inside)
    for _ in range(HALVINGS):
        middle = 0.5 * (inside + outside)
        through = gets_through(middle)
        inside, outside = np.where(through, middle, inside), np.where(through, outside, middle)
    return outside


def _obstruction(seen: Viewpoints, lens: LensTables, height: Array, distance: Array, x: Array, y: Array) -> Array:
    """Return the obstruction of rays: the largest (r / r_max)² over all apertures and the stop, (points, rays).

    Apertures do not end the rays here; a ray gets through if its obstruction is below one. The least value over the
    wavelengths counts; inf for a ray that misses a surface or is totally reflected.

    Parameters
    ----------
    height, distance : (points,) float64, mm
    x, y : (points, rays) float64, mm
        Intersections of the rays with the outermost plane.
    """
    heights, distances = (np.broadcast_to(a[:, None], x.shape).flatten() for a in (height, distance))
    unbounded = lens.surfaces.copy()
    unbounded["semi_diameter"] = np.inf
    rims = np.ascontiguousarray(lens.surfaces["semi_diameter"])
    # Rays from behind the lens go against the light.
    interfaces = weighing(lens.interfaces, importance=not seen.to_sensor)
    room, book = empty_bundle(ROWS + 1), unread_book(lens)
    lens = lens._replace(surfaces=unbounded, interfaces=interfaces, gradients=without_edges(lens.gradients))
    least = np.full(x.size, np.inf)
    colours = lens.media.indices.shape[1]
    for colour in sorted({0, colours // 2, colours - 1}):
        _trace_unbounded(
            heights, distances, np.ascontiguousarray(x).reshape(-1), np.ascontiguousarray(y).reshape(-1), seen.plane_z,
            seen.to_sensor, lens, rims, colour, room, book, least,
        )  # fmt: skip
    return least.reshape(x.shape)


@kernel
def _trace_unbounded(
    height: Array, distance: Array, x: Array, y: Array, plane_z: float, to_sensor: bool, lens: LensTables,
    rims: Array, colour: int, bundle: Array, book: Array, least: Array,
) -> None:  # fmt: skip
    """Trace rays from points (height, 0) at a distance through points (x, y) of a plane; lower their obstruction."""
    sense = 1.0 if to_sensor else -1.0
    last = len(lens.surfaces)
    for first in range(0, len(x), BLOCK):
        count = min(BLOCK, len(x) - first)
        for i in range(count):
            dx, dy, dz = x[first + i] - height[first + i], y[first + i], distance[first + i]
            scale = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
            # Start well before the plane, as surfaces may touch it.
            back = 0.5 * distance[first + i]
            load(
                bundle, i,
                x[first + i] - back * dx / dz, y[first + i] - back * dy / dz, plane_z - back * sense,
                dx * scale, dy * scale, sense * dz * scale, 1.0,
            )  # fmt: skip
            bundle[_OBSTRUCTION + i] = 0.0
        if count < BLOCK:
            pad(bundle, count)
        for step in range(last + 1):
            space = step if to_sensor else last - step
            if lens.stop_space == space:
                for i in range(BLOCK):
                    t = (lens.stop_z - bundle[Z + i]) / bundle[DZ + i]
                    at_x, at_y = bundle[X + i] + t * bundle[DX + i], bundle[Y + i] + t * bundle[DY + i]
                    filled = (at_x * at_x + at_y * at_y) / (lens.stop_radius * lens.stop_radius)
                    bundle[_OBSTRUCTION + i] = max(bundle[_OBSTRUCTION + i], filled)
            if step == last:
                break
            k = space if to_sensor else space - 1
            at_surface(bundle, lens, k, False, colour, sense, (np.inf, DROPPED, DROPPED), False, book)
            for i in range(BLOCK):
                filled = (bundle[X + i] * bundle[X + i] + bundle[Y + i] * bundle[Y + i]) / (rims[k] * rims[k])
                bundle[_OBSTRUCTION + i] = max(bundle[_OBSTRUCTION + i], filled)
        for i in range(count):
            if bundle[ENDED_ON + i] == 0.0:
                least[first + i] = min(least[first + i], bundle[_OBSTRUCTION + i])


def _opening(seen: Viewpoints, middle: Array, radius: Array) -> Opening:
    """Return the opening of measured disks, closed beyond the last field angle that lets light through."""
    sense, tangent_step = 1.0 if seen.to_sensor else -1.0, float(seen.tangent[1])
    far = covering(tangent_step, 1.0 / seen.distance, middle, radius, seen.distance)
    return Opening(seen.plane_z, sense, far, 0.0, no_disks())


@inlined
def opening_from(opening: Opening, p: Vector) -> tuple[float, float, float]:
    """Return centre (x, y) and radius, in the opening's plane, of the disk seen from a point; radius −1: none.

    Parameters
    ----------
    opening : Opening
    p : (3,) float, mm
        Point, camera frame.
    """
    x, y, z = p
    distance = (opening.plane_z - z) * opening.sense
    if distance <= 0.0:
        return 0.0, 0.0, -1.0
    height = np.sqrt(x * x + y * y)
    if distance < opening.near_depth:
        return disk_at(opening.near, x, y, height, distance)
    return disk_at(opening.far, x, y, height / distance, 1.0 / distance)
