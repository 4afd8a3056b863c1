"""Phase surfaces of Zemax files: gratings, binary optics, Zernike phases and holograms.

Zemax's phase Φ in rad bends a ray by m ∇Φ λ / 2π along the surface, as a scene's does; a binary lens with A₁ < 0
converges. The radii that OpticStudio's samples store for their images confirm each type but HOLOGRM1:

- BINARY_1: m Σ A_i E_i(x/R, y/R), E_i = x, y, x², x y, ... (sample sc_diffract3).
- BINARY_2: m Σ A_i (r/R)^(2i) (samples Achromatic singlet, sc_diffract2).
- BINARY_3: two zones of BINARY_2, the inner one up to A₁, with R = A₁ and A₂ (OpticStudio's help, 24.2, "Binary 3";
  the sample Dual Zone CD-DVD lens focuses in its inner zone).
- DGRATING: 2π m T y, T lines per µm (a flat and a curved grating in the tests of optiland).
- FZERNPHA: 2π m Σ A_i Z_i(x/R, y/R) with fringe Zernike polynomials: A_i are in waves (sample sc_zern2).
- HOLOGRM2: −(2π/λ_c) m (d₁ + d₂): order 1 turns light from point 1 into light towards point 2 (sample Transmission
  hologram: the points are object and image).
- HOLOGRM1: (2π/λ_c) m (d₂ − d₁), the same with light from point 2. The help, 24.2, "Hologram 1", leaves the direction
  of its unit vectors along the beams open, so the sign of m is taken from HOLOGRM2.

Binary optics are even aspheres, gratings and Zernike phases spheres and conics. A hologram must be flat, since a
scene's phase does not depend on z. Extra data hold the number of terms, the radius R and
the coefficients.
"""

import math
from collections.abc import Callable

from lfmesh.imports import phase_keys
from lfmesh.imports.numbers import nanometres
from lfmesh.imports.phase_keys import CURVED_HOLOGRAM, PhaseKeys, whole_order
from lfmesh.imports.prescription import Prescription
from lfmesh.imports.report import Report, Verdict
from lfmesh.imports.xy_terms import MOST_FRINGE_TERMS, fringe_terms, powers_of
from lfmesh.imports.zemax_lines import SurfaceLines, UnreadableLineError
from lfmesh.scene.quantities import LARGEST

ASPHERIC = ("BINARY_1", "BINARY_2")
"""Phase surfaces with the terms r² to r¹⁶ of an even asphere in parameters 1 to 8."""

MOST_TERMS = {"BINARY_1": 230, "BINARY_2": 240, "BINARY_3": 60, "FZERNPHA": MOST_FRINGE_TERMS}
"""Most terms in the extra data: x and y up to degree 20, and as many as there are places."""

_HOLOGRAMS = ("HOLOGRM1", "HOLOGRM2")

SAME = 1e-12
"""Largest relative difference of equal zones (rounding)."""

_PER_ZONE = 4
"""Extra data of BINARY_3 for each power: its coefficients of sag and phase in the inner, then in the outer zone."""

_AS_HOLOGRAM_2 = (
    "the sign of its order is taken as in HOLOGRM2: order 1 turns light from point 1 into light from point 2"
)


class PhaseLines(SurfaceLines):
    """Lines of a phase surface; of binary optics without the terms of their asphere."""

    def take(self, made: Prescription, report: Report) -> None:
        """Give the surface its phase, and the lines their verdicts.

        Parameters
        ----------
        made : Prescription
        report : Report
        """
        try:
            self._check_numbers()
            self.surface.phase = READERS[self.kind](self, made.unit_mm)
        except UnreadableLineError as error:
            report.refuse(error.at, error.text, str(error))
            return
        for place, value in self.parameters.items():
            unused = self.kind == "FZERNPHA" and place == 1 and not self._reaches_beyond
            report.add(value.at, value.text, Verdict.WITHOUT_EFFECT if unused else Verdict.TAKEN)
        counted = self.extra_number(1) * (_PER_ZONE if self.kind == "BINARY_3" else 1)
        first = 2 if self.kind == "BINARY_3" else 3
        for place, value in self.extra.items():
            beyond = place - first >= counted and value.number
            constant = self.kind == "FZERNPHA" and place == first
            how = f"XDAT 1 counts {counted:g} terms" if beyond else "a constant turns no ray" if constant else ""
            report.add(value.at, value.text, Verdict.WITHOUT_EFFECT if how else Verdict.TAKEN, how)
        if how := self._doubt():
            report.add(self.at, self.text, Verdict.APPROXIMATED, how)
        else:
            report.add(self.at, self.text, Verdict.TAKEN)

    def _doubt(self) -> str:
        """Return how the phase differs from Zemax's; empty if it does not."""
        if self.surface.phase is None:
            return ""
        if self.kind == "HOLOGRM1":
            return _AS_HOLOGRAM_2
        if self.kind == "FZERNPHA" and self._reaches_beyond and not self.parameter(1):
            return f"Zemax's phase ends at its radius {self.radius:g}; here it goes on to the rim of the surface"
        return ""

    @property
    def _reaches_beyond(self) -> bool:
        """True if the surface extends beyond the normalisation radius."""
        size = self.surface.aperture or self.surface.extent
        return self.surface.phase is not None and size is not None and size > self.radius

    def _check_numbers(self) -> None:
        points = range(1, 7) if self.kind in _HOLOGRAMS else range(0)
        bounded = [value for place, value in self.parameters.items() if place not in points]
        for value in (*bounded, *self.extra.values()):
            if abs(value.number) > LARGEST:
                raise self.error(f"a number must be {LARGEST:g} or less in magnitude", value)
        for value in self.extra.values():
            if value.number and self.kind not in MOST_TERMS:
                raise self.error(f"{self.kind} has no extra data", value)

    def order(self, place: int) -> int:
        """Return the diffraction order in a parameter."""
        value = self.needed(place, "the diffraction order")
        try:
            return whole_order(value.number)
        except ValueError as error:
            raise self.error(str(error), value) from None

    @property
    def count(self) -> int:
        """Number of terms in the extra data."""
        if 1 not in self.extra:
            raise self.error("its extra data are missing: XDAT 1 counts the terms, XDAT 2 is the radius they refer to")
        value, most = self.extra[1], MOST_TERMS[self.kind]
        if not 0.0 <= value.number <= most or value.number != math.floor(value.number):
            raise self.error(f"the number of terms of {self.kind} must be a whole number up to {most}", value)
        return int(value.number)

    @property
    def radius(self) -> float:
        """Normalisation radius, in the file's unit."""
        if 2 not in self.extra:
            raise self.error("XDAT 2, the normalisation radius, is missing")
        if not self.extra[2].number > 0.0:
            raise self.error("the normalisation radius must be above 0", self.extra[2])
        return self.extra[2].number

    @property
    def coefficients(self) -> list[float]:
        """Coefficients in the extra data."""
        places = range(3, self.count + 3)
        if places and not any(place in self.extra for place in places):
            raise self.error(f"XDAT 1 counts {len(places)} terms, but the file has none of their coefficients")
        return [self.extra_number(place) for place in places]


def _binary_1(lines: PhaseLines, unit_mm: float) -> PhaseKeys | None:
    """Return the phase of BINARY_1."""
    lines.only(range(1))
    terms = {powers_of(k): value for k, value in enumerate(lines.coefficients, 1)}
    return phase_keys.xy(terms, lines.radius * unit_mm, lines.order(0)) if terms else None


def _binary_2(lines: PhaseLines, unit_mm: float) -> PhaseKeys | None:
    """Return the phase of BINARY_2."""
    lines.only(range(1))
    terms = lines.coefficients
    return phase_keys.radial(terms, lines.radius * unit_mm, lines.order(0)) if terms else None


def _binary_3(lines: PhaseLines, unit_mm: float) -> PhaseKeys | None:
    """Return the phase of BINARY_3 and put its terms into the surface; UnreadableLineError unless its zones are equal.

    Parameters 1 and 2 are radius and conic constant of the outer zone, 3 and 4 the radii A₁ and A₂, 5 and 6 the orders
    of both zones; the extra data hold the coefficients of sag and phase of both zones, power by power.
    """
    lines.only(range(1, 7))
    surface, count = lines.surface, lines.count
    radii = [lines.needed(place, "the radius of a zone") for place in (3, 4)]
    for radius in radii:
        if not radius.number > 0.0:
            raise lines.error("the radius of a zone must be above 0", radius)
    inner, outer = ([[surface.curvature, surface.conic]], [[_curvature(lines.parameter(1)), lines.parameter(2)]])
    for k in range(count):
        sags = [lines.extra.get(place) for place in range(2 + _PER_ZONE * k, 2 + _PER_ZONE * (k + 1))]
        values = [0.0 if value is None else value.number for value in sags]
        inner.append([values[0], values[1]])
        outer.append([values[2], values[3] * _power(radii[0].number / radii[1].number, 2 * k + 2)])
    orders = [lines.order(place) for place in (5, 6)]
    pairs = [pair for one, other in zip(inner, outer, strict=True) for pair in zip(one, other, strict=True)]
    if orders[0] != orders[1] or not all(math.isclose(*pair, rel_tol=SAME) for pair in pairs):
        raise lines.error("BINARY_3 has two zones, whose shapes and phases differ here; only equal zones are supported")
    for k, (sag, _) in enumerate(inner[1:], 1):
        try:
            surface.add_term(2 * k, sag)
        except ValueError as error:
            raise lines.error(str(error), lines.extra[_PER_ZONE * k - 2]) from None
    return phase_keys.radial([phase for _, phase in inner[1:]], radii[0].number * unit_mm, orders[0])


def _grating(lines: PhaseLines, _: float) -> PhaseKeys | None:
    """Return the phase of DGRATING: lines per µm in parameter 1, parallel to x, and the order in parameter 2."""
    lines.only(range(1, 3))
    per_um = lines.needed(1, "the lines per µm").number
    return phase_keys.grating(1e3 * per_um, 90.0, lines.order(2))


def _zernike(lines: PhaseLines, unit_mm: float) -> PhaseKeys | None:
    """Return the phase of FZERNPHA in powers of x and y, without its constant."""
    lines.only(range(2))
    waves = fringe_terms(lines.coefficients)
    terms = {powers: 2.0 * math.pi * value for powers, value in waves.items()}
    return phase_keys.xy(terms, lines.radius * unit_mm, lines.order(0)) if terms else None


def _hologram(lines: PhaseLines, unit_mm: float) -> PhaseKeys | None:
    """Return the phase of a hologram: points in parameters 1 to 6, wavelength in µm in 7, and order in 8."""
    lines.only(range(1, 9))
    if not lines.surface.is_flat:
        raise lines.error(CURVED_HOLOGRAM)
    wavelength = lines.needed(7, "the construction wavelength")
    if not wavelength.number > 0.0:
        why = "the construction wavelength must be above 0; below 0 it marks a hologram that was made into a mirror"
        raise lines.error(why, wavelength)
    x1, y1, z1, x2, y2, z2 = (lines.parameter(place) for place in range(1, 7))
    points = [phase_keys.point_mm(x1, y1, z1, unit_mm), phase_keys.point_mm(x2, y2, z2, unit_mm)]
    construction_nm = nanometres(repr(wavelength.number))
    return phase_keys.hologram(points, (False, lines.kind == "HOLOGRM2"), construction_nm, lines.order(8))


def _curvature(radius: float) -> float:
    return 1.0 / radius if radius else 0.0


def _power(value: float, exponent: int) -> float:
    """Return a power; inf beyond the range of floats."""
    try:
        return value**exponent
    except OverflowError:
        return math.inf


READERS: dict[str, Callable[[PhaseLines, float], PhaseKeys | None]] = {
    "BINARY_1": _binary_1,
    "BINARY_2": _binary_2,
    "BINARY_3": _binary_3,
    "DGRATING": _grating,
    "FZERNPHA": _zernike,
    "HOLOGRM1": _hologram,
    "HOLOGRM2": _hologram,
}
"""Readers of phase surfaces, by Zemax's type."""
