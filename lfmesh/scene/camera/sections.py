"""Surfaces with another section in x than in y: biconics and toroids, cylinders among them.

Both have a plane of symmetry in x and one in y. The keys of the surface itself (`radius_mm`, `conic`, and of a toroid
`asphere_mm`) are those of the section y–z; here stands what is different in the section x–z. They are the surfaces that
OpticStudio calls biconic and toroidal.
"""

import math
from collections.abc import Callable

from lfmesh.scene.model import Model
from lfmesh.scene.quantities import Number, Radius

AZIMUTHS = 33
"""Azimuths in a quarter turn at which gaps between surfaces are measured that are not both of revolution."""

PLACES = 512
"""Places along y at which it is sought how far a toroid reaches."""

BEFORE_END = 1e-5
"""Share of that by which a toroid counts as ended before, for the places in between."""


class Biconic(Model):
    """The section x–z of a biconic."""

    radius_x_mm: Radius
    """Radius of curvature at the vertex in the section x–z, in mm; inf is flat."""
    conic_x: Number = 0.0
    """Conic constant in the section x–z."""


class Toroid(Model):
    """The section x–z of a toroid."""

    radius_x_mm: Radius
    """Distance from the vertex to the line, parallel to y, about which the curve of the section y–z turns, in mm,
    positive towards the sensor: the radius of the circle that is the section x–z. inf is a cylinder's."""


def curvature(radius_mm: float) -> float:
    """Return 1/radius, 0 for a flat section."""
    return 0.0 if math.isinf(radius_mm) else 1.0 / radius_mm


def biconic_sag_mm(c_x: float, conic_x: float, c_y: float, conic_y: float, x: float, y: float) -> float:
    """Return (c_x x² + c_y y²) / (1 + √(1 − (1 + k_x) c_x² x² − (1 + k_y) c_y² y²)), where it ends: at its end.

    Parameters
    ----------
    c_x, conic_x, c_y, conic_y : float
        Curvatures, 1/mm, and conic constants.
    x, y : float, mm
    """
    square = (1.0 + conic_x) * (c_x * x) ** 2 + (1.0 + conic_y) * (c_y * y) ** 2
    return (c_x * x * x + c_y * y * y) / (1.0 + math.sqrt(max(0.0, 1.0 - square)))


def toroid_sag_mm(c_x: float, along_y_mm: float, x: float) -> float:
    """Return the sag of a toroid, whose curve has a sag along y, at a distance x from that curve, mm.

    From (1/c_x − z)² + x² = (1/c_x − f)²: z = f + c_x x² / (1 − c_x f + √((1 − c_x f)² − c_x² x²)).

    Parameters
    ----------
    c_x : float, 1/mm
    along_y_mm : float
        The curve's sag f.
    x : float, mm
    """
    rest = 1.0 - c_x * along_y_mm
    root = math.sqrt(max(0.0, rest * rest - (c_x * x) ** 2))
    return along_y_mm + (c_x * x * x / (rest + root) if rest + root > 0.0 else 0.0)


def toroid_reach_mm(c_x: float, curve: Callable[[float], float], most_mm: float) -> float:
    """Return the height up to which a toroid exists at every azimuth, a little less than measured, in mm.

    It exists where c_x² x² < (1 − c_x f(y))², that is up to the least y² + (1/c_x − f(y))², squared.

    Parameters
    ----------
    c_x : float, 1/mm
    curve : function
        Sag f of the section y–z by height.
    most_mm : float
        Where that section ends.
    """
    if c_x == 0.0:
        return most_mm
    least = min(most_mm, 1.0 / abs(c_x))
    for y in (least * k / PLACES for k in range(PLACES + 1)):
        rest = max(0.0, 1.0 - c_x * curve(y))
        least = min(least, math.hypot(y, rest / c_x))
    return least * (1.0 - BEFORE_END)
