"""Shapes of surfaces that are none of revolution: biconics and toroids, cylinders among them.

Each is a `Form`, and a field of `Surface`. The keys of the surface itself (`radius_mm`, `conic`, and of a toroid
`asphere_mm`) are those of the section y–z. OpticStudio calls the two biconic and toroidal.
"""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from lfmesh.scene.model import Model
from lfmesh.scene.quantities import Number, Radius

if TYPE_CHECKING:
    from lfmesh.scene.camera.lens import Surface

Heights = TypeVar("Heights", float, NDArray[np.float64])
"""One height, or coordinate, or an array of them."""

AZIMUTHS = 33
"""Azimuths in a quarter turn at which gaps between surfaces are measured that are not both of revolution."""

PLACES, PASSES = 512, 3
"""Places along y at which it is sought how far a toroid reaches, and how often, each time between the neighbours of the
place found before."""

BEFORE_END = 1e-5
"""Share of that by which a toroid counts as ended before, for the places in between."""


class Form(Model):
    """A shape of surface in place of one of revolution; what it does not override is that of its section y–z."""

    symmetric: ClassVar[bool] = False
    """It is symmetric about x and about y, so that a quarter turn tells all of it."""
    without: ClassVar[tuple[str, ...]] = ("asphere_mm", "odd_asphere_mm", "qcon", "qbfs", "mesh")
    """Keys of the surface that it does not go with."""

    def sag_at_mm(self, surface: "Surface", x_mm: Heights, y_mm: Heights) -> Heights:
        """Return z above the vertex plane at a point, in mm; where it has ended, a finite number.

        Parameters
        ----------
        surface : Surface
            Whose form it is: it has the keys of the section y–z.
        x_mm, y_mm : float or array
        """
        raise NotImplementedError

    def reach_mm(self, surface: "Surface") -> float:
        """Return the height up to which it exists at every azimuth, in mm."""
        return reach_of_conic_mm(surface.vertex_radius_mm, surface.vertex_conic)

    def curvature_x_per_mm(self, surface: "Surface") -> float:
        """Return the curvature at the vertex in the section x–z."""
        return surface.curvature_per_mm

    def in_words(self) -> str:
        """Return its keys with their values.

        Returns
        -------
        str
        """
        return " and ".join(f"{key} = {value:g}" for key, value in self.model_dump().items())


class Biconic(Form):
    """The section x–z of a biconic."""

    symmetric = True
    radius_x_mm: Radius
    """Radius of curvature at the vertex in the section x–z, in mm; inf is flat."""
    conic_x: Number = 0.0
    """Conic constant in the section x–z."""

    def sag_at_mm(self, surface: "Surface", x_mm: Heights, y_mm: Heights) -> Heights:
        """Return z above the vertex plane at a point.

        Parameters
        ----------
        surface, x_mm, y_mm
            As for `Form`.

        Returns
        -------
        float or array
            mm.
        """
        c_x, c_y = curvature(self.radius_x_mm), surface.curvature_per_mm
        return biconic_sag_mm(c_x, self.conic_x, c_y, surface.conic, x_mm, y_mm)

    def reach_mm(self, surface: "Surface") -> float:
        """Return the height at which the first of its conics turns back.

        Parameters
        ----------
        surface : Surface
            That this is the form of.

        Returns
        -------
        float
            mm; infinite where none turns back.
        """
        return min(super().reach_mm(surface), reach_of_conic_mm(self.radius_x_mm, self.conic_x))

    def curvature_x_per_mm(self, surface: "Surface") -> float:
        """Return its own curvature.

        Parameters
        ----------
        surface : Surface
            That this is the form of.

        Returns
        -------
        float
            1/mm.
        """
        return curvature(self.radius_x_mm)


class Toroid(Form):
    """The section x–z of a toroid."""

    symmetric = True
    without = ("odd_asphere_mm", "qcon", "qbfs", "mesh")
    radius_x_mm: Radius
    """Radius of the circle that is the section x–z, in mm: the distance from the vertex to the line, parallel to y,
    about which the curve of the section y–z turns. Positive towards the sensor; inf is a cylinder's."""

    def sag_at_mm(self, surface: "Surface", x_mm: Heights, y_mm: Heights) -> Heights:
        """Return z above the vertex plane at a point.

        Parameters
        ----------
        surface, x_mm, y_mm
            As for `Form`.

        Returns
        -------
        float or array
            mm.
        """
        return toroid_sag_mm(curvature(self.radius_x_mm), surface.sag_mm(y_mm), x_mm)

    def reach_mm(self, surface: "Surface") -> float:
        """Return the height at which it turns back at some azimuth.

        Parameters
        ----------
        surface : Surface
            That this is the form of.

        Returns
        -------
        float
            mm; infinite where it does not.
        """
        return _toroid_reach_mm(surface)

    def curvature_x_per_mm(self, surface: "Surface") -> float:
        """Return that of its circle.

        Parameters
        ----------
        surface : Surface
            That this is the form of.

        Returns
        -------
        float
            1/mm.
        """
        return curvature(self.radius_x_mm)


def reach_of_conic_mm(radius_mm: float, conic: float) -> float:
    """Return the height at which a conic turns back and ends."""
    return abs(radius_mm) / math.sqrt(1 + conic) if conic > -1 else math.inf


@lru_cache(maxsize=256)
def _toroid_reach_mm(surface: "Surface") -> float:
    most = reach_of_conic_mm(surface.vertex_radius_mm, surface.vertex_conic)
    return toroid_reach_mm(surface.curvature_x_per_mm, surface.sag_mm, most)


def curvature(radius_mm: float) -> float:
    """Return 1/radius, 0 for a flat section."""
    return 0.0 if math.isinf(radius_mm) else 1.0 / radius_mm


def biconic_sag_mm(c_x: float, conic_x: float, c_y: float, conic_y: float, x: Heights, y: Heights) -> Heights:
    """Return (c_x x² + c_y y²) / (1 + √(1 − (1 + k_x) c_x² x² − (1 + k_y) c_y² y²)), where it ends: at its end.

    Parameters
    ----------
    c_x, conic_x, c_y, conic_y : float
        Curvatures, 1/mm, and conic constants.
    x, y : float or array, mm
    """
    square = (1.0 + conic_x) * (c_x * x) ** 2 + (1.0 + conic_y) * (c_y * y) ** 2
    return (c_x * x * x + c_y * y * y) / (1.0 + np.sqrt(np.maximum(0.0, 1.0 - square)))


def toroid_sag_mm(c_x: float, along_y_mm: Heights, x: Heights) -> Heights:
    """Return the sag of a toroid, whose curve has a sag along y, at a distance x from that curve, mm.

    From (1/c_x − z)² + x² = (1/c_x − f)²: z = f + c_x x² / (1 − c_x f + √((1 − c_x f)² − c_x² x²)).

    Parameters
    ----------
    c_x : float, 1/mm
    along_y_mm : float or array
        The curve's sag f.
    x : float or array, mm
    """
    rest = 1.0 - c_x * along_y_mm
    below = rest + np.sqrt(np.maximum(0.0, rest * rest - (c_x * x) ** 2))
    divisor: Any = np.where(below > 0.0, below, np.inf)
    return along_y_mm + c_x * x * x / divisor


def toroid_reach_mm(c_x: float, curve: Callable[[NDArray[np.float64]], NDArray[np.float64]], most_mm: float) -> float:
    """Return the height up to which a toroid exists at every azimuth, a little less than measured, in mm.

    It exists where c_x² x² < (1 − c_x f(y))², that is up to the least y² + (1/c_x − f(y))², squared.

    Parameters
    ----------
    c_x : float, 1/mm
    curve : function
        Sags f of the section y–z by heights.
    most_mm : float
        Where that section ends.
    """
    if c_x == 0.0:
        return most_mm
    least = min(most_mm, 1.0 / abs(c_x))
    low, high = 0.0, least
    for _ in range(PASSES):
        y = np.linspace(low, high, PLACES + 1)
        ends = np.hypot(y, np.maximum(0.0, 1.0 - c_x * curve(y)) / c_x)
        k = int(ends.argmin())
        low, high = y[max(k - 1, 0)], y[min(k + 1, PLACES)]
    return min(least, float(ends.min())) * (1.0 - BEFORE_END)
