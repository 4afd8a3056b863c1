"""Shapes of surfaces in place of one of revolution: the class that each derives from, and the surface as it sees it."""

import math
from collections.abc import Hashable
from itertools import product
from typing import ClassVar, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from lfmesh.optics.bounds import Range, scaled
from lfmesh.scene.model import Model

Heights = TypeVar("Heights", float, NDArray[np.float64])
"""One height, or coordinate, or an array of them."""


class SurfaceShape(Hashable, Protocol):
    """A surface as its `Form` and the gap to its neighbour see it: `Surface` has all of this."""

    @property
    def form(self) -> "Form | None":
        """Shape that is none of revolution."""

    @property
    def thickness_mm(self) -> float | None:
        """Distance from this vertex to the next."""

    @property
    def semi_diameter_mm(self) -> float | None:
        """Radius of the clear aperture."""

    @property
    def conic(self) -> float:
        """Conic constant of the section y–z."""

    @property
    def curvature_per_mm(self) -> float:
        """Curvature at the vertex in the section y–z."""

    @property
    def curvature_x_per_mm(self) -> float:
        """Curvature at the vertex in the section x–z."""

    @property
    def vertex_radius_mm(self) -> float:
        """Radius of curvature at the vertex in the section y–z."""

    @property
    def vertex_conic(self) -> float:
        """Conic constant of the conic that the powers are added to."""

    @property
    def powers_mm(self) -> tuple[tuple[int, float], ...]:
        """Each power of r that is added to the conic, with its coefficient."""

    def sag_mm(self, height_mm: Heights) -> Heights:
        """Return the sag of the section y–z.

        Parameters
        ----------
        height_mm : float or array, mm
        """

    def profile_ranges(self, height_mm: Range) -> tuple[Range, Range]:
        """Return bounds of `sag_mm` and of its derivative between heights.

        Parameters
        ----------
        height_mm : Range, mm
        """


class Form(Model):
    """A shape of surface in place of one of revolution; what it does not override is that of its section y–z."""

    symmetric: ClassVar[bool] = False
    """It is symmetric about x and about y, so that a quarter turn tells all of it."""
    without: ClassVar[tuple[str, ...]] = ("asphere_mm", "odd_asphere_mm", "qcon", "qbfs", "mesh")
    """Keys of the surface that it does not go with."""

    def sag_at_mm(self, surface: SurfaceShape, x_mm: Heights, y_mm: Heights) -> Heights:
        """Return z above the vertex plane at a point, in mm; where it has ended, a finite number.

        Parameters
        ----------
        surface : Surface
            Whose form it is: it has the keys of the section y–z.
        x_mm, y_mm : float or array
        """
        raise NotImplementedError

    def ranges_in(self, surface: SurfaceShape, square: Range, sine: Range, cosine: Range) -> tuple[Range, Range, Range]:
        """Return bounds of its sag, in mm, and of the sag's derivatives by r² and by the azimuth.

        They decide whether surfaces cross. See `lfmesh/optics/bounds.py` for sums and products of ranges.

        Parameters
        ----------
        surface : Surface
            That this is the form of.
        square : Range
            The least and the largest r² in each of a number of cells, mm².
        sine, cosine : Range
            x/r and y/r there, each of one sign.

        Returns
        -------
        tuple of three Range
            mm, 1/mm and mm.
        """
        raise NotImplementedError

    def bends_in(self, surface: SurfaceShape, x: Range, y: Range) -> list[Range]:
        """Return bounds of its sag and of the sag's derivatives by x, by y, by x twice, by both, and by y twice.

        They decide whether apertures clip the axial beam; without them `check` says that this is not proven.

        Parameters
        ----------
        surface : Surface
            That this is the form of.
        x, y : Range, mm
            Inside its reach.

        Returns
        -------
        list of six Range
            mm, 1, 1, 1/mm, 1/mm and 1/mm.
        """
        return [(np.full_like(x[0], -np.inf), np.full_like(x[0], np.inf))] * 6

    def reach_mm(self, surface: SurfaceShape) -> float:
        """Return the height up to which it exists at every azimuth, in mm."""
        return reach_of_conic_mm(surface.vertex_radius_mm, surface.vertex_conic)

    def is_flat(self, surface: SurfaceShape) -> bool:
        """Return whether its sag is proven to be zero all over its aperture.

        Parameters
        ----------
        surface : Surface
            That this is the form of.

        Returns
        -------
        bool
        """
        to_one = np.zeros(1), np.ones(1)
        to_minus_one = scaled(-1.0, to_one)
        square = np.zeros(1), np.full(1, (surface.semi_diameter_mm or 1.0) ** 2)
        quarters = product((to_one, to_minus_one), repeat=2)
        return not any(np.any(self.ranges_in(surface, square, *turned)[0]) for turned in quarters)

    def curvature_x_per_mm(self, surface: SurfaceShape) -> float:
        """Return the curvature at the vertex in the section x–z."""
        return surface.curvature_per_mm

    def in_words(self) -> str:
        """Return its keys with their values.

        Returns
        -------
        str
        """
        return " and ".join(f"{key} = {value:g}" for key, value in self.model_dump().items())


def reach_of_conic_mm(radius_mm: float, conic: float) -> float:
    """Return the height at which a conic turns back and ends.

    Parameters
    ----------
    radius_mm : float
        At the vertex.
    conic : float
    """
    return abs(radius_mm) / math.sqrt(1 + conic) if conic > -1 else math.inf
