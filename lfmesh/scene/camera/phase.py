"""Phases of lens surfaces and lenslets: diffractive surfaces, metasurfaces, gratings and holograms."""

import math
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, PrivateAttr, ValidationInfo, field_validator

from lfmesh.errors import FileError
from lfmesh.optics.phase_grid import PhaseGrid, read_phase_grid
from lfmesh.optics.phase_shapes import (
    PhaseProfile,
    grating_profile,
    grid_bounds_mm,
    hologram_profile,
    metalens_profile,
    radial_profile,
    xy_profile,
    zones_profile,
)
from lfmesh.optics.zones import Zone
from lfmesh.scene.camera.base_phase import MM_PER_NM, Phase, term_rad
from lfmesh.scene.camera.orders import Order
from lfmesh.scene.inputs import file_stamp
from lfmesh.scene.light.spectra import Resolves
from lfmesh.scene.model import Fault, Location, Model
from lfmesh.scene.quantities import Coefficient, FilePath, Number, Positive, SignedLength, Vector

__all__ = [
    "AnyPhase",
    "GratingPhase",
    "GridPhase",
    "HologramPhase",
    "MetalensPhase",
    "Order",
    "Phase",
    "PhaseZone",
    "RadialPhase",
    "XyPhase",
    "ZonedPhase",
    "with_grids_beside",
]

MOST_TERMS = 240
"""Maximum number of coefficients of a radial phase, or of a zone."""

MOST_ZONES = 60
"""Maximum number of zones of a phase."""

HIGHEST_POWER, MOST_XY_TERMS = 40, 861
"""Highest power of x and of y in a phase, and maximum number of terms."""

Power = Annotated[int, Field(strict=True, ge=0, le=HIGHEST_POWER)]


class RadialPhase(Phase):
    """Even powers of the distance from the vertex: Σ A_i (r / radius)^(2i), with i from 1."""

    kind: Literal["radial"] = "radial"
    """Kind of phase."""
    coefficients_rad: tuple[Coefficient, ...] = Field(min_length=1, max_length=MOST_TERMS)
    """Coefficients A of r², r⁴, ..., in rad; a negative first one converges in the order 1."""
    radius_mm: Positive
    """Distance that x and y are divided by, in mm."""

    def _shape(self) -> PhaseProfile:
        return radial_profile(self.coefficients_rad, self.radius_mm)

    def terms_rad(self, radius_mm: float) -> Iterator[tuple[Location, float, float]]:
        """Yield the terms.

        Parameters
        ----------
        radius_mm : float

        Yields
        ------
        As in `Phase`.
        """
        for i, a in enumerate(self.coefficients_rad):
            yield ("coefficients_rad", i), a, term_rad(a, radius_mm / self.radius_mm, 2 * i + 2)


class XyPhase(Phase):
    """Powers of x and y: Σ A (x / radius)^i (y / radius)^j."""

    kind: Literal["xy"] = "xy"
    """Kind of phase."""
    coefficients_rad: tuple[tuple[Power, Power, Coefficient], ...] = Field(min_length=1, max_length=MOST_XY_TERMS)
    """Terms [i, j, A] with the powers of x and y, and the coefficient in rad."""
    radius_mm: Positive
    """Distance that x and y are divided by, in mm."""

    @property
    def of_revolution(self) -> bool:
        """False."""
        return False

    def _shape(self) -> PhaseProfile:
        return xy_profile(self.coefficients_rad, self.radius_mm)

    def terms_rad(self, radius_mm: float) -> Iterator[tuple[Location, float, float]]:
        """Yield the terms.

        Parameters
        ----------
        radius_mm : float

        Yields
        ------
        As in `Phase`.
        """
        for k, (i, j, a) in enumerate(self.coefficients_rad):
            yield ("coefficients_rad", k, 2), a, term_rad(a, radius_mm / self.radius_mm, i + j)

    @property
    def symmetric(self) -> bool:
        """True if all powers are even."""
        return all(i % 2 == j % 2 == 0 for i, j, _ in self.coefficients_rad)

    def faults(self) -> Iterator[Fault]:
        """Yield faults between fields, and powers that occur twice."""
        yield from super().faults()
        seen: set[tuple[int, int]] = set()
        for k, (i, j, _) in enumerate(self.coefficients_rad):
            if (i, j) in seen:
                yield Fault(("coefficients_rad", k), None, f"the powers [{i}, {j}] are given twice; keep one")
            seen.add((i, j))


class GratingPhase(Phase):
    """Straight lines of one spacing: 2π lines (x cos δ + y sin δ)."""

    kind: Literal["grating"] = "grating"
    """Kind of phase."""
    lines_per_mm: Positive
    """Number of lines per mm."""
    direction_deg: Number = 0.0
    """Direction δ of the grating vector, across the lines, in degrees from +x towards +y. Light turns there in positive
    orders."""

    @property
    def of_revolution(self) -> bool:
        """False."""
        return False

    def _shape(self) -> PhaseProfile:
        return grating_profile(self.lines_per_mm, self.direction_deg)


class MetalensPhase(Phase):
    """Phase that focuses parallel light to a point, −(2π/λ₀)(√(r² + f²) − f), with λ₀ = `design_nm`."""

    kind: Literal["metalens"] = "metalens"
    """Kind of phase."""
    focal_length_mm: SignedLength
    """Focal length f in air at the design wavelength, in mm: positive converges, negative diverges."""

    needs_design: ClassVar[bool] = True

    def _shape(self) -> PhaseProfile:
        return metalens_profile(self.focal_length_mm, _wave_number(self.design_nm or math.nan))


class GridPhase(Phase):
    """Samples on a regular grid, with a cubic B-spline between them."""

    kind: Literal["grid"] = "grid"
    """Kind of phase."""
    file: FilePath
    """NumPy file, `.npz`, relative to the scene file, with the unwrapped phase_rad [x, y] and spacing_mm, one or two
    numbers. Without origin_mm, the position of sample [0, 0], the grid is centred on the vertex. It must cover the
    clear aperture."""

    _grid: PhaseGrid | None = PrivateAttr(default=None)

    @field_validator("file")
    @classmethod
    def _sound(cls, file: str, info: ValidationInfo) -> str:
        """Read the file once, if its folder is known, to report its faults with those of the scene."""
        folder = (info.context or {}).get("folder")
        if folder is not None:
            try:
                grid_of(folder / file)
            except FileError as error:
                raise ValueError(str(error)) from None
        return file

    @property
    def of_revolution(self) -> bool:
        """False."""
        return False

    def profile(self) -> PhaseProfile:
        """Return the spline through the samples.

        Returns
        -------
        PhaseProfile

        Raises
        ------
        FileError
            The file cannot be used.
        """
        # A phase outside of a scene starts from the current folder.
        return (self._grid or grid_of(Path(self.file))).profile

    def read_in(self, scene: Resolves) -> "GridPhase":
        """Return the phase with the contents of its file.

        Parameters
        ----------
        scene : Scene

        Returns
        -------
        GridPhase

        Raises
        ------
        FileError
            The file cannot be used.
        """
        grid = grid_of(scene.resolve(self.file))
        if self._grid == grid:
            return self
        copy = self.model_copy()
        copy._grid = grid
        return copy

    @property
    def reach_mm(self) -> float:
        """Distance from the vertex along x and y to the nearest end of the grid, in mm; 0 if it lies outside."""
        first, last = grid_bounds_mm(self.profile())
        return max(0.0, float(min(*-first, *last)))


class HologramPhase(Phase):
    """Hologram of two waves, (2π/λ)(d₂ − d₁), with the distances d from two points and λ = `construction_nm`.

    The order 1 turns the first wave into the second. The distance from a virtual point counts negatively.
    """

    kind: Literal["hologram"] = "hologram"
    """Kind of phase."""
    point_1_mm: Vector
    """Point of the first construction wave, from the vertex, in mm."""
    point_2_mm: Vector
    """Point of the second construction wave, from the vertex, in mm."""
    point_1: Literal["real", "virtual"] = "real"
    """First wave: "real" if it diverges from its point, "virtual" if it converges to it."""
    point_2: Literal["real", "virtual"] = "real"
    """Second wave: as `point_1`."""
    construction_nm: Positive
    """Wavelength of both construction waves in air, in nm."""

    @property
    def of_revolution(self) -> bool:
        """True if both points are on the axis."""
        return not any((*self.point_1_mm[:2], *self.point_2_mm[:2]))

    def _shape(self) -> PhaseProfile:
        real = self.point_1 == "real", self.point_2 == "real"
        return hologram_profile((self.point_1_mm, self.point_2_mm), real, _wave_number(self.construction_nm))

    def faults(self) -> Iterator[Fault]:
        """Yield faults between fields, and points on the surface."""
        yield from super().faults()
        for key in ("point_1_mm", "point_2_mm"):
            if getattr(self, key)[2] == 0.0:
                yield Fault((key,), list(getattr(self, key)), "must not lie in the vertex plane, z = 0")


class PhaseZone(Model):
    """A ring of a "zones" phase: offset + Σ A_i (r / radius)^(2i), with i from 1."""

    border_mm: Positive | None = None
    """Outer radius of the zone, in mm. Omitted: at the last zone only, which has no end."""
    coefficients_rad: tuple[Coefficient, ...] = Field(min_length=1, max_length=MOST_TERMS)
    """Coefficients A of r², r⁴, ..., in rad; [0.0] for a zone that turns no light."""
    radius_mm: Positive
    """Distance that r is divided by, in mm."""
    offset_rad: Number = 0.0
    """Constant phase of the zone, in rad. It turns no ray, but shifts the zone's waves against the others."""


class ZonedPhase(Phase):
    """Concentric zones with radial phases of their own, as of a lens with two focal points."""

    kind: Literal["zones"] = "zones"
    """Kind of phase."""
    zones: tuple[PhaseZone, ...] = Field(min_length=1, max_length=MOST_ZONES)
    """Zones, from the vertex outwards, such as [{ border_mm = 1.5, coefficients_rad = [-20.0], radius_mm = 1.5 }, {
    coefficients_rad = [-70.0], radius_mm = 2.5 }]. A point on a border belongs to the zone inside it."""

    def _shape(self) -> PhaseProfile:
        borders = [math.inf if zone.border_mm is None else zone.border_mm for zone in self.zones]
        return zones_profile([
            Zone(inner, outer, zone.offset_rad, 0.0, 0.0,
                 tuple((2 * i, a) for i, a in enumerate(zone.coefficients_rad, start=1)), 1.0 / zone.radius_mm)
            for zone, inner, outer in zip(self.zones, [0.0, *borders[:-1]], borders, strict=True)
        ])  # fmt: skip

    def terms_rad(self, radius_mm: float) -> Iterator[tuple[Location, float, float]]:
        """Yield the terms.

        Parameters
        ----------
        radius_mm : float

        Yields
        ------
        As in `Phase`.
        """
        for k, zone in enumerate(self.zones):
            end = radius_mm if zone.border_mm is None else min(radius_mm, zone.border_mm)
            for i, a in enumerate(zone.coefficients_rad):
                yield ("zones", k, "coefficients_rad", i), a, term_rad(a, end / zone.radius_mm, 2 * i + 2)

    def faults(self) -> Iterator[Fault]:
        """Yield faults between fields, and borders that are missing or do not grow."""
        yield from super().faults()
        before = 0.0
        for k, zone in enumerate(self.zones[:-1]):
            where = ("zones", k, "border_mm")
            if zone.border_mm is None:
                yield Fault(where, None, "missing: only the last zone has no end")
            elif zone.border_mm <= before:
                yield Fault(where, zone.border_mm, f"must be above that of the zone inside, {before:g}")
            before = zone.border_mm or before
        if self.zones[-1].border_mm is not None:
            where = ("zones", len(self.zones) - 1, "border_mm")
            yield Fault(where, self.zones[-1].border_mm, "omit it: the last zone has no end")


AnyPhase = Annotated[
    RadialPhase | XyPhase | GratingPhase | MetalensPhase | GridPhase | HologramPhase | ZonedPhase,
    Field(discriminator="kind"),
]
"""A phase, by its kind."""


def with_grids_beside(data: Any, folder: Path) -> Any:
    """Make the paths of phase grids in a lens file start from its folder, in place, and return its tables.

    Parameters
    ----------
    data : object
        Tables of the file, unchecked.
    folder : Path
    """
    surfaces = data.get("surfaces") if isinstance(data, dict) else None
    for surface in surfaces if isinstance(surfaces, list) else ():
        phase = surface.get("phase") if isinstance(surface, dict) else None
        if isinstance(phase, dict) and isinstance(phase.get("file"), str):
            phase["file"] = str(folder.resolve() / phase["file"])
    return data


def grid_of(path: Path) -> PhaseGrid:
    """Return the phase in a file, read again only if the file has changed."""
    return _read(path, file_stamp(path))


@lru_cache(maxsize=16)
def _read(path: Path, stamp: tuple[object, ...]) -> PhaseGrid:
    """Return the phase of a file; `stamp` identifies the version of the file."""
    return read_phase_grid(path)


def _wave_number(wavelength_nm: float) -> float:
    """Return 2π/λ in rad/mm."""
    return 2.0 * math.pi / (wavelength_nm * MM_PER_NM)
