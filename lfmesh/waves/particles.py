"""Pictures of particles as the sum of their point spreads.

Light of different particles does not interfere. Behind an array each particle has its own spread: spreads change within
a resolved length, so a grid of them would outnumber the particles of nearly all scenes. Without an array spreads are
interpolated, see `between`.
"""

import itertools
import time
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.geometry import frame as frames
from lfmesh.transport.packets.packet import CAMERA_FRAME, WORLD_FRAME
from lfmesh.transport.render.image import UntracedLight
from lfmesh.transport.render.progress import Progress
from lfmesh.transport.world import World
from lfmesh.waves.between import add_spreads
from lfmesh.waves.lit_particle import Lit, Particle
from lfmesh.waves.point_spread import warnings_of
from lfmesh.waves.wave_camera import WaveCamera

Array = NDArray[np.float64]

MOST_SPREADS = 2000
"""Most point spreads of a picture behind an array; each takes seconds."""

LOOKING, STAGE = "particles checked", "point spreads of particles"


def particle_film(world: World, progress: Callable[[Progress], None] | None = None) -> UntracedLight:
    """Return the light of a scene's particles on each pixel, with the warnings of `lf.point_spread`.

    Parameters
    ----------
    world : World
    progress : callable, optional
        Called for each particle and wavelength.

    Raises
    ------
    LfmeshError
        Bands, particles with light that changes much over the lens's opening, too many particles behind an array, or a
        refusal of `lf.point_spread`.
    """
    scene = world.scene
    camera, seen = _looked_at(world, progress)
    columns, rows = scene.camera.sensor.pixels
    film, beyond = np.zeros((rows, columns, scene.channels)), 0.0
    for channel, wavelength in enumerate(scene.wavelengths_nm):
        told = _counted(progress, STAGE, len(seen) * scene.channels, channel * len(seen))
        lit = [each for each in (one[channel] for one in seen) if each is not None]
        for _ in range(len(seen) - len(lit)):
            told()
        picture = film[:, :, channel]
        if scene.camera.mla is None:
            add_spreads(camera, wavelength, lit, picture, told)
            continue
        for each in lit:
            spread = each.own_spread(camera, wavelength)
            if spread is not None:
                picture += each.intensity_w_sr * spread.mean
                beyond = max(beyond, spread.beyond)
            told()
    return UntracedLight(film, tuple(warnings_of(beyond)))


def refuse_particles(world: World, progress: Callable[[Progress], None] | None = None) -> None:
    """Refuse particles that waves cannot picture, before computing waves.

    Parameters
    ----------
    world : World
    progress : callable, optional
        Called for each particle.

    Raises
    ------
    LfmeshError
        As from `particle_film`, by a few hundred rays per particle. A need for more than two grids is not detected.
    """
    _looked_at(world, progress)


def _looked_at(
    world: World, progress: Callable[[Progress], None] | None
) -> tuple[WaveCamera, list[tuple[Lit | None, ...]]]:
    """Return the camera and each particle at each wavelength; refuse scenes that waves cannot picture."""
    _refuse(world)
    scene, camera = world.scene, WaveCamera.of(world.scene)
    particles = list(_particles(world))
    told, middle, seen = _counted(progress, LOOKING, len(particles)), len(scene.wavelengths_nm) // 2, []
    for each in particles:
        lit = [each.lit(camera, channel, hides=channel == middle) for channel in range(scene.channels)]
        seen.append(tuple(lit))
        told()
    return camera, seen


def _counted(progress: Callable[[Progress], None] | None, stage: str, total: int, done: int = 0) -> Callable[[], None]:
    """Return a function that reports the progress of a stage at each call."""
    number, began = itertools.count(done + 1), time.perf_counter()

    def told() -> None:
        if progress is not None:
            progress(Progress(next(number), total, time.perf_counter() - began, 0, 0, stage))

    return told


def _particles(world: World) -> Iterator[Particle]:
    into_camera = world.tables.frames[WORLD_FRAME, CAMERA_FRAME]
    for table in world.particles:
        along = frames.directions(into_camera, table.along[None, :])[0]
        points = zip(table.points, frames.points(into_camera, table.points), table.strength, strict=True)
        for number, (there, point, strength) in enumerate(points):
            yield Particle(table.entry, number, there, point, strength * table.scale, along, table.phases)


def _spreads(world: World) -> int:
    """Return the number of point spreads of a world's particles."""
    return world.scene.channels * sum(len(table.points) for table in world.particles)


def _refuse(world: World) -> None:
    scene, chosen = world.scene, f'transport.diffraction = "{world.scene.transport.diffraction}"'
    if scene.camera.sensor.bands:
        raise LfmeshError(
            f"camera.sensor.bands: particles with {chosen} are pictured at single wavelengths; omit bands"
        )
    if scene.moves:
        raise LfmeshError(
            f"{chosen}: particles are pictured by point spreads, which hold for one time, but the scene has motion or "
            'streaks; give transport.diffraction = "none", or omit every motion and frame_time_s'
        )
    spreads = _spreads(world)
    if scene.camera.mla is not None and spreads > MOST_SPREADS:
        raise LfmeshError(
            f"{chosen}: particles behind an array need {spreads:,} point spreads of some seconds each; the limit is "
            f'{MOST_SPREADS:,}; give fewer particles, or transport.diffraction = "none"'
        )
