"""Detector: photons to electrons to counts, with their noise."""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.lightfield.views.upright import Upright
from lfmesh.notebook import Pictured
from lfmesh.optics.cie import PLANCK_J_S, SPEED_OF_LIGHT_M_S
from lfmesh.scene.camera.bands import RGB_NM, channel_labels
from lfmesh.transport.render.image import Image

Array = NDArray[np.float64]

PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")

MOST_BITS = 16
MOST_ELECTRONS = 1e15
"""Most electrons expected in a pixel: more than any well, within the range of numpy's Poisson numbers."""

BRIGHT_PERCENTILE = 99.5


@dataclass(frozen=True)
class Exposed(Pictured):
    """An exposed image, (row, column) as on the sensor.

    Attributes
    ----------
    counts : (H, W) uint16
    expected_e : (H, W) float64
        Photoelectrons expected in each pixel, without dark current.
    saturated : (H, W) bool
        Pixels with a full well.
    detector : Detector
    upright : Upright
        Transformation to the upright picture.
    wavelengths_nm : tuple of float
        Of the image's channels.
    """

    counts: NDArray[np.uint16]
    expected_e: Array
    saturated: NDArray[np.bool_]
    detector: "Detector"
    upright: Upright
    wavelengths_nm: tuple[float, ...]

    def __repr__(self) -> str:
        height, width = self.counts.shape
        full = f"{self.saturated.mean():.2%} saturated"
        return f"<Exposed: {width} × {height} pixels, counts to {self.counts.max()}, {full}>"

    @property
    def electrons(self) -> Array:
        """(H, W): electrons in each pixel by its count, dark current included."""
        return (self.counts.astype(np.float64) - self.detector.black_level) * self.detector.electrons_per_count


@dataclass(frozen=True)
class Detector:
    """A detector by its data sheet.

    Attributes
    ----------
    exposure_s : float
    quantum_efficiency : float
        Electrons per photon.
    bayer : {"RGGB", "BGGR", "GRBG", "GBRG"}, optional
        Colour filters of the first two pixels of the upright picture's first row, then of its second row (default:
        none).
    full_well_e : float
        Full-well capacity, electrons, at the highest count.
    dark_current_e_s : float
        Electrons per second.
    read_noise_e : float
        Standard deviation, electrons.
    bits : int
    black_level : int
        Count of an empty pixel; prevents clipping of read noise.
    seed : int

    Raises
    ------
    LfmeshError
        A value is out of range.
    """

    exposure_s: float = 0.01
    quantum_efficiency: float = 0.6
    bayer: Literal["RGGB", "BGGR", "GRBG", "GBRG"] | None = None
    full_well_e: float = 10000.0
    dark_current_e_s: float = 1.0
    read_noise_e: float = 2.0
    bits: int = 12
    black_level: int = 64
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("exposure_s", "full_well_e"):
            _refuse(name, getattr(self, name), 0.0 < getattr(self, name) < math.inf, "above 0 and finite")
        for name in ("dark_current_e_s", "read_noise_e"):
            _refuse(name, getattr(self, name), 0.0 <= getattr(self, name) < math.inf, "0 or more and finite")
        _refuse("quantum_efficiency", self.quantum_efficiency, 0.0 < self.quantum_efficiency <= 1.0, "in (0, 1]")
        _refuse("bits", self.bits, 1 <= self.bits <= MOST_BITS, f"from 1 to {MOST_BITS}")
        _refuse("black_level", self.black_level, 0 <= self.black_level < self.white_level, "below the highest count")
        _refuse("bayer", self.bayer, self.bayer in (None, *PATTERNS), f"one of {', '.join(PATTERNS)}, or omitted")
        _refuse("seed", self.seed, self.seed >= 0, "0 or more")

    @property
    def white_level(self) -> int:
        """Highest count."""
        return int(2**self.bits - 1)

    @property
    def electrons_per_count(self) -> float:
        """Electrons per step of the converter."""
        return self.full_well_e / (self.white_level - self.black_level)

    def filling(self, image: Image, share: float = 0.8) -> "Detector":
        """Return this detector with the exposure time that fills bright pixels to a fraction of the well.

        Parameters
        ----------
        image : Image
            The 99.5th percentile of its lit pixels counts as bright.
        share : float
            Fraction of the full well.

        Returns
        -------
        Detector

        Raises
        ------
        LfmeshError
            The image is black.
        """
        electrons = self.expected_e(image)
        bright = float(np.percentile(electrons[electrons > 0.0], BRIGHT_PERCENTILE)) if electrons.any() else 0.0
        if not bright > 0.0:
            raise LfmeshError("no exposure time fills the wells: the image is black")
        return replace(self, exposure_s=self.exposure_s * share * self.full_well_e / bright)

    def timed_by(self, image: Image) -> "Detector":
        """Return this detector with the exposure time of an image's scene, or else as `filling` does.

        Parameters
        ----------
        image : Image
            With `exposure` in its scene, the time for which the shutter is open counts.

        Returns
        -------
        Detector

        Raises
        ------
        LfmeshError
            The image is black, and its scene has no exposure.
        """
        exposure = image.scene.exposure
        return self.filling(image) if exposure is None else replace(self, exposure_s=exposure.open_s)

    def electrons_per_watt(self, wavelengths_nm: tuple[float, ...]) -> Array:
        """Return the photoelectrons per watt in each channel of an image, (filters, channels).

        Power · time / (hc/λ) · efficiency · filter, with rows for red, green and blue of a mosaic, else one row. Each
        filter passes the band of its name (R, G or B), at its centroid. Single wavelengths pass the Gaussian filters
        `RGB_NM`.

        Parameters
        ----------
        wavelengths_nm : tuple of float
            Of the channels.

        Returns
        -------
        (filters, channels) float64
            Electrons per watt.

        Raises
        ------
        LfmeshError
            The bands do not match the filters.
        """
        photons_per_joule = 1e-9 * np.asarray(wavelengths_nm) / (PLANCK_J_S * SPEED_OF_LIGHT_M_S)
        weights = self.exposure_s * self.quantum_efficiency * photons_per_joule
        names = channel_labels(wavelengths_nm)
        if self.bayer is None:
            if len(names) > 1:
                raise LfmeshError(
                    f"camera.sensor.bands = {', '.join(names)}: a detector without filters sees one band, or single "
                    "wavelengths; give bayer, with bands named R, G and B"
                )
            return np.asarray(weights[None])
        if not names:
            return np.asarray(weights * [transmittance(colour, wavelengths_nm) for colour in RGB_NM])
        if not set(RGB_NM) <= set(names):
            raise LfmeshError(
                f"bayer = {self.bayer!r}: its filters see the bands R, G and B, but the sensor's bands are named "
                f"{', '.join(names)}"
            )
        return np.asarray(weights * [[name == colour for name in names] for colour in RGB_NM])

    def expected_e(self, image: Image) -> Array:
        """Return the photoelectrons expected in each pixel, see `electrons_per_watt`.

        Parameters
        ----------
        image : Image

        Returns
        -------
        (H, W) float64
            Electrons.
        """
        by_filter = self.electrons_per_watt(image.wavelengths_nm)
        if self.bayer is None:
            return np.asarray(image.mean @ by_filter[0])
        electrons = np.empty(image.mean.shape[:2])
        upright = Upright.of(image.scene).picture
        picture, light = upright(electrons), upright(image.mean)
        for place, colour in enumerate(self.bayer):
            pixels = np.s_[place // 2 :: 2, place % 2 :: 2]
            picture[pixels] = light[pixels] @ by_filter[list(RGB_NM).index(colour)]
        return electrons

    def expose(self, image: Image) -> Exposed:
        """Draw one exposure: shot noise of light and dark current, full well, read noise, conversion.

        Parameters
        ----------
        image : Image
            Single wavelengths count as lines that carry all of the power.

        Returns
        -------
        Exposed
        """
        random = np.random.Generator(np.random.Philox(self.seed))
        expected = self.expected_e(image)
        lit = np.minimum(expected + self.dark_current_e_s * self.exposure_s, MOST_ELECTRONS)
        collected = random.poisson(lit).astype(np.float64)
        saturated = collected >= self.full_well_e
        read = np.minimum(collected, self.full_well_e) + random.normal(0.0, self.read_noise_e, collected.shape)
        counts = np.clip(np.rint(self.black_level + read / self.electrons_per_count), 0, self.white_level)
        return Exposed(
            counts.astype(np.uint16),
            expected,
            np.asarray(saturated),
            self,
            Upright.of(image.scene),
            image.wavelengths_nm,
        )


def transmittance(colour: str, wavelengths_nm: tuple[float, ...]) -> Array:
    """Return the transmittance of a colour filter at each wavelength, (n,)."""
    centre, width = RGB_NM[colour]
    return np.asarray(np.exp2(-((2.0 * (np.asarray(wavelengths_nm) - centre) / width) ** 2)))


def _refuse(name: str, value: object, valid: bool, must: str) -> None:
    if not valid:
        raise LfmeshError(f"{name} = {value}: must be {must}")
