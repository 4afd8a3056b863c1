"""Keys of a scene's phases, as the readers of lens files make them."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from lfmesh.scene.camera.orders import MOST_ORDER

PhaseKeys = dict[str, Any]
Point = tuple[float, float, float]

CURVED_HOLOGRAM = "a hologram on a curved surface is not supported: its phase depends on z"

_FAR_MM = 1e12
"""Distance of construction points of plane waves; files write 1e10 to 1e18."""


def radial(coefficients_rad: Sequence[float], radius_mm: float, order: int) -> PhaseKeys | None:
    """Return a phase Σ A_i (r/radius)^(2i), i from 1; None if it has no effect.

    Parameters
    ----------
    coefficients_rad : sequence of float
    radius_mm : float
    order : int
    """
    terms = list(coefficients_rad)
    while terms and not terms[-1]:
        terms.pop()
    if not terms or not order:
        return None
    return {"kind": "radial", "coefficients_rad": terms, "radius_mm": radius_mm, "order": order}


def zones(parts: Sequence[tuple[Sequence[float], float]], border_mm: float, offset_rad: float, order: int) \
        -> PhaseKeys | None:  # fmt: skip
    """Return a phase of two zones, Σ A_i (r/radius)^(2i) in each; None if it turns no light.

    Parameters
    ----------
    parts : sequence of two
        Coefficients in rad, and radius in mm, of the inner and the outer zone.
    border_mm : float
    offset_rad : float
        Constant phase of the outer zone.
    order : int
    """
    if not order or not any(any(coefficients) for coefficients, _ in parts):
        return None
    tables: list[PhaseKeys] = []
    for coefficients, radius_mm in parts:
        terms = list(coefficients) or [0.0]
        while len(terms) > 1 and not terms[-1]:
            terms.pop()
        tables.append({"coefficients_rad": terms, "radius_mm": radius_mm})
    tables[0]["border_mm"], tables[1]["offset_rad"] = border_mm, offset_rad
    return {"kind": "zones", "zones": tables, "order": order}


def xy(coefficients_rad: Mapping[tuple[int, int], float], radius_mm: float, order: int) -> PhaseKeys | None:
    """Return a phase Σ A (x/radius)^i (y/radius)^j; None if it has no effect.

    Parameters
    ----------
    coefficients_rad : mapping
        A by (i, j).
    radius_mm : float
    order : int
    """
    terms = [(i, j, value) for (i, j), value in coefficients_rad.items() if value and i + j]
    if not terms or not order:
        return None
    return {"kind": "xy", "coefficients_rad": terms, "radius_mm": radius_mm, "order": order}


def grating(lines_per_mm: float, direction_deg: float, order: int) -> PhaseKeys | None:
    """Return the phase of a ruled grating; None if it has no effect.

    Parameters
    ----------
    lines_per_mm : float
        A negative number reverses the order.
    direction_deg : float
        Direction of the grating vector from +x.
    order : int
    """
    if not lines_per_mm or not order:
        return None
    order = order if lines_per_mm > 0.0 else -order
    return {"kind": "grating", "lines_per_mm": abs(lines_per_mm), "direction_deg": direction_deg, "order": order}


def hologram(
    points_mm: Sequence[Point], virtual: Sequence[bool], construction_nm: float, order: int
) -> PhaseKeys | None:
    """Return the phase of a hologram; its order 1 turns the light of point 1 into that of point 2.

    Light diverges from a real point and converges to a virtual one.

    Parameters
    ----------
    points_mm : sequence of two points
    virtual : sequence of two bool
    construction_nm : float
    order : int
    """
    if not order or (points_mm[0] == points_mm[1] and virtual[0] == virtual[1]):
        return None
    names = ["virtual" if each else "real" for each in virtual]
    keys = {"kind": "hologram", "construction_nm": construction_nm, "order": order}
    return keys | {"point_1_mm": points_mm[0], "point_2_mm": points_mm[1], "point_1": names[0], "point_2": names[1]}


def point_mm(x: float, y: float, z: float, unit_mm: float) -> Point:
    """Return a construction point in mm, in the same direction but nearer where it is out of range.

    Parameters
    ----------
    x, y, z : float
        In the file's unit.
    unit_mm : float
    """
    largest = max(abs(x), abs(y), abs(z)) * unit_mm
    scale = unit_mm if largest <= _FAR_MM else _FAR_MM / max(abs(x), abs(y), abs(z))
    return x * scale, y * scale, z * scale


def whole_order(value: float) -> int:
    """Return a diffraction order; ValueError unless it is a whole number within the limits of a scene."""
    if value != math.floor(value) or abs(value) > MOST_ORDER:
        raise ValueError(f"a diffraction order must be a whole number up to {MOST_ORDER} in magnitude")
    return int(value)
