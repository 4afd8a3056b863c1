"""Zemax lens files (`.zmx`): the sequential, centred, refracting part of the format.

The reader is lfmesh's own. ray-optics and Optiland replace unknown glasses by n = 1.5, a model or another maker's glass
(K-SK15 for N-SK15) and skip unknown commands; ray-optics also evaluates a file beside the lens file as Python, and
queries the network for glasses. Here every line has a verdict, and unsupported lines that change the image are refused.
The tests use ray-optics as reference.

Each line is a command, its name first; `SURF n` starts a surface, with its commands indented. Lengths are in the unit
of UNIT, curvatures in its reciprocal, wavelengths in µm. The pupil (ENPD, FNUM, OBNA) or the stop's own size (FLOA)
sets the aperture. DIAM is the semi-diameter filled by rays and blocks nothing; CLAP and FLAP block light.
"""

import math
import ntpath
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from lfmesh.errors import SceneError
from lfmesh.imports.conditions import FieldPoint
from lfmesh.imports.gradient_files import BLANKS, GradientFiles
from lfmesh.imports.lens_making import lens_of, note_focal_lengths
from lfmesh.imports.numbers import number, numbers
from lfmesh.imports.prescription import MOST_CONFIGURATIONS, Prescription
from lfmesh.imports.report import OTHER_AIR, Report, Verdict
from lfmesh.imports.text import read_lines
from lfmesh.imports.zemax_configurations import Configurations
from lfmesh.imports.zemax_surfaces import SurfaceReader
from lfmesh.imports.zemax_tables import APERTURES_REFUSED, FIELD_KINDS, THERMAL, UNITS_MM, WITHOUT_EFFECT
from lfmesh.scene.camera.lens import AS_IT_STANDS, FileChoices, Lens


def read(path: Path, lines: list[str] | None = None, choices: FileChoices = AS_IT_STANDS) -> tuple[Lens, Report]:
    """Return the lens of a Zemax file and the report on its lines.

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
    lines = read_lines(path) if lines is None else lines
    lens, report, count = _read(path, lines, choices)
    note_focal_lengths(report, count, lambda k: _read(path, lines, replace(choices, configuration=k))[1])
    return lens, report


def _read(path: Path, lines: list[str], choices: FileChoices) -> tuple[Lens, Report, int]:
    """Return the lens in one configuration, its report, and the number of configurations."""
    reader = _Reader(Report(path))
    reader.made.gradient_files = GradientFiles(path.parent, tuple(map(Path, choices.gradient_files)))
    for at, line in enumerate(lines, 1):
        reader.take(at, line)
    made, found = reader.finished(), reader.configurations
    if choices.coating_file is not None:
        made.coating_file = Path(choices.coating_file)
    found.apply(made, reader.report, choices.configuration)
    return lens_of(made, reader.report, choices.substitutes), reader.report, found.count


class _Reader(SurfaceReader):
    """Reader of lines; a command without its own method is looked up in the tables above."""

    def __init__(self, report: Report) -> None:
        super().__init__(report)
        self.catalogues: list[str] = []
        self.notes: list[str] = []
        self.waves: dict[int, float] = {}
        self.count = 0
        self.primary_line: tuple[int, str] | None = None
        self.configurations = Configurations()
        self.fields: dict[str, list[float]] = {}

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
                pass  # Its verdict depends on the requested configuration.
            elif command in WITHOUT_EFFECT or (self.made.surfaces and not inside):
                # Merit functions, configurations and tolerances follow the surfaces.
                self._without_effect()
            else:
                self.report.add(at, self.text, Verdict.UNKNOWN)
        except (ValueError, IndexError) as error:
            self._refuse(str(error) if isinstance(error, ValueError) else "it is cut short")

    def finished(self) -> Prescription:
        """Return the prescription, completed by values that depend on the whole file."""
        made = self.made
        if not made.surfaces:
            raise SceneError(f"{self.report.path}: not a Zemax lens file: it has no line SURF")
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
        self.end_surfaces()
        made.makers = self.catalogues
        made.source = " ".join(self.notes).strip() or None
        made.fields = self._field_points()
        return made

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
            self.report.add(self.at, self.text, *OTHER_AIR)
        else:
            self._taken()

    def _on_gcat(self, words: list[str]) -> None:
        # Dated catalogues have names like SUMITA_AUG2011.
        self.catalogues = [word.upper().split("_")[0] for word in words]
        self._taken()

    def _on_ftyp(self, words: list[str]) -> None:
        kind = int(number(words[0]))
        self.made.field_kind = FIELD_KINDS.get(kind, "angle")
        if len(words) > 1 and number(words[1]):
            self.made.telecentric = self.at, self.text
        if len(words) > 3:
            self.count = int(number(words[3]))
            self.fields["count"] = [number(words[2])]
        if kind not in FIELD_KINDS:
            self._approximated("fields of an unknown kind are taken as angles to compute missing apertures")
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
        # Micrometres have up to ten digits; the product would add rounding in the eleventh.
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
        names = [ntpath.basename(name) for name in names]
        self.made.coating_file = next((name for name in names if name.upper().endswith(".DAT")), None)
        # The last one has the profiles of GRADIUM blanks.
        self.made.gradient_files.profiles = next((name for name in names if name.upper().endswith(".GRD")), BLANKS)
        self._taken()

    def _on_mnum(self, words: list[str]) -> None:
        count, current = (int(value) for value in [*numbers(words[:2]), 1.0, 1.0][:2])
        if not 1 <= current <= count <= MOST_CONFIGURATIONS:
            raise ValueError(f"it must give a number of configurations up to {MOST_CONFIGURATIONS}, and one of them")
        self.configurations = Configurations(self.at, self.text, count, current)
