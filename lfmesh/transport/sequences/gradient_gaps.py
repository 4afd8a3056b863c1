"""Gaps of gradient-index glass for blocks of rays, and for callers from Python: optical paths, and curves to draw.

Each ray of a block crosses the gap singly, by `events.gradient`. What follows takes the block together again.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.frame import point_through
from lfmesh.geometry.lens.gradient_gap import follow_in_gap
from lfmesh.geometry.ray import Ray
from lfmesh.geometry.surfaces.surface import normal_at
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.gradient_path import advance
from lfmesh.transport.events.gradient import (
    AT_EDGE,
    ON_OTHER_FACE,
    REACHED,
    TRAPPED_INSIDE,
    cross_gap,
    gap_of,
    index_at,
    ray_in_gap,
)
from lfmesh.transport.packets.book import TRAPPED, TURNED_BACK
from lfmesh.transport.sequences.bundle import (
    AT_X,
    AT_Y,
    AT_Z,
    BLOCK,
    DROPPED,
    DX,
    DY,
    DZ,
    ENDED_ON,
    FATE,
    INDEX_BEFORE,
    INDEX_BEHIND,
    NX,
    NY,
    NZ,
    T,
    X,
    Y,
    Z,
)
from lfmesh.transport.tables.gradient_spaces import GradientSpaces
from lfmesh.transport.tables.tables import LensTables

Array = NDArray[np.float64]


@inlined
def follow_gap(bundle: Array, lens: LensTables, space: int, k: int, colour: int) -> None:
    """Replace the rays of a block in a gap by the straight rays that end as they do.

    Sets their lengths, and their fates: 0 for rays that reach the face, within its mount or not.

    Parameters
    ----------
    bundle : (ROWS · BLOCK,) float64
        Camera frame.
    lens : LensTables
    space : int
    k : int
        Number of the face aimed at.
    colour : int
        Wavelength number.
    """
    _follow_gap(lens.gradients, bundle, lens, space, k, colour)


@inlined
def _follow_gap(gradients: Any, bundle: Array, lens: LensTables, space: int, k: int, colour: int) -> None:
    """Follow rays as `follow_gap` does; `gradients` : GradientSpaces or None."""
    if gradients is None:
        return
    for i in range(BLOCK):
        bundle[T + i], bundle[FATE + i] = 0.0, DROPPED
        if bundle[ENDED_ON + i] != 0.0:
            continue
        end = cross_gap(
            lens, space, colour, k,
            Ray(bundle[X + i], bundle[Y + i], bundle[Z + i], bundle[DX + i], bundle[DY + i], bundle[DZ + i]),
        )  # fmt: skip
        bundle[X + i], bundle[Y + i], bundle[Z + i] = end.x, end.y, end.z
        bundle[DX + i], bundle[DY + i], bundle[DZ + i] = end.dx, end.dy, end.dz
        bundle[T + i], bundle[FATE + i] = end.distance, 0.0
        if end.fate == AT_EDGE:
            bundle[FATE + i] = lens.ring_slot[space] + 1.0
        elif end.fate == ON_OTHER_FACE:
            bundle[FATE + i] = TURNED_BACK + 1.0
        elif end.fate == TRAPPED_INSIDE:
            bundle[FATE + i] = TRAPPED + 1.0


@inlined
def arrive_from_gap(gradients: Any, bundle: Array, surface: Any, sense: float, mount: float) -> None:
    """Set points and normals of rays on the face that `follow_gap` took them to; end rays outside its clear aperture.

    Parameters
    ----------
    gradients : GradientSpaces or None
        None: numba skips this code.
    bundle : (ROWS · BLOCK,) float64
        Frame of the surface.
    surface : SURFACE record
    sense : float
        1 for rays that arrive along the surface's normal, −1 against it.
    mount : float
        Fate of rays between the clear aperture and the rim.
    """
    if gradients is None:
        return
    for i in range(BLOCK):
        t = bundle[T + i]
        x, y, z = bundle[X + i] + t * bundle[DX + i], bundle[Y + i] + t * bundle[DY + i], bundle[Z + i]
        z += t * bundle[DZ + i]
        bundle[AT_X + i], bundle[AT_Y + i], bundle[AT_Z + i] = x, y, z
        bundle[NX + i], bundle[NY + i], bundle[NZ + i] = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        if bundle[FATE + i] != 0.0:
            continue
        nx, ny, nz = normal_at(surface, x, y, z - surface.vertex_z)
        bundle[NX + i], bundle[NY + i], bundle[NZ + i] = sense * nx, sense * ny, sense * nz
        if not x * x + y * y <= surface.semi_diameter * surface.semi_diameter:
            bundle[FATE + i] = mount


@inlined
def set_local_indices(gradients: Any, bundle: Array, lens: LensTables, k: int, colour: int, into: int) -> None:
    """Set the indices on both sides of a face at each ray's intersection.

    Parameters
    ----------
    gradients : GradientSpaces or None
        None: numba skips this code.
    bundle : (ROWS · BLOCK,) float64
        Frame of the surface.
    lens : LensTables
    k : int
        Number of the face.
    colour : int
        Wavelength number.
    into : int
        1 for rays towards the sensor, 0 for others.
    """
    if gradients is None:
        return
    surface = lens.surfaces[k]
    for i in range(BLOCK):
        bundle[INDEX_BEFORE + i], bundle[INDEX_BEHIND + i] = 1.0, 1.0
        if bundle[ENDED_ON + i] != 0.0 or bundle[FATE + i] != 0.0:
            continue
        x, y, z = bundle[AT_X + i], bundle[AT_Y + i], bundle[AT_Z + i]
        if surface.posed:
            x, y, z = point_through(surface.pose, x, y, z)
        bundle[INDEX_BEFORE + i] = index_at(lens, k + 1 - into, colour, x, y, z)
        bundle[INDEX_BEHIND + i] = index_at(lens, k + into, colour, x, y, z)


def gap_paths(lens: LensTables, space: int, colour: int, position: Array, direction: Array) -> Array:
    """Return the optical paths of rays through a gap to the next face, (n,) mm; NaN for rays that do not reach it.

    Parameters
    ----------
    lens : LensTables
    space : int
        A space of gradient-index glass.
    colour : int
        Wavelength number.
    position, direction : (n, 3) float64
        Starts in the gap or on a face of it, mm, and unit directions, camera frame.
    """
    paths = np.empty(len(position))
    _fill_paths(lens.gradients, lens, space, colour, np.ascontiguousarray(position), np.ascontiguousarray(direction),
                paths)  # fmt: skip
    return paths


def gap_curves(
    lens: LensTables, space: int, k: int, colour: int, position: Array, direction: Array, points: int
) -> Array:
    """Return points along rays through a gap, from their starts to the walls where they end, (n, points, 3) mm.

    Parameters
    ----------
    lens : LensTables
    space : int
        A space of gradient-index glass.
    k : int
        Number of the face aimed at.
    colour : int
        Wavelength number.
    position, direction : (n, 3) float64
        As for `gap_paths`.
    points : int
        Number of points of each ray, 2 or more.
    """
    curves = np.empty((len(position), points, 3))
    _fill_curves(lens.gradients, lens.surfaces, space, colour, np.ascontiguousarray(position),
                 np.ascontiguousarray(direction), curves)  # fmt: skip
    return curves


@kernel
def _fill_paths(
    gradients: GradientSpaces, lens: LensTables, space: int, colour: int, p: Array, d: Array, paths: Array
) -> None:
    for i in range(len(paths)):
        ray = Ray(p[i, 0], p[i, 1], p[i, 2], d[i, 0], d[i, 1], d[i, 2])
        start = ray_in_gap(gradients, space, gradients.number[space] + colour, ray)
        end = cross_gap(lens, space, colour, space if start.tz > 0.0 else space - 1, ray)
        paths[i] = end.path if end.fate == REACHED else np.nan


@kernel
def _fill_curves(
    gradients: GradientSpaces, surfaces: NDArray[np.void], space: int, colour: int, p: Array, d: Array, curves: Array
) -> None:
    number, last = gradients.number[space] + colour, curves.shape[1] - 1
    longest, gap = gradients.longest[space, colour], gap_of(gradients, surfaces, space)
    for i in range(len(curves)):
        ray = ray_in_gap(
            gradients, space, number, Ray(p[i, 0], p[i, 1], p[i, 2], d[i, 0], d[i, 1], d[i, 2])
        )  # fmt: skip
        _, _, length = follow_in_gap(gradients.gradients, number, gap, ray, longest, gradients.steps[space, colour])
        part = length / last
        steps = max(int(np.ceil(part / longest)), 1)
        for j in range(last + 1):
            x, y, z = point_through(gradients.pose[space], ray.x, ray.y, ray.z)
            curves[i, j, 0], curves[i, j, 1], curves[i, j, 2] = x, y, z
            ray = advance(gradients.gradients, number, ray, part / steps, steps)
