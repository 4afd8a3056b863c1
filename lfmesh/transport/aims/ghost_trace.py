"""Coarse trace of ghosts: weights of rays from the sensor that leave the camera along each sequence.

It is made once per camera. Its light that meets anything in a scene decides the probability of each sequence there
(`ghost_aim`).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry import frame
from lfmesh.transport.packets.packet import CAMERA_FRAME, MLA_FRAME, SENSOR_FRAME, WORLD_FRAME
from lfmesh.transport.sequences.follower import RAY_ENDED, RAY_WEIGHT
from lfmesh.transport.sequences.ghosts import ANGLES, HEIGHTS, RADII, SINES, GhostTables
from lfmesh.transport.sequences.ray_tables import follow_route
from lfmesh.transport.tables.phase_faces import carrying
from lfmesh.transport.tables.tables import Tables

Array = NDArray[np.float64]

RAYS_OF_A_KIND, RAYS_OF_A_SINE = 16, 256
"""Rays of the coarse trace per kind of ray, and per interval of the sine of the angle at the sensor."""

SHARE_PAST_ALL = 0.1
"""Factor on the weights of rays that miss everything in the scene, as the few rays of a kind that meet something say
too little about how often others do."""

MOST_BOXES = 16
"""Largest number of targets with a box test each; beyond it, rays are tested against a common box."""


class Passing(NamedTuple):
    """Rays that leave the camera, of those sent along each of several sequences.

    Attributes
    ----------
    rays : int
        Number of rays sent along each sequence.
    sequence, ray : (n,) int64
        Sequence, and ray number.
    weight : (n,) float64
    p, d : (n, 3) float64
        Exit point on the lens, mm, and direction, camera frame.
    """

    rays: int
    sequence: NDArray[np.int64]
    ray: NDArray[np.int64]
    weight: Array
    p: Array
    d: Array


class CoarseTrace(NamedTuple):
    """Rays that leave a camera: of each kind at the lens, of each sine, and to anywhere on the array.

    Attributes
    ----------
    of_kinds, at_sines, to_array : Passing
        The last two along sequences that start in new directions at the pixel.
    solid_angles : (rays to the array,) float64
        Inverse densities of the last, sr of projected solid angle.
    """

    of_kinds: Passing
    at_sines: Passing
    to_array: Passing
    solid_angles: Array


def coarse_trace(tables: Tables, ghosts: GhostTables) -> CoarseTrace:
    """Trace some rays of each kind along all sequences.

    Parameters
    ----------
    tables : Tables
        With the aim.
    ghosts : GhostTables
        Without probabilities.
    """
    of_kinds = _passing(tables, ghosts, ~ghosts.anew, *_rays(ghosts))
    if not ghosts.anew.any():
        none = Passing(0, *(np.zeros(0, np.int64),) * 2, np.zeros(0), *(np.zeros((0, 3)),) * 2)
        return CoarseTrace(of_kinds, none, none, np.zeros(0))
    at_sines = _passing(tables, ghosts, ghosts.anew, *_rays_from_sensor(tables))
    p, d, solid_angles = _rays_to_array(tables)
    return CoarseTrace(of_kinds, at_sines, _passing(tables, ghosts, ghosts.anew, p, d), solid_angles)


def _passing(tables: Tables, ghosts: GhostTables, those: NDArray[np.bool_], p: Array, d: Array) -> Passing:
    """Return the rays that leave the camera along the selected sequences.

    Parameters
    ----------
    those : (sequences,) bool
        Selected sequences.
    p, d : (n, 3) float64
        Position, mm, and unit direction, camera frame: behind the lens and towards it, on the image path; from the
        sensor, for sequences with new directions.
    """
    turning = ghosts.from_pixel & ~ghosts.anew & those
    as_given = np.arange(len(p)), _starts(p, d)
    turned = _turned_back_at_sensor(tables, ghosts, p, d) if turning.any() else as_given
    out = []
    for sequence in np.flatnonzero(those):
        numbers, rays = turned if turning[sequence] else as_given
        ends = _follow(tables, ghosts, rays, *ghosts.first[sequence : sequence + 2])
        passes = np.flatnonzero((ends[RAY_ENDED] == 0.0) & (ends[RAY_WEIGHT] > 0.0))
        out.append((np.full(len(passes), sequence), numbers[passes], *ends[:7, passes]))
    sequences, rays_passing, *ends_passing = (np.concatenate(each) for each in zip(*out, strict=True))
    return Passing(
        len(p), sequences, rays_passing, ends_passing[6],
        np.column_stack(ends_passing[:3]), np.column_stack(ends_passing[3:6]),
    )  # fmt: skip


def meeting(tables: Tables, boxes: Array | None, rays: Passing) -> NDArray[np.bool_]:
    """Tell for each ray whether it meets any box.

    Parameters
    ----------
    tables : Tables
    boxes : (n, 2, 3) float64, mm, optional
        Lowest and highest corners, world frame; if omitted, all rays do.
    rays : Passing
    """
    if boxes is None:
        return np.ones(len(rays.weight), np.bool_)
    if len(boxes) > MOST_BOXES:
        boxes = np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])[None]
    move = tables.frames[CAMERA_FRAME, WORLD_FRAME]
    p, d = frame.points(move, rays.p), frame.directions(move, rays.d)
    meets = np.zeros(len(p), np.bool_)
    with np.errstate(divide="ignore", invalid="ignore"):
        for low, high in boxes:
            one, other = (low - p) / d, (high - p) / d
            # A ray along a face of a box, with 0 / 0, counts as missing it.
            begins, ends = np.fmin(one, other).max(axis=1), np.fmax(one, other).min(axis=1)
            meets |= (begins <= ends) & (ends > 0.0)
    return meets


def rms_weights(
    rays: Passing, counted: NDArray[np.bool_], sequences: int, of_a_kind: int, factors: Array | float = 1.0
) -> Array:
    """Return the root mean square weight of each kind of ray along each sequence, (sequences, kinds).

    Parameters
    ----------
    rays : Passing
    counted : (n,) bool
        Rays that count in full; the others count by `SHARE_PAST_ALL`.
    sequences : int
    of_a_kind : int
        Number of consecutive rays per kind.
    factors : (rays,) float64, optional
        Factors on the weights.
    """
    if rays.rays == 0:
        return np.zeros((sequences, 0))
    kinds = rays.rays // of_a_kind
    weights = np.broadcast_to(factors, rays.rays)[rays.ray] * np.where(counted, 1.0, SHARE_PAST_ALL) * rays.weight
    cell = rays.sequence * kinds + rays.ray // of_a_kind
    sums = np.bincount(cell, weights**2, sequences * kinds)
    return np.asarray(np.sqrt(sums / of_a_kind).reshape(sequences, kinds))


def _turned_back_at_sensor(tables: Tables, ghosts: GhostTables, p: Array, d: Array) -> tuple[NDArray[np.int64], Array]:
    """Trace rays at the lens back to their pixels; return the arrivals' indices and their reversed rays."""
    t = (ghosts.plane_z - p[:, 2]) / d[:, 2]
    ends = _follow(tables, ghosts, _starts(p + t[:, None] * d, -d), ghosts.to_lens, ghosts.first[0])
    passing = np.flatnonzero(ends[RAY_ENDED] == 0.0)
    x, along = ends[:3, passing].T, ends[3:6, passing].T
    move = tables.frames[CAMERA_FRAME, SENSOR_FRAME]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = -frame.points(move, x)[:, 2] / frame.directions(move, along)[:, 2]
        return passing, _starts(x + t[:, None] * along, -along)


def _starts(p: Array, d: Array) -> Array:
    """Return rays of weight 1 in the form of `follow_rays`."""
    rays = np.ones((7, len(p)))
    rays[:3], rays[3:6] = p.T, d.T
    return rays


def _follow(tables: Tables, ghosts: GhostTables, rays: Array, first: int, last: int) -> Array:
    """Return the ends of rays along legs of the sequences, see `follow_rays`."""
    colour = tables.lens.media.indices.shape[1] // 2
    return follow_route(carrying(tables.camera, importance=True), ghosts.route, rays, (first, last), colour)


def _rays(ghosts: GhostTables) -> tuple[Array, Array]:
    """Return rays of each kind to the lens: positions and directions (kinds · RAYS_OF_A_KIND, 3), camera frame."""
    shape = (RADII, HEIGHTS, ANGLES, RAYS_OF_A_KIND)
    draw = np.random.default_rng(0)
    at = np.indices(shape)[:3] + draw.random((3, *shape))
    r = np.sqrt(np.interp(at[0].ravel(), np.arange(RADII + 1), ghosts.rings))
    height = ghosts.height * np.sqrt(at[1].ravel() / HEIGHTS)
    angle = np.arccos(1.0 - 2.0 * at[2].ravel() / ANGLES) * draw.choice([-1.0, 1.0], r.shape)
    turn = 2.0 * np.pi * draw.random(r.shape)
    p = np.column_stack([height * np.cos(turn), height * np.sin(turn), np.full_like(r, ghosts.from_z)])
    to = np.column_stack([r * np.cos(turn + angle), r * np.sin(turn + angle), np.full_like(r, ghosts.plane_z)])
    d = to - p
    return p, d / np.linalg.norm(d, axis=1)[:, None]


def _rays_from_sensor(tables: Tables) -> tuple[Array, Array]:
    """Return rays of each sine from the sensor: positions and directions (SINES · RAYS_OF_A_SINE, 3)."""
    draw = np.random.default_rng(1)
    move, count = tables.frames[SENSOR_FRAME, CAMERA_FRAME], SINES * RAYS_OF_A_SINE
    at = _on_sensor(tables, draw.uniform(-1.0, 1.0, (count, 2)))
    low = (np.repeat(np.arange(SINES), RAYS_OF_A_SINE) / SINES) ** 2
    squared = low + draw.random(count) * np.repeat(projected_angles(), RAYS_OF_A_SINE)
    sine, turn = np.sqrt(squared), 2.0 * np.pi * draw.random(count)
    d = np.column_stack([sine * np.cos(turn), sine * np.sin(turn), -np.sqrt(1.0 - squared)])
    return frame.points(move, at), frame.directions(move, d)


def _rays_to_array(tables: Tables) -> tuple[Array, Array, Array]:
    """Return rays from the sensor to the array likewise, and inverse densities (n,), sr of projected solid angle."""
    draw, lenslets, count = np.random.default_rng(2), tables.mla.lenslets, SINES * RAYS_OF_A_SINE
    half = np.array(lenslets.lattice.half_extent)
    at = _on_sensor(tables, draw.uniform(-1.0, 1.0, (count, 2)))
    to = np.column_stack([half * draw.uniform(-1.0, 1.0, (count, 2)), np.full(count, 0.5 * lenslets.thickness)])
    way = frame.points(tables.frames[MLA_FRAME, SENSOR_FRAME], to) - at
    length = np.linalg.norm(way, axis=1)
    d = way / length[:, None]
    at_array = frame.directions(tables.frames[SENSOR_FRAME, MLA_FRAME], d)[:, 2]
    projected = 4.0 * half.prod() * np.abs(at_array) * np.maximum(-d[:, 2], 0.0) / length**2
    move = tables.frames[SENSOR_FRAME, CAMERA_FRAME]
    return frame.points(move, at), frame.directions(move, d), projected


def _on_sensor(tables: Tables, at: Array) -> Array:
    """Return points of the sensor (n, 3), sensor frame, from coordinates (n, 2) between −1 and 1."""
    sensor = tables.sensor
    return np.column_stack([0.5 * sensor.pixel * np.array([sensor.columns, sensor.rows]) * at, np.zeros(len(at))])


def projected_angles() -> Array:
    """Return the projected solid angles of the intervals of the sine, over π, (SINES,)."""
    return np.diff((np.arange(SINES + 1) / SINES) ** 2)
