"""Built scene: meshes, Embree scenes, and the tables for kernels."""

from collections.abc import Callable
from copy import copy
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from lfmesh.errors import (
    ClosedGapWarning,
    CutBodiesWarning,
    LfmeshError,
    PictureWarning,
    SceneError,
    heard,
    warn_caller,
)
from lfmesh.geometry import frame
from lfmesh.geometry.array.array_mesh import mla_mesh
from lfmesh.geometry.lens.element_poses import pose_of
from lfmesh.geometry.lens.lens_shape import LensShape
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.geometry.meshes.flatness import in_one_plane
from lfmesh.geometry.meshes.levels import SURFACE_LEVEL
from lfmesh.geometry.meshes.mesh import Array, Mesh, joined
from lfmesh.geometry.objects.targets import TargetMesh, target_body
from lfmesh.geometry.surfaces.bends import rim_range
from lfmesh.geometry.surfaces.division import divided
from lfmesh.geometry.surfaces.tessellation import element, revolved
from lfmesh.notebook import Shown
from lfmesh.scene import FirstOrder, Scene
from lfmesh.scene.literals import counted
from lfmesh.transport.aims.aim_table import all_before, shapes_in_camera, unaimed
from lfmesh.transport.aims.ghost_aim import ghost_tables
from lfmesh.transport.built import Key, keep, key_of, known, let_go, refuse_other
from lfmesh.transport.checks.aim_proof import AimProof, proven_aim
from lfmesh.transport.collisions import refuse_collisions, slab_of_tables
from lfmesh.transport.inside_camera import refuse_objects_inside
from lfmesh.transport.packets.book import Book
from lfmesh.transport.packets.packet import (
    BACK_FRAME,
    CAMERA_FRAME,
    ENDS_AT,
    FACES,
    FACES_AT,
    LENS,
    MLA_FRAME,
    OBJECTS,
    SENSOR_FRAME,
    WORLD_FRAME,
)
from lfmesh.transport.refused_glass import closed_gaps, cut_bodies, refuse_untraceable_glass
from lfmesh.transport.regions.embree import Finder
from lfmesh.transport.regions.glass_round import places_round
from lfmesh.transport.regions.seen_lights import with_seen_lights
from lfmesh.transport.regions.standing_lamps import off_surfaces
from lfmesh.transport.sequences.ghosts import GhostTables
from lfmesh.transport.tables.cover import apparent_frames, cover_tables
from lfmesh.transport.tables.frames import frame_table
from lfmesh.transport.tables.interfaces import InterfaceTables, coatings_in_book, interface_tables
from lfmesh.transport.tables.lens import lens_tables, mla_tables, with_diffracting_stop, with_diffraction
from lfmesh.transport.tables.lines import Lines
from lfmesh.transport.tables.media import MediumList, clear, index2_behind_lens
from lfmesh.transport.tables.objects import housing_mesh, middle_of, object_tables
from lfmesh.transport.tables.particles import ParticleTables, corners_round, particle_tables, refuse_particles_behind
from lfmesh.transport.tables.polarisation import polarisation_tables
from lfmesh.transport.tables.surroundings import Surroundings, surroundings_of
from lfmesh.transport.tables.tables import ROUGH, AimTables, Camera, SensorTables, Tables
from lfmesh.transport.tables.volumes import corners_in_camera, reach_of

if TYPE_CHECKING:
    import trimesh


class Bodies(NamedTuple):
    """Source bodies of the meshes."""

    lens: LensShape
    targets: list[TargetMesh]
    housing: Mesh


class World(Shown):
    """Scene that rays can be traced through, made by `build`.

    It is pickled as its scene and rebuilt from it.

    Parameters
    ----------
    scene, report, tables, finders, book, bodies, particles, find_aim, how
        Internal results of `build`.

    Attributes
    ----------
    scene : Scene
        Scene with its lens solved.
    facts : FirstOrder
        First-order report without its warnings.
    tables : Tables
        Tables for kernels, without an aim: rays are sent all over the lens.
    warnings : tuple of PictureWarning
        Possible errors of any ray through it, as warned of by `build`.
    """

    def __init__(
        self, scene: Scene, report: FirstOrder, tables: Tables, finders: dict[int, Finder],
        book: Book, bodies: Bodies, particles: tuple[ParticleTables, ...],
        find_aim: Callable[[], tuple[AimTables, AimProof | None]], how: dict[str, Any],
    ) -> None:  # fmt: skip
        self.scene = scene
        self.facts = report
        self.tables = tables
        self.finders = finders
        self.book = book
        self.slots = book.names
        self.lens_shape, self.targets, self.housing = bodies
        self.media = MediumList.of(scene)
        self.lines = Lines.of(scene)
        self.particles = particles
        self.kept: dict[str, Any] = {}
        """Seed-independent results of renders, by name; shared with all `reseeded` copies."""
        self._find_aim = find_aim
        self._how = how
        """Keywords given to `build`."""
        self.warnings: tuple[PictureWarning, ...] = ()
        self._key: Key | None = None
        """Key of its inputs, see `built.key_of`; None if they changed meanwhile."""
        self._said: tuple[Warning, ...] = ()
        """All warnings of `build`."""
        self._untouched: World | None = None
        """Copy for renders, unaffected by its owner's changes to this world."""

    def __repr__(self) -> str:
        bodies = len(self.scene.targets), len(self.scene.lights)
        name = f"{self.scene.name!r}, " if self.scene.name else ""
        return (
            f"<World: {name}{counted(len(self.lens_shape.elements), 'lens element')}, "
            f"{'with' if self.tables.mla.present else 'no'} microlenses, "
            f"{counted(bodies[0], 'target')}, {counted(bodies[1], 'light')}>"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuilt, (self.scene, self._how)

    def __copy__(self) -> "World":
        other = object.__new__(World)
        other.__dict__.update(self.__dict__)
        return other

    @cached_property
    def _aim_and_proof(self) -> tuple[AimTables, AimProof | None]:
        return self._find_aim()

    @property
    def first_order(self) -> FirstOrder:
        """First-order report."""
        return solved_camera(self.scene).report

    @cached_property
    def aim(self) -> AimTables:
        """Aim of rays that have to pass the lens, found on first use."""
        return self._aim_and_proof[0]

    @property
    def aim_proof(self) -> AimProof | None:
        """Share of light outside the aim, measured by rays from the stop; None for a world without aim."""
        return self._aim_and_proof[1]

    @property
    def ghosts(self) -> GhostTables | None:
        """Sequences of the camera's ghosts, and how they are drawn; None if they are not followed by sequence."""
        if "ghosts" not in self.kept:
            self.kept["ghosts"] = self._ghosts()
        found: GhostTables | None = self.kept["ghosts"]
        return found

    def _ghosts(self) -> GhostTables | None:
        if self.tables.mla.apertures is not None:
            # Sequences have no random numbers.
            return None
        # Media are left out, so that a medium's image and its projection matrix use the same rays.
        boxes = np.array([target.box_mm for target in self.targets]) if self.targets else None
        return ghost_tables(self.aimed_tables, boxes, self.scene.transport.max_events)

    @property
    def aimed_tables(self) -> Tables:
        """Tables with the aim."""
        return self.tables._replace(aim=self.aim)

    def reseeded(self, seed: int) -> "World":
        """Return the same world with another seed for renders.

        Parameters
        ----------
        seed : int

        Returns
        -------
        World
        """
        scene = self.scene.changed({"transport.seed": seed})
        # The aim does not depend on the seed: find it once for all copies.
        _ = self._aim_and_proof
        world = copy(self)
        world.scene = scene
        return world

    @cached_property
    def surroundings(self) -> Surroundings:
        """Bounds of lens, housing and targets, for rays that can do without Embree."""
        targets = [target.hull for target in self.targets]
        return surroundings_of(self.tables.lens, self.lens_shape, self.housing, targets, self.tables.frames)

    @cached_property
    def is_flat(self) -> bool:
        """True if all facets of all targets lie in one plane, so that no light goes from target to target."""
        return in_one_plane(target.hull for target in self.targets)

    @property
    def mesh_names(self) -> list[str]:
        """Names for `mesh`: "lens[0]", ..., "mount", "stop", "mla", "sensor", "housing", "targets[0]", ..."""
        names = [f"lens[{i}]" for i in range(len(self.lens_shape.elements))]
        names += ["mount"] if self._mounts() else []
        names += ["stop"] + (["mla"] if self.tables.mla.present else []) + ["sensor", "housing"]
        return names + [f"targets[{i}]" for i in range(len(self.targets))]

    def mesh(self, name: str) -> "trimesh.Trimesh":
        """Return a body as a mesh in the world frame, mm.

        Lens elements and the array are closed solids with outward normals. Cemented elements are separate solids,
        although rays see one shared interface.

        Parameters
        ----------
        name : str
            One of `mesh_names`.

        Returns
        -------
        trimesh.Trimesh

        Raises
        ------
        LfmeshError
            No body has this name.
        """
        if name not in self.mesh_names:
            raise LfmeshError(f"unknown mesh {name!r}; valid are {', '.join(self.mesh_names)}")
        kind, _, number = name.rstrip("]").partition("[")
        makers: dict[str, Callable[[], trimesh.Trimesh]] = {
            "lens": lambda: self._in_world(
                self._element(int(number)).solid(), self.tables.frames[CAMERA_FRAME, WORLD_FRAME]
            ),
            "mount": lambda: self._in_world(
                joined(self._mounts()).solid(), self.tables.frames[CAMERA_FRAME, WORLD_FRAME]
            ),
            "stop": lambda: self._in_world(self._stop(), self.tables.frames[CAMERA_FRAME, WORLD_FRAME]),
            "mla": lambda: self._in_world(self._array(), self.tables.frames[MLA_FRAME, WORLD_FRAME]),
            "sensor": lambda: self._in_world(self._sensor(), self.tables.frames[SENSOR_FRAME, WORLD_FRAME]),
            "housing": lambda: self._in_world(self.housing.solid(), self.tables.frames[CAMERA_FRAME, WORLD_FRAME]),
            "targets": lambda: self.targets[int(number)].mesh.solid(),
        }
        return makers[kind]()

    def surface_name(self, number: int) -> str:
        """Return the name of a surface from its number in a recorded vertex.

        Parameters
        ----------
        number : int

        Returns
        -------
        str
        """
        if number < FACES_AT:
            return f"lens surface {self.lens_shape.numbers[number]}" if number >= 0 else "start"
        if number < ENDS_AT:
            return FACES[number - FACES_AT]
        return self.slots[number - ENDS_AT]

    @staticmethod
    def _in_world(mesh: "trimesh.Trimesh", to_world: Array) -> "trimesh.Trimesh":
        import trimesh

        moved = Mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces)).moved(to_world)
        return trimesh.Trimesh(moved.vertices, moved.faces, process=False)

    def _element(self, number: int) -> Mesh:
        shape = self.lens_shape
        k = shape.elements[number]
        return element(shape.caps[k], shape.closures[k], shape.caps[k + 1])

    def _mounts(self) -> list[Mesh]:
        shape = self.lens_shape
        return [mesh for k, mesh in enumerate(shape.closures) if shape.media[k + 1] is None]

    def _array(self) -> "trimesh.Trimesh":
        """Return the array in its own frame."""
        mla = self.tables.mla
        if mla.back is None:
            return mla_mesh(mla.lenslets)
        return mla_mesh(mla.lenslets, back=mla.back.lenslets, shift_mm=self.tables.frames[BACK_FRAME, MLA_FRAME][:2, 3])

    def _stop(self) -> "trimesh.Trimesh":
        """Return the annulus around the stop's aperture."""
        surfaces = self.scene.camera.lens.surfaces
        number = next(i for i, s in enumerate(surfaces) if s.stop)
        z = self.scene.camera.lens.vertices_mm[number]
        inner = surfaces[number].semi_diameter_mm or 0.0
        outer = max(1.3 * inner, *self.lens_shape.rims)
        if number in self.lens_shape.numbers:
            z += rim_range(self.lens_shape.surfaces[self.lens_shape.numbers.index(number)], inner)[1]
        ring = revolved(np.array([[outer, z], [inner, z]]), 96)
        return ring.moved(pose_of(self.scene.camera.lens, number)).solid()

    def _sensor(self) -> "trimesh.Trimesh":
        import trimesh

        x, y = (0.5 * size for size in self.scene.camera.sensor.size_mm)
        corners = np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]])
        return trimesh.Trimesh(corners, [[0, 2, 1], [0, 3, 2]], process=False)


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
    known, elements = MediumList.of(scene), [shape.media[k + 1] for k in shape.elements]
    absorbers = [known.places(number, elements) for number in known.absorbing]
    return Book.of_bodies(len(shape.elements), targets, spaces, coatings_in_book(scene), media, absorbers)


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


def _rebuilt(scene: Scene, how: dict[str, Any]) -> World:
    """Build a scene again in the same way."""
    return build(scene, **how)


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
    doubtful = (
        *(ClosedGapWarning(line) for line in closed_gaps(scene, targets)),
        *(CutBodiesWarning(line) for line in cut_bodies(scene, targets)),
    )
    warn_caller(doubtful)
    object_mesh, objects = object_tables(scene, targets, housing, moves, book, lines, interfaces.objects, known, ranks)
    columns, rows = scene.camera.sensor.pixels
    own = scene.camera.sensor
    sensor = SensorTables(columns, rows, own.pixel_mm, own.reflectance, index2_behind_lens(scene, wavelengths_nm))
    particles = particle_tables(scene, lines, objects.media, lambda points: places_round(objects, targets, points))
    refuse_particles_behind(particles, moves, float(lens.box_low[2]))
    diffracting = with_diffraction(scene, mla, wavelengths_nm)
    stopped = with_diffracting_stop(scene, lens, wavelengths_nm)
    # Absorption weakens light but does not change its path.
    anywhere = unaimed(scene, clear(lens))

    # A world and its copy for renders share the result.
    @cache
    def find_aim() -> tuple[AimTables, AimProof | None]:
        if not aimed:
            return anywhere, None
        grains = frame.points(moves[WORLD_FRAME, CAMERA_FRAME], corners_round(particles))
        boxes = [corners_in_camera(objects.volumes, moves), grains]
        if reach_of(objects.volumes)[1]:
            boxes.append(all_before(lens))
        shapes = shapes_in_camera(targets, np.concatenate(boxes), moves)
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
    world.warnings = (*doubtful, *standing)
    return world
