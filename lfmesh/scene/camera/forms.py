"""Base class of surface shapes other than one profile of revolution, and the surface as it sees it."""

import math
from collections.abc import Hashable
from itertools import product
from typing import ClassVar, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from lfmesh.optics.bounds import Range, scaled
from lfmesh.scene.model import Model

Heights = TypeVar("Heights", float, NDArray[np.float64])
"""A height or coordinate, or an array of them."""


class SurfaceShape(Hashable, Protocol):
    """Part of `Surface` that its `Form` and the gap to its neighbour use."""

    @property
    def form(self) -> "Form | None":
        """Shape without rotational symmetry."""

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
        """Conic constant of the base conic."""

    @property
    def powers_mm(self) -> tuple[tuple[int, float], ...]:
        """Powers of r added to the base conic, with their coefficients."""

    def sag_mm(self, height_mm: Heights) -> Heights:
        """Return the sag of the section y–z.

        Parameters
        ----------
        height_mm : float or array, mm
        """

    def profile_ranges(self, height_mm: Range) -> tuple[Range, Range]:
        """Return bounds of `sag_mm` and its derivative between heights.

        Parameters
        ----------
        height_mm : Range, mm
        """


class Form(Model):
    """A surface shape other than one profile of revolution; by default with the properties of the y–z section."""

    symmetric: ClassVar[bool] = False
    """True if it is symmetric about x and y, so that one quadrant describes it."""
    without: ClassVar[tuple[str, ...]] = ("asphere_mm", "odd_asphere_mm", "qcon", "qbfs", "mesh")
    """Keys of the surface that it excludes."""

    def sag_at_mm(self, surface: SurfaceShape, x_mm: Heights, y_mm: Heights) -> Heights:
        """Return z above the vertex plane at a point; a finite number beyond the end of the surface.

        Parameters
        ----------
        surface : Surface
            Its keys describe the y–z section.
        x_mm, y_mm : float or array
        """
        raise NotImplementedError

    def ranges_in(self, surface: SurfaceShape, square: Range, sine: Range, cosine: Range) -> tuple[Range, Range, Range]:
        """Return bounds of the sag, in mm, and of its derivatives by r² and by the azimuth.

        They decide whether surfaces cross. See `lfmesh/optics/bounds.py` for sums and products of ranges.

        Parameters
        ----------
        surface : Surface
        square : Range
            Smallest and largest r² in each cell, mm².
        sine, cosine : Range
            x/r and y/r in each cell, each of one sign.

        Returns
        -------
        tuple of three Range
            mm, 1/mm and mm.
        """
        raise NotImplementedError

    def bends_in(self, surface: SurfaceShape, x: Range, y: Range) -> list[Range]:
        """Return bounds of the sag and of its derivatives by x, by y, by x twice, by both, and by y twice.

        They prove whether apertures clip the axial beam.

        Parameters
        ----------
        surface : Surface
        x, y : Range, mm
            Inside its reach.

        Returns
        -------
        list of six Range
            mm, 1, 1, 1/mm, 1/mm and 1/mm.
        """
        return [(np.full_like(x[0], -np.inf), np.full_like(x[0], np.inf))] * 6

    def reach_mm(self, surface: SurfaceShape) -> float:
        """Return the largest height that the surface reaches at every azimuth."""
        return reach_of_conic_mm(surface.vertex_radius_mm, surface.vertex_conic)

    def is_flat(self, surface: SurfaceShape) -> bool:
        """Return whether the sag is proven to be zero over the whole aperture.

        Parameters
        ----------
        surface : Surface

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
        """Return the curvature at the vertex in the section x–z.

        Parameters
        ----------
        surface : Surface

        Returns
        -------
        float
            1/mm.
        """
        return surface.curvature_per_mm

    def in_words(self) -> str:
        """Return the keys with their values.

        Returns
        -------
        str
        """
        return " and ".join(f"{key} = {value:g}" for key, value in self.model_dump().items())


def reach_of_conic_mm(radius_mm: float, conic: float) -> float:
    """Return the largest height that a conic reaches.

    Parameters
    ----------
    radius_mm : float
        Radius at the vertex.
    conic : float
    """
    return abs(radius_mm) / math.sqrt(1 + conic) if conic > -1 else math.inf
