"""Phases of faces: the diffraction orders of a ray, their shares of its light, and the children of a packet.

A phase Φ changes the momentum along its face, the tangential part of n times the unit direction, by G = m λ/2π ∇Φ in
order m, for light of either direction of travel: reversed, p + G → p reads −(p + G) + G = −p. Étendue is conserved, so
radiance and importance take no factor but the shares of the light.

A face reflects and transmits light by Fresnel's equations, or its coating, at the momentum p with which the light
arrives. Importance travels against the light: a packet that leaves with p + G stands for light that arrives with
−(p + G), from the far side if it is transmitted. So the shares of the orders of a packet need not add up to 1, and the
book takes the difference with the light in no listed order.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.phase_law import diffracted
from lfmesh.optics.phase_profiles import phase_at
from lfmesh.transport.events.crossing import (
    CHOOSE,
    KEEP_REFLECTED,
    KEEP_REFRACTED,
    record_interface,
    windowed,
)
from lfmesh.transport.events.interface import Direction, shares
from lfmesh.transport.packets.book import UNFOLLOWED
from lfmesh.transport.packets.children import IN_ORDER
from lfmesh.transport.packets.packet import (
    BOTH,
    E_REFLECTED,
    E_TRANSMITTED,
    EVENTS,
    ROULETTE,
    Flow,
    Options,
    count_event,
)
from lfmesh.transport.packets.random import DIMENSIONS_PER_EVENT, derived, uniform
from lfmesh.transport.paths.automaton import after_interface
from lfmesh.transport.tables.phase_faces import (
    END_OF_ORDERS,
    EVANESCENT_ORDERS,
    FIRST_REFLECTED,
    FIRST_TRANSMITTED,
    UNLISTED_ORDERS,
    PhaseFaces,
)
from lfmesh.transport.tables.tables import ABSORBING, Interfaces

Array = NDArray[np.float64]

EVANESCENT = -1.0
"""Share of an order that leads to no direction."""


class LightAtPhase(NamedTuple):
    """A ray at a face with a phase, in the frame of the face.

    Attributes
    ----------
    number, colour : int
        Row of the interface, and number of the wavelength.
    n_i, n_t : float
        Refractive indices before and after the face.
    direction, normal : (3,) float
        Unit direction, and unit normal along the ray.
    gradient : (2,) float
        Change of momentum in the first order, before its projection on the face.
    outward : bool
        The ray comes from the side of a coating's last layer.
    reflectance, transmittance : float
        Shares of light that arrives as the ray does.
    """

    number: int
    colour: int
    n_i: float
    n_t: float
    direction: Direction
    normal: Direction
    gradient: tuple[float, float]
    outward: bool
    reflectance: float
    transmittance: float


@inlined
def has_phase(phases: Any, number: int) -> bool:
    """Tell whether an interface has a phase.

    Parameters
    ----------
    phases : PhaseFaces or None
        None: no interface of the region has one.
    number : int
        Row of the interface.
    """
    if phases is None:
        return False
    return phases.number[number] >= 0


@inlined
def momentum_change(phases: PhaseFaces, number: int, colour: int, x: float, y: float) -> tuple[float, float]:
    """Return the change of momentum in the first order along x and y, before its projection on the face.

    Parameters
    ----------
    phases : PhaseFaces
    number, colour : int
        Row of the interface, and number of the wavelength.
    x, y : float, mm
        Point of the face, in the frame of its phase.
    """
    _, phase_x, phase_y = phase_at(phases.phases, phases.number[number], x, y)
    scale = phases.scale[colour]
    return scale * phase_x, scale * phase_y


@inlined
def light_at_phase(
    interfaces: Interfaces, phases: PhaseFaces, number: int, colour: int, indices: tuple[float, float],
    direction: Direction, normal: Direction, place: tuple[float, float], outward: bool,
) -> LightAtPhase:  # fmt: skip
    """Return a ray at a face with a phase, and the shares of light that arrives there.

    Parameters
    ----------
    interfaces : Interfaces
        Of the region.
    phases : PhaseFaces
        Its phases.
    number, colour : int
        Row of the interface, and number of the wavelength.
    indices : (2,) float
        Refractive indices before and after the face.
    direction, normal, outward
        As for `LightAtPhase`.
    place : (2,) float, mm
        Point of the face, in the frame of its phase.
    """
    n_i, n_t = indices
    cos_i = direction[0] * normal[0] + direction[1] * normal[1] + direction[2] * normal[2]
    reflectance, transmittance, _ = shares(interfaces, number, colour, n_i, n_t, min(cos_i, 1.0), outward)
    gradient = momentum_change(phases, number, colour, place[0], place[1])
    return LightAtPhase(
        number, colour, n_i, n_t, direction, normal, gradient, outward, reflectance, transmittance
    )  # fmt: skip


@inlined
def towards_order(
    interfaces: Interfaces, phases: PhaseFaces, light: LightAtPhase, listed: int, reflects: bool
) -> tuple[float, float, float, float, float]:
    """Return the share of a ray's weight that goes to an order, and the order's direction.

    Parameters
    ----------
    interfaces : Interfaces
    phases : PhaseFaces
    light : LightAtPhase
    listed : int
        Number of the order in the tables.
    reflects : bool
        It is one of the reflected orders.

    Returns
    -------
    share : float
        `EVANESCENT`: the order has no direction.
    of_light : float
        Share of the order in light that arrives as the ray does, evanescent or not.
    dx, dy, dz : float
        Unit direction, in the frame of the face.
    """
    order, part = phases.order[listed], phases.share[listed, light.colour]
    of_light = part * (light.reflectance if reflects else light.transmittance)
    n_out = light.n_i if reflects else light.n_t
    goes_on, cos_out, dx, dy, dz = diffracted(
        light.n_i, n_out, light.direction, light.normal, order * light.gradient[0], order * light.gradient[1], reflects
    )
    if not goes_on:
        return EVANESCENT, of_light, 0.0, 0.0, 0.0
    share = of_light
    if phases.against_light and not (reflects and order == 0.0):
        # Light comes the way that the packet goes, from the far side if that is transmitted.
        n_far, outward = (light.n_t, light.outward) if reflects else (light.n_i, not light.outward)
        reflectance, transmittance, _ = shares(
            interfaces, light.number, light.colour, n_out, n_far, min(cos_out, 1.0), outward
        )
        share = part * (reflectance if reflects else transmittance)
    return share, of_light, dx, dy, dz


@inlined
def absorbed_at_phase(interfaces: Interfaces, light: LightAtPhase) -> float:
    """Return the share of a ray's weight that the coating of a face with a phase absorbs.

    Parameters
    ----------
    interfaces : Interfaces
    light : LightAtPhase
    """
    if interfaces.rows[light.number].kind != ABSORBING:
        return 0.0
    return 1.0 - light.reflectance - light.transmittance


@inlined
def unlisted_at_phase(phases: PhaseFaces, light: LightAtPhase) -> float:
    """Return the share of the light in no listed order.

    Parameters
    ----------
    phases : PhaseFaces
    light : LightAtPhase
    """
    left, number, colour = phases.left, light.number, light.colour
    return (
        light.transmittance * left[number, FIRST_TRANSMITTED, colour]
        + light.reflectance * left[number, FIRST_REFLECTED, colour]
    )


@kernel
def _totals(
    interfaces: Interfaces, phases: PhaseFaces, light: LightAtPhase, weight: float, book: Array
) -> tuple[float, float]:
    """Return the sums of the shares of transmitted and of reflected orders; book the weight that goes to neither."""
    first, reflected = phases.first[light.number, FIRST_TRANSMITTED], phases.first[light.number, FIRST_REFLECTED]
    passed, thrown, evanescent, unlisted = 0.0, 0.0, 0.0, unlisted_at_phase(phases, light)
    for listed in range(first, phases.first[light.number, END_OF_ORDERS]):
        share, of_light, _, _, _ = towards_order(interfaces, phases, light, listed, listed >= reflected)
        if share == EVANESCENT:
            evanescent += of_light
            continue
        unlisted += of_light - share
        if listed >= reflected:
            thrown += share
        else:
            passed += share
    book[phases.slot[light.number, EVANESCENT_ORDERS]] += weight * evanescent
    book[phases.slot[light.number, UNLISTED_ORDERS]] += weight * unlisted
    absorbed = absorbed_at_phase(interfaces, light)
    if absorbed != 0.0:
        book[interfaces.rows[light.number].slot] += weight * absorbed
    return passed, thrown


@kernel
def _chosen(interfaces: Interfaces, phases: PhaseFaces, light: LightAtPhase, first: int, end: int, place: float) -> int:
    """Return the order, among those from `first` to `end`, at a place in the sum of their shares."""
    chosen = first
    for listed in range(first, end):
        share, _, _, _, _ = towards_order(
            interfaces, phases, light, listed, listed >= phases.first[light.number, FIRST_REFLECTED]
        )
        if share > 0.0:
            # The last one, if rounding puts the place behind all of them.
            if place >= 0.0:
                chosen = listed
            place -= share
    return chosen


@inlined
def key_of_order(key: np.uint64, events: int, listed: int, leads: bool, reflects: bool) -> np.uint64:
    """Return the key of a child in an order.

    The leading orders on either side have the keys of refracted and reflected children.

    Parameters
    ----------
    key : uint64
        Of the parent.
    events : int
        Number of its events, including this one.
    listed : int
        Number of the order among those of its face.
    leads : bool
        It is the first of the transmitted or of the reflected orders.
    reflects : bool
    """
    if not leads:
        return derived(derived(key, IN_ORDER + events), listed)
    return derived(key, events) if reflects else key


def order_splitter(send: Callable[..., None]) -> Callable[..., None]:
    """Make the function that divides a packet at a face with a phase into its orders.

    Parameters
    ----------
    send : kernel
        As for `interface.splitter`; directions are in the frame of the face.

    Returns
    -------
    split_orders : kernel
    """

    @inlined
    def split_orders(
        place: Any, options: Options, flow: Flow, frames: NDArray[Any], frame: int, packet: Any,
        surface: int, part: int, beyond: int, x: float, y: float, z: float,
        interfaces: Interfaces, phases: PhaseFaces, light: LightAtPhase,
    ) -> None:  # fmt: skip
        """Divide a packet into the listed orders, and send the survivors of roulette.

        Parameters
        ----------
        frame, surface, part, beyond, x, y, z
            As for the function made by `interface.splitter`.
        interfaces : Interfaces
        phases : PhaseFaces
        light : LightAtPhase
        """
        flow.counts[EVENTS] += 1
        begin, reflected, until = (
            phases.first[light.number, FIRST_TRANSMITTED], phases.first[light.number, FIRST_REFLECTED],
            phases.first[light.number, END_OF_ORDERS],
        )  # fmt: skip
        weight, dimension, first, end = packet.weight, packet.events * DIMENSIONS_PER_EVENT, begin, until
        passed, thrown = _totals(interfaces, phases, light, weight, flow.book)
        split, whole = options.thinning.split, 0.0
        if split == ROULETTE:
            whole = passed + thrown
        elif split != BOTH:
            if passed == 0.0 and light.transmittance == 0.0:
                # Under total reflection the reflected child is the path.
                first, whole = reflected, thrown
            else:
                flow.book[UNFOLLOWED] += weight * thrown
                end, whole = reflected, passed
        if split != BOTH:
            if whole <= 0.0:
                end = first
            else:
                choice = uniform(packet.key, dimension + CHOOSE) * whole
                first = _chosen(interfaces, phases, light, first, end, choice)
                end = first + 1
        floor = options.thinning.cutoff * packet.start
        count_event(packet)
        node, key, path = packet.node, packet.key, packet.path
        for listed in range(first, end):
            reflects = listed >= reflected
            share, _, dx, dy, dz = towards_order(interfaces, phases, light, listed, reflects)
            if not share > 0.0:
                continue
            leads = listed == (reflected if reflects else begin)
            child_key = key_of_order(key, packet.events, listed - begin, leads, reflects)
            left = weight * whole
            if split == BOTH:
                own = key if leads else child_key
                left = windowed(
                    flow.book, weight * share, floor, own, dimension + (KEEP_REFLECTED if reflects else KEEP_REFRACTED)
                )
                if left == 0.0:
                    continue
            packet.path = after_interface(frame, not reflects, light.transmittance, path)
            if options.record:
                event = E_REFLECTED if reflects else E_TRANSMITTED
                packet.node = record_interface(flow, frames, frame, x, y, z, left, surface, part, event, node, beyond)
            send(place, options, flow, frames, packet, not reflects, x, y, z, dx, dy, dz, left, child_key)

    return split_orders
