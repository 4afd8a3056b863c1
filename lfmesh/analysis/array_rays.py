"""Rays of object points on through the microlens array: the lenslet that each meets, and where it lands on the sensor.

An object point is moved aside by first differences: rays through the same point of the stop change place and direction
in proportion to the move, which is a few lenslets at most.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from lfmesh.geometry import frame as frames
from lfmesh.lightfield.calibration.calibration import Calibration, calibrate
from lfmesh.lightfield.rays.chief_rays import Plate, plate_of
from lfmesh.transport.packets.packet import CAMERA_FRAME, MLA_FRAME, SENSOR_FRAME
from lfmesh.transport.sequences.ray_tables import follow_sequence
from lfmesh.transport.sequences.sequences import Itinerary
from lfmesh.transport.tables.tables import Tables
from lfmesh.transport.trace import at_wavelength
from lfmesh.transport.world import World
from lfmesh.waves.bundle import LensRays, pupil_grid

Array = NDArray[np.float64]
Whole = NDArray[np.int64]

ACROSS = 16
"""Points on a diameter of the part of the stop's grid that each place, or position of a point, has."""


class Landed(NamedTuple):
    """Rays on the sensor.

    Attributes
    ----------
    point : (n,) int64
        Number of the moved point that each comes from.
    lenslet : (n,) int64
        Number of the lenslet that it met, row by row; empty where that was not asked for.
    pixels : (n, 2) float64
        Column and row on the sensor, the middle of the first pixel at (0, 0).
    weight : (n,) float64
        Transmittance of lens and array.
    """

    point: Whole
    lenslet: Whole
    pixels: Array
    weight: Array


class MovedPoint(NamedTuple):
    """The rays of an object point through a grid in the stop, and how they change where it moves aside.

    Attributes
    ----------
    part : (n,) int64
        Which of the interleaved parts of the grid each ray belongs to.
    place, slope : (n, 2) float64
        At the image plane, mm and dx/dz.
    place_by, slope_by : (n, 2, 2) float64
        Their derivatives by the object point's slope.
    weight : (n,) float64
        Above 0.
    parts : int
        Number of the parts along each axis.
    """

    part: Whole
    place: Array
    slope: Array
    place_by: Array
    slope_by: Array
    weight: Array
    parts: int


@dataclass(frozen=True)
class ArrayRays:
    """Sends rays from behind the lens through array and cover onto the sensor, at the primary wavelength.

    Attributes
    ----------
    world : World
        Of a camera whose array can be decoded.
    image_z_mm : float
        The plane on which places are given.
    """

    world: World
    image_z_mm: float

    @cached_property
    def calibration(self) -> Calibration:
        """Points on the sensor of the chief rays of all lenslets."""
        return calibrate(self.world.scene)

    @cached_property
    def plate(self) -> Plate:
        """The array."""
        return plate_of(self.world.scene)

    @cached_property
    def cells(self) -> KDTree:
        """The centres of the micro-images, in pixels; what lies nearest to one is its cell."""
        return KDTree(self.calibration.centres_px.reshape(-1, 2))

    @cached_property
    def wavelength_nm(self) -> float:
        """The primary wavelength."""
        return self.world.scene.primary_nm

    @cached_property
    def apexes(self) -> Array:
        """(lenslets, 2) float64, mm: x and y of the apexes, camera frame."""
        flat = self.plate.apexes
        points = np.column_stack([flat, np.zeros(len(flat))])
        return frames.points(self.plate.moves[MLA_FRAME, CAMERA_FRAME], points)[:, :2]

    @property
    def _tables(self) -> Tables:
        return at_wavelength(self.world, self.wavelength_nm)

    @cached_property
    def _lattice(self) -> KDTree:
        return KDTree(self.plate.lenslets.lattice.centres().reshape(-1, 2))

    @cached_property
    def _start_z(self) -> float:
        camera = self.world.scene.camera
        assert camera.mla is not None
        return float(camera.lens.vertices_mm[-1] + 0.5 * (camera.mla.distance_mm or 0.0))

    def moved_point(self, object_mm: float, slope: Array, reach: float, *, parts: int) -> MovedPoint:
        """Return the rays of an object point, and by differences those of its neighbours.

        Parameters
        ----------
        object_mm : float
            Of its plane, before the first vertex.
        slope : (2,) float64
            x and y over that.
        reach : float
            Difference in slope by which derivatives are taken.
        parts : int
            Along each axis of the stop's grid, of which every moved point has one.
        """
        lens, pupil = LensRays(self.world, object_mm, self.image_z_mm), pupil_grid(parts * ACROSS)
        three = [lens.bundle(slope + move, pupil, self.wavelength_nm) for move in reach * _STEPS]
        passes = np.logical_and.reduce([each.passes for each in three])
        place = [each.place[passes] for each in three]
        steep = [each.direction[passes, :2] / each.direction[passes, 2:] for each in three]
        number = np.round((pupil + 1.0) * 0.5 * parts * ACROSS - 0.5).astype(np.int64) % parts
        return MovedPoint(
            (number[:, 0] * parts + number[:, 1])[passes],
            place[0],
            steep[0],
            np.stack([(each - place[0]) / reach for each in place[1:]], axis=2),
            np.stack([(each - steep[0]) / reach for each in steep[1:]], axis=2),
            three[0].weight[passes],
            parts,
        )

    def from_object(self, rays: MovedPoint, moves: Array) -> Landed:
        """Follow the rays of object points moved aside, (n, 2) in slope, to the sensor."""
        point, ray = _dealt(rays, len(moves))
        return self._landed(
            point,
            rays.place[ray] + (rays.place_by[ray] @ moves[point][:, :, None])[:, :, 0],
            rays.slope[ray] + (rays.slope_by[ray] @ moves[point][:, :, None])[:, :, 0],
            rays.weight[ray],
            met=False,
        )

    def across_plane(self, rays: MovedPoint, places: Array) -> Landed:
        """Follow rays through places of the image plane, (n, 2) mm, and all parts of the stop, to the sensor."""
        point, ray = _dealt(rays, len(places))
        turn = rays.slope_by @ np.linalg.inv(rays.place_by)
        slope = rays.slope[ray] + (turn[ray] @ (places[point] - rays.place[ray])[:, :, None])[:, :, 0]
        return self._landed(point, places[point], slope, rays.weight[ray], met=True)

    def _landed(self, point: Whole, place: Array, slope: Array, weight: Array, *, met: bool) -> Landed:
        tables, ahead = self._tables, np.column_stack([slope, np.ones(len(slope))])
        start = np.column_stack([place, np.full(len(place), self.image_z_mm)])
        start += (self._start_z - self.image_z_mm) * ahead
        ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
        first = len(tables.lens.surfaces)
        rays = follow_sequence(tables, Itinerary((first, first + 1), (False, False)), start, ahead, weight)
        ok = rays.weight > 0.0
        to_sensor = tables.frames[CAMERA_FRAME, SENSOR_FRAME]
        p, d = _points(to_sensor, rays.position[ok]), _directions(to_sensor, rays.direction[ok])
        landed = p[:, :2] - (p[:, 2] / d[:, 2])[:, None] * d[:, :2]
        if self.plate.cover_mm > 0.0:
            landed = landed + self.plate.moved_by_cover(d)
        sensor = self.world.scene.camera.sensor
        pixels = landed / sensor.pixel_mm + 0.5 * (np.asarray(sensor.pixels) - 1.0)
        lenslet = np.zeros(0, np.int64)
        if met:
            lenslet = self._lenslet(start[ok], ahead[ok], rays.position[ok], rays.direction[ok])
        return Landed(point[ok], lenslet, pixels, rays.weight[ok])

    def _lenslet(self, start: Array, before: Array, end: Array, behind: Array) -> Whole:
        """Return the numbers of the lenslets that rays met, from their lines before and behind the array."""
        move = self._tables.frames[CAMERA_FRAME, MLA_FRAME]
        met = _points(move, end)
        if self.plate.curved_to_lens:
            # The ray within the glass meets the one before it on the curved face.
            p, d = _points(move, start), _directions(move, before)
            inside = self.plate.inside(_directions(move, behind))
            between, cosine = met - p, (d * inside).sum(axis=1)
            along = (between * d).sum(axis=1) - cosine * (between * inside).sum(axis=1)
            sine2 = (np.cross(d, inside) ** 2).sum(axis=1)
            flat = -p[:, 2] / d[:, 2]
            t = np.divide(along, sine2, out=flat, where=sine2 > 0.0)
            met = p + t[:, None] * d
        return np.asarray(self._lattice.query(met[:, :2])[1], dtype=np.int64)


_STEPS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])


def _points(move: Array, p: Array) -> Array:
    """Return points through a frame as `frame.points`; many small products are quicker without a matrix library."""
    return np.asarray(_directions(move, p) + move[:, 3])


def _directions(move: Array, d: Array) -> Array:
    return np.stack([d[:, 0] * row[0] + d[:, 1] * row[1] + d[:, 2] * row[2] for row in move], axis=1)


def even_points(count: int) -> Array:
    """Return points that fill the unit square evenly, (n, 2), always the same; most even for powers of two."""
    return _sequence(count)[:, :2]


def _sequence(count: int) -> Array:
    """Return points of Sobol's sequence in the unit cube, (n, 3), moved off its faces."""
    from scipy.stats import qmc

    power = max(0, (count - 1).bit_length())
    found = qmc.Sobol(3, scramble=False).random_base2(power)[:count] + 0.5 / (1 << power)
    return np.asarray(found, dtype=np.float64)


def _dealt(rays: MovedPoint, count: int) -> tuple[Whole, Whole]:
    """Return the pairs of a point and a ray: points of the even sequence have parts of the stop's grid in turn."""
    parts = rays.parts * rays.parts
    of_part = [np.flatnonzero(rays.part == part) for part in range(parts)]
    chosen = [of_part[part] for part in (parts * _sequence(count)[:, 2]).astype(np.int64)]
    return np.repeat(np.arange(count), [len(each) for each in chosen]), np.concatenate(chosen)
