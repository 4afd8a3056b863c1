"""What a target does with light: its scattering model, evaluated, sampled, and with the density of the samples.

The one place that knows the models. Light from lamps is weighted by `evaluate`, and so is the child that is aimed at
the camera; a child that goes anywhere is drawn by `sample`; where light might have gone either way, `density` says how
often it goes this one. A model has its branch in each of the four functions; all are reciprocal, so that the two
methods, which walk a path in opposite ways, agree.

Directions are unit vectors along which light travels: `ix, iy, iz` towards the point, `ox, oy, oz` away from it.
"""

from typing import NamedTuple

import numpy as np

from lfmesh.kernel import inlined
from lfmesh.optics.scattering import lambertian
from lfmesh.transport.tables.scattering import LAMBERTIAN, ScatteringTables


class Point(NamedTuple):
    """A point of a target that light meets or leaves."""

    prim: int  # facet
    x: float
    y: float
    z: float
    nx: float  # unit normal on the side of the light
    ny: float
    nz: float
    model: int  # row of `ScatteringTables.models`
    texel: float  # the texture's value, a factor of what the model sends back


@inlined
def albedo(scattering: ScatteringTables, point: Point, colour: int, ix: float, iy: float, iz: float) -> float:
    """Return the share of light from a direction that is scattered."""
    model = scattering.models[point.model]
    if model.kind == LAMBERTIAN:
        return scattering.parameters[model.first, colour] * point.texel
    return 0.0


@inlined
def evaluate(
    scattering: ScatteringTables, point: Point, colour: int,
    ix: float, iy: float, iz: float, ox: float, oy: float, oz: float,
) -> float:  # fmt: skip
    """Return the BRDF, 1/sr: radiance that leaves in one direction over irradiance from another.

    It is asked for directions on the side of the light alone.
    """
    model = scattering.models[point.model]
    if model.kind == LAMBERTIAN:
        return scattering.parameters[model.first, colour] * point.texel / np.pi
    return 0.0


@inlined
def sample(
    scattering: ScatteringTables, point: Point, colour: int, ix: float, iy: float, iz: float, u: float, v: float
) -> tuple[float, float, float, float]:
    """Return a direction that light is scattered in, from two uniform numbers, and BRDF · cos θ over its density."""
    model = scattering.models[point.model]
    if model.kind == LAMBERTIAN:
        ox, oy, oz = lambertian(point.nx, point.ny, point.nz, u, v)
        return ox, oy, oz, scattering.parameters[model.first, colour] * point.texel
    return 0.0, 0.0, 0.0, 0.0


@inlined
def density(
    scattering: ScatteringTables, point: Point, colour: int,
    ix: float, iy: float, iz: float, ox: float, oy: float, oz: float,
) -> float:  # fmt: skip
    """Return the density per solid angle with which `sample` draws a direction."""
    model = scattering.models[point.model]
    if model.kind == LAMBERTIAN:
        return max(0.0, point.nx * ox + point.ny * oy + point.nz * oz) / np.pi
    return 0.0
