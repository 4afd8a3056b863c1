"""Leaf of the tree of emitting facets that a point asks, drawn on the way down by the light that each part brings.

At each node a point chooses between the two parts by bounds of their irradiance, from power, distance, the point's
horizon and the pieces' normals, but not shadows (Conty Estevez & Kulla, Importance sampling of many lights with
adaptive tree splitting, HPG 2018). If a node is far away and its pieces alike, the rest of the way follows power alone,
which is cheaper. A chance is zero only if the bounds show that no light comes.

In a scene with motion each mover has a tree of its own. A point chooses among their roots in the same way, moved into
the frame of each.
"""

from typing import Any

import numpy as np

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.events.moving import direction_between, mover_of, point_between
from lfmesh.transport.events.surface import outward
from lfmesh.transport.lights.many_lamps import BELOW_ONE, NO_NORMAL, Place, widened
from lfmesh.transport.packets.packet import IN_FOG, mover_of_frame
from lfmesh.transport.tables.tables import Emitters, ObjectTables

FAR = 2.5
"""Distance of a node, in its radii, above which the distances of its pieces differ little."""

ALIKE = 0.3
"""Least cosine of angles at a node, or at the point, over the largest one, above which pieces count as alike."""


@inlined
def lit_normal(objects: ObjectTables, packet: Any, arrives: bool, moving: Any) -> Place:
    """Return the normal, on the lit side, at the point of a packet, in its frame.

    `NO_NORMAL` in a medium, and without a tree, as nothing else uses the normal.

    Parameters
    ----------
    objects : ObjectTables
    packet : PACKET
        At the point, with its facet in `facet`; its frame may be that of another mover.
    arrives : bool
        The packet has its direction of arrival; else of departure.
    moving : Moving or None
    """
    if packet.facet == IN_FOG or len(objects.emitters.nodes) == 0:
        return NO_NORMAL
    here, own = mover_of_frame(packet.frame), mover_of(moving, objects.facets[packet.facet].body)
    x, y, z = point_between(moving, here, own, packet.x, packet.y, packet.z)
    nx, ny, nz = outward(objects, packet.facet, x, y, z)
    nx, ny, nz = direction_between(moving, own, here, nx, ny, nz)
    if (nx * packet.dx + ny * packet.dy + nz * packet.dz > 0.0) == arrives:
        return -nx, -ny, -nz
    return nx, ny, nz


@inlined
def drawn_tree(
    trees: Any, emitters: Emitters, place: Place, normal: Place, u: float, moving: Any, here: int
) -> tuple[int, float, float]:
    """Draw a tree; return its root, its chance (0: no light), and the remaining random number.

    Parameters
    ----------
    trees : (n, 2) int64 or None
        See `Emitters`; None: there is one tree, and numba compiles only the first line.
    emitters : Emitters
    place, normal
        As for `drawn_leaf`, in the frame of the mover `here`.
    u : float
        Uniform in [0, 1).
    moving : Moving or None
    here : int
    """
    if trees is None:
        return 0, 1.0, u
    whole = 0.0
    for number in range(len(trees)):
        whole += _brought_by(trees[number], emitters, place, normal, moving, here)
    rest, root, own, left = u * whole, 0, 0.0, 0.0
    for number in range(len(trees)):
        light = _brought_by(trees[number], emitters, place, normal, moving, here)
        if light > 0.0 and rest >= 0.0:
            # The remainder of the number is a new random number.
            root, own, left = trees[number, 0], light, min(rest / light, BELOW_ONE)
        rest -= light
    return root, own / whole if whole > 0.0 else 0.0, left


@inlined
def chance_of_tree(
    trees: Any, emitters: Emitters, place: Place, normal: Place, piece: int, moving: Any, here: int
) -> tuple[int, float]:
    """Return the root of the tree of a piece, and its chance in `drawn_tree`.

    Parameters
    ----------
    trees, emitters, place, normal, moving, here
        As for `drawn_tree`.
    piece : int
    """
    if trees is None:
        return 0, 1.0
    whole, root, own = 0.0, 0, 0.0
    for number in range(len(trees)):
        light, first = _brought_by(trees[number], emitters, place, normal, moving, here), trees[number, 0]
        if emitters.nodes[first].begin <= piece < emitters.nodes[first].end:
            root, own = first, light
        whole += light
    return root, own / whole if own > 0.0 else 0.0


@inlined
def _brought_by(tree: Any, emitters: Emitters, place: Place, normal: Place, moving: Any, here: int) -> float:
    """Estimate the light of a tree's pieces at a point in the frame of the mover `here`."""
    at = point_between(moving, here, tree[1], place[0], place[1], place[2])
    facing = direction_between(moving, here, tree[1], normal[0], normal[1], normal[2])
    return _brought(emitters.nodes[tree[0]], at, facing)[0]


@kernel
def drawn_leaf(emitters: Emitters, root: int, place: Place, normal: Place, u: float) -> tuple[int, float, float]:
    """Draw a leaf of a tree; return its node, its chance (0: no light), and the remaining random number.

    Parameters
    ----------
    emitters : Emitters
        With a tree.
    root : int
        First node of the tree.
    place : (3,) float, mm
        The point, in the frame of the tree's mover.
    normal : (3,) float
        Unit normal on the lit side; `NO_NORMAL`: lit from all sides.
    u : float
        Uniform in [0, 1).
    """
    nodes, number, chance = emitters.nodes, root, 1.0
    light, alike = _brought(nodes[root], place, normal)
    if not light > 0.0:
        return root, 0.0, u
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
def chance_of_leaf(emitters: Emitters, root: int, place: Place, normal: Place, piece: int) -> float:
    """Return the chance of the leaf of a piece in `drawn_leaf`.

    Parameters
    ----------
    emitters, root, place, normal
        As for `drawn_leaf`.
    piece : int
        Of the tree.
    """
    nodes, number, chance = emitters.nodes, root, 1.0
    light, alike = _brought(nodes[root], place, normal)
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
