"""Many rays along a sequence of the two faces of the array, refracted at some and reflected at others.

Faces are counted from the lens to the sensor. A ray leaves the sequence where it meets two lenslets of a face in turn,
or where it is reflected so steeply that it does not turn back; then it passes with weight 0.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.events.crossing import reflected
from lfmesh.transport.events.interface import shares
from lfmesh.transport.packets.packet import BACK_FRAME, CAMERA_FRAME, MLA_FRAME
from lfmesh.transport.sequential.image_path import (
    begin_array,
    bend,
    leave_layer,
    meet_curved_face,
    meet_flat_face,
    move_ray,
)
from lfmesh.transport.sequential.lens_bundle import (
    BLOCK,
    DROPPED,
    DX,
    DY,
    DZ,
    ENDED_ON,
    LEFT_BEHIND,
    MET,
    WEIGHT,
    empty_bundle,
    move_bundle,
    normalise,
)
from lfmesh.transport.sequential.lenslet_bundle import PASSED
from lfmesh.transport.sequential.reflections import Array, Arrived, book_for, drop_backward, load_rays, store
from lfmesh.transport.tables.tables import FLAT_ROW, MlaTables


def follow_array_faces(
    rays: Arrived, mla: MlaTables, frames: Array, faces: tuple[int, ...], mirrors: tuple[bool, ...], colour: int = 0
) -> None:
    """Take rays (camera frame) along a sequence of the faces of the array.

    Parameters
    ----------
    rays : Arrived
        Changed in place.
    mla : MlaTables
    frames : (6, 6, 3, 4) float64
    faces : tuple of int
        0 is the face towards the lens, 1 the one towards the sensor.
    mirrors : tuple of bool
        Whether the rays are reflected at each of them; else they are refracted.
    colour : int
        Number of the wavelength.
    """
    _follow(
        rays, mla, frames, np.array(faces, np.int64), np.array(mirrors, np.bool_), colour, empty_bundle(),
        book_for(mla.media),
    )  # fmt: skip


@kernel
def _follow(
    rays: Arrived, mla: MlaTables, frames: Array, faces: NDArray[np.int64], reflected: NDArray[np.bool_],
    colour: int, bundle: Array, book: Array,
) -> None:  # fmt: skip
    for first in range(0, len(rays.weight), BLOCK):
        count = load_rays(bundle, rays, first)
        drop_backward(bundle, faces[0] == 0)
        along_array(bundle, count, mla, faces, reflected, colour, frames, faces[0] == 0, book)
        normalise(bundle)
        store(bundle, rays, first, count)


@kernel
def along_array(
    bundle: Array, count: int, mla: MlaTables, faces: NDArray[np.int64], reflected: NDArray[np.bool_], colour: int,
    frames: Array, to_sensor: bool, book: Array,
) -> None:  # fmt: skip
    """Take a bundle (camera frame) along a sequence of faces of the array.

    Parameters
    ----------
    bundle : (ROWS · BLOCK,) float64
    count : int
        Number of rays in it.
    mla : MlaTables
    faces : (n,) int64
        The faces, in the order in which they are met.
    reflected : (n,) bool
        Whether the rays are reflected at each of them.
    colour : int
        Number of the wavelength.
    frames : (6, 6, 3, 4) float64
    to_sensor : bool
        Direction of travel at the start.
    book : (slots,) float64
        For light that the array absorbs.
    """
    move_bundle(bundle, frames[CAMERA_FRAME, MLA_FRAME])
    inward, curved_face = to_sensor == mla.curved_to_lens, 0 if mla.curved_to_lens else 1
    turns = False
    for step in range(len(faces)):
        turns = turns or reflected[step]
    begin_array(bundle, count, mla, colour, inward, frames, not turns)
    for i in range(count):
        if bundle[ENDED_ON + i] != 0.0 or bundle[PASSED + i] > 0.0:
            continue
        goes_on = (bundle[DZ + i] > 0.0) == inward
        for step in range(len(faces)):
            if not goes_on:
                break
            if faces[step] == curved_face:
                goes_on = _at_curved_face(bundle, i, mla, reflected[step], colour, book)
            else:
                goes_on = _at_other_face(mla.back, bundle, i, mla, reflected[step], colour, frames, book)
        if not goes_on and bundle[ENDED_ON + i] == 0.0:
            bundle[LEFT_BEHIND + i] += bundle[WEIGHT + i]
            bundle[ENDED_ON + i] = DROPPED
    move_bundle(bundle, frames[MLA_FRAME, CAMERA_FRAME])


@inlined
def _at_other_face(
    back: Any, bundle: Array, i: int, mla: MlaTables, mirrors: bool, colour: int, frames: Array, book: Array
) -> bool:  # fmt: skip
    """Reflect or refract a ray at the flat face, or at the lenslets in its place; `back` is that of `mla`."""
    if back is None:
        along = 1.0 if bundle[DZ + i] > 0.0 else -1.0
        if not meet_flat_face(bundle, i, mla, colour, book):
            return False
        return _turn(bundle, i, mla, FLAT_ROW, mirrors, colour, along < 0.0, 0.0, 0.0, along)
    move_ray(bundle, i, frames[MLA_FRAME, BACK_FRAME])
    goes_on = _at_curved_face(bundle, i, back, mirrors, colour, book)
    move_ray(bundle, i, frames[BACK_FRAME, MLA_FRAME])
    return goes_on


@kernel
def _at_curved_face(bundle: Array, i: int, mla: MlaTables, mirrors: bool, colour: int, book: Array) -> bool:
    """Reflect or refract a ray at the lenslet that it meets, and follow it out of the layer of faces."""
    inward = bundle[DZ + i] > 0.0
    met, column, row, nx, ny, nz = meet_curved_face(bundle, i, mla, colour, book)
    if not met or not _turn(bundle, i, mla, mla.row, mirrors, colour, inward, nx, ny, nz):
        return False
    return leave_layer(bundle, i, mla, inward == mirrors, column, row, colour, book)


@kernel
def _turn(
    bundle: Array, i: int, mla: MlaTables, face: int, mirrors: bool, colour: int, entering: bool,
    nx: float, ny: float, nz: float,
) -> bool:  # fmt: skip
    """Reflect or refract a ray at a face whose normal points along it; tell whether it goes where the sequence goes."""
    dz = bundle[DZ + i]
    if not mirrors:
        return bend(bundle, i, mla, face, colour, entering, nx, ny, nz) and dz * bundle[DZ + i] > 0.0
    glass = mla.media.indices[mla.medium, colour]
    n_i, n_t = (1.0, glass) if entering else (glass, 1.0)
    cos_i = min(nx * bundle[DX + i] + ny * bundle[DY + i] + nz * dz, 1.0)
    bundle[MET + i] += 1.0
    bundle[WEIGHT + i] *= shares(mla.interfaces, face, colour, n_i, n_t, cos_i)[0]
    bundle[DX + i], bundle[DY + i], bundle[DZ + i] = reflected(
        bundle[DX + i], bundle[DY + i], dz, nx, ny, nz
    )  # fmt: skip
    return dz * bundle[DZ + i] < 0.0
