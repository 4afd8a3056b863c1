"""Built scene: meshes, Embree scenes, and the tables for kernels."""

from collections.abc import Callable, Hashable
from copy import copy
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from lfmesh.errors import (
    LfmeshError,
    PictureWarning,
)
from lfmesh.geometry import frame
from lfmesh.geometry.array.array_mesh import mla_mesh
from lfmesh.geometry.lens.element_poses import pose_of
from lfmesh.geometry.lens.lens_shape import LensShape
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.geometry.meshes.flatness import in_one_plane
from lfmesh.geometry.meshes.mesh import Array, Mesh, joined
from lfmesh.geometry.objects.targets import TargetMesh
from lfmesh.geometry.surfaces.bends import rim_range
from lfmesh.geometry.surfaces.tessellation import element, revolved
from lfmesh.notebook import Shown
from lfmesh.scene import FirstOrder, Scene
from lfmesh.scene.literals import counted
from lfmesh.transport.aims.ghost_aim import ghost_tables
from lfmesh.transport.checks.aim_proof import AimProof
from lfmesh.transport.packets.book import Book
from lfmesh.transport.packets.packet import (
    BACK_FRAME,
    CAMERA_FRAME,
    ENDS_AT,
    FACES,
    FACES_AT,
    MLA_FRAME,
    OBJECT_FRAME,
    SENSOR_FRAME,
    WORLD_FRAME,
)
from lfmesh.transport.regions.embree import Finder
from lfmesh.transport.sequences.ghosts import GhostTables
from lfmesh.transport.tables.bending_fields import boxes_of_fields
from lfmesh.transport.tables.lines import Lines
from lfmesh.transport.tables.media import MediumList
from lfmesh.transport.tables.motion_tables import hulls_of
from lfmesh.transport.tables.particles import ParticleTables
from lfmesh.transport.tables.surroundings import Surroundings, surroundings_of
from lfmesh.transport.tables.swept import box_round
from lfmesh.transport.tables.tables import AimTables, Tables

if TYPE_CHECKING:
    import trimesh


Key = tuple[Hashable, ...]
"""Key of the inputs of a world, see `world_cache.key_of`."""


class Bodies(NamedTuple):
    """Source bodies of the meshes."""

    lens: LensShape
    targets: list[TargetMesh]
    housing: Mesh


class World(Shown):
    """Scene that rays can be traced through, made by `build`.

    It is pickled as its scene and rebuilt from it, see `build`.

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
        """Key of its inputs, see `world_cache.key_of`; None if they changed meanwhile."""
        self._said: tuple[Warning, ...] = ()
        """All warnings of `build`."""
        self.moving_finders: tuple[Finder, ...] = ()
        """Finders of the facets of each mover, see `tables.motions`; none if nothing moves."""
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
        motions, moves = self.tables.motions, self.tables.frames
        if motions is not None and self.targets:
            hulls = hulls_of(self.targets, self.tables.objects, moves[WORLD_FRAME, OBJECT_FRAME])
            corners = [
                box_round(motions, int(mover), hull, moves[OBJECT_FRAME, WORLD_FRAME])
                for mover, hull in zip(motions.of_target, hulls, strict=False)
            ]
            boxes = np.stack([np.min(corners, axis=1), np.max(corners, axis=1)], axis=1)
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
        """Bounds of lens, housing, targets and media that bend light, for rays that can do without Embree."""
        to_world = self.tables.frames[OBJECT_FRAME, WORLD_FRAME]
        fields = [frame.points(to_world, corners) for corners in boxes_of_fields(self.tables.objects.fields)]
        targets = [target.hull for target in self.targets]
        targets += [Mesh(corners, np.zeros((0, 3), np.int64)) for corners in fields]
        return surroundings_of(self.tables.lens, self.lens_shape, self.housing, targets, self.tables.frames)

    @cached_property
    def is_flat(self) -> bool:
        """True if all facets of all targets lie in one plane throughout, so that no light goes between targets."""
        motions = self.tables.motions
        if motions is not None and len(np.unique(motions.of_target[:-1])) > 1:
            return False
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
