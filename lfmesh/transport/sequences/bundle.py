"""Bundle: a block of rays followed together, laid out for vector instructions.

A bundle is one float64 array of `ROWS` rows of `BLOCK` values at constant offsets, which tells the compiler that rows
do not overlap. Loops run over the whole block; places beyond the last ray hold rays that have ended. There are no
branches: an ended ray keeps its point and its slot while the others continue.

At each face, the module for its shape writes the intersections, and `division` the rays that continue.
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
# The face: intersection point, mm, unit normal there along the ray, and the value that `ENDED_ON` takes if the ray
# ends there; 0 if it meets the interface.
AT_X, AT_Y, AT_Z, NX, NY, NZ = 10 * BLOCK, 11 * BLOCK, 12 * BLOCK, 13 * BLOCK, 14 * BLOCK, 15 * BLOCK
FATE = 16 * BLOCK
# The interface: reflected and transmitted fractions of the power, cosine of refraction, absorbed power. Coating table:
# piece, distance from its middle, and first row of its coefficients.
REFLECTED, TRANSMITTED, COS_T, TAKEN = 17 * BLOCK, 18 * BLOCK, 19 * BLOCK, 20 * BLOCK
PIECE, WITHIN, COEFFICIENTS = 21 * BLOCK, 22 * BLOCK, 23 * BLOCK
# Distance to a lens surface, mm; −1: missed. Distance to the second hit on the surface just left.
T, AGAIN = 29 * BLOCK, 30 * BLOCK
# Factor of thin lenses on importance since `begin_etendue`.
ETENDUE = 31 * BLOCK
SCRATCH = 32 * BLOCK
"""First working row of the modules for shapes."""
# For diffraction: key of the ray's packet (an integer in the memory of a float) and its events before the bundle; a
# deflection drawn in advance, and the number of events before it (−1: none drawn).
KEY, EVENTS_BEFORE = 40 * BLOCK, 41 * BLOCK
KICK_X, KICK_Y, KICK_AT = 42 * BLOCK, 43 * BLOCK, 44 * BLOCK
# At a face with a phase: the intersection point, mm, in the frame of the phase.
PHASE_X, PHASE_Y = 45 * BLOCK, 46 * BLOCK
# At a face of gradient-index glass: the refractive indices on both sides of the intersection.
INDEX_BEFORE, INDEX_BEHIND = 47 * BLOCK, 48 * BLOCK
ROWS = 49

DROPPED = -1.0
"""In place of slot + 1: the ray has left its path, and all its power was left behind."""

BESIDE = -2.0
"""In place of slot + 1: the ray passes beside the lens."""


def empty_bundle(rows: int = ROWS) -> Array:
    """Return memory for a block of rays, aligned to cache lines.

    Parameters
    ----------
    rows : int
        More than `ROWS` for a module with rows of its own.
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
    """Transform a bundle into another frame by a rigid motion, (3, 4)."""
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
    """Normalise the directions, which every interface changes by a rounding error."""
    for i in range(BLOCK):
        dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        scale = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
        bundle[DX + i], bundle[DY + i], bundle[DZ + i] = dx * scale, dy * scale, dz * scale


@pasted
def set_fate(bundle: Array, i: int, t: float, fate: float) -> None:
    """Set a ray's fate, and its point at a distance; fate 0: it meets the interface.

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
    """Set the unit normal, along the ray, at its intersection.

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
    """End a ray that leaves its path.

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
    """Attenuate rays by the absorption of a medium up to the next face.

    Parameters
    ----------
    bundle : (ROWS · BLOCK,) float64
    absorption : Absorption or None
    medium, colour : int
        Medium and wavelength numbers.
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
    """End the rays with a fate other than 0 at their points on the face."""
    for i in range(BLOCK):
        ended, fate = bundle[ENDED_ON + i], bundle[FATE + i]
        ends = both(ended == 0.0, fate != 0.0)
        bundle[X + i] = select(ends, bundle[AT_X + i], bundle[X + i])
        bundle[Y + i] = select(ends, bundle[AT_Y + i], bundle[Y + i])
        bundle[Z + i] = select(ends, bundle[AT_Z + i], bundle[Z + i])
        bundle[LEFT_BEHIND + i] += select(both(ends, fate == DROPPED), bundle[WEIGHT + i], 0.0)
        bundle[ENDED_ON + i] = select(ends, fate, ended)
