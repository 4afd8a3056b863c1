"""The regions that gradient-index glass fills: between two faces of the lens, and in the cells of the array."""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lfmesh.optics.bounds import SAG, Range, profile_range, scaled
from lfmesh.optics.gradient_range import GlassRegion
from lfmesh.scene.camera.lens import Lens
from lfmesh.scene.camera.mla import MicrolensArray
from lfmesh.scene.camera.surface import Surface

Array = NDArray[np.float64]

SECTORS = 64
"""Number of parts of a quadrant in which the sag of a surface without rotational symmetry is bounded."""


@dataclass(frozen=True)
class LensRegion(GlassRegion):
    """The glass between a surface of the lens and the next.

    Beyond its rim, up to the larger one, a face continues in its own shape or as the plane of the rim, whichever leaves
    less glass: a convex face may be the stop of a lens whose formula ends at that face.

    Attributes
    ----------
    front, back : Surface
    rims_mm : (float, float)
        Clear radii of both; 0 for an unknown one.
    """

    front: Surface
    back: Surface
    rims_mm: tuple[float, float]

    @property
    def corners_mm(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Lowest and highest x and y."""
        wide = max(self.rims_mm)
        return (-wide, -wide), (wide, wide)

    @property
    def radii_mm(self) -> tuple[float, float]:
        """Smallest and largest distance from the axis."""
        return 0.0, max(self.rims_mm)

    def depths(self, radii: Range) -> Range:
        """Return the smallest and largest depth of the glass between distances from the axis, at any azimuth.

        Parameters
        ----------
        radii : (n,) float64 each, mm

        Returns
        -------
        (n,) float64 each, mm
        """
        front, back = (
            [
                _sag_range(surface, (np.minimum(radii[0], end), np.minimum(radii[1], end)))
                for end in (rim, surface.reach_mm)
            ]
            for surface, rim in zip((self.front, self.back), self.rims_mm, strict=True)
        )
        low = np.maximum(front[0][0], front[1][0])
        high = (self.front.thickness_mm or 0.0) + np.minimum(back[0][1], back[1][1])
        return np.minimum(low, high), high


@dataclass(frozen=True)
class LensletFace:
    """Face of a lenslet as its sag into the plate: radius, conic constant and coefficients of r⁴, r⁶, ..."""

    radius_mm: float
    conic: float
    terms_mm: tuple[float, ...]
    cylinder_axis: str | None

    def sag_range(self, radii: Range, half_mm: float) -> Range:
        """Return the range of the sag between distances from the axis, at any azimuth.

        Parameters
        ----------
        radii : (n,) float64 each, mm
        half_mm : float
            Half the pitch, at which a cylinder ends.
        """
        if self.cylinder_axis is not None:
            radii = np.zeros_like(radii[0]), np.minimum(radii[1], half_mm)
        curvature = (np.full_like(radii[0], 0.0 if math.isinf(self.radius_mm) else 1.0 / self.radius_mm),) * 2
        powers = [(2 * j + 4, a) for j, a in enumerate(self.terms_mm)]
        return profile_range(curvature, self.conic, powers, radii, SAG)


@dataclass(frozen=True)
class CellRegion(GlassRegion):
    """The glass of a lenslet.

    Attributes
    ----------
    pitch_mm, thickness_mm : float
    hexagonal : bool
    front, back : LensletFace
        Faces towards the lens and towards the sensor; a positive sag reaches into the plate.
    """

    pitch_mm: float
    thickness_mm: float
    hexagonal: bool
    front: LensletFace
    back: LensletFace

    @property
    def corners_mm(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Lowest and highest x and y."""
        x = 0.5 * self.pitch_mm
        y = self.radii_mm[1] if self.hexagonal else x
        return (-x, -y), (x, y)

    @property
    def radii_mm(self) -> tuple[float, float]:
        """Smallest and largest distance from the axis."""
        return 0.0, self.pitch_mm / math.sqrt(3.0 if self.hexagonal else 2.0)

    def depths(self, radii: Range) -> Range:
        """Return the smallest and largest depth of the glass between distances from the axis, at any azimuth.

        Parameters
        ----------
        radii : (n,) float64 each, mm

        Returns
        -------
        (n,) float64 each, mm
        """
        half = 0.5 * self.pitch_mm
        return self.front.sag_range(radii, half)[0], self.thickness_mm - self.back.sag_range(radii, half)[0]


def lens_region(lens: Lens, number: int) -> LensRegion:
    """Return the glass behind a surface, as wide as the known apertures of both faces.

    Parameters
    ----------
    lens : Lens
    number : int
        Number of the surface, not the last.
    """
    rims = lens.aperture_mm(number) or 0.0, lens.aperture_mm(number + 1) or 0.0
    return LensRegion(lens.surfaces[number], lens.surfaces[number + 1], rims)


def cell_regions(
    mla: MicrolensArray, pitch_mm: float | None = None, stretches: tuple[float, ...] = (1.0,)
) -> tuple[CellRegion, ...]:
    """Return the glass of a lenslet of each type.

    Parameters
    ----------
    mla : MicrolensArray
        With a gradient.
    pitch_mm : float, optional
        Width of a cell. Default: the nominal pitch.
    stretches : tuple of float
        Curvatures of the curved face over the nominal one, for a region each.
    """
    back = mla.back
    other = LensletFace(math.inf, 0.0, (), None)
    if back is not None:
        other = LensletFace(back.radius_mm, back.conic, back.asphere_mm, back.cylinder_axis)
    width, regions = mla.pitch_mm if pitch_mm is None else pitch_mm, []
    for kind, radius in enumerate(mla.radii_mm):
        for stretch in stretches:
            own = LensletFace(radius / stretch, *mla.profile_of(kind), mla.cylinder_axis)
            faces = (own, other) if mla.curved_side == "lens" else (other, own)
            regions.append(CellRegion(width, mla.thickness_mm, mla.layout == "hexagonal", *faces))
    return tuple(regions)


def _sag_range(surface: Surface, radii: Range) -> Range:
    """Return the range of a surface's sag between distances from the axis, at any azimuth."""
    form = surface.form
    if form is None:
        return surface.profile_ranges(radii)[0]
    square = radii[0] * radii[0], radii[1] * radii[1]
    turns = np.linspace(0.0, 0.5 * np.pi, SECTORS + 1)
    ranges = []
    for before, after in pairwise(turns.tolist()):
        sine, cosine = (
            (np.full_like(square[0], low), np.full_like(square[0], high))
            for low, high in ((math.sin(before), math.sin(after)), (max(math.cos(after), 0.0), math.cos(before)))
        )
        signs = ((1.0, 1.0),) if form.symmetric else ((1.0, 1.0), (-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0))
        ranges += [form.ranges_in(surface, square, scaled(one, sine), scaled(two, cosine))[0] for one, two in signs]
    return np.min([each[0] for each in ranges], axis=0), np.max([each[1] for each in ranges], axis=0)
