"""Scattering models of targets: albedo, BRDF, sampling of directions, and the density of the samples.

Only this module depends on the kind of a model; Lambert's comes first, as most targets are matt. `evaluate` weights
light from lamps and the child that is aimed at the camera; `sample` draws the direction of a child that is not aimed;
`density` gives the weight between the two where both could have found the same path. A model has a branch in each of
the four functions. All models are reciprocal, so that the two methods, which follow a path in opposite directions,
agree.

All functions have the parameters `scattering` (the tables), `point`, `colour` (number of the wavelength), and unit
directions along which light travels: `ix, iy, iz` towards the point, `ox, oy, oz` away from it.
"""

from typing import NamedTuple

import numpy as np

from lfmesh.kernel import inlined, kernel
from lfmesh.optics.gloss import gloss_albedos, gloss_brdf, gloss_density, gloss_direction
from lfmesh.optics.scattering import lambertian, tangents
from lfmesh.transport.tables.scattering import LAMBERTIAN, ScatteringTables


class Point(NamedTuple):
    """A point of a target at which light arrives or leaves."""

    prim: int  # facet
    x: float
    y: float
    z: float
    nx: float  # unit normal on the side of the light
    ny: float
    nz: float
    model: int  # row of `ScatteringTables.models`
    texel: float  # value of the texture, a factor of the reflectance of the matt surface, or of the base under gloss


@inlined
def albedo(scattering: ScatteringTables, point: Point, colour: int, ix: float, iy: float, iz: float) -> float:
    """Return the share of the light from a direction that is scattered.

    Parameters
    ----------
    scattering : ScatteringTables
    point : Point
    colour : int
        Number of the wavelength.
    ix, iy, iz : float
        Unit direction towards where the light comes from.
    """
    model = scattering.models[point.model]
    if model.kind == LAMBERTIAN:
        return scattering.parameters[model.first, colour] * point.texel
    cosine = -(point.nx * ix + point.ny * iy + point.nz * iz)
    once, rest = gloss_albedos(scattering.parameters, model.first, colour, point.texel, cosine)
    return once + rest


@inlined
def evaluate(
    scattering: ScatteringTables, point: Point, colour: int,
    ix: float, iy: float, iz: float, ox: float, oy: float, oz: float,
) -> float:  # fmt: skip
    """Return the BRDF, 1/sr: radiance that leaves in one direction over irradiance from another.

    Both directions must be on the same side of the target.

    Parameters
    ----------
    scattering : ScatteringTables
    point : Point
    colour : int
        Number of the wavelength.
    ix, iy, iz : float
        Unit direction towards where the light comes from.
    ox, oy, oz : float
        Unit direction in which it leaves.
    """
    model = scattering.models[point.model]
    if model.kind == LAMBERTIAN:
        return scattering.parameters[model.first, colour] * point.texel / np.pi
    return _evaluate_gloss(scattering, point, colour, ix, iy, iz, ox, oy, oz)


@inlined
def sample(
    scattering: ScatteringTables, point: Point, colour: int, ix: float, iy: float, iz: float, u: float, v: float
) -> tuple[float, float, float, float]:
    """Return a random direction of scattered light, and BRDF · cos θ over its density.

    Parameters
    ----------
    u, v : float
        Random numbers, uniform in [0, 1).
    """
    model = scattering.models[point.model]
    if model.kind == LAMBERTIAN:
        ox, oy, oz = lambertian(point.nx, point.ny, point.nz, u, v)
        return ox, oy, oz, scattering.parameters[model.first, colour] * point.texel
    return _sample_gloss(scattering, point, colour, ix, iy, iz, u, v)


@inlined
def density(
    scattering: ScatteringTables, point: Point, colour: int,
    ix: float, iy: float, iz: float, ox: float, oy: float, oz: float,
) -> float:  # fmt: skip
    """Return the density, 1/sr, with which `sample` draws a direction.

    Parameters
    ----------
    scattering, point, colour, ix, iy, iz
        As for `sample`.
    ox, oy, oz : float
        Unit direction drawn.
    """
    model = scattering.models[point.model]
    if model.kind == LAMBERTIAN:
        return max(0.0, point.nx * ox + point.ny * oy + point.nz * oz) / np.pi
    return _density_of_gloss(scattering, point, colour, ix, iy, iz, ox, oy, oz)


@inlined
def _local(point: Point, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return a direction in the local frame of a point, whose z axis is the normal."""
    ux, uy, uz, vx, vy, vz = tangents(point.nx, point.ny, point.nz)
    return (
        ux * x + uy * y + uz * z,
        vx * x + vy * y + vz * z,
        point.nx * x + point.ny * y + point.nz * z,
    )


@kernel
def _evaluate_gloss(
    scattering: ScatteringTables, point: Point, colour: int,
    ix: float, iy: float, iz: float, ox: float, oy: float, oz: float,
) -> float:  # fmt: skip
    """Return the BRDF of a glossy point, see `evaluate`."""
    first = scattering.models[point.model].first
    ax, ay, az = _local(point, -ix, -iy, -iz)
    bx, by, bz = _local(point, ox, oy, oz)
    return gloss_brdf(scattering.parameters, first, colour, point.texel, ax, ay, az, bx, by, bz)


@kernel
def _density_of_gloss(
    scattering: ScatteringTables, point: Point, colour: int,
    ix: float, iy: float, iz: float, ox: float, oy: float, oz: float,
) -> float:  # fmt: skip
    """Return the density of a glossy point's samples, see `density`."""
    first = scattering.models[point.model].first
    ax, ay, az = _local(point, -ix, -iy, -iz)
    bx, by, bz = _local(point, ox, oy, oz)
    return gloss_density(scattering.parameters, first, colour, point.texel, ax, ay, az, bx, by, bz)


@kernel
def _sample_gloss(
    scattering: ScatteringTables, point: Point, colour: int, ix: float, iy: float, iz: float, u: float, v: float
) -> tuple[float, float, float, float]:
    """Return a random direction from a glossy point and what it carries, see `sample`."""
    first = scattering.models[point.model].first
    ax, ay, az = _local(point, -ix, -iy, -iz)
    x, y, z = gloss_direction(scattering.parameters, first, colour, point.texel, ax, ay, az, u, v)
    ux, uy, uz, vx, vy, vz = tangents(point.nx, point.ny, point.nz)
    ox, oy, oz = x * ux + y * vx + z * point.nx, x * uy + y * vy + z * point.ny, x * uz + y * vz + z * point.nz
    # From the direction as it is stored, so that evaluation and density there give the same numbers.
    chance = _density_of_gloss(scattering, point, colour, ix, iy, iz, ox, oy, oz)
    if chance <= 0.0:
        return ox, oy, oz, 0.0
    cosine = point.nx * ox + point.ny * oy + point.nz * oz
    return ox, oy, oz, _evaluate_gloss(scattering, point, colour, ix, iy, iz, ox, oy, oz) * cosine / chance
