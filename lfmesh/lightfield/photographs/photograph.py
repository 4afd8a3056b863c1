"""Photographs computed from a light field: one plane, a stack of planes, or every place in focus."""

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lfmesh.notebook import Pictured
from lfmesh.scene.literals import counted

Array = NDArray[np.float64]

SHARPNESS_RADIUS = 2
"""Sharpness is compared over windows that reach this many samples to either side."""

LEAST_SHARE = 0.5 / (2 * SHARPNESS_RADIUS + 1) ** 2
"""Share of a window: that of half a sample, which is none."""


@dataclass(frozen=True, eq=False)
class Photograph(Pictured):
    """Photograph of one plane, as a conventional camera focused on it takes it.

    Attributes
    ----------
    mean : (t, s, c) float64
        Upright; NaN where no view saw anything.
    stderr : (t, s, c) float64
    distance_mm : float
        Object distance of the plane, in front of the first vertex.
    f_number : float
        Image-side f-number of the aperture used.
    sample_mm : float
        Size of a sample (along s) in the plane.
    wavelengths_nm : tuple of float
    unit : str
        As the light field's.
    method : str
        That it was computed by.
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
    """Photographs of the same scene, from plane to plane."""

    photographs: tuple[Photograph, ...]
    """In the order in which the distances were given."""

    def __repr__(self) -> str:
        planes = self.distances_mm
        return (
            f"<FocalStack: {len(planes)} photographs of {_samples(self.photographs[0].mean)}, "
            f"{planes[0]:.6g} to {planes[-1]:.6g} mm>"
        )

    @property
    def distances_mm(self) -> tuple[float, ...]:
        """The planes."""
        return tuple(photograph.distance_mm for photograph in self.photographs)

    @property
    def mean(self) -> Array:
        """(planes, t, s, c)."""
        return np.stack([photograph.mean for photograph in self.photographs])


@dataclass(frozen=True, eq=False)
class AllInFocus(Pictured):
    """The sharpest of a stack's photographs at every place.

    Attributes
    ----------
    mean, stderr : (t, s, c) float64
    distance_mm : (t, s) float64
        The plane that each sample was taken from.
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

    Sharpness is the mean energy of the Laplacian in a window of 5 × 5 samples, summed over the channels. Samples beside
    unknown ones have none, and an unknown sample is taken only where no photograph knows it.

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
    """Return the energy of the Laplacian round every sample, (t, s); −1 where the sample is unknown."""
    known = np.asarray(np.isfinite(picture).all(axis=2))
    filled = np.where(known[..., None], picture, 0.0)
    energy = sum(ndimage.laplace(filled[..., c], mode="nearest") ** 2 for c in range(picture.shape[2]))
    # The border of what is known is no edge.
    whole = ndimage.binary_erosion(known, border_value=1)
    window = partial(ndimage.uniform_filter, size=2 * SHARPNESS_RADIUS + 1, mode="nearest")
    total, count = window(np.where(whole, energy, 0.0)), window(whole.astype(np.float64))
    sharp = np.divide(total, count, out=np.zeros_like(total), where=count > LEAST_SHARE)
    return np.where(known, sharp, -1.0)
