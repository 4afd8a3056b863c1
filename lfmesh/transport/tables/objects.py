"""Tables of object space: targets, lights, the sources of forward packets, and the camera's housing."""

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import SceneError
from lfmesh.geometry.lens.lens_shape import LensShape
from lfmesh.geometry.meshes.levels import PATCH, SURFACE_LEVEL
from lfmesh.geometry.meshes.mesh import FACET, Array, Mesh, facet_normals, facet_table, joined
from lfmesh.geometry.meshes.patch_tree import patch_tree
from lfmesh.geometry.objects.round_faces import ROUND, RoundFaces, boxes_of, round_faces
from lfmesh.geometry.objects.targets import TargetMesh
from lfmesh.geometry.objects.texture import Texture, is_grey
from lfmesh.geometry.surfaces.bends import rim_hull
from lfmesh.geometry.surfaces.tessellation import revolved
from lfmesh.optics.rgb_spectra import primary_reflectances
from lfmesh.scene import Scene
from lfmesh.scene.materials.coatings import UNCOATED
from lfmesh.transport.packets.book import LOST_OUTSIDE, Book
from lfmesh.transport.packets.packet import CAMERA_FRAME, OBJECT_FRAME, SENSOR_FRAME, WORLD_FRAME
from lfmesh.transport.tables.bending_fields import BendingFields, boxes_of_fields
from lfmesh.transport.tables.contacts import CUT, contacts, touching_mm
from lfmesh.transport.tables.emitting_facets import emitter_table, no_emitters
from lfmesh.transport.tables.facet_models import facet_models
from lfmesh.transport.tables.forward_sources import sources_of
from lfmesh.transport.tables.frames import frame_table
from lfmesh.transport.tables.hosts import Hosts, hosts_of
from lfmesh.transport.tables.lens import curved
from lfmesh.transport.tables.lights import light_tables
from lfmesh.transport.tables.lines import Lines
from lfmesh.transport.tables.media import MediumList
from lfmesh.transport.tables.motions import Motions
from lfmesh.transport.tables.single_scatter import single_scatter_tables
from lfmesh.transport.tables.spectra import radiance_at, reflectance_at
from lfmesh.transport.tables.tables import (
    AIR,
    BY_ALPHA,
    OPAQUE,
    SOURCE,
    GlassTables,
    Interfaces,
    ObjectTables,
)
from lfmesh.transport.tables.varied_gloss import VariedGloss
from lfmesh.transport.tables.volumes import BY_TEMPERATURE, NOWHERE, OF_BODY, reach_of, volume_tables


def middle_of(targets: list[TargetMesh]) -> Array:
    """Return the middle of the targets' bounding box in the world frame."""
    if not targets:
        return np.zeros(3)
    boxes = np.array([target.box_mm for target in targets])
    return np.asarray(0.5 * (boxes[:, 0].min(axis=0) + boxes[:, 1].max(axis=0)))


def housing_mesh(scene: Scene, shape: LensShape) -> Mesh:
    """Return the camera's housing: a plate around the first rim, the barrel, and the body around array and sensor."""
    hulls = [rim_hull(surface, rim) for surface, rim in zip(shape.surfaces, shape.rims, strict=True)]
    rim, barrel = shape.rims[0], 1.05 * max(shape.rims)
    if shape.surfaces["posed"].any():
        # Posed elements widen the hole in the plate and the barrel.
        reaches = [float(np.hypot(hull[:, 0], hull[:, 1]).max()) for hull in hulls]
        rim, barrel = reaches[0], 1.05 * max(reaches)
    # No rim stands behind the plate.
    front, back = float(hulls[0][:, 2].max()), float(hulls[-1][:, 2].max())
    moves = frame_table(scene, np.zeros(3))
    corners = [np.multiply(0.5, scene.camera.sensor.size_mm)]
    if scene.camera.mla is not None:
        corners.append(np.multiply(0.5, scene.camera.mla.size_mm))
    body = max(barrel, 1.1 * max(float(np.hypot(*corner)) for corner in corners))
    end = float(moves[SENSOR_FRAME, CAMERA_FRAME, 2, 3]) + 0.5 * body
    back = max(back, front)
    profile = [[rim, front], [barrel, front], [barrel, back], [body, back], [body, end], [0.0, end]]
    mesh = revolved(np.array(profile), shape.azimuths)
    return Mesh(mesh.vertices, mesh.faces[facet_normals(mesh)[1] > 0.0])


def object_tables(
    scene: Scene, targets: list[TargetMesh], housing: Mesh, moves: Array,
    book: Book, lines: Lines, interfaces: Interfaces, known: MediumList,
    ranks: NDArray[np.int64],
) -> tuple[Mesh, ObjectTables]:  # fmt: skip
    """Return targets and housing as one mesh in the object frame, for Embree, and their tables.

    Parameters
    ----------
    scene : Scene
    targets : list of TargetMesh
        World frame.
    housing : Mesh
        Camera frame.
    moves : (6, 6, 3, 4) float64
        See `frame_table`.
    book : Book
    lines : Lines
    interfaces : Interfaces
        One row for each target.
    known : MediumList
        Media of the scene.
    ranks : (targets,) int64
        See `ObjectTables.rank`.
    """
    wavelengths_nm = lines.wavelengths_nm
    to_object = moves[WORLD_FRAME, OBJECT_FRAME]
    parts = [t.met_mesh.moved(to_object) for t in targets]
    mesh = joined([*parts, housing.moved(moves[CAMERA_FRAME, OBJECT_FRAME])])
    rounds = _rounds(targets, to_object, len(mesh.faces))
    facets = _facets(mesh, [*parts, housing], rounds)
    bodies = facets["body"]
    uv = np.zeros((len(facets), 3, 2))
    texture = np.zeros((len(targets), 3), np.int64)
    weights = np.array([primary_reflectances(w) for w in wavelengths_nm])
    texels: list[NDArray[np.float32]] = []
    filled = 0
    for i, target in enumerate(targets):
        if target.texture is None or (target.round is None and target.uv is None):
            continue
        if target.round is None:
            uv[bodies == i] = target.uv
        height, width = target.texture.shape[:2]
        texture[i] = filled, height, width
        texels.append(_texels(target.texture, weights, lines.in_bands))
        filled += height * width
    materials = [t.material for t in scene.targets]
    alphas = [t.alpha.ravel() if t.alpha is not None else np.zeros(0, np.float32) for t in targets]
    radius = _radius(targets, parts, moves[OBJECT_FRAME, WORLD_FRAME][:, 3])
    glasses = [t.refractor for t in scene.targets]
    medium = np.array([known.of_body(g) if g is not None else OPAQUE for g in glasses], dtype=np.int64)
    level = np.array([SURFACE_LEVEL[g.level] if g is not None else 0 for g in glasses], dtype=np.int64)
    patches, across = curved(bool((level == PATCH).any()), mesh)
    # Target of each rank, from 1; the entry of rank 0 is unused.
    by_rank = np.zeros(int(ranks.max(initial=0)) + 1, np.int64)
    by_rank[ranks[ranks > 0]] = np.flatnonzero(ranks)
    first, partners, near = contacts([target.met_mesh for target in targets], ranks > 0, len(facets))
    _refuse_touched_finishes(scene, bodies, first)
    reflectances = [reflectance_at(scene, i, wavelengths_nm) for i in range(len(targets))]
    radiance = np.array([radiance_at(scene, i, lines) for i in range(len(targets))]).reshape(-1, len(wavelengths_nm))
    media = known.table_of_objects(wavelengths_nm, book, medium.tolist())
    # A black body in a medium has n² times its radiance in air.
    radiance[[m.temperature_k is not None for m in materials]] *= media.indices[AIR] ** 2
    hosts = hosts_of(scene, targets, ranks, medium, media)
    models = facet_models(scene, targets, hosts, wavelengths_nm, reflectances)
    largest = radiance.max(axis=1, keepdims=True, initial=0.0)
    tree = patch_tree(patches, facets["corners"], facets["body"], _of_smooth_patches(scene, facets["body"], level))
    glass = GlassTables(
        interfaces,
        level,
        patches,
        across,
        tree,
        first,
        partners,
        near,
        _boxes(parts, rounds, ranks > 0, level),
        _emitters_inside(scene, targets, hosts),
        models.in_media,
    )
    tables = ObjectTables(
        facets=facets,
        uv=uv,
        one_sided=np.array(
            [
                (t.closed and t.alpha is None and m.opacity == 1.0)
                # The black side of a hot sheet emits.
                or (m.sides == "front" and m.temperature_k is None)
                for t, m in zip(targets, materials, strict=True)
            ],
            dtype=np.bool_,
        ),
        scattering=models.scattering,
        model=_models(models.of_facets, len(housing.faces), rounds),
        varied=_with_rounds(models.varied, len(housing.faces), rounds),
        smooth=np.array([t.smooth for t in targets], dtype=np.bool_),
        radiance=radiance,
        emission_spectra=np.divide(radiance, largest, out=np.zeros_like(radiance), where=largest > 0.0),
        media=media,
        medium=medium,
        rank=ranks,
        by_rank=by_rank,
        texture=texture,
        texels=np.concatenate(texels) if texels else np.zeros((0, weights.shape[1]), np.float32),
        texel_weights=weights if lines.in_bands else np.zeros((0, 0)),
        opacity=np.array(
            [m.opacity if t.alpha is None else BY_ALPHA for t, m in zip(targets, materials, strict=True)],
            dtype=np.float64,
        ),
        alpha_first=np.cumsum([0, *(len(alpha) for alpha in alphas)])[:-1],
        alpha=np.concatenate([np.zeros(0, np.float32), *alphas]),
        target_slot=book.targets,
        lost_slot=np.append(book.lost_in_targets, LOST_OUTSIDE),
        lamps=light_tables(scene, to_object, lines),
        emitters=no_emitters(),
        sources=np.zeros(0, SOURCE),
        radius=radius,
        outer_radius=max(radius, float(np.linalg.norm(mesh.vertices, axis=1).max())),
        lit_middle=np.zeros(3),
        lit_radius=radius,
        glass=glass if (medium != OPAQUE).any() else None,
        rounds=rounds,
    )
    tables = with_volumes(tables, scene, targets, moves, book, lines)
    return mesh, tables._replace(emitters=emitter_table(tables), sources=sources_of(scene, tables, mesh))


def _rounds(targets: list[TargetMesh], to_object: Array, first: int) -> RoundFaces | None:
    """Return the exact round faces, object frame, numbered from `first` on; None if there are none."""
    none = np.zeros(0, ROUND)
    return round_faces([none if t.round is None else t.round.faces() for t in targets], to_object, first)


def _facets(mesh: Mesh, parts: list[Mesh], rounds: RoundFaces | None) -> NDArray[np.void]:
    """Return the facets of targets and housing, (m,) FACET, and an empty row for each round face.

    `mesh` joins `parts`: the targets and, last, the housing.
    """
    bodies = np.repeat([*range(len(parts) - 1), -1], [len(part.faces) for part in parts])
    facets = facet_table(mesh, bodies.astype(np.int64))
    if rounds is None:
        return facets
    rows = np.zeros(len(rounds.faces), FACET)
    rows["body"] = rounds.faces["body"]
    return np.concatenate([facets, rows])


def _models(of_facets: NDArray[np.int64], housing: int, rounds: RoundFaces | None) -> NDArray[np.int64]:
    """Return the scattering model's row for each facet: of targets, housing (0) and round faces, in this order."""
    own = np.zeros(0, np.int64) if rounds is None else rounds.faces["body"]
    return np.concatenate([of_facets, np.zeros(housing, np.int64), own])


def _with_rounds(varied: VariedGloss, housing: int, rounds: RoundFaces | None) -> VariedGloss:
    """Return the tables of varied gloss, extended by rows without gloss for the round faces."""
    if rounds is None or not len(varied.ranges):
        return varied
    return varied._replace(range_of=np.append(varied.range_of, np.full(housing + len(rounds.faces), -1)))


def _radius(targets: list[TargetMesh], parts: list[Mesh], middle: Array) -> float:
    """Return the radius of a sphere round the origin of the object frame that holds the targets, mm.

    `parts` are in the object frame; `middle` is that frame's origin in the world.
    """
    meshed = (float(np.linalg.norm(part.vertices, axis=1).max()) for part in parts if len(part.vertices))
    return max([*meshed, *(t.round.farthest_mm(middle) for t in targets if t.round is not None)], default=0.0)


def _emitters_inside(scene: Scene, targets: list[TargetMesh], hosts: Hosts) -> NDArray[np.bool_]:
    """Return a mask of the targets from which the forward method starts light in bodies of glass, (targets,)."""
    forward = scene.transport.method == "forward"
    found = [
        forward and each.material.emits and hosts.along(target) != [None]
        for each, target in zip(scene.targets, targets, strict=True)
    ]
    return np.array(found, np.bool_)


def _boxes(
    bodies: list[Mesh], rounds: RoundFaces | None, is_glass: NDArray[np.bool_], level: NDArray[np.int64]
) -> Array:
    """Return the corners of enclosing boxes of bodies of glass, (n, 2, 3) mm; zeros for other targets.

    `rounds` holds the faces of bodies without a mesh, `level` the surface level of each body.
    """
    boxes = np.zeros((len(bodies), 2, 3))
    for i in np.flatnonzero(is_glass):
        body = bodies[i]
        if rounds is not None and not len(body.faces):
            low, high = (end for end in boxes_of(rounds.faces[rounds.faces["body"] == i]))
            low, high = low.min(axis=0), high.max(axis=0)
            slack = CUT * float((high - low).max())
            boxes[i] = low - slack, high + slack
            continue
        slack = touching_mm([body])
        if level[i] == PATCH:
            corners = body.vertices[body.faces]
            # An arc of less than half a turn bulges by less than half its chord.
            slack = 0.5 * float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max())
        boxes[i] = body.vertices.min(axis=0) - slack, body.vertices.max(axis=0) + slack
    return boxes


def _of_smooth_patches(scene: Scene, bodies: NDArray[np.int64], level: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return a mask of facets that light meets as curved patches, (m,); on rough bodies it meets the facets."""
    glasses = [target.refractor for target in scene.targets]
    polished = [glass is not None and not glass.finish.is_rough for glass in glasses]
    chosen = np.append((level == PATCH) & np.array(polished, np.bool_), False)[bodies]
    return np.asarray(chosen, np.bool_)


def _texels(texture: Texture, weights: Array, in_bands: bool) -> NDArray[np.float32]:
    """Return the texels of a texture, row by row: a value at every wavelength or, in bands, the primaries.

    Bands have too many wavelengths to keep a value for each. For `weights`, see `primary_reflectances`.
    """
    if in_bands:
        return texture.reshape(-1, 3)
    if is_grey(texture):
        # The three reflectances sum to 1 at every wavelength.
        return np.repeat(texture[:, :, 0].reshape(-1, 1), len(weights), axis=1)
    return texture.reshape(-1, 3) @ weights.T.astype(np.float32)


def with_volumes(
    tables: ObjectTables, scene: Scene, targets: list[TargetMesh], moves: Array, book: Book, lines: Lines
) -> ObjectTables:
    """Return the tables with media added, and with spheres enlarged to hold the media.

    Parameters
    ----------
    tables : ObjectTables
        Without media, at the wavelengths of the lines.
    scene : Scene
    targets : list of TargetMesh
        World frame.
    moves : (6, 6, 3, 4) float64
        See `frame_table`.
    book : Book
    lines : Lines

    Raises
    ------
    SceneError
        Media cannot be used, or directional light would come through an unbounded medium.
    """
    hosts = hosts_of(scene, targets, tables.rank, tables.medium, tables.media)
    volumes, media = volume_tables(scene, moves, lines, book.media, hosts)
    if volumes is None:
        return tables
    volumes = volumes._replace(near_lamps=single_scatter_tables(volumes, tables.lamps.rows, tables.outer_radius))
    reach, endless = reach_of(volumes)
    if endless and not tables.lamps.rows["placed"].all():
        raise SceneError(
            "media: a directional light comes from infinity, so nothing of it passes a medium without bounds; give "
            "the medium bounds, or use another light"
        )
    lit = tables.lit_radius
    if volumes.scatters:
        lit = np.inf if endless else max(lit, reach)
    outer = np.inf if endless else max(tables.outer_radius, reach)
    return tables._replace(media=media, volumes=volumes, outer_radius=outer, lit_radius=lit)


def with_fields(
    tables: ObjectTables, fields: BendingFields | None, scene: Scene, mesh: Mesh, motions: Motions | None = None
) -> ObjectTables:
    """Return the tables with media that bend light, and with spheres enlarged to hold them.

    Parameters
    ----------
    tables : ObjectTables
    fields : BendingFields or None
    scene : Scene
    mesh : Mesh
        Mesh of targets and housing, object frame.
    motions : Motions, optional

    Raises
    ------
    SceneError
        Media of both kinds of emission stand where light is bent.
    """
    if fields is None:
        return tables
    given = [tables.volumes.rows["emits"][number] for number in np.flatnonzero(tables.volumes.emission.any(axis=1))]
    by_heat = [kind in (OF_BODY, BY_TEMPERATURE) for kind in given]
    if len(set(by_heat)) > 1:
        raise SceneError(
            f"media[{fields.medium[0]}] bends light, so media may emit by temperature_k or by emission_w_mm3_sr, but "
            "not both; use one of them"
        )
    acts = (tables.volumes.rows["inside"] != NOWHERE).any()
    fields = fields._replace(alone=not acts, emit_radiance=bool(given) and not by_heat[0])
    reach = float(np.linalg.norm(boxes_of_fields(fields).reshape(-1, 3), axis=1).max())
    tables = tables._replace(
        fields=fields, outer_radius=max(tables.outer_radius, reach), lit_radius=max(tables.lit_radius, reach)
    )
    return tables._replace(sources=sources_of(scene, tables, mesh, motions))


def _refuse_touched_finishes(scene: Scene, bodies: NDArray[np.int64], first: NDArray[np.int64]) -> None:
    """Refuse a coated or rough body of glass that touches another: chance would decide which face a ray meets."""
    if not len(first):
        return
    touching = np.unique(bodies[np.flatnonzero(np.diff(first) > 0)])
    for i in touching:
        glass = scene.targets[i].refractor
        if glass is not None and glass.coating != UNCOATED:
            raise SceneError(
                f'targets[{i}].refractor.coating = "{glass.coating}": a coated body must not touch another body of '
                "glass; leave a gap between them, or omit the coating"
            )
        if glass is not None and glass.finish.is_rough:
            raise SceneError(
                f"targets[{i}].refractor.finish = {glass.finish.in_words()}: a rough body must not touch another body "
                "of glass; leave a gap between them, or polish it"
            )
