"""Surfaces with two concentric zones, each with a radius, conic constant and aspheric terms of its own.

Lenses for two kinds of discs, or for two wavelengths, have such faces. OpticStudio's Binary 3 is one with a phase.
"""

import math
from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from pydantic import Field

from lfmesh.optics.bounds import ACROSS, SAG, Range, scaled
from lfmesh.optics.zones import Zone, joined, zones_in_plane, zones_range
from lfmesh.scene.camera.forms import Form, Heights, SurfaceShape, reach_of_conic_mm
from lfmesh.scene.camera.qcon import MOST_ASPHERE_TERMS
from lfmesh.scene.model import Fault
from lfmesh.scene.quantities import LARGEST, Coefficient, Number, Positive, Radius


class OuterZone(Form):
    """Zone around the one that the surface's own keys describe, which it continues without a step."""

    symmetric = True
    without = ("odd_asphere_mm", "qcon", "qbfs", "mesh")
    border_mm: Positive
    """Distance from the axis, in mm, at which the zone begins. A point on the border belongs to the inner zone."""
    radius_mm: Radius
    """Radius of curvature of the zone's conic, in mm; inf is flat."""
    conic: Number = 0.0
    """Conic constant of the zone."""
    asphere_mm: tuple[Coefficient, ...] = Field(default=(), max_length=MOST_ASPHERE_TERMS)
    """Even aspheric coefficients of the zone, of r⁴, r⁶, ..., in mm⁻³, mm⁻⁵, ..."""

    @property
    def curvature_per_mm(self) -> float:
        """Curvature of the zone's conic at the axis."""
        return 0.0 if math.isinf(self.radius_mm) else 1.0 / self.radius_mm

    def zones(self, surface: SurfaceShape) -> tuple[Zone, Zone]:
        """Return the formulas of the inner and of the outer zone.

        Parameters
        ----------
        surface : Surface

        Returns
        -------
        tuple of two Zone
        """
        return _zones(self, surface.curvature_per_mm, surface.vertex_conic, surface.powers_mm)

    def zone_at(self, surface: SurfaceShape, height_mm: float) -> Zone:
        """Return the formula of the zone that contains a height.

        Parameters
        ----------
        surface : Surface
        height_mm : float

        Returns
        -------
        Zone
        """
        inner, outer = self.zones(surface)
        return outer if abs(height_mm) > self.border_mm else inner

    def profile_mm(self, surface: SurfaceShape, height_mm: Heights) -> Heights:
        """Return the sag at heights from the axis.

        Parameters
        ----------
        surface : Surface
        height_mm : float or array

        Returns
        -------
        float or array
            mm.
        """
        if isinstance(height_mm, float | int):
            return self.zone_at(surface, float(height_mm)).sag(height_mm)
        inner, outer = self.zones(surface)
        heights = np.asarray(height_mm)
        return np.asarray(np.where(np.abs(heights) > self.border_mm, outer.sag(heights), inner.sag(heights)))

    def sag_at_mm(self, surface: SurfaceShape, x_mm: Heights, y_mm: Heights) -> Heights:
        """Return z above the vertex plane at a point.

        Parameters
        ----------
        surface, x_mm, y_mm
            As in `Form`.

        Returns
        -------
        float or array
            mm.
        """
        return self.profile_mm(surface, np.hypot(x_mm, y_mm))

    def ranges_in(self, surface: SurfaceShape, square: Range, sine: Range, cosine: Range) -> tuple[Range, Range, Range]:
        """Return bounds of the sag and its derivatives.

        Parameters
        ----------
        surface, square, sine, cosine
            As in `Form`.

        Returns
        -------
        tuple of three Range
            mm, 1/mm and mm.
        """
        zones, r = self.zones(surface), (np.sqrt(square[0]), np.sqrt(square[1]))
        zero = np.zeros_like(r[0])
        return zones_range(zones, r, SAG), scaled(0.5, zones_range(zones, r, ACROSS)), (zero, zero)

    def bends_in(self, surface: SurfaceShape, x: Range, y: Range) -> list[Range]:
        """Return bounds of the sag and its derivatives; the second ones are unbounded at the border.

        Parameters
        ----------
        surface, x, y
            As in `Form`.

        Returns
        -------
        list of six Range
            mm, 1, 1, 1/mm, 1/mm and 1/mm.
        """
        return zones_in_plane(self.zones(surface), x, y)

    def reach_mm(self, surface: SurfaceShape) -> float:
        """Return the height at which the outer zone ends, or the inner one inside the border.

        Parameters
        ----------
        surface : Surface

        Returns
        -------
        float
            mm; infinite if it does not end.
        """
        inner = super().reach_mm(surface)
        return inner if inner <= self.border_mm else reach_of_conic_mm(self.radius_mm, self.conic)

    def in_words(self) -> str:
        """Return the keys with their values.

        Returns
        -------
        str
        """
        words = [f"{key} = {getattr(self, key):g}" for key in ("border_mm", "radius_mm", "conic")]
        terms = ", ".join(f"{a:.4g}" for a in self.asphere_mm)
        return " and ".join([*words, f"asphere_mm = [{terms}]"] if terms else words)

    def faults_on(self, surface: SurfaceShape) -> Iterator[Fault]:
        """Yield zones that end before the border or leave the range of numbers.

        Parameters
        ----------
        surface : Surface

        Yields
        ------
        Fault
            With its place in the surface.
        """
        inner = super().reach_mm(surface)
        outer = reach_of_conic_mm(self.radius_mm, self.conic)
        if inner <= self.border_mm:
            yield Fault(
                ("outer_zone", "border_mm"), self.border_mm, f"the inner zone ends {inner:.6g} mm from the axis"
            )
        elif outer <= self.border_mm:
            yield Fault(
                ("outer_zone", "radius_mm"), self.radius_mm,
                f"with conic = {self.conic:g} the zone ends {outer:.6g} mm from the axis, inside "
                f"border_mm = {self.border_mm:g}",
            )  # fmt: skip
        elif not abs(self.zones(surface)[1].offset) <= LARGEST:
            yield Fault(
                ("outer_zone", "border_mm"), self.border_mm, f"the sag there is more than {LARGEST:g} mm"
            )  # fmt: skip
        elif surface.semi_diameter_mm is not None and surface.semi_diameter_mm > self.border_mm:
            highest = np.abs([a * surface.semi_diameter_mm**p for p, a in self.zones(surface)[1].powers if a])
            if not np.max(highest, initial=0.0) <= LARGEST:
                yield Fault(
                    ("outer_zone", "asphere_mm"), self.asphere_mm,
                    f"makes a sag of more than {LARGEST:g} mm inside the clear aperture",
                )  # fmt: skip


@lru_cache(maxsize=256)
def _zones(
    outer: OuterZone, curvature: float, conic: float, powers_mm: tuple[tuple[int, float], ...]
) -> tuple[Zone, Zone]:
    border, terms = outer.border_mm, tuple((2 * j + 4, a) for j, a in enumerate(outer.asphere_mm))
    return joined(
        Zone(0.0, border, 0.0, curvature, conic, powers_mm),
        Zone(border, math.inf, 0.0, outer.curvature_per_mm, outer.conic, terms),
    )
