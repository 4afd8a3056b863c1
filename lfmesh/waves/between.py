"""Point spreads of many particles, interpolated between points of a grid in the volume that holds them.

Without a microlens array a point's picture, moved onto its chief ray, changes little from place to place. Particles lie
in cells, and the picture of one in a cell is interpolated linearly between those of the cell's corners, in x / z, y / z
and 1 / z, of which defocus is a linear function. The particle nearest to the middle of each cell has a point spread of
its own: where the interpolated one differs from it by more than `BETWEEN` of its light, the cell is cut in two, across
the way along which the spread in the middle of an edge is farthest from the mean of its ends. Where a cell has no
more particles than corners, or the lens stops a particle's chief ray, each has its own.
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
"""Largest sum of differences of an interpolated spread from a particle's own, over the power."""

PARTS = 1 << 20
"""Finest cells along each side of the volume."""

KEPT, PLACES = 64, 1024
"""Spreads at corners that are remembered, as cells share them, and most places on a side of their grids."""


class _Cell(NamedTuple):
    """A part of the volume.

    Attributes
    ----------
    low, high : (int, int, int)
        Corners, in finest cells; the same along ways in which the volume has no width.
    members : (n,) int64
        Particles in it.
    """

    low: tuple[int, int, int]
    high: tuple[int, int, int]
    members: Numbers

    @property
    def wide(self) -> list[int]:
        """Ways in which it has a width."""
        return [axis for axis in range(3) if self.high[axis] > self.low[axis]]

    @property
    def corners(self) -> list[tuple[int, ...]]:
        """Its corners; along the last way first."""
        return list(itertools.product(*((a, b) if b > a else (a,) for a, b in zip(self.low, self.high, strict=True))))

    def cut(self, axis: int, place: Array) -> "list[_Cell]":
        """Return its halves.

        Parameters
        ----------
        axis : int
        place : (all particles,) float64
            Places of all particles along it, in finest cells.
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
        As from `lf.point_spread`, of a particle.
    """
    if lit:
        _Volume(camera, wavelength_nm, lit, film, told).picture()


class _Volume:
    """Particles, and the spreads at points between them."""

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
        """Add the particles of a cell; or return its halves where they cannot be interpolated."""
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
        """Return the shares of a cell's corners in the spreads of its particles, (particles, corners)."""
        weights = np.ones((len(cell.members), 1))
        for axis in cell.wide:
            along = (self.place[cell.members, axis] - cell.low[axis]) / (cell.high[axis] - cell.low[axis])
            weights = (weights[:, :, None] * np.stack([1.0 - along, along], axis=1)[:, None, :]).reshape(len(along), -1)
        return weights

    def _grid(self, cell: _Cell) -> tuple[float, float]:
        """Return period and step of grids that hold the light of a cell, mm: a few, so that cells share corners."""
        period = max(self.lit[member].period_mm for member in cell.members)
        step = min(self.lit[member].step_mm for member in cell.members)
        return FINER ** math.ceil(math.log(period, FINER)), FINER ** math.floor(math.log(step, FINER))

    def _bend(self, cell: _Cell, axis: int, grid: tuple[float, float]) -> float:
        """Return how far the spread in the middle of an edge is from the mean of its ends, squared.

        Where one is unknown it is inf, and below 0 along ways that cannot be cut.
        """
        if cell.high[axis] == cell.low[axis] + 1:
            return -1.0
        ends = (cell.low[axis], (cell.low[axis] + cell.high[axis]) // 2, cell.high[axis])
        low, middle, high = (self.spread_at(_with(cell.low, axis, end), *grid) for end in ends)
        if low is None or middle is None or high is None:
            return math.inf
        return float((np.abs(middle.series - 0.5 * (low.series + high.series)) ** 2).sum())

    def _spread_at(self, corner: tuple[int, ...], period_mm: float, step_mm: float) -> Irradiance | None:
        """Return the irradiance of a point of 1 W/sr about its chief ray, on a grid; None where it has none."""
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
        # Light behind the lens ends at its rim, so that the irradiance has none of the grid's highest terms.
        return Irradiance.of(light).about(place, math.ceil(n / FIRST_BAND))

    def _between(self, like: Irradiance, weights: Array, series: Waves, member: int) -> Irradiance:
        """Return the irradiance of a particle from those of the corners of its cell."""
        mixed = (weights @ series.reshape(len(series), -1)).reshape(series.shape[1:])
        return replace(like, series=mixed, at_mm=self.lit[member].place_mm)

    def _missed(self, own: PointSpread, like: Irradiance, weights: Array, series: Waves, member: int) -> float:
        """Return the sum of differences of an interpolated spread from a particle's own, over the power."""
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
