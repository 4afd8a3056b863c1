"""Photographs computed from a light field: one plane, a stack of planes, or all in focus."""

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lfmesh.notebook import Pictured
from lfmesh.scene.literals import counted

Array = NDArray[np.float64]

SHARPNESS_RADIUS = 2
"""Half width, in samples, of the windows in which sharpness is compared."""

LEAST_SHARE = 0.5 / (2 * SHARPNESS_RADIUS + 1) ** 2
"""Fraction of a window equal to half a sample; less means none."""


@dataclass(frozen=True, eq=False)
class Photograph(Pictured):
    """Photograph of one plane, as from a conventional camera focused on it.

    Attributes
    ----------
    mean : (t, s, c) float64
        Upright; NaN where no view has data.
    stderr : (t, s, c) float64
    distance_mm : float
        Object distance of the plane, in front of the first vertex.
    f_number : float
        Image-side f-number of the aperture used.
    sample_mm : float
        Size of a sample (along s) in the plane.
    wavelengths_nm : tuple of float
    unit : str
        As for the light field.
    method : str
        Method of computation.
    """

    mean: Array
    stderr: Array
    distance_mm: float
    f_number: float
    sample_mm: float
    wavelengths_nm: tuple[float, ...]
    unit: str
    method: str = "shift"

    def __repr__(self) -> str:
        return (
            f"<Photograph: {_samples(self.mean)}, focused on {self.distance_mm:.6g} mm, f/{self.f_number:.3g}, "
            f"{self.unit}>"
        )


@dataclass(frozen=True, eq=False)
class FocalStack(Pictured):
    """Photographs of the same scene in several planes."""

    photographs: tuple[Photograph, ...]
    """In the order of the given distances."""

    def __repr__(self) -> str:
        planes = self.distances_mm
        return (
            f"<FocalStack: {len(planes)} photographs of {_samples(self.photographs[0].mean)}, "
            f"{planes[0]:.6g} to {planes[-1]:.6g} mm>"
        )

    @property
    def distances_mm(self) -> tuple[float, ...]:
        """Object distances of the planes."""
        return tuple(photograph.distance_mm for photograph in self.photographs)

    @property
    def mean(self) -> Array:
        """(planes, t, s, c)."""
        return np.stack([photograph.mean for photograph in self.photographs])


@dataclass(frozen=True, eq=False)
class AllInFocus(Pictured):
    """The sharpest photograph of a stack at each sample.

    Attributes
    ----------
    mean, stderr : (t, s, c) float64
    distance_mm : (t, s) float64
        Plane of each sample.
    wavelengths_nm : tuple of float
    unit : str
    """

    mean: Array
    stderr: Array
    distance_mm: Array
    wavelengths_nm: tuple[float, ...]
    unit: str

    def __repr__(self) -> str:
        planes = self.distance_mm
        return (
            f"<AllInFocus: {_samples(self.mean)}, planes from {planes.min():.6g} to {planes.max():.6g} mm, {self.unit}>"
        )


def _samples(mean: Array) -> str:
    height, width, channels = mean.shape
    return f"{width} × {height} samples, {counted(channels, 'wavelength')}"


def all_in_focus(stack: FocalStack) -> AllInFocus:
    """Take every sample from the photograph of a stack that is sharpest there.

    Sharpness is the mean energy of the Laplacian in a window of 5 × 5 samples, summed over the channels. Samples next
    to unknown ones have none; unknown ones are taken only if no photograph knows them.

    Parameters
    ----------
    stack : FocalStack
        From `lf.focal_stack`.

    Returns
    -------
    AllInFocus
    """
    sharpness = np.stack([_sharpness(photograph.mean) for photograph in stack.photographs])
    best = sharpness.argmax(axis=0)
    first = stack.photographs[0]

    def sharpest(values: list[Array]) -> Array:
        return np.take_along_axis(np.stack(values), best[None, :, :, None], axis=0)[0]

    return AllInFocus(
        mean=sharpest([photograph.mean for photograph in stack.photographs]),
        stderr=sharpest([photograph.stderr for photograph in stack.photographs]),
        distance_mm=np.asarray(stack.distances_mm)[best],
        wavelengths_nm=first.wavelengths_nm,
        unit=first.unit,
    )


def _sharpness(picture: Array) -> Array:
    """Return the energy of the Laplacian around every sample, (t, s); −1 if the sample is unknown."""
    known = np.asarray(np.isfinite(picture).all(axis=2))
    filled = np.where(known[..., None], picture, 0.0)
    energy = sum(ndimage.laplace(filled[..., c], mode="nearest") ** 2 for c in range(picture.shape[2]))
    # The border of the known samples is not an edge.
    whole = ndimage.binary_erosion(known, border_value=1)
    window = partial(ndimage.uniform_filter, size=2 * SHARPNESS_RADIUS + 1, mode="nearest")
    total, count = window(np.where(whole, energy, 0.0)), window(whole.astype(np.float64))
    sharp = np.divide(total, count, out=np.zeros_like(total), where=count > LEAST_SHARE)
    return np.where(known, sharp, -1.0)
