"""How ghosts are drawn: by the light that each sequence brings, as a coarse trace finds it.

The trace decides only how often a sequence is followed, never what light there is: each is drawn by every ray with some
chance, and weighted by its inverse.
"""

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.levels import EXACT
from lfmesh.geometry.surface import CONIC_AND_EVEN
from lfmesh.transport.aiming.lenslet_view import with_wider_views
from lfmesh.transport.aiming.mixture import WIDE_SHARE_OF_GHOSTS
from lfmesh.transport.packets.packet import CAMERA_FRAME, MLA_FRAME, SENSOR_FRAME
from lfmesh.transport.sequential.ghosts import ANGLES, HEIGHTS, RADII, GhostTables, weights_along
from lfmesh.transport.sequential.lens_bundle import empty_bundle
from lfmesh.transport.sequential.plane_faces import count_faces
from lfmesh.transport.sequential.reflections import BUNDLE_ROWS, book_for
from lfmesh.transport.sequential.sequences import ARRAY_LEG, LENS_LEG, Faces, Itinerary
from lfmesh.transport.tables.tables import AimTables, Tables

Array = NDArray[np.float64]

RAYS_OF_A_KIND = 16
"""Rays of the coarse trace for each kind of ray that is told apart."""

SHARE_OF_DISK = 0.1
"""Share of the rays of a camera without an array that go anywhere on the disk at the lens."""

SHARE_OF_ALL, SHARE_OF_EACH = 0.2, 0.1
"""Share of the chances that goes by the light that sequences bring over all kinds of rays, and the share that all have
alike: for what the few rays of a kind have missed."""


def ghost_tables(tables: Tables, max_events: int) -> GhostTables | None:
    """Return how ghosts are drawn; None where they are not followed by sequence.

    That is where a surface of the lens is none of revolution, or a thin lens, and where no light comes along any of the
    sequences that `max_events` allows.

    Parameters
    ----------
    tables : Tables
        With the aim.
    max_events : int
        As in `Options`.
    """
    lens = tables.lens
    known = (lens.surfaces["level"] == EXACT) & (lens.surfaces["kind"] == CONIC_AND_EVEN)
    if not known.all() or lens.interfaces.thin or lens.interfaces.rough:
        return None
    of = Faces(len(lens.surfaces), 2 * tables.mla.present, count_faces(tables), tables.sensor.reflectance > 0.0)
    image_path, *twice = of.paths()
    # The array itself reflects nothing on them.
    paths = [path.reverse for path in twice if all(of.part(face) != ARRAY_LEG for face in path.mirrors)]
    paths = [path for path in paths if len(path.faces) <= max_events]
    if not paths:
        return None
    ghosts = _without_chances(tables, of, image_path, paths)
    light = _light(tables, ghosts)
    if not light.any():
        return None
    return ghosts._replace(until=_cumulative(light, ghosts.from_pixel), cells=_cells(light))


def _without_chances(tables: Tables, of: Faces, image_path: Itinerary, paths: list[Itinerary]) -> GhostTables:
    """Return the tables of sequences, from the sensor, with no chances yet."""
    behind = [leg for leg in of.legs(image_path) if leg.part != LENS_LEG]
    to_lens = [leg for leg in of.legs(image_path.reverse) if leg.part != LENS_LEG]
    legs, first, from_pixel = [*to_lens, *behind], [], []
    for path in paths:
        own = of.legs(path)
        begins_in_lens = own[: len(to_lens)] == to_lens
        first.append(len(legs))
        from_pixel.append(not begins_in_lens)
        legs += own[len(to_lens) if begins_in_lens else 0 :]
    steps = np.cumsum([0, *(len(leg.faces) for leg in legs)])
    from_z, height = _where_from(tables)
    return GhostTables(
        faces=np.array([face for leg in legs for face in leg.faces], np.int64),
        reflected=np.array([mirrors for leg in legs for mirrors in leg.reflected], np.bool_),
        legs=np.array([(leg.part, *steps[k : k + 2], leg.to_sensor) for k, leg in enumerate(legs)], np.int64),
        to_lens=len(to_lens),
        first=np.array([*first, len(legs)], np.int64),
        from_pixel=np.array(from_pixel, np.bool_),
        lengths=np.array([len(path.faces) for path in paths], np.int64),
        until=np.zeros((0, len(paths))),
        cells=np.zeros((HEIGHTS, 0)),
        plane_z=tables.aim.exit.plane_z,
        from_z=from_z,
        radius=tables.aim.back_radius,
        height=height,
    )


def _where_from(tables: Tables) -> tuple[float, float]:
    """Return z and largest distance from the axis, mm, of the plane that rays to the lens come from, camera frame."""
    if tables.mla.present:
        move, half = tables.frames[MLA_FRAME, CAMERA_FRAME], tables.mla.lenslets.lattice.half_extent
    else:
        move, sensor = tables.frames[SENSOR_FRAME, CAMERA_FRAME], tables.sensor
        half = 0.5 * sensor.pixel * sensor.columns, 0.5 * sensor.pixel * sensor.rows
    corners = [move[:, :3] @ [x, y, 0.0] + move[:, 3] for x in (-half[0], half[0]) for y in (-half[1], half[1])]
    return float(move[2, 3]), max(float(np.hypot(*corner[:2])) for corner in corners)


def _light(tables: Tables, ghosts: GhostTables) -> Array:
    """Return the root mean square of the weights of rays of each kind along each sequence, (kinds, sequences)."""
    p, d = _rays(ghosts)
    camera = tables.lens, tables.mla, tables.sensor, tables.cover
    media = [tables.lens.media, tables.mla.media, *([] if tables.cover is None else [tables.cover.media])]
    book, bundle = max((book_for(each) for each in media), key=len), empty_bundle(BUNDLE_ROWS)
    colour = tables.lens.media.indices.shape[1] // 2
    weights = np.zeros((len(ghosts.lengths), len(p)))
    for sequence, row in enumerate(weights):
        weights_along(sequence, p, d, camera, ghosts, tables.frames, colour, bundle, book, row)
    return np.sqrt((weights.reshape(len(weights), -1, RAYS_OF_A_KIND) ** 2).mean(axis=2).T)


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


def _cumulative(light: Array, from_pixel: NDArray[np.bool_]) -> Array:
    """Return the cumulative chances of the sequences for each kind of ray from the light that they bring.

    In the last row, for rays that do not come to the lens, those that begin at the pixel share all chances.
    """
    of_all = light.sum(axis=0) / light.sum()
    of_kind = light.sum(axis=1, keepdims=True)
    own = np.where(of_kind > 0.0, light / np.where(of_kind > 0.0, of_kind, 1.0), of_all)
    chances = (1.0 - SHARE_OF_ALL - SHARE_OF_EACH) * own + SHARE_OF_ALL * of_all + SHARE_OF_EACH / light.shape[1]
    lost = np.where(from_pixel, of_all + SHARE_OF_EACH / light.shape[1], 0.0)
    until = np.cumsum(np.vstack([chances, lost]), axis=1)
    return np.ascontiguousarray(until / np.where(until[:, -1:] > 0.0, until[:, -1:], 1.0))


def _cells(light: Array) -> Array:
    """Return the cumulative chances of the cells at the lens, for each height, from the light of all sequences."""
    edges = np.arccos(1.0 - 2.0 * np.arange(ANGLES + 1) / ANGLES)
    area = np.broadcast_to(np.diff(edges) / edges[-1] / RADII, (RADII, ANGLES)).ravel()
    found = light.sum(axis=1).reshape(RADII, HEIGHTS, ANGLES).transpose(1, 0, 2).reshape(HEIGHTS, -1) * area
    total = found.sum(axis=1, keepdims=True)
    own = np.where(total > 0.0, found / np.where(total > 0.0, total, 1.0), area)
    until = np.cumsum((1.0 - SHARE_OF_DISK) * own + SHARE_OF_DISK * area, axis=1)
    return np.ascontiguousarray(until / until[:, -1:])


def aim_at_ghosts(tables: Tables, ghosts: GhostTables) -> AimTables:
    """Return where the packets of ghosts are aimed.

    What the sensor or its cover reflects comes through an array mostly from beside the lens's opening, often from the
    whole lens: then lenslets are chosen by the light of ghosts, in rings about the middle of the lens's view.

    Parameters
    ----------
    tables : Tables
        With the aim of the image path.
    ghosts : GhostTables
    """
    aim = tables.aim._replace(wide_share=WIDE_SHARE_OF_GHOSTS)
    known = aim.exit.radius > 0.0
    reflects = tables.cover is not None or tables.sensor.reflectance > 0.0
    if not (tables.mla.present and reflects and known.any()):
        return aim
    wider = ghosts.radius / float(np.median(aim.exit.radius[known]))
    if not wider > 1.0:
        return aim
    rings = len(aim.shown) - 1
    light = np.diff(ghosts.cells, prepend=0.0, axis=1).reshape(HEIGHTS, RADII, ANGLES).sum(axis=(0, 2))
    shown = np.interp((np.arange(rings) + 0.5) / rings * RADII - 0.5, np.arange(RADII), light)
    wide = with_wider_views(aim, tables.mla, tables.frames, tables.sensor, wider)
    return wide._replace(shown=np.append(shown / shown.max(), 0.0))
