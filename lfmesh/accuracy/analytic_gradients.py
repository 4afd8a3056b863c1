"""Gradient-index glass of the analytic truth: the index by its formula, and rays by extrapolation; see `analytic`.

It shares no code with the engine. The gradient of n² is that of the formula along an imaginary step, which loses no
digits (W. Squire, G. Trapp, SIAM Review 40, 1998, 110). The rays dr/dσ = T, dT/dσ = ½ ∇n² are integrated by the
modified midpoint rule, extrapolated to steps of length 0 (W. B. Gragg, SIAM J. Numer. Anal. 2, 1965, 384).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from lfmesh.accuracy.analytic_rays import Array
from lfmesh.optics.glass import Medium, refractive_index
from lfmesh.scene.camera.gradient import (
    AxialGradient,
    Gradient,
    GradientDispersion,
    GradiumGradient,
    RadialGradient,
    RadialSquareGradient,
    SelfocGradient,
    SphericalGradient,
    XyzGradient,
)

STEP = 1e-30
"""Imaginary step over the unit of length."""

SUBSTEPS = (2, 4, 6, 8, 10, 12, 14, 16)
"""Substeps of the midpoint rules that are extrapolated. The result has order 16."""

FEWEST_PIECES, MOST_PIECES = 4, 256
PROBES = 64
"""Rays, evenly out of all, that decide on the number of pieces of a path."""

ROUNDINGS = 64
"""Accepted change by halved pieces, in units of the rounding error of the position."""

CORRECTIONS = 12
"""Steps by Newton's method onto the face."""

Height = Callable[[Any], tuple[Any, Any]]
"""Function from points (n, 3) to z minus the sag of a face, (n,), and its gradient, (n, 3)."""


@dataclass(frozen=True)
class GradientIndex:
    """Index of gradient-index glass at one wavelength.

    Attributes
    ----------
    gradient : Gradient
    wavelength_nm : float
    vertex_z : float, mm
        Vertex of the surface in front of the glass.
    """

    gradient: Gradient
    wavelength_nm: float
    vertex_z: float = 0.0

    def at(self, p: Array) -> Array:
        """Return the index at points (n, 3), mm."""
        return np.asarray(np.sqrt(self._square(*self._own(p).T + 0j).real))

    def follow(
        self, p: Array, d: Array, height: Height, samples: int = FEWEST_PIECES
    ) -> tuple[Array, Array, Array]:  # fmt: skip
        """Return points and unit directions at which rays meet the next face, and points of the paths.

        Parameters
        ----------
        p, d : (n, 3) float
            Positions on the face behind the rays, mm, and unit directions.
        height : callable
            Of the next face.
        samples : int
            Smallest number of points of a path.

        Returns
        -------
        (n, 3) float, (n, 3) float
            NaN for rays that do not meet it.
        (samples or more, n, 3) float, mm
        """
        start = np.concatenate([p, d * self.at(p)[:, None]], axis=1)
        length = -height(p)[0] / start[:, 5]
        pieces = max(samples, self._pieces(start, length))
        state, points = start, []
        for _ in range(pieces):
            state = self._extrapolated(state, length / pieces)
            points.append(state[:, :3])
        for _ in range(CORRECTIONS):
            above, normal = height(state[:, :3])
            change = -above / (normal * state[:, 3:]).sum(axis=1)
            state = self._extrapolated(state, change)
            if not np.any(np.abs(change) > 4 * np.finfo(change.dtype).eps * np.abs(length)):
                break
        along = state[:, 3:]
        return state[:, :3], along / np.sqrt((along * along).sum(axis=1))[:, None], np.array(points)

    def _own(self, p: Array) -> Array:
        return p - np.array([0, 0, self.vertex_z], p.dtype)

    def _square(self, x: Any, y: Any, z: Any) -> Any:
        return n2_of(self.gradient, self.wavelength_nm, x, y, z)

    def _rates(self, state: Array) -> Array:
        """Return T and ½ ∇n² of rays, (n, 6)."""
        kind = state.dtype.type
        x, y, z = self._own(state[:, :3]).T
        imaginary, real = 1j * kind(STEP), 0j * kind(0)
        squares = (
            self._square(x + imaginary, y + real, z + real),
            self._square(x + real, y + imaginary, z + real),
            self._square(x + real, y + real, z + imaginary),
        )
        return np.concatenate([state[:, 3:], np.stack([s.imag / (2 * kind(STEP)) for s in squares], axis=1)], axis=1)

    def _extrapolated(self, state: Array, step: Array) -> Array:
        """Return rays after a step in σ of their own, (n,)."""
        kind = state.dtype.type
        rates = self._rates(state)
        row: list[Array] = []
        for k, count in enumerate(SUBSTEPS):
            part = (step / kind(count))[:, None]
            # Changes, not states, since extrapolation multiplies rounding errors.
            before, now = 0 * state, part * rates
            for _ in range(count - 1):
                before, now = now, before + 2 * part * self._rates(state + now)
            above, row = row, [(before + now + part * self._rates(state + now)) / 2]
            for j in range(k):
                ratio = (kind(count) / kind(SUBSTEPS[k - 1 - j])) ** 2
                row.append(row[j] + (row[j] - above[j]) / (ratio - 1))
        return state + row[-1]

    def _pieces(self, start: Array, length: Array) -> int:
        """Return a number of pieces of all paths that is enough for some of them."""
        some = np.linspace(0, len(start) - 1, min(PROBES, len(start))).astype(np.int64)
        pieces, coarse = FEWEST_PIECES, None
        while pieces < MOST_PIECES:
            fine = start[some]
            for _ in range(pieces):
                fine = self._extrapolated(fine, length[some] / pieces)
            if coarse is not None:
                change = np.abs(fine - coarse)[:, :3]
                rounding = np.finfo(change.dtype).eps * np.abs(fine[:, :3]).max(axis=1, keepdims=True)
                if not np.any(change > ROUNDINGS * rounding):
                    break
            pieces, coarse = 2 * pieces, fine
        return pieces


Index = float | GradientIndex
"""Refractive index of a medium."""


def index_behind(medium: Medium, wavelength_nm: float, vertex_z: float) -> Index:
    """Return the index of the medium behind a surface.

    Parameters
    ----------
    medium : Medium
    wavelength_nm : float, nm
    vertex_z : float, mm
        Of the surface.
    """
    if isinstance(medium, Gradient):
        return GradientIndex(medium, wavelength_nm, vertex_z)
    return refractive_index(medium, wavelength_nm)


def index_at(index: Index, p: Array) -> float | Array:
    """Return the index of a medium, or the indices at points (n, 3)."""
    return index.at(p) if isinstance(index, GradientIndex) else index


def n2_of(gradient: Gradient, wavelength_nm: float, x: Any, y: Any, z: Any) -> Any:
    """Return n² at points.

    Parameters
    ----------
    gradient : Gradient
    wavelength_nm : float
    x, y, z : (n,) complex, mm
        From the vertex of the surface in front.

    Returns
    -------
    (n,) complex
    """
    kind = x.real.dtype.type
    r2 = x * x + y * y
    match gradient:
        case RadialSquareGradient():
            return kind(gradient.index) ** 2 * (1 + _series(gradient.coefficients, r2))
        case RadialGradient():
            n = kind(gradient.index) + _series(gradient.coefficients, r2) + _series(gradient.axial_coefficients, z)
        case AxialGradient():
            n = kind(gradient.index) + _series(gradient.coefficients, z)
        case SphericalGradient():
            n = kind(gradient.index) + _series(gradient.coefficients, _depth(gradient.radius_mm, r2, z))
        case XyzGradient():
            n = kind(gradient.index) + _series(gradient.x_coefficients, x) + _series(gradient.y_coefficients, y)
            n = n + _series(gradient.z_coefficients, z)
        case SelfocGradient():
            per2 = 1 / (kind(wavelength_nm) / 1000) ** 2
            b, c = (kind(each) for each in gradient.index)
            k0, k1, k2 = (kind(each) for each in gradient.gradient_constant_per_mm)
            root = k0 + k1 * per2 + k2 * per2 * per2
            return ((b + c * per2) * (1 - root * root * r2 / 2)) ** 2
        case GradiumGradient():
            constant, *others = gradient.coefficients
            n = kind(constant) + _series(others, (z + kind(gradient.offset_mm)) / kind(gradient.blank_mm))
        case _:
            raise NotImplementedError(f"{type(gradient).__name__}: the truth has no such gradient")
    return n * n if gradient.dispersion is None else _dispersed(gradient.dispersion, wavelength_nm, n)


def _series(coefficients: Any, x: Any) -> Any:
    """Return the sum of coefficients times x, x², ..."""
    kind, total = x.real.dtype.type, 0 * x
    for coefficient in reversed(coefficients):
        total = (total + kind(coefficient)) * x
    return total


def _depth(radius_mm: float, r2: Any, z: Any) -> Any:
    """Return R − sgn(R) √(r² + (R − z)²), without the difference of large numbers."""
    if np.isinf(radius_mm):
        return z + 0 * r2
    radius = r2.real.dtype.type(radius_mm)
    distance = np.sign(radius) * np.sqrt(r2 + (radius - z) ** 2)
    return (2 * radius * z - z * z - r2) / (radius + distance)


def _dispersed(dispersion: GradientDispersion, wavelength_nm: float, reference: Any) -> Any:
    """Return n² at a wavelength from the index at the reference wavelength."""
    kind = reference.real.dtype.type
    square, of_reference = ((kind(nm) / 1000) ** 2 for nm in (wavelength_nm, dispersion.reference_nm))
    total = 0 * reference
    for strength, resonance in zip(dispersion.strengths, dispersion.resonances_um2, strict=True):
        (k0, *ks), (l0, *ls) = strength, resonance
        total = total + (kind(k0) + _series(ks, reference)) / (square - kind(l0) - _series(ls, reference))
    return reference * reference + (square - of_reference) * total
