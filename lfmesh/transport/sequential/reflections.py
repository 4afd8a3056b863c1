"""Many rays along one sequence of lens surfaces, refracted at some and reflected at others, exactly and in blocks.

A ray leaves the sequence where it misses the next surface or meets another one before it, which can only be the surface
that it comes from, on its hollow side; then it passes with weight 0, as do rays that an aperture or the stop takes.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.surfaces.tessellation import OVERREACH
from lfmesh.kernels.decorators import kernel, pasted
from lfmesh.kernels.vector import both, select
from lfmesh.transport.packets.book import HOUSING, STOP
from lfmesh.transport.sequential.image_path import through_mla
from lfmesh.transport.sequential.lens_bundle import (
    BLOCK,
    DROPPED,
    DX,
    DY,
    DZ,
    ENDED_ON,
    ETENDUE,
    LEFT_BEHIND,
    MET,
    ROWS,
    WEIGHT,
    X,
    Y,
    Z,
    absorb_since_start,
    begin_etendue,
    distances_to,
    empty_bundle,
    load,
    mirror_at_surface,
    move_bundle,
    normalise,
    note_start,
    pad,
    through_stop,
    through_surface,
)
from lfmesh.transport.sequential.sequences import Itinerary
from lfmesh.transport.tables.tables import LensTables, Media, MlaTables

Array = NDArray[np.float64]

# Rows beyond those of a bundle: where a leg starts, and the distance at which the ray meets its surface again.
_FROM_X, _FROM_Y, _FROM_Z, _AGAIN = ROWS * BLOCK, (ROWS + 1) * BLOCK, (ROWS + 2) * BLOCK, (ROWS + 3) * BLOCK
BUNDLE_ROWS = ROWS + 4

NEAR = 1e-9
"""Distance, over the size of the coordinates, at which a ray still is on the surface that it leaves."""


class Arrived(NamedTuple):
    """Rays behind the last surface of a sequence, camera frame."""

    position: Array  # (n, 3) mm, on that surface; of a ray that does not pass, where it left the sequence
    direction: Array  # (n, 3) unit
    weight: Array  # (n,) share of the power: the product of R, T and what glass transmits; 0: does not pass


def follow_sequence(
    lens: LensTables, path: Itinerary, p: Array, d: Array, colour: int = 0, ways: Array | None = None
) -> Arrived:
    """Follow rays along a sequence of surfaces of the lens.

    Parameters
    ----------
    lens : LensTables
    path : Itinerary
        Over surfaces of the lens alone.
    p, d : (n, 3) float64
        Position, mm, before the lens as the sequence runs, and unit direction; camera frame.
    colour : int
        Number of the wavelength.
    ways : (n,) float64, optional
        Filled with numbers that tell apart where, and on what, rays leave the sequence; the same for all that pass.
    """
    rays = Arrived(np.array(p, dtype=np.float64, order="C"), np.array(d, dtype=np.float64, order="C"), np.empty(len(p)))
    _follow(
        rays, lens, np.array(path.faces, np.int64), np.array(path.reflected, np.bool_), path.to_sensor, colour,
        empty_bundle(BUNDLE_ROWS), book_for(lens.media), np.empty(len(p)) if ways is None else ways,
    )  # fmt: skip
    return rays


def follow_through_mla(rays: Arrived, mla: MlaTables, frames: Array, colour: int = 0) -> None:
    """Take rays that come from the lens on through the array, refracted at both of its faces.

    Parameters
    ----------
    rays : Arrived
        Changed in place.
    mla : MlaTables
    frames : (6, 6, 3, 4) float64
    colour : int
        Number of the wavelength.
    """
    _through_mla(rays, mla, frames, colour, empty_bundle(BUNDLE_ROWS), book_for(mla.media))


def book_for(media: Media) -> Array:
    """Return a book with a slot for each medium that absorbs; what is entered in it is not used."""
    return np.zeros(1 + int(media.absorption.slot.max()) if media.absorption is not None else 0)


def etendue_factors(lens: LensTables, p: Array, d: Array, colour: int = 0) -> Array:
    """Return by what thin lenses divide the radiance of rays (n,) from object space to behind the lens.

    Parameters
    ----------
    lens : LensTables
    p, d : (n, 3) float64
        Position, mm, before the lens, and unit direction; camera frame.
    colour : int
        Number of the wavelength.
    """
    factors = np.ones(len(p))
    if lens.interfaces.thin:
        _etendue_factors(np.ascontiguousarray(p), np.ascontiguousarray(d), lens, colour, empty_bundle(), factors)
    return factors


@kernel
def _etendue_factors(p: Array, d: Array, lens: LensTables, colour: int, bundle: Array, factors: Array) -> None:
    for first in range(0, len(p), BLOCK):
        count = min(BLOCK, len(p) - first)
        for i in range(count):
            at, to = p[first + i], d[first + i]
            load(bundle, i, at[0], at[1], at[2], to[0], to[1], to[2], 1.0)
        pad(bundle, count)
        begin_etendue(lens.interfaces, bundle)
        for k in range(len(lens.surfaces)):
            through_surface(bundle, lens, k, colour, 1.0, np.inf, DROPPED, DROPPED)
        for i in range(count):
            factors[first + i] = bundle[ETENDUE + i]


@kernel
def _follow(
    rays: Arrived, lens: LensTables, faces: NDArray[np.int64], reflected: NDArray[np.bool_], to_sensor: bool,
    colour: int, bundle: Array, book: Array, ways: Array,
) -> None:  # fmt: skip
    for first in range(0, len(rays.weight), BLOCK):
        count = min(BLOCK, len(rays.weight) - first)
        for i in range(count):
            p, d = rays.position[first + i], rays.direction[first + i]
            load(bundle, i, p[0], p[1], p[2], d[0], d[1], d[2], 1.0)
        pad(bundle, count)
        along(bundle, lens, faces, reflected, to_sensor, colour, book)
        normalise(bundle)
        store(bundle, rays, first, count)
        for i in range(count):
            ended = bundle[ENDED_ON + i]
            on = 1.0 if ended == STOP + 1.0 else (2.0 if ended == DROPPED else 0.0)
            ways[first + i] = 3.0 * bundle[MET + i] + on


@kernel
def _through_mla(rays: Arrived, mla: MlaTables, frames: Array, colour: int, bundle: Array, book: Array) -> None:
    for first in range(0, len(rays.weight), BLOCK):
        count = load_rays(bundle, rays, first)
        drop_backward(bundle, True)
        through_mla(bundle, count, mla, colour, frames, True, book)
        normalise(bundle)
        store(bundle, rays, first, count)


@kernel
def drop_backward(bundle: Array, to_sensor: bool) -> None:
    """End rays of a bundle that do not travel in the direction in which their sequence goes on."""
    for i in range(BLOCK):
        _drop(bundle, i, (bundle[DZ + i] > 0.0) != to_sensor)


@kernel
def load_rays(bundle: Array, rays: Arrived, first: int) -> int:
    """Load rays of a table from number `first` on into a bundle; return how many it holds.

    Those of weight 0 have ended.

    Parameters
    ----------
    bundle : (ROWS · BLOCK,) float64
    rays : Arrived
    first : int
    """
    count = min(BLOCK, len(rays.weight) - first)
    for i in range(count):
        p, d = rays.position[first + i], rays.direction[first + i]
        load(bundle, i, p[0], p[1], p[2], d[0], d[1], d[2], rays.weight[first + i])
        if not rays.weight[first + i] > 0.0:
            bundle[ENDED_ON + i] = DROPPED
    pad(bundle, count)
    return count


@kernel
def store(bundle: Array, rays: Arrived, first: int, count: int) -> None:
    """Enter the rays of a bundle in a table of rays; of those that have ended, the weight is 0.

    Parameters
    ----------
    bundle : (ROWS · BLOCK,) float64
    rays : Arrived
        Changed in place, from number `first` on.
    first, count : int
    """
    for i in range(count):
        p, d = rays.position[first + i], rays.direction[first + i]
        p[0], p[1], p[2] = bundle[X + i], bundle[Y + i], bundle[Z + i]
        d[0], d[1], d[2] = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        rays.weight[first + i] = bundle[WEIGHT + i] if bundle[ENDED_ON + i] == 0.0 else 0.0


@kernel
def along(
    bundle: Array, lens: LensTables, faces: NDArray[np.int64], reflected: NDArray[np.bool_], to_sensor: bool,
    colour: int, book: Array,
) -> None:  # fmt: skip
    """Take a bundle (camera frame) along a sequence of surfaces of the lens.

    Parameters
    ----------
    bundle : (BUNDLE_ROWS · BLOCK,) float64
    lens : LensTables
    faces : (n,) int64
        The surfaces, in the order in which they are met.
    reflected : (n,) bool
        Whether the rays are reflected at each of them.
    to_sensor : bool
        Direction of travel at the start.
    colour : int
        Number of the wavelength.
    book : (slots,) float64
        For light that the glasses absorb.
    """
    space, last = 0 if to_sensor else len(lens.surfaces), -1
    for step in range(len(faces) + 1):
        ends = step == len(faces)
        k = last if ends else faces[step]
        within = space
        note_start(lens.media.absorption, bundle)
        if lens.stop_space == space and (ends or k != last):
            if lens.stop_posed:
                move_bundle(bundle, lens.stop_unpose)
            through_stop(bundle, lens.stop_z, lens.stop_radius, float(STOP))
            if lens.stop_posed:
                move_bundle(bundle, lens.stop_pose)
        if last >= 0:
            _find_return(bundle, lens, last, 1.0 if space == last else -1.0)
        if ends:
            break
        sense = 1.0 if space == k else -1.0
        rim, mount, beyond = lens.surfaces[k].semi_diameter * (1.0 + OVERREACH), lens.mount_slot[k] + 1.0, HOUSING + 1.0
        if reflected[step]:
            mirror_at_surface(bundle, lens, k, colour, sense, rim, mount, beyond)
        else:
            through_surface(bundle, lens, k, colour, sense, rim, mount, beyond)
            space = k + 1 if sense > 0.0 else k
        absorb_since_start(lens.media.absorption, bundle, lens.medium[within], colour, book)
        if last >= 0 and last != k:
            _end_returned(bundle)
        surface = lens.surfaces[k]
        if surface.terms == 0 and surface.conic == 0.0:
            unpose = surface.unpose
            _end_beyond_equator(
                bundle, surface.curvature, unpose[2, 0], unpose[2, 1], unpose[2, 2], unpose[2, 3] - surface.vertex_z
            )
        last = k
    _end_that_return(bundle)


@kernel
def _find_return(bundle: Array, lens: LensTables, k: int, sense: float) -> None:
    """Find where rays meet the surface again that they leave, within its rim; keep their starts.

    Parameters
    ----------
    sense : float
        In which they would cross it.
    """
    surface = lens.surfaces[k]
    for i in range(BLOCK):
        bundle[_FROM_X + i], bundle[_FROM_Y + i], bundle[_FROM_Z + i] = bundle[X + i], bundle[Y + i], bundle[Z + i]
        bundle[_AGAIN + i] = np.inf
    if surface.terms == 0 and not sense * surface.curvature < 0.0:
        return
    if surface.posed:
        move_bundle(bundle, surface.unpose)
    distances_to(bundle, surface, sense, _AGAIN)
    rim = surface.semi_diameter * (1.0 + OVERREACH)
    for i in range(BLOCK):
        t = bundle[_AGAIN + i]
        x, y, z = bundle[X + i], bundle[Y + i], bundle[Z + i]
        ahead = t > NEAR * (abs(x) + abs(y) + abs(z))
        x, y = x + t * bundle[DX + i], y + t * bundle[DY + i]
        bundle[_AGAIN + i] = select(both(ahead, x * x + y * y <= rim * rim), t, np.inf)
    if surface.posed:
        move_bundle(bundle, surface.pose)


@pasted
def _drop(bundle: Array, i: int, drops: bool) -> None:
    """End ray `i` off its sequence where a condition holds, if it has not ended before."""
    ends = both(bundle[ENDED_ON + i] == 0.0, drops)
    bundle[ENDED_ON + i] = select(ends, DROPPED, bundle[ENDED_ON + i])
    bundle[LEFT_BEHIND + i] += select(ends, bundle[WEIGHT + i], 0.0)


@kernel
def _end_returned(bundle: Array) -> None:
    """End rays that met the surface that they left before they came here."""
    for i in range(BLOCK):
        x, y = bundle[X + i] - bundle[_FROM_X + i], bundle[Y + i] - bundle[_FROM_Y + i]
        z = bundle[Z + i] - bundle[_FROM_Z + i]
        again = bundle[_AGAIN + i]
        _drop(bundle, i, x * x + y * y + z * z > again * again)


@kernel
def _end_that_return(bundle: Array) -> None:
    """End rays that have met the last surface of their sequence and will meet it again."""
    for i in range(BLOCK):
        _drop(bundle, i, bundle[_AGAIN + i] < np.inf)


@kernel
def _end_beyond_equator(bundle: Array, c: float, along_x: float, along_y: float, along_z: float, shift: float) -> None:
    """End rays that met the half of a sphere that does not hold its vertex.

    Parameters
    ----------
    c : float
        Curvature, 1/mm.
    along_x, along_y, along_z, shift : float
        Give the height above the vertex, mm, of a point in the camera frame.
    """
    for i in range(BLOCK):
        height = along_x * bundle[X + i] + along_y * bundle[Y + i] + along_z * bundle[Z + i] + shift
        _drop(bundle, i, c * height >= 1.0)
