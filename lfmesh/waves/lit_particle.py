"""A particle seen by the lens: light into the opening and grid of its waves, from a few hundred rays."""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.optics.phase import PhaseTables, evaluate_phases
from lfmesh.scene.literals import plain
from lfmesh.waves.bundle import Bundle
from lfmesh.waves.extent import FINER, Extent
from lfmesh.waves.point_spread import TOLERANCE, Asked, PointSpread, followed
from lfmesh.waves.pupil_waves import pupil_rays
from lfmesh.waves.refused import NoLightError, refuse_values
from lfmesh.waves.stop_aim import INSIDE
from lfmesh.waves.wave_camera import WaveCamera, entering

Array = NDArray[np.float64]
Found = TypeVar("Found")

EVEN = 0.05
"""Largest accepted change of a particle's light over the lens's opening, over the mean."""


class Lit(NamedTuple):
    """A particle seen by the lens at one wavelength.

    Attributes
    ----------
    name : str
        For messages.
    point_mm : (3,) float64
        Camera frame.
    intensity_w_sr : float
        Into the lens's opening.
    place_mm : (2,) float64
        Its chief ray on the sensor's plane, camera frame; NaN if the lens stops it.
    period_mm, step_mm : float
        Width and step of the grid that its waves need.
    """

    name: str
    point_mm: Array
    intensity_w_sr: float
    place_mm: Array
    period_mm: float
    step_mm: float

    def own_spread(self, camera: WaveCamera, wavelength_nm: float) -> PointSpread | None:
        """Return its point spread for 1 W/sr, or None if none of its light falls on the pixels.

        Parameters
        ----------
        camera : WaveCamera
        wavelength_nm : float

        Raises
        ------
        LfmeshError
            As from `lf.point_spread`, with the particle's name.
        """
        asked = Asked(tolerance=TOLERANCE, of_all=True)
        return _named(self.name, lambda: followed(camera, self.point_mm, wavelength_nm, asked=asked))


class Particle(NamedTuple):
    """A particle of a world.

    Attributes
    ----------
    entry, number : int
        Index of its entry, and in the entry.
    place_mm, point_mm : (3,) float64
        World and camera frame.
    power_w : (channels,) float64
        Over all directions.
    along : (3,) float64
        Direction of the light that it scatters, camera frame.
    phases : PhaseTables
        Phase function by the angle to `along`.
    """

    entry: int
    number: int
    place_mm: Array
    point_mm: Array
    power_w: Array
    along: Array
    phases: PhaseTables

    @property
    def name(self) -> str:
        """Name for messages."""
        where = ", ".join(f"{x:g}" for x in self.place_mm)
        return f"particles[{self.entry}], number {self.number} at ({where}) mm"

    def lit(self, camera: WaveCamera, channel: int, *, hides: bool) -> Lit | None:
        """Return the particle as the lens sees it at a wavelength, or None if it is dark.

        Parameters
        ----------
        camera : WaveCamera
        channel : int
        hides : bool
            Look for targets that hide it.

        Raises
        ------
        LfmeshError
            A target hides part of it, its light changes too much over the opening, or its waves are too wide.
        """
        return _named(self.name, lambda: self._lit(camera, channel, hides=hides))

    def _lit(self, camera: WaveCamera, channel: int, *, hides: bool) -> Lit | None:
        wavelength = camera.scene.wavelengths_nm[channel]
        refuse_values(camera.scene, self.point_mm, None, 1, TOLERANCE)
        bundle = camera.looked_at(self.point_mm, wavelength)
        if not bundle.passes.any():
            return None
        if hides:
            camera.refuse_hidden(self.point_mm, bundle, wavelength)
        intensity = self._intensity_w_sr(bundle, channel)
        rays = pupil_rays(bundle, camera.camera, float(camera.sensor_mm[2]), wavelength)
        extent = Extent.of(camera, wavelength, rays)
        if extent.misses:
            return None
        grid = extent.grid(FINER, f"point_mm = {self.point_mm.tolist()}")
        return Lit(self.name, self.point_mm, intensity, bundle.place[0], grid.n * grid.step_mm, grid.step_mm)

    def _intensity_w_sr(self, bundle: Bundle, channel: int) -> float:
        """Return the mean intensity into the lens's opening; refuse large changes over it."""
        ahead = entering(self.point_mm, bundle)
        sent = np.empty(len(ahead))
        evaluate_phases(self.phases, channel, ahead @ self.along / np.linalg.norm(ahead, axis=1), sent)
        # Rays on the rim are not evenly spread.
        inside = np.hypot(*bundle.pupil[bundle.passes].T) < INSIDE
        mean = float(sent[inside].mean()) if inside.any() else float(sent.mean())
        change = float(np.abs(sent - mean).max()) / mean
        if change > EVEN:
            raise LfmeshError(
                f"its scattered light varies by {plain(change, 2)} of the mean over the lens's opening, but point "
                f"spreads are valid up to {EVEN:g}; use smaller particles or a smaller opening"
            )
        return float(self.power_w[channel]) * mean


def _named(name: str, found: Callable[[], Found]) -> Found | None:
    """Return a function's result, or None without light; add the particle's name to errors."""
    try:
        return found()
    except NoLightError:
        return None
    except LfmeshError as error:
        raise LfmeshError(f'{name}: {error}; or picture particles by rays: transport.diffraction = "none"') from None
