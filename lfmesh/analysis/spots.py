"""Spots: intersections of a field's rays with the image plane, their size, and the geometric MTF."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Spot:
    """Intersections of one field's rays with the image plane, for all wavelengths together.

    Each ray represents an equal area of the stop, weighted by its Fresnel transmittance. The reference is the primary
    chief ray; without one it is the mean position, and figures from the chief ray are NaN.

    Attributes
    ----------
    slope_y : float
        Slope of the field: height over distance, or tangent of the angle.
    chief_mm : (2,) float64
        Intersection of the chief ray, regardless of apertures; NaN if it misses a surface, is totally reflected, or
        turns back in gradient-index glass.
    reference_mm : (2,) float64
        Position of the reference point.
    place_mm : (n, 2) float64
        Positions relative to the reference.
    weight : (n,) float64
    wavelength_nm : (n,) float64
        Wavelength of each ray.
    passed : float
        Unvignetted fraction of the stop.
    chief_blocked_by : str
        What ends the chief ray, in words; empty if it arrives.
    """

    slope_y: float
    chief_mm: Array
    reference_mm: Array
    place_mm: Array
    weight: Array
    wavelength_nm: Array
    passed: float
    chief_blocked_by: str = ""

    @cached_property
    def centroid_mm(self) -> Array:
        """(2,): mean position, relative to the reference."""
        return np.asarray(np.average(self.place_mm, axis=0, weights=self.weight))

    @cached_property
    def rms_mm(self) -> float:
        """Root mean square distance from the centroid."""
        return self.rms_about(self.centroid_mm)

    @cached_property
    def rms_chief_mm(self) -> float:
        """Root mean square distance from the chief ray."""
        return self.rms_about(self.chief_mm - self.reference_mm)

    @cached_property
    def geo_mm(self) -> float:
        """Largest distance from the chief ray (OpticStudio's GEO radius, chief ray as reference)."""
        return self.reach_mm if self.has_chief else math.nan

    @cached_property
    def reach_mm(self) -> float:
        """Largest distance from the reference."""
        return float(np.hypot(*self.place_mm.T).max())

    @property
    def has_chief(self) -> bool:
        """True if there is a chief ray."""
        return bool(np.isfinite(self.chief_mm).all())

    def rms_about(self, point_mm: ArrayLike) -> float:
        """Return the root mean square distance from a point given relative to the reference, mm."""
        off = self.place_mm - np.asarray(point_mm)
        return float(np.sqrt(np.average((off * off).sum(axis=1), weights=self.weight)))

    def mtf(self, per_mm: ArrayLike, *, tangential: bool) -> Array:
        """Return the geometric MTF: the modulus of the spot's Fourier transform, without diffraction.

        Parameters
        ----------
        per_mm : (m,) float
            Line pairs per mm.
        tangential : bool
            Lines along x, blurred along y (the meridional direction); otherwise sagittal.
        """
        along = self.place_mm[:, 1 if tangential else 0]
        phase = np.exp(-2j * np.pi * np.multiply.outer(np.asarray(per_mm, dtype=np.float64), along))
        return np.asarray(np.abs(phase @ self.weight) / self.weight.sum())


def half_contrast(frequencies: Array, mtf: Array) -> float:
    """Return the frequency at which an MTF first falls to one half; NaN if it does not.

    Parameters
    ----------
    frequencies : (f,) float64
        Ascending.
    mtf : (f,) float64
        At these frequencies.
    """
    below = np.flatnonzero(mtf < 0.5)
    if not below.size or below[0] == 0:
        return float("nan")
    j = int(below[0])
    return float(np.interp(-0.5, [-mtf[j - 1], -mtf[j]], [frequencies[j - 1], frequencies[j]]))
