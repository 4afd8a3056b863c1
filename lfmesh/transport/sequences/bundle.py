"""A block of rays that are followed together, laid out for vector instructions.

A bundle is one float64 array of `ROWS` rows of `BLOCK` values, at constant offsets, so that the compiler sees that rows
do not overlap. Loops run over the whole block; the places beyond the last ray hold rays that have ended. There are no
branches: a ray that ends keeps its point and its slot while the others continue.

At each face a module for its shape writes where the rays meet it, and `division` what goes on from there.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import kernel, pasted
from lfmesh.kernels.vector import both, select

Array = NDArray[np.float64]

BLOCK = 128

# Position and unit direction, mm; weight; power not followed; interfaces met; book slot + 1 of what ended the ray.
X, Y, Z, DX, DY, DZ = 0, BLOCK, 2 * BLOCK, 3 * BLOCK, 4 * BLOCK, 5 * BLOCK
WEIGHT, LEFT_BEHIND, MET, ENDED_ON = 6 * BLOCK, 7 * BLOCK, 8 * BLOCK, 9 * BLOCK
# The face: where the ray meets it, mm, the unit normal there along the ray, and the value that `ENDED_ON` takes if the
# ray goes no further than that; 0 where it meets the interface.
AT_X, AT_Y, AT_Z, NX, NY, NZ = 10 * BLOCK, 11 * BLOCK, 12 * BLOCK, 13 * BLOCK, 14 * BLOCK, 15 * BLOCK
FATE = 16 * BLOCK
# The interface: shares of the power, cosine of refraction, and the power that it absorbs. Of a coating's table: the
# piece, the distance from its middle, and the first of the rows of its coefficients.
REFLECTED, TRANSMITTED, COS_T, TAKEN = 17 * BLOCK, 18 * BLOCK, 19 * BLOCK, 20 * BLOCK
PIECE, WITHIN, COEFFICIENTS = 21 * BLOCK, 22 * BLOCK, 23 * BLOCK
# Distance at which a surface of the lens is met, mm; −1: nowhere. Distance at which the last one is met again.
T, AGAIN = 29 * BLOCK, 30 * BLOCK
# Factor by which thin lenses have changed importance since `begin_etendue`.
ETENDUE = 31 * BLOCK
SCRATCH = 32 * BLOCK
"""First of the rows that the modules for shapes use as working memory."""
# For diffraction: the key of the ray's packet, an integer in the memory of a float, and the events before the bundle;
# a change of direction that is drawn already, and after how many events it comes (−1: none is).
KEY, EVENTS_BEFORE = 40 * BLOCK, 41 * BLOCK
KICK_X, KICK_Y, KICK_AT = 42 * BLOCK, 43 * BLOCK, 44 * BLOCK
ROWS = 45

DROPPED = -1.0
"""In place of slot + 1: the ray has left the path that is followed, and all its power was left behind."""

BESIDE = -2.0
"""In place of slot + 1: the ray passes beside the lens."""


def empty_bundle(rows: int = ROWS) -> Array:
    """Return memory for a block of rays, aligned to cache lines.

    Parameters
    ----------
    rows : int
        More than `ROWS` where a module keeps rows of its own.
    """
    room = np.zeros(rows * BLOCK + 8)
    offset = (-room.ctypes.data // 8) % 8
    return room[offset : offset + rows * BLOCK]


@pasted
def load(bundle: Array, i: int, x: float, y: float, z: float, dx: float, dy: float, dz: float, weight: float) -> None:
    """Write ray `i` at its start, with its weight.

    Parameters
    ----------
    bundle : (ROWS · BLOCK,) float64
    i : int
        Place in the block.
    x, y, z : float, mm
    dx, dy, dz : float
        Unit direction.
    weight : float
    """
    bundle[X + i], bundle[Y + i], bundle[Z + i] = x, y, z
    bundle[DX + i], bundle[DY + i], bundle[DZ + i] = dx, dy, dz
    bundle[WEIGHT + i], bundle[LEFT_BEHIND + i], bundle[MET + i], bundle[ENDED_ON + i] = weight, 0.0, 0.0, 0.0


@kernel
def pad(bundle: Array, count: int) -> None:
    """Fill the places from `count` on with rays that have ended."""
    for i in range(count, BLOCK):
        load(bundle, i, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0)
        bundle[ENDED_ON + i] = DROPPED


@kernel
def move_bundle(bundle: Array, move: Array) -> None:
    """Transform a bundle into another frame by a rigid move, (3, 4): rotation and shift."""
    xx, xy, xz, x0 = move[0, 0], move[0, 1], move[0, 2], move[0, 3]
    yx, yy, yz, y0 = move[1, 0], move[1, 1], move[1, 2], move[1, 3]
    zx, zy, zz, z0 = move[2, 0], move[2, 1], move[2, 2], move[2, 3]
    for i in range(BLOCK):
        x, y, z = bundle[X + i], bundle[Y + i], bundle[Z + i]
        bundle[X + i] = xx * x + xy * y + xz * z + x0
        bundle[Y + i] = yx * x + yy * y + yz * z + y0
        bundle[Z + i] = zx * x + zy * y + zz * z + z0
        x, y, z = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        bundle[DX + i] = xx * x + xy * y + xz * z
        bundle[DY + i] = yx * x + yy * y + yz * z
        bundle[DZ + i] = zx * x + zy * y + zz * z


@kernel
def normalise(bundle: Array) -> None:
    """Normalise the directions, whose length every interface changes by a rounding error."""
    for i in range(BLOCK):
        dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        scale = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
        bundle[DX + i], bundle[DY + i], bundle[DZ + i] = dx * scale, dy * scale, dz * scale


@pasted
def set_fate(bundle: Array, i: int, t: float, fate: float) -> None:
    """Enter that a ray ends after a distance; with fate 0, that it meets the interface there.

    Parameters
    ----------
    bundle : (ROWS · BLOCK,) float64
    i : int
        Place in the block.
    t : float, mm
    fate : float
    """
    bundle[AT_X + i] = bundle[X + i] + t * bundle[DX + i]
    bundle[AT_Y + i] = bundle[Y + i] + t * bundle[DY + i]
    bundle[AT_Z + i] = bundle[Z + i] + t * bundle[DZ + i]
    bundle[FATE + i] = fate


@pasted
def set_normal(bundle: Array, i: int, nx: float, ny: float, nz: float) -> None:
    """Enter the unit normal, along the ray, where a ray meets its face.

    Parameters
    ----------
    bundle : (ROWS · BLOCK,) float64
    i : int
        Place in the block.
    nx, ny, nz : float
    """
    bundle[NX + i], bundle[NY + i], bundle[NZ + i] = nx, ny, nz


@kernel
def drop(bundle: Array, i: int) -> None:
    """End a ray that leaves the path which is followed.

    Parameters
    ----------
    bundle : (ROWS · BLOCK,) float64
    i : int
        Place in the block.
    """
    bundle[ENDED_ON + i] = DROPPED
    bundle[LEFT_BEHIND + i] += bundle[WEIGHT + i]


@kernel
def absorb(bundle: Array, absorption: Any, medium: int, colour: int, book: Array) -> None:
    """Take from rays what a medium absorbs before the face that they meet next.

    Parameters
    ----------
    bundle : (ROWS · BLOCK,) float64
    absorption : Absorption or None
    medium, colour : int
        Numbers of the medium and of the wavelength.
    book : (slots,) float64
    """
    if absorption is None:
        return
    coefficient = absorption.per_mm[medium, colour]
    if not coefficient > 0.0:
        return
    absorbed = 0.0
    for i in range(BLOCK):
        x, y, z = bundle[AT_X + i] - bundle[X + i], bundle[AT_Y + i] - bundle[Y + i], bundle[AT_Z + i] - bundle[Z + i]
        share = np.exp(-coefficient * np.sqrt(x * x + y * y + z * z))
        weight = bundle[WEIGHT + i]
        left = select(bundle[ENDED_ON + i] == 0.0, weight * share, weight)
        absorbed += weight - left
        bundle[WEIGHT + i] = left
    book[absorption.slot[medium]] += absorbed


@kernel
def end_by_fate(bundle: Array) -> None:
    """End the rays whose fate is not 0, where they meet the face; the others stay where they are."""
    for i in range(BLOCK):
        ended, fate = bundle[ENDED_ON + i], bundle[FATE + i]
        ends = both(ended == 0.0, fate != 0.0)
        bundle[X + i] = select(ends, bundle[AT_X + i], bundle[X + i])
        bundle[Y + i] = select(ends, bundle[AT_Y + i], bundle[Y + i])
        bundle[Z + i] = select(ends, bundle[AT_Z + i], bundle[Z + i])
        bundle[LEFT_BEHIND + i] += select(both(ends, fate == DROPPED), bundle[WEIGHT + i], 0.0)
        bundle[ENDED_ON + i] = select(ends, fate, ended)
