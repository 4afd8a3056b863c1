"""Surfaces of Zemax lens files: the commands behind `SURF`, passed on by `lfmesh.imports.zemax`."""

import math

from lfmesh.errors import SceneError
from lfmesh.imports.decentres import Move
from lfmesh.imports.numbers import number, numbers
from lfmesh.imports.prescription import MOST_SURFACES, FileSurface, Prescription
from lfmesh.imports.report import Report, Verdict
from lfmesh.imports.zemax_gradients import READERS as GRADIENTS
from lfmesh.imports.zemax_gradients import GradientLines
from lfmesh.imports.zemax_lines import SurfaceLines, Value
from lfmesh.imports.zemax_phases import ASPHERIC, PhaseLines
from lfmesh.imports.zemax_phases import READERS as PHASES
from lfmesh.imports.zemax_tables import (
    ASPHERES,
    BEFORE_EXTRA,
    EXTENDED,
    FIRST_TERM,
    FORBES,
    LAST_OF_TOROID,
    MOST_EXTRA,
    OF_ZERNIKE_TERMS,
    ORDER_OF_BREAK,
    REFUSED_TYPES,
    SECTIONS,
    ZERNIKE_TERMS,
)
from lfmesh.scene.camera.qcon import MOST_ASPHERE_TERMS

_LATE: dict[str, type[SurfaceLines]] = {**dict.fromkeys(PHASES, PhaseLines), **dict.fromkeys(GRADIENTS, GradientLines)}
"""Types whose lines are read once the file has ended."""


class SurfaceReader:
    """Reader of surface lines; a command NAME goes to the method `_on_name` with its words.

    Attributes
    ----------
    report : Report
    made : Prescription
        Receives the surfaces.
    at, text : int, str
        Number (from 1) and text of the current line.
    """

    def __init__(self, report: Report) -> None:
        self.report = report
        self.made = Prescription()
        self.at, self.text = 0, ""
        self.kind = "STANDARD"
        self.break_values: dict[int, float] = {}
        self.drawn: list[tuple[int, str, FileSurface]] = []
        self.distance_line = 0, ""
        self.extra: dict[int, tuple[int, str, float]] = {}
        self.late: dict[int, SurfaceLines] = {}
        """By the number of the following surface."""

    def end_surfaces(self) -> None:
        """Complete the surfaces with values that depend on the whole file."""
        if self.distance_line[0]:
            self.report.add(*self.distance_line, Verdict.WITHOUT_EFFECT, "nothing lies behind the image")
            self.distance_line = 0, ""
        self._end_surface()
        self._end_drawn()
        refused = [line.number for line in self.report.of(Verdict.REFUSED)]
        for following, lines in self.late.items():
            end = self.made.surfaces[following].line if following < len(self.made.surfaces) else math.inf
            if not any(lines.at < number < end for number in refused):
                lines.take(self.made, self.report)

    def _end_drawn(self) -> None:
        """Report which semi-diameters are used: a pupil or clear aperture makes them drawing sizes only."""
        for at, text, surface in self.drawn:
            sized = surface.stop and self.made.pupil[0] != "stop"
            ends = surface is self.made.surfaces[0] or surface is self.made.surfaces[-1]
            cut = surface.aperture is not None and surface.aperture != surface.extent
            unused = sized or ends or cut or surface.is_break
            self.report.add(at, text, Verdict.WITHOUT_EFFECT if unused else Verdict.TAKEN)

    @property
    def _surface(self) -> FileSurface:
        if not self.made.surfaces:
            raise ValueError("it stands before the first SURF")
        return self.made.surfaces[-1]

    def _taken(self, how: str = "") -> None:
        self.report.add(self.at, self.text, Verdict.TAKEN, how)

    def _approximated(self, how: str) -> None:
        self.report.add(self.at, self.text, Verdict.APPROXIMATED, how)

    def _without_effect(self) -> None:
        self.report.add(self.at, self.text, Verdict.WITHOUT_EFFECT)

    def _refuse(self, why: str) -> None:
        self.report.refuse(self.at, self.text, why)

    def _on_surf(self, _: list[str]) -> None:
        if len(self.made.surfaces) >= MOST_SURFACES:
            raise SceneError(f"{self.report.path}: line {self.at}: more than {MOST_SURFACES} surfaces")
        self._end_surface()
        self.made.surfaces.append(FileSurface(self.at, self.text))
        self.kind = "STANDARD"
        self._taken()

    def _end_surface(self) -> None:
        """Complete a surface after its last line."""
        if self.distance_line[0]:
            self.report.add(*self.distance_line, Verdict.TAKEN)
            self.distance_line = 0, ""
        if self.break_values:
            x, y, *tilt, tilts_first = (self.break_values.get(place, 0.0) for place in range(1, ORDER_OF_BREAK + 1))
            make = Move.tilted_then_shifted if tilts_first else Move.shifted_then_tilted
            self._surface.before = make((x, y, 0.0), tilt)
            self.break_values = {}
        if self.extra:
            self._end_extra()

    def _on_type(self, words: list[str]) -> None:
        surface, self.kind = self._surface, words[0].upper()
        surface.is_break = self.kind == "COORDBRK"
        self.late.pop(len(self.made.surfaces), None)
        if self.kind in _LATE:
            # Its verdict and those on its lines depend on all of them.
            self.late[len(self.made.surfaces)] = _LATE[self.kind](self.kind, surface, self.at, self.text)
        elif self.kind in ("STANDARD", "COORDBRK", FORBES, *ASPHERES):
            self._taken()
        elif self.kind in SECTIONS:
            self._surface.section = SECTIONS[self.kind]
            self._taken()
        elif self.kind == "PARAXIAL":
            self._surface.focal_length = math.nan
            self._taken("a thin lens")
        else:
            why = REFUSED_TYPES.get(self.kind, f"surfaces of type {self.kind} are not supported")
            supported = ", ".join((*ASPHERES, *SECTIONS, FORBES, *_LATE))
            self._refuse(f"{why}; STANDARD, {supported} and PARAXIAL are")

    def _on_stop(self, _: list[str]) -> None:
        self._surface.stop = True
        self._taken()

    def _on_curv(self, words: list[str]) -> None:
        self._surface.curvature = number(words[0])
        self._taken(self._solve(words[1:2]))

    def _on_disz(self, words: list[str]) -> None:
        if words[0].upper().startswith("INF"):
            if len(self.made.surfaces) > 1:
                raise ValueError("only the object may lie at infinity")
            self._surface.thickness = math.inf
        else:
            self._surface.thickness = number(words[0])
        self.distance_line = self.at, self.text

    @staticmethod
    def _solve(words: list[str]) -> str:
        return "a solve or pickup: its present value" if words and words[0] not in ("0", "1") else ""

    def _on_glas(self, words: list[str]) -> None:
        name, surface = words[0], self._surface
        if name.upper() == "MIRROR":
            self._refuse("mirrors are not supported: the lens refracts")
            return
        if self.kind in REFUSED_TYPES:
            # Its refusal covers the glass.
            return
        surface.glass_line = self.at, self.text
        values = numbers(words[3:5]) if len(words) > 4 else []
        if name == "___BLANK" or (len(words) > 1 and words[1] == "1"):
            if len(values) < 2:
                raise ValueError("a model glass needs nd and Vd")
            if len(words) > 5 and number(words[5]):
                self._approximated("the deviation of its partial dispersion is not used")
            surface.model = values[0], values[1]
        else:
            surface.glass = name
            # Catalogue glasses carry 1.5 and 40 if the program never wrote their values.
            if values and values[0] not in (0.0, 1.5):
                surface.stated_index, surface.stated_abbe = values[0], values[1] or None
        self._taken(self._solve(["2"] if len(words) > 1 and words[1] == "2" else []))

    def _on_coni(self, words: list[str]) -> None:
        self._surface.conic = number(words[0])
        self._taken()

    def _on_parm(self, words: list[str]) -> None:
        place, value = int(number(words[0])), number(words[1])
        if self.kind in _LATE and not (self.kind in ASPHERIC and 1 <= place <= 8):
            self._put(place, value)
        elif not value:
            self._taken()
        elif self.kind in FIRST_TERM and place > BEFORE_EXTRA:
            # Later versions store extra data among the parameters.
            self._on_xdat([str(place - BEFORE_EXTRA), words[1]])
        elif self.kind in ("EVENASPH", *ASPHERIC) and 1 <= place <= 8:
            self._add_term(2 * place, value)
        elif self.kind == "ODDASPHE" and 1 <= place <= 8:
            self._add_term(place, value)
        elif self.kind in SECTIONS and place == 1:
            self._surface.curvature_x = 1.0 / value
            self._taken()
        elif self.kind == "BICONICX" and place == 2:
            self._surface.conic_x = value
            self._taken()
        elif self.kind == "TOROIDAL" and 2 <= place <= LAST_OF_TOROID:
            self._add_term(2 * place - 2, value)
        elif self.kind == "TOROIDAL" and place == ZERNIKE_TERMS:
            self._refuse("Zernike terms of a toroid are not supported")
        elif self.kind == "TOROIDAL" and place in OF_ZERNIKE_TERMS:
            self._without_effect()
        elif self.kind in (*ASPHERES, *SECTIONS, FORBES):
            self._refuse(f"parameter {place} of {self.kind} is unknown")
        elif self.kind == "COORDBRK" and 1 <= place <= ORDER_OF_BREAK:
            self.break_values[place] = value
            self._taken()
        elif self.kind == "PARAXIAL" and place == 1:
            self._surface.focal_length = value
            self._taken()
        elif self.kind in ("STANDARD", "PARAXIAL"):
            self._without_effect()
        # Parameters of a refused type are covered by its refusal.

    def _put(self, place: int, value: float, extra: bool = False) -> None:
        """Keep a number for the end of the file; later versions store extra data among the parameters."""
        lines = self.late[len(self.made.surfaces)]
        if place > BEFORE_EXTRA and not extra:
            place, extra = place - BEFORE_EXTRA, True
        values = lines.extra if extra else lines.parameters
        values[place] = Value(self.at, self.text, value)

    def _add_term(self, power: int, value: float) -> None:
        """Add a term in a power of r to the sag."""
        if not math.isfinite(value):
            self._refuse(f"its term in r^{power} overflows float64")
            return
        try:
            self._surface.add_term(power, value)
        except ValueError as error:
            self._refuse(str(error))
        else:
            self._taken("in the curvature, the conic constant and the other terms" if power == 2 else "")

    def _on_xdat(self, words: list[str]) -> None:
        place, value = int(number(words[0])), number(words[1])
        if self.kind in _LATE:
            self._put(place, value, extra=True)
        elif self.kind in FIRST_TERM:
            # Its meaning depends on the number of terms, known at the surface's end.
            self.extra[place] = self.at, self.text, value
        elif not value:
            self._taken()
        elif self.kind == "TOROIDAL":
            # The number of terms and the normalisation radius precede the coefficients.
            if place > 2:
                self._refuse("Zernike terms of a toroid are not supported")
            else:
                self._without_effect()
        elif self.kind in ("STANDARD", "COORDBRK", "PARAXIAL", "BICONICX", *ASPHERES):
            self.report.add(self.at, self.text, Verdict.UNKNOWN)

    def _end_extra(self) -> None:
        """Apply the XDAT values to the surface."""
        first = FIRST_TERM.get(self.kind, 0)
        values = {place: value for place, (_, _, value) in self.extra.items()}
        count = values.get(first - 2, float(MOST_EXTRA))
        norm_radius = values.get(first - 1, 1.0 if self.kind in EXTENDED else 0.0)
        terms = [values.get(first + k, 0.0) for k in range(max(0, min(int(count), MOST_EXTRA)))]
        line = self.at, self.text
        for place, (at, text, value) in sorted(self.extra.items()):
            self.at, self.text = at, text
            if place == first - 1 and not value > 0.0:
                self._refuse("the normalisation radius must be above 0")
            elif place < first or not value:
                self._taken()
            elif place - first >= count:
                self.report.add(at, text, Verdict.WITHOUT_EFFECT, f"XDAT {first - 2} counts {count:g} terms")
            elif self.kind in EXTENDED:
                power = EXTENDED[self.kind] * (place - first + 1)
                self._add_term(power, _over(value, norm_radius, power) if norm_radius > 0.0 else 0.0)
            elif place - first >= MOST_ASPHERE_TERMS:
                self._refuse(f"Forbes' aspheres have at most {MOST_ASPHERE_TERMS} terms")
            else:
                self._taken()
        self.at, self.text = line
        if self.kind == FORBES and any(terms) and norm_radius > 0.0:
            kind = "qcon" if values.get(1) else "qbfs"
            self._surface.forbes = kind, norm_radius, terms[:MOST_ASPHERE_TERMS]
        self.extra = {}

    def _on_diam(self, words: list[str]) -> None:
        self._surface.extent = abs(number(words[0])) or None
        self.drawn.append((self.at, self.text, self._surface))

    def _on_clap(self, words: list[str]) -> None:
        inner, outer = numbers(words[:2])
        if inner > 0:
            self._refuse("a ring-shaped aperture is not supported: its middle is dark")
        elif outer > 0:
            self._surface.aperture = outer
            self._taken()
        else:
            self._taken("the semi-diameter")
            self._surface.aperture = self._surface.extent

    _on_flap = _on_clap

    def _on_coat(self, words: list[str]) -> None:
        # The verdict comes at the end, as it depends on the primary wavelength and the media.
        self._surface.coating = (self.at, self.text, words[0])

    def _on_sqap(self, words: list[str]) -> None:
        half = numbers(words[:2])
        self._surface.aperture = math.hypot(*half)
        self._approximated("a rectangular aperture: the circle around it")

    def _on_obdc(self, words: list[str]) -> None:
        if any(numbers(words[:2])):
            self._refuse("a decentred aperture is not supported")
        else:
            self._taken()

    def _on_scbd(self, words: list[str]) -> None:
        if any(numbers(words[2:])):
            self._refuse("a decentred or tilted surface is not supported; put coordinate breaks around it")
        else:
            self._taken()


def _over(value: float, radius: float, power: int) -> float:
    """Return a coefficient over a power of a radius; 0 or inf beyond the range of floats."""
    try:
        return value / radius**power
    except OverflowError:
        return 0.0
    except ZeroDivisionError:
        return math.inf
