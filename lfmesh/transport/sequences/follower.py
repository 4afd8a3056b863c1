"""Follower of sequences: takes blocks of rays from face to face of the camera.

A route is a list of faces, cut into legs: lens, array, and cover with sensor. Only the route distinguishes the image
path, a ghost and a user's ray. A ray leaves its route if it misses the next face or first meets another: a
neighbouring lenslet or, on a checked leg, the concave side of the surface just left.
"""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.surfaces.tessellation import OVERREACH
from lfmesh.kernels.by_address import by_address
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.kernels.vector import both, select
from lfmesh.transport.events.gradient import in_gradient
from lfmesh.transport.packets.book import HOUSING
from lfmesh.transport.packets.packet import CAMERA_FRAME, MLA_FRAME, SENSOR_FRAME
from lfmesh.transport.sequences.bundle import (
    AGAIN,
    BESIDE,
    BLOCK,
    DROPPED,
    DX,
    DY,
    DZ,
    ENDED_ON,
    ETENDUE,
    EVENTS_BEFORE,
    KICK_AT,
    KICK_X,
    KICK_Y,
    LEFT_BEHIND,
    MET,
    WEIGHT,
    X,
    Y,
    Z,
    drop,
    load,
    move_bundle,
    pad,
)
from lfmesh.transport.sequences.division import begin_etendue
from lfmesh.transport.sequences.lens_surfaces import at_surface, find_return
from lfmesh.transport.sequences.lenslets import at_lenslets, at_other_face
from lfmesh.transport.sequences.planes import at_plane
from lfmesh.transport.sequences.sequences import ARRAY_LEG, LENS_LEG, Leg
from lfmesh.transport.sequences.stop import through_stop, turn_behind_stop
from lfmesh.transport.tables.tables import Camera, LensTables, MlaTables, Tables

Array = NDArray[np.float64]


@by_address
class Route(NamedTuple):
    """Faces that rays meet in turn, leg by leg; one route may hold the legs of many sequences."""

    steps: NDArray[np.int64]  # (steps, 2) the face, counted within its part; 1: rays are reflected there
    # (legs, 5) part of the camera, first step, end of the steps (excluded), 1 if the leg begins towards the sensor,
    # and 1 if it is checked, see `route_of`
    legs: NDArray[np.int64]


def route_of(legs: list[Leg], *, checked: bool) -> Route:
    """Return the route along legs.

    Parameters
    ----------
    legs : list of Leg
    checked : bool
        Drop rays that meet the surface just left again before the next one.
    """
    ends = np.cumsum([0, *(len(leg.faces) for leg in legs)])
    steps = [met for leg in legs for met in zip(leg.faces, leg.reflected, strict=True)]
    rows = [(leg.part, *ends[k : k + 2], leg.to_sensor, checked) for k, leg in enumerate(legs)]
    return Route(np.array(steps, np.int64).reshape(-1, 2), np.array(rows, np.int64).reshape(-1, 5))


IN_LENS, IN_ARRAY, ARRAY_AGAIN, LENS_AGAIN = range(4)
"""Legs of `image_route`: through lens and array to the sensor; through array and lens to the objects."""


@lru_cache(maxsize=64)
def image_route(surfaces: int, has_array: bool) -> Route:
    """Return the image path in both directions; without an array, its legs are empty.

    Parameters
    ----------
    surfaces : int
        Number of refracting surfaces of the lens.
    has_array : bool
    """
    lens, array = tuple(range(surfaces)), (0, 1) if has_array else ()
    there = [(LENS_LEG, lens, True), (ARRAY_LEG, array, True)]
    back = [(ARRAY_LEG, array[::-1], False), (LENS_LEG, lens[::-1], False)]
    return route_of(
        [Leg(part, faces, (False,) * len(faces), to_sensor) for part, faces, to_sensor in (*there, *back)],
        checked=False,
    )


def image_route_of(tables: Tables) -> Route:
    """Return the image path through a camera in both directions."""
    return image_route(len(tables.lens.surfaces), bool(tables.mla.present))


@kernel
def follow_legs(bundle: Array, camera: Camera, route: Route, first: int, last: int, colour: int, book: Array) -> None:
    """Take a bundle (camera frame) along the legs `first` to `last` (excluded).

    Parameters
    ----------
    bundle : (ROWS · BLOCK,) float64
    camera : Camera
    route : Route
    first, last : int
    colour : int
        Wavelength number.
    book : (slots,) float64
        Receives light absorbed by media and coatings.
    """
    for leg in range(first, last):
        part, begin, end, to_sensor, checked = route.legs[leg]
        steps = route.steps[begin:end]
        if part == LENS_LEG:
            _along_lens(bundle, camera.lens, steps, to_sensor != 0, checked != 0, colour, book)
        elif len(steps) == 0:
            continue
        elif part == ARRAY_LEG:
            if checked != 0:
                _drop_backward(bundle, to_sensor != 0)
            _along_array(bundle, camera.mla, steps, to_sensor != 0, colour, camera.frames, book)
        else:
            _along_planes(bundle, camera, steps, to_sensor != 0, colour, book)


@kernel
def _along_lens(
    bundle: Array, lens: LensTables, steps: NDArray[np.int64], to_sensor: bool, checked: bool, colour: int, book: Array
) -> None:
    """Take a bundle along lens surfaces and through the stop."""
    space, last = 0 if to_sensor else len(lens.surfaces), -1
    # A phase may turn rays to any side, also along a concave surface.
    checked = checked or _has_phases(lens.interfaces.phases)
    begin_etendue(lens.interfaces, bundle)
    for step in range(len(steps) + 1):
        ends = step == len(steps)
        k = last if ends else steps[step, 0]
        if lens.stop_space == space and (ends or k != last):
            through_stop(bundle, lens, colour, book)
        if checked:
            straight = (ends or k != last) and not in_gradient(lens.gradients, space)
            find_return(bundle, lens, last if straight else -1, 1.0 if space == last else -1.0)
        if ends:
            break
        sense, mirrors = 1.0 if space == k else -1.0, steps[step, 1] != 0
        beyond = lens.ring_slot[space] + 1.0
        if step == 0:
            beyond = BESIDE if to_sensor else HOUSING + 1.0
        fates = (lens.surfaces[k].semi_diameter * (1.0 + OVERREACH), lens.mount_slot[k] + 1.0, beyond)
        at_surface(bundle, lens, k, mirrors, colour, sense, fates, checked, book)
        if not mirrors:
            turn_behind_stop(lens.aperture, bundle, lens, k, colour, sense)
            space = k + 1 if sense > 0.0 else k
        last = k
    if checked:
        for i in range(BLOCK):
            if bundle[ENDED_ON + i] == 0.0 and bundle[AGAIN + i] < np.inf:
                drop(bundle, i)


@inlined
def _has_phases(phases: Any) -> bool:
    """Tell whether a region has phases; `phases` : PhaseFaces or None."""
    return phases is not None


@kernel
def _drop_backward(bundle: Array, to_sensor: bool) -> None:
    """Drop rays that travel against the direction of their leg."""
    for i in range(BLOCK):
        drops = both(bundle[ENDED_ON + i] == 0.0, (bundle[DZ + i] > 0.0) != to_sensor)
        bundle[ENDED_ON + i] = select(drops, DROPPED, bundle[ENDED_ON + i])
        bundle[LEFT_BEHIND + i] += select(drops, bundle[WEIGHT + i], 0.0)


@kernel
def _along_array(
    bundle: Array, mla: MlaTables, steps: NDArray[np.int64], to_sensor: bool, colour: int, frames: Array, book: Array
) -> None:
    """Take a bundle along faces of the array: 0 faces the lens, 1 the sensor."""
    move_bundle(bundle, frames[CAMERA_FRAME, MLA_FRAME])
    for step in range(len(steps)):
        mirrors = steps[step, 1] != 0
        # In the array's frame z runs from the curved face into the glass.
        inward = to_sensor == mla.curved_to_lens
        if (steps[step, 0] == 0) == mla.curved_to_lens:
            at_lenslets(bundle, mla, inward, mirrors, colour, book)
        else:
            at_other_face(mla.back, bundle, mla, not inward, mirrors, colour, frames, book)
        to_sensor = to_sensor != mirrors
    move_bundle(bundle, frames[MLA_FRAME, CAMERA_FRAME])


@kernel
def _along_planes(
    bundle: Array, camera: Camera, steps: NDArray[np.int64], to_sensor: bool, colour: int, book: Array
) -> None:
    """Take a bundle along the cover's faces and the sensor."""
    move_bundle(bundle, camera.frames[CAMERA_FRAME, SENSOR_FRAME])
    for step in range(len(steps)):
        mirrors = steps[step, 1] != 0
        at_plane(bundle, camera.cover, camera.sensor, steps[step, 0], to_sensor, mirrors, colour, book)
        to_sensor = to_sensor != mirrors
    move_bundle(bundle, camera.frames[SENSOR_FRAME, CAMERA_FRAME])


RAY_WEIGHT, RAY_MET, RAY_ENDED, RAY_ETENDUE, END_ROWS = 6, 7, 8, 9, 10
"""Rows of ray tables, see `follow_rays`, after those of position and direction, and the number of rows."""

RAY_KICK_X, RAY_KICK_Y, RAY_KICK_AT = 7, 8, 9
"""Rows of tables of rays to be diffracted at the array: their deflection there, and the number of interfaces met
before it."""


@inlined
def _give_kick(apertures: Any, rays: Array, n: int, bundle: Array, i: int) -> None:
    """Set the deflection of a ray by diffraction at the array, if any."""
    if apertures is None:
        return
    bundle[EVENTS_BEFORE + i] = 0.0
    bundle[KICK_X + i], bundle[KICK_Y + i] = rays[RAY_KICK_X, n], rays[RAY_KICK_Y, n]
    bundle[KICK_AT + i] = rays[RAY_KICK_AT, n]


@kernel
def follow_rays(
    rays: Array, ends: Array, order: NDArray[np.int64], first: NDArray[np.int64], legs: NDArray[np.int64],
    camera: Camera, route: Route, colour: int, book: Array, bundle: Array,
) -> None:  # fmt: skip
    """Take groups of rays along their legs, in blocks.

    Parameters
    ----------
    rays : (7 or more, n) float64
        Position, mm, unit direction and weight of each, camera frame; if the array diffracts, also the rows from
        `RAY_KICK_X`.
    ends : (END_ROWS, n) float64
        Filled for the rays in `order`: as `rays`, with unit directions to rounding; then the number of interfaces met,
        the cause of the end (0: not ended), and the factor by which thin lenses divide the radiance.
    order : (m,) int64
        Ray numbers, group after group.
    first : (groups + 1,) int64
        Start of each group in `order`.
    legs : (groups + 1,) int64
        First leg of each group; the next group's is the end.
    camera : Camera
    route : Route
    colour : int
        Wavelength number.
    book : (slots,) float64
        Receives light absorbed by media and coatings.
    bundle : (ROWS · BLOCK,) float64
        Working memory.
    """
    for group in range(len(first) - 1):
        for begin in range(first[group], first[group + 1], BLOCK):
            count = min(BLOCK, first[group + 1] - begin)
            for i in range(count):
                n = order[begin + i]
                load(
                    bundle, i, rays[0, n], rays[1, n], rays[2, n], rays[3, n], rays[4, n], rays[5, n],
                    rays[RAY_WEIGHT, n],
                )  # fmt: skip
                _give_kick(camera.mla.apertures, rays, n, bundle, i)
            pad(bundle, count)
            follow_legs(bundle, camera, route, legs[group], legs[group + 1], colour, book)
            for i in range(count):
                n = order[begin + i]
                ends[0, n], ends[1, n], ends[2, n] = bundle[X + i], bundle[Y + i], bundle[Z + i]
                ends[3, n], ends[4, n], ends[5, n] = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
                ends[RAY_WEIGHT, n], ends[RAY_MET, n] = bundle[WEIGHT + i], bundle[MET + i]
                ends[RAY_ENDED, n], ends[RAY_ETENDUE, n] = bundle[ENDED_ON + i], bundle[ETENDUE + i]
