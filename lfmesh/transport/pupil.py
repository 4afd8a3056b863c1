"""The lens's opening as points in front of it or behind it see it, found by real rays.

From each of a table of points rays go at the lens, through its exact surfaces; what gets through at any wavelength of
the scene is bounded by a disk in the lens's outermost plane. Vignetting and the aberrations of the pupil are in it. The
lens is one of revolution, so a point is told by its distance from that plane and the tangent of its field angle.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernel import inlined, kernel
from lfmesh.transport.bundle import (
    BLOCK,
    ENDED_ON,
    empty_bundle,
    load,
    pad,
)
from lfmesh.transport.image_path import through_lens
from lfmesh.transport.tables import LensTables, Opening

Array = NDArray[np.float64]

ANGLES = 33
"""Field angles at which the opening is measured, evenly spaced in their tangent."""

DISTANCES = 6
"""Distances at which it is measured where points lie at several, evenly spaced in their inverse."""

SEARCH = 24
"""Rays across the outermost plane of the lens in the search for the opening."""

SPOKES = 20
"""Half as many directions round the opening's middle in which its edge is measured."""

STEPS = 16
"""Points of a spoke that are tried, outermost first, and ..."""

HALVINGS = 6
"""... how often the last interval is halved then."""

PARAXIAL_MARGIN = 1.15
"""Over the paraxial pupil's radius, where no real rays are to be had: pupils have aberrations."""

MARGIN = 1.02
"""Over the measured radius: what lies between the measured points, spokes and wavelengths."""


class Outlook(NamedTuple):
    """From where a side of the lens is looked at.

    Attributes
    ----------
    plane_z : float, mm
        The lens's outermost plane on that side, camera frame.
    wide_radius : float, mm
        Of the disk there that every ray to the lens crosses.
    to_sensor : bool
        The way rays go from there into the lens.
    tangent : (m,) float64
        Of field angles, from 0, evenly spaced.
    distance : (n,) float64, mm
        To the plane, far to near, evenly spaced in its inverse.
    """

    plane_z: float
    wide_radius: float
    to_sensor: bool
    tangent: Array
    distance: Array


def outlook(plane_z: float, wide_radius: float, points: Array, *, to_sensor: bool) -> Outlook | None:
    """Return how points (n, 3) (camera frame) look at a side of the lens; None: none of them lies before it."""
    distance = (plane_z - points[:, 2]) * (1.0 if to_sensor else -1.0)
    before = distance > 1e-6 * wide_radius
    if not before.any():
        return None
    distance = distance[before]
    tangent = np.hypot(points[before, 0], points[before, 1]) / distance
    near, far = float(distance.min()), float(distance.max())
    # Where all lie in one plane, one distance will do.
    many = DISTANCES if far - near > 1e-9 * far else 1
    inverse = np.linspace(1.0 / far, 1.0 / near, many)
    # Points on the axis alone see it at no angle; the table then needs some width.
    widest = float(tangent.max()) or 1.0
    return Outlook(plane_z, wide_radius, to_sensor, np.linspace(0.0, widest, ANGLES), 1.0 / inverse)


def unknown_opening(plane_z: float, *, to_sensor: bool) -> Opening:
    """Return the opening of a lens of which nothing is known: rays go anywhere on it."""
    sense = 1.0 if to_sensor else -1.0
    return Opening(False, plane_z, sense, 1.0, 0.0, 1.0, np.zeros((2, 2)), np.full((1, 1), -1.0))


def paraxial_opening(seen: Outlook, pupil_z: float, pupil_radius: float) -> Opening:
    """Return a pupil of first-order optics as points see it in the outermost plane, with a margin.

    Where that is wider than the disk that every ray to the lens crosses, the latter takes its place.
    """
    tangent, distance = np.meshgrid(seen.tangent, seen.distance)
    depth = (pupil_z - seen.plane_z) * (1.0 if seen.to_sensor else -1.0)
    with np.errstate(divide="ignore"):
        share = distance / (distance + depth)
    radius = np.abs(PARAXIAL_MARGIN * pupil_radius * share)
    fits = radius < seen.wide_radius
    middle = np.where(fits, tangent * distance * (1.0 - np.where(fits, share, 0.0)), 0.0)
    return _opening(seen, middle, np.where(fits, radius, seen.wide_radius))


def real_opening(seen: Outlook, lens: LensTables) -> Opening:
    """Return what gets through the lens's exact surfaces, whatever the wavelength, as points see it.

    Field angles beyond which nothing gets through are left out of the table.
    """
    middle, radius = _measured(seen, lens)
    open_columns = np.flatnonzero((radius > 0.0).any(axis=0))
    if not len(open_columns):
        return _opening(seen, middle, radius)
    last = min(int(open_columns[-1]) + 1, ANGLES - 1)
    if last < ANGLES - 1:
        seen = seen._replace(tangent=np.linspace(0.0, seen.tangent[last], ANGLES))
        middle, radius = _measured(seen, lens)
    return _opening(seen, middle, radius)


def _measured(seen: Outlook, lens: LensTables) -> tuple[Array, Array]:
    """Return middle (along the meridian) and radius of the opening's disk from every point, (n, m) mm; −1: closed."""
    height = np.outer(seen.distance, seen.tangent).ravel()
    distance = np.repeat(seen.distance, len(seen.tangent))
    # Half of the plane does: the other is its mirror image.
    across = np.linspace(-1.0, 1.0, SEARCH) * seen.wide_radius
    gx, gy = (np.tile(axis.ravel(), (len(height), 1)) for axis in np.meshgrid(across, across[across >= 0.0]))
    passes = _passes(seen, lens, height, distance, gx, gy)
    count = passes.sum(axis=1)
    start = (passes * gx).sum(axis=1) / np.maximum(count, 1)
    edge = _edge(seen, lens, height, distance, start)
    angle = np.linspace(0.0, np.pi, SPOKES)
    px, py = start[:, None] + edge * np.cos(angle), edge * np.sin(angle)
    # The smallest disk on the meridian, to a hundredth of what there is between its extremes.
    low, high = px.min(axis=1), px.max(axis=1)
    trial = low + np.linspace(0.0, 1.0, 101)[:, None] * (high - low)
    reach = np.sqrt(((px[None] - trial[..., None]) ** 2 + py[None] ** 2).max(axis=2))
    best = reach.argmin(axis=0)
    points = np.arange(len(height))
    radius = np.where(count > 0, MARGIN * reach[best, points], -1.0)
    shape = len(seen.distance), len(seen.tangent)
    return trial[best, points].reshape(shape), radius.reshape(shape)


def _edge(seen: Outlook, lens: LensTables, height: Array, distance: Array, start: Array) -> Array:
    """Return how far from `start` light gets through along each spoke, (points, SPOKES) mm."""
    angle = np.linspace(0.0, np.pi, SPOKES)
    across, up = np.cos(angle)[None, :, None], np.sin(angle)[None, :, None]
    reach = 2.0 * seen.wide_radius
    steps = np.linspace(0.0, reach, STEPS + 1)[1:]
    shape = (len(height), SPOKES, STEPS)
    x = (start[:, None, None] + steps * across).reshape(len(height), -1)
    y = np.broadcast_to(steps * up, shape).reshape(len(height), -1)
    passes = _passes(seen, lens, height, distance, x, y).reshape(shape)
    inside = np.where(passes.any(axis=2), STEPS - passes[..., ::-1].argmax(axis=2), 0) * (reach / STEPS)
    outside = inside + reach / STEPS
    for _ in range(HALVINGS):
        middle = 0.5 * (inside + outside)
        through = _passes(seen, lens, height, distance, start[:, None] + middle * across[..., 0], middle * up[..., 0])
        inside, outside = np.where(through, middle, inside), np.where(through, outside, middle)
    return outside


def _passes(seen: Outlook, lens: LensTables, height: Array, distance: Array, x: Array, y: Array) -> NDArray[np.bool_]:
    """Tell which rays from points of the meridian to points of the outermost plane (points, rays) get through."""
    passed = np.zeros(x.shape, np.bool_)
    room = empty_bundle()
    heights, distances = (np.broadcast_to(a[:, None], x.shape).ravel() for a in (height, distance))
    for colour in sorted({0, lens.indices.shape[1] // 2, lens.indices.shape[1] - 1}):
        _send(
            heights, distances, x.ravel(), y.ravel(), seen.plane_z, seen.to_sensor, lens, colour, room,
            passed.reshape(-1),
        )  # fmt: skip
    return passed


@kernel
def _send(
    height: Array, distance: Array, x: Array, y: Array, plane_z: float, to_sensor: bool, lens: LensTables, colour: int,
    bundle: Array, passed: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Send rays from points (height, 0) at a distance to points (x, y) of a plane; mark those that get through."""
    sense = 1.0 if to_sensor else -1.0
    for first in range(0, len(x), BLOCK):
        count = min(BLOCK, len(x) - first)
        for i in range(count):
            dx, dy, dz = x[first + i] - height[first + i], y[first + i], distance[first + i]
            scale = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
            # From well before the plane: surfaces may touch it.
            back = 0.5 * distance[first + i]
            load(
                bundle, i,
                x[first + i] - back * dx / dz, y[first + i] - back * dy / dz, plane_z - back * sense,
                dx * scale, dy * scale, sense * dz * scale, 1.0,
            )  # fmt: skip
        if count < BLOCK:
            pad(bundle, count)
        through_lens(bundle, lens, colour, to_sensor)
        for i in range(count):
            if bundle[ENDED_ON + i] == 0.0:
                passed[first + i] = True


def _opening(seen: Outlook, middle: Array, radius: Array) -> Opening:
    """Return measured disks as a table: the middle interpolated between its points, the radius large enough for that.

    A mesh of the table has the largest radius of its corners. From points beyond the last that see anything, the lens
    is closed.
    """
    closed = radius <= 0.0
    for column in range(1, middle.shape[1]):
        # What has no opening has no middle; its neighbour's lets the table be interpolated up to there.
        middle[:, column] = np.where(closed[:, column], middle[:, column - 1], middle[:, column])
    if len(seen.distance) == 1:
        middle, radius = np.repeat(middle, 2, axis=0), np.repeat(radius, 2, axis=0)
    largest = np.maximum.reduce([radius[:-1, :-1], radius[1:, :-1], radius[:-1, 1:], radius[1:, 1:]])
    # Between two points of a bent line a chord is off by an eighth of the second difference.
    bend = 0.125 * np.abs(np.diff(middle, 2, axis=1)).max(axis=1, initial=0.0)
    bend += 0.125 * np.abs(np.diff(middle, 2, axis=0)).max(initial=0.0)
    allowed = np.maximum(bend[:-1], bend[1:])[:, None]
    nearness = 1.0 / seen.distance
    step = (nearness[-1] - nearness[0]) / (len(nearness) - 1) if len(nearness) > 1 else 1.0
    return Opening(
        True, seen.plane_z, 1.0 if seen.to_sensor else -1.0, float(seen.tangent[1]), float(nearness[0]), float(step),
        np.ascontiguousarray(middle), np.where(largest > 0.0, largest + allowed, -1.0),
    )  # fmt: skip


@inlined
def opening_from(opening: Opening, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return middle and radius (camera frame, in the plane of the opening) of the disk that a point sees; −1: none."""
    distance = (opening.plane_z - z) * opening.sense
    if distance <= 0.0:
        return 0.0, 0.0, -1.0
    height = np.sqrt(x * x + y * y)
    a = height / (distance * opening.tangent_step)
    b = (1.0 / distance - opening.nearness) / opening.nearness_step
    rows, columns = opening.radius.shape
    if a > columns:
        return 0.0, 0.0, -1.0
    column, row = min(int(a), columns - 1), min(max(int(b), 0), rows - 1)
    a, b = a - column, min(max(b - row, 0.0), 1.0)
    middle = opening.middle
    m = (1.0 - b) * ((1.0 - a) * middle[row, column] + a * middle[row, column + 1])
    m += b * ((1.0 - a) * middle[row + 1, column] + a * middle[row + 1, column + 1])
    # Towards the point; for one on the axis the middle is on it too.
    m = m / height if height > 0.0 else 0.0
    return m * x, m * y, opening.radius[row, column]
