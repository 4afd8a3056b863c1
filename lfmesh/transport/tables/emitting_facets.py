"""Emitting facets as light sources of the adjoint method, in pieces that are drawn by their power.

A facet is divided into 4ⁿ equal triangles, its pieces, to resolve its texture. They are numbered as Basu & Owen's
triangular van der Corput points (SIAM J. Numer. Anal. 53, 743, 2015): of the four triangles made by the midpoints of
the edges, the middle one has the base-4 digit 0 and the one at corner k has 1 + k. Close numbers mean close places, so
evenly spread random numbers give evenly spread points. The pieces of a round face are squares of its parameters,
numbered along Morton's curve.
"""

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.objects.round_faces import RoundFaces, places_in_picture, point_at, round_normal
from lfmesh.kernels.decorators import kernel
from lfmesh.transport.tables.emitter_tree import EMITTER_NODE, FEW, Bounds, emitter_tree
from lfmesh.transport.tables.scattering import mean_emission
from lfmesh.transport.tables.tables import Emitters, ObjectTables

MOST_PIECES = 1 << 14
"""Largest total number of pieces of textured facets; the table then stays in the cache."""

TEXELS_ACROSS = 4
"""Number of texels along the edge of a piece below which it is not divided further."""

GRID = 9
"""Number of points along each side of a round face's piece from which its bounds are found."""

BETWEEN = 0.1
"""Relative enlargement of those bounds, in size and angle."""

MOST_PLACES = 1 << 20
"""Largest number of texture look-ups at a time."""

PROBES = 2
"""Further divisions n of a piece: the mean of its texture is taken over the centres of the 4ⁿ parts."""


def emitter_table(objects: ObjectTables, movers: NDArray[np.int64] | None = None) -> Emitters:
    """Return the table of emitting facets, empty if there are none; `objects.emitters` is not read.

    Parameters
    ----------
    objects : ObjectTables
    movers : (targets + 1,) int64, optional
        Mover of each target and of the housing, in a scene with motion; each mover gets a tree of its own.
    """
    facets = objects.facets
    emissions = mean_emissions(objects).mean(axis=2)
    if not emissions.any():
        return no_emitters()
    edge = facets["corners"][:, 1:] - facets["corners"][:, :1]
    area = 0.5 * np.linalg.norm(np.cross(edge[:, 0], edge[:, 1]), axis=1)
    if objects.rounds is not None:
        area[objects.rounds.first :] = objects.rounds.faces["area"]
    emission = np.append(emissions, [[0.0, 0.0]], axis=0)[facets["body"]]
    bright = np.flatnonzero(np.maximum(emission[:, 0], emission.sum(axis=1)) * area > 0.0)
    if not len(bright):
        return no_emitters()
    level = _levels(objects, bright)
    count = 4**level
    facet, piece_area = np.repeat(bright, count), np.repeat(area[bright] / count, count)
    power = (emission[facet, 0] + emission[facet, 1] * _texture_means(objects, bright, level)) * piece_area
    if power.sum() <= 0.0:
        return no_emitters()
    first, levels = np.full(len(facets), -1, np.int64), np.zeros(len(facets), np.int64)
    first[bright], levels[bright] = np.cumsum(count) - count, level
    share = power / power.sum()
    place = _all_places(level, bright < _first_round(objects))
    order, nodes, trees = _trees(objects, facet, place, share, movers)
    number = np.empty(len(order), np.int64)
    number[order] = np.arange(len(order))
    until, chance = _in_leaves(share[order], nodes)
    density = chance / piece_area[order]
    return Emitters(facet[order], until, nodes, place[order], density, number, first, levels, trees)


def _all_places(level: NDArray[np.int64], triangles: NDArray[np.bool_]) -> Array:
    """Return the places of the pieces of some facets, see `Emitters`."""
    made = {
        (each, plain): _places(each, plain) for each, plain in set(zip(level.tolist(), triangles.tolist(), strict=True))
    }
    return np.concatenate([made[each, plain] for each, plain in zip(level.tolist(), triangles.tolist(), strict=True)])


def _in_leaves(share: Array, nodes: NDArray[np.void]) -> tuple[Array, Array]:
    """Return the cumulative probability of pieces within their leaf, and the probability of each, (n,)."""
    if not len(nodes):
        return np.cumsum(share), share
    leaves = nodes[nodes["right"] == 0]
    until, chance = np.empty(len(share)), np.zeros(len(share))
    for begin, end, power in zip(
        leaves["begin"].tolist(), leaves["end"].tolist(), leaves["power"].tolist(), strict=True
    ):
        if power > 0.0:
            chance[begin:end] = share[begin:end] / power
        until[begin:end] = np.cumsum(chance[begin:end])
    return until, chance


def _trees(
    objects: ObjectTables, facet: NDArray[np.int64], place: Array, share: Array, movers: NDArray[np.int64] | None
) -> tuple[NDArray[np.int64], NDArray[np.void], NDArray[np.int64] | None]:  # fmt: skip
    """Return the order of pieces in the leaves of their trees, (n,), the nodes, and `Emitters.trees`.

    Each piece has a facet, a place (see `Emitters`) and a share of the power. Without movers there is one tree. If
    facets are few there are no nodes.
    """
    if len(np.unique(facet)) <= FEW:
        return np.arange(len(facet)), np.zeros(0, EMITTER_NODE), None
    bounds = _bounds(objects, facet, place, share)
    if movers is None:
        return *emitter_tree(bounds), None
    of_piece = movers[objects.facets["body"][facet]]
    orders: list[NDArray[np.int64]] = []
    forest: list[NDArray[np.void]] = []
    trees: list[tuple[int, int]] = []
    pieces, count = 0, 0
    for mover in np.unique(of_piece):
        own = np.flatnonzero(of_piece == mover)
        order, nodes = emitter_tree(bounds.some(own))
        trees.append((count, int(mover)))
        nodes["right"][nodes["right"] > 0] += count
        nodes["begin"] += pieces
        nodes["end"] += pieces
        pieces, count = pieces + len(own), count + len(nodes)
        orders.append(own[order])
        forest.append(nodes)
    return np.concatenate(orders), np.concatenate(forest), np.array(trees, np.int64)


def _bounds(objects: ObjectTables, facet: NDArray[np.int64], place: Array, share: Array) -> Bounds:
    """Return the bounds of pieces; the parameters are as for `_trees`."""
    corners = objects.facets["corners"][facet]
    low, high = np.full((2, len(facet), 3), [[[np.inf]], [[-np.inf]]])
    for s, t in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)):
        b, c = place[:, :1] + s * place[:, 2:], place[:, 1:2] + t * place[:, 2:]
        points = (1.0 - b - c) * corners[:, 0] + b * corners[:, 1] + c * corners[:, 2]
        low, high = np.minimum(low, points), np.maximum(high, points)
    normal, spread = objects.facets["normal"][facet], np.zeros(len(facet))
    both = ~objects.one_sided[objects.facets["body"][facet]]
    bounds = Bounds(low, high, normal, spread, both, share)
    if objects.rounds is not None:
        _bound_round(objects.rounds, facet, place, bounds)
    return bounds


@kernel
def _bound_round(rounds: RoundFaces, facet: NDArray[np.int64], place: Array, bounds: Bounds) -> None:
    """Enter the bounds of the pieces of round faces, from points on a grid, enlarged for the space between."""
    for piece in range(len(facet)):
        if facet[piece] < rounds.first:
            continue
        face, low, high = rounds.faces[facet[piece] - rounds.first], bounds.low[piece], bounds.high[piece]
        normal, least = bounds.normal[piece], 1.0
        low[:], high[:], normal[:] = np.inf, -np.inf, 0.0
        for again in range(2):
            for number in range(GRID * GRID):
                s = place[piece, 0] + place[piece, 2] * (number // GRID) / (GRID - 1)
                t = place[piece, 1] + place[piece, 2] * (number % GRID) / (GRID - 1)
                point = point_at(face, s, t)
                along = round_normal(face, point[0], point[1], point[2])
                if again:
                    least = min(least, along[0] * normal[0] + along[1] * normal[1] + along[2] * normal[2])
                else:
                    for axis in range(3):
                        low[axis], high[axis] = min(low[axis], point[axis]), max(high[axis], point[axis])
                        normal[axis] += along[axis]
            if not again:
                length = np.sqrt(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2])
                if length > BETWEEN * GRID * GRID:
                    normal /= length
                else:
                    normal[0], normal[1], normal[2] = 0.0, 0.0, 0.0
        wider = BETWEEN * max(high[0] - low[0], high[1] - low[1], high[2] - low[2])
        low -= wider
        high += wider
        length = abs(normal[0]) + abs(normal[1]) + abs(normal[2])
        bounds.spread[piece] = min((1.0 + BETWEEN) * np.arccos(max(least, -1.0)), np.pi) if length > 0.0 else np.pi


def mean_emissions(objects: ObjectTables) -> Array:
    """Return each target's radiance averaged over directions and summed over its sides, (targets, 2, wavelengths).

    The two values are the radiance at texture 0 and the amount that a texture of 1 adds, each the largest over the
    media at the target.
    """
    means = np.zeros((len(objects.radiance), 2, objects.radiance.shape[1]))
    behind = objects.scattering.models["behind"]
    for body, radiance in enumerate(objects.radiance):
        rows = [body] if objects.glass is None else np.unique(objects.glass.models[body]).tolist()
        means[body] = np.max([radiance * mean_emission(objects.scattering, row) for row in rows], axis=0)
        if not objects.one_sided[body]:
            others = [radiance * mean_emission(objects.scattering, int(behind[row])) for row in rows]
            means[body] += np.max(others, axis=0)
    return means


def no_emitters() -> Emitters:
    """Return the table of a scene without emitting targets."""
    none, empty = np.zeros(0, np.int64), np.zeros(0)
    return Emitters(none, empty, np.zeros(0, EMITTER_NODE), np.zeros((0, 3)), empty, none, none, none)


def _levels(objects: ObjectTables, bright: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the number of divisions of each of some facets, (n,)."""
    texture = objects.texture[objects.facets["body"][bright]]
    texels = objects.uv[bright] * texture[:, None, :0:-1]
    across = np.linalg.norm(texels - np.roll(texels, 1, axis=1), axis=2).max(axis=1)
    across = np.where(bright < _first_round(objects), across, texture[:, 1:].max(axis=1))
    wanted = np.ceil(np.log2(np.maximum(across / TEXELS_ACROSS, 1.0))).astype(np.int64)
    level = np.zeros_like(wanted)
    for most in range(int(wanted.max()), 0, -1):
        level = np.minimum(wanted, most)
        if (4**level).sum() <= MOST_PIECES:
            return level
    return np.zeros_like(wanted)


def corner_weights(level: int) -> Array:
    """Return the barycentric coordinates of the corners of a triangle's pieces, (4**level, 3 corners, 3)."""
    pieces = np.eye(3)[None]
    for _ in range(level):
        a, b, c = pieces[:, 0], pieces[:, 1], pieces[:, 2]
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        four = [(bc, ca, ab), (a, ab, ca), (ab, b, bc), (ca, bc, c)]
        pieces = np.stack([np.stack(corners, axis=1) for corners in four], axis=1).reshape(-1, 3, 3)
    return pieces


def square_corners(level: int) -> Array:
    """Return the lower left corners, (4**level, 2), of the pieces of the unit square."""
    corners, size = np.zeros((1, 2)), 1.0
    for _ in range(level):
        size *= 0.5
        corners = (corners[:, None] + size * np.array([[0, 0], [1, 0], [0, 1], [1, 1]])).reshape(-1, 2)
    return corners


def _places(level: int, triangles: bool) -> Array:
    """Return the places of the pieces of a facet, or of a round face, see `Emitters`."""
    if not triangles:
        return np.column_stack([square_corners(level), np.full(4**level, 0.5**level)])
    corners = corner_weights(level)
    return np.column_stack([corners[:, 0, 1:], corners[:, 1, 1] - corners[:, 0, 1]])


def _first_round(objects: ObjectTables) -> int:
    """Return the number of the first round face among the facets."""
    return len(objects.facets) if objects.rounds is None else objects.rounds.first


def _in_texture(objects: ObjectTables, facets: NDArray[np.int64], level: int) -> Array:
    """Return the texture coordinates of the centres of the pieces of facets, or of round faces, (n, 4**level, 2)."""
    first = _first_round(objects)
    if facets[0] < first:
        return np.einsum("kc,ncd->nkd", corner_weights(level).mean(axis=1), objects.uv[facets])
    s, t = (square_corners(level) + 0.5 * 0.5**level).T
    return np.stack([places_in_picture(objects.rounds.faces[facet - first], s, t) for facet in facets])


def _texture_means(objects: ObjectTables, bright: NDArray[np.int64], level: NDArray[np.int64]) -> Array:
    """Return the mean of the texture over each piece and over the wavelengths; 1 without a texture."""
    texture = objects.texture[objects.facets["body"][bright]]
    count = 4**level
    means = np.ones(int(count.sum()))
    starts = np.cumsum(count) - count
    weights = objects.texel_weights.mean(axis=0) if len(objects.texel_weights) else None
    alike = np.column_stack([texture, level, bright >= _first_round(objects)])
    for kind in np.unique(alike[texture[:, 1] > 0], axis=0):
        start, height, width, depth, _ = (int(value) for value in kind)
        texels = objects.texels[start : start + height * width]
        picture = (texels.mean(axis=1) if weights is None else texels @ weights).reshape(height, width)
        own = np.flatnonzero((alike == kind).all(axis=1))
        for some in np.array_split(own, -(-len(own) * 4 ** (depth + PROBES) // MOST_PLACES)):
            values = _between_texels(picture, _in_texture(objects, bright[some], depth + PROBES))
            pieces = starts[some, None] + np.arange(4**depth)
            means[pieces] = values.reshape(len(some), 4**depth, -1).mean(axis=2)
    return means


def _between_texels(picture: Array, places: Array) -> Array:
    """Return a picture's values, (height, width), at places (..., 2) in it, bilinear and clamped as for rays."""
    height, width = picture.shape
    column = np.clip(places[..., 0] * width - 0.5, 0.0, width - 1.0)
    row = np.clip((1.0 - places[..., 1]) * height - 0.5, 0.0, height - 1.0)
    left, low = column.astype(np.int64), row.astype(np.int64)
    right, next_row = np.minimum(left + 1, width - 1), np.minimum(low + 1, height - 1)
    s, t = row - low, column - left
    upper = (1.0 - t) * picture[low, left] + t * picture[low, right]
    return (1.0 - s) * upper + s * ((1.0 - t) * picture[next_row, left] + t * picture[next_row, right])
