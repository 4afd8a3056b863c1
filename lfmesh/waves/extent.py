"""Extent of a point's light between lens and sensor, and the grid for it."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.waves.angular_spectrum import Grid
from lfmesh.waves.camera_faces import GRAZING, WaveFace, outside
from lfmesh.waves.pupil_waves import PupilRays
from lfmesh.waves.wave_camera import WaveCamera

Array = NDArray[np.float64]

FIRST_BAND, FIRST_RINGS = 1.5, 30.0
"""Range of directions of the first grid, over that of the rays, and its margin in units of λ / 2 NA."""

FINER = 1.25
"""Factor by which each grid is finer and wider than the one before."""

LEAST, MOST = 128, 3072
"""Grid points per side, smallest and largest number."""

CAUSES = (
    ("its rays at lenslets or sensor are", "give a point nearer the plane in focus, or a smaller stop"),
    ("the diffraction rings of its narrow beam are", "give a wider stop"),
    ("lenslets make it", "give a smaller pitch of the same f-number"),
)
"""Causes of large grids and remedies, for rays, rings and lenslets."""


@dataclass(frozen=True)
class Extent:
    """Light of a point behind the lens, and the faces and sensor in its way.

    Attributes
    ----------
    pupil : PupilRays
    faces : list of WaveFace
        From the lens to the sensor.
    sensor_mm : (3,) float64
        Centre of the sensor, camera frame.
    pixels_mm : (2,) float64
        Width and height of the pixel array.
    """

    pupil: PupilRays
    faces: list[WaveFace]
    sensor_mm: Array
    pixels_mm: Array

    @classmethod
    def of(cls, camera: WaveCamera, wavelength_nm: float, pupil: PupilRays) -> "Extent":
        """Return the extent of the light behind a camera's lens.

        Parameters
        ----------
        camera : WaveCamera
        wavelength_nm : float
        pupil : PupilRays
        """
        sensor = camera.scene.camera.sensor
        pixels_mm = np.asarray(sensor.pixels) * sensor.pixel_mm
        return cls(pupil, camera.faces(wavelength_nm), camera.sensor_mm, pixels_mm)

    @property
    def relief(self) -> list[WaveFace]:
        """Faces with lenslets."""
        return [face for face in self.faces if face.lenslets is not None]

    @property
    def misses(self) -> bool:
        """True if light misses the lenslets, or without them the pixels, by more than the first grid's margin."""
        face = next(iter(self.relief), None)
        # Behind the plane faces before it, light is nearer to the axis than in air, but not nearer than at the first
        # one.
        planes = [*(each.z_mm for each in self.faces[:1]), face.z_mm if face else float(self.sensor_mm[2])]
        places = np.vstack([self.pupil.places_at(z) for z in planes])
        missed = face.missed_by(places) if face else outside(places - self.sensor_mm[:2], 0.5 * self.pixels_mm)
        return missed > FIRST_RINGS * self.pupil.wavelength_mm / (2.0 * float(self.pupil.half.max()))

    @cached_property
    def _half_and_band(self) -> tuple[float, float, float, float]:
        """Half widths of rays, rings and lenslets' addition, mm, and range of directions."""
        pupil, sensor_z = self.pupil, float(self.sensor_mm[2])
        reach = 0.0
        # Plane faces keep each direction, so the grid need not hold the light across them.
        index = pupil.index
        p = np.vstack([pupil.middle, index * pupil.rays[1][:, :2]])
        z = self.faces[0].z_mm if self.faces else sensor_z
        way = (z - pupil.focus_mm[2]) / math.sqrt(index**2 - float(pupil.middle @ pupil.middle))
        places = np.vstack([pupil.focus_mm[:2] + way * pupil.middle, pupil.places_at(z)])
        for face in [*self.faces, None]:
            end = sensor_z if face is None else face.z_mm
            along = np.sqrt(np.maximum(index**2 - (p**2).sum(axis=1, keepdims=True), GRAZING**2))
            places, z = places + (end - z) * p / along, end
            if face is None or face.lenslets is not None:
                reach = max(reach, float(np.abs(places[1:] - places[0]).max()))
            index = index if face is None else face.index
        cone = float(pupil.half.max())
        rings, added, turned, index = FIRST_RINGS * pupil.wavelength_mm / (2.0 * cone), 0.0, 0.0, pupil.index
        for face in self.faces:
            turn, pitch = face.turn(pupil.places_at(face.z_mm), index, pupil.wavelength_mm)
            turn += 4.0 * pupil.wavelength_mm / pitch if pitch else 0.0
            added += pitch + turn * (sensor_z - face.z_mm)
            turned, index = turned + turn, face.index
        band = FIRST_BAND * (cone + turned) + pupil.index * (reach + rings + added) / abs(pupil.radius_mm)
        return reach, rings, added, band

    def grid(self, fineness: float, words: str) -> Grid:
        """Return a grid finer and wider than the first one by a factor.

        Parameters
        ----------
        fineness : float
        words : str
            Name of the point for messages.

        Raises
        ------
        LfmeshError
            The grid needs more than `MOST` points per side.
        """
        wide, (places, step) = self._half_and_band[:3], self._places(fineness)
        if places > MOST:
            cause, advice = CAUSES[int(np.argmax(wide))]
            raise LfmeshError(
                f"{words}: its waves need grids of {places} points per side, above the limit of {MOST}: "
                f"{cause} {2e3 * max(wide):.4g} µm wide; {advice}"
            )
        return Grid(scipy.fft.next_fast_len(places // 2) * 2, step, self.pupil.wavelength_mm, self.pupil.middle)

    def refuse_wide(self, words: str) -> None:
        """Refuse light for which the second grid, which each spread needs, is too large.

        Parameters
        ----------
        words : str
            Name of the point for messages.
        """
        self.grid(FINER, words)

    def fits(self, fineness: float) -> bool:
        """Tell whether a grid, see `grid`, has at most `MOST` points per side.

        Parameters
        ----------
        fineness : float
        """
        return self._places(fineness)[0] <= MOST

    def _places(self, fineness: float) -> tuple[int, float]:
        """Return the number of grid points per side, and their distance, mm."""
        *wide, band = self._half_and_band
        step = self.pupil.wavelength_mm / (2.0 * band * fineness)
        return max(LEAST, math.ceil(sum(wide) * fineness / step) * 2), step
