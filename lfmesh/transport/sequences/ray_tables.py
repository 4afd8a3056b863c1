"""Exact ray tables along one sequence of faces, for analyses and drawings, without packets."""

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
from lfmesh.transport.tables.gradient_spaces import of_spaces, without_edges
from lfmesh.transport.tables.phase_faces import of_faces, slots_of
from lfmesh.transport.tables.tables import Camera, LensTables, MlaTables, Tables

Array = NDArray[np.float64]


class Arrived(NamedTuple):
    """Rays behind the last face of a sequence, camera frame."""

    position: Array  # (n, 3) mm, on that face; for a ray that does not pass, the point where it left the sequence
    direction: Array  # (n, 3) unit
    weight: Array  # (n,) remaining power; 0: the ray does not pass
    way: Array  # (n,) code of the place and cause of a ray's exit from the sequence; the same for all that pass
    met: NDArray[np.int64]  # (n,) number of faces met within their apertures
    ended: Array  # (n,) cause of the end, see `bundle.ENDED_ON`; 0: none


def faces_of(tables: Tables) -> Faces:
    """Return the number of faces of each part of a camera."""
    reflects = tables.sensor.reflectance > 0.0
    planes = (2 if tables.cover is not None else 0) + int(reflects)
    return Faces(len(tables.lens.surfaces), 2 * int(tables.mla.present), planes, reflects)


def follow_sequence(
    tables: Tables, path: Itinerary, p: Array, d: Array, weight: Array | float = 1.0, colour: int = 0
) -> Arrived:
    """Follow rays along a sequence of faces of a camera.

    A ray leaves the sequence if it misses the next face or first meets another. It then passes with weight 0, as do
    rays stopped by an aperture or the stop.

    Parameters
    ----------
    tables : Tables
    path : Itinerary
        Over faces of the camera, see `faces_of`; of its lens, array, cover or all of them.
    p, d : (n, 3) float64
        Position, mm, before the first face, and unit direction; camera frame.
    weight : (n,) float64, optional
        Power of each ray.
    colour : int
        Wavelength number.
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
        Wavelength number.
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
    """Return the tables of a lens reduced to consecutive faces.

    Parameters
    ----------
    lens : LensTables
    first, last : int
        First face, and end of the faces (excluded).
    """
    stop_space = lens.stop_space - first
    return lens._replace(
        surfaces=lens.surfaces[first:last], medium=lens.medium[first : last + 1],
        interfaces=of_faces(lens.interfaces, first, last),
        ring_slot=lens.ring_slot[first : last + 1], mount_slot=lens.mount_slot[first:last],
        stop_space=stop_space if 0 <= stop_space <= last - first else -1,
        gradients=of_spaces(lens.gradients, first, last),
    )  # fmt: skip


def without_apertures(lens: LensTables) -> LensTables:
    """Return the tables of a lens with unlimited apertures and an open stop."""
    surfaces = lens.surfaces.copy()
    surfaces["semi_diameter"] = np.inf
    return lens._replace(surfaces=surfaces, stop_space=-1, gradients=without_edges(lens.gradients))


def follow_route(camera: Camera, route: Route, rays: Array, legs: tuple[int, int], colour: int) -> Array:
    """Return the ends (END_ROWS, n) of rays along legs of a route, see `follow_rays`, without a book.

    Parameters
    ----------
    camera : Camera
    route : Route
    rays : (7, n) float64
    legs : (2,) int
        First leg, and end of the legs (excluded).
    colour : int
        Wavelength number.
    """
    count = rays.shape[1]
    ends = np.zeros((END_ROWS, count))
    follow_rays(
        rays, ends, np.arange(count), np.array([0, count]), np.array(legs), camera, route, colour,
        unread_book(camera.lens, camera.mla, camera.cover), empty_bundle(),
    )  # fmt: skip
    return ends


def unread_book(*regions: LensTables | MlaTables | CoverTables | None) -> Array:
    """Return a book with a slot for all absorption in parts of a camera, not to be read."""
    there = [region for region in regions if region is not None]
    slots = [slots_of(region.interfaces) for region in there]
    slots += [region.media.absorption.slot for region in there if region.media.absorption is not None]
    return np.zeros(1 + max(int(each.max(initial=0)) for each in slots))


def etendue_factors(tables: Tables, p: Array, d: Array, colour: int = 0) -> Array:
    """Return the divisors (n,) of radiance by thin lenses, from object space to behind the lens.

    Parameters
    ----------
    tables : Tables
    p, d : (n, 3) float64
        Position, mm, before the lens, and unit direction; camera frame. Apertures are ignored.
    colour : int
        Wavelength number.
    """
    if not tables.lens.interfaces.thin:
        return np.ones(len(p))
    camera = tables._replace(lens=without_apertures(tables.lens)).camera
    rays = np.ones((RAY_WEIGHT + 1, len(p)))
    rays[:3], rays[3:6] = p.T, d.T
    route = route_of(faces_of(tables).legs(image_path(len(camera.lens.surfaces))), checked=False)
    return follow_route(camera, route, rays, (0, 1), colour)[RAY_ETENDUE]
