"""Aims fitted to rays from the stop: moved and widened openings, wider views and cells."""

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.frame import directions, points
from lfmesh.kernels.decorators import kernel
from lfmesh.transport.aims.disks import disk_at, wide_open
from lfmesh.transport.aims.lenslet_view import RINGS, by_rings, fitted_views, unmeasured_light, with_wider_cells
from lfmesh.transport.aims.support import seen_from_cells
from lfmesh.transport.packets.packet import CAMERA_FRAME, SENSOR_FRAME
from lfmesh.transport.sequences.stop_rays import CameraTables, Rays, rays_from_stop, reach_of
from lfmesh.transport.tables.tables import (
    AimTables,
    Disks,
    Opening,
)

ALLOWED = 1e-4
"""Share of the throughput that the aim may miss."""

Array = NDArray[np.float64]

MARGIN = 1.02
"""Factor by which a fitted aim exceeds the need of the rays."""


def shown_by(off: Array, throughput: Array) -> Array:
    """Return the root mean square light in each ring of a lenslet's view, (RINGS + 1,); see `LensletAim.shown`.

    A ring counts as no darker than the rings outside it, so that sparse rays do not make it dark.

    Parameters
    ----------
    off : (n,) float64
        Distance of rays from the centres of views, in radii of the views.
    throughput : (n,) float64
    """
    light, _ = np.histogram(off * off, RINGS, (0.0, 1.0), weights=throughput)
    brightest = light.max()
    if not brightest > 0.0:
        return unmeasured_light()
    light = np.maximum.accumulate(light[::-1])[::-1]
    # A direction either leads through the opening or does not, so its mean square is its mean.
    return by_rings(np.sqrt(light))


def decentred(entrance: Opening, exit_: Opening, through: CameraTables) -> tuple[Opening, Opening]:
    """Return both sides' openings, moved to where posed lens elements pass light.

    Rays from the stop give the mean move: a shift, and its change with the distance of the point.

    Parameters
    ----------
    entrance, exit_ : Opening
        Openings of the lens as prescribed.
    through : CameraTables
        With poses.
    """
    random = np.random.default_rng(0x905E)
    bare = through._replace(mla=through.mla._replace(present=False))
    reach = reach_of(bare, random)
    if reach is None:
        return entrance, exit_
    rays = rays_from_stop(bare, reach, random)
    to_camera = through.frames[SENSOR_FRAME, CAMERA_FRAME]
    landing = np.column_stack([rays.sensor[:, :2], np.zeros(len(rays.sensor))])
    behind = points(to_camera, landing), -directions(to_camera, rays.sensor[:, 2:])
    before = rays.objects[:, :3], rays.objects[:, 3:]
    entrance = entrance._replace(near=_moved_to_rays(entrance, *before, rays.throughput, random, near=True))
    return (
        entrance._replace(far=_moved_to_rays(entrance, *before, rays.throughput, random)),
        exit_._replace(far=_moved_to_rays(exit_, *behind, rays.throughput, random)),
    )


def _moved_to_rays(
    opening: Opening, p: Array, d: Array, throughput: Array, random: np.random.Generator, *, near: bool = False
) -> Disks:
    """Return an opening's table with centres moved by the mean offset of the rays.

    Parameters
    ----------
    opening : Opening
    p, d : (n, 3) float64
        Points, mm, and directions of the rays, camera frame.
    throughput : (n,) float64
    near : bool
        The table of near points.
    """
    disks = opening.near if near else opening.far
    if not (disks.radius > 0.0).any() or not len(throughput):
        return disks
    rows = len(disks.radius) - 1 if disks.row_step != 1.0 else 0
    row = rows * random.random(len(p))
    along = disks.first + row * disks.row_step
    z = opening.plane_z - opening.sense * (along if near else 1.0 / along)
    seen_from = p + ((z - p[:, 2]) / d[:, 2])[:, None] * d
    across = np.hypot(seen_from[:, 0], seen_from[:, 1]) * (1.0 if near else along)
    disks = _open_out_to(disks, int(across.max() / disks.column_step) + 2)
    off = np.full((len(p), 2), np.nan)
    crossing = p + ((opening.plane_z - p[:, 2]) / d[:, 2])[:, None] * d
    _off_centre(disks, seen_from, across, along, crossing, off)
    known = np.isfinite(off[:, 0])
    if not known.any():
        return disks
    weight = np.sqrt(throughput[known])[:, None]
    terms = np.column_stack([np.ones(known.sum()), row[known]])[:, : 2 if rows else 1]
    # Disks that vanish towards the plane stay in place there.
    first = 1 if disks.first == 0.0 and not (disks.radius[0] > 0.0).any() else 0
    shift = np.zeros((2, 2))
    shift[first : terms.shape[1]] = np.linalg.lstsq(weight * terms[:, first:], weight * off[known], rcond=None)[0]
    return disks._replace(decentre=shift)


def _open_out_to(disks: Disks, columns: int) -> Disks:
    """Return a table open in at least `columns` columns, as poses may pass more light.

    In added columns, centres are extrapolated linearly, and radii stay.
    """
    width = int(np.flatnonzero((disks.radius >= 0.0).any(axis=0)).max(initial=-1))
    if not 0 < width < columns:
        return disks
    middle, radius = disks.middle[:, : width + 1], disks.radius[:, : width + 1]
    further = np.arange(1, columns - width + 1)
    middle = np.hstack([middle, middle[:, -1:] + further * (middle[:, -1:] - middle[:, -2:-1])])
    radius = np.hstack([radius, np.repeat(radius.max(axis=1, keepdims=True), columns - width, axis=1)])
    return disks._replace(middle=np.ascontiguousarray(middle), radius=np.ascontiguousarray(radius))


@kernel
def _off_centre(disks: Disks, p: Array, across: Array, along: Array, crossing: Array, off: Array) -> None:
    """Write each ray's offset in the opening's plane from the disk centre seen from its point, (n, 2) mm."""
    for i in range(len(off)):
        cx, cy, radius = disk_at(disks, p[i, 0], p[i, 1], across[i], along[i])
        if radius > 0.0:
            off[i, 0], off[i, 1] = crossing[i, 0] - cx, crossing[i, 1] - cy


def fitted(aim: AimTables, through: CameraTables, rays: Rays) -> AimTables:
    """Return the aim with views and cell margins as wide as the rays need.

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
    """Return the value exceeded by a negligible share of the throughput, ignoring infinite values."""
    known = np.isfinite(values)
    order = np.argsort(values[known])[::-1]
    above = np.cumsum(throughput[known][order])
    first = int(np.searchsorted(above, 0.25 * ALLOWED * throughput.sum()))
    return float(values[known][order][min(first, len(order) - 1)]) if len(order) else 1.0


def widened(disks: Disks, beyond: Array, throughput: Array, wide_radius: float) -> Disks:
    """Return a table widened to hold rays outside it; wide open if too much light meets closed nodes.

    Parameters
    ----------
    disks : Disks
    beyond : (n,) float64
        Distance of each ray from the centre, in radii; inf where the table is closed.
    throughput : (n,) float64
    wide_radius : float, mm
        Radius of the disk that every ray to the lens crosses.
    """
    if throughput[np.isinf(beyond)].sum() > 0.5 * ALLOWED * throughput.sum():
        return wide_open(disks, wide_radius)
    by = max(1.0, MARGIN * _above(beyond, throughput))
    return disks._replace(radius=np.where(disks.radius > 0.0, by * disks.radius, disks.radius))
