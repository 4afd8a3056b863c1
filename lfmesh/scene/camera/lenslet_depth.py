"""Shape of a lenslet's face: how deep it is cut into the plate, how far it rises over its apex, and in words."""

import math
from collections.abc import Sequence

_HEIGHTS = 256
"""Distances from the axis at which the depth is checked."""


def sag_mm(radius_mm: float, conic: float, terms: Sequence[float], height_mm: float) -> float:
    """Return the depth of a lenslet's face at a height from its axis, by ISO 10110-12.

    Parameters
    ----------
    radius_mm, conic : float
    terms : (n,) float
        Coefficients of r⁴, r⁶, ...
    height_mm : float
    """
    c, r2 = 1 / radius_mm, height_mm * height_mm
    conic_sag = c * r2 / (1 + math.sqrt(max(0.0, 1 - (1 + conic) * c * c * r2)))
    return conic_sag + sum(a * r2 ** (j + 2) for j, a in enumerate(terms))


def cell_corner_mm(pitch_mm: float, layout: str, cylinder_axis: str | None) -> float:
    """Return the distance from a lenslet's axis to its cell's farthest corner; of a cylinder from its line of apexes.

    Parameters
    ----------
    pitch_mm : float
    layout : str
        "square" or "hexagonal".
    cylinder_axis : str or None
    """
    if cylinder_axis is not None:
        return pitch_mm / 2
    return pitch_mm / math.sqrt(3.0 if layout == "hexagonal" else 2.0)


def profile_words(conics: Sequence[float], terms: Sequence[Sequence[float]], cylinder_axis: str | None) -> str:
    """Return what lenslets are where they are no spheres, as "aspheres" or "cylinders along y"; else nothing.

    Parameters
    ----------
    conics : (types,) float
    terms : (types, n) float
    cylinder_axis : str or None
    """
    kind = "aspheres" if any(map(any, terms)) else "conics" if any(conics) else ""
    if cylinder_axis is None:
        return kind
    return f"{'a' if kind else ''}cylinders along {cylinder_axis}"


def highest_and_deepest_mm(
    radius_mm: float, conic: float, terms: Sequence[float], corner_mm: float
) -> tuple[float, float]:
    """Return how far a face rises over its apex within its cell, and how deep it is there, both 0 or more.

    Parameters
    ----------
    radius_mm, conic : float
    terms : (n,) float
        Coefficients of r⁴, r⁶, ...
    corner_mm : float
        Distance of the cell's corner from the axis.
    """
    heights = [sag_mm(radius_mm, conic, terms, corner_mm * i / _HEIGHTS) for i in range(_HEIGHTS + 1)]
    return -min(heights), max(heights)
