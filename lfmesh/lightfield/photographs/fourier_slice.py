"""Refocusing in the Fourier domain: a photograph is a slice of the light field's 4D spectrum.

R. Ng, "Fourier Slice Photography", SIGGRAPH 2005.
"""

import math

import numpy as np
from numpy.typing import NDArray

from lfmesh.lightfield.views.field import LightField, Samples

Array = NDArray[np.float64]


class ViewSpectra:
    """Fourier transforms of the views along t and s, and of their masks of known samples.

    A photograph's spectrum sums the views', each with the phase of its shift: the light field's 4D spectrum on the
    plane k_u = shift · k_s, k_v = shift · k_t, evaluated without interpolation between FFT bins.
    """

    def __init__(self, field: LightField, most_shift_mm: float) -> None:
        rows, columns, height, width, _ = field.data.shape
        spacing = field.spacing_mm
        self._spacing = spacing
        self._size = (height, width)
        # Borders are repeated by the largest shift of a view, to avoid wrap-around.
        self._margin = tuple(
            math.ceil(0.5 * count * most_shift_mm / step) + 1
            for count, step in zip((rows, columns), spacing, strict=True)
        )
        known = np.isfinite(field.data)
        self._views = self._transformed(np.where(known, field.data, 0.0))
        self._known = None if known.all() else self._transformed(known.astype(np.float32))

    def slice(self, shift_mm: float, shares: Array) -> Array:
        """Return the photograph (t, s, c) for a shift."""
        picture = self._sum(self._views, shift_mm, shares)
        if self._known is None:
            return picture / shares.sum()
        weight = self._sum(self._known, shift_mm, shares)
        # Sinc interpolation of the mask rings; the weight of places that hardly any view knows is unusable.
        floor = 0.5 * float(shares[shares > 0.0].min())
        return np.where(weight > floor, picture / np.maximum(weight, floor), np.nan)

    def _transformed(self, samples: Samples) -> NDArray[np.complex64]:
        top, side = self._margin
        padded = np.pad(samples, ((0, 0), (0, 0), (top, top), (side, side), (0, 0)), mode="edge")
        return np.fft.rfft2(padded, axes=(2, 3)).astype(np.complex64)

    def _sum(self, spectra: NDArray[np.complex64], shift_mm: float, shares: Array) -> Array:
        (top, side), (height, width) = self._margin, self._size
        full = (height + 2 * top, width + 2 * side)
        rows, columns = shares.shape
        along_t, along_s = (shift_mm / spacing for spacing in self._spacing)
        v, u = np.arange(rows) - 0.5 * (rows - 1), np.arange(columns) - 0.5 * (columns - 1)
        turn_t = np.exp(-2j * np.pi * along_t * np.outer(v, np.fft.fftfreq(full[0])))
        turn_s = np.exp(-2j * np.pi * along_s * np.outer(u, np.fft.rfftfreq(full[1])))
        total = np.zeros(spectra.shape[2:], np.complex128)
        for i, j in zip(*np.nonzero(shares), strict=True):
            total += (shares[i, j] * turn_t[i])[:, None, None] * turn_s[j][:, None] * spectra[i, j]
        picture = np.fft.irfft2(total, s=full, axes=(0, 1))
        return picture[top : top + height, side : side + width]
