"""Split an image into classes of paths that are estimated independently.

Paths with reflections carry a few per cent of the light and cost ten times as much as the image path. The adjoint
method therefore adds two estimates: the image path by the sequential engine, and all other paths, with fewer samples,
by the mesh engine. `allocation` measures how many fewer. Most other paths are ghosts of two reflections. They form a
part of their own if they can be followed by their sequences of surfaces (`sequences.ghosts`).

Further parts are traced forward: in the adjoint method, light of lamps through glass; in both methods, light of lamps
on a camera with rough surfaces, and each entry of particles, points that no ray from the sensor meets.
`paths.automaton` defines the classes; each path belongs to one of them and counts once.
"""

from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfmesh.scene import Scene
from lfmesh.transport.aims.ghost_aim import aim_at_ghosts
from lfmesh.transport.aims.mixture import WIDE_SHARE_OF_IMAGE_PATH, WIDE_SHARE_OF_STRAYS, with_wide_share
from lfmesh.transport.aims.through_glass import GlassAim
from lfmesh.transport.checks.blind_check import without_aim
from lfmesh.transport.choice import engine_of
from lfmesh.transport.packets.book import LIT, REACHED
from lfmesh.transport.packets.packet import BOTH, BY_MESH, BY_ORDER, TRANSMIT, Options
from lfmesh.transport.paths.automaton import (
    GHOSTS,
    LAMP_ON_CAMERA,
    LAMP_THROUGH_GLASS,
    OFF_IMAGE_PATH,
    OTHER_STRAYS,
)
from lfmesh.transport.paths.estimators import Estimator, lamps_on_camera
from lfmesh.transport.render.glass_aim import glass_aim, has_glass, refuse_unaimed
from lfmesh.transport.settings import options_of, with_thinning
from lfmesh.transport.tables.forward_sources import aimed_at_camera, aimed_at_glass
from lfmesh.transport.tables.particles import ParticleTables
from lfmesh.transport.tables.scattering import LAMBERTIAN, ScatteringTables
from lfmesh.transport.tables.tables import ObjectTables, Tables
from lfmesh.transport.world import World

IMAGE_PATHS_PER_STRAY, WITH_GLASS = 4, 2
"""Samples of the image path per sample of the paths off it: without glass in object space, and with glass, whose
reflections are part of the picture."""

IMAGE_PATHS_PER_OTHER_STRAY, IMAGE_PATHS_PER_GHOST = 64, 8
"""The same, without glass, if ghosts are a part of their own: per other stray, and per ghost."""

CUTOFF_OVER_SAMPLES, LEAST_CUTOFF, IN_SINGLE_ELEMENT = 10.0, 1.0 / 100.0, 1.0 / 30.0
"""Weight below which other strays play roulette, over `weight_cutoff`: the first number over the samples of the image
path in a replicate, between the second number and 1. The more samples the image path has, the further its few strays
are followed: a tenth of the cutoff costs 2.5 times the time and leaves a twelfth of the variance.

The third number is an upper limit for a lens of two surfaces. There, only one child of a packet stays in the lens, so a
path does not branch and costs little. In a dark corner lit by total reflection, packets made heavier by roulette would
be visible."""

SCATTERED_PER_FOLLOWED = 25.0
"""Without glass in object space: scattered paths, not yet off the image path, per path followed. The reflection of such
a path at a lens surface, some 4 %, then has about the weight of other children."""

OWN_BOOK, LAMP_BOOK, BOOKS = 0, 1, 2
"""Rows of a run's books: the method's own packets, and packets of other parts, from particles or lamps, in W."""


@dataclass(frozen=True)
class Part:
    """Class of paths, with the settings for tracing it.

    Attributes
    ----------
    number : int
        See `Estimator`.
    options : Options
        `adjoint` tells whether it is traced from pixels or, forward, from lamps.
    tables : Tables
    thinned : int
        The part takes one in this number of samples. A forward part starts as many packets as it would take samples of
        all pixels.
    accounts : bool
        The part's book accounts for all energy; other parts' books contribute only `REACHED` and `LIT`.
    book : int
        Row of the run's books that receives the part's book.
    particles : ParticleTables, optional
        Start of its packets, in place of lamps and emitting targets.
    """

    number: int
    options: Options
    tables: Tables
    thinned: int = 1
    accounts: bool = True
    book: int = OWN_BOOK
    particles: ParticleTables | None = None

    def packets(self, pixels: int, of_image: int, replicates: int) -> int:
        """Return the number of packets per channel that a forward part starts in a replicate.

        Parameters
        ----------
        pixels : int
        of_image : int
            Samples per pixel in a replicate of the image.
        replicates : int
        """
        if self.particles is None:
            return pixels * self.samples(of_image)
        return len(self.particles.points) * self.per_particle(replicates)

    def per_particle(self, replicates: int) -> int:
        """Return the number of packets per particle and channel in a replicate."""
        return 1 if self.particles is None else max(1, self.particles.samples // replicates)

    def samples(self, of_image: int) -> int:
        """Return the part's samples per pixel, at least one, if the image has `of_image`."""
        return max(1, of_image // self.thinned)

    def draws(self, pixels: int, of_image: int, replicates: int) -> int:
        """Return the draws per replicate that may bring light to a pixel: its samples, or all packets.

        Parameters
        ----------
        pixels, of_image, replicates : int
            See `packets`.
        """
        return self.samples(of_image) if self.options.adjoint else self.packets(pixels, of_image, replicates)

    @property
    def from_lamps(self) -> bool:
        """True if its packets come from particles or lamps, apart from the method's own."""
        return self.book == LAMP_BOOK

    def by_meshes(self) -> "Part":
        """Return the part with all surfaces of lens and array found by Embree, except along the image path."""
        if self.options.faces == BY_ORDER:
            return self
        return replace(self, options=self.options._replace(faces=BY_MESH))

    def booked(self, book: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the entries of a chunk's book for the run's books, (BOOKS, slots)."""
        kept = np.zeros((BOOKS, len(book)))
        if self.accounts:
            kept[self.book] = book
        else:
            kept[self.book, [REACHED, LIT]] = book[[REACHED, LIT]]
        return kept


def parts_of(world: World, *, aimed: bool = True, by_meshes: bool = False) -> tuple[Part, ...]:
    """Return the parts of a scene's image, which is their sum.

    Parameters
    ----------
    world : World
    aimed : bool
        See `Tracer`.
    by_meshes : bool
        Embree finds all surfaces of lens and array, except along the image path.
    """
    parts = _parts_of(world, aimed=aimed, ghosts=not by_meshes)
    return tuple(part.by_meshes() for part in parts) if by_meshes else parts


def _parts_of(world: World, *, aimed: bool, ghosts: bool) -> tuple[Part, ...]:
    """Return the parts of an image; `ghosts` allows a separate part for ghosts."""
    options, tables = options_of(world, aimed=aimed), world.aimed_tables
    through_glass = aimed_at_glass(tables.objects, tables.motions) is not None
    forward = not options.adjoint or bool(world.particles) or through_glass
    through = glass_aim(world)[0] if aimed and forward else None
    if aimed and not options.adjoint:
        refuse_unaimed(world)
    particles = particle_parts(world, through)
    if particles and not (len(tables.objects.lamps.rows) or tables.objects.radiance.any() or world.scene.media):
        # Nothing else shines, so packets need not start anywhere else.
        return particles
    lamps = lamp_parts(world, through) if options.adjoint else ()
    lamps = (*lamps, *camera_parts(world, through), *particles)
    if not options.adjoint:
        tables = _aimed_through(tables, through)
    if engine_of(world.scene)[0] != "both":
        return (Part(Estimator.IMAGE_PATH, options, tables), *lamps)
    path = with_wide_share(tables.aim, WIDE_SHARE_OF_IMAGE_PATH, WIDE_SHARE_OF_IMAGE_PATH)
    strays = with_wide_share(tables.aim, WIDE_SHARE_OF_STRAYS)
    thinned = WITH_GLASS if has_glass(world) else IMAGE_PATHS_PER_STRAY
    along_path = with_thinning(options, split=TRANSMIT)._replace(faces=BY_ORDER)
    off_path = _off_image_path(options, world)
    image_path = Part(Estimator.IMAGE_PATH, along_path, tables._replace(aim=path), accounts=False)
    if not ghosts or world.ghosts is None:
        return (image_path, Part(Estimator.STRAYS, off_path, tables._replace(aim=strays), thinned), *lamps)
    thinned = WITH_GLASS if has_glass(world) else IMAGE_PATHS_PER_OTHER_STRAY
    others = off_path._replace(paths=OTHER_STRAYS)
    if not has_glass(world):
        single = len(tables.lens.surfaces) == 2 and tables.cover is None and tables.sensor.reflectance == 0.0
        lower = min(1.0, max(LEAST_CUTOFF, CUTOFF_OVER_SAMPLES / world.scene.transport.samples_each))
        cutoff, unturned = others.thinning.cutoff, others.thinning.unturned_cutoff
        least = min(lower, IN_SINGLE_ELEMENT) if single else lower
        others = with_thinning(others, cutoff=least * cutoff, unturned_cutoff=lower * unturned)
    of_ghosts = tables._replace(aim=aim_at_ghosts(tables, world.ghosts), ghosts=world.ghosts)
    return (
        image_path,
        Part(Estimator.STRAYS, others, tables._replace(aim=strays), thinned),
        Part(Estimator.GHOSTS, along_path._replace(paths=GHOSTS), of_ghosts, IMAGE_PATHS_PER_GHOST, accounts=False),
        *lamps,
    )


def _off_image_path(options: Options, world: World) -> Options:
    """Return the options of the part that estimates paths off the image path."""
    options = options._replace(paths=OFF_IMAGE_PATH)
    if options.thinning.split == BOTH and not has_glass(world):
        # Scattered paths can leave the image path only in the lens, and few reach it.
        return with_thinning(options, unturned_cutoff=SCATTERED_PER_FOLLOWED * options.thinning.cutoff)
    return options


def _aimed_through(tables: Tables, through: GlassAim | None) -> Tables:
    """Return tables that aim light from inside glass and liquids at the lens."""
    return tables._replace(aim=tables.aim._replace(entrance=tables.aim.entrance._replace(glass=through)))


def lamp_parts(world: World, through: GlassAim | None) -> tuple[Part, ...]:
    """Return the part of an adjoint image traced from lamps, if there is such light; `through` is from `glass_aim`."""
    objects = aimed_at_glass(world.tables.objects, world.tables.motions)
    if objects is None:
        return ()
    return (_from_lamps(Estimator.LAMPS_THROUGH_GLASS, world, objects, through, LAMP_THROUGH_GLASS),)


def camera_parts(world: World, through: GlassAim | None) -> tuple[Part, ...]:
    """Return the part of an image for lamp light scattered first by rough surfaces of the camera, if there is any.

    `through` is from `glass_aim`.
    """
    if not world.scene.rough_in_camera():
        return ()
    tables = world.tables
    objects = aimed_at_camera(tables.objects, tables.lens, tables.frames, tables.motions)
    if objects is None:
        return ()
    return (_from_lamps(lamps_on_camera(len(world.particles)), world, objects, through, LAMP_ON_CAMERA),)


def _from_lamps(number: int, world: World, objects: ObjectTables, through: GlassAim | None, paths: int) -> Part:
    """Return a part traced forward from lamps, with tables that hold their aim."""
    options = options_of(world)._replace(adjoint=False, importance=False, paths=paths)
    if objects.fields is not None:
        # A scattered packet may find the lens beside the aim.
        options = options._replace(bounce=True)
    tables = _aimed_through(world.aimed_tables._replace(objects=objects), through)
    return Part(number, options, tables, book=LAMP_BOOK)


def adds_particles(world: World) -> bool:
    """Tell whether the light of particles is added to the image as waves, because of diffraction."""
    return bool(world.particles) and world.scene.transport.diffraction != "none"


def particle_parts(world: World, through: GlassAim | None) -> tuple[Part, ...]:
    """Return the parts of an image traced from particles; `through` is from `glass_aim`.

    Targets hide particles. They are black in these parts, since packets from particles reach them only by chance. With
    diffraction there are no such parts, see `adds_particles`.
    """
    if not world.particles or adds_particles(world):
        return ()
    options = options_of(world)._replace(adjoint=False, importance=False, bounce=False)
    objects = world.tables.objects
    models = objects.scattering.models.copy()
    models["kind"], models["first"], models["black"] = LAMBERTIAN, 0, True
    black = ScatteringTables(models, np.zeros((1, objects.scattering.parameters.shape[1])))
    tables = _aimed_through(world.aimed_tables._replace(objects=objects._replace(scattering=black)), through)
    return tuple(
        Part(Estimator.PARTICLES + number, options, tables, book=LAMP_BOOK, particles=particles)
        for number, particles in enumerate(world.particles)
    )


def blind_part(world: World) -> Part:
    """Return a part that estimates all paths in another way, to check the other parts.

    Unaimed rays check the adjoint method. Paths from the pixels check a forward image: they bring light far more often
    than unaimed packets, and lack the limits of the forward method.
    """
    if world.scene.transport.method == "forward":
        adjoint = copy(world)
        adjoint.scene = world.scene.changed({"transport.method": "adjoint"})
        return Part(Estimator.BLIND_CHECK, options_of(adjoint), world.aimed_tables, accounts=False)
    return Part(
        Estimator.BLIND_CHECK, options_of(world), world.tables._replace(aim=without_aim(world.aim)), accounts=False
    )


def finds_all(world: World) -> bool:
    """Tell whether the blind part finds all light that it checks.

    Paths from the pixels, which check a forward image, miss light of lamps through glass.
    """
    tables = world.tables
    return world.scene.transport.method == "adjoint" or aimed_at_glass(tables.objects, tables.motions) is None


def in_words(scene: Scene, parts: tuple[Part, ...]) -> str:
    """Describe the engine of an image, the reason, and its parts for ghosts, lamps and particles."""
    words = ": ".join(engine_of(scene))
    if any(part.options.paths == GHOSTS for part in parts):
        words += ", ghosts by sequence"
    if any(part.options.paths == LAMP_THROUGH_GLASS for part in parts):
        bending = parts[0].tables.objects.fields is not None
        words += f"; lamps' light through {'media that bend it' if bending else 'glass'} forward"
    if any(part.options.paths == LAMP_ON_CAMERA for part in parts):
        words += "; lamps' light on the camera's rough surfaces forward"
    if scene.particles and scene.transport.diffraction != "none":
        words += "; particles by point spreads"
    return f"{words}; particles forward" if any(part.particles is not None for part in parts) else words
