"""Lambertian scattering and emission: directions with a density of cos θ / π about a normal."""

import numpy as np

from lfmesh.kernels.decorators import kernel


@kernel
def tangents(nx: float, ny: float, nz: float) -> tuple[float, float, float, float, float, float]:
    """Return two unit vectors perpendicular to a unit normal and to each other (Duff et al., JCGT 6(1), 2017).

    Parameters
    ----------
    nx, ny, nz : float
        Unit normal.
    """
    sign = np.copysign(1.0, nz)
    a = -1.0 / (sign + nz)
    b = nx * ny * a
    return 1.0 + sign * nx * nx * a, sign * b, -sign * nx, b, sign + ny * ny * a, -ny


@kernel
def about(nx: float, ny: float, nz: float, cos_theta: float, phi: float) -> tuple[float, float, float]:
    """Return the unit direction at a polar angle θ and an azimuth φ about a unit axis.

    Parameters
    ----------
    nx, ny, nz : float
        The axis.
    cos_theta : float
    phi : float
        rad.
    """
    sin_theta = np.sqrt(max(0.0, (1.0 - cos_theta) * (1.0 + cos_theta)))
    return _turned(nx, ny, nz, cos_theta, sin_theta, phi)


@kernel
def near(nx: float, ny: float, nz: float, height: float, phi: float) -> tuple[float, float, float]:
    """Return the direction as in `about`, given 1 − cos θ, even for angles with a cosine that rounds to 1.

    Parameters
    ----------
    nx, ny, nz : float
        The axis.
    height : float
        1 − cos θ.
    phi : float
        rad.
    """
    return _turned(nx, ny, nz, 1.0 - height, np.sqrt(height * (2.0 - height)), phi)


@kernel
def _turned(
    nx: float, ny: float, nz: float, cos_theta: float, sin_theta: float, phi: float
) -> tuple[float, float, float]:
    """Return the direction as in `about`, given cosine and sine of θ."""
    ux, uy, uz, vx, vy, vz = tangents(nx, ny, nz)
    a, b = sin_theta * np.cos(phi), sin_theta * np.sin(phi)
    return (
        a * ux + b * vx + cos_theta * nx,
        a * uy + b * vy + cos_theta * ny,
        a * uz + b * vz + cos_theta * nz,
    )


@kernel
def lambertian(nx: float, ny: float, nz: float, u: float, v: float) -> tuple[float, float, float]:
    """Sample a unit direction about a unit normal with density cos θ / π (the paper's equation 1: cos 2θ = 1 − 2u).

    Parameters
    ----------
    nx, ny, nz : float
        The normal.
    u, v : float
        Uniform in [0, 1).
    """
    return about(nx, ny, nz, np.sqrt(1.0 - u), 2.0 * np.pi * v)
