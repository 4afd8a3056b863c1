"""Point spreads of many particles, interpolated between grid points of their volume.

Without a microlens array, a point's picture, centred on its chief ray, changes little with position. Within cells of
the volume it is interpolated linearly in x / z, y / z and 1 / z; defocus is linear in these. The particle nearest to
the middle of each cell has its own point spread. If the interpolated one differs from it by more than `BETWEEN` of its
light, the cell is halved along the axis with the largest error at the middle of an edge. Particles have their own
spreads in cells with no more particles than corners, or if the lens stops their chief ray.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.waves.angular_spectrum import Grid, Irradiance, Waves
from lfmesh.waves.extent import FINER, FIRST_BAND
from lfmesh.waves.lit_particle import Lit
from lfmesh.waves.point_spread import Monochrome, PointSpread, pixels_of
from lfmesh.waves.pupil_waves import pupil_waves
from lfmesh.waves.wave_camera import WaveCamera

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]

BETWEEN = 0.01
"""Largest sum of differences between an interpolated spread and a particle's own, over the power."""

PARTS = 1 << 20
"""Finest cells along each side of the volume."""

KEPT, PLACES = 64, 1024
"""Corner spreads kept for neighbouring cells, and largest number of points on a side of their grids."""


class _Cell(NamedTuple):
    """Part of the volume.

    Attributes
    ----------
    low, high : (int, int, int)
        Corners, in finest cells; equal along axes without width.
    members : (n,) int64
        Particles in it.
    """

    low: tuple[int, int, int]
    high: tuple[int, int, int]
    members: Numbers

    @property
    def wide(self) -> list[int]:
        """Axes along which it has a width."""
        return [axis for axis in range(3) if self.high[axis] > self.low[axis]]

    @property
    def corners(self) -> list[tuple[int, ...]]:
        """Its corners; the last axis varies fastest."""
        return list(itertools.product(*((a, b) if b > a else (a,) for a, b in zip(self.low, self.high, strict=True))))

    def cut(self, axis: int, place: Array) -> "list[_Cell]":
        """Return its two halves.

        Parameters
        ----------
        axis : int
        place : (all particles,) float64
            Coordinates of all particles, in finest cells.
        """
        middle = (self.low[axis] + self.high[axis]) // 2
        below = place[self.members] < middle
        ends = [(self.low[axis], middle, below), (middle, self.high[axis], ~below)]
        return [
            _Cell(_with(self.low, axis, a), _with(self.high, axis, b), self.members[inside]) for a, b, inside in ends
        ]


def add_spreads(
    camera: WaveCamera, wavelength_nm: float, lit: Sequence[Lit], film: Array, told: Callable[[], None]
) -> None:
    """Add the light of particles to a picture.

    Parameters
    ----------
    camera : WaveCamera
        Without an array.
    wavelength_nm : float
    lit : sequence of Lit
    film : (rows, columns) float64, W
    told : callable
        Called after each particle.

    Raises
    ------
    LfmeshError
        As from `lf.point_spread`, for a particle.
    """
    if lit:
        _Volume(camera, wavelength_nm, lit, film, told).picture()


class _Volume:
    """Particles, and point spreads at grid points between them."""

    def __init__(
        self, camera: WaveCamera, wavelength_nm: float, lit: Sequence[Lit], film: Array, told: Callable[[], None]
    ) -> None:
        self.camera, self.wavelength_nm, self.lit, self.film, self.told = camera, wavelength_nm, lit, film, told
        self.pixels = pixels_of(camera)
        x, y, z = np.array([each.point_mm for each in lit]).T
        slopes = np.column_stack([x / -z, y / -z, 1.0 / -z])
        self.low, self.width = slopes.min(axis=0), np.ptp(slopes, axis=0)
        self.place = PARTS * (slopes - self.low) / np.where(self.width > 0.0, self.width, 1.0)
        self.spread_at = lru_cache(KEPT)(self._spread_at)

    def picture(self) -> None:
        """Add all particles to the picture."""
        x, y, z = (PARTS if wide else 0 for wide in (self.width > 0.0).tolist())
        placed = np.array([np.isfinite(each.place_mm).all() for each in self.lit])
        for member in np.flatnonzero(~placed).tolist():
            self._add_own(member)
        cells = [_Cell((0, 0, 0), (x, y, z), np.flatnonzero(placed))]
        while cells:
            cell = cells.pop()
            if len(cell.members) <= len(cell.corners) or max(np.subtract(cell.high, cell.low)) <= 1:
                for member in cell.members:
                    self._add_own(member)
            else:
                cells += self._interpolated(cell)

    def _interpolated(self, cell: _Cell) -> list[_Cell]:
        """Add the particles of a cell, or return its halves if they cannot be interpolated."""
        members, grid = cell.members, self._grid(cell)
        spreads = [self.spread_at(corner, *grid) for corner in cell.corners]
        known = [each for each in spreads if each is not None]
        if len(known) < len(spreads):
            longest = int(np.argmax(np.subtract(cell.high, cell.low)))
            return cell.cut(longest, self.place[:, longest])
        weights = self._weights(cell)
        tested = int(np.argmax(weights.prod(axis=1)))
        own = self._own_spread(members[tested])
        series = np.stack([each.series for each in known])
        if own is None or self._missed(own, known[0], weights[tested], series, members[tested]) > BETWEEN:
            axis = max(cell.wide, key=lambda each: self._bend(cell, each, grid))
            return cell.cut(axis, self.place[:, axis])
        for row, member in enumerate(members):
            if row == tested:
                self.film += self.lit[member].intensity_w_sr * own.mean
            else:
                self._between(known[0], weights[row], series, member).add_to(
                    self.film, self.pixels, self.camera.sensor_mm, self.lit[member].intensity_w_sr
                )
            self.told()
        return []

    def _weights(self, cell: _Cell) -> Array:
        """Return the weights of a cell's corners for its particles, (particles, corners)."""
        weights = np.ones((len(cell.members), 1))
        for axis in cell.wide:
            along = (self.place[cell.members, axis] - cell.low[axis]) / (cell.high[axis] - cell.low[axis])
            weights = (weights[:, :, None] * np.stack([1.0 - along, along], axis=1)[:, None, :]).reshape(len(along), -1)
        return weights

    def _grid(self, cell: _Cell) -> tuple[float, float]:
        """Return period and step, mm, of a cell's grid, from few values so that cells share corners."""
        period = max(self.lit[member].period_mm for member in cell.members)
        step = min(self.lit[member].step_mm for member in cell.members)
        return FINER ** math.ceil(math.log(period, FINER)), FINER ** math.floor(math.log(step, FINER))

    def _bend(self, cell: _Cell, axis: int, grid: tuple[float, float]) -> float:
        """Return the squared deviation of the spread in the middle of an edge from the mean of its ends.

        inf if one is unknown; negative along axes that cannot be halved.
        """
        if cell.high[axis] == cell.low[axis] + 1:
            return -1.0
        ends = (cell.low[axis], (cell.low[axis] + cell.high[axis]) // 2, cell.high[axis])
        low, middle, high = (self.spread_at(_with(cell.low, axis, end), *grid) for end in ends)
        if low is None or middle is None or high is None:
            return math.inf
        return float((np.abs(middle.series - 0.5 * (low.series + high.series)) ** 2).sum())

    def _spread_at(self, corner: tuple[int, ...], period_mm: float, step_mm: float) -> Irradiance | None:
        """Return the irradiance of a point of 1 W/sr about its chief ray on a grid, or None."""
        camera, nm = self.camera, self.wavelength_nm
        n = scipy.fft.next_fast_len(math.ceil(0.5 * period_mm / step_mm)) * 2
        slope = self.low + self.width * np.array(corner) / PARTS
        point = np.array([slope[0], slope[1], -1.0]) / slope[2]
        place = camera.looked_at(point, nm).place[0]
        if n > PLACES or not np.isfinite(place).all():
            return None
        try:
            own = Monochrome(camera, point, nm, pupil_waves(camera.world, camera.camera, point, nm), self.pixels)
            needed = own.extent.grid(1.0, "")
        except LfmeshError:
            return None
        if needed.n * needed.step_mm > n * step_mm or needed.step_mm < step_mm:
            return None
        light = own.at_sensor(Grid(n, step_mm, own.pupil.wavelength_mm, own.pupil.middle)).light
        # The pupil ends at its rim, so the irradiance has none of the grid's highest terms.
        return Irradiance.of(light).about(place, math.ceil(n / FIRST_BAND))

    def _between(self, like: Irradiance, weights: Array, series: Waves, member: int) -> Irradiance:
        """Interpolate the irradiance of a particle between the corners of its cell."""
        mixed = (weights @ series.reshape(len(series), -1)).reshape(series.shape[1:])
        return replace(like, series=mixed, at_mm=self.lit[member].place_mm)

    def _missed(self, own: PointSpread, like: Irradiance, weights: Array, series: Waves, member: int) -> float:
        """Return the sum of differences between an interpolated spread and a particle's own, over the power."""
        found = np.zeros_like(own.mean)
        self._between(like, weights, series, member).add_to(found, self.pixels, self.camera.sensor_mm)
        return float(np.abs(found - own.mean).sum()) / own.power_w

    def _own_spread(self, member: int) -> PointSpread | None:
        return self.lit[member].own_spread(self.camera, self.wavelength_nm)

    def _add_own(self, member: int) -> None:
        own = self._own_spread(member)
        if own is not None:
            self.film += self.lit[member].intensity_w_sr * own.mean
        self.told()


def _with(corner: tuple[int, int, int], axis: int, value: int) -> tuple[int, int, int]:
    x, y, z = (value if i == axis else old for i, old in enumerate(corner))
    return x, y, z
