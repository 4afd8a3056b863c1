"""Configurations of Zemax files: zoom positions and other states of a lens.

`MNUM count current` starts them, behind the surfaces. Each following line gives one operand in one configuration: its
name, surface (or field, or wavelength), configuration from 1, and value. The surfaces hold the current configuration.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

from lfmesh.errors import SceneError
from lfmesh.imports.conditions import FieldPoint
from lfmesh.imports.numbers import number
from lfmesh.imports.prescription import FileSurface, Prescription
from lfmesh.imports.report import Report, Verdict
from lfmesh.imports.text import command_names

Setter = Callable[[FileSurface, str], None]


def _thickness(surface: FileSurface, value: str) -> None:
    surface.thickness = number(value)


def _curvature(surface: FileSurface, value: str) -> None:
    surface.curvature = number(value)


def _conic(surface: FileSurface, value: str) -> None:
    surface.conic = number(value)


def _semi_diameter(surface: FileSurface, value: str) -> None:
    # A clear aperture without its own size equals the semi-diameter.
    clear = surface.aperture is not None and surface.aperture == surface.extent
    surface.extent = abs(number(value)) or None
    if clear:
        surface.aperture = surface.extent


def _glass(surface: FileSurface, value: str) -> None:
    if surface.gradient is not None:
        raise ValueError("gradient-index glass that differs between configurations is not supported")
    name = value.strip('"')
    if name.upper() == "MIRROR":
        raise ValueError("mirrors are not supported: the lens refracts")
    surface.glass, surface.model = name or None, None
    surface.stated_index = surface.stated_abbe = None


_OF_SURFACES: dict[str, Setter] = {
    "THIC": _thickness,
    "CRVT": _curvature,
    "CONN": _conic,
    "SDIA": _semi_diameter,
    "GLSS": _glass,
}

_OF_FIELDS = ("XFIE", "YFIE")

_VIGNETTING = command_names("FVCX FVCY FVDX FVDY FVAN")
"""Vignetting of a field: it only sizes clear apertures that the file leaves open."""

_WITHOUT_EFFECT = command_names("MOFF CWGT FLWT WLWT LTTL")
"""Comments and weights."""


@dataclass
class Configurations:
    """Configurations of a file.

    Attributes
    ----------
    line : int
        Line of MNUM, from 1.
    text : str
        Its text.
    count : int
    current : int
        Configuration held by the surfaces, from 1.
    """

    line: int = 0
    text: str = ""
    count: int = 1
    current: int = 1
    _lines: dict[tuple[str, int], dict[int, tuple[int, str, str]]] = field(default_factory=dict, init=False)
    """Line, text and value by configuration, by operand and place."""

    def take(self, at: int, text: str) -> bool:
        """Read a line behind MNUM; return whether it gives a value of a configuration."""
        words = text.split()
        is_operand = self.count > 1 and len(words) > 3 and words[1].isdigit() and words[2].isdigit()
        if is_operand and 1 <= (configuration := int(words[2])) <= self.count:
            self._lines.setdefault((words[0].upper(), int(words[1])), {})[configuration] = at, text, words[3]
            return True
        return False

    def apply(self, made: Prescription, report: Report, wanted: int | None) -> None:
        """Set a prescription to one configuration.

        Parameters
        ----------
        made : Prescription
            Prescription in the current configuration; changed in place.
        report : Report
            Receives the verdict on every line.
        wanted : int, optional
            From 1; the current one if omitted.

        Raises
        ------
        SceneError
            The file has no such configuration.
        """
        chosen = self.current if wanted is None else wanted
        if not 1 <= chosen <= self.count:
            has = "has one configuration" if self.count == 1 else f"has configurations 1 to {self.count}"
            raise SceneError(f"{report.path}: configuration = {chosen}: the file {has}")
        if self.count > 1 and wanted is None:
            how = f"{self.count} configurations: {chosen}, whose values are in the surfaces, is taken"
            report.add(self.line, self.text, Verdict.APPROXIMATED, how)
        elif self.line:
            report.add(self.line, self.text, Verdict.TAKEN if self.count > 1 else Verdict.WITHOUT_EFFECT)
        for (name, place), values in self._lines.items():
            self._apply_operand(made, report, name, place, values, chosen)

    def _apply_operand(
        self,
        made: Prescription,
        report: Report,
        name: str,
        place: int,
        values: dict[int, tuple[int, str, str]],
        chosen: int,
    ) -> None:
        for configuration, (at, text, value) in values.items():
            if name in _WITHOUT_EFFECT or configuration != chosen:
                report.add(at, text, Verdict.WITHOUT_EFFECT)
            elif chosen == self.current:
                report.add(at, text, Verdict.TAKEN, "its value is in the file's surfaces")
            elif len({held for _, _, held in values.values()}) == 1 and len(values) == self.count:
                report.add(at, text, Verdict.TAKEN, "the same in every configuration")
            elif name in _VIGNETTING:
                how = f"vignetting is that of configuration {self.current}; it affects only missing apertures"
                report.add(at, text, Verdict.APPROXIMATED, how)
            else:
                try:
                    _set(made, name, place, value)
                    report.add(at, text, Verdict.TAKEN)
                except ValueError as error:
                    report.refuse(at, text, str(error))
        if chosen not in values and name not in _WITHOUT_EFFECT and values:
            at, text, _ = next(iter(values.values()))
            report.refuse(at, text, f"the file gives no value for configuration {chosen}")


def _set(made: Prescription, name: str, place: int, value: str) -> None:
    """Set one value of a prescription; ValueError if impossible."""
    if name in _OF_SURFACES:
        if not 0 <= place < len(made.surfaces):
            raise ValueError(f"there is no surface {place}")
        _OF_SURFACES[name](made.surfaces[place], value)
    elif name == "APER":
        made.pupil = made.pupil[0], number(value)
    elif name == "WAVE":
        if not 1 <= place <= len(made.wavelengths_nm):
            raise ValueError(f"there is no wavelength {place}")
        made.wavelengths_nm[place - 1] = float(f"{number(value) * 1000.0:.10g}")
    elif name in _OF_FIELDS:
        if not 1 <= place <= len(made.fields):
            raise ValueError(f"there is no field {place}")
        point = made.fields[place - 1]
        x, y = (number(value), point.y) if name == "XFIE" else (point.x, number(value))
        made.fields[place - 1] = FieldPoint(x, y, point.upper, point.lower)
    else:
        raise ValueError(f"the operand {name} differs between configurations, and is not supported")
