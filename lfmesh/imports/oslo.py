"""OSLO lens files (`.len`): the sequential, centred, refracting part of the format.

The format: commands separated by `;` or line ends, `//` starts a comment, `NXT` goes on to the next surface, the first
of which is the object. Radii, thicknesses and apertures are in units of UNI mm, wavelengths in µm, the primary one
first. `AP` sizes a surface for drawing, and stops light with `CHK` alone.
"""

import math
import re
from collections.abc import Callable
from pathlib import Path

from lfmesh.errors import GlassError, SceneError
from lfmesh.imports.conditions import FieldPoint
from lfmesh.imports.glasses import private_glass
from lfmesh.imports.lens_making import lens_of, refuse_choices
from lfmesh.imports.numbers import is_number, may_matter, number, numbers
from lfmesh.imports.prescription import FAR_MM, MOST_SURFACES, FileSurface, Prescription
from lfmesh.imports.report import Report, Verdict
from lfmesh.imports.text import command_names, read_lines
from lfmesh.scene.camera.lens import AS_IT_STANDS, FileChoices, Lens

COEFFICIENTS = ("AD", "AE", "AF", "AG")
"""Of r⁴, r⁶, r⁸, r¹⁰."""

_WITHOUT_EFFECT = command_names("DES SNO WW TCE DRW PUK AMO APCK CBK WRS ZRF NOT TIT MCO ERR IGNR IMS ANS MCN")
"""Names, notes, weights, temperatures, drawing."""

_REFUSED = {
    **dict.fromkeys(["DCX", "DCY", "DCZ", "TLA", "TLB", "TLC", "BEN", "RCO", "GC", "GCS"], "tilted and decentred axes"),
    **dict.fromkeys(["ASP", "DOE", "GRX", "GOR", "GSP", "HOR", "HV1", "HV2"], "aspheres but AD to AG, and gratings,"),
    **dict.fromkeys(["CVX", "RDX", "TCV"], "toroids"),
    **dict.fromkeys(["GRD", "GDT", "GIN"], "gradient indices"),
    **dict.fromkeys(["LMO", "NSS"], "groups of surfaces"),
    **dict.fromkeys(["ATP", "AX1", "AX2", "AY1", "AY2", "AAC", "APN"], "apertures that are not round"),
    **dict.fromkeys(["PK", "APK"], "pickups, whose values the file does not hold,"),
}

_SOLVES = command_names("PY PYC PU PUC PI PIC CVS EC PCR")
"""Solves; the present value stands beside them, or the surface has none."""


def read(path: Path, lines: list[str] | None = None, choices: FileChoices = AS_IT_STANDS) -> tuple[Lens, Report]:
    """Return the lens of an OSLO file, and what became of its commands.

    Parameters
    ----------
    path : Path
    lines : list of str, optional
        Its text, in place of reading it.
    choices : FileChoices
        Substitutes of glasses.

    Raises
    ------
    SceneError
        The file cannot be read, or holds what the lens cannot have.
    """
    refuse_choices(path, choices)
    reader = _Reader(Report(path))
    for at, line in enumerate(read_lines(path) if lines is None else lines, 1):
        for words in commands(line):
            reader.take(at, words)
    return lens_of(reader.finished(), reader.report, choices.substitutes), reader.report


def commands(line: str) -> list[list[str]]:
    """Return the commands of a line, each as its words; quoted words lose their quotes."""
    found: list[list[str]] = [[]]
    for quoted, sign, word in re.findall(r'"([^"]*)"?|(;|//.*)|([^\s;"]+)', line):
        if sign.startswith("//"):
            break
        if sign:
            found.append([])
        else:
            found[-1].append(word or quoted)
    return [words for words in found if words]


class _Reader:
    """Reads command by command; one without a method of its name is looked up in the tables above."""

    def __init__(self, report: Report) -> None:
        self.report = report
        self.made = Prescription(surfaces=[FileSurface(1, "object")])
        self.given: set[int] = {0}
        self.solved: dict[int, tuple[int, str]] = {}
        self.beam: tuple[int, str, float] | None = None
        self.height: float | None = None
        self.begun = self.ended = False
        self.at, self.text = 0, ""

    def take(self, at: int, words: list[str]) -> None:
        """Read one command."""
        self.at, self.text = at, " ".join(words)
        command, rest = words[0].upper(), words[1:]
        method: Callable[[list[str]], None] | None = getattr(self, f"_on_{command.lower()}", None)
        if self.ended:
            self._add(Verdict.WITHOUT_EFFECT)
            return
        try:
            if method is not None:
                method(rest)
            elif command in COEFFICIENTS:
                self._coefficient(COEFFICIENTS.index(command), number(rest[0]))
            elif command in _REFUSED:
                if not rest or any(map(may_matter, rest)):
                    raise ValueError(f"{_REFUSED[command]} are not supported")
                self._add(Verdict.WITHOUT_EFFECT)
            elif command in _SOLVES:
                self.solved[len(self.made.surfaces) - 1] = at, self.text
                self._add(Verdict.TAKEN, "a solve: the present value")
            elif command in _WITHOUT_EFFECT or command.startswith("SNO"):
                self._add(Verdict.WITHOUT_EFFECT)
            else:
                self._add(Verdict.UNKNOWN)
        except (ValueError, IndexError) as error:
            self.report.refuse(at, self.text, str(error) if isinstance(error, ValueError) else "it is cut short")

    def finished(self) -> Prescription:
        """Return what was read, with what only the whole file shows."""
        made = self.made
        if not self.begun:
            raise SceneError(f"{self.report.path}: no OSLO lens file: it has no line LEN NEW")
        if not self.ended:
            raise SceneError(f"{self.report.path}: cut short: it has no line END")
        for k, (at, text) in self.solved.items():
            if k not in self.given and k + 2 < len(made.surfaces):
                self.report.refuse(at, text, "a solve for a thickness that the file does not hold")
        distance = made.surfaces[0].thickness
        if abs(distance * made.unit_mm) >= FAR_MM:
            distance = made.surfaces[0].thickness = math.inf
        if self.beam is not None:
            radius = self.beam[2]
            # Of a near object it is the beam's radius in the plane of the first surface.
            near = math.sin(math.atan2(radius, distance))
            made.pupil = ("epd", 2.0 * radius) if math.isinf(distance) else ("object_na", near)
        if self.height is not None:
            made.field_kind = "object"
            if math.isinf(distance):
                raise SceneError(f"{self.report.path}: OBH = {self.height:g}: of an object at infinity give ANG")
        return made

    @property
    def _surface(self) -> FileSurface:
        return self.made.surfaces[-1]

    def _add(self, verdict: Verdict, how: str = "") -> None:
        self.report.add(self.at, self.text, verdict, how)

    def _on_len(self, words: list[str]) -> None:
        self.begun = self.begun or words[0].upper() == "NEW"
        self.made.name = words[1] or None
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
        self.beam = self.at, self.text, self._above_zero(words)

    def _on_nao(self, words: list[str]) -> None:
        self.made.pupil = "object_na", self._above_zero(words)

    def _on_nap(self, words: list[str]) -> None:
        self.made.pupil = "image_na", self._above_zero(words)

    def _on_fno(self, words: list[str]) -> None:
        self.made.pupil = "f_number", self._above_zero(words)

    def _on_ang(self, words: list[str]) -> None:
        self.made.fields = [FieldPoint(), FieldPoint(0.0, number(words[0]))]
        self._add(Verdict.TAKEN)

    def _on_obh(self, words: list[str]) -> None:
        self.height = number(words[0])
        self.made.fields = [FieldPoint(), FieldPoint(0.0, self.height)]
        self._add(Verdict.TAKEN)

    def _on_wv(self, words: list[str]) -> None:
        micrometres = numbers(words)
        if not micrometres or min(micrometres) <= 0.0:
            raise ValueError("a wavelength must be above 0")
        self.made.wavelengths_nm = [float(f"{value * 1000.0:.10g}") for value in micrometres]
        self._add(Verdict.TAKEN)

    def _on_nxt(self, _: list[str]) -> None:
        if len(self.made.surfaces) >= MOST_SURFACES:
            raise SceneError(f"{self.report.path}: line {self.at}: more than {MOST_SURFACES} surfaces")
        self.made.surfaces.append(FileSurface(self.at, f"surface {len(self.made.surfaces)}"))
        self._add(Verdict.TAKEN)

    def _on_end(self, _: list[str]) -> None:
        self.ended = True
        self._add(Verdict.TAKEN)

    def _on_rd(self, words: list[str]) -> None:
        radius = number(words[0])
        self._surface.curvature = 1.0 / radius if radius else 0.0
        self._add(Verdict.TAKEN)

    def _on_cv(self, words: list[str]) -> None:
        self._surface.curvature = number(words[0])
        self._add(Verdict.TAKEN)

    def _on_th(self, words: list[str]) -> None:
        self._surface.thickness = number(words[0])
        self.given.add(len(self.made.surfaces) - 1)
        self._add(Verdict.TAKEN)

    def _on_cc(self, words: list[str]) -> None:
        self._surface.conic = number(words[0])
        self._add(Verdict.TAKEN)

    def _coefficient(self, place: int, value: float) -> None:
        terms = self._surface.asphere
        terms += [0.0] * (place + 1 - len(terms))
        terms[place] = value
        self._add(Verdict.TAKEN)

    def _on_ap(self, words: list[str]) -> None:
        checked = words[0].upper() == "CHK"
        radius = abs(number(words[-1]))
        size = radius if 0.0 < radius * self.made.unit_mm < FAR_MM else None
        if checked:
            self._surface.aperture = size
        else:
            self._surface.extent = size
        self._add(Verdict.TAKEN if checked and size else Verdict.WITHOUT_EFFECT)

    def _on_ast(self, _: list[str]) -> None:
        self._surface.stop = True
        self._add(Verdict.TAKEN)

    def _on_pfl(self, words: list[str]) -> None:
        self._surface.focal_length = number(words[0])
        self._add(Verdict.APPROXIMATED, "a perfect lens, by the sine condition; taken as a thin lens, by the tangent's")

    def _on_pfm(self, _: list[str]) -> None:
        self._add(Verdict.WITHOUT_EFFECT)

    def _on_air(self, _: list[str]) -> None:
        self._add(Verdict.TAKEN)

    def _on_rfl(self, _: list[str]) -> None:
        raise ValueError("mirrors are not supported: the lens refracts")

    _on_rfh = _on_rfl

    def _on_gla(self, words: list[str]) -> None:
        surface = self._surface
        if words[0].upper() == "MOD":
            # A name may stand before the numbers.
            words = words[1:] if is_number(words[1]) else words[2:]
            if len(words) == 2 and number(words[1]) > 10.0:
                surface.model = number(words[0]), number(words[1])
                self._add(Verdict.TAKEN)
                return
        if not is_number(words[0]):
            surface.glass = words[0]
        elif len(words) == 1:
            surface.model = number(words[0]), 0.0
        else:
            own = f"GLA {self.at}"
            try:
                self.made.indices[own] = private_glass(self.made.wavelengths_nm, numbers(words))
            except GlassError as error:
                raise ValueError(str(error)) from None
            surface.glass = own
        self._add(Verdict.TAKEN)
