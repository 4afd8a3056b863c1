"""Choice of the lamps that a point samples: all if they are few, otherwise some drawn from a tree.

From the root of the tree (`tables/lamp_tree.py`), a point repeatedly opens the node with the most uncertain estimate of
its light, until all uncertainties are small against the light (Conty Estevez & Kulla, Importance sampling of many
lights with adaptive tree splitting, HPG 2018). It keeps at most `OF_MANY` of the open nodes, each with certainty or
with a probability proportional to its estimate. Within a node, one lamp is drawn on the way down by the estimates of
the two parts. Its light is divided by its probability.

The estimate of a node is zero only if its bounds show that none of its lamps shines there: below the horizon of the
point, or beyond the light of all lamps. For a single point lamp or parallel light, the estimate is the irradiance.

Packets sent past lamps, into the light scattered near them, follow another law: power over distance. A node counts as
one lamp if its lamps are about equally far; otherwise it is opened.

In a scene with motion each mover has trees of its own, and a point is moved into the frame of each.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.events.crossing import LIGHT_U, draw_two
from lfmesh.transport.events.moving import direction_between, point_between
from lfmesh.transport.lights.lamps import LIGHT_DIMENSIONS, illuminate_from
from lfmesh.transport.packets.packet import MOST_MOVERS, Options, mover_of_frame
from lfmesh.transport.tables.lights import MM2, Lamps

OF_MANY = 3
"""Largest number of lamps that a point samples if there are more than `MOST_ASKED`. More would cost more time than they
save, as other causes make the samples of a pixel differ too."""

MOST_OPENED = 96
"""Number of open nodes at which a point opens no more.

Only points among lamps need that many: there, nodes hold near and far lamps, and bounds say little about the nearest.
With lamps from 1 mm to 100 m away, the light of a point has a standard deviation of 30 times its mean with 12 nodes,
and 0.6 with 96. Most other points open some ten.
"""

MOST_NODES = MOST_OPENED + 2 * (MOST_MOVERS + 1)
"""Room for open nodes: each mover has a tree of lamps and one of parallel light."""

SETTLED = 0.5
"""Uncertainty of a node's light, over the light of all nodes, up to which it is not opened."""

CLOSEST = 0.125
"""Distance of a node's nearest lamp, over the node's radius, below which its uncertainty grows no further."""

FAR = 1.5
"""Distance of a node from a point, in its radii, above which its lamps count as one for packets sent past lamps."""

BELOW_ONE = 1.0 - 2.0**-53
"""Largest random number."""

ASKED = np.dtype(
    [
        ("node", "i8"),
        ("estimate", "f8"),  # of the light, W/m²
        ("doubt", "f8"),  # uncertainty of the estimate; negative: the node is kept with certainty
        ("lamp", "i8"),
        ("share", "f8"),  # one over the probability of sampling it
    ]
)
"""A node opened by a point, and the lamp sampled in it."""

NO_NORMAL = (0.0, 0.0, 0.0)
"""Stands for the normal at a point lit from all sides: in a medium, or on rough glass."""

Place = tuple[float, float, float]


@kernel
def lamps_to_ask(
    options: Options, lamps: Lamps, packet: Any, place: Place, normal: Place, asked: NDArray[np.void], moving: Any
) -> int:  # fmt: skip
    """Choose the lamps that a point samples; return their number.

    Parameters
    ----------
    options : Options
    lamps : Lamps
    packet : PACKET
        Source of the random numbers.
    place : (3,) float, mm
        The point, in the packet's frame.
    normal : (3,) float
        Unit normal on the lit side; `NO_NORMAL` if all sides are lit.
    asked : (MOST_NODES,) ASKED
        Output: `lamp` and `share` of the lamps to sample.
    moving : Moving or None
    """
    if len(lamps.nodes) == len(lamps.rows):
        for number in range(len(lamps.rows)):
            asked[number].lamp, asked[number].share = number, 1.0
        return len(lamps.rows)
    colour, dimension = packet.colour, LIGHT_U + LIGHT_DIMENSIONS * (len(lamps.rows) + 1)
    here = mover_of_frame(packet.frame)
    count, kept = _opened(lamps, colour, place, normal, asked, moving, here), 0
    if count > OF_MANY:
        u, _ = draw_two(options, packet, dimension)
        count = _thinned(asked, count, OF_MANY, u)
    for k in range(count):
        number, share, within = asked[k].node, asked[k].share, 1.0
        if lamps.nodes[number].lamp < 0:
            u, _ = draw_two(options, packet, dimension + LIGHT_DIMENSIONS * (k + 1))
            at, facing = _seen_from(moving, here, lamps.nodes[number].mover, place, normal)
            number, within = drawn_below(lamps, number, colour, at, facing, u, False)
        if within > 0.0:
            asked[kept].lamp, asked[kept].share = lamps.nodes[number].lamp, share / within
            kept += 1
    return kept


@kernel
def drawn_below(
    lamps: Lamps, number: int, colour: int, place: Place, normal: Place, u: float, past: bool
) -> tuple[int, float]:
    """Draw a lamp of a node; return the lamp's own node and its probability, 0 if no lamp of the node shines.

    Parameters
    ----------
    lamps : Lamps
    number : int
        Number of the node.
    colour : int
        Number of the wavelength.
    place, normal
        As for `lamps_to_ask`, in the frame of the node's mover.
    u : float
        Random number, uniform in [0, 1).
    past : bool
        Draw by `brightness_past` instead of by the irradiance.
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
        # Rescaled, the number is uniform again.
        u, chance = min(u, BELOW_ONE), chance * share
    return number, chance


@kernel
def chance_below(lamps: Lamps, number: int, lamp: int, colour: int, place: Place) -> float:
    """Return the probability that `drawn_below` draws a lamp of a node, for a packet sent past it.

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
    """Return the next node, from some number on, that counts as one lamp: a lamp, or lamps far from a point."""
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
    """Draw the lamp past which a point may send a packet, by the brightness of the glow round it; −1: there is none.

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
            # Rescaled, the number is uniform again.
            drawn, rest = number, min(choice / own, BELOW_ONE)
        choice -= own
        number = _counted(lamps, lamps.nodes[number].skip, place)
    if drawn < 0:
        return -1
    drawn, chance = drawn_below(lamps, drawn, colour, place, NO_NORMAL, rest, True)
    return lamps.nodes[drawn].lamp if chance > 0.0 else -1


@kernel
def chance_passed(lamps: Lamps, lamp: int, colour: int, place: Place) -> float:
    """Return the probability that `passed_lamp` draws a lamp.

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
    """Return the weights for drawing one of the two parts of a node."""
    if past:
        return brightness_past(lamps, left, colour, place), brightness_past(lamps, right, colour, place)
    return estimate(lamps, left, colour, place, normal)[0], estimate(lamps, right, colour, place, normal)[0]


@kernel
def brightness_past(lamps: Lamps, number: int, colour: int, place: Place) -> float:
    """Return the brightness, W/mm, of the glow round the lamps of a node as seen from a point.

    The distance is blurred by the node's radius.

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
    """Return an estimate of the irradiance that the lamps of a node bring to a point, and its uncertainty, W/m².

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
    """Return the irradiance from a point lamp, W/m²; 0 at the lamp itself."""
    light = lamps.rows[lamp]
    position = light.position[0], light.position[1], light.position[2]
    if position == place:
        return 0.0
    ux, uy, uz, _, irradiance = illuminate_from(lamps.profiles, light, position, place[0], place[1], place[2])
    cosine = normal[0] * ux + normal[1] * uy + normal[2] * uz if facing else 1.0
    return irradiance * lamps.spectra[lamp, colour] * cosine if cosine > 0.0 else 0.0


@inlined
def widened(cosine: float, cos_more: float, sin_more: float) -> tuple[float, float]:
    """Return the cosines of the largest and smallest angle within a given angle of another.

    Parameters
    ----------
    cosine : float
        Cosine of the angle.
    cos_more, sin_more : float
        Cosine and sine of the largest deviation.
    """
    sine = np.sqrt(max(1.0 - cosine * cosine, 0.0))
    least = cosine * cos_more - sine * sin_more if cosine > -cos_more else -1.0
    most = cosine * cos_more + sine * sin_more if cosine < cos_more else 1.0
    return least, most


@inlined
def _opened(
    lamps: Lamps, colour: int, place: Place, normal: Place, asked: NDArray[np.void], moving: Any, here: int
) -> int:  # fmt: skip
    """Open nodes for a point in the frame of the mover `here`, and write their estimates; return their number."""
    count, root = 0, 0
    while root < len(lamps.nodes):
        at, facing = _seen_from(moving, here, lamps.nodes[root].mover, place, normal)
        count = _added(lamps, root, colour, at, facing, asked, count)
        root = lamps.nodes[root].skip
    while 0 < count < MOST_OPENED:
        widest, whole = 0, 0.0
        for k in range(count):
            whole += asked[k].estimate
            if asked[k].doubt > asked[widest].doubt:
                widest = k
        if asked[widest].doubt <= SETTLED * whole:
            break
        node, count = asked[widest].node, count - 1
        asked[widest].node = asked[count].node
        asked[widest].estimate, asked[widest].doubt = asked[count].estimate, asked[count].doubt
        at, facing = _seen_from(moving, here, lamps.nodes[node].mover, place, normal)
        count = _added(lamps, node + 1, colour, at, facing, asked, count)
        count = _added(lamps, lamps.nodes[node + 1].skip, colour, at, facing, asked, count)
    for k in range(count):
        asked[k].share = 1.0
    return count


@inlined
def _seen_from(moving: Any, here: int, there: int, place: Place, normal: Place) -> tuple[Place, Place]:
    """Return a point and its normal moved from the frame of one mover into that of another."""
    at = point_between(moving, here, there, place[0], place[1], place[2])
    return at, direction_between(moving, here, there, normal[0], normal[1], normal[2])


@inlined
def _added(
    lamps: Lamps, number: int, colour: int, place: Place, normal: Place, asked: NDArray[np.void], count: int
) -> int:
    """Add a node to the open ones, unless none of its lamps shines at the point; return their number."""
    light, doubt = estimate(lamps, number, colour, place, normal)
    if not light > 0.0:
        return count
    asked[count].node, asked[count].estimate, asked[count].doubt = number, light, doubt
    return count + 1


@kernel
def _thinned(asked: NDArray[np.void], count: int, most: int, u: float) -> int:
    """Keep at most `most` of `count` open nodes, by their estimates; return their number.

    Nodes with an expected number of draws of one or more are kept with certainty. The others are kept by systematic
    sampling: evenly spaced steps, offset by a random number, along the sum of their probabilities.
    """
    left, whole, more = most, 0.0, True
    while more and left > 0:
        whole, more = 0.0, False
        for k in range(count):
            if asked[k].doubt >= 0.0:
                whole += asked[k].estimate
        for k in range(count):
            if asked[k].doubt >= 0.0 and asked[k].estimate * left >= whole:
                # Sum the rest anew: a far brighter node makes it lose digits.
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
