"""Scattering models of targets: albedo, BRDF, sampled directions and their density.

Only this module depends on the kind of a model; Lambert's comes first, as most targets are matt. A model has a branch
in each of the four functions. `evaluate` weights light from lamps and the child aimed at the camera, `sample` draws the
direction of an unaimed child, and `density` weights the two if both could find the same path. Emission by temperature
is a model too: 1 minus the surface's albedo, so everything in an isothermal room looks like a black body (Kirchhoff).
All other models are reciprocal, so the two methods agree. Interpolated normals are not; but a point knows which of its
directions leads to the light, so both methods evaluate the same number.

All functions have the parameters `scattering` (the tables), `point`, `colour` (number of the wavelength), and unit
directions of travel of the light: `incoming` or `ix, iy, iz` towards the point, `outgoing` or `ox, oy, oz` away from
it.
"""

from typing import NamedTuple

import numpy as np

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.gloss import ROWS, gloss_albedos, gloss_brdf, gloss_density, gloss_direction
from lfmesh.optics.scattering import lambertian, tangents
from lfmesh.transport.tables.scattering import LAMBERTIAN, THERMAL, ScatteringTables

Direction = tuple[float, float, float]

OUTLINE = 0.1
"""Cosine of view at a smooth surface's normal, over the cosine at its facet, below which the normal is turned."""


class Point(NamedTuple):
    """Point of a target where light arrives or leaves."""

    prim: int  # facet
    x: float
    y: float
    z: float
    nx: float  # unit normal on the side of the light
    ny: float
    nz: float
    model: int  # row of `ScatteringTables.models`
    texel: float  # value of the texture, a factor of the reflectance of the matt surface, or of the base under gloss
    smooth: bool = False  # shaded with the normal below
    sx: float = 0.0  # unit normal interpolated between the facet's corners
    sy: float = 0.0
    sz: float = 0.0
    to_light: bool = False  # packets leave the point towards the light; else they come from it
    u: float = 0.0  # random numbers, uniform in [0, 1), for a smooth point that emits by temperature
    v: float = 0.0


@inlined
def albedo(scattering: ScatteringTables, point: Point, colour: int, ix: float, iy: float, iz: float) -> float:
    """Return the scattered share of the light from a direction.

    Parameters
    ----------
    scattering : ScatteringTables
    point : Point
    colour : int
    ix, iy, iz : float
        Unit direction of the light towards the point.
    """
    model = scattering.models[point.model]
    if model.kind == LAMBERTIAN and not point.smooth:
        return scattering.parameters[model.first, colour] * point.texel
    if model.kind == THERMAL:
        return scattering.parameters[model.first, colour] - scattering.parameters[model.first + 1, colour] * point.texel
    return _other_albedo(scattering, point, colour, ix, iy, iz)


@inlined
def is_hot(scattering: ScatteringTables, row: int) -> bool:
    """Tell whether a model emits by temperature, in each direction as it absorbs.

    Parameters
    ----------
    scattering : ScatteringTables
    row : int
        Row of an emission model.
    """
    return scattering.models[row].kind == THERMAL


@inlined
def evaluate(
    scattering: ScatteringTables, point: Point, colour: int, incoming: Direction, outgoing: Direction
) -> float:  # fmt: skip
    """Return the BRDF, 1/sr: leaving radiance in one direction over irradiance from another.

    Both directions must be on the same side of the target.

    Parameters
    ----------
    scattering : ScatteringTables
    point : Point
    colour : int
    incoming, outgoing : (3,) float
        Unit directions of the light.
    """
    model = scattering.models[point.model]
    if model.kind == LAMBERTIAN and not point.smooth:
        return scattering.parameters[model.first, colour] * point.texel / np.pi
    if model.kind == THERMAL:
        return emissivity(scattering, point, colour, outgoing[0], outgoing[1], outgoing[2]) / np.pi
    return _evaluate_other(scattering, point, colour, incoming, outgoing)


@inlined
def sample(
    scattering: ScatteringTables, point: Point, colour: int, incoming: Direction, u: float, v: float
) -> tuple[float, float, float, float]:
    """Return a random direction of scattered light, and BRDF · cos θ over its density.

    Parameters
    ----------
    u, v : float
        Uniform in [0, 1).
    """
    model = scattering.models[point.model]
    if model.kind == LAMBERTIAN:
        ox, oy, oz = lambertian(point.nx, point.ny, point.nz, u, v)
        share = scattering.parameters[model.first, colour] * point.texel
        if point.smooth:
            share = np.pi * _evaluate_other(scattering, point, colour, incoming, (ox, oy, oz))
        return ox, oy, oz, share
    if model.kind == THERMAL:
        ox, oy, oz = lambertian(point.nx, point.ny, point.nz, u, v)
        return ox, oy, oz, emissivity(scattering, point, colour, ox, oy, oz)
    return _sample_gloss(scattering, point, colour, incoming, u, v)


@inlined
def density(
    scattering: ScatteringTables, point: Point, colour: int, incoming: Direction, outgoing: Direction
) -> float:  # fmt: skip
    """Return the density, 1/sr, of a direction in `sample`.

    Parameters
    ----------
    scattering, point, colour, incoming
        As for `sample`.
    outgoing : (3,) float
        Unit direction drawn.
    """
    model = scattering.models[point.model]
    if model.kind == LAMBERTIAN or model.kind == THERMAL:
        return max(0.0, point.nx * outgoing[0] + point.ny * outgoing[1] + point.nz * outgoing[2]) / np.pi
    return _density_of_gloss(scattering, point, colour, incoming, outgoing)


@inlined
def _local(nx: float, ny: float, nz: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return a direction in a local frame with the normal nx, ny, nz as its z axis."""
    ux, uy, uz, vx, vy, vz = tangents(nx, ny, nz)
    return ux * x + uy * y + uz * z, vx * x + vy * y + vz * z, nx * x + ny * y + nz * z


@inlined
def _seen_normal(point: Point, vx: float, vy: float, vz: float) -> tuple[float, float, float]:
    """Return the unit shading normal at a point seen from a direction.

    An interpolated normal that faces away is turned towards the facet's normal until it no longer does; otherwise gloss
    would be black along the body's outline.

    Parameters
    ----------
    vx, vy, vz : float
        Unit direction away from the surface.
    """
    if not point.smooth:
        return point.nx, point.ny, point.nz
    seen = point.sx * vx + point.sy * vy + point.sz * vz
    facet = point.nx * vx + point.ny * vy + point.nz * vz
    if seen >= OUTLINE * facet or facet <= 0.0:
        return point.sx, point.sy, point.sz
    share = OUTLINE - seen / facet
    x, y, z = point.sx + share * point.nx, point.sy + share * point.ny, point.sz + share * point.nz
    over = 1.0 / np.sqrt(x * x + y * y + z * z)
    return x * over, y * over, z * over


@inlined
def _smooth_light(
    point: Point, sx: float, sy: float, sz: float, lx: float, ly: float, lz: float
) -> float:  # fmt: skip
    """Return the effective cosine of incidence at a smooth surface, over the cosine at its facet.

    The plain cosine at the interpolated normal would leave facets bright up to their horizon and black beyond. The
    effective one falls smoothly to zero there: Chiang, Li and Burley, "Taming the Shadow Terminator", SIGGRAPH 2019
    Talks. It never exceeds the plain cosine, so no light is gained.

    Parameters
    ----------
    sx, sy, sz : float
        Unit shading normal.
    lx, ly, lz : float
        Unit direction of the light, away from the surface.
    """
    shaded = sx * lx + sy * ly + sz * lz
    facet = point.nx * lx + point.ny * ly + point.nz * lz
    if shaded <= 0.0 or facet <= 0.0:
        return 0.0
    both = point.nx * sx + point.ny * sy + point.nz * sz
    share = facet / (shaded * both)
    if share >= 1.0:
        return shaded / facet
    return (1.0 + share - share * share) / both


@kernel
def _other_albedo(
    scattering: ScatteringTables, point: Point, colour: int, ix: float, iy: float, iz: float
) -> float:  # fmt: skip
    """Return the albedo of a glossy or smooth point, see `albedo`; for gloss on smooth points, to first order."""
    model = scattering.models[point.model]
    nx, ny, nz = _seen_normal(point, -ix, -iy, -iz)
    light = 1.0
    if point.smooth and not point.to_light:
        light = _smooth_light(point, nx, ny, nz, -ix, -iy, -iz)
    if model.kind == LAMBERTIAN:
        return light * scattering.parameters[model.first, colour] * point.texel
    dielectric, metal = _albedos(scattering, point, colour, -(nx * ix + ny * iy + nz * iz))
    return light * (dielectric + metal)


@kernel
def emissivity(
    scattering: ScatteringTables, point: Point, colour: int, ox: float, oy: float, oz: float
) -> float:  # fmt: skip
    """Return the directional emissivity of a point with a temperature: 1 minus the albedo for uniform light.

    The albedo is that of the BRDF as traced. On a smooth point, the light removed by the facet's horizon and
    `_smooth_light` is in no table; a single direction of light gives an unbiased estimate.

    Parameters
    ----------
    scattering : ScatteringTables
    point : Point
        With a `THERMAL` model.
    colour : int
    ox, oy, oz : float
        Unit direction away from the surface.
    """
    model = scattering.models[point.model].emission
    nx, ny, nz = _seen_normal(point, ox, oy, oz)
    surface = Point(
        point.prim, point.x, point.y, point.z, nx, ny, nz, model, point.texel, False, nx, ny, nz, True, 0.0, 0.0
    )  # fmt: skip
    value = 1.0 - albedo(scattering, surface, colour, -ox, -oy, -oz)
    if not point.smooth:
        return value
    if scattering.models[model].kind == LAMBERTIAN:
        lx, ly, lz = lambertian(nx, ny, nz, point.u, point.v)
        share = scattering.parameters[scattering.models[model].first, colour] * point.texel
    else:
        lx, ly, lz, share = _sample_gloss(scattering, surface, colour, (-ox, -oy, -oz), point.u, point.v)
    if share <= 0.0:
        return value
    kept = _smooth_light(point, nx, ny, nz, lx, ly, lz) * (point.nx * lx + point.ny * ly + point.nz * lz)
    return value + share * max(0.0, 1.0 - kept / (nx * lx + ny * ly + nz * lz))


@kernel
def _albedos(scattering: ScatteringTables, point: Point, colour: int, cosine: float) -> tuple[float, float]:
    """Return the albedos of a glossy point's dielectric and metal shares, for light at a cosine of incidence."""
    model = scattering.models[point.model]
    dielectric, metal = 0.0, 0.0
    if model.metal < 1.0:
        once, rest = gloss_albedos(scattering.parameters, model.first, colour, point.texel, cosine)
        dielectric = (1.0 - model.metal) * (once + rest)
    if model.metal > 0.0:
        once, rest = gloss_albedos(scattering.parameters, model.first + ROWS, colour, 1.0, cosine)
        metal = model.metal * point.texel * (once + rest)
    return dielectric, metal


@kernel
def _evaluate_other(
    scattering: ScatteringTables, point: Point, colour: int, incoming: Direction, outgoing: Direction
) -> float:  # fmt: skip
    """Return the BRDF of a glossy or smooth point, see `evaluate`.

    On a smooth point it is the BRDF of the shading frame times `_smooth_light`, the same for both senses of following a
    path (Veach, thesis, 1997, section 5.3).
    """
    (ix, iy, iz), (ox, oy, oz) = incoming, outgoing
    model = scattering.models[point.model]
    nx, ny, nz = point.nx, point.ny, point.nz
    light = 1.0
    if point.smooth:
        if point.to_light:
            nx, ny, nz = _seen_normal(point, -ix, -iy, -iz)
            light = _smooth_light(point, nx, ny, nz, ox, oy, oz)
        else:
            nx, ny, nz = _seen_normal(point, ox, oy, oz)
            light = _smooth_light(point, nx, ny, nz, -ix, -iy, -iz)
        if light == 0.0:
            return 0.0
    if model.kind == LAMBERTIAN:
        return light * scattering.parameters[model.first, colour] * point.texel / np.pi
    arriving, leaving = _local(nx, ny, nz, -ix, -iy, -iz), _local(nx, ny, nz, ox, oy, oz)
    value = 0.0
    if model.metal < 1.0:
        value = gloss_brdf(scattering.parameters, model.first, colour, point.texel, arriving, leaving)
    if model.metal > 0.0:
        metal = gloss_brdf(scattering.parameters, model.first + ROWS, colour, 1.0, arriving, leaving)
        value = (1.0 - model.metal) * value + model.metal * point.texel * metal
    return light * value


@kernel
def _chance_of_metal(scattering: ScatteringTables, point: Point, colour: int, cosine: float) -> float:
    """Return the chance of drawing a direction from the metal share of a glossy point."""
    model = scattering.models[point.model]
    if model.metal == 0.0 or model.metal == 1.0:
        return model.metal
    dielectric, metal = _albedos(scattering, point, colour, cosine)
    return metal / (dielectric + metal) if metal > 0.0 else 0.0


@kernel
def _density_of_gloss(
    scattering: ScatteringTables, point: Point, colour: int, incoming: Direction, outgoing: Direction
) -> float:  # fmt: skip
    """Return the density of a glossy point's samples, see `density`."""
    (ix, iy, iz), (ox, oy, oz) = incoming, outgoing
    first = scattering.models[point.model].first
    nx, ny, nz = _seen_normal(point, -ix, -iy, -iz)
    arriving, leaving = _local(nx, ny, nz, -ix, -iy, -iz), _local(nx, ny, nz, ox, oy, oz)
    chance = _chance_of_metal(scattering, point, colour, arriving[2])
    value = 0.0
    if chance < 1.0:
        value = gloss_density(scattering.parameters, first, colour, point.texel, arriving, leaving)
    if chance > 0.0:
        metal = gloss_density(scattering.parameters, first + ROWS, colour, 1.0, arriving, leaving)
        value = (1.0 - chance) * value + chance * metal
    return value


@kernel
def _sample_gloss(
    scattering: ScatteringTables, point: Point, colour: int, incoming: Direction, u: float, v: float
) -> tuple[float, float, float, float]:
    """Draw a direction from a glossy point, with its weight, see `sample`."""
    ix, iy, iz = incoming
    first, texel = scattering.models[point.model].first, point.texel
    nx, ny, nz = _seen_normal(point, -ix, -iy, -iz)
    arriving = _local(nx, ny, nz, -ix, -iy, -iz)
    chance = _chance_of_metal(scattering, point, colour, arriving[2])
    if u < chance:
        u, first, texel = u / chance, first + ROWS, 1.0
    elif chance > 0.0:
        u = min((u - chance) / (1.0 - chance), 1.0)
    x, y, z = gloss_direction(scattering.parameters, first, colour, texel, arriving, u, v)
    ux, uy, uz, vx, vy, vz = tangents(nx, ny, nz)
    ox, oy, oz = x * ux + y * vx + z * nx, x * uy + y * vy + z * ny, x * uz + y * vz + z * nz
    cosine = point.nx * ox + point.ny * oy + point.nz * oz
    if cosine <= 0.0:
        # Above the shading frame's horizon, and below the facet's.
        return ox, oy, oz, 0.0
    # For the direction as stored, so that evaluation and density give the same numbers.
    density = _density_of_gloss(scattering, point, colour, incoming, (ox, oy, oz))
    if density <= 0.0:
        return ox, oy, oz, 0.0
    return ox, oy, oz, _evaluate_other(scattering, point, colour, incoming, (ox, oy, oz)) * cosine / density
