"""Diffraction image of a field: path differences, polychromatic point spread, MTF.

The optical transfer function is the autocorrelation of the pupil function, and the point spread is its transform (J. W.
Goodman, Introduction to Fourier Optics, 6.3). The pupil function is sampled in direction cosines from the primary chief
ray's image point. Its step is the wavelength times a common frequency step, so that all wavelengths add up term by
term.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.geometry.lens.solved_camera import SolvedCamera
from lfmesh.waves.bundle import LensRays
from lfmesh.waves.pupil_waves import PupilWaves, waves_of_field
from lfmesh.waves.wavefront import Wavefront, path_differences, wavefront_of

Array = NDArray[np.float64]

ACROSS, MOST_ACROSS = 160, 1024
"""Smallest and largest number of grid cells across the pupil's diameter."""

WIDER = 4.0
"""Width of the image-plane grid over that of the spot, so that the periodic images do not overlap."""

PLACES = 121
"""Samples along each side of the picture of a point spread."""


@dataclass(frozen=True)
class PathFan:
    """Optical path differences of one field at one wavelength, along the axes of the stop.

    Attributes
    ----------
    pupil : (n,) float64
        Pupil coordinate, -1 to 1 stop radii.
    tangential_waves : (n,) float64
        Meridional rays, relative to this wavelength's chief ray; NaN where blocked.
    sagittal_waves : (n,) float64
        Rays through the stop's x axis.
    """

    pupil: Array
    tangential_waves: Array
    sagittal_waves: Array


@dataclass(frozen=True)
class FieldWaves:
    """Diffraction image of a field.

    Attributes
    ----------
    fans : list of PathFan
        One per wavelength.
    wavefront : Wavefront
        At the primary wavelength.
    transfer : (m, m) complex128
        Optical transfer function by frequency along y and x, mean of all wavelengths, in FFT order; first element:
        power.
    step_per_mm : float
        Step between frequencies.
    in_phase : float
        Sum of the transfer function for in-phase pupils.
    """

    fans: list[PathFan]
    wavefront: Wavefront
    transfer: NDArray[np.complex128]
    step_per_mm: float
    in_phase: float

    def mtf(self, frequencies_per_mm: Array, *, tangential: bool) -> Array:
        """Return the modulus of the transfer function along y (tangential) or x; 0 beyond the grid."""
        line = self.transfer[:, 0] if tangential else self.transfer[0]
        half = len(line) // 2
        known = np.abs(line[:half]) / abs(line[0])
        return np.interp(frequencies_per_mm, self.step_per_mm * np.arange(half), known, right=0.0)

    def point_spread(self, half_mm: float, places: int = PLACES) -> Array:
        """Return the point spread over the in-phase peak, on a square about the image point, indexed (y, x).

        Parameters
        ----------
        half_mm : float
            Half the side of the square.
        places : int
            Samples along each side, each the mean over its cell.
        """
        frequency = np.fft.fftfreq(len(self.transfer), 1.0 / len(self.transfer)) * self.step_per_mm
        width = 2.0 * half_mm / places
        at = (np.arange(places) - 0.5 * (places - 1)) * width
        waves = np.sinc(frequency * width) * np.exp(2j * np.pi * at[:, None] * frequency)
        return np.asarray((waves @ self.transfer @ waves.T).real / self.in_phase)


def field_waves(
    rays: LensRays, camera: SolvedCamera, slope: float, wavelengths_nm: tuple[float, ...], spot_mm: float, fan: Array
) -> FieldWaves:
    """Compute the diffraction image of a field.

    Parameters
    ----------
    rays : LensRays
    camera : SolvedCamera
    slope : float
        See `LensRays.bundle`.
    wavelengths_nm : tuple of float
        The primary one in the middle.
    spot_mm : float
        Largest distance of a ray from the spot's reference in the image plane.
    fan : (n,) float64
        Pupil coordinates, in stop radii.

    Raises
    ------
    LfmeshError
        No chief ray, no light, collimated light, or aberrations too large for the grid.
    """
    primary = wavelengths_nm[len(wavelengths_nm) // 2]
    wavefront = wavefront_of(rays, slope, primary, words="this field")
    along = np.array([0.0, slope])
    pupils = [waves_of_field(rays, camera, along, nm, wavefront.image_mm) for nm in wavelengths_nm]
    widest = 2.0 * max(float(pupil.half.max()) for pupil in pupils)
    wave = max(pupil.wavelength_mm for pupil in pupils)
    across = max(ACROSS, math.ceil(WIDER * 2.0 * spot_mm * widest / wave))
    if across > MOST_ACROSS:
        raise LfmeshError(
            f"rays end {1e3 * spot_mm:.4g} µm from the chief ray, {spot_mm * widest / wave:.3g} times λ / 2 sin u: too "
            "aberrated to be followed as waves"
        )
    step = widest / (across * wave)
    size = scipy.fft.next_fast_len(2 * math.ceil(across * wave / min(pupil.wavelength_mm for pupil in pupils)) + 4)
    transfer, in_phase = np.zeros((size, size), np.complex128), 0.0
    for pupil in pupils:
        of_one, peak = _transfer(pupil, step, size)
        transfer += of_one / len(pupils)
        in_phase += peak / len(pupils)
    fans = [_path_fan(rays, slope, nm, wavefront.image_mm, fan) for nm in wavelengths_nm]
    return FieldWaves(fans, wavefront, transfer, step, in_phase)


def diffraction_limit(frequencies_per_mm: Array, wavelengths_nm: tuple[float, ...], f_number: float) -> Array:
    """Return the MTF of a perfect round pupil, averaged over all wavelengths (Goodman, 6.4.2).

    Parameters
    ----------
    frequencies_per_mm : (f,) float64
    wavelengths_nm : tuple of float
    f_number : float
        1 / 2 sin u.
    """
    total = np.zeros(len(frequencies_per_mm))
    for nm in wavelengths_nm:
        over_cut_off = np.minimum(frequencies_per_mm * nm * 1e-6 * f_number, 1.0)
        total += 2.0 / np.pi * (np.arccos(over_cut_off) - over_cut_off * np.sqrt(1.0 - over_cut_off**2))
    return np.asarray(total / len(wavelengths_nm))


def _transfer(pupil: PupilWaves, step_per_mm: float, size: int) -> tuple[NDArray[np.complex128], float]:
    """Return the autocorrelation of a pupil function on a grid of frequencies, and its in-phase sum."""
    cells = (np.arange(size) - size // 2) * step_per_mm * pupil.wavelength_mm
    waves, _ = pupil.at(pupil.middle[0] + cells, pupil.middle[1] + cells)
    transfer = np.asarray(scipy.fft.fft2(np.abs(scipy.fft.ifft2(waves)) ** 2) * size**2)
    # A cell cut by the rim holds the square of its mean amplitude, which is less than its power.
    transfer[0, 0] = pupil.power_w
    return transfer, float(np.abs(waves).sum() ** 2)


def _path_fan(rays: LensRays, slope: float, wavelength_nm: float, centre: Array, fan: Array) -> PathFan:
    none = np.zeros(len(fan))
    pupil = np.vstack([np.column_stack([none, fan]), np.column_stack([fan, none])])
    bundle, chief = rays.bundle(slope, pupil, wavelength_nm), rays.chief(slope, wavelength_nm)
    waves = np.full(len(pupil), np.nan)
    if chief.exists:
        entry = np.vstack([chief.entry, bundle.entry[bundle.passes]])
        waves[bundle.passes] = path_differences(rays, slope, entry, wavelength_nm, centre)[0][1:]
    return PathFan(fan, *np.split(waves, 2))
