"""Interfaces: shares of reflected and transmitted power, and the children of a packet.

Only this module depends on the kind of an interface (see `tables.interfaces`), and only here is a packet divided. The
regions find where an interface is met and where the children go.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernel import inlined, pasted
from lfmesh.optics.fresnel import fresnel, transmittance
from lfmesh.optics.share_table import coated_shares
from lfmesh.transport.events.crossing import record_interface, split_shares
from lfmesh.transport.events.polarisation import become_child
from lfmesh.transport.packets.packet import E_REFLECTED, E_TRANSMITTED, EVENTS, OBJECT_FRAME, Flow, Options
from lfmesh.transport.packets.path_class import turns_off_image_path
from lfmesh.transport.packets.random import derived
from lfmesh.transport.tables.tables import ABSORBING, BARE, Interfaces

Array = NDArray[np.float64]


@inlined
def shares(
    interfaces: Interfaces, number: int, colour: int, n_i: float, n_t: float, cos_i: float
) -> tuple[float, float, float]:
    """Return reflectance, transmittance and the cosine of refraction at an interface.

    Parameters
    ----------
    interfaces : Interfaces
        Of the region.
    number : int
        Row of the interface.
    colour : int
        Number of the wavelength.
    n_i, n_t : float
        Refractive index before and after the interface.
    cos_i : float
        Cosine of the angle of incidence, 0 to 1.

    Returns
    -------
    R, T, cos_t : float
        Shares of the power; under total reflection 1, 0, 0, but R below 1 if a coating absorbs.
    """
    return _shares(interfaces, number, colour, n_i, n_t, cos_i, False)


@inlined
def _shares(
    interfaces: Interfaces, number: int, colour: int, n_i: float, n_t: float, cos_i: float, outward: bool
) -> tuple[float, float, float]:
    """Return what `shares` does; between equal indices `outward` tells from which side light comes."""
    reflectance, transmittance, cos_t = fresnel(n_i, n_t, cos_i)
    row = interfaces.rows[number]
    if row.kind != BARE:
        reflectance, transmittance = coated_shares(
            interfaces.parameters, row.first, row.pieces, row.kind == ABSORBING, colour, n_i, n_t, cos_i, cos_t,
            transmittance == 0.0, outward,
        )  # fmt: skip
    return reflectance, transmittance, cos_t


@inlined
def bare_shares(n_i: float, n_t: float, cos_i: float) -> tuple[float, float, float]:
    """Return what `shares` does for an interface without a coating, without branches, for blocks of packets.

    Parameters
    ----------
    n_i, n_t, cos_i : float
        As for `shares`.
    """
    return fresnel(n_i, n_t, cos_i)


@inlined
def is_coated(interfaces: Interfaces, number: int) -> bool:
    """Tell whether an interface has a coating."""
    return interfaces.rows[number].kind != BARE


@inlined
def divided(
    interfaces: Interfaces, number: int, colour: int, n_i: float, n_t: float, cos_i: float, outward: bool,
    packet: Any, book: Array,
) -> tuple[float, float, float]:  # fmt: skip
    """Return what `shares` does, as shares of what a coating leaves of the packet.

    What the coating absorbs is taken from the packet and entered in the book.

    Parameters
    ----------
    outward : bool
        Light comes from the side that the layers of a coating end with; between equal indices only this tells it.
    """
    reflectance, transmittance, cos_t = _shares(interfaces, number, colour, n_i, n_t, cos_i, outward)
    row = interfaces.rows[number]
    if row.kind == ABSORBING:
        left = reflectance + transmittance
        book[row.slot] += packet.weight * (1.0 - left)
        packet.weight *= left
        over = 1.0 / left if left > 0.0 else 0.0
        reflectance, transmittance = reflectance * over, transmittance * over
    return reflectance, transmittance, cos_t


@pasted
def transmitted_share(
    interfaces: Interfaces, number: int, colour: int,
    n_i: float, n_t: float, cos_i: float, cos_t: float, s: float, p: float, over: float,
) -> float:  # fmt: skip
    """Return the transmittance alone, from intermediate results of Fresnel's equations that a block of rays has ready.

    Of bare interfaces; at coated ones a block goes ray by ray.

    Parameters
    ----------
    interfaces, number, colour, n_i, n_t, cos_i
        As for `shares`.
    cos_t : float
        Cosine of refraction.
    s, p, over : float
        See `optics.fresnel.transmittance`. Under total reflection the result is meaningless.
    """
    return transmittance(n_i, n_t, cos_i, cos_t, s, p, over)


def splitter(send: Callable[..., None]) -> Callable[..., None]:
    """Make the function that divides a packet at the interfaces of a region.

    Parameters
    ----------
    send : kernel
        Queues a child where it goes next, called as ``send(place, options, flow, frames, packet, refracts, x, y, z,
        dx, dy, dz, weight, key)``: `place` holds what the region needs to send it, `packet` is the child's parent.

    Returns
    -------
    split : kernel
    """

    @inlined
    def split(
        place: Any, options: Options, flow: Flow, frames: NDArray[Any], frame: int, packet: Any,
        surface: int, part: int, beyond: int, x: float, y: float, z: float, reflectance: float, transmittance: float,
        mirrored: tuple[float, float, float], bent: tuple[float, float, float],
    ) -> None:  # fmt: skip
        """Divide a packet into its reflected and its refracted child, and send those that survive roulette.

        Parameters
        ----------
        frame : int
            Of point and directions.
        surface, part : int
            Fields of a recorded vertex.
        beyond : int
            Medium on the far side.
        x, y, z : float, mm
            Point on the interface.
        reflectance, transmittance : float
            Shares of the power.
        mirrored, bent : (3,) float
            Unit directions of the reflected and the refracted child.
        """
        flow.counts[EVENTS] += 1
        to_reflected, to_refracted = split_shares(options, flow.book, packet, reflectance, transmittance)
        packet.events += 1
        node, key, stray, medium = packet.node, packet.key, packet.stray, packet.medium
        for refracts in (False, True):
            weight = to_refracted if refracts else to_reflected
            if weight <= 0.0:
                continue
            dx, dy, dz = bent if refracts else mirrored
            if frame == OBJECT_FRAME:
                # In lens and array it follows from the space, and a field written just before it is read is slow.
                packet.medium = beyond if refracts else medium
            packet.stray = 1 if turns_off_image_path(frame, refracts, transmittance) else stray
            if options.record:
                event = E_TRANSMITTED if refracts else E_REFLECTED
                packet.node = record_interface(flow, frames, frame, x, y, z, weight, surface, part, event, node, beyond)
            become_child(flow.polarised, packet, refracts)
            child_key = key if refracts else derived(key, packet.events)
            send(place, options, flow, frames, packet, refracts, x, y, z, dx, dy, dz, weight, child_key)

    return split
