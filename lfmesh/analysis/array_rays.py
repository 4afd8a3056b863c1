"""Tracing rays of object points through the microlens array to the sensor.

Neighbouring object points, up to a few lenslets away, are traced by first differences of rays through the same point of
the stop.
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
"""Rays across the stop's diameter in each part of the stop's grid; each position uses one part."""


class Landed(NamedTuple):
    """Rays that reach the sensor.

    Attributes
    ----------
    point : (n,) int64
        Number of the ray's object point or place.
    lenslet : (n,) int64
        Number of the lenslet met, row by row; empty if not requested.
    pixels : (n, 2) float64
        Column and row on the sensor; the centre of the first pixel is (0, 0).
    weight : (n,) float64
        Transmittance of lens and array.
    """

    point: Whole
    lenslet: Whole
    pixels: Array
    weight: Array


class MovedPoint(NamedTuple):
    """Rays of an object point through a grid in the stop, with derivatives by its slope.

    Attributes
    ----------
    part : (n,) int64
        Interleaved part of the grid.
    place, slope : (n, 2) float64
        At the image plane, mm and dx/dz.
    place_by, slope_by : (n, 2, 2) float64
        Derivatives.
    weight : (n,) float64
        Transmittance of the lens, above 0.
    parts : int
        Number of parts along each axis.
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
    """Tracer from the lens through array and cover to the sensor, at the primary wavelength.

    Attributes
    ----------
    world : World
        The array must be decodable.
    image_z_mm : float
        Plane of the given places.
    """

    world: World
    image_z_mm: float

    @cached_property
    def calibration(self) -> Calibration:
        """Chief rays' points on the sensor, for all lenslets."""
        return calibrate(self.world.scene)

    @cached_property
    def plate(self) -> Plate:
        """The array."""
        return plate_of(self.world.scene)

    @cached_property
    def cells(self) -> KDTree:
        """Centres of the micro-images, in pixels; the points nearest to a centre form its cell."""
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
        """Trace the rays of an object point, with finite-difference derivatives.

        Parameters
        ----------
        object_mm : float
            Distance before the first vertex.
        slope : (2,) float64
            x and y of the point over that distance.
        reach : float
            Step in slope of the finite differences.
        parts : int
            Parts of the stop's grid along each axis; each moved point uses one.
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
        """Trace the rays of displaced object points, (n, 2) in slope, to the sensor."""
        point, ray = _dealt(rays, len(moves))
        return self._landed(
            point,
            rays.place[ray] + (rays.place_by[ray] @ moves[point][:, :, None])[:, :, 0],
            rays.slope[ray] + (rays.slope_by[ray] @ moves[point][:, :, None])[:, :, 0],
            rays.weight[ray],
            met=False,
        )

    def across_plane(self, rays: MovedPoint, places: Array) -> Landed:
        """Trace rays through places of the image plane, (n, 2) mm, and all parts of the stop, to the sensor."""
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
        """Return the lenslets that rays met, from the rays before and behind the array."""
        move = self._tables.frames[CAMERA_FRAME, MLA_FRAME]
        met = _points(move, end)
        if self.plate.curved_to_lens:
            # The rays before and inside the glass intersect on the curved face.
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
    """Transform points like `frame.points`, without a matrix library: faster for many small products."""
    return np.asarray(_directions(move, p) + move[:, 3])


def _directions(move: Array, d: Array) -> Array:
    return np.stack([d[:, 0] * row[0] + d[:, 1] * row[1] + d[:, 2] * row[2] for row in move], axis=1)


def even_points(count: int) -> Array:
    """Return a fixed low-discrepancy set in the unit square, (n, 2); most even for powers of two."""
    return _sequence(count)[:, :2]


def _sequence(count: int) -> Array:
    """Return points of Sobol's sequence in the unit cube, (n, 3), shifted off its faces."""
    from scipy.stats import qmc

    power = max(0, (count - 1).bit_length())
    found = qmc.Sobol(3, scramble=False).random_base2(power)[:count] + 0.5 / (1 << power)
    return np.asarray(found, dtype=np.float64)


def _dealt(rays: MovedPoint, count: int) -> tuple[Whole, Whole]:
    """Return pairs of point and ray: the points of the even sequence take the parts of the stop's grid in turn."""
    parts = rays.parts * rays.parts
    of_part = [np.flatnonzero(rays.part == part) for part in range(parts)]
    chosen = [of_part[part] for part in (parts * _sequence(count)[:, 2]).astype(np.int64)]
    return np.repeat(np.arange(count), [len(each) for each in chosen]), np.concatenate(chosen)
