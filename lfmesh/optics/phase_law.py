"""The grating equation at a surface with a phase.

Along the surface, an order m changes n times the unit direction by G = m λ/2π ∇Φ, with the same sign for both
directions of travel (W. T. Welford, "A vector raytracing equation for hologram lenses of arbitrary shape", Opt. Commun.
14 (1975) 322). Reversed light therefore returns along its own path.
"""

import numpy as np

from lfmesh.kernels.decorators import inlined


@inlined
def diffracted(
    n_i: float, n_t: float, direction: tuple[float, float, float], normal: tuple[float, float, float],
    gx: float, gy: float, reflects: bool,
) -> tuple[bool, float, float, float, float]:  # fmt: skip
    """Return whether an order propagates, and the cosine and the direction that it leaves with.

    Parameters
    ----------
    n_i, n_t : float
        Indices on the sides of arrival and departure, equal for a reflected order.
    direction : (float, float, float)
        Unit direction of arrival.
    normal : (float, float, float)
        Unit normal, with a positive component along the direction.
    gx, gy : float
        m λ/2π ∇Φ in the surface's frame, with the wavelength and the gradient in mm; its z component is 0.
    reflects : bool
        True for a reflected order.

    Returns
    -------
    propagates : bool
        False for an evanescent order; the other values are then 0.
    cos_out : float
        Unsigned cosine with the normal.
    ox, oy, oz : float
        Unit direction.
    """
    dx, dy, dz = direction
    nx, ny, nz = normal
    # The component along the normal of n times the direction, plus G.
    along = n_i * (dx * nx + dy * ny + dz * nz) + gx * nx + gy * ny
    px, py, pz = n_i * dx + gx - along * nx, n_i * dy + gy - along * ny, n_i * dz - along * nz
    left = n_t * n_t - (px * px + py * py + pz * pz)
    if not left > 0.0:
        return False, 0.0, 0.0, 0.0, 0.0
    over = 1.0 / n_t
    cos_out = np.sqrt(left) * over
    ahead = -cos_out if reflects else cos_out
    return True, cos_out, px * over + ahead * nx, py * over + ahead * ny, pz * over + ahead * nz
