"""Surface of a target at a point: shading normal, texture, opacity and emission."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.objects.round_faces import place_in_picture, point_at, round_normal
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.events.bending import squared_index_ratio
from lfmesh.transport.events.facets import barycentric
from lfmesh.transport.events.moving import mover_of, point_between
from lfmesh.transport.events.scattering import Point, emissivity, is_hot
from lfmesh.transport.packets.children import EMITTED
from lfmesh.transport.packets.random import derived, uniform
from lfmesh.transport.tables.motions import STILL
from lfmesh.transport.tables.tables import AIR, BY_ALPHA, ObjectTables
from lfmesh.transport.tables.varied_gloss import drawn_model

Array = NDArray[np.float64]

VARIED = 1 << 40
"""Offset, in a packet's key, of the first facet's random numbers for its scattering model."""


@inlined
def point_of(
    objects: ObjectTables, packet: Any, prim: int, place: tuple[float, float, float], side: float, to_light: bool
) -> Point:  # fmt: skip
    """Return a point on one side of a facet, with its scattering model and texture value.

    Parameters
    ----------
    objects : ObjectTables
    packet : PACKET
        Its wavelength and medium apply at the point.
    prim : int
        Facet.
    place : (3,) float, mm
    side : float
        1: the side that the normal points to, −1: the other.
    to_light : bool
        Packets leave it towards the light, as in the adjoint method.
    """
    x, y, z = place
    texel = _texture_at(objects, prim, packet.colour, x, y, z)
    facet = objects.facets[prim]
    nx, ny, nz = outward(objects, prim, x, y, z)
    nx, ny, nz = side * nx, side * ny, side * nz
    model = objects.model[prim]
    if len(objects.varied.ranges) > 0:
        model = _drawn_model(objects, packet, prim, model, x, y, z)
    model = _model_in(objects.glass, model, packet.medium)
    if side < 0.0:
        model = objects.scattering.models[model].behind
    if not objects.smooth[facet.body]:
        return Point(prim, x, y, z, nx, ny, nz, model, texel, False, nx, ny, nz, to_light, 0.0, 0.0)
    sx, sy, sz = _interpolated_normal(facet, side, x, y, z)
    return Point(prim, x, y, z, nx, ny, nz, model, texel, True, sx, sy, sz, to_light, 0.0, 0.0)


@inlined
def outward(objects: ObjectTables, prim: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return the unit normal of a facet, or of a round face at a point.

    Parameters
    ----------
    objects : ObjectTables
    prim : int
    x, y, z : float, mm
    """
    return _outward(objects.rounds, objects, prim, x, y, z)


@inlined
def _outward(
    rounds: Any, objects: ObjectTables, prim: int, x: float, y: float, z: float
) -> tuple[float, float, float]:  # fmt: skip
    """Return the result of `outward`; `rounds` : RoundFaces or None, for which numba omits the branch."""
    # Two conditions: numba omits the code if the first alone is known to be false.
    if rounds is not None:  # noqa: SIM102
        if prim >= rounds.first:
            return round_normal(rounds.faces[prim - rounds.first], x, y, z)
    normal = objects.facets[prim].normal
    return normal[0], normal[1], normal[2]


@inlined
def spread(objects: ObjectTables, prim: int, u: float, v: float) -> tuple[float, float]:
    """Map two random numbers, uniform in [0, 1), evenly to a facet.

    Parameters
    ----------
    objects : ObjectTables
    prim : int
    u, v : float

    Returns
    -------
    b, c : float
        Barycentric weights of the second and third corner; for a round face, its parameters.
    """
    return _spread(objects.rounds, prim, u, v)


@inlined
def _spread(rounds: Any, prim: int, u: float, v: float) -> tuple[float, float]:
    """Return the result of `spread`; `rounds` : RoundFaces or None."""
    if rounds is not None:  # noqa: SIM102
        if prim >= rounds.first:
            return u, v
    return (1.0 - u, 1.0 - v) if u + v > 1.0 else (u, v)


@inlined
def place_on(objects: ObjectTables, prim: int, b: float, c: float) -> tuple[float, float, float]:
    """Return a point of a facet, mm.

    Parameters
    ----------
    objects : ObjectTables
    prim : int
    b, c : float
        As returned by `spread`.
    """
    return _place_on(objects.rounds, objects, prim, b, c)


@inlined
def _place_on(
    rounds: Any, objects: ObjectTables, prim: int, b: float, c: float
) -> tuple[float, float, float]:  # fmt: skip
    """Return the result of `place_on`; `rounds` : RoundFaces or None."""
    if rounds is not None:  # noqa: SIM102
        if prim >= rounds.first:
            return point_at(rounds.faces[prim - rounds.first], b, c)
    corner = objects.facets[prim].corners
    a = 1.0 - b - c
    return (
        a * corner[0, 0] + b * corner[1, 0] + c * corner[2, 0],
        a * corner[0, 1] + b * corner[1, 1] + c * corner[2, 1],
        a * corner[0, 2] + b * corner[1, 2] + c * corner[2, 2],
    )


@kernel
def _drawn_model(objects: ObjectTables, packet: Any, prim: int, model: int, x: float, y: float, z: float) -> int:
    """Return the row of a facet's scattering model, drawn among the models that a picture mixes at the point, if any.

    Without a picture it is `model`. The random numbers belong to the packet, its event and the facet. Light sampled at
    the point and light scattered there may use different models; each is weighted by the densities of its own.
    """
    varied = objects.varied
    if varied.range_of[prim] < 0:
        return model
    facet = objects.facets[prim]
    first, height, width = varied.picture[facet.body, 0], varied.picture[facet.body, 1], varied.picture[facet.body, 2]
    row, column = _place_in(facet, varied.uv[prim], height, width, x, y, z)
    roughness = _between_texels(varied.roughness, first, height, width, row, column)
    metallic = _between_texels(varied.metallic, first, height, width, row, column)
    key = derived(packet.key, VARIED + prim)
    u, v = uniform(key, 2 * packet.events), uniform(key, 2 * packet.events + 1)
    return drawn_model(varied, varied.range_of[prim], roughness, metallic, u, v)


@inlined
def _model_in(glass: Any, model: int, medium: int) -> int:
    """Return the row of a scattering model for the medium at the point, since gloss depends on the relative index.

    `model` is the row for the first medium of the target. `glass` is None if there is only one medium; numba then
    compiles only the first line.
    """
    if glass is None:
        return model
    return glass.models[model, medium]


@inlined
def emission_of(objects: ObjectTables, point: Point, key: np.uint64) -> Point:
    """Return a point with the scattering model of its emission.

    Parameters
    ----------
    objects : ObjectTables
    point : Point
    key : uint64
        Key of the packet.
    """
    row = objects.scattering.models[point.model].emission
    smooth = point.smooth and is_hot(objects.scattering, row)
    u, v = 0.0, 0.0
    if smooth:
        u, v = uniform(derived(key, EMITTED), 0), uniform(derived(key, EMITTED), 1)
    return Point(
        point.prim, point.x, point.y, point.z, point.nx, point.ny, point.nz, row, point.texel,
        smooth, point.sx, point.sy, point.sz, point.to_light, u, v,
    )  # fmt: skip


@kernel
def _interpolated_normal(facet: Any, side: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return the unit normal interpolated between a facet's corners, on its front (`side` 1) or back (−1)."""
    b, c = barycentric(facet, x, y, z)
    at = facet.corner_normals
    a = 1.0 - b - c
    nx = a * at[0, 0] + b * at[1, 0] + c * at[2, 0]
    ny = a * at[0, 1] + b * at[1, 1] + c * at[2, 1]
    nz = a * at[0, 2] + b * at[1, 2] + c * at[2, 2]
    over = side / np.sqrt(nx * nx + ny * ny + nz * nz)
    return nx * over, ny * over, nz * over


@inlined
def _texture_at(objects: ObjectTables, prim: int, colour: int, x: float, y: float, z: float) -> float:
    """Return the texture's value at a point of a facet (linear light, bilinear, clamped); 1 without a texture."""
    body = objects.facets[prim].body
    height = objects.texture[body, 1]
    if height == 0:
        return 1.0
    first, width = objects.texture[body, 0], objects.texture[body, 2]
    row, column = _texel_at(objects.rounds, objects, prim, height, width, x, y, z)
    left, low = int(np.floor(column)), int(np.floor(row))
    right_share, low_share = column - left, row - low
    # No views of rows: counting a view's references costs more than the reads.
    in_bands = len(objects.texel_weights) > 0
    value = 0.0
    for j in range(2):
        for k in range(2):
            r = min(max(low + j, 0), height - 1)
            s = min(max(left + k, 0), width - 1)
            share = (low_share if j else 1.0 - low_share) * (right_share if k else 1.0 - right_share)
            texel = first + r * width + s
            if in_bands:
                for primary in range(objects.texel_weights.shape[1]):
                    value += share * objects.texels[texel, primary] * objects.texel_weights[colour, primary]
            else:
                value += share * objects.texels[texel, colour]
    return value


@inlined
def _texel_at(
    rounds: Any, objects: ObjectTables, prim: int, height: int, width: int, x: float, y: float, z: float
) -> tuple[float, float]:
    """Return row and column of a target's texture at a point, like `_place_in`; `rounds` : RoundFaces or None."""
    if rounds is not None:  # noqa: SIM102
        if prim >= rounds.first:
            u, v = place_in_picture(rounds.faces[prim - rounds.first], x, y, z)
            return (1.0 - v) * height - 0.5, u * width - 0.5
    return _place_in(objects.facets[prim], objects.uv[prim], height, width, x, y, z)


@inlined
def _place_in(
    facet: Any, uv: Array, height: int, width: int, x: float, y: float, z: float
) -> tuple[float, float]:  # fmt: skip
    """Return row and column of a facet's picture at a point, counted from the centre of the first texel."""
    b, c = barycentric(facet, x, y, z)
    a = 1.0 - b - c
    u = a * uv[0, 0] + b * uv[1, 0] + c * uv[2, 0]
    v = a * uv[0, 1] + b * uv[1, 1] + c * uv[2, 1]
    return (1.0 - v) * height - 0.5, u * width - 0.5


@inlined
def _between_texels(
    values: NDArray[np.float32], first: int, height: int, width: int, row: float, column: float
) -> float:
    """Return the bilinear, clamped value of a picture with its texels from `first` on."""
    low, left = min(max(row, 0.0), height - 1.0), min(max(column, 0.0), width - 1.0)
    j, k = min(int(low), max(height - 2, 0)), min(int(left), max(width - 2, 0))
    s, t = low - j, left - k
    place = first + j * width + k
    down, right = (width if height > 1 else 0), (1 if width > 1 else 0)
    upper = (1.0 - t) * values[place] + t * values[place + right]
    return (1.0 - s) * upper + s * ((1.0 - t) * values[place + down] + t * values[place + down + right])


@kernel
def opacity_at(objects: ObjectTables, prim: int, x: float, y: float, z: float) -> float:
    """Return the opacity of a target at a point of a facet: a constant, or its texture's alpha (bilinear, clamped).

    Parameters
    ----------
    prim : int
        Facet.
    x, y, z : float, mm
    """
    body = objects.facets[prim].body
    if objects.opacity[body] != BY_ALPHA:
        return objects.opacity[body]
    height, width = objects.texture[body, 1], objects.texture[body, 2]
    row, column = _texel_at(objects.rounds, objects, prim, height, width, x, y, z)
    return _between_texels(objects.alpha, objects.alpha_first[body], height, width, row, column)


@inlined
def emitted_radiance(
    objects: ObjectTables, packet: Any, point: Point, ox: float, oy: float, oz: float, moving: Any
) -> float:  # fmt: skip
    """Return the radiance emitted by a point into the packet's medium, scaled for the packet's weight, W/(m² sr).

    Parameters
    ----------
    objects : ObjectTables
    packet : PACKET
    point : Point
    ox, oy, oz : float
        Unit direction away from the surface.
    moving : Moving or None
    """
    radiance = objects.radiance[objects.facets[point.prim].body, packet.colour]
    if radiance <= 0.0:
        return 0.0
    source = emission_of(objects, point, derived(packet.key, packet.events))
    hot = is_hot(objects.scattering, source.model)
    # Radiance over n² is conserved. A black body's grows as n² and is tabulated for the medium round the bodies.
    index = objects.media.indices[AIR if hot else packet.medium, packet.colour]
    radiance /= index * index
    if hot:
        return radiance * emissivity(objects.scattering, source, packet.colour, ox, oy, oz)
    x, y, z = point_between(moving, mover_of(moving, objects.facets[point.prim].body), STILL, point.x, point.y, point.z)
    return radiance * point.texel / squared_index_ratio(objects.fields, packet, x, y, z)
