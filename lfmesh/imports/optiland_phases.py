"""Phases and gratings of optiland's files.

A `PhaseInteractionModel` adds the gradient of its `phase_profile`, in rad/mm, to the wave vector along the surface, as
a scene's phase does; its optical path has the opposite sign, which no ray shows. A `DiffractiveInteractionModel` has
its grating in the geometry, with the period in µm and the grooves at an angle from x, and turns light by
p' = p + m λ/d: its tests hold OpticStudio's gratings against that. Both follow optiland 0.6.
"""

import math
from collections.abc import Mapping
from typing import Any

from lfmesh.imports import phase_keys
from lfmesh.imports.phase_keys import PhaseKeys, whole_order
from lfmesh.scene.quantities import LARGEST

MODEL, GRATING_MODEL = "PhaseInteractionModel", "DiffractiveInteractionModel"

GRATINGS = ("PlaneGrating", "StandardGratingGeometry")
"""Geometries with grooves."""

_ONE_MM = 1.0


def profile_phase(profile: Mapping[str, Any]) -> tuple[PhaseKeys | None, float]:
    """Return the phase of a `phase_profile`, None if it has no effect, and its efficiency.

    Raises
    ------
    ValueError
        It cannot be read.
    """
    kind = profile.get("phase_type")
    if kind == "constant":
        _number(profile, "phase", 0.0)
        return None, 1.0
    if kind == "linear_grating":
        direction_deg = math.degrees(_number(profile, "angle", 0.0))
        order = whole_order(_number(profile, "order", 1.0))
        efficiency = _number(profile, "efficiency", 1.0)
        if not 0.0 <= efficiency <= 1.0:
            raise ValueError(f"efficiency = {efficiency:g} must lie between 0 and 1")
        return phase_keys.grating(1.0 / _period(profile), direction_deg, order), efficiency
    if kind == "radial":
        terms = profile.get("coefficients")
        if not isinstance(terms, list):
            raise ValueError("coefficients must be a list")
        return phase_keys.radial([_number({"coefficient": term}, "coefficient") for term in terms], _ONE_MM, 1), 1.0
    if kind in ("grid", "height_profile"):
        raise ValueError(f"a phase_profile {kind} is not read: a scene has the phase of a grid in a file of its own")
    raise ValueError(f"a phase_profile of type {str(kind)[:30]} is not read; constant, linear_grating and radial are")


def groove_phase(geometry: Mapping[str, Any]) -> PhaseKeys | None:
    """Return the phase of a flat grating, or None if it has no effect; ValueError if it cannot be read."""
    if math.isfinite(geometry.get("radius", math.inf)):
        raise ValueError("a curved grating is not read: optiland's grooves on it lie in no parallel planes")
    direction_deg = 90.0 + math.degrees(_number(geometry, "angle"))
    return phase_keys.grating(1e3 / _period(geometry), direction_deg, whole_order(_number(geometry, "order")))


def _period(entry: Mapping[str, Any]) -> float:
    period = _number(entry, "period")
    if not period > 0.0:
        raise ValueError(f"period = {period:g} must be above 0")
    return period


def _number(entry: Mapping[str, Any], key: str, default: float | None = None) -> float:
    """Return a finite number; ValueError if the file has another value, or none where there is no default."""
    value = entry.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{key} must be a number")
    if not abs(value) <= LARGEST:
        raise ValueError(f"{key} = {str(value)[:30]} must be {LARGEST:g} or less in magnitude")
    return float(value)
