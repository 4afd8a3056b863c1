"""Interfaces: shares of reflected and transmitted power, and the children of a packet.

Only this module depends on the kind of an interface (see `tables.interfaces`), and only it and `events.phase` divide
packets. The regions find hits and the destinations of children.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.fresnel import fresnel
from lfmesh.optics.scattering import lambertian, tangents
from lfmesh.optics.share_table import coated_shares
from lfmesh.transport.events.crossing import BOUNCE_U, CHOOSE, draw, draw_two, record_interface, split_shares
from lfmesh.transport.events.ground import ground_density, ground_direction
from lfmesh.transport.events.polarisation import become_child
from lfmesh.transport.packets.children import IN_DENSITY, IN_WALK
from lfmesh.transport.packets.packet import (
    CAMERA,
    E_REFLECTED,
    E_TRANSMITTED,
    EVENTS,
    LAMP,
    OBJECT_FRAME,
    Flow,
    Options,
    count_event,
)
from lfmesh.transport.packets.random import derived
from lfmesh.transport.paths.automaton import ON_ROUGH_FACE, after_interface
from lfmesh.transport.tables.tables import ABSORBING, BARE, DIFFUSE, ROUGH, THIN_LENS, Interfaces

Array = NDArray[np.float64]
Direction = tuple[float, float, float]


@inlined
def shares(
    interfaces: Interfaces, number: int, colour: int, n_i: float, n_t: float, cos_i: float, outward: bool
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
        Refractive indices before and after the interface.
    cos_i : float
        Cosine of the angle of incidence, 0 to 1.
    outward : bool
        Light comes from the side of a coating's last layer (the indices may be equal).

    Returns
    -------
    R, T, cos_t : float
        Shares of power; 1, 0, 0 under total reflection, but R below 1 if a coating absorbs.
    """
    reflectance, transmittance, cos_t = fresnel(n_i, n_t, cos_i)
    row = interfaces.rows[number]
    if row.kind != BARE and row.kind != THIN_LENS:
        reflectance, transmittance = coated_shares(
            interfaces.parameters, row.first, row.pieces, row.kind == ABSORBING, colour, n_i, n_t, cos_i, cos_t,
            transmittance == 0.0, outward,
        )  # fmt: skip
    return reflectance, transmittance, cos_t


@inlined
def is_coated(interfaces: Interfaces, number: int) -> bool:
    """Tell whether an interface has a coating."""
    return interfaces.rows[number].kind != BARE


@inlined
def divided(
    interfaces: Interfaces, number: int, colour: int, n_i: float, n_t: float, cos_i: float, outward: bool,
    packet: Any, book: Array,
) -> tuple[float, float, float]:  # fmt: skip
    """Return the results of `shares` relative to the packet after absorption in the coating.

    The absorbed weight is taken from the packet and entered in the book.

    Parameters
    ----------
    interfaces, number, colour, n_i, n_t, cos_i, outward
        As for `shares`.
    packet : PACKET
    book : (slots,) float64
    """
    reflectance, transmittance, cos_t = shares(interfaces, number, colour, n_i, n_t, cos_i, outward)
    row = interfaces.rows[number]
    if row.kind == ABSORBING:
        left = reflectance + transmittance
        book[row.slot] += packet.weight * (1.0 - left)
        packet.weight *= left
        over = 1.0 / left if left > 0.0 else 0.0
        reflectance, transmittance = reflectance * over, transmittance * over
    return reflectance, transmittance, cos_t


@inlined
def is_thin_lens(interfaces: Interfaces, number: int) -> bool:
    """Tell whether an interface is a thin lens."""
    return interfaces.rows[number].kind == THIN_LENS


@inlined
def through_thin_lens(
    interfaces: Interfaces, number: int, colour: int, x: float, y: float, direction: Direction
) -> tuple[float, float, float, float]:
    """Return the direction behind a thin lens, and the factor (cosine behind / cosine in front)⁴.

    The slopes dx/|dz| and dy/|dz| change by −x/f and −y/f: a collineation, which images points into points at every
    angle (Born and Wolf, 4.3). It conserves dx dy d(slope) d(slope); an element of étendue is cos⁴ times that. So at
    constant flux the factor divides radiance; it multiplies importance, which goes against the light.

    Parameters
    ----------
    interfaces, number, colour
        As for `shares`.
    x, y : float, mm
        Distances from the axis of the lens.
    direction : (3,) float
        Unit direction in the lens's frame.
    """
    dx, dy, dz = direction
    power = interfaces.parameters[interfaces.rows[number].first, colour] * abs(dz)
    ux, uy = dx - power * x, dy - power * y
    scale2 = 1.0 / (ux * ux + uy * uy + dz * dz)
    scale = np.sqrt(scale2)
    return ux * scale, uy * scale, dz * scale, scale2 * scale2


@inlined
def is_rough(interfaces: Interfaces, number: int) -> bool:
    """Tell whether an interface scatters light."""
    return interfaces.rows[number].kind >= ROUGH


@kernel
def scattered(
    interfaces: Interfaces, number: int, options: Options, packet: Any, n_i: float, n_t: float, normal: Direction
) -> tuple[bool, float, float, float]:
    """Draw whether a rough interface transmits a packet, and its new direction.

    The packet keeps its weight. In basic radiance the process is symmetric: importance is scattered as flux is. Counts
    the event.

    Parameters
    ----------
    interfaces : Interfaces
        Of the region.
    number : int
        Row of the interface.
    options : Options
    packet : PACKET
    n_i, n_t : float
        Refractive indices before and after the interface.
    normal : (3,) float
        Unit normal along the ray.
    """
    (nx, ny, nz), dx, dy, dz = normal, packet.dx, packet.dy, packet.dz
    choice = draw(packet, CHOOSE)
    count_event(packet)
    u, v = draw_two(options, packet, BOUNCE_U)
    row = interfaces.rows[number]
    if row.kind == DIFFUSE:
        passes = choice >= interfaces.parameters[row.first + (1 if n_i > n_t else 0), packet.colour]
        sense = 1.0 if passes else -1.0
        ox, oy, oz = lambertian(sense * nx, sense * ny, sense * nz, u, v)
        return passes, ox, oy, oz
    px, py, pz, qx, qy, qz = tangents(-nx, -ny, -nz)
    a, b, c = dx * px + dy * py + dz * pz, dx * qx + dy * qy + dz * qz, -(dx * nx + dy * ny + dz * nz)
    key = derived(packet.key, IN_WALK + packet.events)
    alpha = interfaces.parameters[row.first, packet.colour]
    passes, a, b, c = ground_direction(alpha, n_i, n_t, (a, b, c), u, v, key)
    return passes, a * px + b * qx - c * nx, a * py + b * qy - c * ny, a * pz + b * qz - c * nz


@kernel
def scattered_density(
    interfaces: Interfaces, number: int, packet: Any, indices: tuple[float, float], normal: Direction,
    leaving: Direction, light: int,
) -> float:  # fmt: skip
    """Return the density, 1/sr, of a direction in `scattered`; for ground interfaces an unbiased estimate.

    Parameters
    ----------
    interfaces, number, packet, normal
        As for `scattered`.
    indices : (2,) float
        Refractive indices before and after the interface.
    leaving : (3,) float
        Unit direction of the leaving light.
    light : int
        Identifies the direction among those asked for at one event.
    """
    (n_i, n_t), (nx, ny, nz), (ox, oy, oz) = indices, normal, leaving
    dx, dy, dz = packet.dx, packet.dy, packet.dz
    row = interfaces.rows[number]
    along = ox * nx + oy * ny + oz * nz
    if row.kind == DIFFUSE:
        reflected_share = interfaces.parameters[row.first + (1 if n_i > n_t else 0), packet.colour]
        return (1.0 - reflected_share if along > 0.0 else reflected_share) * abs(along) / np.pi
    px, py, pz, qx, qy, qz = tangents(-nx, -ny, -nz)
    a, b, c = dx * px + dy * py + dz * pz, dx * qx + dy * qy + dz * qz, -(dx * nx + dy * ny + dz * nz)
    to_a, to_b = ox * px + oy * py + oz * pz, ox * qx + oy * qy + oz * qz
    key = derived(derived(packet.key, IN_DENSITY + packet.events), light)
    alpha = interfaces.parameters[row.first, packet.colour]
    return ground_density(alpha, n_i, n_t, (a, b, c), (to_a, to_b, -along), key)


def scatterer(send: Callable[..., None]) -> Callable[..., None]:
    """Make the function that sends a packet on in the direction drawn by `scattered`.

    Parameters
    ----------
    send : kernel
        As for `splitter`.

    Returns
    -------
    send_scattered : kernel
    """

    @inlined
    def send_scattered(
        place: Any, options: Options, flow: Flow, frames: NDArray[Any], frame: int, packet: Any,
        surface: int, part: int, beyond: int, x: float, y: float, z: float, passes: bool,
        dx: float, dy: float, dz: float,
    ) -> None:  # fmt: skip
        """Send a packet on with its whole weight, in its class of paths, as on a target.

        Parameters
        ----------
        frame, surface, part, beyond, x, y, z
            As for the function made by `splitter`.
        passes : bool
            The packet is transmitted.
        dx, dy, dz : float
            Unit direction.
        """
        flow.counts[EVENTS] += 1
        if packet.kind == LAMP:
            # See `PathClass.LAMP_ON_CAMERA`; rough glass in object space has already changed the kind.
            packet.kind, packet.path = CAMERA, ON_ROUGH_FACE[packet.path]
        if frame == OBJECT_FRAME and passes:
            packet.medium = beyond
        if options.record:
            event = E_TRANSMITTED if passes else E_REFLECTED
            packet.node = record_interface(
                flow, frames, frame, x, y, z, packet.weight, surface, part, event, packet.node, beyond
            )
        send(place, options, flow, frames, packet, passes, x, y, z, dx, dy, dz, packet.weight, packet.key)

    return send_scattered


def splitter(send: Callable[..., None]) -> Callable[..., None]:
    """Make the function that divides a packet at the interfaces of a region.

    Parameters
    ----------
    send : kernel
        Queues a child at its next station, called as ``send(place, options, flow, frames, packet, refracts, x, y, z,
        dx, dy, dz, weight, key)``: `place` holds data of the region, `packet` is the child's parent.

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
        """Divide a packet into its reflected and refracted child, and send the survivors of roulette.

        Parameters
        ----------
        frame : int
            Frame of point and directions.
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
        count_event(packet)
        node, key, path, medium = packet.node, packet.key, packet.path, packet.medium
        for refracts in (False, True):
            weight = to_refracted if refracts else to_reflected
            if weight <= 0.0:
                continue
            dx, dy, dz = bent if refracts else mirrored
            if frame == OBJECT_FRAME:
                # In lens and array the medium follows from the space, and reading a field just written is slow.
                packet.medium = beyond if refracts else medium
            packet.path = after_interface(frame, refracts, transmittance, path)
            if options.record:
                event = E_TRANSMITTED if refracts else E_REFLECTED
                packet.node = record_interface(flow, frames, frame, x, y, z, weight, surface, part, event, node, beyond)
            become_child(flow.polarised, packet, refracts)
            child_key = key if refracts else derived(key, packet.events)
            send(place, options, flow, frames, packet, refracts, x, y, z, dx, dy, dz, weight, child_key)

    return split
