"""Tables of rays along one sequence of faces, exactly: what analyses and drawings ask of a camera, without packets."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.transport.packets.book import STOP
from lfmesh.transport.sequences.bundle import DROPPED, empty_bundle
from lfmesh.transport.sequences.follower import (
    END_ROWS,
    RAY_ENDED,
    RAY_ETENDUE,
    RAY_MET,
    RAY_WEIGHT,
    Route,
    follow_rays,
    route_of,
)
from lfmesh.transport.sequences.sequences import Faces, Itinerary, image_path
from lfmesh.transport.tables.cover import CoverTables
from lfmesh.transport.tables.tables import Camera, LensTables, MlaTables, Tables

Array = NDArray[np.float64]


class Arrived(NamedTuple):
    """Rays behind the last face of a sequence, camera frame."""

    position: Array  # (n, 3) mm, on that face; of a ray that does not pass, where it left the sequence
    direction: Array  # (n, 3) unit
    weight: Array  # (n,) what is left of the power; 0: the ray does not pass
    way: Array  # (n,) numbers that tell apart where, and on what, rays leave the sequence; the same for all that pass
    met: NDArray[np.int64]  # (n,) faces of the sequence that rays have met within their apertures
    ended: Array  # (n,) what ended them, see `bundle.ENDED_ON`; 0: nothing did


def faces_of(tables: Tables) -> Faces:
    """Return how many faces the parts of a camera have."""
    reflects = tables.sensor.reflectance > 0.0
    planes = (2 if tables.cover is not None else 0) + int(reflects)
    return Faces(len(tables.lens.surfaces), 2 * int(tables.mla.present), planes, reflects)


def follow_sequence(
    tables: Tables, path: Itinerary, p: Array, d: Array, weight: Array | float = 1.0, colour: int = 0
) -> Arrived:
    """Follow rays along a sequence of faces of a camera.

    A ray leaves the sequence where it misses the next face or meets another one before it; then it passes with weight
    0, as do rays that an aperture or the stop takes.

    Parameters
    ----------
    tables : Tables
    path : Itinerary
        Over faces of the camera, see `faces_of`; of its lens, array, cover or all of them.
    p, d : (n, 3) float64
        Position, mm, before the first face, and unit direction; camera frame.
    weight : (n,) float64, optional
        Power of each.
    colour : int
        Number of the wavelength.
    """
    return follow_to(tables.camera, route_of(faces_of(tables).legs(path), checked=True), p, d, weight, colour)


def follow_to(
    camera: Camera, route: Route, p: Array, d: Array, weight: Array | float = 1.0, colour: int = 0
) -> Arrived:
    """Follow rays along all legs of a route.

    Parameters
    ----------
    camera : Camera
    route : Route
    p, d : (n, 3) float64
        Starts, mm, and unit directions, camera frame.
    weight : (n,) float64
        Power of the rays.
    colour : int
        Number of the wavelength.
    """
    rays = np.empty((RAY_WEIGHT + 1, len(p)))
    rays[:3], rays[3:6], rays[RAY_WEIGHT] = p.T, d.T, weight
    ends = follow_route(camera, route, rays, (0, len(route.legs)), colour)
    ended, d = ends[RAY_ENDED], ends[3:6].T
    on = np.where(ended == STOP + 1.0, 1.0, np.where(ended == DROPPED, 2.0, 0.0))
    return Arrived(
        np.ascontiguousarray(ends[:3].T),
        d / np.linalg.norm(d, axis=1, keepdims=True),
        np.where(ended == 0.0, ends[RAY_WEIGHT], 0.0),
        3.0 * ends[RAY_MET] + on,
        ends[RAY_MET].astype(np.int64),
        ended,
    )


def lens_of_faces(lens: LensTables, first: int, last: int) -> LensTables:
    """Return the tables of a lens with some of its faces only, for rays that go on from one to the next of them.

    Parameters
    ----------
    lens : LensTables
    first, last : int
        The first of these faces, and the one before which they end.
    """
    rows = lens.interfaces._replace(rows=lens.interfaces.rows[first:last])
    stop_space = lens.stop_space - first
    return lens._replace(
        surfaces=lens.surfaces[first:last], medium=lens.medium[first : last + 1], interfaces=rows,
        ring_slot=lens.ring_slot[first : last + 1], mount_slot=lens.mount_slot[first:last],
        stop_space=stop_space if 0 <= stop_space <= last - first else -1,
    )  # fmt: skip


def without_apertures(lens: LensTables) -> LensTables:
    """Return the tables of a lens whose surfaces go on beyond their clear apertures, and whose stop takes nothing."""
    surfaces = lens.surfaces.copy()
    surfaces["semi_diameter"] = np.inf
    return lens._replace(surfaces=surfaces, stop_space=-1)


def follow_route(camera: Camera, route: Route, rays: Array, legs: tuple[int, int], colour: int) -> Array:
    """Return the ends (END_ROWS, n) of rays along some legs of a route, see `follow_rays`; no book is kept.

    Parameters
    ----------
    camera : Camera
    route : Route
    rays : (7, n) float64
    legs : (2,) int
        The first leg, and the one before which they end.
    colour : int
        Number of the wavelength.
    """
    count = rays.shape[1]
    ends = np.zeros((END_ROWS, count))
    follow_rays(
        rays, ends, np.arange(count), np.array([0, count]), np.array(legs), camera, route, colour,
        unread_book(camera.lens, camera.mla, camera.cover), empty_bundle(),
    )  # fmt: skip
    return ends


def unread_book(*regions: LensTables | MlaTables | CoverTables | None) -> Array:
    """Return a book in which all that parts of a camera absorb can be entered, and that nobody reads."""
    there = [region for region in regions if region is not None]
    slots = [region.interfaces.rows["slot"] for region in there]
    slots += [region.media.absorption.slot for region in there if region.media.absorption is not None]
    return np.zeros(1 + max(int(each.max(initial=0)) for each in slots))


def etendue_factors(tables: Tables, p: Array, d: Array, colour: int = 0) -> Array:
    """Return by what thin lenses divide the radiance of rays (n,) from object space to behind the lens.

    Parameters
    ----------
    tables : Tables
    p, d : (n, 3) float64
        Position, mm, before the lens, and unit direction; camera frame. Apertures are left out.
    colour : int
        Number of the wavelength.
    """
    if not tables.lens.interfaces.thin:
        return np.ones(len(p))
    camera = tables._replace(lens=without_apertures(tables.lens)).camera
    rays = np.ones((RAY_WEIGHT + 1, len(p)))
    rays[:3], rays[3:6] = p.T, d.T
    route = route_of(faces_of(tables).legs(image_path(len(camera.lens.surfaces))), checked=False)
    return follow_route(camera, route, rays, (0, 1), colour)[RAY_ETENDUE]
