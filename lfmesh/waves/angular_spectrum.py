"""Angular spectra: light as plane waves on a grid of directions, propagated through space and across relief faces.

Amplitudes are normalised to flux along z, so the sum of their squares is the power. A Fourier transform gives the light
across a plane, without paraxial approximation (J. W. Goodman, Introduction to Fourier Optics, 3.10). Lenslets are not
thin phase screens: waves are evaluated on the curved face itself, interpolated in z between planes through the relief.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lfmesh.kernels.decorators import kernel

Array = NDArray[np.float64]
Waves = NDArray[np.complex128]

INTERPOLATED = 1e-5
"""Largest interpolation error between planes through a relief."""

AT_ONCE = 1024
"""Points processed through all planes at a time, few enough for the fastest memory."""

NEAR_PEAK = 33
"""Points per side of the fine grid around the brightest point, on which the peak is sought."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Directions and points of a discrete Fourier transform, n per side.

    Attributes
    ----------
    n : int
        Even.
    step_mm : float
        Between points.
    wavelength_mm : float
        In air.
    middle : (2,) float64
        Central direction.
    """

    n: int
    step_mm: float
    wavelength_mm: float
    middle: Array

    @cached_property
    def places(self) -> Array:
        """(n,) mm: coordinates from the middle, in FFT order."""
        return np.asarray(np.fft.fftfreq(self.n, 1.0 / (self.n * self.step_mm)))

    @cached_property
    def directions(self) -> tuple[Array, Array]:
        """(n,), (n,): optical direction cosines n sin θ along x and y, in FFT order."""
        offset = np.fft.fftfreq(self.n, self.step_mm) * self.wavelength_mm
        return self.middle[0] + offset, self.middle[1] + offset

    def along_z(self, index: float) -> Array:
        """Return n cos θ in a medium for all directions, (n, n); 0 for evanescent waves."""
        px, py = self.directions
        return np.asarray(np.sqrt(np.maximum(index * index - px[None, :] ** 2 - py[:, None] ** 2, 0.0)))

    def middle_z(self, index: float) -> float:
        """Return n cos θ of the central direction in a medium."""
        return math.sqrt(max(index * index - float(self.middle @ self.middle), 1e-12))


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Light across a plane.

    Attributes
    ----------
    grid : Grid
    waves : (n, n) complex128, √W
        Amplitude of each direction, [y, x] in FFT order.
    at_mm : (3,) float64
        Origin of the points, camera frame.
    index : float
        Of the medium.
    beyond_w : float
        Missing power, sent by lenslets into directions outside the grid.
    """

    grid: Grid
    waves: Waves
    at_mm: Array
    index: float = 1.0
    beyond_w: float = 0.0

    @property
    def power_w(self) -> float:
        """Power of all waves."""
        return float((np.abs(self.waves) ** 2).sum())

    @property
    def field(self) -> Waves:
        """(n, n) √W: light across the plane, [y, x] in FFT order; squares are power."""
        return np.asarray(scipy.fft.ifft2(self.waves, norm="ortho"))

    def travelled(self, z_mm: float) -> "Spectrum":
        """Return the light across another plane of the medium, with the origin moved along the central ray."""
        grid, way = self.grid, z_mm - float(self.at_mm[2])
        if way == 0.0:
            return self
        pz, middle_z = grid.along_z(self.index), grid.middle_z(self.index)
        shift = way / middle_z * grid.middle
        px, py = grid.directions
        phase = (pz - middle_z) * way
        phase += (px * shift[0])[None, :] + (py * shift[1])[:, None]
        waves = np.where(pz > 0.0, self.waves * np.exp(2j * np.pi / grid.wavelength_mm * phase), 0.0)
        return replace(self, waves=waves, at_mm=np.array([*(self.at_mm[:2] + shift), z_mm]))

    def through_plane(self, amplitude: Array, index: float) -> "Spectrum":
        """Return the light behind a plane face with an amplitude (n, n) for each direction."""
        return replace(self, waves=self.waves * amplitude * (self.grid.along_z(index) > 0.0), index=index)

    @property
    def spread(self) -> Array:
        """(2,): root mean square of the direction cosines x and y about the central direction."""
        power = np.abs(self.waves) ** 2
        off = [p - m for p, m in zip(self.grid.directions, self.grid.middle, strict=True)]
        means = [float(power.sum(axis=axis) @ off[axis] ** 2) / max(float(power.sum()), 1e-300) for axis in (0, 1)]
        return np.maximum(np.sqrt(means), 1e-6)

    def through_relief(
        self, height: Array, share: Waves, clear: Array, amplitude: Sequence[Array], index: float,
        told: Callable[[float], None],
    ) -> "Spectrum":  # fmt: skip
        """Return the light behind a relief face, as waves of its base plane.

        Parameters
        ----------
        height : (n, n) float64, mm
            z of the face above the plane, at the grid's points.
        share : (n, n) complex128
            Mean of the transmitted wave over each cell, over an unobstructed wave at its height.
        clear : (n, n) float64
            Unobstructed fraction of each cell, over the squared amplitude of unit power.
        amplitude : (3,) of (n, n) float64
            Transmitted amplitude at each point for the central direction, and its derivatives by both direction
            cosines.
        index : float
            Refractive index behind the face.
        told : callable
            Called with the completed fraction of the work.
        """
        grid, k = self.grid, 2.0 * np.pi / self.grid.wavelength_mm
        spans, middles = [], []
        for n in (self.index, index):
            pz = grid.along_z(n)
            middles.append(0.5 * float(pz.max() + pz[pz > 0.0].min()))
            spans.append(np.where(pz > 0.0, pz - middles[-1], 0.0))
        span = max(float(np.abs(each).max()) for each in spans)
        slices = _slices(float(height.min()), float(height.max()), k * span)
        shape = self.waves.shape
        face, behind, waves = (
            np.zeros(shape, np.complex128),
            np.zeros(shape, np.complex128),
            np.empty(shape, np.complex128),
        )
        part = np.empty(shape)
        off_x, off_y = (p - m for p, m in zip(grid.directions, grid.middle, strict=True))
        steps = 2 * len(slices)
        for number, z in enumerate(slices):
            fill_share(slices, number, height.ravel(), part.ravel())
            turn(self.waves.ravel(), spans[0].ravel(), k * z, waves.ravel())
            for passed, off in zip(amplitude, (1.0, off_x[None, :], off_y[:, None]), strict=True):
                light = scipy.fft.ifft2(waves * off, norm="ortho", overwrite_x=True)
                add_product(part.ravel(), passed.ravel(), light.ravel(), face.ravel())
            told((number + 1) / steps)
        passing = float((clear * (face.real**2 + face.imag**2)).sum())
        face *= share * np.exp(1j * k * (middles[0] - middles[1]) * height)
        for number, z in enumerate(slices):
            fill_share(slices, number, height.ravel(), part.ravel())
            light = scipy.fft.fft2(part * face, norm="ortho", overwrite_x=True)
            turn(light.ravel(), spans[1].ravel(), -k * z, waves.ravel())
            behind += waves
            told(0.5 + (number + 1) / steps)
        found = replace(self, waves=np.where(grid.along_z(index) > 0.0, behind, 0.0), index=index)
        return replace(found, beyond_w=self.beyond_w + passing - found.power_w)


def _slices(low: float, high: float, per_mm: float) -> Array:
    """Return heights of planes (Chebyshev points) to interpolate exp(i · per_mm · z)."""
    half = 0.5 * (high - low)
    count, error = 1, per_mm * half
    while error > INTERPOLATED:
        count += 1
        error *= 0.5 * per_mm * half / count
    return np.asarray(0.5 * (low + high) + half * np.cos(np.pi * (np.arange(count) + 0.5) / count))


@kernel
def fill_share(planes: Array, number: int, height: Array, share: Array) -> None:
    """Fill in the Lagrange polynomial of one plane at given heights.

    Parameters
    ----------
    planes : (m,) float64, mm
    number : int
        Index of the plane.
    height, share : (n,) float64
    """
    share[:] = 1.0
    for first in range(0, len(height), AT_ONCE):
        end = min(first + AT_ONCE, len(height))
        for other in range(len(planes)):
            if other == number:
                continue
            plane, scale = planes[other], 1.0 / (planes[number] - planes[other])
            for i in range(first, end):
                share[i] *= (height[i] - plane) * scale


@kernel
def turn(waves: Waves, phase: Array, times: float, turned: Waves) -> None:
    """Fill in waves advanced by a multiple of given phases.

    Parameters
    ----------
    waves, turned : (n,) complex128
    phase : (n,) float64
    times : float
    """
    for i in range(len(waves)):
        angle = times * phase[i]
        turned[i] = waves[i] * complex(math.cos(angle), math.sin(angle))


@kernel
def add_product(share: Array, passed: Array, light: Waves, face: Waves) -> None:
    """Add weighted transmitted light to the light on a face.

    Parameters
    ----------
    share, passed : (n,) float64
    light, face : (n,) complex128
    """
    for i in range(len(face)):
        face[i] += share[i] * passed[i] * light[i]


class Sampling(NamedTuple):
    """Evenly spaced points along x and y, [row, column].

    Attributes
    ----------
    first_mm : (2,) float64
        x and y of the first point.
    step_mm : float
    size : (int, int)
        Columns and rows.
    """

    first_mm: Array
    step_mm: float
    size: tuple[int, int]


@dataclass(frozen=True, eq=False)
class Irradiance:
    """Irradiance across a plane as a Fourier series, finite because directions are limited.

    Attributes
    ----------
    series : (m, m / 2 + 1) complex128
        Transform of the real irradiance: [y, x], in x from 0 on.
    period_mm : float
    at_mm : (2,) float64
        Origin of the coordinates.
    brightest_mm : (2,) float64
        Brightest of m × m points.
    """

    series: Waves
    period_mm: float
    at_mm: Array
    brightest_mm: Array

    @classmethod
    def of(cls, light: Spectrum) -> "Irradiance":
        """Return the irradiance of light across a plane."""
        n, m = light.grid.n, 2 * light.grid.n
        wide = np.zeros((m, m), np.complex128)
        low, high = slice(0, n // 2), slice(-(n // 2), None)
        for rows in (low, high):
            for columns in (low, high):
                wide[rows, columns] = light.waves[rows, columns]
        field = scipy.fft.ifft2(wide, norm="ortho", overwrite_x=True)
        power = field.real**2 + field.imag**2
        period = n * light.grid.step_mm
        row, column = divmod(int(power.argmax()), m)
        brightest = light.at_mm[:2] + np.fft.fftfreq(m, 1.0 / period)[[column, row]]
        return cls(scipy.fft.rfft2(power) / period**2, period, light.at_mm[:2], brightest)

    def sampled(self, points: Sampling, box_mm: float = 0.0) -> Array:
        """Return the irradiance averaged over a square box around each point, (rows, columns) W/mm².

        Parameters
        ----------
        points : Sampling
            In the camera frame; outside the period, values repeat.
        box_mm : float
            Side of the box.
        """
        m = len(self.series)
        waves = []
        for axis, number in ((1, np.fft.fftfreq(m, 1.0 / m)), (0, np.arange(m // 2 + 1))):
            at = points.first_mm[axis] - self.at_mm[axis] + points.step_mm * np.arange(points.size[axis])
            mean = np.sinc(number * box_mm / self.period_mm)
            waves.append(mean * np.exp(2j * np.pi / self.period_mm * at[:, None] * number))
        # Each term of x except the first also represents that of opposite sign; the last is nearly 0.
        waves[1][:, 1:] *= 2.0
        return np.asarray(((waves[0] @ self.series) @ waves[1].T).real)

    def add_to(self, film: Array, pixels: Sampling, sensor_mm: Array, times: float = 1.0) -> None:
        """Add the power on each pixel within the period to a picture.

        Parameters
        ----------
        film : (rows, columns) float64, W
        pixels : Sampling
            Pixel centres, sensor frame.
        sensor_mm : (3,) float64
            Centre of the sensor, camera frame.
        times : float
            Factor.
        """
        low = self.at_mm - sensor_mm[:2] - 0.5 * self.period_mm
        first = np.ceil((low - pixels.first_mm) / pixels.step_mm).astype(int).clip(0, pixels.size)
        last = np.floor((low + self.period_mm - pixels.first_mm) / pixels.step_mm).astype(int) + 1
        count = last.clip(0, pixels.size) - first
        if (count > 0).all():
            at = sensor_mm[:2] + pixels.first_mm + first * pixels.step_mm
            lit = self.sampled(Sampling(at, pixels.step_mm, (int(count[0]), int(count[1]))), pixels.step_mm)
            seen = film[first[1] : first[1] + count[1], first[0] : first[0] + count[0]]
            # Rounding leaves some of the darkest values below 0.
            seen += np.maximum(times * pixels.step_mm**2 * lit, 0.0)

    def about(self, place_mm: Array, terms: int) -> "Irradiance":
        """Return the irradiance about another origin, with only the lowest terms of its series.

        Parameters
        ----------
        place_mm : (2,) float64
            New origin, camera frame.
        terms : int
            Terms of each sign along y, and along x.
        """
        m = len(self.series)
        kept = self.series[np.r_[: terms + 1, m - terms - 1 : m], : terms + 2]
        waves = [np.exp(2j * np.pi / self.period_mm * off * number) for off, number in zip(
            place_mm - self.at_mm, (np.arange(terms + 2), np.fft.fftfreq(2 * terms + 2, 1.0 / (2 * terms + 2))),
            strict=True,
        )]  # fmt: skip
        return replace(self, series=kept * waves[1][:, None] * waves[0], at_mm=place_mm)

    def peak(self) -> float:
        """Return the largest irradiance, W/mm²."""
        step = self.period_mm / len(self.series)
        points = Sampling(self.brightest_mm - step, 2.0 * step / (NEAR_PEAK - 1), (NEAR_PEAK, NEAR_PEAK))
        return float(self.sampled(points).max())
