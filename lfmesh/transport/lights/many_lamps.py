"""The lamps that a point asks: all of them where they are few, else some that are drawn from a tree of them.

A point begins with the root of the tree (`tables/lamp_tree.py`) and opens nodes one by one: always that whose estimate
of the light, by its bounds, is in most doubt, until all doubts are small against the light (Conty Estevez & Kulla,
Importance sampling of many lights with adaptive tree splitting, HPG 2018). Of the nodes it then has, it takes at most
`OF_MANY`, each with a chance in proportion to its estimate, or surely. Within a node one lamp is drawn, by the
estimates of its parts on the way down. Light counts by one over the chance of its lamp.

The estimate of a node is zero only where its bounds show that none of its lamps shines there: below the horizon of the
point, or beyond the light of all lamps. That of a single point lamp, and of parallel light, is its irradiance.

Packets are sent past lamps into the light that is scattered near them by another law: the power over the distance.
There a node counts as one lamp if it is far enough away for all of its lamps to be about as far, and else is opened.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.events.crossing import LIGHT_U, draw_two
from lfmesh.transport.lights.lamps import LIGHT_DIMENSIONS, illuminate_from
from lfmesh.transport.packets.packet import Options
from lfmesh.transport.tables.lights import MM2, Lamps

OF_MANY = 3
"""Largest number of lamps that a point asks where there are more than `MOST_ASKED`: more cost more time than they save,
as samples of a pixel differ for other reasons too."""

MOST_NODES = 96
"""Largest number of nodes that a point opens.

Few points need that many: those among lamps, where nodes hold near and far ones, and bounds tell little of the nearest.
Over lamps from 1 mm to 100 m the light of a point has a standard deviation of 30 times its mean with 12, and 0.6 with
96; most other points open some ten.
"""

SETTLED = 0.5
"""Doubt of a node's light, over that of all nodes, up to which it is not opened."""

CLOSEST = 0.125
"""Distance of a node's nearest lamp, over its radius, below which its doubt grows no further."""

FAR = 1.5
"""Distance of a node from a point, in its radii, above which its lamps count as one when packets are sent past them."""

BELOW_ONE = 1.0 - 2.0**-53
"""Largest random number."""

ASKED = np.dtype(
    [
        ("node", "i8"),
        ("estimate", "f8"),  # of the light, W/m²
        ("doubt", "f8"),  # by how much that may be wrong; negative: the node is taken surely
        ("lamp", "i8"),
        ("share", "f8"),  # one over the chance with which it is asked
    ]
)
"""A node that a point has opened, and the lamp of it that it asks."""

NO_NORMAL = (0.0, 0.0, 0.0)
"""In place of the normal of a point that all light reaches: in a medium, or on rough glass."""

Place = tuple[float, float, float]


@kernel
def lamps_to_ask(
    options: Options, lamps: Lamps, packet: Any, place: Place, normal: Place, asked: NDArray[np.void]
) -> int:  # fmt: skip
    """Choose the lamps that a point asks; return their number.

    Parameters
    ----------
    options : Options
    lamps : Lamps
    packet : PACKET
        It has the random numbers.
    place : (3,) float, mm
        The point, object frame.
    normal : (3,) float
        Unit normal of the point on the side that is lit; `NO_NORMAL`: all sides are.
    asked : (MOST_NODES,) ASKED
        Written: `lamp` and `share` of those that are asked.
    """
    if len(lamps.nodes) == len(lamps.rows):
        for number in range(len(lamps.rows)):
            asked[number].lamp, asked[number].share = number, 1.0
        return len(lamps.rows)
    colour, dimension = packet.colour, LIGHT_U + LIGHT_DIMENSIONS * (len(lamps.rows) + 1)
    count, kept = _opened(lamps, colour, place, normal, SETTLED, asked), 0
    if count > OF_MANY:
        u, _ = draw_two(options, packet, dimension)
        count = _thinned(asked, count, OF_MANY, u)
    for k in range(count):
        number, share, within = asked[k].node, asked[k].share, 1.0
        if lamps.nodes[number].lamp < 0:
            u, _ = draw_two(options, packet, dimension + LIGHT_DIMENSIONS * (k + 1))
            number, within = drawn_below(lamps, number, colour, place, normal, u, False)
        if within > 0.0:
            asked[kept].lamp, asked[kept].share = lamps.nodes[number].lamp, share / within
            kept += 1
    return kept


@kernel
def drawn_below(
    lamps: Lamps, number: int, colour: int, place: Place, normal: Place, u: float, past: bool
) -> tuple[int, float]:
    """Draw a lamp of a node; return its own node, and its chance: 0 where none of them shines.

    Parameters
    ----------
    lamps : Lamps
    number : int
        Of the node.
    colour : int
        Number of the wavelength.
    place, normal
        As for `lamps_to_ask`.
    u : float
        Random number, uniform in [0, 1).
    past : bool
        By `brightness_past`, else by the light that arrives.
    """
    chance = 1.0
    while lamps.nodes[number].lamp < 0:
        left, right = number + 1, lamps.nodes[number + 1].skip
        one, other = _weights(lamps, left, right, colour, place, normal, past)
        if not one + other > 0.0:
            return number, 0.0
        share = one / (one + other)
        if u < share:
            number, u = left, u / share
        else:
            u, share = u - share, other / (one + other)
            number, u = right, u / share
        # What is left of the number is a random number of its own.
        u, chance = min(u, BELOW_ONE), chance * share
    return number, chance


@kernel
def chance_below(lamps: Lamps, number: int, lamp: int, colour: int, place: Place) -> float:
    """Return the chance with which `drawn_below` draws a lamp of a node, past which a packet is sent.

    Parameters
    ----------
    lamps, number, colour, place
        As for `drawn_below`.
    lamp : int
        Number of the lamp.
    """
    chance, leaf = 1.0, lamps.leaf[lamp]
    while lamps.nodes[number].lamp < 0:
        left, right = number + 1, lamps.nodes[number + 1].skip
        one, other = _weights(lamps, left, right, colour, place, NO_NORMAL, True)
        if not one + other > 0.0:
            return 0.0
        number = left if leaf < right else right
        chance *= (one if number == left else other) / (one + other)
    return chance


@inlined
def _counted(lamps: Lamps, number: int, place: Place) -> int:
    """Return the next node from some number on that counts as one lamp: a lamp, or lamps that are far from a point."""
    while number < len(lamps.nodes):
        node = lamps.nodes[number]
        px, py, pz = node.middle[0] - place[0], node.middle[1] - place[1], node.middle[2] - place[2]
        reach = FAR * node.radius
        if node.lamp >= 0 or not node.placed or px * px + py * py + pz * pz > reach * reach:
            break
        number += 1
    return number


@kernel
def passed_lamp(lamps: Lamps, colour: int, place: Place, u: float) -> int:
    """Draw the lamp past which a point may send a packet, by the brightness of the light round it; −1: there is none.

    Parameters
    ----------
    lamps, colour, place
        As for `drawn_below`.
    u : float
        Random number, uniform in [0, 1).
    """
    whole, number = 0.0, _counted(lamps, 0, place)
    while number < len(lamps.nodes):
        whole += brightness_past(lamps, number, colour, place)
        number = _counted(lamps, lamps.nodes[number].skip, place)
    choice, drawn, rest, number = whole * u, -1, 0.0, _counted(lamps, 0, place)
    while number < len(lamps.nodes):
        own = brightness_past(lamps, number, colour, place)
        if own > 0.0 and choice >= 0.0:
            # What is left of the number is a random number of its own.
            drawn, rest = number, min(choice / own, BELOW_ONE)
        choice -= own
        number = _counted(lamps, lamps.nodes[number].skip, place)
    if drawn < 0:
        return -1
    drawn, chance = drawn_below(lamps, drawn, colour, place, NO_NORMAL, rest, True)
    return lamps.nodes[drawn].lamp if chance > 0.0 else -1


@kernel
def chance_passed(lamps: Lamps, lamp: int, colour: int, place: Place) -> float:
    """Return the chance with which `passed_lamp` draws a lamp.

    Parameters
    ----------
    lamps, colour, place
        As for `drawn_below`.
    lamp : int
        Number of the lamp.
    """
    whole, own, holder, leaf = 0.0, 0.0, 0, lamps.leaf[lamp]
    number = _counted(lamps, 0, place)
    while number < len(lamps.nodes):
        light, after = brightness_past(lamps, number, colour, place), lamps.nodes[number].skip
        if number <= leaf < after:
            own, holder = light, number
        whole += light
        number = _counted(lamps, after, place)
    return own / whole * chance_below(lamps, holder, lamp, colour, place) if own > 0.0 else 0.0


@inlined
def _weights(
    lamps: Lamps, left: int, right: int, colour: int, place: Place, normal: Place, past: bool
) -> tuple[float, float]:
    """Return what the two parts of a node are drawn in proportion to."""
    if past:
        return brightness_past(lamps, left, colour, place), brightness_past(lamps, right, colour, place)
    return estimate(lamps, left, colour, place, normal)[0], estimate(lamps, right, colour, place, normal)[0]


@kernel
def brightness_past(lamps: Lamps, number: int, colour: int, place: Place) -> float:
    """Return the brightness of the light round the lamps of a node, as a point sees it, in W/mm.

    The distance of one with a size from all its points is about as large.

    Parameters
    ----------
    lamps, number, colour, place
        As for `drawn_below`.
    """
    node = lamps.nodes[number]
    px, py, pz = node.middle[0] - place[0], node.middle[1] - place[1], node.middle[2] - place[2]
    far = np.sqrt(px * px + py * py + pz * pz + node.radius * node.radius)
    if not node.placed or far <= 0.0:
        return 0.0
    return lamps.power[number, colour] / far


@kernel
def estimate(lamps: Lamps, number: int, colour: int, place: Place, normal: Place) -> tuple[float, float]:
    """Return about the irradiance that the lamps of a node bring to a point, and by how much it may be wrong, W/m².

    Parameters
    ----------
    lamps, number, colour, place, normal
        As for `drawn_below`.
    """
    node, power = lamps.nodes[number], lamps.power[number, colour]
    if power <= 0.0:
        return 0.0, 0.0
    facing = normal[0] != 0.0 or normal[1] != 0.0 or normal[2] != 0.0
    least, most = 1.0, 1.0
    if not node.placed:
        if facing:
            cosine = -(normal[0] * node.axis[0] + normal[1] * node.axis[1] + normal[2] * node.axis[2])
            if node.lamp >= 0:
                return power * max(cosine, 0.0), 0.0
            least, most = widened(cosine, node.cos_spread, node.sin_spread)
        light = power * max(most, 0.0)
        return light, 0.0 if node.lamp >= 0 else max(light - power * max(least, 0.0), 0.0)
    vx, vy, vz = node.middle[0] - place[0], node.middle[1] - place[1], node.middle[2] - place[2]
    d2, r2 = vx * vx + vy * vy + vz * vz, node.radius * node.radius
    if node.lamp >= 0 and r2 == 0.0:
        return _of_point(lamps, node.lamp, colour, place, normal, facing), 0.0
    nearest2 = max(d2 - r2, 0.25 * r2)
    if nearest2 <= 0.0:
        return 0.0, 0.0
    far, doubt = np.sqrt(d2), 0.0
    cos_round, sin_round = -1.0, 0.0
    if d2 > r2:
        cos_round, sin_round = np.sqrt((d2 - r2) / d2), node.radius / far
    light = power * node.per_sr / (MM2 * nearest2)
    if facing:
        cosine = (normal[0] * vx + normal[1] * vy + normal[2] * vz) / far if far > 0.0 else 0.0
        least, most = widened(cosine, cos_round, sin_round)
        if most <= 0.0:
            return 0.0, 0.0
        light, doubt = light * most, 0.5 * (1.0 - max(least, 0.0) / most)
    if node.cos_reach > -1.0:
        cosine = -(node.axis[0] * vx + node.axis[1] * vy + node.axis[2] * vz) / far if far > 0.0 else 0.0
        least, most = widened(cosine, node.cos_spread, node.sin_spread)
        least, most = widened(least, cos_round, sin_round)[0], widened(most, cos_round, sin_round)[1]
        if most < node.cos_reach or (node.fades and most <= 0.0):
            return 0.0, 0.0
        if node.fades:
            light *= most
            doubt += 0.5 * (1.0 - max(least, 0.0) / most)
        elif least < node.cos_reach:
            doubt += 0.5
    if node.lamp >= 0:
        return light, 0.0
    near = max(far - node.radius, CLOSEST * node.radius)
    doubt += 0.5 * ((far + node.radius) ** 2 / (near * near) - 1.0)
    return light, max(doubt, 0.0) * light


@inlined
def _of_point(lamps: Lamps, lamp: int, colour: int, place: Place, normal: Place, facing: bool) -> float:
    """Return the irradiance that a point lamp brings, W/m²; 0 at the lamp itself."""
    light = lamps.rows[lamp]
    position = light.position[0], light.position[1], light.position[2]
    if position == place:
        return 0.0
    ux, uy, uz, _, irradiance = illuminate_from(lamps.profiles, light, position, place[0], place[1], place[2])
    cosine = normal[0] * ux + normal[1] * uy + normal[2] * uz if facing else 1.0
    return irradiance * lamps.spectra[lamp, colour] * cosine if cosine > 0.0 else 0.0


@inlined
def widened(cosine: float, cos_more: float, sin_more: float) -> tuple[float, float]:
    """Return the cosines of the largest and of the smallest angle that differ from one by up to another.

    Parameters
    ----------
    cosine : float
        Of the angle.
    cos_more, sin_more : float
        Of the other one.
    """
    sine = np.sqrt(max(1.0 - cosine * cosine, 0.0))
    least = cosine * cos_more - sine * sin_more if cosine > -cos_more else -1.0
    most = cosine * cos_more + sine * sin_more if cosine < cos_more else 1.0
    return least, most


@inlined
def _opened(
    lamps: Lamps, colour: int, place: Place, normal: Place, settled: float, asked: NDArray[np.void]
) -> int:  # fmt: skip
    """Write the nodes that a point opens, with their estimates; return their number."""
    count, root = 0, 0
    while root < len(lamps.nodes):
        count = _added(lamps, root, colour, place, normal, asked, count)
        root = lamps.nodes[root].skip
    while 0 < count < len(asked):
        widest, whole = 0, 0.0
        for k in range(count):
            whole += asked[k].estimate
            if asked[k].doubt > asked[widest].doubt:
                widest = k
        if asked[widest].doubt <= settled * whole:
            break
        node, count = asked[widest].node, count - 1
        asked[widest].node = asked[count].node
        asked[widest].estimate, asked[widest].doubt = asked[count].estimate, asked[count].doubt
        count = _added(lamps, node + 1, colour, place, normal, asked, count)
        count = _added(lamps, lamps.nodes[node + 1].skip, colour, place, normal, asked, count)
    for k in range(count):
        asked[k].share = 1.0
    return count


@inlined
def _added(
    lamps: Lamps, number: int, colour: int, place: Place, normal: Place, asked: NDArray[np.void], count: int
) -> int:
    """Add a node to those that a point has opened, unless none of its lamps shines there; return their number."""
    light, doubt = estimate(lamps, number, colour, place, normal)
    if not light > 0.0:
        return count
    asked[count].node, asked[count].estimate, asked[count].doubt = number, light, doubt
    return count + 1


@kernel
def _thinned(asked: NDArray[np.void], count: int, most: int, u: float) -> int:
    """Keep some of more nodes, by their estimates; return their number.

    Those for which that number of draws would be one or more are kept surely; of the others each that holds one of even
    steps along the sum of their chances (systematic sampling).

    Parameters
    ----------
    asked : (MOST_NODES,) ASKED
    count, most : int
        Number of nodes, and of those that are kept.
    u : float
        Random number, uniform in [0, 1).
    """
    left, whole, more = most, 0.0, True
    while more and left > 0:
        whole, more = 0.0, False
        for k in range(count):
            if asked[k].doubt >= 0.0:
                whole += asked[k].estimate
        for k in range(count):
            if asked[k].doubt >= 0.0 and asked[k].estimate * left >= whole:
                # The rest is added up anew: beside one that is far brighter, its digits are lost.
                asked[k].doubt, left, more = -1.0, left - 1, True
                break
    kept, sum_of_chances = 0, 0.0
    for k in range(count):
        share = 1.0
        if asked[k].doubt >= 0.0:
            before = np.ceil(sum_of_chances - u)
            sum_of_chances += asked[k].estimate * left / whole
            if left == 0 or np.ceil(sum_of_chances - u) == before or kept == most:
                continue
            share = whole / (asked[k].estimate * left)
        asked[kept].node, asked[kept].share = asked[k].node, share
        kept += 1
    return kept
