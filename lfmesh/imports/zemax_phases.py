"""Phase surfaces of Zemax files: gratings, binary optics, Zernike phases and holograms.

Zemax's phase Φ in rad bends a ray by m ∇Φ λ / 2π along the surface, as a scene's does; a binary lens with A₁ < 0
converges. The radii that OpticStudio's samples store for their images confirm each type but HOLOGRM1:

- BINARY_1: m Σ A_i E_i(x/R, y/R), E_i = x, y, x², x y, ... (sample sc_diffract3).
- BINARY_2: m Σ A_i (r/R)^(2i) (samples Achromatic singlet, sc_diffract2).
- BINARY_3: two zones of BINARY_2, the inner one up to A₁, with R = A₁ and A₂ (OpticStudio's help, 24.2, "Binary 3").
  The outer one is shifted along z to join the inner one, unless its break is 1. In the sample Dual Zone CD-DVD lens
  both zones focus. Its merit function calls parameter 7 the phase offset, and keeps it at 0.
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
from collections.abc import Callable, Sequence

from lfmesh.imports import phase_keys
from lfmesh.imports.numbers import nanometres
from lfmesh.imports.phase_keys import CURVED_HOLOGRAM, PhaseKeys, whole_order
from lfmesh.imports.prescription import OuterShape, Prescription
from lfmesh.imports.report import Report, Verdict
from lfmesh.imports.xy_terms import MOST_FRINGE_TERMS, fringe_terms, powers_of
from lfmesh.imports.zemax_lines import SurfaceLines, UnreadableLineError
from lfmesh.scene.camera.qcon import MOST_ASPHERE_TERMS
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

PHASE_OFFSET, _BREAK = 7, 8
"""Parameters of BINARY_3: the phase offset of the outer zone, and 1 to leave a step between the zones."""

_AS_HOLOGRAM_2 = (
    "the sign of its order is taken as in HOLOGRM2: order 1 turns light from point 1 into light from point 2"
)


_AS_OFFSET = "taken as a constant phase of the outer zone, in rad, which turns no ray; its sign was not confirmed"


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
            if self.kind == "BINARY_3" and place == PHASE_OFFSET and value.number:
                report.add(value.at, value.text, Verdict.APPROXIMATED, _AS_OFFSET)
                continue
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
    """Return the phase of BINARY_3, and put the shapes of its zones into the surface.

    Parameters 1 and 2 are radius and conic constant of the outer zone, 3 and 4 the radii A₁ and A₂, 5 and 6 the orders
    of both zones, 7 the phase offset of the outer zone and 8 its break; the extra data hold the coefficients of sag and
    phase of both zones, power by power.
    """
    lines.only(range(1, 9))
    surface = lines.surface
    radii = [lines.needed(place, "the radius of a zone") for place in (3, 4)]
    for radius in radii:
        if not radius.number > 0.0:
            raise lines.error("the radius of a zone must be above 0", radius)
    columns = [
        [lines.extra_number(2 + _PER_ZONE * k + column) for k in range(lines.count)] for column in range(_PER_ZONE)
    ]
    sags, phases, outer_sags, outer_phases = columns
    shape = [surface.curvature, surface.conic, *sags]
    outer_shape = [_curvature(lines.parameter(1)), lines.parameter(2), *outer_sags]
    if not _alike(shape, outer_shape):
        surface.outer_zone = _outer_shape(lines, radii[0].number, outer_shape)
    for k, sag in enumerate(sags):
        try:
            surface.add_term(2 * k + 2, sag)
        except ValueError as error:
            raise lines.error(str(error), lines.extra[_PER_ZONE * k + 2]) from None
    (order, outer_order), ratio = (lines.order(place) for place in (5, 6)), radii[0].number / radii[1].number
    offset, border_mm = lines.parameter(PHASE_OFFSET), radii[0].number * unit_mm
    rescaled = [value * _power(ratio, 2 * k + 2) for k, value in enumerate(outer_phases)]
    if order == outer_order and not offset and _alike(phases, rescaled):
        return phase_keys.radial(phases, border_mm, order)
    if order != outer_order:
        # A scene's phase has the same orders everywhere: order 1 of phases multiplied by the orders.
        phases, outer_phases = [order * value for value in phases], [outer_order * value for value in outer_phases]
        order = 1
    parts = (phases, border_mm), (outer_phases, radii[1].number * unit_mm)
    return phase_keys.zones(parts, border_mm, offset / order if order else 0.0, order)


def _alike(one: Sequence[float], other: Sequence[float]) -> bool:
    return all(math.isclose(*pair, rel_tol=SAME) for pair in zip(one, other, strict=True))


def _outer_shape(lines: PhaseLines, border: float, shape: Sequence[float]) -> OuterShape:
    """Return the outer zone of BINARY_3, in the file's unit, from its curvature, conic constant and terms of r², ..."""
    if lines.parameter(_BREAK):
        why = "the break leaves a step between the zones; only zones that join are supported"
        raise lines.error(why, lines.parameters[_BREAK])
    curvature, conic, *terms = shape
    square = terms[0] if terms else 0.0
    if square and (1.0 + conic) * curvature:
        why = "a term in r² of the outer zone needs a flat or parabolic conic; put it into the radius"
        raise lines.error(why, lines.extra[2 + 2])
    if square:
        curvature, conic = curvature + 2.0 * square, -1.0
    coefficients = terms[1:]
    while coefficients and not coefficients[-1]:
        coefficients.pop()
    if len(coefficients) > MOST_ASPHERE_TERMS:
        power, at = 2 * len(coefficients) + 2, 2 + 2 + _PER_ZONE * len(coefficients)
        raise lines.error(f"a term in r^{power}: aspheres reach up to r^{2 * MOST_ASPHERE_TERMS + 2}", lines.extra[at])
    return border, curvature, conic, coefficients


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
