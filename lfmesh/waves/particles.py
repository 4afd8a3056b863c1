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
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.optics.phase import PhaseTables, evaluate_phases
from lfmesh.transport.packets.packet import CAMERA_FRAME, WORLD_FRAME
from lfmesh.transport.render.progress import Progress
from lfmesh.transport.world import World, build
from lfmesh.waves.bundle import LensRays, pupil_grid
from lfmesh.waves.point_spread import followed, refuse_point, warnings_of
from lfmesh.waves.refused import TRIALS, NoLightError

Array = NDArray[np.float64]

MOST_SPREADS = 2000
"""Point spreads of a picture: they take seconds each."""

EVEN = 0.05
"""Largest change of a particle's light over the lens's opening, over the mean, with which it is pictured."""

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
        Bands, particles whose light changes much over the lens's opening, too many of them, or what `lf.point_spread`
        refuses.
    """
    scene = world.scene
    refuse_particles(world)
    columns, rows = scene.camera.sensor.pixels
    film = np.zeros((rows, columns, scene.channels))
    done, all_of_them, began, beyond = 0, _spreads(world), time.perf_counter(), 0.0
    lens = build(solved_camera(scene).scene.camera_alone())
    for each in _particles(world):
        for channel, wavelength in enumerate(scene.wavelengths_nm):
            with each.named():
                spread = followed(scene, each.point_mm, wavelength)
                film[:, :, channel] += each.intensity_w_sr(lens, channel, wavelength) * spread.mean
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
    scene, lens = world.scene, build(solved_camera(world.scene).scene.camera_alone())
    for each in _particles(world):
        with each.named():
            refuse_point(scene, each.point_mm, scene.wavelengths_nm)
            for channel, wavelength in enumerate(scene.wavelengths_nm):
                each.intensity_w_sr(lens, channel, wavelength)


class _Particle(NamedTuple):
    """A particle of a world.

    Attributes
    ----------
    entry, number : int
        Of its entry, and its own there.
    place_mm, point_mm : (3,) float64
        World and camera frame.
    power_w : (channels,) float64
        Over all directions.
    along : (3,) float64
        Way of the light that it scatters, camera frame.
    phases : PhaseTables
        By the angle to it.
    """

    entry: int
    number: int
    place_mm: Array
    point_mm: Array
    power_w: Array
    along: Array
    phases: PhaseTables

    def intensity_w_sr(self, lens: World, channel: int, wavelength_nm: float) -> float:
        """Return the mean intensity into the lens's opening.

        Parameters
        ----------
        lens : World
            The camera alone.
        channel : int
        wavelength_nm : float

        Raises
        ------
        LfmeshError
            It changes too much over the opening.
        """
        rays = LensRays(lens, -float(self.point_mm[2]), 0.0)
        bundle = rays.bundle(self.point_mm[:2] / rays.object_mm, pupil_grid(TRIALS), wavelength_nm)
        ahead = np.column_stack([bundle.entry[bundle.passes], np.zeros(bundle.passes.sum())]) - self.point_mm
        sent = np.empty(len(ahead))
        evaluate_phases(self.phases, channel, ahead @ self.along / np.linalg.norm(ahead, axis=1), sent)
        mean = float(sent.mean())
        change = float(np.abs(sent - mean).max()) / mean
        if change > EVEN:
            raise LfmeshError(
                f"the light that it scatters changes by {change:.2g} of its mean over the lens's opening, and point "
                f"spreads stand for changes up to {EVEN:g}; take smaller particles or a smaller opening"
            )
        return float(self.power_w[channel]) * mean

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
        along = frames.directions(into_camera, table.along[None, :])[0]
        points = zip(table.points, frames.points(into_camera, table.points), table.strength, strict=True)
        for number, (there, point, strength) in enumerate(points):
            yield _Particle(table.entry, number, there, point, strength * table.scale, along, table.phases)


def _spreads(world: World) -> int:
    """Return the number of point spreads of a world's particles."""
    return world.scene.channels * sum(len(table.points) for table in world.particles)


def _refuse(world: World) -> None:
    scene, chosen = world.scene, f'transport.diffraction = "{world.scene.transport.diffraction}"'
    if scene.camera.sensor.bands:
        raise LfmeshError(
            f"camera.sensor.bands: particles with {chosen} are pictured at single wavelengths; leave bands out"
        )
    spreads = _spreads(world)
    if spreads > MOST_SPREADS:
        raise LfmeshError(
            f"{chosen}: particles need {spreads:,} point spreads, some seconds each, {MOST_SPREADS:,} are possible; "
            'give fewer particles, or transport.diffraction = "none"'
        )
