"""Projection of a plotter's camera, which needs no window."""

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

Array = NDArray[np.float64]


def projection_matrix(plotter: pv.Plotter) -> Array:
    """Return the (4, 4) matrix from the world to normalised device coordinates, -1 to 1 across the picture."""
    width, height = plotter.window_size
    matrix = plotter.camera.GetCompositeProjectionTransformMatrix(width / height, -1.0, 1.0)
    return np.array([[matrix.GetElement(i, j) for j in range(4)] for i in range(4)])
