"""Cached nodes and weights of Gauss-Legendre quadrature."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@lru_cache(maxsize=64)
def gauss_legendre(count: int) -> tuple[Array, Array]:
    """Return the nodes in (-1, 1) and the weights, which sum to 2, each (count,); both are read-only.

    numpy finds the nodes as eigenvalues, which takes milliseconds.

    Parameters
    ----------
    count : int
    """
    nodes, weights = np.polynomial.legendre.leggauss(count)
    for values in (nodes, weights):
        values.setflags(write=False)
    return nodes, weights
