"""How the lens's ghosts are drawn: by the light that each sequence brings, as a coarse trace finds it.

The trace decides only how often a sequence is followed, never what light there is: each is drawn by every ray with some
chance, and weighted by its inverse.
"""

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.levels import EXACT
from lfmesh.geometry.surface import CONIC_AND_EVEN
from lfmesh.transport.packets.packet import CAMERA_FRAME, MLA_FRAME, SENSOR_FRAME
from lfmesh.transport.sequential.lens_ghosts import ANGLES, HEIGHTS, RADII, GhostTables
from lfmesh.transport.sequential.reflections import follow_sequence
from lfmesh.transport.sequential.sequences import Itinerary, two_reflections
from lfmesh.transport.tables.tables import Tables

Array = NDArray[np.float64]

RAYS_OF_A_KIND = 16
"""Rays of the coarse trace for each kind of ray that is told apart."""

SHARE_OF_ALL, SHARE_OF_EACH = 0.2, 0.1
"""Share of the chances that goes by the light that sequences bring over all kinds of rays, and the share that all have
alike: for what the few rays of a kind have missed."""

COVER_FACES, ARRAY_FACES = 2, 2


def ghost_tables(tables: Tables, max_events: int) -> GhostTables | None:
    """Return how the lens's ghosts are drawn; None where they are not followed by sequence.

    That is where a surface is none of revolution, or a thin lens, where `max_events` might cut a sequence, and where no
    light comes along any.

    Parameters
    ----------
    tables : Tables
        With the aim.
    max_events : int
        As in `Options`.
    """
    lens = tables.lens
    count = len(lens.surfaces)
    paths = [path.reverse for path in two_reflections(count)]
    known = (lens.surfaces["level"] == EXACT) & (lens.surfaces["kind"] == CONIC_AND_EVEN)
    if not paths or not known.all() or lens.interfaces.thin or lens.interfaces.rough:
        return None
    longest = max(len(path.faces) for path in paths)
    if longest + COVER_FACES + ARRAY_FACES >= max_events:
        return None
    faces, reflected = np.zeros((len(paths), longest), np.int64), np.zeros((len(paths), longest), np.bool_)
    for row, path in enumerate(paths):
        faces[row, : len(path.faces)], reflected[row, : len(path.faces)] = path.faces, path.reflected
    from_z, height = _where_from(tables)
    ghosts = GhostTables(
        faces, reflected, np.array([len(path.faces) for path in paths]), np.zeros((0, len(paths))),
        tables.aim.exit.plane_z, from_z, tables.aim.back_radius, height,
    )  # fmt: skip
    light = _light(tables, ghosts, paths)
    if not light.any():
        return None
    return ghosts._replace(until=_cumulative(light))


def _where_from(tables: Tables) -> tuple[float, float]:
    """Return z and largest distance from the axis, mm, of the plane that rays to the lens come from, camera frame."""
    if tables.mla.present:
        move, half = tables.frames[MLA_FRAME, CAMERA_FRAME], tables.mla.lenslets.lattice.half_extent
    else:
        move, sensor = tables.frames[SENSOR_FRAME, CAMERA_FRAME], tables.sensor
        half = 0.5 * sensor.pixel * sensor.columns, 0.5 * sensor.pixel * sensor.rows
    corners = [move[:, :3] @ [x, y, 0.0] + move[:, 3] for x in (-half[0], half[0]) for y in (-half[1], half[1])]
    return float(move[2, 3]), max(float(np.hypot(*corner[:2])) for corner in corners)


def _light(tables: Tables, ghosts: GhostTables, paths: list[Itinerary]) -> Array:
    """Return the root mean square of the weights of rays of each kind along each sequence, (kinds, sequences)."""
    p, d = _rays(ghosts)
    colour = tables.lens.media.indices.shape[1] // 2
    squares = [follow_sequence(tables.lens, path, p, d, colour).weight ** 2 for path in paths]
    means = np.array(squares).reshape(len(paths), -1, RAYS_OF_A_KIND).mean(axis=2)
    return np.sqrt(means.T)


def _rays(ghosts: GhostTables) -> tuple[Array, Array]:
    """Return some rays of each kind to the lens: positions and directions (kinds · RAYS_OF_A_KIND, 3), camera frame."""
    shape = (RADII, HEIGHTS, ANGLES, RAYS_OF_A_KIND)
    draw = np.random.default_rng(0)
    at = np.indices(shape)[:3] + draw.random((3, *shape))
    r = ghosts.radius * np.sqrt(at[0].ravel() / RADII)
    height = ghosts.height * np.sqrt(at[1].ravel() / HEIGHTS)
    angle = np.arccos(1.0 - 2.0 * at[2].ravel() / ANGLES) * draw.choice([-1.0, 1.0], r.shape)
    turn = 2.0 * np.pi * draw.random(r.shape)
    p = np.column_stack([height * np.cos(turn), height * np.sin(turn), np.full_like(r, ghosts.from_z)])
    to = np.column_stack([r * np.cos(turn + angle), r * np.sin(turn + angle), np.full_like(r, ghosts.plane_z)])
    d = to - p
    return p, d / np.linalg.norm(d, axis=1)[:, None]


def _cumulative(light: Array) -> Array:
    """Return the cumulative chances of the sequences for each kind of ray from the light that they bring."""
    of_all = light.sum(axis=0) / light.sum()
    of_kind = light.sum(axis=1, keepdims=True)
    own = np.where(of_kind > 0.0, light / np.where(of_kind > 0.0, of_kind, 1.0), of_all)
    chances = (1.0 - SHARE_OF_ALL - SHARE_OF_EACH) * own + SHARE_OF_ALL * of_all + SHARE_OF_EACH / light.shape[1]
    until = np.cumsum(chances, axis=1)
    return np.ascontiguousarray(until / until[:, -1:])
