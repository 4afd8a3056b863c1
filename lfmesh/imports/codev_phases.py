"""Diffractive surfaces of CODE V files: `DIF DOE`, `DIF HOE` and `DIF GRT`.

- DOE: 2π/HWL · HOR · (C₁ r² + C₂ r⁴ + ...) with HCT R, or (C₁ x + C₂ y + C₃ x² + C₄ x y + ...) with HCT XY. The
  coefficients HCO are path lengths in the file's unit, so that C₁ < 0 converges. Edmund's hybrid asphere 65988, in the
  tests of ray-optics, has its focal length of 15 mm and its back focal length with these signs.
- HOE: the same polynomial, or two construction points, (2π/HWL) HOR (±d₂ ∓ d₁): upper signs for points HV1 REA and
  HV2 REA, which light diverges from, lower ones for VIR, which light converges to. Zemax's converter (CODE V to
  OpticStudio) makes HOLOGRM1 and HOLOGRM2 of them with the same points and order, which sets the sign of HOR. With
  points, the surface must be flat, since a scene's phase does not depend on z.
- GRT: 2π GRO y/GRS, or along (GRX, GRY), the normal of the planes that generate the grooves, in the words of KDP-2 and
  ray-optics. Zemax's converter makes DGRATING of it with the same order, which sets the sign of GRO.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from lfmesh.imports import phase_keys
from lfmesh.imports.numbers import may_matter, number
from lfmesh.imports.phase_keys import CURVED_HOLOGRAM, PhaseKeys, Point, whole_order
from lfmesh.imports.prescription import FileSurface
from lfmesh.imports.report import Report, Verdict
from lfmesh.imports.text import command_names
from lfmesh.imports.xy_terms import powers_of
from lfmesh.scene.quantities import LARGEST, SMALLEST

KINDS = ("DOE", "HOE", "GRT")

COMMANDS = command_names("DIF HOR HWL HCT HCO HTO HX1 HY1 HZ1 HX2 HY2 HZ2 HV1 HV2 GRO GRS GRX GRY GRZ HOE GRT DOE")
"""Commands of diffractive surfaces; a kind may follow `DIF` or stand alone."""

MOST_XY_TERMS, MOST_RADIAL_TERMS = 65, 10
"""Terms up to degree 10 in x and y, and up to r²⁰."""

_POINTS = (("HX1", "HY1", "HZ1"), ("HX2", "HY2", "HZ2"))

_OF_GRATING = ("GRO", "GRS", "GRX", "GRY", "GRZ")

_AS_ZEMAX = (
    "the sign of its order is taken as in Zemax's converter: order 1 turns the light of point 1 into that of point 2"
)


@dataclass
class _Diffractive:
    """Commands of one diffractive surface.

    Attributes
    ----------
    surface : FileSurface
    at, text : int, str
        Line of `DIF`, or of the first command without it.
    kind : str
        One of `KINDS`; empty without `DIF`.
    words : dict
        Line, text and argument by command.
    terms : dict
        Line, text and coefficient by the number of the term, from 1.
    refused : bool
        True once a command was impossible.
    """

    surface: FileSurface
    at: int
    text: str
    kind: str = ""
    words: dict[str, tuple[int, str, str]] = field(default_factory=dict)
    terms: dict[int, tuple[int, str, float]] = field(default_factory=dict)
    refused: bool = False

    def number(self, command: str, default: float | None = None) -> float:
        """Return a command's number; ValueError if it is missing without a default."""
        if command not in self.words:
            if default is None:
                raise ValueError(f"{self.kind} needs {command}")
            return default
        value = self.any_number(command)
        if abs(value) > LARGEST:
            raise ValueError(f"{command} must be {LARGEST:g} or less in magnitude")
        return value

    def any_number(self, command: str) -> float:
        """Return a command's number, of any magnitude; 0 if it is missing."""
        try:
            return number(self.words[command][2]) if command in self.words else 0.0
        except ValueError as error:
            raise ValueError(f"{command}: {error}") from None

    @property
    def lines(self) -> list[tuple[int, str]]:
        """Lines of all commands, in the order of the file."""
        given = (*self.words.values(), *self.terms.values())
        return sorted({(self.at, self.text), *((at, text) for at, text, _ in given)})

    @property
    def has_effect(self) -> bool:
        """True unless all there is are commands of value 0 without `DIF`."""
        return bool(self.kind or self.terms) or any(may_matter(word) for *_, word in self.words.values())

    def word(self, command: str, default: str) -> str:
        """Return a command's word in capitals."""
        return self.words[command][2].upper() if command in self.words else default


class DiffractiveSurfaces:
    """Diffractive surfaces of a file, completed at its end."""

    def __init__(self, report: Report) -> None:
        self._report = report
        self._surfaces: dict[int, _Diffractive] = {}

    def take(self, surface: FileSurface, command: str, words: list[str], line: tuple[int, str]) -> None:
        """Read a command of `COMMANDS`; ValueError if it is impossible.

        Parameters
        ----------
        surface : FileSurface
        command : str
        words : list of str
            After the command and the name of its surface.
        line : tuple of int and str
            Number and text of the line.
        """
        made = self._surfaces.setdefault(id(surface), _Diffractive(surface, *line))
        try:
            self._take(made, command, words, line)
        except (ValueError, IndexError):
            made.refused = True
            raise

    @staticmethod
    def _take(made: _Diffractive, command: str, words: list[str], line: tuple[int, str]) -> None:
        if command == "DIF" or command in KINDS:
            kind = words[0].upper() if command == "DIF" else command
            if kind not in KINDS:
                raise ValueError(f"diffractive surfaces of kind {kind[:20]} are not supported; {', '.join(KINDS)} are")
            made.kind, (made.at, made.text) = kind, line
        elif command == "HCO":
            place = int(number(words[0][1:])) if words[0][:1].upper() == "C" else 0
            if not 1 <= place <= MOST_XY_TERMS:
                raise ValueError(f"it must name a coefficient from C1 to C{MOST_XY_TERMS}")
            made.terms[place] = *line, number(words[1])
        else:
            made.words[command] = *line, words[0]

    def finish(self, unit_mm: float) -> None:
        """Give the surfaces their phases, and the commands their verdicts.

        Parameters
        ----------
        unit_mm : float
            Length of the file's unit.
        """
        for made in self._surfaces.values():
            if made.refused:
                continue
            try:
                made.surface.phase = _phase(made, unit_mm) if made.has_effect else None
            except ValueError as error:
                self._report.refuse(made.at, made.text, str(error))
                continue
            for at, text in made.lines:
                self._report.add(at, text, Verdict.TAKEN if made.has_effect else Verdict.WITHOUT_EFFECT)
            if made.surface.phase is not None and made.surface.phase["kind"] == "hologram":
                self._report.add(made.at, made.text, Verdict.APPROXIMATED, _AS_ZEMAX)


def _phase(made: _Diffractive, unit_mm: float) -> PhaseKeys | None:
    """Return the phase of a surface; ValueError if a scene cannot have it, or if its commands are incomplete."""
    if not made.kind:
        raise ValueError("a command of diffractive surfaces without DIF")
    foreign = [name for name in made.words if (name in _OF_GRATING) != (made.kind == "GRT") and name != "HTO"]
    if foreign or (made.kind == "GRT" and made.terms):
        raise ValueError(f"{foreign[0] if foreign else 'HCO'} does not belong to DIF {made.kind}")
    make: Callable[[_Diffractive, float], PhaseKeys | None] = _grating if made.kind == "GRT" else _diffractive
    return make(made, unit_mm)


def _grating(made: _Diffractive, unit_mm: float) -> PhaseKeys | None:
    """Return the phase of `DIF GRT`."""
    spacing, order = made.number("GRS"), whole_order(made.number("GRO"))
    across, up, along = (made.number(name, default) for name, default in (("GRX", 0.0), ("GRY", 1.0), ("GRZ", 0.0)))
    if not spacing:
        raise ValueError("GRS must not be 0")
    if along:
        raise ValueError("grooves generated by planes that lean against the axis, GRZ, are not supported")
    if not across and not up:
        raise ValueError("GRX and GRY must not both be 0")
    return phase_keys.grating(1.0 / (spacing * unit_mm), math.degrees(math.atan2(up, across)), order)


def _diffractive(made: _Diffractive, unit_mm: float) -> PhaseKeys | None:
    """Return the phase of `DIF DOE` or `DIF HOE`."""
    if made.word("HTO", "SPH") != "SPH":
        raise ValueError(f"HTO {made.word('HTO', '')[:20]} is not supported; SPH is")
    order, design_nm = whole_order(made.number("HOR")), made.number("HWL")
    if not design_nm > SMALLEST:
        raise ValueError("HWL must be above 0")
    points = [_point(made, names, unit_mm) for names in _POINTS]
    virtual = [_is_virtual(made.word(name, "REA")) for name in ("HV1", "HV2")]
    terms = {place: value for place, (_, _, value) in made.terms.items() if value}
    apart = points[0] != points[1] or virtual[0] != virtual[1]
    if apart and (terms or made.kind == "DOE"):
        raise ValueError("construction points beside a polynomial are not supported")
    if apart and not made.surface.is_flat:
        raise ValueError(CURVED_HOLOGRAM)
    if apart:
        return phase_keys.hologram(points, virtual, design_nm, order)
    if made.kind == "HOE" and not terms:
        return None
    return _polynomial(made, terms, 2.0 * math.pi * unit_mm / (1e-6 * design_nm), unit_mm, order)


def _polynomial(
    made: _Diffractive, terms: dict[int, float], rad_per_unit: float, unit_mm: float, order: int
) -> PhaseKeys | None:
    """Return the phase of a polynomial in lengths over the file's unit."""
    form = made.word("HCT", "")
    most = {"R": MOST_RADIAL_TERMS, "XY": MOST_XY_TERMS}
    if form not in most:
        raise ValueError(f"{f'HCT {form[:20]} is not supported' if form else 'it needs HCT'}; R and XY are supported")
    if max(terms, default=1) > most[form]:
        raise ValueError(f"HCT {form} has at most {most[form]} terms, not C{max(terms)}")
    if any(abs(value) > LARGEST for value in terms.values()):
        raise ValueError(f"HCO must be {LARGEST:g} or less in magnitude")
    values = {place: rad_per_unit * value for place, value in terms.items()}
    if form == "XY":
        return phase_keys.xy({powers_of(place): value for place, value in values.items()}, unit_mm, order)
    return phase_keys.radial([values.get(place, 0.0) for place in range(1, max(values, default=0) + 1)], unit_mm, order)


def _point(made: _Diffractive, names: tuple[str, str, str], unit_mm: float) -> Point:
    """Return a construction point."""
    x, y, z = (made.any_number(name) for name in names)
    return phase_keys.point_mm(x, y, z, unit_mm)


def _is_virtual(word: str) -> bool:
    """Tell whether light converges to a point; ValueError for an unknown word."""
    if word not in ("REA", "VIR"):
        raise ValueError(f"{word[:20]} is unknown; REA and VIR are known")
    return word == "VIR"
