"""Shares of many lights in the packets of the forward method, by their light on surfaces in view.

Rays of the field find places on targets. Half of the packets are shared by the unshadowed irradiance that each light
brings to these places, and to the eye if the light stands in the field. The other half, or all packets if lights are
few, follows the power towards all targets. So no light is left out, and packets are at most twice as heavy as with the
second rule alone.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry import frame
from lfmesh.geometry.objects.round_faces import FLAT
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.scene import FirstOrder
from lfmesh.scene.advice import half_field_mm
from lfmesh.transport.lights.lamps import illuminate
from lfmesh.transport.packets.packet import CAMERA_FRAME, OBJECT_FRAME
from lfmesh.transport.regions.embree import Finder
from lfmesh.transport.regions.first_met import first_met
from lfmesh.transport.tables.lamp_tree import MOST_ASKED
from lfmesh.transport.tables.lights import MM2, Lamps
from lfmesh.transport.tables.tables import FIRST_VOLUME, ObjectTables

Array = NDArray[np.float64]

ACROSS = 24
"""Number of rays along each side of the field."""

MOST_PAIRS = 1 << 24
"""Largest number of lights times places; beyond it, fewer places are used."""

OF_SEEN = 0.5
"""Share of the packets drawn by the light on surfaces in view."""

FAR_FOCUS = 1e3
"""Distance of the plane of the field, in focal lengths, for a camera focused at infinity."""


EMITTING = np.dtype(
    [
        ("middle", "f8", (3,)),  # mm, object frame
        ("normal", "f8", (3,)),  # unit normal of a facet; 0: it shines equally in all directions
        ("both", "?"),  # it shines on both sides
        ("in_field", "?"),
        ("size2", "f8"),  # mm², square of its size, the least distance assumed
        ("power", "f8"),  # W
    ]
)
"""Emitting facet or medium, reduced to a point with its power."""


def with_seen_lights(objects: ObjectTables, facts: FirstOrder, frames: Array, finder: Finder) -> ObjectTables:
    """Return tables with lights drawn by their light on surfaces in view; unchanged if lights are few.

    Parameters
    ----------
    objects : ObjectTables
    facts : FirstOrder
    frames : (6, 6, 3, 4) float64
        See `frame_table`.
    finder : Finder
        Finder of object space.
    """
    sources = objects.sources.copy()
    if len(sources) <= MOST_ASKED:
        return objects
    places, normals, eye = _seen_places(objects, facts, frames, finder)
    emits = sources["light"] < 0
    light, of_lamps = np.zeros(len(sources)), np.zeros(len(objects.lamps.rows))
    if not emits.all():
        _fill_from_lamps(objects.lamps, places, normals, of_lamps)
        light[~emits] = of_lamps[sources["light"][~emits]]
    if emits.any():
        emitting = _emitting(objects, sources[emits])
        emitting["in_field"] = _in_field(emitting, facts, frames)
        own = np.zeros(len(emitting))
        _fill_emitted(emitting, places, normals, eye, own)
        light[emits] = own
    if not light.sum() > 0.0:
        return objects
    sources["share"] = (1.0 - OF_SEEN) * sources["share"] + OF_SEEN * (light / light.sum())
    sources["until"] = np.cumsum(sources["share"])
    return objects._replace(sources=sources)


def _seen_places(
    objects: ObjectTables, facts: FirstOrder, frames: Array, finder: Finder
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Return places on targets in the field, and the eye, object frame.

    Returns
    -------
    places, normals : (n, 3) float64
        mm, and unit normals on the visible side.
    eye : (4,) float64
        Vertex of the lens, mm, and the weight of irradiance at the eye relative to irradiance at a place.
    """
    far = _distance_mm(facts)
    width, height = half_field_mm(-far, facts)
    steps = (2.0 * np.arange(ACROSS) + 1.0) / ACROSS - 1.0
    x, y = np.meshgrid(width * steps, height * steps)
    ends = np.stack([x.ravel(), y.ravel(), np.full(x.size, -far)], axis=1)
    move = frames[CAMERA_FRAME, OBJECT_FRAME]
    starts = frame.points(move, np.zeros((len(ends), 3)))
    d = frame.directions(move, ends / np.linalg.norm(ends, axis=1, keepdims=True))
    facet, t, normal = first_met(objects, finder, starts, d)
    seen = np.flatnonzero((facet >= 0) & (np.append(objects.facets["body"], -1)[facet] >= 0))
    few = max(MOST_PAIRS // len(objects.sources), 1)
    # Take every n-th place: the first ones would leave out the lower part of the field.
    some = seen[:: max(-(-len(seen) // few), 1)]
    facing = -np.sign(np.einsum("ij,ij->i", normal[some], d[some]))[:, None] * normal[some]
    # A light in the field is seen by all rays in its solid angle; a place, by its irradiance over π.
    per_ray = 4.0 * width * height / (len(ends) * far * far)
    of_eye = np.pi / per_ray * len(some) / max(len(seen), 1)
    return starts[some] + t[some, None] * d[some], facing, np.append(starts[0], of_eye)


def _distance_mm(facts: FirstOrder) -> float:
    """Return the distance of the plane at which the field is taken."""
    focused = facts.object_distance_mm
    return focused if np.isfinite(focused) else FAR_FOCUS * abs(facts.efl_mm)


def _emitting(objects: ObjectTables, sources: NDArray[np.void]) -> NDArray[np.void]:
    """Return the facets and media of some sources, (n,) EMITTING, without `in_field`."""
    found, facet = np.zeros(len(sources), EMITTING), sources["facet"]
    found["power"] = sources["power"]
    is_volume = facet <= FIRST_VOLUME
    if not is_volume.all():
        own, rows = found[~is_volume], objects.facets[facet[~is_volume]]
        own["middle"], own["normal"] = rows["corners"].mean(axis=1), rows["normal"]
        own["both"] = ~objects.one_sided[rows["body"]]
        own["size2"] = ((rows["corners"] - own["middle"][:, None]) ** 2).sum(axis=2).max(axis=1)
        own["power"] = np.minimum(own["power"], _by_texture(objects, sources[~is_volume]))
        found[~is_volume] = own
    if objects.rounds is not None:
        is_round = ~is_volume & (facet >= objects.rounds.first)
        own, faces = found[is_round], objects.rounds.faces[facet[is_round] - objects.rounds.first]
        own["middle"], own["size2"] = faces["centre"], faces["radius"] ** 2 + faces["half"] ** 2
        own["normal"] = np.where((faces["kind"] == FLAT)[:, None], faces["axes"][:, 2], 0.0)
        found[is_round] = own
    if is_volume.any():
        own, rows = found[is_volume], objects.volumes.rows[FIRST_VOLUME - facet[is_volume]]
        centre = 0.5 * (rows["low"] + rows["high"]) - rows["to_own"][:, :, 3]
        # The frame's axes are orthogonal: the transposed matrix is the inverse one.
        own["middle"] = np.einsum("ikj,ik->ij", rows["to_own"][:, :, :3], centre)
        own["size2"] = ((rows["high"] - rows["low"]) ** 2).sum(axis=1) / 12.0
        found[is_volume] = own
    return found


def _by_texture(objects: ObjectTables, sources: NDArray[np.void]) -> Array:
    """Return the approximate power of textured emitting facets, W; inf for a facet outside the table of pieces."""
    emitters, facet = objects.emitters, sources["facet"]
    if not len(emitters.facet):
        return np.full(len(sources), np.inf)
    chance = np.ones(len(emitters.facet))
    if len(emitters.nodes):
        leaves = emitters.nodes[emitters.nodes["right"] == 0]
        chance = np.repeat(leaves["power"], leaves["end"] - leaves["begin"])
    # The pieces of a facet have equal sizes.
    pieces = emitters.density * chance / 4.0 ** emitters.level[emitters.facet]
    share = np.bincount(emitters.facet, pieces, len(objects.facets))[facet] * _areas(objects)[facet]
    with np.errstate(divide="ignore", invalid="ignore"):
        whole = sources["power"] / share
    # A facet without a texture has its whole power; if all have one, the brightest counts as white.
    return np.where(share > 0.0, share, 0.0) * np.min(whole[share > 0.0], initial=np.inf)


def _areas(objects: ObjectTables) -> Array:
    """Return the areas of all facets, mm²."""
    edges = objects.facets["corners"][:, 1:] - objects.facets["corners"][:, :1]
    areas = 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    if objects.rounds is not None:
        areas[objects.rounds.first :] = objects.rounds.faces["area"]
    return np.asarray(areas)


def _in_field(emitting: NDArray[np.void], facts: FirstOrder, frames: Array) -> NDArray[np.bool_]:
    """Return a mask of the emitters in the field."""
    x, y, z = frame.points(frames[OBJECT_FRAME, CAMERA_FRAME], emitting["middle"]).T
    # The edges of the field are straight beyond the focal plane; nearer, a wider field does no harm.
    far = _distance_mm(facts)
    planes = np.array([0.0, far, 2.0 * far])
    width, height = np.transpose([half_field_mm(-float(plane), facts) for plane in planes])
    half = [np.interp(-z, planes, each) * np.maximum(-z / planes[-1], 1.0) for each in (width, height)]
    size = np.sqrt(emitting["size2"])
    return np.asarray((z < 0.0) & (np.abs(x) <= half[0] + size) & (np.abs(y) <= half[1] + size))


@kernel
def _fill_from_lamps(lamps: Lamps, places: Array, normals: Array, light: Array) -> None:
    """Sum the irradiance that each lamp brings to some places; no ray meets or sees a lamp."""
    for number in range(len(lamps.rows)):
        for i in range(len(places)):
            place = places[i, 0], places[i, 1], places[i, 2]
            ux, uy, uz, _, irradiance = illuminate(lamps.profiles, lamps.rows[number], place, 0.5, 0.5, False)
            cosine = normals[i, 0] * ux + normals[i, 1] * uy + normals[i, 2] * uz
            if cosine > 0.0 and irradiance < np.inf:
                light[number] += irradiance * cosine


@kernel
def _fill_emitted(emitting: NDArray[np.void], places: Array, normals: Array, eye: Array, light: Array) -> None:
    """Sum the irradiance that each emitter brings to places and, if it stands in the field, to the eye."""
    for number in range(len(emitting)):
        own, whole = emitting[number], 0.0
        for i in range(len(places)):
            at, facing = (places[i, 0], places[i, 1], places[i, 2]), (normals[i, 0], normals[i, 1], normals[i, 2])
            whole += _per_watt(own, at, facing)
        if own.in_field:
            whole += eye[3] * _per_watt(own, (eye[0], eye[1], eye[2]), (0.0, 0.0, 0.0))
        light[number] = own.power * whole


@inlined
def _per_watt(own: Any, at: tuple[float, float, float], facing: tuple[float, float, float]) -> float:
    """Return the approximate irradiance per watt that an emitter brings to a place, 1/m².

    `facing` is the place's unit normal, or 0 if all light counts.
    """
    normal = own.normal
    vx, vy, vz = own.middle[0] - at[0], own.middle[1] - at[1], own.middle[2] - at[2]
    d2 = vx * vx + vy * vy + vz * vz
    if not d2 > 0.0:
        return 0.0
    far, cosine, per_sr = np.sqrt(d2), 1.0, 0.25 / np.pi
    if facing[0] != 0.0 or facing[1] != 0.0 or facing[2] != 0.0:
        cosine = (facing[0] * vx + facing[1] * vy + facing[2] * vz) / far
    if normal[0] != 0.0 or normal[1] != 0.0 or normal[2] != 0.0:
        away = -(normal[0] * vx + normal[1] * vy + normal[2] * vz) / far
        per_sr = (0.5 * abs(away) if own.both else away) / np.pi
    return max(cosine, 0.0) * max(per_sr, 0.0) / (MM2 * max(d2, own.size2))
