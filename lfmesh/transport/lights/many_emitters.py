"""Leaf of the tree of emitting facets that a point asks, drawn on the way down by the light that each part brings.

At each node a point chooses between the two parts by bounds of their irradiance, from power, distance, the point's
horizon and the pieces' normals, but not shadows (Conty Estevez & Kulla, Importance sampling of many lights with
adaptive tree splitting, HPG 2018). If a node is far away and its pieces alike, the rest of the way follows power alone,
which is cheaper. A chance is zero only if the bounds show that no light comes.
"""

from typing import Any

import numpy as np

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.events.surface import outward
from lfmesh.transport.lights.many_lamps import BELOW_ONE, NO_NORMAL, Place, widened
from lfmesh.transport.packets.packet import IN_FOG
from lfmesh.transport.tables.tables import Emitters, ObjectTables

FAR = 2.5
"""Distance of a node, in its radii, above which the distances of its pieces differ little."""

ALIKE = 0.3
"""Least cosine of angles at a node, or at the point, over the largest one, above which pieces count as alike."""


@inlined
def lit_normal(objects: ObjectTables, packet: Any, arrives: bool) -> Place:
    """Return the normal, on the lit side, at the point of a packet; `NO_NORMAL` in a medium.

    Parameters
    ----------
    objects : ObjectTables
    packet : PACKET
        At the point, with its facet in `facet`.
    arrives : bool
        The packet has its direction of arrival; else of departure.
    """
    if packet.facet == IN_FOG:
        return NO_NORMAL
    nx, ny, nz = outward(objects, packet.facet, packet.x, packet.y, packet.z)
    if (nx * packet.dx + ny * packet.dy + nz * packet.dz > 0.0) == arrives:
        return -nx, -ny, -nz
    return nx, ny, nz


@kernel
def drawn_leaf(emitters: Emitters, place: Place, normal: Place, u: float) -> tuple[int, float, float]:
    """Draw a leaf of the tree; return its node, its chance (0: no light), and the remaining random number.

    Parameters
    ----------
    emitters : Emitters
        With a tree.
    place : (3,) float, mm
        The point, object frame.
    normal : (3,) float
        Unit normal on the lit side; `NO_NORMAL`: lit from all sides.
    u : float
        Uniform in [0, 1).
    """
    nodes, number, chance = emitters.nodes, 0, 1.0
    light, alike = _brought(nodes[0], place, normal)
    if not light > 0.0:
        return 0, 0.0, u
    while nodes[number].right > 0:
        share, alike_left, alike_right = _share(nodes, number, place, normal, alike)
        if share < 0.0:
            return number, 0.0, u
        # The remainder of the number is a new random number.
        if u < share:
            number, u, chance, alike = number + 1, u / share, chance * share, alike_left
        else:
            u = (u - share) / (1.0 - share)
            number, chance, alike = nodes[number].right, chance * (1.0 - share), alike_right
        u = min(u, BELOW_ONE)
    return number, chance, u


@kernel
def chance_of_leaf(emitters: Emitters, place: Place, normal: Place, piece: int) -> float:
    """Return the chance of the leaf of a piece in `drawn_leaf`.

    Parameters
    ----------
    emitters, place, normal
        As for `drawn_leaf`.
    piece : int
    """
    nodes, number, chance = emitters.nodes, 0, 1.0
    light, alike = _brought(nodes[0], place, normal)
    if not light > 0.0:
        return 0.0
    while nodes[number].right > 0:
        share, alike_left, alike_right = _share(nodes, number, place, normal, alike)
        if share < 0.0:
            return 0.0
        if piece < nodes[number + 1].end:
            number, chance, alike = number + 1, chance * share, alike_left
        else:
            number, chance, alike = nodes[number].right, chance * (1.0 - share), alike_right
    return chance


@inlined
def _share(nodes: Any, number: int, place: Place, normal: Place, alike: bool) -> tuple[float, bool, bool]:
    """Return the chance of a node's first part, −1 if neither brings light, and whether the pieces of each are alike.

    Parameters
    ----------
    alike : bool
        The pieces of the node itself are alike.
    """
    left, right = nodes[number + 1], nodes[nodes[number].right]
    one, other, alike_left, alike_right = left.power, right.power, True, True
    if not alike:
        one, alike_left = _brought(left, place, normal)
        other, alike_right = _brought(right, place, normal)
    if not one + other > 0.0:
        return -1.0, alike_left, alike_right
    return one / (one + other), alike_left, alike_right


@inlined
def _brought(node: Any, place: Place, normal: Place) -> tuple[float, bool]:
    """Estimate the light of a node's pieces at a point; tell whether they look alike."""
    vx, vy, vz = node.middle[0] - place[0], node.middle[1] - place[1], node.middle[2] - place[2]
    d2, r2 = vx * vx + vy * vy + vz * vz, node.radius * node.radius
    nearest2 = max(d2 - r2, 0.25 * r2)
    if nearest2 <= 0.0 or node.power <= 0.0:
        return 0.0, True
    light, alike = node.power / nearest2, d2 > FAR * FAR * r2
    if d2 <= r2:
        return light, False
    over_far = 1.0 / np.sqrt(d2)
    turn = node.radius * over_far
    if normal[0] != 0.0 or normal[1] != 0.0 or normal[2] != 0.0:
        cosine = (normal[0] * vx + normal[1] * vy + normal[2] * vz) * over_far
        if cosine + turn <= 0.0:
            return 0.0, True
        light *= min(cosine + turn, 1.0)
        alike = alike and cosine - turn >= ALIKE * (cosine + turn)
    cosine = -(node.axis[0] * vx + node.axis[1] * vy + node.axis[2] * vz) * over_far
    least, most = widened(abs(cosine) if node.both else cosine, node.cos_spread, node.sin_spread)
    # Over the sphere the direction turns by its arc sine, and the cosine changes by no more.
    least, most = least - 0.5 * np.pi * turn, most + 0.5 * np.pi * turn
    if most <= 0.0:
        return 0.0, True
    return light * min(most, 1.0), alike and least >= ALIKE * most
