"""Sources of forward packets: lamps, emitting facets and media, and the sphere at which lamps are aimed.

The sphere rests relative to the camera and holds its goals throughout the exposure. A lamp that moves gets packets by
its mean power towards the sphere.
"""

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import SceneError
from lfmesh.geometry.meshes.mesh import Array, Mesh, facet_normals
from lfmesh.geometry.objects.round_faces import FLAT, ROUND, WALL, boxes_of
from lfmesh.scene import Scene
from lfmesh.transport.packets.packet import CAMERA_FRAME, OBJECT_FRAME
from lfmesh.transport.tables.bending_fields import boxes_of_fields
from lfmesh.transport.tables.emitting_facets import mean_emissions
from lfmesh.transport.tables.lights import MM2, power_towards
from lfmesh.transport.tables.motions import STILL, Motions
from lfmesh.transport.tables.swept import swept
from lfmesh.transport.tables.tables import AIR, FIRST_VOLUME, OPAQUE, ROUGH, SOURCE, LensTables, ObjectTables
from lfmesh.transport.tables.volumes import Volumes

Entry = tuple[int, int, float, float]
"""Light (or −1), facet (or −1), power towards the sphere aimed at, whole power, W."""


def sources_of(
    scene: Scene, objects: ObjectTables, mesh: Mesh, motions: Motions | None = None
) -> NDArray[np.void]:  # fmt: skip
    """Return the sources of a scene, (n,) SOURCE.

    Parameters
    ----------
    scene : Scene
    objects : ObjectTables
        Tables without the sources.
    mesh : Mesh
        Mesh of targets and housing, object frame.
    motions : Motions, optional

    Raises
    ------
    SceneError
        The forward method would have to start light throughout an unbounded medium.
    """
    entries = [*_lamps(objects, motions), *_emitting_facets(objects, mesh), *_emitting_volumes(scene, objects.volumes)]
    return _sources(entries)


def aimed_at_glass(objects: ObjectTables, motions: Motions | None = None) -> ObjectTables | None:
    """Return tables that start forward packets from lamps alone, aimed at the glass.

    Media that bend light count as glass. None if no packet is needed: without lamps, without smooth glass, or without
    anything that scatters.
    """
    glass, rough, facets = _glass(objects)
    used = objects.model[np.append(~glass, False)[objects.facets["body"]]]
    black = objects.scattering.models["black"][used].all() and not rough.any()
    in_fog = objects.volumes is not None and objects.volumes.scatters
    fields = boxes_of_fields(objects.fields).reshape(-1, 3)
    if not len(objects.lamps.rows) or not (facets.any() or len(fields)) or (black and not in_fog):
        return None
    return _aimed_at(objects, facets, fields, motions)


def aimed_at_camera(
    objects: ObjectTables, lens: LensTables, frames: Array, motions: Motions | None = None
) -> ObjectTables | None:
    """Return tables that start forward packets from lamps alone, aimed at the front of the lens.

    Smooth glass and media in object space may bend light into the lens, so they are aimed at too. None without lamps.

    Parameters
    ----------
    objects : ObjectTables
    lens : LensTables
    frames : (6, 6, 3, 4) float64
        See `frame_table`.
    motions : Motions, optional
    """
    if not len(objects.lamps.rows):
        return None
    front = lens.facets["corners"][lens.facets["body"] == 0].reshape(-1, 3)
    move = frames[CAMERA_FRAME, OBJECT_FRAME]
    front = front @ move[:, :3].T + move[:, 3]
    points = np.concatenate([front, boxes_of_fields(objects.fields).reshape(-1, 3)])
    return _aimed_at(objects, _glass(objects)[2], points, motions)


def _glass(objects: ObjectTables) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return masks of the bodies of glass, of the rough ones among them, and of the facets of smooth glass."""
    glass = objects.medium != OPAQUE
    # Read the finish from a body's row for the surrounding medium.
    rough = np.zeros(len(glass), np.bool_)
    if objects.glass is not None:
        kinds = objects.glass.interfaces.rows["kind"].reshape(len(glass), len(objects.media.indices))
        rough = glass & (kinds[:, AIR] >= ROUGH)
    return glass, rough, np.append(glass & ~rough, False)[objects.facets["body"]]


def _aimed_at(
    objects: ObjectTables, facets: NDArray[np.bool_], points: Array, motions: Motions | None
) -> ObjectTables:  # fmt: skip
    """Return tables with only lamps as sources, aimed at a sphere round some facets and points, mm, object frame.

    The points rest relative to the camera.
    """
    if motions is None:
        middle, radius = _sphere_round(objects, facets, points)
    else:
        middle, radius = _sphere_round_paths(objects, facets, points, motions)
    objects = objects._replace(lit_middle=middle, lit_radius=radius)
    return objects._replace(sources=_sources(_lamps(objects, motions)))


def _sphere_round_paths(
    objects: ObjectTables, facets: NDArray[np.bool_], points: Array, motions: Motions
) -> tuple[Array, float]:
    """Return centre and radius of a sphere that holds facets and points throughout the exposure, mm, object frame."""
    movers = motions.of_target[objects.facets["body"]]
    centres, radii = [np.zeros((0, 3))], [np.zeros(0)]
    for mover in np.unique(np.append(movers[facets], STILL)):
        own, also = facets & (movers == mover), points[: len(points) if mover == STILL else 0]
        if not own.any() and not len(also):
            continue
        middle, radius = _sphere_round(objects, own, also)
        # A turn about the centre of its sphere does not move a body out of it.
        places, margin = swept(motions, int(mover), middle[None])
        centres.append(places)
        radii.append(np.full(len(places), radius + margin))
    places, reach = np.concatenate(centres), np.concatenate(radii)
    middle = 0.5 * ((places - reach[:, None]).min(axis=0) + (places + reach[:, None]).max(axis=0))
    return middle, float((np.linalg.norm(places - middle, axis=1) + reach).max())


def _sphere_round(objects: ObjectTables, facets: NDArray[np.bool_], points: Array) -> tuple[Array, float]:
    """Return centre and radius of a sphere round some facets and points at t = 0, mm, object frame."""
    met = facets if objects.rounds is None else facets[: objects.rounds.first]
    ends = [points, objects.facets["corners"][: len(met)][met].reshape(-1, 3)]
    faces = np.zeros(0, ROUND) if objects.rounds is None else objects.rounds.faces[facets[objects.rounds.first :]]
    # The wall of a cylinder reaches as far as its ends.
    faces = faces[faces["kind"] != FLAT]
    corners = np.vstack([*ends, *boxes_of(faces)])
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    reach = np.where(faces["kind"] == WALL, np.hypot(faces["radius"], faces["half"]), faces["radius"])
    far = np.linalg.norm(faces["centre"] - middle, axis=1) + reach
    return middle, max(float(each.max(initial=0.0)) for each in (np.linalg.norm(np.vstack(ends) - middle, axis=1), far))


def _lamps(objects: ObjectTables, motions: Motions | None) -> list[Entry]:
    """Return the sources of the lights: power towards the sphere aimed at, and whole power."""
    middle, radius = objects.lit_middle, objects.lit_radius
    entries = []
    for number, light in enumerate(objects.lamps.rows):
        towards, whole = power_towards(light, middle, radius)
        if light["placed"] and light["mover"] != STILL:
            towards = _mean_towards(light, middle, radius, motions)
        entries.append((number, -1, towards, whole))
    return entries


def _mean_towards(light: np.void, middle: Array, radius: float, motions: Motions | None) -> float:
    """Return the mean over places on a lamp's path of the bound of its power towards the sphere, W."""
    moved, found = light.copy(), []
    for place in swept(motions, int(light["mover"]), light["position"][None])[0]:
        moved["position"] = place
        found.append(power_towards(moved, middle, radius)[0])
    return float(np.mean(found))


def _emitting_facets(objects: ObjectTables, mesh: Mesh) -> list[Entry]:
    """Return the sources of emitting targets, one per facet."""
    entries = []
    emission = mean_emissions(objects)
    most = np.maximum(emission[:, 0], emission.sum(axis=1)).max(axis=1, initial=0.0)
    largest = objects.radiance.max(axis=1, initial=0.0)
    areas = facet_normals(mesh)[1]
    if objects.rounds is not None:
        areas = np.append(areas, objects.rounds.faces["area"])
    for facet in np.flatnonzero(np.append(most > 0.0, False)[objects.facets["body"]]):
        body = objects.facets["body"][facet]
        area, sides = np.pi * areas[facet] * MM2, 1.0 if objects.one_sided[body] else 2.0
        entries.append((-1, int(facet), most[body] * area, largest[body] * area * sides))
    return entries


def _emitting_volumes(scene: Scene, volumes: Volumes | None) -> list[Entry]:
    """Return the sources of emitting media.

    Raises
    ------
    SceneError
        The forward method would have to start light throughout an unbounded medium.
    """
    entries: list[Entry] = []
    if volumes is None:
        return entries
    for number in range(len(scene.media)):
        power = float(volumes.powers[number])
        if np.isfinite(power) and power > 0.0:
            entries.append((-1, FIRST_VOLUME - number, power, power))
        elif power > 0.0 and scene.transport.method == "forward":
            raise SceneError(
                f'media[{number}]: emits without bounds, so method = "forward" cannot start light in it; give it '
                'bounds, or use method = "adjoint"'
            )
    return entries


def _sources(entries: list[Entry]) -> NDArray[np.void]:
    """Return the table of forward sources, with shares of the packets by the power towards the targets."""
    table = np.zeros(len(entries), SOURCE)
    if entries:
        table["light"], table["facet"], table["share"], table["power"] = zip(*entries, strict=True)
        reaching = table["share"].sum()
        # If no power reaches the sphere, shares are equal: the ledger books their power all the same.
        table["share"] = table["share"] / reaching if reaching > 0.0 else 1.0 / len(table)
        table["until"] = np.cumsum(table["share"])
    return table
