"""State of polarisation of packets: at interfaces, targets, lights and the polariser in front of the sensor.

A packet's `stokes` are Q, U and V over I, and its weight is I. They refer to the packet's direction of travel, by the
conventions of `optics.polarisation`, with a reference direction in the world frame: the array's own frame may be
mirrored, which turns right-handed light into left-handed.

In the adjoint method light travels against the packet. Weight and `stokes` then describe the reversed light with the
strongest response of the pixel: light with (I, Q, U, V), given for its own direction and the same reference direction,
adds weight · (I + q Q − u U + v V) to the pixel. Interfaces and the polariser act on both in the same way, see
`optics.polarisation`. Targets depolarise scattered and emitted light, so at a target only a packet's weight counts.

Functions shared with unpolarised light begin with ``polarised is None``; numba then compiles nothing else of them.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.geometry.frame import move_direction
from lfmesh.kernels.decorators import inlined
from lfmesh.optics.polarisation import after, bare_interface, coated_interface, turned
from lfmesh.transport.packets.packet import SENSOR_FRAME, WORLD_FRAME
from lfmesh.transport.tables.polarisation import IN_ARRAY, IN_LENS, IN_OBJECTS

Array = NDArray[np.float64]
Direction = tuple[float, float, float]

NORMAL2 = 1e-24
"""Squared sine of the angle of incidence below which any reference direction is accepted: s- and p-polarised light
differ by no more than this."""


@inlined
def shares_by_state(
    polarised: Any, region: int, number: int, outward: bool, n_i: float, n_t: float, cos_i: float, normal: Direction,
    frames: Array, frame: int, packet: Any, book: Array, reflectance: float, transmittance: float,
) -> tuple[float, float]:  # fmt: skip
    """Return reflectance and transmittance for a packet's state, and set the states of its children.

    Absorption in a coating is taken from the packet and entered in the book; the shares refer to the rest.

    Parameters
    ----------
    polarised : PolarisationTables or None
    region, number : int
        Region of the interface, and its row there.
    outward : bool
        Light comes from the far side: from the inside in object space and array, from the sensor's side in the lens.
    n_i, n_t, cos_i : float
        Refractive indices before and behind the interface, and cosine of incidence.
    normal : (3,) float
        Unit normal, along the ray.
    frames : (6, 6, 3, 4) float64
    frame : int
        Frame of the normal and the packet.
    packet : POLARISED
    book : (slots,) float64
    reflectance, transmittance : float
        Shares of unpolarised light, returned if packets have no state.
    """
    if polarised is None:
        return reflectance, transmittance
    film = polarised.films[polarised.begin[region] + number]
    if film.count == 0:
        back, on = bare_interface(n_i, n_t, cos_i)
    else:
        back, on = coated_interface(
            n_i, n_t, cos_i, polarised.indices, polarised.thicknesses, packet.colour, film.first, film.count,
            film.turned != outward, polarised.wavelengths[packet.colour],
        )  # fmt: skip
    q, u, v = _with_s_axis(packet, frames, frame, normal)
    reflectance, a, b, c = after(back, q, u, v)
    packet.reflected[0], packet.reflected[1], packet.reflected[2] = a, b, c
    transmittance, a, b, c = after(on, q, u, v)
    packet.refracted[0], packet.refracted[1], packet.refracted[2] = a, b, c
    if film.absorbs:
        left = min(reflectance + transmittance, 1.0)
        book[film.slot] += packet.weight * (1.0 - left)
        packet.weight *= left
        over = 1.0 / (reflectance + transmittance) if left > 0.0 else 0.0
        reflectance, transmittance = reflectance * over, transmittance * over
    return reflectance, transmittance


@inlined
def _with_s_axis(packet: Any, frames: Array, frame: int, normal: Direction) -> Direction:
    """Return a packet's state for the reference direction s of an interface; set s for the children."""
    dx, dy, dz = move_direction(frames, frame, WORLD_FRAME, packet.dx, packet.dy, packet.dz)
    nx, ny, nz = move_direction(frames, frame, WORLD_FRAME, normal[0], normal[1], normal[2])
    sx, sy, sz = dy * nz - dz * ny, dz * nx - dx * nz, dx * ny - dy * nx
    size2 = sx * sx + sy * sy + sz * sz
    if size2 < NORMAL2:
        sx, sy, sz = packet.reference[0], packet.reference[1], packet.reference[2]
        size2 = sx * sx + sy * sy + sz * sz
    scale = 1.0 / np.sqrt(size2)
    sx, sy, sz = sx * scale, sy * scale, sz * scale
    # Close to normal incidence the product's rounding errors are no longer perpendicular to the ray.
    along = sx * dx + sy * dy + sz * dz
    sx, sy, sz = sx - along * dx, sy - along * dy, sz - along * dz
    size2 = sx * sx + sy * sy + sz * sz
    if size2 < NORMAL2:
        # An unpolarised packet's reference direction may lie along its ray.
        sx, sy, sz = _across(dx, dy, dz)
        size2 = 1.0
    scale = 1.0 / np.sqrt(size2)
    sx, sy, sz = sx * scale, sy * scale, sz * scale
    packet.s_axis[0], packet.s_axis[1], packet.s_axis[2] = sx, sy, sz
    return _referred_to(packet, dx, dy, dz, sx, sy, sz)


@inlined
def _referred_to(packet: Any, dx: float, dy: float, dz: float, sx: float, sy: float, sz: float) -> Direction:
    """Return a packet's state for another reference direction, perpendicular to its direction, in the world frame."""
    q, u, v = packet.stokes[0], packet.stokes[1], packet.stokes[2]
    ex, ey, ez = packet.reference[0], packet.reference[1], packet.reference[2]
    cosine = ex * sx + ey * sy + ez * sz
    sine = (dy * ez - dz * ey) * sx + (dz * ex - dx * ez) * sy + (dx * ey - dy * ex) * sz
    if q != 0.0 or u != 0.0:
        # Otherwise the reference direction is arbitrary.
        q, u = turned(q, u, cosine, sine)
    return q, u, v


@inlined
def become_child(polarised: Any, packet: Any, refracts: bool) -> None:
    """Give a divided packet the state of its refracted or its reflected child.

    Parameters
    ----------
    polarised : PolarisationTables or None
    packet : POLARISED
    refracts : bool
    """
    if polarised is None:
        return
    for i in range(3):
        packet.stokes[i] = packet.refracted[i] if refracts else packet.reflected[i]
        packet.reference[i] = packet.s_axis[i]


@inlined
def depolarise(polarised: Any, packet: Any) -> None:
    """Make a packet unpolarised.

    Parameters
    ----------
    polarised : PolarisationTables or None
    packet : POLARISED
    """
    if polarised is None:
        return
    packet.stokes[0] = packet.stokes[1] = packet.stokes[2] = 0.0


@inlined
def through_polariser(polarised: Any, packet: Any, weight: float, frame: int, frames: Array, book: Array) -> float:
    """Pass a packet through the polariser in front of the sensor, if any; return its weight.

    At any angle of incidence, the polariser transmits the field perpendicular to the ray and to its absorbing axis,
    like a sheet of parallel absorbing molecules.

    Parameters
    ----------
    polarised : PolarisationTables or None
    packet : POLARISED
    weight : float
    frame : int
        Frame of the packet.
    frames : (6, 6, 3, 4) float64
    book : (slots,) float64
        Receives the absorbed weight.
    """
    if polarised is None:
        return weight
    if not polarised.has_polariser:
        return weight
    dx, dy, dz = move_direction(frames, frame, WORLD_FRAME, packet.dx, packet.dy, packet.dz)
    return _polarised(polarised, packet, weight, dx, dy, dz, book)


@inlined
def behind_polariser(
    polarised: Any, packet: Any, weight: float, dx: float, dy: float, dz: float, frames: Array, book: Array
) -> float:
    """Start a packet of the adjoint method at a pixel and pass it through the polariser; return its weight.

    Parameters
    ----------
    polarised : PolarisationTables or None
    packet : POLARISED
    weight : float
        At the pixel, which detects light of any state.
    dx, dy, dz : float
        Unit direction, sensor frame.
    frames : (6, 6, 3, 4) float64
    book : (slots,) float64
    """
    if polarised is None:
        return weight
    depolarise(polarised, packet)
    dx, dy, dz = move_direction(frames, SENSOR_FRAME, WORLD_FRAME, dx, dy, dz)
    packet.reference[0], packet.reference[1], packet.reference[2] = _across(dx, dy, dz)
    if not polarised.has_polariser:
        return weight
    passed = _polarised(polarised, packet, weight, dx, dy, dz, book)
    packet.start *= passed / weight
    return passed


@inlined
def _polarised(polarised: Any, packet: Any, weight: float, dx: float, dy: float, dz: float, book: Array) -> float:
    """Pass a packet of a given direction (world frame) through the polariser; return its weight."""
    axis = polarised.absorbing
    ex, ey, ez = dy * axis[2] - dz * axis[1], dz * axis[0] - dx * axis[2], dx * axis[1] - dy * axis[0]
    scale = 1.0 / np.sqrt(ex * ex + ey * ey + ez * ez)
    ex, ey, ez = ex * scale, ey * scale, ez * scale
    q, _, _ = _referred_to(packet, dx, dy, dz, ex, ey, ez)
    passed = 0.5 * max(0.0, 1.0 + q) * weight
    book[polarised.slot] += weight - passed
    packet.stokes[0], packet.stokes[1], packet.stokes[2] = 1.0, 0.0, 0.0
    packet.reference[0], packet.reference[1], packet.reference[2] = ex, ey, ez
    return passed


@inlined
def polarise_as_light(polarised: Any, packet: Any, number: int, dx: float, dy: float, dz: float) -> None:
    """Give a packet the polarisation of its light.

    Parameters
    ----------
    polarised : PolarisationTables or None
    packet : POLARISED
    number : int
        Number of the light.
    dx, dy, dz : float
        Unit direction, object frame (with the world's axes).
    """
    if polarised is None:
        return
    for i in range(3):
        packet.stokes[i] = polarised.lights[number, i]
    packet.reference[0], packet.reference[1], packet.reference[2] = _across(dx, dy, dz)


@inlined
def _across(dx: float, dy: float, dz: float) -> Direction:
    """Return the unit direction of the x axis's component perpendicular to a ray; for a ray along x, the y axis."""
    size2 = dy * dy + dz * dz
    if size2 < NORMAL2:
        return 0.0, 1.0, 0.0
    scale = 1.0 / np.sqrt(size2)
    return size2 * scale, -dx * dy * scale, -dx * dz * scale


def across(directions: ArrayLike, axis: ArrayLike = (1.0, 0.0, 0.0)) -> Array:
    """Return the reference directions of rays: the component of an axis perpendicular to each ray.

    Parameters
    ----------
    directions : (n, 3) float64
        Unit directions.
    axis : (3,) or (n, 3) float64
        Of any length but 0. For a ray along it, the y axis replaces it, or else the z axis.

    Returns
    -------
    reference : (n, 3) float64
    """
    d = np.asarray(directions, np.float64).reshape(-1, 3)
    found = np.zeros_like(d)
    for each in ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), axis):
        e = np.broadcast_to(np.asarray(each, np.float64), d.shape)
        e = e / np.linalg.norm(e, axis=1, keepdims=True)
        e = e - (e * d).sum(axis=1, keepdims=True) * d
        size = np.linalg.norm(e, axis=1, keepdims=True)
        found = np.where(size**2 < NORMAL2, found, e / np.where(size > 0.0, size, 1.0))
    # Once more, because the difference of nearly parallel directions has lost digits.
    found -= (found * d).sum(axis=1, keepdims=True) * d
    return found / np.linalg.norm(found, axis=1, keepdims=True)


__all__ = [
    "IN_ARRAY", "IN_LENS", "IN_OBJECTS", "across", "become_child", "behind_polariser", "depolarise",
    "polarise_as_light", "shares_by_state", "through_polariser",
]  # fmt: skip
