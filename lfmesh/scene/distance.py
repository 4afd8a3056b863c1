"""Distances in words."""

import math


def length_in_words(length_mm: float) -> str:
    """Return "480 mm", or "infinity"."""
    return f"{length_mm:.6g} mm" if math.isfinite(length_mm) else "infinity"


def reach_in_words(near_mm: float, far_mm: float, digits: int = 4) -> str:
    """Return "480 mm to 1200 mm", "480 mm to infinity", or "no distance" if both are infinite.

    Parameters
    ----------
    near_mm, far_mm : float
    digits : int
        Significant digits of the lengths.
    """
    if not math.isfinite(near_mm):
        return "no distance"
    return f"{near_mm:.{digits}g} mm to " + (f"{far_mm:.{digits}g} mm" if math.isfinite(far_mm) else "infinity")
