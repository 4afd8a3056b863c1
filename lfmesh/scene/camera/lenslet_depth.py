"""Shape of a lenslet's face: depth in the plate, rise above its apex, and words for it."""

import math
from collections.abc import Sequence

_HEIGHTS = 256
"""Number of distances from the axis at which the depth is checked."""


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
    """Return the distance from a lenslet's axis, or a cylinder's line of apexes, to the farthest corner of its cell.

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
    """Return the shape of non-spherical lenslets, such as "aspheres" or "cylinders along y", else "".

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
    """Return a face's largest rise above its apex and its largest depth within its cell, both 0 or more.

    Parameters
    ----------
    radius_mm, conic : float
    terms : (n,) float
        Coefficients of r⁴, r⁶, ...
    corner_mm : float
        Distance of the cell's corner.
    """
    heights = [sag_mm(radius_mm, conic, terms, corner_mm * i / _HEIGHTS) for i in range(_HEIGHTS + 1)]
    return -min(heights), max(heights)
