"""Aims fitted to rays from the stop: openings moved and widened, views and cells as wide as the light needs."""

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.frame import directions, points
from lfmesh.kernels.decorators import kernel
from lfmesh.transport.aims.lenslet_view import RINGS, by_rings, fitted_views, unmeasured_light, with_wider_cells
from lfmesh.transport.aims.near_points import near_disk, wide_open
from lfmesh.transport.aims.pupil import opening_from, unknown_like
from lfmesh.transport.aims.support import seen_from_cells
from lfmesh.transport.packets.packet import CAMERA_FRAME, SENSOR_FRAME
from lfmesh.transport.sequences.stop_rays import CameraTables, Rays, rays_from_stop, reach_of
from lfmesh.transport.tables.tables import (
    AimTables,
    NearOpening,
    Opening,
)

ALLOWED = 1e-4
"""Share of the throughput that the aim may miss."""

Array = NDArray[np.float64]

MARGIN = 1.02
"""Factor by which a fitted aim is wider than the rays need."""


def shown_by(off: Array, throughput: Array) -> Array:
    """Return the root mean square of the light in each ring of a lenslet's view, (RINGS + 1,); see `LensletAim.shown`.

    A ring counts as no darker than those further out, so that none is dark because few rays met it by chance.

    Parameters
    ----------
    off : (n,) float64
        Distance of rays from the centres of views, relative to the views' radius.
    throughput : (n,) float64
    """
    light, _ = np.histogram(off * off, RINGS, (0.0, 1.0), weights=throughput)
    brightest = light.max()
    if not brightest > 0.0:
        return unmeasured_light()
    light = np.maximum.accumulate(light[::-1])[::-1]
    # A direction leads through the opening or not, so its mean square is its mean.
    return by_rings(np.sqrt(light))


def decentred(entrance: Opening, exit_: Opening, through: CameraTables) -> tuple[Opening, Opening]:
    """Return the openings of both sides, moved to where poses of lens elements let the light through.

    Rays from the stop say by how much, on average: a shift, and how it changes with the distance of the point.

    Parameters
    ----------
    entrance, exit_ : Opening
        Of the lens as prescribed.
    through : CameraTables
        With poses.
    """
    random = np.random.default_rng(0x905E)
    bare = through._replace(mla=through.mla._replace(present=False))
    reach = reach_of(bare, random)
    if reach == 0.0:
        return entrance, exit_
    rays = rays_from_stop(bare, reach, random)
    to_camera = through.frames[SENSOR_FRAME, CAMERA_FRAME]
    landing = np.column_stack([rays.sensor[:, :2], np.zeros(len(rays.sensor))])
    behind = points(to_camera, landing), -directions(to_camera, rays.sensor[:, 2:])
    before = rays.objects[:, :3], rays.objects[:, 3:]
    entrance = entrance._replace(near=_near_moved_to_rays(entrance, *before, rays.throughput, random))
    return (
        _moved_to_rays(entrance, *before, rays.throughput, random),
        _moved_to_rays(exit_, *behind, rays.throughput, random),
    )


def _moved_to_rays(opening: Opening, p: Array, d: Array, throughput: Array, random: np.random.Generator) -> Opening:
    """Return an opening whose centres are moved by the mean distance of rays from them.

    Parameters
    ----------
    opening : Opening
    p, d : (n, 3) float64
        Points, mm, and directions of the rays, camera frame.
    throughput : (n,) float64
    """
    if not opening.known or not len(throughput):
        return opening
    rows = len(opening.radius) if opening.nearness_step != 1.0 else 0
    row = rows * random.random(len(p))
    z = opening.plane_z - opening.sense / (opening.nearness + row * opening.nearness_step)
    seen_from = p + ((z - p[:, 2]) / d[:, 2])[:, None] * d
    tangent = np.hypot(seen_from[:, 0], seen_from[:, 1]) * (opening.nearness + row * opening.nearness_step)
    opening = _open_out_to(opening, int(tangent.max() / opening.tangent_step) + 2)
    off = np.full((len(p), 2), np.nan)
    _off_centre(seen_from, d, opening, off)
    known = np.isfinite(off[:, 0])
    if not known.any():
        return opening
    weight = np.sqrt(throughput[known])[:, None]
    terms = np.column_stack([np.ones(known.sum()), row[known]])[:, : 2 if rows else 1]
    shift = np.zeros((2, 2))
    shift[: terms.shape[1]] = np.linalg.lstsq(weight * terms, weight * off[known], rcond=None)[0]
    return opening._replace(decentre=shift)


def _near_moved_to_rays(
    opening: Opening, p: Array, d: Array, throughput: Array, random: np.random.Generator
) -> NearOpening:
    """Return the table of near points of an opening, moved likewise; parameters as for `_moved_to_rays`."""
    near = opening.near
    rows = len(near.radius) - 1
    if not opening.known or not near.depth > 0.0 or not (near.radius > 0.0).any() or not len(throughput):
        return near
    row = rows * random.random(len(p))
    distance = near.distance + row * near.distance_step
    t = (opening.plane_z - distance - p[:, 2]) / d[:, 2]
    seen_from = p + t[:, None] * d
    height = np.hypot(seen_from[:, 0], seen_from[:, 1])
    near = _near_open_out_to(near, int(height.max() / near.height_step) + 2)
    off = np.full((len(p), 2), np.nan)
    _off_near_centre(seen_from, d, near, distance, off)
    known = np.isfinite(off[:, 0])
    if not known.any():
        return near
    weight = np.sqrt(throughput[known])[:, None]
    terms = np.column_stack([np.ones(known.sum()), row[known]])
    # Disks that vanish towards the plane do not move there.
    first = 1 if near.distance == 0.0 and not (near.radius[0] > 0.0).any() else 0
    shift = np.zeros((2, 2))
    shift[first:] = np.linalg.lstsq(weight * terms[:, first:], weight * off[known], rcond=None)[0]
    return near._replace(decentre=shift)


def _near_open_out_to(near: NearOpening, columns: int) -> NearOpening:
    """Return a table of near points that is open at so many heights at least, as `_open_out_to` does."""
    width = int(np.flatnonzero((near.radius >= 0.0).any(axis=0)).max(initial=-1))
    if not 0 < width < columns:
        return near
    middle, radius = near.middle[:, : width + 1], near.radius[:, : width + 1]
    further = np.arange(1, columns - width + 1)
    middle = np.hstack([middle, middle[:, -1:] + further * (middle[:, -1:] - middle[:, -2:-1])])
    radius = np.hstack([radius, np.repeat(radius.max(axis=1, keepdims=True), columns - width, axis=1)])
    return near._replace(middle=np.ascontiguousarray(middle), radius=np.ascontiguousarray(radius))


@kernel
def _off_near_centre(p: Array, d: Array, near: NearOpening, distance: Array, off: Array) -> None:
    """Write what `_off_centre` does, of near points at a distance."""
    for i in range(len(off)):
        cx, cy, radius = near_disk(near, p[i, 0], p[i, 1], distance[i])
        if radius > 0.0:
            over = distance[i] / abs(d[i, 2])
            off[i, 0], off[i, 1] = p[i, 0] + over * d[i, 0] - cx, p[i, 1] + over * d[i, 1] - cy


def _open_out_to(opening: Opening, columns: int) -> Opening:
    """Return an opening that is open at so many field angles at least, as poses may let light through beyond.

    Beyond those at which the lens as prescribed is open, centres go on evenly, and radii stay.
    """
    width = int(np.flatnonzero((opening.radius > 0.0).any(axis=0)).max(initial=-1)) + 1
    if not 0 < width < columns:
        return opening
    middle, radius = opening.middle[:, : width + 1], opening.radius[:, :width]
    further = np.arange(1, columns - width + 1)
    middle = np.hstack([middle, middle[:, -1:] + further * (middle[:, -1:] - middle[:, -2:-1])])
    radius = np.hstack([radius, np.repeat(radius.max(axis=1, keepdims=True), columns - width, axis=1)])
    return opening._replace(middle=np.ascontiguousarray(middle), radius=np.ascontiguousarray(radius))


@kernel
def _off_centre(p: Array, d: Array, opening: Opening, off: Array) -> None:
    """Write how far each ray crosses the opening's plane from the centre of the disk seen from its point, (n, 2) mm."""
    for i in range(len(off)):
        cx, cy, radius = opening_from(opening, (p[i, 0], p[i, 1], p[i, 2]))
        if radius > 0.0:
            t = (opening.plane_z - p[i, 2]) / d[i, 2]
            off[i, 0], off[i, 1] = p[i, 0] + t * d[i, 0] - cx, p[i, 1] + t * d[i, 1] - cy


def fitted(aim: AimTables, through: CameraTables, rays: Rays) -> AimTables:
    """Return the aim with the lenslets' views and cell margins as wide as the rays need.

    Parameters
    ----------
    aim : AimTables
    through : CameraTables
    rays : Rays
    """
    mla, weight = through.mla, rays.throughput
    off, radius, out = seen_from_cells(aim, through, rays)
    seen = radius > 0.0
    needed, furthest = MARGIN * _above((off / radius)[seen], weight[seen]), MARGIN * _above(off[seen], weight[seen])
    closed = weight[~seen].sum() > 0.25 * ALLOWED * weight.sum()
    opened = MARGIN * _above(off[~seen], weight[~seen]) if closed else 0.0
    lenslets = fitted_views(aim.lenslets, mla, through.frames, through.sensor, needed, furthest, opened)
    return aim._replace(lenslets=with_wider_cells(lenslets, mla, max(1.0, MARGIN * _above(out, weight))))


def _above(values: Array, throughput: Array) -> float:
    """Return the value above which a negligible share of the throughput lies; infinite values are left out."""
    known = np.isfinite(values)
    order = np.argsort(values[known])[::-1]
    above = np.cumsum(throughput[known][order])
    first = int(np.searchsorted(above, 0.25 * ALLOWED * throughput.sum()))
    return float(values[known][order][min(first, len(order) - 1)]) if len(order) else 1.0


def widened(opening: Opening, beyond: Array, throughput: Array) -> Opening:
    """Return an opening widened to hold rays outside it; not known if too much light goes where it is closed.

    Parameters
    ----------
    opening : Opening
    beyond : (n,) float64
        Distance of each ray from the centre, in radii; inf where the opening is closed.
    throughput : (n,) float64
    """
    if throughput[np.isinf(beyond)].sum() > 0.5 * ALLOWED * throughput.sum():
        return unknown_like(opening)
    by = max(1.0, MARGIN * _above(beyond, throughput))
    return opening._replace(radius=np.where(opening.radius > 0.0, by * opening.radius, opening.radius))


def widened_near(opening: Opening, beyond: Array, throughput: Array, wide_radius: float) -> Opening:
    """Return an opening whose table of near points is widened likewise; if too much is closed, they see a wide disk.

    Parameters
    ----------
    opening, beyond, throughput
        As for `widened`.
    wide_radius : float, mm
    """
    near = opening.near
    if not opening.known or not (beyond > 1.0).any():
        return opening
    if throughput[np.isinf(beyond)].sum() > 0.5 * ALLOWED * throughput.sum():
        return opening._replace(near=wide_open(near, wide_radius))
    by = max(1.0, MARGIN * _above(beyond, throughput))
    return opening._replace(near=near._replace(radius=np.where(near.radius > 0.0, by * near.radius, near.radius)))
