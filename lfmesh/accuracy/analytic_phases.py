"""Phase surfaces of the analytic truth: the phase, its gradient, and the share of light in an order; see `analytic`.

It shares no code with the engine. The gradient is that of the phase itself along an imaginary step, which loses no
digits (W. Squire, G. Trapp, SIAM Review 40, 1998, 110).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from lfmesh.accuracy.analytic_rays import Array
from lfmesh.errors import LfmeshError
from lfmesh.optics.glass import Medium, refractive_index
from lfmesh.scene.camera.phase import (
    AnyPhase,
    GratingPhase,
    GridPhase,
    HologramPhase,
    MetalensPhase,
    PhaseZone,
    RadialPhase,
    XyPhase,
    ZonedPhase,
)
from lfmesh.scene.light.spectra import Spectrum

STEP = 1e-30
"""Imaginary step over the unit of length."""


@dataclass(frozen=True)
class DiffractionOrder:
    """One order of a phase at one wavelength.

    Attributes
    ----------
    phase : AnyPhase
    number : int
        Number of the order, negative on the other side.
    wavelength_mm : float
        Wavelength in air.
    share : float
        Fraction of the transmitted light in this order.
    """

    phase: AnyPhase
    number: int
    wavelength_mm: float
    share: float

    def change(self, at: Array) -> Array:
        """Return the change of n times the unit direction that the order makes, before its projection on the face.

        Parameters
        ----------
        at : (n, 3) float, mm
            Points in the surface's own frame.

        Returns
        -------
        (n, 3) float
            The third component is 0: the phase is constant along z.
        """
        kind = at.dtype.type
        x, y = at[:, 0], at[:, 1]
        imaginary = 1j * kind(STEP)
        by_x = phase_rad(self.phase, x + imaginary, y + 0 * imaginary).imag / kind(STEP)
        by_y = phase_rad(self.phase, x + 0 * imaginary, y + imaginary).imag / kind(STEP)
        scale = kind(self.number) * kind(self.wavelength_mm) / (2 * pi_of(kind))
        return np.stack([scale * by_x, scale * by_y, np.zeros_like(x)], axis=1)


def pi_of(kind: type) -> Any:
    """Return π to the precision of a type."""
    return 4 * np.arctan(kind(1))


def only_order(
    phase: AnyPhase | None, wavelength_nm: float, before: Medium, behind: Medium, where: str
) -> DiffractionOrder | None:
    """Return the order that a phase sends light to, None without a phase.

    Parameters
    ----------
    phase : AnyPhase or None
    wavelength_nm : float, nm
    before, behind : Medium
        Media on both sides, in the direction of the light.
    where : str
        Key of the phase, for a message.

    Raises
    ------
    LfmeshError
        The phase sends light to several orders, or comes from a file.
    """
    if phase is None:
        return None
    if isinstance(phase, GridPhase):
        raise LfmeshError(f"{where}.kind: the truth that errors are measured against has no phase from a file")
    if len(phase.orders) > 1:
        raise LfmeshError(
            f"{where}.orders: {len(phase.orders)} orders; the truth that errors are measured against follows one: "
            "give order in place of orders"
        )
    (number,) = phase.listed
    return DiffractionOrder(phase, number, wavelength_nm * 1e-6, _share(phase, number, wavelength_nm, (before, behind)))


def _share(phase: AnyPhase, number: int, wavelength_nm: float, media: tuple[Medium, Medium]) -> float:
    """Return the share of the transmitted light in the order of a phase that sends light to one alone."""
    given = phase.efficiency
    if given == "blaze":
        return _blaze(phase, number, wavelength_nm, media)
    listed = phase.orders[0].share if phase.orders else 1.0
    if isinstance(given, Spectrum):
        given = float(np.interp(wavelength_nm, given.wavelengths_nm or (), given.values or ()))
    return (1.0 if listed is None else listed) * (1.0 if isinstance(given, str) else given)


def _blaze(phase: AnyPhase, number: int, wavelength_nm: float, media: tuple[Medium, Medium]) -> float:
    """Return the share of an order of a blaze by scalar diffraction (Swanson, MIT Lincoln Laboratory TR-854, 1989)."""
    design_nm = phase.design_nm or np.nan
    step, designed = (refractive_index(media[0], w) - refractive_index(media[1], w) for w in (wavelength_nm, design_nm))
    depth = phase.blaze_order * design_nm / wavelength_nm * step / designed
    if not phase.levels:
        return float(np.sinc(depth - number) ** 2)
    # Steps of equal light, with phases that follow each other (a sum of phasors).
    step_phases = 2.0 * np.pi * (depth - number) / phase.levels * np.arange(phase.levels)
    return float((np.sinc(number / phase.levels) * abs(np.exp(1j * step_phases).mean())) ** 2)


def phase_rad(phase: AnyPhase, x: Any, y: Any) -> Any:
    """Return the phase at points of its own frame, rad.

    Parameters
    ----------
    phase : AnyPhase
        Not from a file.
    x, y : (n,) complex, mm

    Returns
    -------
    (n,) complex
    """
    kind = x.real.dtype.type
    match phase:
        case RadialPhase():
            return _radial(phase, x, y)
        case ZonedPhase():
            r2 = x.real * x.real + y.real * y.real
            total = _zone(phase.zones[-1], x, y)
            for zone in reversed(phase.zones[:-1]):
                inside = r2 <= kind(zone.border_mm) * kind(zone.border_mm)
                total = np.where(inside, _zone(zone, x, y), total)
            return total
        case XyPhase():
            u, v = x / kind(phase.radius_mm), y / kind(phase.radius_mm)
            return sum((kind(a) * _power(u, int(i)) * _power(v, int(j)) for i, j, a in phase.coefficients_rad), 0 * x)
        case GratingPhase():
            angle = kind(phase.direction_deg) * (pi_of(kind) / 180)
            return 2 * pi_of(kind) * kind(phase.lines_per_mm) * (x * np.cos(angle) + y * np.sin(angle))
        case MetalensPhase():
            f, wave = kind(phase.focal_length_mm), kind(phase.design_nm) * kind(1e-6)
            return -np.sign(f) * 2 * pi_of(kind) / wave * (np.sqrt(x * x + y * y + f * f) - abs(f))
        case HologramPhase():
            return _hologram(phase, x, y)
    raise NotImplementedError(f"{phase.kind}: the truth has no such phase")


def _zone(zone: PhaseZone, x: Any, y: Any) -> Any:
    return _radial(zone, x, y) + x.real.dtype.type(zone.offset_rad)


def _radial(terms: RadialPhase | PhaseZone, x: Any, y: Any) -> Any:
    kind = x.real.dtype.type
    total, r2 = 0 * x, (x * x + y * y) / kind(terms.radius_mm) ** 2
    for coefficient in reversed(terms.coefficients_rad):
        total = (total + kind(coefficient)) * r2
    return total


def _power(base: Any, exponent: int) -> Any:
    """Return an integer power by products, which keep the digits of an imaginary step."""
    product = base * 0 + 1
    for _ in range(exponent):
        product = product * base
    return product


def _hologram(phase: HologramPhase, x: Any, y: Any) -> Any:
    """Return 2π/λ times the difference of the distances from both points; that from a virtual one counts negatively."""
    kind = x.real.dtype.type
    distances = []
    for point, of_wave in ((phase.point_1_mm, phase.point_1), (phase.point_2_mm, phase.point_2)):
        across, up, along = (kind(c) for c in point)
        distance = np.sqrt((x - across) ** 2 + (y - up) ** 2 + along * along)
        distances.append(distance if of_wave == "real" else -distance)
    return 2 * pi_of(kind) / (kind(phase.construction_nm) * kind(1e-6)) * (distances[1] - distances[0])
