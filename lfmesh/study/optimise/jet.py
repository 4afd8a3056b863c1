"""Forward-mode derivatives: numbers that carry their derivatives through a calculation."""

from typing import Any, Union

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Number = Union["Jet", Array, float]
"""A jet, or numbers that do not depend on the variables."""


class Jet:
    """Values with their derivatives by m variables.

    Parameters
    ----------
    value : float64 array of any shape
    slope : float64 array of that shape and (m,)
    """

    __slots__ = ("slope", "value")
    # numpy leaves arithmetic with jets to this class.
    __array_ufunc__ = None

    def __init__(self, value: Any, slope: Array) -> None:
        self.value: Array = np.asarray(value, dtype=np.float64)
        self.slope = slope

    def __add__(self, other: Number) -> "Jet":
        if isinstance(other, Jet):
            return Jet(self.value + other.value, self.slope + other.slope)
        value = self.value + other
        return Jet(value, np.broadcast_to(self.slope, (*value.shape, self.slope.shape[-1])))

    __radd__ = __add__

    def __neg__(self) -> "Jet":
        return Jet(-self.value, -self.slope)

    def __sub__(self, other: Number) -> "Jet":
        return self + (-other)

    def __rsub__(self, other: Number) -> "Jet":
        return -self + other

    def __mul__(self, other: Number) -> "Jet":
        if isinstance(other, Jet):
            slope = self.value[..., None] * other.slope + other.value[..., None] * self.slope
            return Jet(self.value * other.value, slope)
        factor = np.asarray(other, dtype=np.float64)
        return Jet(self.value * factor, self.slope * factor[..., None])

    __rmul__ = __mul__

    def __truediv__(self, other: Number) -> "Jet":
        if isinstance(other, Jet):
            ratio = self.value / other.value
            slope = (self.slope - ratio[..., None] * other.slope) / other.value[..., None]
            return Jet(ratio, slope)
        return self * (1.0 / np.asarray(other, dtype=np.float64))

    def __rtruediv__(self, other: Number) -> "Jet":
        ratio = np.asarray(other, dtype=np.float64) / self.value
        return Jet(ratio, (-ratio / self.value)[..., None] * self.slope)

    def power(self, exponent: int) -> "Jet":
        """Return an integer power, 1 or more."""
        lower = self.value ** (exponent - 1)
        return Jet(lower * self.value, (exponent * lower)[..., None] * self.slope)

    def root(self) -> "Jet":
        """Return the square root, with derivative 0 at 0."""
        root = np.sqrt(self.value)
        half = np.divide(0.5, root, out=np.zeros_like(root), where=root != 0.0)
        return Jet(root, half[..., None] * self.slope)

    def picked(self, where: Any) -> "Jet":
        """Return the values selected by a numpy index."""
        return Jet(self.value[where], self.slope[where])


def constant(value: Any, variables: int) -> Jet:
    """Return constants as a jet.

    Parameters
    ----------
    value : float64 array
    variables : int
    """
    value = np.asarray(value, dtype=np.float64)
    return Jet(value, np.zeros((*value.shape, variables)))
