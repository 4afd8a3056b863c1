"""Distances in words."""

import math


def reach_in_words(near_mm: float, far_mm: float) -> str:
    """Return "480 mm to 1200 mm", or "480 mm to infinity"."""
    return f"{near_mm:.4g} mm to " + (f"{far_mm:.4g} mm" if math.isfinite(far_mm) else "infinity")
