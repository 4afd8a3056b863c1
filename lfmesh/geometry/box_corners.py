"""Corners of boxes along the axes."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def corners_between(low: Array, high: Array) -> Array:
    """Return the corners of a box, (8, 3), from its lowest and its highest one, (3,) each."""
    ends = np.array([low, high])
    return np.array([[ends[i, 0], ends[j, 1], ends[k, 2]] for i, j, k in np.ndindex(2, 2, 2)])
