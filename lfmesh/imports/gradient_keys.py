"""Keys of a scene's gradient-index glass, as the readers of lens files make them."""

import math
from collections.abc import Sequence
from typing import Any

GradientKeys = dict[str, Any]

OWN_RADIUS = None
"""Radius of spheres of constant index that follow the surface in front, whose curvature may still change."""


def radial_square(index_squared: float, coefficients: Sequence[float], unit_mm: float) -> GradientKeys | None:
    """Return a gradient n² = n₀² + c₁ r² + c₂ r⁴ + ...; None if it is constant.

    Parameters
    ----------
    index_squared : float
        n₀², above 0.
    coefficients : sequence of float
        In the file's unit.
    unit_mm : float
    """
    terms = _trimmed([c / index_squared for c in in_mm(coefficients, unit_mm, 2)])
    return {"kind": "radial_n2", "index": math.sqrt(index_squared), "coefficients": terms} if terms else None


def radial_and_axial(
    index: float, radial: Sequence[float], axial: Sequence[float], unit_mm: float
) -> GradientKeys | None:
    """Return a gradient n = n₀ + c₁ r² + c₂ r⁴ + ... + d₁ z + d₂ z² + ...; None if it is constant.

    Parameters
    ----------
    index : float
    radial, axial : sequences of float
        c and d, in the file's unit.
    unit_mm : float
    """
    across, along = _trimmed(in_mm(radial, unit_mm, 2)), _trimmed(in_mm(axial, unit_mm, 1))
    if not across:
        return {"kind": "axial", "index": index, "coefficients": along} if along else None
    keys: GradientKeys = {"kind": "radial_n", "index": index, "coefficients": across}
    return keys | ({"axial_coefficients": along} if along else {})


def spherical(index: float, coefficients: Sequence[float], radius: float | None, unit_mm: float) -> GradientKeys | None:
    """Return a gradient n = n₀ + c₁ t + c₂ t² + ... with t = R − ρ; None if it is constant.

    Parameters
    ----------
    index : float
    coefficients : sequence of float
        In the file's unit.
    radius : float or None
        R, in the file's unit; `OWN_RADIUS`: that of the surface in front.
    unit_mm : float
    """
    terms = _trimmed(in_mm(coefficients, unit_mm, 1))
    size = OWN_RADIUS if radius is OWN_RADIUS else radius * unit_mm
    return {"kind": "spherical", "index": index, "coefficients": terms, "radius_mm": size} if terms else None


def xyz(
    index: float, coefficients: Sequence[Sequence[float]], unit_mm: float
) -> GradientKeys | None:  # fmt: skip
    """Return a gradient n = n₀ + Σ a_i x^i + Σ b_i y^i + Σ c_i z^i, i from 1; None if it is constant.

    Parameters
    ----------
    index : float
    coefficients : three sequences of float
        a, b and c, in the file's unit.
    unit_mm : float
    """
    terms = {
        f"{axis}_coefficients": _trimmed(in_mm(each, unit_mm, 1))
        for axis, each in zip("xyz", coefficients, strict=True)
    }
    given = {key: each for key, each in terms.items() if each}
    return {"kind": "xyz", "index": index, **given} if given else None


def in_mm(coefficients: Sequence[float], unit_mm: float, step: int) -> list[float]:
    """Return coefficients of powers step, 2 step, ... of a length, per mm in place of the file's unit.

    Parameters
    ----------
    coefficients : sequence of float
    unit_mm : float
    step : int
    """
    return [value / unit_mm ** (step * i) for i, value in enumerate(coefficients, 1)]


def _trimmed(coefficients: Sequence[float]) -> tuple[float, ...]:
    """Return coefficients without the zeros at their end."""
    count = max((i for i, each in enumerate(coefficients, 1) if each), default=0)
    return tuple(coefficients[:count])
