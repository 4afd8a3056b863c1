"""Sampling of ghosts by the light of each sequence in a coarse trace.

Light that misses everything in the scene counts little. The trace decides only the probability of each sequence, never
the amount of light: every ray draws each sequence with some probability and is weighted by its inverse. The same holds
for new directions at the pixels.
"""

import math

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.meshes.levels import EXACT
from lfmesh.geometry.surfaces.surface import CONIC_AND_EVEN
from lfmesh.transport.aims.ghost_trace import (
    RAYS_OF_A_KIND,
    RAYS_OF_A_SINE,
    CoarseTrace,
    coarse_trace,
    meeting,
    projected_angles,
    rms_weights,
)
from lfmesh.transport.aims.kept import Kept, digest_of
from lfmesh.transport.aims.lenslet_view import RINGS, by_rings
from lfmesh.transport.packets.packet import BACK_FRAME, CAMERA_FRAME, MLA_FRAME, SENSOR_FRAME
from lfmesh.transport.sequences.follower import route_of
from lfmesh.transport.sequences.ghosts import (
    ANGLES,
    HEIGHTS,
    RADII,
    SINES,
    GhostTables,
)
from lfmesh.transport.sequences.ray_tables import faces_of
from lfmesh.transport.sequences.sequences import ARRAY_LEG, LENS_LEG, Faces, Itinerary
from lfmesh.transport.tables.phase_faces import spreads_light
from lfmesh.transport.tables.tables import AimTables, Tables

Array = NDArray[np.float64]

WITHIN_OPENING = 4
"""Number of radius intervals at the lens that lie in its opening, which may be small."""

SHARE_OF_DISK, SHARE_AROUND = 0.1, 0.2
"""Share of rays to anywhere on the disk at the lens, for a camera without an array; share of a cell's or interval's
light taken from its neighbours, as its few rays may have missed some."""

SHARE_OF_HALF_SPHERE, LEAST_ANEW, MOST_ANEW = 0.2, 0.02, 0.5
"""Share of packets with new directions that go uniformly over half of the sphere; least and largest share of these
among all packets."""

LEAST_TO_ARRAY = 0.1
"""Least share of new directions to anywhere on the array, and of the others."""

SHARE_OF_EACH = 0.1
"""Share of the probability that is equal for all sequences, as the few rays of a kind may have missed some."""

SHARE_OF_RING, SHARE_OF_ALL = {True: 0.5, False: 0.0}, {True: 0.1, False: 0.2}
"""Shares of the probability, with and without an array, that follow the light of sequences over all kinds of rays at
the same distance from the axis at the lens, and over all kinds. Lenslets reflect light so widely that few rays of a
kind return to the lens. Without an array, a sequence may show its own small pupil to only a few kinds."""


LEAST_SHOWN = 0.02
"""Least light of a ring at the lens, relative to the brightest, for the choice of lenslets that show it."""

MOST_SEARCHED = 4.0
"""Largest search distance, in pitches, from the chief ray of a pixel for lenslets that show ghosts."""

_kept: Kept[tuple[GhostTables, CoarseTrace] | None] = Kept()


def ghost_tables(tables: Tables, boxes: Array | None, max_events: int) -> GhostTables | None:
    """Return the sampling tables of ghosts; None if ghosts are not followed by sequence.

    That is so if a lens surface is thin, rough, met by its mesh, or not a conic or even asphere, if a phase has several
    orders, and if no sequence allowed by `max_events` carries light.

    Parameters
    ----------
    tables : Tables
        With the aim.
    boxes : (targets, 2, 3) float64, mm, optional
        Lowest and highest corners, world frame, of everything that ghosts can show. Default: everywhere.
    max_events : int
        As in `Options`.
    """
    camera, own = tables.camera, [CAMERA_FRAME, MLA_FRAME, SENSOR_FRAME, BACK_FRAME]
    # The light that leaves the camera does not depend on the places of objects.
    key = digest_of(camera._replace(frames=camera.frames[np.ix_(own, own)]), tables.aim.exit, max_events)
    found = _kept.of(key, lambda: _traced(tables, max_events))
    return None if found is None else with_chances(tables, boxes, *found)


def _traced(tables: Tables, max_events: int) -> tuple[GhostTables, CoarseTrace] | None:
    """Return a camera's sequences without probabilities, and their coarse trace; None as for `ghost_tables`."""
    lens = tables.lens
    known = (lens.surfaces["level"] == EXACT) & (lens.surfaces["kind"] == CONIC_AND_EVEN)
    if (
        not known.all()
        or lens.interfaces.thin
        or spreads_light(lens.interfaces)
        or spreads_light(tables.mla.interfaces)
    ):
        return None
    of = faces_of(tables)
    image_path, *twice = of.paths()
    paths = [path.reverse for path in twice if len(path.faces) <= max_events]
    if not paths:
        return None
    ghosts = _without_chances(tables, of, image_path, paths)
    trace = coarse_trace(tables, ghosts)
    return (ghosts, trace) if any(len(rays.ray) for rays in trace[:3]) else None


def with_chances(tables: Tables, boxes: Array | None, ghosts: GhostTables, trace: CoarseTrace) -> GhostTables:
    """Return the tables with the sequences' probabilities, by light that meets anything in the scene.

    Parameters
    ----------
    tables, boxes
        As for `ghost_tables`.
    ghosts : GhostTables
        The sequences.
    trace : CoarseTrace
        Their trace.
    """
    counted = [meeting(tables, boxes, rays) for rays in trace[:3]]
    of_kinds, at_sines, to_array = counted
    sequences = len(ghosts.lengths)
    light = rms_weights(trace.of_kinds, of_kinds, sequences, RAYS_OF_A_KIND).T
    area = _areas(ghosts)
    weighted = light.reshape(RADII, HEIGHTS, ANGLES, -1) * area[:, None, :, None]
    of_all = weighted.sum(axis=(0, 1, 2))
    if ghosts.anew.any():
        ghosts = _drawn_anew(
            ghosts,
            rms_weights(trace.at_sines, at_sines, sequences, RAYS_OF_A_SINE),
            rms_weights(trace.to_array, to_array, sequences, trace.to_array.rays, trace.solid_angles)[:, 0],
            _seen_by_sensor(tables, ghosts) * float(of_all.sum()) / HEIGHTS,
        )
    others = ~ghosts.anew
    return ghosts._replace(
        until=_cumulative(
            light, _shares(of_all, others), others, ghosts.from_pixel & others, array=bool(tables.mla.present)
        ),
        cells=_cells(weighted.sum(axis=3), area),
        shown=np.sqrt(np.square(light.sum(axis=1)).reshape(RADII, -1).mean(axis=1)),
    )


def _without_chances(tables: Tables, of: Faces, image_path: Itinerary, paths: list[Itinerary]) -> GhostTables:
    """Return the tables of sequences, from the sensor, without probabilities."""
    behind = [leg for leg in of.legs(image_path) if leg.part != LENS_LEG]
    to_lens = [leg for leg in of.legs(image_path.reverse) if leg.part != LENS_LEG]
    legs, first, from_pixel, anew = [*to_lens, *behind], [], [], []
    for path in paths:
        own = of.legs(path)
        begins_in_lens = own[: len(to_lens)] == to_lens
        first.append(len(legs))
        from_pixel.append(not begins_in_lens)
        anew.append(not begins_in_lens and any(of.part(face) == ARRAY_LEG for face in path.mirrors))
        legs += own[len(to_lens) if begins_in_lens else 0 :]
    from_z, height = _where_from(tables)
    opening = _opening(tables.aim)
    half = tables.mla.lenslets.lattice.half_extent if tables.mla.present else (0.0, 0.0)
    return GhostTables(
        route=route_of(legs, checked=True),
        to_lens=len(to_lens),
        first=np.array([*first, len(legs)], np.int64),
        from_pixel=np.array(from_pixel, np.bool_),
        lengths=np.array([len(path.faces) for path in paths], np.int64),
        anew=np.array(anew, np.bool_),
        share_anew=0.0,
        until_anew=np.zeros(len(paths)),
        to_array=0.0,
        array_half_x=half[0],
        array_half_y=half[1],
        sines=np.zeros((len(paths), SINES)),
        until=np.zeros((0, len(paths))),
        cells=np.zeros((HEIGHTS, 0)),
        plane_z=tables.aim.exit.opening.plane_z,
        from_z=from_z,
        rings=np.append(
            np.linspace(0.0, opening**2, WITHIN_OPENING, endpoint=False),
            np.linspace(opening**2, tables.aim.exit.wide_radius**2, RADII - WITHIN_OPENING + 1),
        ),
        height=height,
        shown=np.zeros(RADII),
    )


def _where_from(tables: Tables) -> tuple[float, float]:
    """Return z and radius, mm, of the plane of origin of rays to the lens, camera frame."""
    if tables.mla.present:
        move, half = tables.frames[MLA_FRAME, CAMERA_FRAME], tables.mla.lenslets.lattice.half_extent
    else:
        move, sensor = tables.frames[SENSOR_FRAME, CAMERA_FRAME], tables.sensor
        half = 0.5 * sensor.pixel * sensor.columns, 0.5 * sensor.pixel * sensor.rows
    corners = [move[:, :3] @ [x, y, 0.0] + move[:, 3] for x in (-half[0], half[0]) for y in (-half[1], half[1])]
    return float(move[2, 3]), max(float(np.hypot(*corner[:2])) for corner in corners)


def _opening(aim: AimTables) -> float:
    """Return a radius, mm, that holds the lens's opening but not the whole disk."""
    disks, within = aim.exit.opening.far, math.sqrt(0.5) * aim.exit.wide_radius
    seen = disks.radius > 0.0
    return min(float((np.abs(disks.middle) + disks.radius)[seen].max()), within) if seen.any() else within


def _seen_by_sensor(tables: Tables, ghosts: GhostTables) -> float:
    """Return the approximate projected solid angle, sr, of the disk at the lens from the sensor."""
    return math.pi / (1.0 + ((ghosts.from_z - ghosts.plane_z) / tables.aim.exit.wide_radius) ** 2)


def _drawn_anew(ghosts: GhostTables, light: Array, to_array: Array, of_others: float) -> GhostTables:
    """Return the tables with the probabilities of sequences with new directions.

    Parameters
    ----------
    ghosts : GhostTables
    light : (sequences, SINES) float64
        Root mean square of the weights of rays in each interval of the sine.
    to_array : (sequences,) float64, sr
        The same for rays to anywhere on the array, of weight times inverse density in projected solid angle.
    of_others : float, sr
        As `to_array`, for all other sequences together and rays over all of the lens.
    """
    projected = projected_angles()
    padded = np.pad(light, ((0, 0), (1, 1)), mode="edge")
    found = projected * ((1.0 - SHARE_AROUND) * light + 0.5 * SHARE_AROUND * (padded[:, :-2] + padded[:, 2:]))
    total = found.sum(axis=1, keepdims=True)
    own = np.where(total > 0.0, found / np.where(total > 0.0, total, 1.0), projected)
    chances = (1.0 - SHARE_OF_HALF_SPHERE) * own + SHARE_OF_HALF_SPHERE * projected
    squares = math.pi**2 * ((projected * light) ** 2 / chances).sum(axis=1)
    share_to_array = _share_to_array(squares.sum(), np.square(to_array).sum())
    # Each of the two ways to draw directions counts by the inverse of its squares.
    inverse = share_to_array * _inverse(to_array**2) + (1.0 - share_to_array) * _inverse(squares)
    each = np.sqrt(_inverse(inverse))
    share = 1.0
    if not ghosts.anew.all():
        # There may be a little light even if the coarse trace has found none.
        both = float(each.sum()) + of_others
        share = float(np.clip(each.sum() / both if both > 0.0 else MOST_ANEW, LEAST_ANEW, MOST_ANEW))
    chance = (1.0 - SHARE_OF_EACH) * _shares(each, ghosts.anew) + SHARE_OF_EACH * _evenly(ghosts.anew)
    return ghosts._replace(share_anew=share, until_anew=_until(chance), to_array=share_to_array, sines=_until(chances))


def _inverse(squares: Array) -> Array:
    """Return the inverses of squares; 0 if the coarse trace has found nothing."""
    return np.where(squares > 0.0, 1.0 / np.where(squares > 0.0, squares, 1.0), 0.0)


def _share_to_array(at_sines: float, to_array: float) -> float:
    """Return the share of new directions to anywhere on the array, from both ways' squared weights."""
    both = at_sines + to_array
    return float(np.clip(at_sines / both if both > 0.0 else 0.5, LEAST_TO_ARRAY, 1.0 - LEAST_TO_ARRAY))


def _shares(light: Array, those: NDArray[np.bool_]) -> Array:
    """Return selected sequences' shares of their light, (sequences,); 0 for the others."""
    found = np.where(those, light, 0.0)
    total = found.sum()
    return np.asarray(found / total) if total > 0.0 else _evenly(those)


def _evenly(those: NDArray[np.bool_]) -> Array:
    """Return equal shares for selected sequences, 0 for the others."""
    return np.where(those, 1.0 / max(int(those.sum()), 1), 0.0)


def _cumulative(
    light: Array, of_all: Array, those: NDArray[np.bool_], from_pixel: NDArray[np.bool_], *, array: bool
) -> Array:
    """Return the cumulative probabilities of sequences for each kind of ray, from their light.

    In the last row, for rays that do not reach the lens, sequences that start at the pixel share the whole probability.

    Parameters
    ----------
    light : (kinds, sequences) float64
    of_all : (sequences,) float64
        Share of the light of all kinds.
    those : (sequences,) bool
        Sequences with a probability.
    from_pixel : (sequences,) bool
        Sequences among them that start at the pixel.
    array : bool
        There is an array.
    """
    by_ring = light.reshape(RADII, HEIGHTS * ANGLES, -1)
    of_ring = np.repeat(np.sqrt((by_ring**2).mean(axis=1)), by_ring.shape[1], axis=0)
    chances = (1.0 - SHARE_OF_RING[array] - SHARE_OF_ALL[array] - SHARE_OF_EACH) * _of_kinds(light, of_all)
    chances += SHARE_OF_RING[array] * _of_kinds(of_ring, of_all) + SHARE_OF_ALL[array] * of_all
    each = SHARE_OF_EACH * _evenly(those)
    return _until(np.vstack([chances + each, np.where(from_pixel, of_all + each, 0.0)]))


def _of_kinds(light: Array, of_all: Array) -> Array:
    """Return the sequences' shares of each kind's light (kinds, sequences); `of_all` for dark kinds."""
    total = light.sum(axis=1, keepdims=True)
    return np.where(total > 0.0, light / np.where(total > 0.0, total, 1.0), of_all)


def _until(chances: Array) -> Array:
    """Return cumulative probabilities along the last axis, up to 1 or all 0."""
    until = np.cumsum(chances, axis=-1)
    return np.ascontiguousarray(until / np.where(until[..., -1:] > 0.0, until[..., -1:], 1.0))


def _areas(ghosts: GhostTables) -> Array:
    """Return each cell's share of the disk at the lens, (RADII, ANGLES)."""
    edges = np.arccos(1.0 - 2.0 * np.arange(ANGLES + 1) / ANGLES)
    return np.asarray(np.outer(np.diff(ghosts.rings) / ghosts.rings[-1], np.diff(edges) / edges[-1]))


def _cells(light: Array, area: Array) -> Array:
    """Return the cumulative probabilities of the cells at the lens by height, (HEIGHTS, RADII · ANGLES).

    Parameters
    ----------
    light : (RADII, HEIGHTS, ANGLES) float64
        Light of all sequences.
    area : (RADII, ANGLES) float64
        Shares of the disk.
    """
    found = light.transpose(1, 0, 2)
    padded = np.pad(found, ((0, 0), (1, 1), (1, 1)), mode="edge")
    around = sum(padded[:, i : i + RADII, j : j + ANGLES] for i in range(3) for j in range(3)) / 9.0
    found = (1.0 - SHARE_AROUND) * found + SHARE_AROUND * around
    total = found.sum(axis=(1, 2), keepdims=True)
    own = np.where(total > 0.0, found / np.where(total > 0.0, total, 1.0), area)
    return _until(((1.0 - SHARE_OF_DISK) * own + SHARE_OF_DISK * area).reshape(HEIGHTS, -1))


def aim_at_ghosts(tables: Tables, ghosts: GhostTables) -> AimTables:
    """Return the aim of ghost packets, at the places on the lens where the coarse trace has found ghosts.

    Without an array these are the cells at the lens. With an array, rays go to the lenslets that show the disk of the
    ghosts, wider than the opening, each weighted by the light of the ring that it shows.

    Parameters
    ----------
    tables : Tables
        With the aim.
    ghosts : GhostTables
    """
    aim = tables.aim
    if not tables.mla.present:
        # The cells hold all of the lens.
        return aim._replace(exit=aim.exit._replace(ghosts=ghosts, wide_share=0.0, share_without_aim=0.0))
    lit = np.flatnonzero(ghosts.shown)
    lenslets, opening = aim.lenslets, _opening(aim)
    if not (len(lit) and opening > 0.0 and lenslets.search > 0.0):
        return aim
    growth = math.sqrt(ghosts.rings[lit[-1] + 1]) / opening
    growth = max(1.0, min(growth, MOST_SEARCHED / lenslets.search))
    middles = (np.arange(RINGS) + 0.5) / RINGS * (growth * opening) ** 2
    ring = np.minimum(np.searchsorted(ghosts.rings, middles, side="right"), RADII) - 1
    light = np.maximum(ghosts.shown[ring], LEAST_SHOWN * ghosts.shown.max())
    seen = lenslets.slope_radius2 > 0.0
    return aim._replace(
        lenslets=lenslets._replace(
            slope_radius2=np.where(seen, growth * growth * lenslets.slope_radius2, lenslets.slope_radius2),
            search=growth * lenslets.search,
            shown=by_rings(light),
        )
    )
