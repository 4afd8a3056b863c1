"""Gradient-index glass as kernels read and evaluate it: n² and ½ ∇n² at a point of the medium's own frame."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.kernels.by_address import by_address
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.kernels.vector import fused
from lfmesh.optics.gradient_shapes import (
    FOLDED,
    INDEX,
    INDEX_SQUARED,
    MATERIAL_HEADER,
    REVOLVED,
    SPHERICAL,
    GradientProfile,
)

Array = NDArray[np.float64]
ValueAndGradient = tuple[float, float, float, float]

GRADIENT = np.dtype(
    [
        ("kind", "i8"),
        ("quantity", "i8"),  # that the polynomial gives
        ("counts", "i8", (3,)),  # of coefficients, as in `GradientProfile`
        ("first", "i8"),  # first of its numbers
        ("material", "i8"),  # first of its material's numbers
    ]
)


@by_address
class Gradients(NamedTuple):
    """Index profiles in the form that kernels read."""

    rows: NDArray[np.void]  # (profiles,) GRADIENT: one for each medium and wavelength
    numbers: Array  # of all profiles, each with its material's behind


def gradient_table(profiles: Sequence[GradientProfile]) -> Gradients:
    """Return index profiles in the form that kernels read.

    Parameters
    ----------
    profiles : sequence of GradientProfile
        One for each medium and wavelength.
    """
    rows = np.zeros(len(profiles), GRADIENT)
    end = 0
    for row, profile in zip(rows, profiles, strict=True):
        row["kind"], row["quantity"], row["counts"] = profile.kind, profile.quantity, profile.counts
        row["first"], row["material"] = end, end + len(profile.numbers)
        end += len(profile.numbers) + len(profile.material)
    numbers = [np.concatenate([profile.numbers, profile.material]) for profile in profiles]
    return Gradients(rows, np.concatenate([np.zeros(0), *numbers]))


@inlined
def field_at(gradients: Gradients, number: int, x: float, y: float, z: float) -> ValueAndGradient:
    """Return n² at a point, and ½ ∇n², mm⁻¹.

    Both continue beyond the faces of the medium, and below n² = 0, as the formula does.

    Parameters
    ----------
    gradients : Gradients
    number : int
        Row of the profile.
    x, y, z : float, mm
        In the medium's own frame, with its origin at the vertex of the surface in front of it.
    """
    row = gradients.rows[number]
    if row.kind == REVOLVED:
        value, by_x, by_y, by_z = _revolved(gradients.numbers, row, x, y, z)
    elif row.kind == SPHERICAL:
        value, by_x, by_y, by_z = _spherical(gradients.numbers, row, x, y, z)
    else:
        value, by_x, by_y, by_z = _separable(gradients.numbers, row, x, y, z)
    if row.quantity == INDEX_SQUARED:
        return value, 0.5 * by_x, 0.5 * by_y, 0.5 * by_z
    squared, half_rate = value * value, value
    if row.quantity != INDEX:
        squared, half_rate = _dispersed(gradients.numbers, row.material, value)
    return squared, half_rate * by_x, half_rate * by_y, half_rate * by_z


@kernel
def n2_at(gradients: Gradients, number: int, x: float, y: float, z: float) -> float:
    """Return n² at a point.

    Parameters
    ----------
    gradients, number, x, y, z
        As in `field_at`.
    """
    return field_at(gradients, number, x, y, z)[0]


@kernel
def kick_at(gradients: Gradients, number: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return ½ ∇n² at a point, mm⁻¹.

    Parameters
    ----------
    gradients, number, x, y, z
        As in `field_at`.
    """
    _, by_x, by_y, by_z = field_at(gradients, number, x, y, z)
    return by_x, by_y, by_z


def fields_at(gradients: Gradients, number: int, points: ArrayLike) -> Array:
    """Return n² and ½ ∇n² at points, (n, 4): 1 and mm⁻¹.

    Parameters
    ----------
    gradients, number
        As in `field_at`.
    points : (n, 3) array_like, mm
    """
    at = np.ascontiguousarray(points, np.float64).reshape(-1, 3)
    fields = np.empty((len(at), 4))
    _fill(gradients, number, at, fields)
    return fields


@kernel
def _fill(gradients: Gradients, number: int, points: Array, fields: Array) -> None:
    for k in range(len(points)):
        n2, by_x, by_y, by_z = field_at(gradients, number, points[k, 0], points[k, 1], points[k, 2])
        fields[k, 0], fields[k, 1], fields[k, 2], fields[k, 3] = n2, by_x, by_y, by_z


@inlined
def _revolved(numbers: Array, row: Any, x: float, y: float, z: float) -> ValueAndGradient:
    """Derive Σ c_ij u^i z^j with u = r², by Horner's scheme in z within the one in u."""
    u = fused(x, x, y * y)
    powers_u, powers_z = row.counts[0], row.counts[1]
    value, by_u, by_z = 0.0, 0.0, 0.0
    for i in range(powers_u - 1, -1, -1):
        inner, inner_z = _polynomial(numbers, row.first + i * powers_z, powers_z, z)
        by_u = fused(by_u, u, value)
        value = fused(value, u, inner)
        by_z = fused(by_z, u, inner_z)
    by_u *= 2.0
    return value, by_u * x, by_u * y, by_z


@inlined
def _separable(numbers: Array, row: Any, x: float, y: float, z: float) -> ValueAndGradient:
    """Derive a sum of polynomials of x, of y or |y|, and of z."""
    side = -1.0 if row.kind == FOLDED and y < 0.0 else 1.0
    of_y = row.first + row.counts[0]
    of_x, by_x = _polynomial(numbers, row.first, row.counts[0], x)
    value, by_y = _polynomial(numbers, of_y, row.counts[1], side * y)
    of_z, by_z = _polynomial(numbers, of_y + row.counts[1], row.counts[2], z)
    return of_x + value + of_z, by_x, side * by_y, by_z


@inlined
def _spherical(numbers: Array, row: Any, x: float, y: float, z: float) -> ValueAndGradient:
    """Derive Σ c_i t^i, with t = R − sgn(R) d in a form without cancellation, and d the distance from (0, 0, R)."""
    radius = numbers[row.first]
    sign = np.copysign(1.0, radius)
    u, w = x * x + y * y, radius - z
    distance = np.sqrt(u + w * w)
    t = (z * (radius + w) - u) / (radius + sign * distance)
    value, rate = _polynomial(numbers, row.first + 1, row.counts[0], t)
    # At the centre the gradient has no direction.
    along = sign * rate / distance if distance > 0.0 else 0.0
    return value, -along * x, -along * y, along * w


@inlined
def _dispersed(numbers: Array, first: int, value: float) -> tuple[float, float]:
    """Return n² and ½ dn²/dv of a reference index v, see `GradientMaterial`."""
    factor, square = numbers[first], numbers[first + 1]
    terms, of_strength, of_resonance = int(numbers[first + 2]), int(numbers[first + 3]), int(numbers[first + 4])
    strengths = first + MATERIAL_HEADER
    resonances = strengths + terms * of_strength
    squared, half_rate = value * value, value
    for i in range(terms):
        k, k_rate = _polynomial(numbers, strengths + i * of_strength, of_strength, value)
        resonance, resonance_rate = _polynomial(numbers, resonances + i * of_resonance, of_resonance, value)
        per = 1.0 / (square - resonance)
        squared += factor * per * k
        half_rate += 0.5 * factor * per * (k_rate + k * resonance_rate * per)
    return squared, half_rate


@inlined
def _polynomial(numbers: Array, first: int, count: int, t: float) -> tuple[float, float]:
    """Return a polynomial of t and its derivative, by Horner's scheme."""
    value, rate = 0.0, 0.0
    for i in range(count - 1, -1, -1):
        rate = fused(rate, t, value)
        value = fused(value, t, numbers[first + i])
    return value, rate
