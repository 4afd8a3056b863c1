"""Phases of surfaces as lines of Zemax and CODE V files; `zemax_phases` and `codev_phases` state their meaning."""

import math
from collections.abc import Mapping, Sequence

from lfmesh.errors import SceneError
from lfmesh.imports.codev_phases import MOST_RADIAL_TERMS, MOST_XY_TERMS
from lfmesh.imports.numbers import micrometres
from lfmesh.imports.xy_terms import number_of, powers_of
from lfmesh.imports.zemax_phases import MOST_TERMS
from lfmesh.scene.camera.lens import Surface
from lfmesh.scene.camera.phase import AnyPhase, GratingPhase, HologramPhase, RadialPhase, XyPhase

MOST_EVEN_TERMS = 7
"""Zemax's even aspheres have the powers r⁴ to r¹⁶, and so have its binary optics."""

Powers = Mapping[tuple[int, int], float]


def check_phase(number: int, surface: Surface, program: str) -> None:
    """Raise a SceneError if a program's files cannot hold the phase of a surface.

    Parameters
    ----------
    number : int
        Number of the surface.
    surface : Surface
        One with a phase.
    program : str
        Name of the program.
    """
    phase = surface.phase
    if phase is None:
        return
    if not isinstance(phase, RadialPhase | XyPhase | GratingPhase | HologramPhase):
        raise SceneError(
            f"surfaces[{number}].phase: a {program} file cannot hold a phase of kind {phase.kind}; write .toml"
        )
    if isinstance(phase, HologramPhase) and not surface.is_flat:
        raise SceneError(
            f"surfaces[{number}].phase: a {program} file cannot hold the phase of a hologram on a curved surface; "
            "write .toml"
        )
    if not phase.has_one_order:
        raise SceneError(f"surfaces[{number}].phase: a {program} file holds one order of a phase; write .toml")


def zemax_lines(number: int, surface: Surface) -> list[str]:
    """Return the type of a surface with a phase, and its parameters.

    Parameters
    ----------
    number : int
        Number of the surface.
    surface : Surface

    Raises
    ------
    SceneError
        No type has the phase and the shape.
    """
    phase = surface.phase
    if surface.section_key is not None or any(surface.odd_asphere_mm):
        key = surface.section_key or "odd_asphere_mm"
        raise SceneError(
            f"surfaces[{number}].{key}: Zemax's surfaces with a phase are spheres, conics or even aspheres"
        )
    if isinstance(phase, HologramPhase):
        return _zemax_hologram(phase)
    if isinstance(phase, GratingPhase) and not surface.terms_mm and phase.direction_deg % 180.0 == 90.0:
        order = phase.main_order if phase.direction_deg % 360.0 == 90.0 else -phase.main_order
        return ["  TYPE DGRATING", f"  PARM 1 {phase.lines_per_mm / 1e3!r}", f"  PARM 2 {order}"]
    if isinstance(phase, RadialPhase):
        return _binary("BINARY_2", number, surface, phase.radius_mm, phase.coefficients_rad)
    terms, radius_mm = _in_x_and_y(phase)
    values = [0.0] * max(number_of(*powers) for powers in terms)
    if len(values) > MOST_TERMS["BINARY_1"]:
        degree = sum(powers_of(MOST_TERMS["BINARY_1"]))
        raise SceneError(f"surfaces[{number}].phase.coefficients_rad: Zemax's BINARY_1 has powers i + j up to {degree}")
    for powers, value in terms.items():
        values[number_of(*powers) - 1] = value
    return _binary("BINARY_1", number, surface, radius_mm, values)


def _binary(
    kind: str, number: int, surface: Surface, radius_mm: float, coefficients_rad: Sequence[float]
) -> list[str]:  # fmt: skip
    """Return a binary optic: its order and asphere, then its number of terms, radius and coefficients."""
    if len(surface.terms_mm) > MOST_EVEN_TERMS:
        key = surface.terms_key
        raise SceneError(f"surfaces[{number}].{key}: Zemax's {kind} has {MOST_EVEN_TERMS} terms from r⁴")
    order = surface.phase.main_order if surface.phase is not None else 0
    sag = enumerate((0.0, *surface.terms_mm) if surface.terms_mm else (), 1)
    extra = enumerate((len(coefficients_rad), radius_mm, *coefficients_rad), 1)
    return [
        f"  TYPE {kind}",
        f"  PARM 0 {order}",
        *(f"  PARM {place} {value!r}" for place, value in sag),
        *(f"  XDAT {place} {value!r} 0 0" for place, value in extra),
    ]


def _zemax_hologram(phase: HologramPhase) -> list[str]:
    # Zemax's first wave diverges. The opposite phase has the opposite order.
    order = phase.main_order if phase.point_1 == "real" else -phase.main_order
    values = (*phase.point_1_mm, *phase.point_2_mm, micrometres(phase.construction_nm), order)
    kind = "HOLOGRM1" if phase.point_1 == phase.point_2 else "HOLOGRM2"
    return [f"  TYPE {kind}", *(f"  PARM {place} {value}" for place, value in enumerate(values, 1))]


def _in_x_and_y(phase: AnyPhase | None) -> tuple[Powers, float]:
    """Return the terms of a polynomial or a grating, by their powers, and the radius that they refer to, mm.

    A constant has no effect on rays; a term of 0 stands for a phase of nothing else.
    """
    if isinstance(phase, GratingPhase):
        size, angle = 2.0 * math.pi * phase.lines_per_mm, math.radians(phase.direction_deg)
        return {(1, 0): size * math.cos(angle), (0, 1): size * math.sin(angle)}, 1.0
    if isinstance(phase, XyPhase):
        return {(i, j): value for i, j, value in phase.coefficients_rad if i + j} or {(1, 0): 0.0}, phase.radius_mm
    raise TypeError(phase)


def codev_lines(number: int, phase: AnyPhase, design_nm: float) -> list[str]:
    """Return the commands of a phase.

    Parameters
    ----------
    number : int
        Number of its surface.
    phase : AnyPhase
    design_nm : float
        Wavelength of the path lengths that represent a polynomial.

    Raises
    ------
    SceneError
        CODE V has no such phase.
    """
    order = phase.main_order
    if isinstance(phase, GratingPhase):
        angle = math.radians(phase.direction_deg)
        lines = ["DIF GRT", f"GRO {order}", f"GRS {1.0 / phase.lines_per_mm!r}"]
        upwards = phase.direction_deg == 90.0
        lines += [] if upwards else [f"GRX {math.cos(angle)!r}", f"GRY {math.sin(angle)!r}", "GRZ 0.0"]
    elif isinstance(phase, HologramPhase):
        lines = ["DIF HOE", f"HOR {order}", f"HWL {phase.construction_nm!r}"]
        for place, point, kind in ((1, phase.point_1_mm, phase.point_1), (2, phase.point_2_mm, phase.point_2)):
            x, y, z = point
            lines += [f"HX{place} {x!r}; HY{place} {y!r}; HZ{place} {z!r}", f"HV{place} {kind[:3].upper()}"]
    elif isinstance(phase, RadialPhase):
        terms = {i: (2 * i, value) for i, value in enumerate(phase.coefficients_rad, 1)}
        lines = _polynomial(number, "R", terms, phase.radius_mm, (order, design_nm))
    else:
        powers, radius_mm = _in_x_and_y(phase)
        terms = {number_of(i, j): (i + j, value) for (i, j), value in powers.items()}
        lines = _polynomial(number, "XY", terms, radius_mm, (order, design_nm))
    return [f"  {line}" for line in lines]


def _polynomial(
    number: int, form: str, terms: Mapping[int, tuple[int, float]], radius_mm: float, light: tuple[int, float]
) -> list[str]:
    """Return the commands of a polynomial: terms by their number, each a degree and a coefficient in rad.

    `light` is the order and the design wavelength, nm.
    """
    order, design_nm = light
    most = {"R": MOST_RADIAL_TERMS, "XY": MOST_XY_TERMS}[form]
    if max(terms) > most:
        raise SceneError(
            f"surfaces[{number}].phase.coefficients_rad: CODE V's polynomial {form} has {most} terms, not {max(terms)}"
        )
    lines = ["DIF DOE", f"HOR {order}", f"HWL {design_nm!r}; HCT {form}"]
    for place, (degree, value) in sorted(terms.items()):
        try:
            length = value * (1e-6 * design_nm) / (2.0 * math.pi) / radius_mm**degree
        except (OverflowError, ZeroDivisionError):
            length = math.inf
        if not math.isfinite(length):
            raise SceneError(f"surfaces[{number}].phase: a coefficient leaves the range of numbers in a CODE V file")
        lines.append(f"HCO C{place} {length!r}")
    return lines
