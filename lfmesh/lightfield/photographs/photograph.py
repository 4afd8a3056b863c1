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

LEAST_COVERAGE = 0.5
"""Coverage, over the largest of a stack, below which sharpness is not compared: few views show every plane sharp."""

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
    coverage : (t, s) float64, optional
        Fraction of the aperture's views with data at each sample; without it, 1 at known samples.
    """

    mean: Array
    stderr: Array
    distance_mm: float
    f_number: float
    sample_mm: float
    wavelengths_nm: tuple[float, ...]
    unit: str
    method: str = "shift"
    coverage: Array | None = None

    @property
    def covered(self) -> Array:
        """(t, s): `coverage`, or 1 at known samples and 0 at others."""
        known = np.asarray(np.isfinite(self.mean).all(axis=2), dtype=np.float64)
        return known if self.coverage is None else np.asarray(known * self.coverage)

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
        Plane of each sample; NaN where sharpness cannot be compared.
    wavelengths_nm : tuple of float
    unit : str
    """

    mean: Array
    stderr: Array
    distance_mm: Array
    wavelengths_nm: tuple[float, ...]
    unit: str

    def __repr__(self) -> str:
        planes = self.distance_mm[~np.isnan(self.distance_mm)]
        reach = f"from {planes.min():.6g} to {planes.max():.6g} mm" if len(planes) else "unknown"
        return f"<AllInFocus: {_samples(self.mean)}, planes {reach}, {self.unit}>"


def _samples(mean: Array) -> str:
    height, width, channels = mean.shape
    return f"{width} × {height} samples, {counted(channels, 'wavelength')}"


def all_in_focus(stack: FocalStack) -> AllInFocus:
    """Take every sample from the photograph of a stack that is sharpest there.

    Sharpness is the mean energy of the Laplacian in a window of 5 × 5 samples, summed over the channels. It is compared
    where at least half of the views have data in every photograph. Other samples are taken from the plane of the
    nearest compared one, or where that is unknown from the photograph with the most views; their distance is NaN.

    Parameters
    ----------
    stack : FocalStack
        From `lf.focal_stack`.

    Returns
    -------
    AllInFocus
    """
    first = stack.photographs[0]
    covered = np.stack([photograph.covered for photograph in stack.photographs])
    known = (covered > 0.0) & (covered >= LEAST_COVERAGE * covered.max())
    energy, compared = _sharpness([photograph.mean for photograph in stack.photographs], known.all(axis=0))
    best = energy.argmax(axis=0)
    if compared.any():
        _, nearest = ndimage.distance_transform_edt(~compared, return_indices=True)
        best = best[tuple(nearest)]
    unknown = np.take_along_axis(covered, best[None], axis=0)[0] == 0.0
    best = np.where(unknown, covered.argmax(axis=0), best)

    def sharpest(values: list[Array]) -> Array:
        return np.take_along_axis(np.stack(values), best[None, :, :, None], axis=0)[0]

    return AllInFocus(
        mean=sharpest([photograph.mean for photograph in stack.photographs]),
        stderr=sharpest([photograph.stderr for photograph in stack.photographs]),
        distance_mm=np.where(compared, np.asarray(stack.distances_mm)[best], np.nan),
        wavelengths_nm=first.wavelengths_nm,
        unit=first.unit,
    )


def _sharpness(pictures: list[Array], known: NDArray[np.bool_]) -> tuple[Array, NDArray[np.bool_]]:
    """Return the energy of the Laplacian around every sample (planes, t, s), and where it can be compared (t, s).

    Parameters
    ----------
    pictures : list of (t, s, c) float64
    known : (t, s) bool
        Samples that count, the same in all pictures.
    """
    # The border of the known samples is not an edge.
    whole = ndimage.binary_erosion(known, border_value=1)
    window = partial(ndimage.uniform_filter, size=2 * SHARPNESS_RADIUS + 1, mode="nearest")
    count = window(whole.astype(np.float64))
    energies = []
    for picture in pictures:
        filled = np.where(known[..., None], picture, 0.0)
        energy = sum(ndimage.laplace(filled[..., c], mode="nearest") ** 2 for c in range(picture.shape[2]))
        total = window(np.where(whole, energy, 0.0))
        energies.append(np.divide(total, count, out=np.zeros_like(total), where=count > LEAST_SHARE))
    return np.stack(energies), known & (count > LEAST_SHARE)
