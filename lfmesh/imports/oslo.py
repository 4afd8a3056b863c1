"""OSLO lens files (`.len`): the sequential, refracting part of the format.

In OSLO's Program Reference, commands end at `;` or line ends, blanks or commas separate words, and `//` starts a
comment. `NXT` goes to the next surface (the object is the first), `GTO` to any other. Radii, thicknesses and apertures
are in units of UNI mm, wavelengths in µm, primary first. `AP` sizes a surface for drawing, and stops light only with
`CHK`. Tilts and decentres of a surface move the axis for everything behind it, unless `RCO` undoes them (Optics
Reference, coordinate transforms).
"""

import math
import re
from collections.abc import Callable
from pathlib import Path

from lfmesh.errors import GlassError, SceneError
from lfmesh.imports.conditions import FieldPoint
from lfmesh.imports.decentres import Move
from lfmesh.imports.glasses import private_glass
from lfmesh.imports.lens_making import lens_of, refuse_choices
from lfmesh.imports.numbers import is_number, may_matter, number, numbers
from lfmesh.imports.prescription import FAR_MM, MOST_SURFACES, FileSurface, Prescription
from lfmesh.imports.report import Report, Verdict
from lfmesh.imports.text import command_names, read_lines
from lfmesh.scene.camera.lens import AS_IT_STANDS, FileChoices, Lens

COEFFICIENTS = ("AD", "AE", "AF", "AG")
"""Coefficients of r⁴, r⁶, r⁸, r¹⁰: other names of AS2 to AS5."""

_ASPHERES = {"ASR": 2, "ARA": 1}
"""General aspheres, with the step of the power of r from one coefficient AS to the next."""

_FIXED = {"RDF": "RD", "CVF": "CV", "THF": "TH", "AIF": "AIR", "GLF": "GLA", "APF": "AP"}
"""Commands for values that an optimisation must not change."""

_MOVES = ("DCX", "DCY", "DCZ", "TLA", "TLB", "TLC", "TOX", "TOY", "TOZ")
"""Decentres, rotations about the own x and y axes (left-handed) and z axis (right-handed), and their pivot."""

_NUMBERED = re.compile(r"(WV|WW|SNO|AS|CBK|ELMDF)(\d+)")

_WITHOUT_EFFECT = command_names(
    "DES SNO WW TCE DRW AMO CBK WRS ZRF NOT TIT MCO ERR IGNR IMS ANS MCN PFM LDP BDI BDD VX PF ELMDF LMN LME"
)
"""Names, notes, weights, temperatures, drawing."""

_REFUSED = {
    "BEN": "an axis that bends at a mirror is",
    **dict.fromkeys(["GC", "GCS"], "surfaces placed from any but the previous surface are"),
    **dict.fromkeys(["DOE", "GRX", "GOR", "GSP", "HOR", "HV1", "HV2"], "gratings are"),
    **dict.fromkeys(["GRD", "GDT", "GIN"], "gradient indices are"),
    "NSS": "non-sequential groups are",
    **dict.fromkeys(["ATP", "AX1", "AX2", "AY1", "AY2", "AAC", "APN"], "apertures that are not round are"),
    **dict.fromkeys(["PK", "APK"], "pickups, whose values the file does not hold, are"),
}

_FAR = 1e8
"""Distance, in the file's unit, from which the object is infinite (Optics Reference, telecentric ray aiming)."""

_USUAL_NM = (587.56, 486.13, 656.27)
"""Default wavelengths."""

_SOLVES = command_names("PY PYC PU PUC PI PIC CVS EC PCR")
"""Solves; the present value is given beside them, or the surface has none."""


def read(path: Path, lines: list[str] | None = None, choices: FileChoices = AS_IT_STANDS) -> tuple[Lens, Report]:
    """Return the lens of an OSLO file and the report on its commands.

    Parameters
    ----------
    path : Path
    lines : list of str, optional
        Text of the file; read from `path` if omitted.
    choices : FileChoices
        Substitute glasses.

    Raises
    ------
    SceneError
        The file cannot be read, or its lens is not supported.
    """
    refuse_choices(path, choices)
    reader = _Reader(Report(path))
    for at, line in enumerate(read_lines(path) if lines is None else lines, 1):
        for words in commands(line):
            reader.take(at, words)
    return lens_of(reader.finished(), reader.report, choices.substitutes), reader.report


def commands(line: str) -> list[list[str]]:
    """Return the commands of a line, each as its words without quotes."""
    found: list[list[str]] = [[]]
    for quoted, sign, word in re.findall(r'"([^"]*)"?|(;|//.*)|([^\s,;"]+)', line):
        if sign.startswith("//"):
            break
        if sign:
            found.append([])
        else:
            found[-1].append(word or quoted)
    return [words for words in found if words]


class _Reader:
    """Reader of commands; a command without its own method is looked up in the tables above."""

    def __init__(self, report: Report) -> None:
        self.report = report
        self.made = Prescription(surfaces=[FileSurface(1, "object")], wavelengths_nm=list(_USUAL_NM))
        self.place = 0
        self.given: set[int] = {0}
        self.solved: dict[int, tuple[int, str]] = {}
        self.moves: dict[int, dict[str, float]] = {}
        self.returns: dict[int, tuple[int, str]] = {}
        self.aspheres: dict[int, int] = {}
        self.terms: dict[int, dict[int, tuple[int, str, float]]] = {}
        self.beam: float | None = None
        self.edge: tuple[str, float] | None = None
        self.stated: tuple[int, str, int] | None = None
        self.checked = True
        self.begun = self.ended = False
        self.at, self.text = 0, ""

    def take(self, at: int, words: list[str]) -> None:
        """Read one command."""
        self.at, self.text = at, " ".join(words)
        command, rest = _FIXED.get(words[0].upper(), words[0].upper()), words[1:]
        numbered = _NUMBERED.fullmatch(command)
        command = numbered[1] if numbered else command
        method: Callable[[list[str]], None] | None = getattr(self, f"_on_{command.lower()}", None)
        try:
            if self.ended:
                self._behind(command, rest)
            elif numbered and command in ("WV", "AS"):
                (self._wavelength if command == "WV" else self._term)(int(numbered[2]), number(rest[0]))
            elif method is not None:
                method(rest)
            elif command in COEFFICIENTS:
                self._term(COEFFICIENTS.index(command) + 2, number(rest[0]))
            elif command in _MOVES:
                self.moves.setdefault(self.place, {})[command] = number(rest[0])
                self._add(Verdict.TAKEN)
            elif command in _REFUSED:
                if not rest or any(map(may_matter, rest)):
                    raise ValueError(f"{_REFUSED[command]} not supported")
                self._add(Verdict.WITHOUT_EFFECT)
            elif command in _SOLVES:
                self.solved[self.place] = at, self.text
                self._add(Verdict.TAKEN, "a solve: the present value")
            else:
                self._add(Verdict.WITHOUT_EFFECT if command in _WITHOUT_EFFECT else Verdict.UNKNOWN)
        except (ValueError, IndexError) as error:
            self.report.refuse(at, self.text, str(error) if isinstance(error, ValueError) else "it is cut short")

    def _behind(self, command: str, words: list[str]) -> None:
        """Read the field points behind the surfaces; other states of the lens are not supported."""
        if command == "F" and self.edge is not None:
            y, x, low, up = numbers([words[1], words[2], words[6], words[7]])
            self.made.fields.append(self._field_point(x, y, up, -low))
            self._add(Verdict.TAKEN)
        elif command in ("CFG", "LEN"):
            what = "configurations" if command == "CFG" else "lenses"
            self._add(Verdict.APPROXIMATED, f"further {what} are not read; the surfaces are taken as they stand")
        else:
            self._add(Verdict.WITHOUT_EFFECT)

    def finished(self) -> Prescription:
        """Return the prescription, completed by values that depend on the whole file."""
        made = self.made
        if not self.begun:
            raise SceneError(f"{self.report.path}: not an OSLO lens file: it has no line LEN NEW")
        if not self.ended:
            raise SceneError(f"{self.report.path}: cut short: it has no line END")
        for k, (at, text) in self.solved.items():
            if k not in self.given and k + 2 < len(made.surfaces):
                self.report.refuse(at, text, "a solve for a thickness that the file does not hold")
        behind = len(made.surfaces) - 1
        if self.stated is not None and self.stated[2] != behind:
            self.report.refuse(*self.stated[:2], f"it counts {self.stated[2]} surfaces, but the file holds {behind}")
        for k, surface in enumerate(made.surfaces):
            self._end_terms(k, surface)
            self._end_moves(k, surface)
            if not self.checked and surface.aperture is not None:
                surface.aperture, surface.extent = None, surface.aperture
        if behind > 1:
            # The thickness of the image surface is a focus shift.
            made.surfaces[-2].thickness += made.surfaces[-1].thickness
        self._end_conditions(made)
        return made

    def _end_conditions(self, made: Prescription) -> None:
        """Set the aperture and fields, which depend on the object distance."""
        distance = made.surfaces[0].thickness
        if abs(distance) >= _FAR:
            distance = made.surfaces[0].thickness = math.inf
        if self.beam is None and made.pupil[0] == "stop":
            self.beam = 1.0
            self.report.add(1, "EBR", Verdict.APPROXIMATED, "no aperture in the file: OSLO's own is taken, EBR 1")
        if self.beam is not None:
            # For a near object it is the beam radius in the plane of the first surface.
            near = math.sin(math.atan2(self.beam, distance))
            made.pupil = ("epd", 2.0 * self.beam) if math.isinf(distance) else ("object_na", near)
        if self.edge is not None:
            made.field_kind, value = self.edge
            if made.field_kind == "object" and math.isinf(distance):
                raise SceneError(f"{self.report.path}: OBH = {value:g}: give ANG for an object at infinity")
            made.fields = made.fields or [self._field_point(0.0, share) for share in (0.0, 1.0)]

    def _field_point(self, x: float, y: float, up: float = 1.0, low: float = 1.0) -> FieldPoint:
        """Return the field point at fractions of the field's edge: of a height, or of an angle's tangent."""
        kind, edge = self.edge or ("angle", 0.0)
        if kind != "angle":
            return FieldPoint(x * edge, y * edge, up, low)
        if abs(y) == 1.0 and not x:
            return FieldPoint(0.0, y * edge, up, low)
        slope = math.tan(math.radians(edge))
        return FieldPoint(math.degrees(math.atan(x * slope)), math.degrees(math.atan(y * slope)), up, low)

    def _end_terms(self, place: int, surface: FileSurface) -> None:
        """Apply an asphere's coefficients; their powers depend on its kind."""
        step = self.aspheres.get(place)
        for n, (at, text, value) in self.terms.get(place, {}).items():
            try:
                named = text[:2].upper() in COEFFICIENTS
                if named if step == 1 else not named and step is None:
                    raise ValueError("AD to AG belong to ASP ADO and ASR, AS1 and so on to ASP ASR and ARA")
                surface.add_term((step or 2) * n, value)
            except ValueError as error:
                self.report.refuse(at, text, str(error))

    def _end_moves(self, place: int, surface: FileSurface) -> None:
        """Apply a surface's tilts and decentres."""
        values = self.moves.get(place, {})
        x, y, z, a, b, c, *pivot = (values.get(name, 0.0) for name in _MOVES)
        make = Move.shifted_then_tilted if values.get("DT", 1.0) > 0.0 else Move.tilted_then_shifted
        move = make((x, y, z), (-a, -b, c))
        if any(pivot) and any((a, b, c)):
            shift = pivot - move.turn.apply(pivot)
            move = Move((float(shift[0]), float(shift[1]), float(shift[2])), move.turn)
            if any((x, y, z)):
                self.report.refuse(surface.line, surface.text, "TOX, TOY and TOZ beside decentres are not supported")
        moved = any((x, y, z, a, b, c))
        surface.before = move if moved else None
        if place in self.returns:
            surface.after = move.inverse if moved else None
            self.report.add(*self.returns[place], Verdict.TAKEN if moved else Verdict.WITHOUT_EFFECT)

    @property
    def _surface(self) -> FileSurface:
        return self.made.surfaces[self.place]

    def _add(self, verdict: Verdict, how: str = "") -> None:
        self.report.add(self.at, self.text, verdict, how)

    def _on_len(self, words: list[str]) -> None:
        self.begun = self.begun or words[0].upper() == "NEW"
        self.made.name = words[1] or None
        if len(words) > 3 and is_number(words[3]):
            self.stated = self.at, self.text, int(number(words[3]))
        self._add(Verdict.TAKEN)

    def _on_uni(self, words: list[str]) -> None:
        self.made.unit_mm = self._above_zero(words)

    def _above_zero(self, words: list[str]) -> float:
        value = number(words[0])
        if not value > 0.0:
            raise ValueError("it must be above 0")
        self._add(Verdict.TAKEN)
        return value

    def _on_ebr(self, words: list[str]) -> None:
        self.beam = self._above_zero(words)

    def _on_nao(self, words: list[str]) -> None:
        self._pupil("object_na", self._above_zero(words))

    def _on_nap(self, words: list[str]) -> None:
        self._pupil("image_na", self._above_zero(words))

    def _on_fno(self, words: list[str]) -> None:
        self._pupil("working_f_number", self._above_zero(words))

    def _on_puk(self, words: list[str]) -> None:
        """Read the slope of the marginal ray at the image."""
        slope = abs(number(words[0]))
        self._pupil("image_slope", self._above_zero([repr(slope)]))

    def _pupil(self, kind: str, value: float) -> None:
        # The last such command counts.
        self.made.pupil, self.beam = (kind, value), None

    def _on_ang(self, words: list[str]) -> None:
        if not abs(number(words[0])) < 90.0:
            raise ValueError("it must be below 90 degrees")
        self._field("angle", words)

    def _on_obh(self, words: list[str]) -> None:
        self._field("object", words)

    def _on_gih(self, words: list[str]) -> None:
        self._field("image", words)

    def _field(self, kind: str, words: list[str]) -> None:
        self.edge = kind, number(words[0])
        self._add(Verdict.TAKEN)

    def _on_wv(self, words: list[str]) -> None:
        micrometres = numbers(words)
        if not micrometres or min(micrometres) <= 0.0:
            raise ValueError("a wavelength must be above 0")
        self.made.wavelengths_nm = [float(f"{value * 1000.0:.10g}") for value in micrometres]
        self._add(Verdict.TAKEN)

    def _wavelength(self, place: int, micrometres: float) -> None:
        lines = self.made.wavelengths_nm
        if not 1 <= place <= len(lines) + 1:
            raise ValueError(f"there are {len(lines)} wavelengths before it")
        if not micrometres > 0.0:
            raise ValueError("a wavelength must be above 0")
        self.made.wavelengths_nm = [*lines[: place - 1], float(f"{micrometres * 1000.0:.10g}"), *lines[place:]]
        self._add(Verdict.TAKEN)

    def _on_gto(self, words: list[str]) -> None:
        place = number(words[0])
        if place not in range(len(self.made.surfaces)):
            raise ValueError(f"there is no such surface; the last one is {len(self.made.surfaces) - 1}")
        self.place = int(place)
        self._add(Verdict.TAKEN)

    def _on_nxt(self, _: list[str]) -> None:
        self.place += 1
        if self.place < len(self.made.surfaces):
            self._add(Verdict.TAKEN)
            return
        if len(self.made.surfaces) >= MOST_SURFACES:
            raise SceneError(f"{self.report.path}: line {self.at}: more than {MOST_SURFACES} surfaces")
        self.made.surfaces.append(FileSurface(self.at, f"surface {len(self.made.surfaces)}"))
        self._add(Verdict.TAKEN)

    def _on_end(self, words: list[str]) -> None:
        self.ended = True
        self._add(Verdict.TAKEN)
        if words and (count := number(words[0])) != len(self.made.surfaces) - 1:
            raise ValueError(f"it counts {count:g} surfaces, but the file holds {len(self.made.surfaces) - 1}")

    def _on_rd(self, words: list[str]) -> None:
        radius = number(words[0])
        self._surface.curvature = 1.0 / radius if radius else 0.0
        self._add(Verdict.TAKEN)

    def _on_cv(self, words: list[str]) -> None:
        self._surface.curvature = number(words[0])
        self._add(Verdict.TAKEN)

    def _on_th(self, words: list[str]) -> None:
        self._surface.thickness = number(words[0])
        self.given.add(self.place)
        self._add(Verdict.TAKEN)

    def _on_cc(self, words: list[str]) -> None:
        self._surface.conic = number(words[0])
        self._add(Verdict.TAKEN)

    def _term(self, place: int, value: float) -> None:
        self.terms.setdefault(self.place, {})[place] = self.at, self.text, value
        self._add(Verdict.TAKEN)

    def _on_asp(self, words: list[str]) -> None:
        kind = words[0].upper()
        if kind not in ("ADO", *_ASPHERES):
            raise ValueError(f"aspheres of kind {kind} are not supported; ADO, {' and '.join(_ASPHERES)} are")
        self.aspheres.pop(self.place, None)
        if kind != "ADO":
            self.aspheres[self.place] = _ASPHERES[kind]
        self._add(Verdict.TAKEN)

    def _on_cvx(self, words: list[str]) -> None:
        self._surface.section, self._surface.curvature_x = "toroid", number(words[0])
        self._add(Verdict.TAKEN)

    def _on_rdx(self, words: list[str]) -> None:
        radius = number(words[0])
        self._on_cvx([repr(1.0 / radius if radius else 0.0)])

    def _on_dt(self, words: list[str]) -> None:
        if (order := number(words[0])) not in (1.0, -1.0):
            raise ValueError("it must be 1, decentres first, or -1, tilts first")
        self.moves.setdefault(self.place, {})["DT"] = order
        self._add(Verdict.TAKEN)

    def _on_rco(self, words: list[str]) -> None:
        """Continue the axis as if the surface had no tilts and decentres."""
        if any(map(may_matter, words)) and number(words[0]) != self.place:
            raise ValueError("a return to the axis of another surface is not supported")
        self.returns[self.place] = self.at, self.text

    def _on_ap(self, words: list[str]) -> None:
        checked = words[0].upper() == "CHK"
        radius = number(words[-1])
        if radius < 0.0:
            raise ValueError("it must be 0, for the size that rays fill, or more")
        size = radius if 0.0 < radius * self.made.unit_mm < FAR_MM else None
        if checked:
            self._surface.aperture = size
        else:
            self._surface.extent = size
        self._add(Verdict.TAKEN if checked and size else Verdict.WITHOUT_EFFECT)

    def _on_apck(self, words: list[str]) -> None:
        state = words[0].upper()
        if state not in ("ON", "OFF"):
            raise ValueError("it must be ON or OFF")
        self.checked = state == "ON"
        self._add(Verdict.TAKEN)

    def _on_ast(self, _: list[str]) -> None:
        self._surface.stop = True
        self._add(Verdict.TAKEN)

    def _on_lmo(self, words: list[str]) -> None:
        if words[0].upper() not in ("ELE", "EGR"):
            raise ValueError(f"{_REFUSED['NSS']} not supported")
        self._add(Verdict.WITHOUT_EFFECT)

    def _on_pfl(self, words: list[str]) -> None:
        self._surface.focal_length = number(words[0])
        self._add(Verdict.APPROXIMATED, "a perfect lens, by the sine condition; taken as a thin lens, by the tangent's")

    def _on_air(self, _: list[str]) -> None:
        self._add(Verdict.TAKEN)

    def _on_rfl(self, _: list[str]) -> None:
        raise ValueError("mirrors are not supported: the lens refracts")

    _on_rfh = _on_rfl

    def _on_gla(self, words: list[str]) -> None:
        surface = self._surface
        if words[0].upper() == "MOD":
            # A name may precede the numbers.
            words = words[1:] if is_number(words[1]) else words[2:]
            if len(words) == 2 and number(words[1]) > 10.0:
                surface.model = number(words[0]), number(words[1])
                self._add(Verdict.TAKEN)
                return
        indices = words if is_number(words[0]) else words[1:]
        if not indices:
            surface.glass = words[0]
        elif len(indices) == 1:
            surface.model = number(indices[0]), 0.0
        else:
            own = f"GLA {self.at}"
            try:
                self.made.indices[own] = private_glass(self.made.wavelengths_nm, numbers(indices))
            except GlassError as error:
                raise ValueError(str(error)) from None
            surface.glass = own
        self._add(Verdict.TAKEN)
