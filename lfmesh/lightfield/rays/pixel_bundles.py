"""Bundles of pixels: all light that a pixel receives through one lenslet, traced back into object space.

A bundle is a fixed set of rays from Gauss points of the pixel to Gauss points of the lenslet, traced through cover,
array and lens like `lf.trace`. It yields étendue and first and second moments of the rays.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry import frame as frames
from lfmesh.geometry.array.lattice import Lattice
from lfmesh.geometry.array.lenslets import Lenslets, faces_at, type_of
from lfmesh.geometry.lens.main_order import phases_of
from lfmesh.lightfield.rays.chief_rays import Plate
from lfmesh.lightfield.rays.pixel_slopes import ahead, pixel_slopes
from lfmesh.lightfield.rays.view_rays import image_path_engine
from lfmesh.optics.quadrature import gauss_legendre
from lfmesh.transport.packets.packet import CAMERA_FRAME, MLA_FRAME, SENSOR_FRAME, WORLD_FRAME
from lfmesh.transport.sequences.ray_tables import etendue_factors, faces_of, follow_sequence
from lfmesh.transport.sequences.sequences import Itinerary
from lfmesh.transport.trace import Status, at_wavelength, trace
from lfmesh.transport.world import World

Array = NDArray[np.float64]

ON_PIXEL, ON_LENSLET = 2, 4
"""Gauss points per side of a pixel, and of a lenslet; half of the latter in each of a hexagon's three strips."""

CHUNK = 512
"""Pixels with rays in memory at a time."""

M2_PER_MM2 = 1e-6


class Bundles(NamedTuple):
    """Sums over the rays of each pixel; moments are NaN if none passes.

    Attributes
    ----------
    weight : (n,) float64, m² sr
        W for a radiance of 1 W/(m² sr) before the camera through this lenslet: area times projected solid angle times
        transmittance, and the squared ratio of the indices behind and before the lens.
    mean : (n, 4) float64
        Mean ray: x and y in the plane of the first vertex (mm), dx/dz and dy/dz; camera frame.
    covariance : (n, 4, 4) float64
        Of the same four quantities.
    """

    weight: Array
    mean: Array
    covariance: Array


def bundles(world: World, plate: Plate, numbers: NDArray[np.int64], pixels_px: Array) -> Bundles:
    """Trace the bundles of pixels.

    Parameters
    ----------
    world : World
        The camera with nothing before it.
    plate : Plate
        Its array.
    numbers : (n,) int64
        Lenslet of each pixel, counted row by row.
    pixels_px : (n, 2) float64
        Column and row of each pixel on the sensor, with the centre of the first at (0, 0).
    """
    parts = [
        _chunk(world, plate, numbers[first : first + CHUNK], pixels_px[first : first + CHUNK])
        for first in range(0, len(numbers), CHUNK)
    ]
    return Bundles(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def cell_points(lattice: Lattice) -> tuple[Array, Array]:
    """Return Gauss points of a lattice's cell about its centre, (n, 2) mm, and the area of each, mm²."""
    half = 0.5 * lattice.pitch
    if not lattice.hexagonal:
        nodes, weights = gauss_legendre(ON_LENSLET)
        x, y = np.meshgrid(half * nodes, half * nodes)
        return np.column_stack([x.ravel(), y.ravel()]), (half * half * np.outer(weights, weights)).ravel()
    # Three strips along x with linearly varying widths; the middle one is as wide as the pitch.
    along, of_strip = gauss_legendre(ON_LENSLET // 2)
    across, of_row = gauss_legendre(ON_LENSLET)
    tip = lattice.circumradius
    points, areas = [], []
    for low, high in ((-1.0, -0.5), (-0.5, 0.5), (0.5, 1.0)):
        y = tip * (0.5 * (low + high) + 0.5 * (high - low) * along)
        reach = half * np.minimum(1.0, 2.0 * (1.0 - np.abs(y) / tip))
        points.append(np.stack([np.outer(reach, across), np.repeat(y[:, None], len(across), axis=1)], axis=-1))
        areas.append(0.5 * (high - low) * tip * of_strip[:, None] * reach[:, None] * of_row)
    return np.concatenate(points).reshape(-1, 2), np.concatenate(areas).ravel()


def _chunk(world: World, plate: Plate, numbers: NDArray[np.int64], pixels: Array) -> Bundles:
    scene, moves = world.scene, world.tables.frames
    sensor, lenslets = scene.camera.sensor, plate.lenslets
    nodes, shares = gauss_legendre(ON_PIXEL)
    x, y = np.meshgrid(0.5 * nodes, 0.5 * nodes)
    on_pixel, pixel_share = np.column_stack([x.ravel(), y.ravel()]), 0.25 * np.outer(shares, shares).ravel()
    on_cell, cell_area = cell_points(lenslets.lattice)
    count = len(numbers)
    of_pixel = np.repeat(np.arange(count), len(on_pixel) * len(on_cell))

    places = (pixels[:, None] + on_pixel - 0.5 * (np.asarray(sensor.pixels) - 1.0)) * sensor.pixel_mm
    places = np.repeat(places.reshape(-1, 2), len(on_cell), axis=0)
    cells = lenslets.lattice.centres().reshape(-1, 2)[numbers]
    to = (np.repeat(cells, len(on_pixel), axis=0)[:, None] + on_cell).reshape(-1, 2)
    sag, tilt = _curved_face(plate, numbers[of_pixel], to)
    before = np.full(len(sag), lenslets.thickness) if plate.curved_to_lens else -sag
    glass = lenslets.thickness - sag if plate.curved_to_lens else np.zeros(len(sag))
    _, slope, derivative = pixel_slopes(plate, places, to, before, glass)
    # On a sloping face, the ray's intersection moves more or less for the same change of slope.
    within = np.square(slope).sum(axis=1)
    last = -np.sqrt(plate.glass**2 + (plate.glass**2 - 1.0) * within) if plate.curved_to_lens else 1.0
    rise = 1.0 - np.einsum("ij,ij->i", slope, tilt) / last
    way = ahead(plate, slope)
    # From lenslet area to slopes, and from slopes to solid angle: cos³ for its size, and the cosine at the sensor for
    # the oblique pixel.
    along = 1.0 / np.linalg.norm(way, axis=1)
    aslant = np.abs(frames.directions(moves[MLA_FRAME, SENSOR_FRAME], way)[:, 2]) * along
    area = np.tile(cell_area, count * len(on_pixel)) * np.tile(np.repeat(pixel_share, len(on_cell)), count)
    etendue = sensor.pixel_mm**2 * area * rise * aslant * along**3 / np.abs(np.linalg.det(derivative))

    known = np.flatnonzero(np.isfinite(slope).all(axis=1))
    unit = along[known, None] * way[known]
    start, passed = _before_cover(world, places[known], unit)
    halfway = start + 0.5 * (np.abs(start[:, 2]) - before[known])[:, None] * way[known]
    to_world = frames.compose(moves[CAMERA_FRAME, WORLD_FRAME], moves[MLA_FRAME, CAMERA_FRAME])
    paths = trace(
        world, frames.points(to_world, halfway), frames.directions(to_world, unit), scene.primary_nm,
        split="transmit", engine=image_path_engine(scene, tracing=True), threads=scene.transport.threads,
    )  # fmt: skip
    out = paths.status == Status.ESCAPED
    rays = known[paths.source[out]]
    # Radiance over the square of the index is conserved, apart from the transmittance.
    facts = world.facts
    gain = (facts.image_index / facts.object_index) ** 2
    to_camera = moves[WORLD_FRAME, CAMERA_FRAME]
    p, d = frames.points(to_camera, paths.position[out]), frames.directions(to_camera, paths.direction[out])
    # Reversed light, with its start moved out of the lens.
    tables = at_wavelength(world, scene.primary_nm)
    away = float(np.linalg.norm(tables.lens.box_high - tables.lens.box_low))
    share = passed[paths.source[out]] * paths.weight[out]
    if phases_of(scene):
        share = _share_of_light(world, paths.position[out] + away * paths.direction[out], -paths.direction[out])
    weight = M2_PER_MM2 * gain * etendue[rays] * share
    weight /= etendue_factors(tables, p + away * d, -d)
    slopes = d[:, :2] / d[:, 2:]
    four = np.column_stack([p[:, :2] - p[:, 2:] * slopes, slopes])
    return _moments(count, of_pixel[rays], weight, four)


def _share_of_light(world: World, origins: Array, directions: Array) -> Array:
    """Return the share of light along rays that reaches the sensor, (n,).

    A diffractive face passes another share of light than of its reversal, which arrives at another angle.

    Parameters
    ----------
    world : World
    origins, directions : (n, 3) float64
        Before the lens, mm, and unit, world frame.
    """
    scene = world.scene
    paths = trace(
        world, origins, directions, scene.primary_nm,
        split="transmit", engine=image_path_engine(scene, tracing=True), threads=scene.transport.threads,
    )  # fmt: skip
    share, lands = np.zeros(len(origins)), paths.status == Status.SENSOR
    share[paths.source[lands]] = paths.weight[lands]
    return share


def _before_cover(world: World, places: Array, direction: Array) -> tuple[Array, Array]:
    """Return the exit points of rays from the sensor's cover, (n, 3) mm, and their transmittance.

    Parameters
    ----------
    world : World
    places : (n, 2) float64, mm
        On the sensor.
    direction : (n, 3) float64
        Unit, outside the cover; array frame, like the result.
    """
    moves, cover = world.tables.frames, world.tables.cover
    on_sensor = np.column_stack([places, np.zeros(len(places))])
    detected = np.full(len(places), 1.0 - world.tables.sensor.reflectance)
    if cover is None:
        return frames.points(moves[SENSOR_FRAME, MLA_FRAME], on_sensor), detected
    faces = faces_of(world.tables)
    front = faces.of_lens + faces.of_array
    rays = follow_sequence(
        world.tables,
        Itinerary((front + 1, front), (False, False), to_sensor=False),
        frames.points(moves[SENSOR_FRAME, CAMERA_FRAME], on_sensor),
        frames.directions(moves[MLA_FRAME, CAMERA_FRAME], direction),
        detected,
    )
    return frames.points(moves[CAMERA_FRAME, MLA_FRAME], rays.position), rays.weight


def _curved_face(plate: Plate, numbers: NDArray[np.int64], at: Array) -> tuple[Array, Array]:
    """Return the sag of lenslets, mm into the glass, at points of the array's plane, and its slopes, (n, 2)."""
    lenslets = plate.lenslets
    columns = lenslets.lattice.columns
    kinds = np.array([type_of(lenslets, number % columns, number // columns) for number in np.unique(numbers)])
    curvature = lenslets.curvature[kinds[np.unique(numbers, return_inverse=True)[1]]]
    if len(lenslets.stretch):
        curvature = curvature * lenslets.stretch[numbers]
    aside = at - plate.apexes[numbers]
    if lenslets.profile is not None:
        return _profiled_face(lenslets, kinds[np.unique(numbers, return_inverse=True)[1]], curvature, aside)
    r2 = np.square(aside).sum(axis=1)
    root = np.sqrt(1.0 - curvature * curvature * r2)
    return curvature * r2 / (1.0 + root), (curvature / root)[:, None] * aside


def _profiled_face(lenslets: Lenslets, kinds: NDArray[np.int64], curvature: Array, aside: Array) -> tuple[Array, Array]:
    """Return sag and slopes of aspheric lenslets, like `_curved_face`."""
    sag, normals = np.empty(len(aside)), np.empty((len(aside), 3))
    for kind, c in set(zip(kinds.tolist(), curvature.tolist(), strict=True)):
        of = (kinds == kind) & (curvature == c)
        sag[of], normals[of] = faces_at(lenslets, kind, c, aside[of])
    return sag, -normals[:, :2] / normals[:, 2:]


def _moments(count: int, pixel: NDArray[np.int64], weight: Array, four: Array) -> Bundles:
    """Return sums, means and covariances of rays for each pixel."""
    total = np.asarray(np.bincount(pixel, weight, count), dtype=np.float64)
    mean, covariance = np.full((count, 4), np.nan), np.full((count, 4, 4), np.nan)
    lit = total > 0.0
    for i in range(4):
        mean[lit, i] = np.bincount(pixel, weight * four[:, i], count)[lit] / total[lit]
    from_mean = four - mean[pixel]
    for i in range(4):
        for j in range(i + 1):
            product = np.bincount(pixel, weight * from_mean[:, i] * from_mean[:, j], count)[lit] / total[lit]
            covariance[lit, i, j] = covariance[lit, j, i] = product
    return Bundles(total, mean, covariance)
