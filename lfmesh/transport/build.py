"""Build of a scene: its meshes, Embree scenes and tables."""

import copyreg
from copy import copy
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import (
    ClosedGapWarning,
    CutBodiesWarning,
    SceneError,
    heard,
    warn_caller,
)
from lfmesh.geometry import frame
from lfmesh.geometry.index_media import bends
from lfmesh.geometry.lens.lens_shape import LensShape
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.geometry.meshes.levels import SURFACE_LEVEL
from lfmesh.geometry.meshes.mesh import Mesh
from lfmesh.geometry.objects.targets import target_body
from lfmesh.geometry.surfaces.division import divided
from lfmesh.scene import Scene
from lfmesh.transport.aims.aim_table import all_before, shapes_in_camera, unaimed
from lfmesh.transport.checks.aim_proof import AimProof, proven_aim
from lfmesh.transport.collisions import refuse_collisions, slab_of_tables
from lfmesh.transport.inside_camera import refuse_objects_inside
from lfmesh.transport.packets.book import Book
from lfmesh.transport.packets.packet import (
    CAMERA_FRAME,
    LENS,
    OBJECT_FRAME,
    OBJECTS,
    WORLD_FRAME,
)
from lfmesh.transport.refused_fields import refuse_untraceable_fields
from lfmesh.transport.refused_glass import closed_gaps, cut_bodies, refuse_untraceable_glass
from lfmesh.transport.refused_motion import refuse_untraceable_motion
from lfmesh.transport.regions.embree import Finder
from lfmesh.transport.regions.glass_round import places_round
from lfmesh.transport.regions.seen_lights import with_seen_lights
from lfmesh.transport.regions.standing_lamps import off_surfaces
from lfmesh.transport.tables.bending_fields import bending_fields, bending_media, with_free, with_short_chords
from lfmesh.transport.tables.cover import apparent_frames, cover_tables
from lfmesh.transport.tables.field_lines import coarse_fields, pixel_sizes
from lfmesh.transport.tables.frames import frame_table
from lfmesh.transport.tables.gradient_cells import with_gradient_cells
from lfmesh.transport.tables.interfaces import InterfaceTables, coatings_in_book, interface_tables
from lfmesh.transport.tables.lens import lens_tables, mla_tables, with_diffracting_stop, with_diffraction
from lfmesh.transport.tables.lines import Lines
from lfmesh.transport.tables.media import MediumList, clear, index2_behind_lens
from lfmesh.transport.tables.motion_tables import hulls_of, motion_tables, swept_boxes, with_motions
from lfmesh.transport.tables.motions import STILL, Motions
from lfmesh.transport.tables.objects import housing_mesh, middle_of, object_tables, with_fields
from lfmesh.transport.tables.particles import corners_round, particle_tables, refuse_particles_behind
from lfmesh.transport.tables.polarisation import polarisation_tables
from lfmesh.transport.tables.swept import swept
from lfmesh.transport.tables.tables import AIR, ROUGH, AimTables, Camera, SensorTables, Tables
from lfmesh.transport.tables.volumes import corners_in_camera, reach_of
from lfmesh.transport.world_cache import keep, key_of, known, let_go, refuse_other

if TYPE_CHECKING:
    pass


from lfmesh.transport.world import Bodies, World

Array = NDArray[np.float64]


def book_of(scene: Scene, shape: LensShape) -> Book:
    """Return the book of a scene, with slots for lens elements, targets, spaces between lens surfaces, and coatings.

    The spaces are the air or medium before the lens, glass and air inside it, and the air or medium behind it.
    """
    targets = [target.name or f"targets[{i}]" for i, target in enumerate(scene.targets)]
    before, behind = ("air" if shape.media[end] is None else "medium" for end in (0, -1))
    spaces = [f"the {before} before the lens", *[""] * (len(shape.media) - 2), f"the {behind} behind the lens"]
    element = -1
    for k, medium in enumerate(shape.media[1:-1], start=1):
        element += medium is not None
        spaces[k] = f"lens[{element}]" if medium is not None else f"the air behind lens[{element}]"
    media = [medium.name or f"media[{i}]" for i, medium in enumerate(scene.media)]
    bending = [name for name, medium in zip(media, scene.media, strict=True) if bends(scene, medium)]
    known, elements = MediumList.of(scene), [shape.media[k + 1] for k in shape.elements]
    absorbers = [known.places(number, elements) for number in known.absorbing]
    return Book.of_bodies(len(shape.elements), targets, spaces, coatings_in_book(scene), media, absorbers, bending)


def _refuse_rough_patches(scene: Scene, shape: LensShape, interfaces: InterfaceTables) -> None:
    """Refuse rough curved patches of lens and array: light running along them might not escape."""
    curved = "smooth", "patch"
    lens = shape.surfaces["level"][interfaces.lens.rows["kind"] >= ROUGH]
    if np.isin(lens, [SURFACE_LEVEL[name] for name in curved]).any():
        raise SceneError(
            'camera.lens: a rough surface of the lens must be exact or of flat facets; take surface = "flat" (in '
            "transport, or beside the mesh's file), or polish it"
        )
    if interfaces.mla.rough and scene.transport.surface in curved:
        raise SceneError(
            f'transport.surface = "{scene.transport.surface}": a rough face of camera.mla must be exact or of flat '
            'facets; take "exact" or "flat", or polish it'
        )


def build(scene: Scene, *, rings: int | None = None, aimed: bool = True) -> World:
    """Build a scene: its meshes, Embree scenes and tables.

    Parameters
    ----------
    scene : Scene
        Open distances are solved and files read first. `lf.render(scene, world=world)` uses the world; so does
        `lf.render(scene)` while scene and files are unchanged.
    rings : int, optional
        Number of rings of triangles on each lens surface, in place of the scene's tessellation.
    aimed : bool
        Find, on first use, the directions in which rays pass the lens. If False, rays are sent all over the lens.

    Returns
    -------
    World

    Warns
    -----
    ClosedGapWarning
        Faces of glass are so close that they are treated as touching.
    CutBodiesWarning
        Curved bodies of glass cut each other.

    Raises
    ------
    SceneError, MeshError, FileError
        The scene cannot be built: crossing rims, an unusable mesh or texture, a target inside the camera.
    """
    key = key_of(scene)
    let_go(key)
    with heard() as said:
        world = _built(scene, rings, aimed)
    if key_of(scene) == key:
        world._key, world._said = key, tuple(said)
        if rings is None and aimed:
            untouched = copy(world)
            untouched.kept = {}
            keep(key, untouched)
            world._untouched = untouched
    return world


def world_of(scene: Scene, given: World | None = None) -> World:
    """Return a world of a scene: the given one, one already built in this process, or a new one.

    Parameters
    ----------
    scene : Scene
    given : World, optional

    Raises
    ------
    LfmeshError
        The given world was built from another scene, or the scene cannot be built.
    """
    if given is not None:
        refuse_other(given, given._key, scene)
        world = given
    elif (found := known(key_of(scene))) is not None:
        warn_caller(found._said)
        world = found
    else:
        return build(scene)
    seed = scene.transport.seed
    return world if world.scene.transport.seed == seed else world.reseeded(seed)


def _built(scene: Scene, rings: int | None, aimed: bool) -> World:
    """Build a scene; see `build`."""
    camera = solved_camera(scene)
    scene, report = camera.scene, camera.facts
    form = scene.camera.mla.form if scene.camera.mla is not None else None
    if form is not None and scene.transport.surface != "exact" and (form.decenter_mm or form.radius_error):
        raise SceneError(
            f'transport.surface = "{scene.transport.surface}": facets are those of a perfect lenslet, but '
            'camera.mla.form has errors of single ones; use "exact", or omit decenter_mm and radius_error'
        )
    lines = Lines.of(scene)
    wavelengths_nm = lines.wavelengths_nm
    shape = camera.lens_shape(rings)
    targets = [target_body(target, scene) for target in scene.targets]
    book = book_of(scene, shape)

    interfaces, known = interface_tables(scene, wavelengths_nm, book), MediumList.of(scene)
    _refuse_rough_patches(scene, shape, interfaces)
    lens_mesh, lens = lens_tables(scene, shape, wavelengths_nm, book, interfaces.lens, known)
    cells, mla = mla_tables(scene, wavelengths_nm, interfaces.mla, known, book)
    middle = middle_of(targets)
    moves = frame_table(scene, middle)
    refuse_collisions(scene, slab_of_tables(mla), lambda: shape)
    seen_moves = apparent_frames(scene, moves)
    housing = housing_mesh(scene, shape)
    refuse_objects_inside(scene, targets, housing, moves)
    ranks = refuse_untraceable_glass(
        scene, targets, frame.points(moves[CAMERA_FRAME, WORLD_FRAME], shape.caps[0].vertices)
    )
    bent = bending_media(scene, wavelengths_nm)
    doubtful = (
        *(ClosedGapWarning(line) for line in closed_gaps(scene, targets)),
        *(CutBodiesWarning(line) for line in cut_bodies(scene, targets)),
        *coarse_fields(bent),
    )
    warn_caller(doubtful)
    object_mesh, objects = object_tables(scene, targets, housing, moves, book, lines, interfaces.objects, known, ranks)
    motions = motion_tables(scene, targets, objects, moves)
    hulls = hulls_of(targets, objects, moves[WORLD_FRAME, OBJECT_FRAME]) if motions is not None else []
    objects = with_motions(objects, motions, hulls, scene, object_mesh)
    refuse_untraceable_fields(scene, bent, targets, moves, float(lens.box_low[2]))
    refuse_untraceable_motion(scene, targets, (shape, housing), moves, objects.volumes, bent)
    fields = bending_fields(bent, moves, objects.media.indices[AIR], book.trapped)
    if fields is not None:
        corners = [t.hull.moved(moves[WORLD_FRAME, OBJECT_FRAME]).vertices for t in targets]
        if motions is not None:
            corners = [_held_throughout(motions, i, hull) for i, hull in enumerate(hulls)]
        fields = with_free(fields, [*corners, housing.moved(moves[CAMERA_FRAME, OBJECT_FRAME]).vertices])
        fields = with_short_chords(fields, pixel_sizes(bent, scene, report))
    objects = with_fields(objects, fields, scene, object_mesh, motions)
    columns, rows = scene.camera.sensor.pixels
    own = scene.camera.sensor
    sensor = SensorTables(columns, rows, own.pixel_mm, own.reflectance, index2_behind_lens(scene, wavelengths_nm))
    particles = particle_tables(scene, lines, objects.media, lambda points: places_round(objects, targets, points))
    refuse_particles_behind(particles, moves, float(lens.box_low[2]), motions)
    diffracting = with_diffraction(scene, with_gradient_cells(scene, mla, wavelengths_nm), wavelengths_nm)
    stopped = with_diffracting_stop(scene, lens, wavelengths_nm)
    # Absorption weakens light but does not change its path.
    anywhere = unaimed(scene, clear(lens))

    # A world and its copy for renders share the result.
    @cache
    def find_aim() -> tuple[AimTables, AimProof | None]:
        if not aimed:
            return anywhere, None
        still, around = targets, corners_in_camera(objects.volumes, moves)
        if motions is not None:
            still = [target for target, mover in zip(targets, motions.of_target, strict=False) if mover == STILL]
            around = swept_boxes(motions, hulls, objects, moves)
        boxes = [around, frame.points(moves[WORLD_FRAME, CAMERA_FRAME], corners_round(particles, motions))]
        if reach_of(objects.volumes)[1]:
            boxes.append(all_before(lens))
        shapes = shapes_in_camera(still, np.concatenate(boxes), moves)
        exact = bool(shape.analytic.all())
        camera = Camera(clear(stopped), clear(diffracting), sensor, seen_moves)
        return proven_aim(scene, report, camera, shapes, analytic=exact)

    polarised = polarisation_tables(scene, wavelengths_nm, moves, book)
    tables = Tables(
        lens=stopped,
        mla=diffracting,
        sensor=sensor,
        objects=objects,
        frames=moves,
        aim=anywhere,
        polarised=polarised,
        motions=motions,
    )
    cover = cover_tables(scene, wavelengths_nm, interfaces.cover, known, book)
    if cover is not None:
        tables = tables._replace(cover=cover, apparent=seen_moves)
    bodies_met = objects.facets["body"][: len(object_mesh.faces)]
    finders = {LENS: Finder(lens_mesh), OBJECTS: Finder(*divided(object_mesh, bodies_met))}
    finders |= {station: Finder(mesh) for station, mesh in cells.items()}
    objects, standing = off_surfaces(scene, objects, finders[OBJECTS])
    warn_caller(standing)
    tables = tables._replace(objects=objects)
    if scene.transport.method == "forward":
        tables = tables._replace(objects=with_seen_lights(objects, report, moves, finders[OBJECTS]))
    how = {"rings": rings, "aimed": aimed}
    bodies = Bodies(shape, targets, housing)
    world = World(scene, report, tables, finders, book, bodies, particles, find_aim, how)
    world.moving_finders = _moving_finders(object_mesh, bodies_met, motions)
    world.warnings = (*doubtful, *standing)
    return world


def _held_throughout(motions: Motions, target: int, hull: Array) -> Array:
    """Return points whose hull holds a target throughout the exposure, (n, 3) mm, object frame."""
    places, margin = swept(motions, int(motions.of_target[target]), hull)
    if not margin or not len(places):
        return places
    return np.array([places.min(axis=0) - margin, places.max(axis=0) + margin])


def _moving_finders(mesh: Mesh, bodies: NDArray[np.int64], motions: Motions | None) -> tuple[Finder, ...]:
    """Return the finders of the facets of each mover; none if nothing moves.

    Parameters
    ----------
    mesh : Mesh
        Targets and housing, object frame.
    bodies : (m,) int64
        Target of each facet; −1: the housing.
    motions : Motions or None
    """
    if motions is None:
        return ()
    finders = []
    for mover in range(len(motions.bounds)):
        own = np.flatnonzero(motions.of_target[bodies] == mover)
        used, faces = np.unique(mesh.faces[own], return_inverse=True)
        part, owners = divided(Mesh(mesh.vertices[used], faces.reshape(-1, 3)), bodies[own])
        finders.append(Finder(part, own[owners]))
    return tuple(finders)


def _rebuilt(scene: Scene, how: dict[str, Any]) -> World:
    """Build a scene again in the same way."""
    return build(scene, **how)


# A method of the class would have its file know this one.
copyreg.pickle(World, lambda world: (_rebuilt, (world.scene, world._how)))
