"""Zemax lens files (`.zmx`): the sequential, centred, refracting part of the format.

The reader is this program's own. ray-optics and Optiland read the format, too, but put n = 1.5, a model or another
maker's glass (K-SK15 for N-SK15) in place of one that they do not find, and pass over commands that they do not know;
ray-optics also evaluates a file beside the lens file as Python, and asks the network for glasses. Here every line has
a verdict, and what would change the image is refused. ray-optics serves the tests as truth.

The format: one command a line, its name first; `SURF n` starts a surface, whose commands are indented. Lengths are in
the unit of UNIT, curvatures its reciprocal, wavelengths µm. Aperture stops are given by the pupil (ENPD, FNUM, OBNA) or
by the stop's own size (FLOA). DIAM is the semi-diameter that rays fill, and stops nothing; CLAP and FLAP do.
"""

import math
import ntpath
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from lfmesh.errors import SceneError
from lfmesh.imports.conditions import FieldPoint
from lfmesh.imports.decentres import Move
from lfmesh.imports.lens_making import lens_of, note_focal_lengths
from lfmesh.imports.numbers import number, numbers
from lfmesh.imports.prescription import FileSurface, Prescription
from lfmesh.imports.report import Report, Verdict
from lfmesh.imports.text import read_lines
from lfmesh.imports.zemax_configurations import Configurations
from lfmesh.imports.zemax_tables import (
    APERTURES_REFUSED,
    ASPHERES,
    EXTENDED,
    FIELD_KINDS,
    FIRST_TERM,
    FORBES,
    LAST_OF_TOROID,
    MOST_EXTRA,
    OF_ZERNIKE_TERMS,
    ORDER_OF_BREAK,
    REFUSED_TYPES,
    SECTIONS,
    THERMAL,
    UNITS_MM,
    WITHOUT_EFFECT,
    ZERNIKE_TERMS,
)
from lfmesh.scene.camera.lens import AS_IT_STANDS, FileChoices, Lens
from lfmesh.scene.camera.qcon import MOST_ASPHERE_TERMS

MOST_SURFACES = 1000


def read(path: Path, lines: list[str] | None = None, choices: FileChoices = AS_IT_STANDS) -> tuple[Lens, Report]:
    """Return the lens of a Zemax file, and what became of its lines.

    Parameters
    ----------
    path : Path
    lines : list of str, optional
        Its text, in place of reading it.
    choices : FileChoices
        Substitutes of glasses, and the configuration.

    Raises
    ------
    SceneError
        The file cannot be read, or holds what the lens cannot have.
    """
    lines = read_lines(path) if lines is None else lines
    lens, report, count = _read(path, lines, choices)
    note_focal_lengths(report, count, lambda k: _read(path, lines, replace(choices, configuration=k))[1])
    return lens, report


def _read(path: Path, lines: list[str], choices: FileChoices) -> tuple[Lens, Report, int]:
    """Return the lens in one configuration, what became of the lines, and the number of configurations."""
    reader = _Reader(Report(path))
    for at, line in enumerate(lines, 1):
        reader.take(at, line)
    made, found = reader.finished(), reader.configurations
    if choices.coating_file is not None:
        made.coating_file = Path(choices.coating_file)
    found.apply(made, reader.report, choices.configuration)
    return lens_of(made, reader.report, choices.substitutes), reader.report, found.count


class _Reader:
    """Reads line by line; a command without a method of its name is looked up in the tables above."""

    def __init__(self, report: Report) -> None:
        self.report = report
        self.made = Prescription()
        self.kind, self.norm_radius = "STANDARD", 1.0
        self.break_values: dict[int, float] = {}
        self.drawn: list[tuple[int, str, FileSurface]] = []
        self.distance_line = 0, ""
        self.extra: dict[int, tuple[int, str, float]] = {}
        self.catalogues: list[str] = []
        self.notes: list[str] = []
        self.waves: dict[int, float] = {}
        self.count = 0
        self.primary_line: tuple[int, str] | None = None
        self.configurations = Configurations()
        self.fields: dict[str, list[float]] = {}
        self.at, self.text = 0, ""

    def take(self, at: int, line: str) -> None:
        """Read one line."""
        words = line.split()
        if not words:
            return
        self.at, self.text = at, line.strip()
        command, rest = words[0].upper(), words[1:]
        method: Callable[[list[str]], None] | None = getattr(self, f"_on_{command.lower()}", None)
        inside = line[:1] in " \t"
        try:
            if method is not None:
                method(rest)
            elif command in APERTURES_REFUSED and inside:
                self._refuse(f"{APERTURES_REFUSED[command]} is not supported; only circular apertures are")
            elif not inside and self.configurations.take(self.at, self.text):
                pass  # What becomes of it is known with the configuration that is asked for.
            elif command in WITHOUT_EFFECT or (self.made.surfaces and not inside):
                # What follows the surfaces are merit functions, configurations and tolerances.
                self._without_effect()
            else:
                self.report.add(at, self.text, Verdict.UNKNOWN)
        except (ValueError, IndexError) as error:
            self._refuse(str(error) if isinstance(error, ValueError) else "it is cut short")

    def finished(self) -> Prescription:
        """Return what was read, with what only the whole file shows."""
        made = self.made
        if not made.surfaces:
            raise SceneError(f"{self.report.path}: no Zemax lens file: it has no line SURF")
        if self.distance_line[0]:
            self.report.add(*self.distance_line, Verdict.WITHOUT_EFFECT, "nothing stands behind the image")
            self.distance_line = 0, ""
        self._end_surface()
        self._end_drawn()
        used = [line for number, line in sorted(self.waves.items()) if not self.count or number <= self.count]
        made.wavelengths_nm = list(dict.fromkeys(used))
        if made.wavelengths_nm and self.waves:
            if self.primary_line and made.primary not in self.waves:
                how = f"there is no wavelength {made.primary}; the first is the primary one"
                self.report.add(*self.primary_line, Verdict.APPROXIMATED, how)
            elif self.primary_line:
                self.report.add(*self.primary_line, Verdict.TAKEN)
            primary = self.waves.get(made.primary, used[0])
            made.primary = made.wavelengths_nm.index(primary) if primary in made.wavelengths_nm else 0
        made.makers = self.catalogues
        made.source = " ".join(self.notes).strip() or None
        made.fields = self._field_points()
        return made

    def _end_drawn(self) -> None:
        """Say which semi-diameters are used: where a pupil or a clear aperture decides, they only draw."""
        for at, text, surface in self.drawn:
            sized = surface.stop and self.made.pupil[0] != "stop"
            ends = surface is self.made.surfaces[0] or surface is self.made.surfaces[-1]
            cut = surface.aperture is not None and surface.aperture != surface.extent
            unused = sized or ends or cut or surface.is_break
            self.report.add(at, text, Verdict.WITHOUT_EFFECT if unused else Verdict.TAKEN)

    def _field_points(self) -> list[FieldPoint]:
        x, y = self.fields.get("x", []), self.fields.get("y", [])
        points = []
        for i in range(max(len(x), len(y))):
            squeeze, shift = self._entry("vcy", i), self._entry("vdy", i)
            point = FieldPoint(self._entry("x", i), self._entry("y", i), 1 - squeeze + shift, 1 - squeeze - shift)
            points.append(point)
        return list(dict.fromkeys(points))

    def _entry(self, key: str, i: int) -> float:
        values = self.fields.get(key, [])
        return values[i] if i < len(values) else 0.0

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

    # The file as a whole.

    def _on_mode(self, words: list[str]) -> None:
        if words[0].upper() != "SEQ":
            self._refuse("only sequential files are supported")
        else:
            self._taken()

    def _on_name(self, words: list[str]) -> None:
        self.made.name = " ".join(words) or None
        self._taken()

    def _on_note(self, words: list[str]) -> None:
        if words and words[0] == "0":
            self.notes.append(" ".join(words[1:]))
        self._taken()

    def _on_unit(self, words: list[str]) -> None:
        unit = words[0].upper()
        if unit not in UNITS_MM:
            raise ValueError(f"unit {unit} is unknown; known are {', '.join(UNITS_MM)}")
        self.made.unit_mm = UNITS_MM[unit]
        self._taken()

    def _on_enpd(self, words: list[str]) -> None:
        self._pupil("epd", words)

    def _on_fnum(self, words: list[str]) -> None:
        self._pupil("working_f_number" if len(words) > 1 and number(words[1]) else "f_number", words)

    def _on_obna(self, words: list[str]) -> None:
        if len(words) > 1 and number(words[1]):
            self.made.pupil = "object_na", math.sin(math.radians(number(words[0])))
            self._taken("the half angle of the cone")
        else:
            self._pupil("object_na", words)

    def _on_floa(self, _: list[str]) -> None:
        self.made.pupil = "stop", 0.0
        self._taken()

    def _pupil(self, kind: str, words: list[str]) -> None:
        value = number(words[0])
        if value <= 0:
            raise ValueError("it must be above 0")
        self.made.pupil = kind, value
        self._taken()

    def _on_envd(self, words: list[str]) -> None:
        if len(words) > 1 and tuple(numbers(words[:2])) != THERMAL:
            self._approximated("indices are those of the catalogue, at its own temperature and pressure")
        else:
            self._taken()

    def _on_gcat(self, words: list[str]) -> None:
        # Catalogues of a certain date are named like SUMITA_AUG2011.
        self.catalogues = [word.upper().split("_")[0] for word in words]
        self._taken()

    def _on_ftyp(self, words: list[str]) -> None:
        kind = int(number(words[0]))
        self.made.field_kind = FIELD_KINDS.get(kind, "angle")
        if len(words) > 3:
            self.count = int(number(words[3]))
            self.fields["count"] = [number(words[2])]
        if kind not in FIELD_KINDS:
            self._approximated("fields of an unknown kind count as angles, for apertures that the file leaves open")
        else:
            self._taken()

    def _of_fields(self, key: str, words: list[str]) -> None:
        values = numbers(words)
        if "count" in self.fields:
            values = values[: max(1, int(self.fields["count"][0]))]
        self.fields[key] = values
        self._taken()

    def _on_xfln(self, words: list[str]) -> None:
        self._of_fields("x", words)

    def _on_yfln(self, words: list[str]) -> None:
        self._of_fields("y", words)

    _on_xfld, _on_yfld = _on_xfln, _on_yfln

    def _on_vcyn(self, words: list[str]) -> None:
        self._of_fields("vcy", words)

    def _on_vdyn(self, words: list[str]) -> None:
        self._of_fields("vdy", words)

    def _on_vdxn(self, _: list[str]) -> None:
        self._without_effect()

    _on_vcxn = _on_vdxn

    def _on_wavm(self, words: list[str]) -> None:
        self._wave(int(number(words[0])), number(words[1]))

    def _on_wavl(self, words: list[str]) -> None:
        for i, value in enumerate(numbers(words), 1):
            self._wave(i, value)

    def _wave(self, place: int, micrometres: float) -> None:
        if micrometres <= 0:
            raise ValueError("a wavelength must be above 0")
        # Micrometres with up to ten digits; the product would bring rounding into the eleventh.
        self.waves[place] = float(f"{micrometres * 1000.0:.10g}")
        if self.count and place > self.count:
            self._without_effect()
        else:
            self._taken()

    def _on_pwav(self, words: list[str]) -> None:
        self.made.primary = int(number(words[0]))
        self.primary_line = self.at, self.text

    def _on_cofn(self, _: list[str]) -> None:
        names = [quoted or plain for quoted, plain in re.findall(r'"([^"]*)"|(\S+)', self.text)]
        self.made.coating_file = next((ntpath.basename(name) for name in names if name.upper().endswith(".DAT")), None)
        self._taken()

    def _on_mnum(self, words: list[str]) -> None:
        self.configurations = Configurations(self.at, self.text, *map(int, numbers(words[:2])))

    # Surfaces.

    def _on_surf(self, _: list[str]) -> None:
        if len(self.made.surfaces) >= MOST_SURFACES:
            raise SceneError(f"{self.report.path}: line {self.at}: more than {MOST_SURFACES} surfaces")
        self._end_surface()
        self.made.surfaces.append(FileSurface(self.at, self.text))
        self.kind, self.norm_radius = "STANDARD", 1.0
        self._taken()

    def _end_surface(self) -> None:
        """Put what only a surface's last line completes into it."""
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
        self.kind = words[0].upper()
        self._surface.is_break = self.kind == "COORDBRK"
        if self.kind in ("STANDARD", "COORDBRK", FORBES, *ASPHERES):
            self._taken()
        elif self.kind in SECTIONS:
            self._surface.section = SECTIONS[self.kind]
            self._taken()
        elif self.kind == "PARAXIAL":
            self._surface.focal_length = math.nan
            self._taken("a thin lens")
        else:
            why = REFUSED_TYPES.get(self.kind, f"surfaces of type {self.kind} are not supported")
            self._refuse(f"{why}; STANDARD, {', '.join((*ASPHERES, *SECTIONS, FORBES))} and PARAXIAL are")

    def _on_stop(self, _: list[str]) -> None:
        self._surface.stop = True
        self._taken()

    def _on_curv(self, words: list[str]) -> None:
        self._surface.curvature = number(words[0])
        self._taken(self._solve(words[1:2]))

    def _on_disz(self, words: list[str]) -> None:
        if words[0].upper().startswith("INF"):
            if len(self.made.surfaces) > 1:
                raise ValueError("only the object may stand at infinity")
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
            # Files of catalogue glasses carry 1.5 and 40 where the program never wrote what it knows.
            if values and values[0] not in (0.0, 1.5):
                surface.stated_index = values[0]
        self._taken(self._solve(["2"] if len(words) > 1 and words[1] == "2" else []))

    def _on_coni(self, words: list[str]) -> None:
        self._surface.conic = number(words[0])
        self._taken()

    def _on_parm(self, words: list[str]) -> None:
        place, value = int(number(words[0])), number(words[1])
        if not value:
            self._taken()
        elif self.kind == "EVENASPH" and 1 <= place <= 8:
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
        # Parameters of a refused type are refused with it.

    def _add_term(self, power: int, value: float) -> None:
        """Let the sag have a term in a power of r."""
        if power == 2 and self.kind in SECTIONS:
            self._refuse("a term in y² beside the curvature is not supported; put it into the curvature")
        elif power == 2:
            self._surface.square = value
            self._taken("in the curvature, the conic constant and the other terms")
        elif power == 1:
            self._refuse("a term in r makes a cone, which is not supported: it has no normal at its vertex")
        elif power > 2 * MOST_ASPHERE_TERMS + 2:
            self._refuse(f"a term in r^{power}: aspheres reach up to r^{2 * MOST_ASPHERE_TERMS + 2}")
        else:
            terms = self._surface.odd if power % 2 else self._surface.asphere
            place = (power - 3) // 2
            terms += [0.0] * (place + 1 - len(terms))
            terms[place] = value
            self._taken()

    def _on_xdat(self, words: list[str]) -> None:
        place, value = int(number(words[0])), number(words[1])
        if self.kind in FIRST_TERM:
            # What it means is known with the number of terms, at the surface's end.
            self.extra[place] = self.at, self.text, value
        elif not value:
            self._taken()
        elif self.kind == "TOROIDAL":
            # The number of terms, and the radius that heights are counted in, come before the coefficients.
            if place > 2:
                self._refuse("Zernike terms of a toroid are not supported")
            else:
                self._without_effect()
        elif self.kind in ("STANDARD", "COORDBRK", "PARAXIAL", "BICONICX", *ASPHERES):
            self.report.add(self.at, self.text, Verdict.UNKNOWN)

    def _end_extra(self) -> None:
        """Put the values of XDAT into the surface."""
        first = FIRST_TERM.get(self.kind, 0)
        values = {place: value for place, (_, _, value) in self.extra.items()}
        count = values.get(first - 2, float(MOST_EXTRA))
        norm_radius = values.get(first - 1, 1.0 if self.kind in EXTENDED else 0.0)
        terms = [values.get(first + k, 0.0) for k in range(max(0, min(int(count), MOST_EXTRA)))]
        line = self.at, self.text
        for place, (at, text, value) in sorted(self.extra.items()):
            self.at, self.text = at, text
            if place == first - 1 and not value > 0.0:
                self._refuse("the radius in which heights are counted must be above 0")
            elif place < first or not value:
                self._taken()
            elif place - first >= count:
                self.report.add(at, text, Verdict.WITHOUT_EFFECT, f"XDAT {first - 2} counts {count:g} terms")
            elif self.kind in EXTENDED:
                power = EXTENDED[self.kind] * (place - first + 1)
                self._add_term(power, value / norm_radius**power if norm_radius > 0.0 else 0.0)
            elif place - first >= MOST_ASPHERE_TERMS:
                self._refuse(f"Forbes' aspheres have {MOST_ASPHERE_TERMS} terms at most")
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
        # What becomes of it is known with the primary wavelength and the media, at the end.
        self._surface.coating = (self.at, self.text, words[0])

    def _on_sqap(self, words: list[str]) -> None:
        half = numbers(words[:2])
        self._surface.aperture = math.hypot(*half)
        self._approximated("a rectangular aperture: the circle round it")

    def _on_obdc(self, words: list[str]) -> None:
        if any(numbers(words[:2])):
            self._refuse("a decentred aperture is not supported")
        else:
            self._taken()

    def _on_scbd(self, words: list[str]) -> None:
        if any(numbers(words[2:])):
            self._refuse("a decentred or tilted surface is not supported; put coordinate breaks round it")
        else:
            self._taken()
