"""Pictures of particles by their point spreads: each is a point whose waves pass lens and lenslets coherently.

Light of different particles does not interfere, so their pictures add up. Spreads are not interpolated: they change
within a resolved length of the camera, so that a grid of them has more points than nearly all scenes have particles.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError, warn_caller
from lfmesh.geometry import frame as frames
from lfmesh.scene.media.phase import IsotropicPhase
from lfmesh.transport.packets.packet import CAMERA_FRAME, WORLD_FRAME
from lfmesh.transport.render.progress import Progress
from lfmesh.transport.world import World
from lfmesh.waves.point_spread import followed, refuse_point, warnings_of
from lfmesh.waves.refused import NoLightError

Array = NDArray[np.float64]

MOST_SPREADS = 2000
"""Point spreads of a picture: they take seconds each."""

STAGE = "point spreads of particles"


def particle_film(world: World, progress: Callable[[Progress], None] | None = None) -> Array:
    """Return the light of a scene's particles on each pixel, (rows, columns, wavelengths) W.

    Parameters
    ----------
    world : World
    progress : callable, optional
        Told of each point spread.

    Warns
    -----
    DiffractionWarning
        As from `lf.point_spread`.

    Raises
    ------
    LfmeshError
        Bands, particles that scatter unevenly, too many of them, or what `lf.point_spread` refuses.
    """
    scene = world.scene
    refuse_particles(world)
    columns, rows = scene.camera.sensor.pixels
    film = np.zeros((rows, columns, scene.channels))
    done, all_of_them, began, beyond = 0, _spreads(world), time.perf_counter(), 0.0
    for each in _particles(world):
        # Power over all directions, of which an even share goes each way.
        for channel, power in enumerate(each.power_w):
            with each.named():
                spread = followed(scene, each.point_mm, scene.wavelengths_nm[channel])
                film[:, :, channel] += power / (4.0 * np.pi) * spread.mean
                beyond = max(beyond, spread.beyond)
            done += 1
            if progress is not None:
                progress(Progress(done, all_of_them, time.perf_counter() - began, 0, 0, STAGE))
    warn_caller(warnings_of(beyond))
    return film


def refuse_particles(world: World) -> None:
    """Refuse particles that cannot be pictured by waves, before any of their waves are followed.

    Parameters
    ----------
    world : World

    Raises
    ------
    LfmeshError
        As from `particle_film`. Of each particle a few hundred rays are traced; that its grids must be finer than the
        first two is not foreseen.
    """
    _refuse(world)
    for each in _particles(world):
        with each.named():
            refuse_point(world.scene, each.point_mm, world.scene.wavelengths_nm)


class _Particle(NamedTuple):
    """A particle of a world: number of its entry, its own number, place in world and camera, power of each channel."""

    entry: int
    number: int
    place_mm: Array
    point_mm: Array
    power_w: Array

    @contextmanager
    def named(self) -> Iterator[None]:
        """Name the particle in what is refused of it; one of which no light comes is dark."""
        try:
            yield
        except NoLightError:
            pass
        except LfmeshError as error:
            where = ", ".join(f"{x:g}" for x in self.place_mm)
            raise LfmeshError(
                f"particles[{self.entry}], number {self.number} at ({where}) mm: {error}; or picture particles by "
                'rays: transport.diffraction = "none"'
            ) from None


def _particles(world: World) -> Iterator[_Particle]:
    into_camera = world.tables.frames[WORLD_FRAME, CAMERA_FRAME]
    for table in world.particles:
        points = zip(table.points, frames.points(into_camera, table.points), table.strength, strict=True)
        for number, (there, point, strength) in enumerate(points):
            yield _Particle(table.entry, number, there, point, strength * table.scale)


def _spreads(world: World) -> int:
    """Return the number of point spreads of a world's particles."""
    return world.scene.channels * sum(len(table.points) for table in world.particles)


def _refuse(world: World) -> None:
    scene, chosen = world.scene, f'transport.diffraction = "{world.scene.transport.diffraction}"'
    if scene.camera.sensor.bands:
        raise LfmeshError(
            f"camera.sensor.bands: particles with {chosen} are pictured at single wavelengths; leave bands out"
        )
    for table in world.particles:
        phase = scene.particles[table.entry].phase
        if not isinstance(phase, IsotropicPhase):
            raise LfmeshError(
                f'particles[{table.entry}].phase.kind = "{phase.kind}": with {chosen} particles send light evenly; '
                'take "isotropic", or transport.diffraction = "none"'
            )
    spreads = _spreads(world)
    if spreads > MOST_SPREADS:
        raise LfmeshError(
            f"{chosen}: particles need {spreads:,} point spreads, some seconds each, {MOST_SPREADS:,} are possible; "
            'give fewer particles, or transport.diffraction = "none"'
        )
