"""Profile fit of an optical face: a conic with even terms through points of its curve."""

from dataclasses import dataclass

import numpy as np

from lfmesh.geometry.meshes.mesh import Array

MOST_TERMS = 8
"""Even terms besides the conic: r⁴ to r¹⁸."""

STEPS = 50
"""Most Gauss–Newton steps."""

NO_BETTER = 0.5
"""Factor by which one more term must reduce the largest residual."""

ROUNDED = 1e-11
"""Residual, over the profile's size, below which it is rounding in the file."""

SETTLED = 1e-15
"""Change of the sag by a step, over the profile's size, that is rounding in float64."""

FAR_OFF = 0.01
"""Residual of an even polynomial, over the profile's size, beyond which the points do not lie on a lens profile."""

FIRST_DAMPING = 1e-4
"""Initial damping of the least squares, over the squares of the scaled columns."""

STEEP = 0.5
"""Aperture radius over radius of curvature beyond which a parabola is a poor start for a sphere."""

FLAT_ENOUGH = 1e-12
"""Curvature times radius below which a profile is a straight line."""


@dataclass(frozen=True)
class Profile:
    """A conic with even terms.

    Attributes
    ----------
    vertex_mm : float
        Height on the axis.
    curvature_per_mm : float
    conic : float
    terms_mm : tuple of float
        Coefficients of r⁴, r⁶, ...
    residual_mm : float
        Largest distance of a point from it along the axis.
    """

    vertex_mm: float
    curvature_per_mm: float
    conic: float
    terms_mm: tuple[float, ...]
    residual_mm: float

    @property
    def radius_mm(self) -> float:
        """Vertex radius; inf if flat."""
        return 1.0 / self.curvature_per_mm if self.curvature_per_mm else np.inf


def fitted_profile(r: Array, z: Array) -> Profile | None:
    """Return the profile with the fewest terms that fits as well as one with more terms; None if none fits.

    Parameters
    ----------
    r : (n,) float64, mm
        Distances from the axis.
    z : (n,) float64, mm
        Heights along it.
    """
    size = float(r.max(initial=0.0))
    if len(r) < 3 * MOST_TERMS or not 0.0 < size + np.abs(z).max() < np.inf or not size > 0.0:
        return None
    s, h = r / size, z / size
    powers = np.stack([s ** (2 * j) for j in range(MOST_TERMS + 2)], axis=1)
    if np.abs(powers @ np.linalg.lstsq(powers, h, rcond=None)[0] - h).max() > FAR_OFF:
        return None
    sphere = _sphere_through(s, h)
    best = _refined(s, h, sphere, with_conic=False)
    for terms in range(MOST_TERMS + 1):
        if best is not None and best[1] <= ROUNDED:
            break
        # With a conic constant the least squares may converge slowly; without one they are almost linear.
        starts = [(sphere if best is None else best[0], True), (sphere, False)]
        found = [_refined(s, h, np.resize(np.append(start, np.zeros(3 + terms)), 3 + terms), with_conic=conic)
                 for start, conic in starts]  # fmt: skip
        for each in found:
            if each is not None and (best is None or each[1] < NO_BETTER * best[1]):
                best = each
    if best is None:
        return None
    vertex, c, conic, *a = best[0]
    curvature = 0.0 if abs(c) < FLAT_ENOUGH else float(c) / size
    scaled = tuple(float(each) / size ** (2 * j + 3) for j, each in enumerate(a))
    return Profile(float(vertex) * size, curvature, float(conic) if curvature else 0.0, scaled, best[1] * size)


def _sphere_through(s: Array, h: Array) -> Array:
    """Return vertex, curvature and zero conic constant of a sphere about the axis near points (s, h)."""
    (vertex, c), *_ = np.linalg.lstsq(np.stack([np.ones_like(s), 0.5 * s * s], axis=1), h, rcond=None)
    if abs(c) > STEEP:
        # From s² + (h − m)² = R², linear in m and R² − m².
        (m2, rest), *_ = np.linalg.lstsq(np.stack([h, np.ones_like(h)], axis=1), s * s + h * h, rcond=None)
        middle, square = 0.5 * m2, rest + 0.25 * m2 * m2
        if square > 1.0:
            radius = np.copysign(np.sqrt(square), c)
            return np.array([middle - radius, 1.0 / radius, 0.0])
        c = np.copysign(STEEP, c)
    return np.array([vertex, c, 0.0])


def _refined(s: Array, h: Array, start: Array, with_conic: bool) -> tuple[Array, float] | None:
    """Return vertex, curvature, conic constant and terms by damped least squares, and the largest residual.

    The method is Levenberg–Marquardt: conic constant and terms are nearly interchangeable, and undamped steps lead to
    conics that do not reach the rim.
    """
    values = start.copy()
    found = _sag_and_slopes(s, values)
    if found is None:
        return None
    free = np.ones(len(values), dtype=bool)
    free[2] = with_conic
    damping = FIRST_DAMPING
    for _ in range(STEPS):
        sag, slopes = found
        rest = h - sag
        scale = np.maximum(np.linalg.norm(slopes[:, free], axis=0), np.finfo(np.float64).tiny)
        system = np.vstack([slopes[:, free] / scale, np.sqrt(damping) * np.eye(free.sum())])
        step = np.linalg.lstsq(system, np.concatenate([rest, np.zeros(free.sum())]), rcond=None)[0]
        tried_values = values.copy()
        tried_values[free] += step / scale
        tried = _sag_and_slopes(s, tried_values)
        if tried is None or np.square(h - tried[0]).sum() > np.square(rest).sum():
            damping = 10.0 * damping
            if damping > 1.0 / FIRST_DAMPING:
                break
            continue
        values, found, damping = tried_values, tried, 0.1 * damping
        if np.abs(step).max() <= SETTLED * np.sqrt(len(s)):
            break
    return values, float(np.abs(h - found[0]).max())


def _sag_and_slopes(s: Array, values: Array) -> tuple[Array, Array] | None:
    """Return the sag (n,) and its derivatives (n, k) by each value; None if the conic does not reach."""
    vertex, c, conic, *a = values
    s2 = s * s
    square = 1.0 - (1.0 + conic) * c * c * s2
    if not 0.0 < square.min() <= square.max() < np.inf:
        return None
    root = np.sqrt(square)
    columns = [np.ones_like(s), s2 / (root * (1.0 + root)), c**3 * s2 * s2 / (2.0 * root * (1.0 + root) ** 2)]
    sag = vertex + c * s2 / (1.0 + root)
    for j, each in enumerate(a):
        columns.append(s2 ** (j + 2))
        sag = sag + each * columns[-1]
    slopes = np.stack(columns, axis=1)
    return (sag, slopes) if np.isfinite(sag).all() and np.isfinite(slopes).all() else None
