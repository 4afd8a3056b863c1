"""Gradient-index glass of surfaces as lines of Zemax files; `zemax_gradients` states their meaning."""

import math
from collections.abc import Sequence

from lfmesh.errors import SceneError
from lfmesh.scene.camera.gradient import (
    AnyGradient,
    AxialGradient,
    RadialGradient,
    RadialSquareGradient,
    SphericalGradient,
    XyzGradient,
)
from lfmesh.scene.camera.lens import Surface

_TABLED = {"selfoc": "GRADIENT_9.DAT", "gradium": "PROFILE.GRD"}
"""Files of OpticStudio that hold the numbers of a kind."""

_RADIAL_AND_AXIAL = {"GRINSUR3": (3, 3), "GRINSUR5": (2, 4)}
"""Powers of r² and z of the types."""

_MOST_SQUARES, _MOST_SPHERICAL, _MOST_XYZ = 6, 2, 2
"""Terms of GRINSUR2, GRINSUR7, and of each axis in GRINSUR4."""

_STEPS = 100
"""Program's steps along the axis."""

_USUAL_STEP_MM = 0.1


def check_gradient(number: int, surface: Surface) -> None:
    """Raise a SceneError if a Zemax file cannot hold the gradient of a surface.

    Parameters
    ----------
    number : int
        Number of the surface.
    surface : Surface
    """
    gradient = surface.gradient
    if gradient is None:
        return
    if gradient.kind in _TABLED:
        raise _unwritten(number, f"its numbers stand in a file of OpticStudio, {_TABLED[gradient.kind]}")
    if getattr(gradient, "dispersion", None) is not None:
        raise _unwritten(number, "its dispersion stands in a file of OpticStudio, SGRIN.DAT", ".dispersion")
    if surface.section_key is not None or surface.terms_mm or any(surface.odd_asphere_mm):
        raise _unwritten(number, "Zemax's surfaces with a gradient are spheres or conics")


def gradient_lines(number: int, surface: Surface) -> list[str]:
    """Return the type of a surface with a gradient, and its parameters.

    Parameters
    ----------
    number : int
        Number of the surface.
    surface : Surface

    Raises
    ------
    SceneError
        No type has the gradient.
    """
    step = (surface.thickness_mm or 0.0) / _STEPS or _USUAL_STEP_MM
    kind, values = _type(number, surface.gradient)
    return [f"  TYPE {kind}", *(f"  PARM {place} {value!r}" for place, value in enumerate((step, *values), 1))]


def _type(number: int, gradient: AnyGradient | None) -> tuple[str, list[float]]:
    """Return the type of a gradient, and its parameters behind the step."""
    if isinstance(gradient, RadialSquareGradient):
        squared = gradient.index * gradient.index
        terms = [squared * value for value in gradient.coefficients]
        return "GRINSUR2", [squared, *_filled(number, terms, _MOST_SQUARES)]
    if isinstance(gradient, RadialGradient):
        return _radial_and_axial(number, gradient.index, gradient.coefficients, gradient.axial_coefficients)
    if isinstance(gradient, AxialGradient) or (
        isinstance(gradient, SphericalGradient) and math.isinf(gradient.radius_mm)
    ):
        return _radial_and_axial(number, gradient.index, (), gradient.coefficients)
    if isinstance(gradient, SphericalGradient):
        terms = _filled(number, gradient.coefficients, _MOST_SPHERICAL)
        return "GRINSUR7", [gradient.index, gradient.radius_mm, *terms]
    if isinstance(gradient, XyzGradient):
        axes = (gradient.x_coefficients, gradient.y_coefficients, gradient.z_coefficients)
        return "GRINSUR4", [gradient.index, *(term for axis in axes for term in _filled(number, axis, _MOST_XYZ))]
    raise TypeError(gradient)


def _radial_and_axial(
    number: int, index: float, radial: Sequence[float], axial: Sequence[float]
) -> tuple[str, list[float]]:  # fmt: skip
    """Return the first type with enough powers of r² and z."""
    for kind, (across, along) in _RADIAL_AND_AXIAL.items():
        if not any((*radial[across:], *axial[along:])):
            return kind, [index, *_filled(number, radial, across), *_filled(number, axial, along)]
    types = " or ".join(f"{across} powers of r² and {along} of z" for across, along in _RADIAL_AND_AXIAL.values())
    raise _unwritten(number, f"Zemax's gradients have {types}")


def _filled(number: int, coefficients: Sequence[float], count: int) -> list[float]:
    """Return a number of coefficients, with zeros at their end."""
    if any(coefficients[count:]):
        raise _unwritten(number, f"Zemax's gradient has {count} of its {len(coefficients)} coefficients")
    return [*coefficients[:count], *[0.0] * (count - len(coefficients))]


def _unwritten(number: int, why: str, key: str = "") -> SceneError:
    return SceneError(f"surfaces[{number}].gradient{key}: not written to Zemax files: {why}; write .toml")
