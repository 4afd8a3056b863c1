"""CODE V sequence files (`.seq`): the sequential, centred, refracting part of the language.

The reader is lfmesh's own, for the reasons in `lfmesh.imports.zemax`.

Commands end at `;` or line ends, `&` continues a line, `!` starts a comment. `SO`, `S` and `SI` give the object, a
surface and the image: curvature or radius (RDM), thickness, glass. Other commands qualify the last surface, or the one
that they name (`CIR S3 12`). Lengths are in the unit of DIM, wavelengths in nm.
"""

import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path, PureWindowsPath

from lfmesh.errors import GlassError, SceneError
from lfmesh.imports.codev_commands import commands
from lfmesh.imports.codev_phases import COMMANDS, DiffractiveSurfaces
from lfmesh.imports.codev_tables import (
    COEFFICIENTS,
    FIELDS,
    GRADIENTS,
    MIRRORS,
    MOVES,
    NO_GRADIENTS,
    PRESSURES,
    REFUSED,
    RETURNS,
    SURFACE_NAME,
    TEMPERATURES_C,
    UNITS_MM,
    WITHOUT_EFFECT,
)
from lfmesh.imports.codev_zoom import ZoomPositions, zoom_word
from lfmesh.imports.conditions import FieldPoint
from lfmesh.imports.decentres import Move
from lfmesh.imports.glasses import Medium, formula_glass, private_glass
from lfmesh.imports.lens_making import lens_of, note_focal_lengths, refuse_choices
from lfmesh.imports.numbers import is_number, may_matter, number, numbers
from lfmesh.imports.prescription import MOST_SURFACES, FileSurface, Prescription
from lfmesh.imports.report import OTHER_AIR, Report, Verdict
from lfmesh.imports.text import read_lines
from lfmesh.scene.camera.lens import AS_IT_STANDS, FileChoices, Lens


def read(path: Path, lines: list[str] | None = None, choices: FileChoices = AS_IT_STANDS) -> tuple[Lens, Report]:
    """Return the lens of a CODE V file and the report on its commands.

    Parameters
    ----------
    path : Path
    lines : list of str, optional
        Text of the file; read from `path` if omitted.
    choices : FileChoices
        Substitute glasses and the configuration.

    Raises
    ------
    SceneError
        The file cannot be read or its lens is not supported.
    """
    refuse_choices(path, choices, configurations=True)
    lines = read_lines(path) if lines is None else lines
    lens, report, count = _read(path, lines, choices)
    note_focal_lengths(report, count, lambda k: _read(path, lines, replace(choices, configuration=k))[1])
    return lens, report


def _read(path: Path, lines: list[str], choices: FileChoices) -> tuple[Lens, Report, int]:
    """Return the lens at one zoom position, its report, and the number of positions."""
    reader = _Reader(Report(path))
    for at, words in commands(lines):
        reader.take(at, words)
    for at, words in reader.zoom.commands(choices.configuration):
        reader.take(at, words)
    made = reader.finished()
    try:
        return lens_of(made, reader.report, choices.substitutes), reader.report, reader.zoom.count
    except SceneError as error:
        if reader.radii is not None:
            raise
        raise SceneError(
            f"{error}; the file has no line RDM, so the first numbers of its surfaces are read as curvatures: if "
            "they are radii, put RDM before them"
        ) from None


class _Reader:
    """Reader of commands; a command without its own method is looked up in the tables above."""

    def __init__(self, report: Report) -> None:
        self.report = report
        self.made = Prescription(primary=-1)
        self.radii: bool | None = None
        self.in_private_glass = False
        self.private: list[str] = []
        self.private_nm: list[float] = []
        self.fields: dict[str, list[float]] = {}
        self.reference: tuple[int, str, int] | None = None
        self.ended = False
        self.moves: dict[int, dict[str, float]] = {}
        self.returns: dict[int, list[tuple[int, str]]] = {}
        self.doubts: dict[str, tuple[int, str, str]] = {}
        self.unusable: dict[str, tuple[int, str, str]] = {}
        self.zoom = ZoomPositions(report, WITHOUT_EFFECT)
        self.diffractive = DiffractiveSurfaces(report)
        self.at, self.text = 0, ""

    def take(self, at: int, words: list[str]) -> None:
        """Read one command."""
        self.at, self.text = at, " ".join(words)
        command, rest = words[0].upper(), words[1:]
        try:
            if self.in_private_glass:
                self._private_glass(command, words)
            elif (where := zoom_word(words)) is not None:
                self.zoom.add_single(at, words, where)
            elif SURFACE_NAME.match(command) or command == "S":
                self._surface_line(command, rest)
            elif command in MOVES:
                self._moved(command, rest)
            elif command in RETURNS:
                surface, _ = self._named(rest)
                self.returns.setdefault(id(surface), []).append((at, self.text))
            elif command[:1] in "XY" and command[1:] in FIELDS and len(command) == 3:
                self._of_fields(command[0].lower(), FIELDS[command[1:]], rest)
            elif command in ("VUY", "VLY"):
                self._of_each_field(command.lower(), rest)
                self._taken()
            elif command in COEFFICIENTS and len(command) == 1:
                self._coefficient(COEFFICIENTS.index(command), rest)
            elif command in COMMANDS:
                # Its verdict depends on the other commands of the surface.
                surface, others = self._named(rest)
                self.diffractive.take(surface, command, others, (at, self.text))
            elif command in REFUSED:
                if any(map(may_matter, rest)) or not rest:
                    self.report.refuse(at, self.text, REFUSED[command])
            else:
                self._other(command, rest)
        except (ValueError, IndexError) as error:
            self.report.refuse(at, self.text, str(error) if isinstance(error, ValueError) else "it is cut short")

    def _other(self, command: str, words: list[str]) -> None:
        method: Callable[[list[str]], None] | None = getattr(self, f"_on_{command.lower()}", None)
        if method is not None:
            method(words)
        elif command in WITHOUT_EFFECT or command.startswith(("VUX", "VLX", "PIK")):
            self._without_effect()
        else:
            self.report.add(self.at, self.text, Verdict.UNKNOWN)

    def finished(self) -> Prescription:
        """Return the prescription, completed by values that depend on the whole file."""
        made = self.made
        if not made.surfaces:
            raise SceneError(f"{self.report.path}: not a CODE V lens file: it has no line S")
        if not self.ended:
            raise SceneError(f"{self.report.path}: cut short: it has no image surface SI")
        if self.radii is None:
            first = made.surfaces[min(1, len(made.surfaces) - 1)]
            how = "no RDM in the file: the first numbers of surfaces are read as curvatures, CODE V's old default"
            self.report.add(first.line, "S", Verdict.APPROXIMATED, how)
        for surface in made.surfaces:
            self._move(surface)
        self.diffractive.finish(made.unit_mm)
        for name, (at, text, how) in self.doubts.items():
            if any(surface.glass == name for surface in made.surfaces):
                self.report.add(at, text, Verdict.APPROXIMATED, how)
        for surface in made.surfaces:
            if surface.glass in self.unusable:
                self.report.refuse(*self.unusable[surface.glass])
                # The catalogues do not have it either.
                surface.glass = None
        lines = made.wavelengths_nm
        made.primary = len(lines) // 2
        if self.reference is not None:
            at, text, wanted = self.reference
            made.primary = max(0, min(wanted, len(lines)) - 1)
            if lines and made.primary != wanted - 1:
                how = f"there is no wavelength {wanted}; {made.primary + 1} is the primary one"
                self.report.add(at, text, Verdict.APPROXIMATED, how)
        count = max((len(values) for key, values in self.fields.items() if key in "xy"), default=0)
        for i in range(count):
            up, low = (1.0 - self._entry(key, i) for key in ("vuy", "vly"))
            made.fields.append(FieldPoint(self._entry("x", i), self._entry("y", i), up, low))
        return made

    def _entry(self, key: str, i: int) -> float:
        values = self.fields.get(key, [])
        return values[i] if i < len(values) else 0.0

    def _taken(self, how: str = "") -> None:
        self.report.add(self.at, self.text, Verdict.TAKEN, how)

    def _without_effect(self) -> None:
        self.report.add(self.at, self.text, Verdict.WITHOUT_EFFECT)

    def _named(self, words: list[str]) -> tuple[FileSurface, list[str]]:
        """Return the surface to which a command refers, and the remaining words."""
        if words and (found := SURFACE_NAME.match(words[0].upper())):
            place = found[1]
            if found[2] or place == "S":
                raise ValueError("commands for several surfaces are not supported")
            last = len(self.made.surfaces) - 1
            number_of = {"O": 0, "I": last}.get(place)
            number_of = int(place) if number_of is None else number_of
            if number_of > last:
                raise ValueError(f"there is no surface {number_of}")
            return self.made.surfaces[number_of], words[1:]
        if not self.made.surfaces:
            raise ValueError("it stands before the first surface")
        return self.made.surfaces[-1], words

    # Commands for surfaces.

    def _surface_line(self, command: str, words: list[str]) -> None:
        command = "SO" if command == "S0" and not self.made.surfaces else command
        if command not in ("S", "SO", "SI"):
            raise ValueError("lines that change an existing surface are not supported; write S")
        if len(self.made.surfaces) >= MOST_SURFACES:
            raise SceneError(f"{self.report.path}: line {self.at}: more than {MOST_SURFACES} surfaces")
        if not self.made.surfaces and command != "SO":
            raise ValueError("the object, SO, must come first")
        if self.ended:
            raise ValueError("a surface behind the image, SI")
        surface = FileSurface(self.at, self.text)
        self.made.surfaces.append(surface)
        self.ended = command == "SI"
        if words:
            self._bend(surface, number(words[0]))
        if len(words) > 1:
            far = command == "SO" and words[1].lower().startswith("inf")
            surface.thickness = math.inf if far else number(words[1])
        if len(words) > 2:
            self._glass(surface, words[2])
        if len(words) > 3:
            self._glass(surface, words[3])
        self._taken()

    def _bend(self, surface: FileSurface, value: float) -> None:
        if self.radii:
            value = 1.0 / value if value else 0.0
        surface.curvature = value

    def _glass(self, surface: FileSurface, name: str) -> None:
        if name.upper() == "REFL":
            raise ValueError(MIRRORS)
        if name.upper() in ("REFR", "AIR"):
            return
        if re.fullmatch(r"\d{3,}\.\d+", name):
            digits, abbe = name.split(".")
            surface.model = 1.0 + float(f"0.{digits}"), float(f"{abbe[:2]}.{abbe[2:] or '0'}")
        elif re.fullmatch(r"\d+(\.\d*)?:\d+(\.\d*)?", name):
            index, abbe = name.split(":")
            surface.model = float(index), float(abbe)
        else:
            surface.glass = name.strip("'\"")

    def _moved(self, command: str, words: list[str]) -> None:
        surface, rest = self._named(words)
        self.moves.setdefault(id(surface), {})[command] = number(rest[0])
        self._taken()

    def _move(self, surface: FileSurface) -> None:
        """Apply a surface's decentres."""
        values, orders = self.moves.get(id(surface), {}), self.returns.get(id(surface), [])
        if not any(values.values()):
            for at, text in orders:
                self.report.add(at, text, Verdict.WITHOUT_EFFECT)
            return
        x, y, z, about_x, about_y, about_z = (values.get(name, 0.0) for name in MOVES)
        move = Move.shifted_then_tilted((x, y, z), (-about_x, -about_y, about_z))
        surface.before = move
        if surface.returns_to is not None:
            self.report.refuse(surface.line, surface.text, "RET with decentres of its own is not supported")
        for at, text in orders:
            surface.before = move if text.split()[0].upper() == "DAR" else None
            surface.after = move.inverse
            self.report.add(at, text, Verdict.TAKEN)
        if len(orders) > 1:
            self.report.refuse(*orders[-1], "a surface may have only one DAR or REV")

    def _on_ret(self, words: list[str]) -> None:
        """Return to the frame of an earlier surface: `RET S3`, or `RET S5 S3` for surface 5.

        Zemax's macro for these files makes it a coordinate break that restores the position and orientation of S3.
        """
        target, _ = self._named([words[-1]])
        surface, _ = self._named(words[:-1])
        place = next(i for i, each in enumerate(self.made.surfaces) if each is target)
        if not 0 < place < next(i for i, each in enumerate(self.made.surfaces) if each is surface):
            raise ValueError("it must name a surface between the object and this one")
        surface.returns_to = place
        self._taken()

    def _coefficient(self, place: int, words: list[str]) -> None:
        surface, rest = self._named(words)
        asphere = surface.asphere
        asphere += [0.0] * (place + 1 - len(asphere))
        asphere[place] = number(rest[0])
        self._taken()

    def _on_sto(self, words: list[str]) -> None:
        surface, _ = self._named(words)
        for other in self.made.surfaces:
            other.stop = False
        surface.stop = True
        self._taken()

    def _on_k(self, words: list[str]) -> None:
        surface, rest = self._named(words)
        surface.conic = number(rest[0])
        self._taken()

    def _on_asp(self, _: list[str]) -> None:
        self._taken()

    _on_con = _on_asp

    def _on_cuf(self, words: list[str]) -> None:
        _, rest = self._named(words)
        if number(rest[0]):
            raise ValueError("Fresnel surfaces are not supported")
        self._taken()

    def _on_rdy(self, words: list[str]) -> None:
        surface, rest = self._named(words)
        value = number(rest[0])
        surface.curvature = 1.0 / value if value else 0.0
        self._taken()

    def _on_cuy(self, words: list[str]) -> None:
        surface, rest = self._named(words)
        if is_number(rest[0]):
            surface.curvature = number(rest[0])
        self._taken("" if is_number(rest[0]) else "a solve: the present value")

    def _on_thi(self, words: list[str]) -> None:
        surface, rest = self._named(words)
        if is_number(rest[0]):
            surface.thickness = number(rest[0])
        self._taken("" if is_number(rest[0]) else "a solve: the present value")

    def _on_rmd(self, words: list[str]) -> None:
        _, rest = self._named(words)
        if not rest[0].upper().startswith("REFR"):
            raise ValueError(MIRRORS)
        self._taken()

    def _on_tem(self, words: list[str], usual: tuple[float, ...] = TEMPERATURES_C) -> None:
        known = number(words[0]) in usual
        self.report.add(self.at, self.text, *((Verdict.WITHOUT_EFFECT,) if known else OTHER_AIR))

    def _on_pre(self, words: list[str]) -> None:
        self._on_tem(words, PRESSURES)

    def _on_gla(self, words: list[str]) -> None:
        surface, rest = self._named(words)
        self._glass(surface, rest[0])
        self._taken()

    _on_gl1 = _on_gla

    def _on_mlt(self, words: list[str]) -> None:
        surface, rest = self._named(words)
        name = PureWindowsPath(rest[0].strip("'\""))
        surface.coating = (self.at, self.text, self.report.path.with_name(name.with_suffix(name.suffix or ".mul").name))

    def _on_cir(self, words: list[str]) -> None:
        surface, rest = self._named(words)
        kind = rest[0].upper()
        if kind in ("OBS", "HOL"):
            raise ValueError("obscurations and holes are not supported")
        if kind == "EDG":
            self.report.add(self.at, self.text, Verdict.WITHOUT_EFFECT, "the edge of the glass, not its clear aperture")
            return
        value = abs(number(rest[1] if kind == "CLR" else rest[0]))
        surface.aperture = value or None
        self._taken()

    # Commands for the whole file.

    def _on_rdm(self, words: list[str]) -> None:
        self.radii = not (words and words[0].upper().startswith("N"))
        self._taken()

    def _on_tit(self, words: list[str]) -> None:
        self.made.name = " ".join(words).strip("'\" ") or None
        self._taken()

    _on_title = _on_tit

    def _on_dim(self, words: list[str]) -> None:
        unit = words[0].upper()
        if unit not in UNITS_MM:
            raise ValueError(f"unit {unit} is unknown; known are {', '.join(UNITS_MM)}")
        self.made.unit_mm = UNITS_MM[unit]
        self._taken()

    def _on_epd(self, words: list[str]) -> None:
        self._pupil("epd", words)

    def _on_fno(self, words: list[str]) -> None:
        self._pupil("working_f_number", words)

    def _on_na(self, words: list[str]) -> None:
        self._pupil("image_na", words)

    def _on_nao(self, words: list[str]) -> None:
        self._pupil("object_na", words)

    def _pupil(self, kind: str, words: list[str]) -> None:
        value = number(words[0])
        if value <= 0:
            raise ValueError("it must be above 0")
        self.made.pupil = kind, value
        self._taken()

    def _on_wl(self, words: list[str]) -> None:
        values = _changed(self.made.wavelengths_nm, "W", words, "wavelength")
        if not values or min(values) <= 0:
            raise ValueError("a wavelength must be above 0")
        self.made.wavelengths_nm = values
        self._taken()

    def _on_ref(self, words: list[str]) -> None:
        self.reference = self.at, self.text, int(number(words[0]))
        self._taken()

    def _of_fields(self, axis: str, kind: str, words: list[str]) -> None:
        self._of_each_field(axis, words)
        if any(self.fields[axis]) or axis == "y":
            self.made.field_kind = kind
        self._taken()

    def _on_zoo(self, words: list[str]) -> None:
        # Its verdict depends on the requested position.
        self.zoom.add_row(self.at, words)

    def _of_each_field(self, key: str, words: list[str]) -> None:
        """Read a value for every field or, as in `F2 3.0`, for one field, at most one beyond the last."""
        count = max(map(len, self.fields.values()), default=0)
        values = list(self.fields.get(key, []))
        self.fields[key] = _changed(values + [0.0] * (count - len(values)), "F", words, "field", beyond=1)

    def _on_prv(self, _: list[str]) -> None:
        self.in_private_glass = True
        self._taken("a private glass")

    def _private_glass(self, command: str, words: list[str]) -> None:
        """Read the table of a private glass: PWL with wavelengths, then each glass with its indices."""
        if command == "END":
            self.in_private_glass = False
            self._taken()
        elif command == "PWL":
            self.private_nm = numbers(words[1:])
            self._taken()
        else:
            self.private.append(words[0].strip("'\""))
            try:
                formula = words[1].upper() if len(words) > 1 and not is_number(words[1]) else None
                glass: Medium
                if formula in GRADIENTS:
                    raise GlassError(NO_GRADIENTS)
                if formula is None:
                    glass, how = private_glass(self.private_nm, numbers(words[1:])), ""
                else:
                    glass, how = formula_glass(formula, numbers(words[2:]))
                self.made.indices[self.private[-1]] = glass
                self.unusable.pop(self.private[-1], None)
                self._taken()
                if how:
                    self.doubts[self.private[-1]] = self.at, self.text, how
            except (GlassError, ValueError) as error:
                self.unusable[self.private[-1]] = self.at, self.text, str(error)
                how = f"a private glass, refused where a surface has it: {error}"
                self.report.add(self.at, self.text, Verdict.UNKNOWN, how)


def _changed(held: list[float], letter: str, words: list[str], noun: str, beyond: int = 0) -> list[float]:
    """Return changed values: all replaced or, as in `F2 3.0`, one, at most `beyond` places past the end."""
    if not words or not re.fullmatch(rf"{letter}\d+", words[0].upper()):
        return numbers(words)
    place = int(words[0][1:])
    if not 1 <= place <= len(held) + beyond:
        raise ValueError(f"there is no {noun} {place}")
    return [*held[: place - 1], number(words[1]), *held[place:]]
