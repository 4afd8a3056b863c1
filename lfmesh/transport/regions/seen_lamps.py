"""Shares of lamps in the packets of the forward method, where there are many: by their light on what the camera sees.

Rays of the field find places of targets. Half of the lamps' packets are shared by the irradiance of these places, as if
nothing cast a shadow; the other half, as all of them where lamps are few, by the power towards all targets. So no lamp
that lights something is left out, and packets of none are more than twice as heavy as by the latter alone.
"""

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry import frame
from lfmesh.geometry.objects.round_faces import RoundFaces, first_round, round_normal
from lfmesh.geometry.ray import Ray, along
from lfmesh.kernels.decorators import kernel
from lfmesh.scene import FirstOrder
from lfmesh.scene.advice import half_field_mm
from lfmesh.transport.lights.lamps import illuminate
from lfmesh.transport.packets.packet import CAMERA_FRAME, OBJECT_FRAME
from lfmesh.transport.regions.embree import Finder
from lfmesh.transport.tables.lamp_tree import MOST_ASKED
from lfmesh.transport.tables.lights import Lamps
from lfmesh.transport.tables.tables import ObjectTables

Array = NDArray[np.float64]

ACROSS = 24
"""Number of rays along each side of the field."""

OF_SEEN = 0.5
"""Share of the lamps' packets that follows the light on what the camera sees."""

FAR_FOCUS = 1e3
"""Distance of the plane at which the field is taken, in focal lengths, where the camera focuses at infinity."""


def with_seen_lamps(objects: ObjectTables, facts: FirstOrder, frames: Array, finder: Finder) -> ObjectTables:
    """Return tables whose lamps start packets by their light on what the camera sees; the same where lamps are few.

    Parameters
    ----------
    objects : ObjectTables
    facts : FirstOrder
    frames : (6, 6, 3, 4) float64
        See `frame_table`.
    finder : Finder
        Of object space.
    """
    sources, own = objects.sources.copy(), np.flatnonzero(objects.sources["light"] >= 0)
    if len(own) <= MOST_ASKED:
        return objects
    places, normals = _seen_places(objects, facts, frames, finder)
    light = np.zeros(len(objects.lamps.rows))
    _fill_light(objects.lamps, places, normals, light)
    light = light[sources["light"][own]]
    if not light.sum() > 0.0:
        return objects
    share = sources["share"][own]
    sources["share"][own] = (1.0 - OF_SEEN) * share + OF_SEEN * share.sum() * (light / light.sum())
    sources["until"] = np.cumsum(sources["share"])
    return objects._replace(sources=sources)


def _seen_places(
    objects: ObjectTables, facts: FirstOrder, frames: Array, finder: Finder
) -> tuple[Array, Array]:  # fmt: skip
    """Return places of targets in the field, (n, 3) mm, and unit normals on the side that is seen, object frame."""
    far = facts.object_distance_mm if np.isfinite(facts.object_distance_mm) else FAR_FOCUS * abs(facts.efl_mm)
    width, height = half_field_mm(-far, facts)
    along = (2.0 * np.arange(ACROSS) + 1.0) / ACROSS - 1.0
    x, y = np.meshgrid(width * along, height * along)
    ends = np.stack([x.ravel(), y.ravel(), np.full(x.size, -far)], axis=1)
    move = frames[CAMERA_FRAME, OBJECT_FRAME]
    start = frame.points(move, np.zeros((len(ends), 3)))
    d = frame.directions(move, ends / np.linalg.norm(ends, axis=1, keepdims=True))
    found = finder.find(start.astype(np.float32), d.astype(np.float32))
    facets = objects.facets[np.maximum(found, 0)]
    normal, offset = facets["normal"], facets["offset"]
    cosine = np.einsum("ij,ij->i", normal, d)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (offset - np.einsum("ij,ij->i", normal, start)) / cosine
    seen = (found >= 0) & (facets["body"] >= 0) & np.isfinite(t) & (t > 0.0)
    facing = -np.sign(cosine)[:, None] * normal
    if objects.rounds is not None:
        t = np.where((found >= 0) & np.isfinite(t) & (t > 0.0), t, np.inf)
        _meet_rounds(objects.rounds, start, d, t, facing, seen)
    return (start + t[:, None] * d)[seen], facing[seen]


@kernel
def _meet_rounds(
    rounds: RoundFaces, starts: Array, directions: Array, t: Array, facing: Array, seen: NDArray[np.bool_]
) -> None:
    """Enter the round faces that rays meet before a distance: their distance, normal towards the start, and `seen`."""
    for i in range(len(starts)):
        ray = Ray(starts[i, 0], starts[i, 1], starts[i, 2], directions[i, 0], directions[i, 1], directions[i, 2])
        number, nearest, steepness = first_round(rounds, None, ray, -1, t[i])
        if number >= 0:
            x, y, z = along(ray, nearest)
            nx, ny, nz = round_normal(rounds.faces[number], x, y, z)
            side = -1.0 if steepness > 0.0 else 1.0
            t[i], seen[i] = nearest, True
            facing[i, 0], facing[i, 1], facing[i, 2] = side * nx, side * ny, side * nz


@kernel
def _fill_light(lamps: Lamps, places: Array, normals: Array, light: Array) -> None:
    """Fill in the irradiance that each lamp brings to some places, summed."""
    for number in range(len(lamps.rows)):
        for i in range(len(places)):
            place = places[i, 0], places[i, 1], places[i, 2]
            ux, uy, uz, _, irradiance = illuminate(lamps.profiles, lamps.rows[number], place, 0.5, 0.5, False)
            cosine = normals[i, 0] * ux + normals[i, 1] * uy + normals[i, 2] * uz
            if cosine > 0.0 and irradiance < np.inf:
                light[number] += irradiance * cosine
