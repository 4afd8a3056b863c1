"""Lens files of optiland (`.json`), from its `save_optiland_file`: centred, refracting lenses.

The format is the dictionary of optiland's `Optic`: `surface_group.surfaces` from object to image, each with a
`geometry` (kind, vertex in the frame of the first surface, radius, conic, coefficients) and the `material_post` behind
it. Lengths are mm, wavelengths µm. Unrecognised, non-empty properties of a surface are reported as *unknown*.
"""

import json
import math
import sys
from collections.abc import Mapping
from pathlib import Path, PureWindowsPath
from typing import Any

from lfmesh.errors import SceneError
from lfmesh.imports.conditions import FieldPoint
from lfmesh.imports.lens_making import lens_of, refuse_choices
from lfmesh.imports.optiland_phases import GRATING_MODEL, GRATINGS, MODEL, groove_phase, profile_phase
from lfmesh.imports.prescription import FileSurface, Prescription
from lfmesh.imports.report import Report, Verdict
from lfmesh.imports.text import read_lines
from lfmesh.optics.glass import MAKERS
from lfmesh.scene.camera.lens import AS_IT_STANDS, FileChoices, Lens

_UNITS_NM = {"nm": 1.0, "um": 1e3, "mm": 1e6}
_APERTURES = {"EPD": "epd", "imageFNO": "f_number", "objectNA": "object_na"}
_FIELDS = {
    **dict.fromkeys(("angle", "AngleField"), "angle"),
    **dict.fromkeys(("object_height", "ObjectHeightField"), "object"),
    **dict.fromkeys(("paraxial_image_height", "ParaxialImageHeightField"), "image"),
    **dict.fromkeys(("real_image_height", "RealImageHeightField"), "image"),
}
_FIRST_POWER = {"Plane": 0, "StandardGeometry": 0, "EvenAsphere": 2, "OddAsphere": 1, **dict.fromkeys(GRATINGS, 0)}
"""Supported kinds of surface, with the power of r of their first coefficient; 0 means no coefficients."""
_TOLERANCES = ("tol", "max_iter")
_KNOWN = {
    "geometry": ("type", "cs", "radius", "conic", "coefficients", "period", "angle", "order", *_TOLERANCES),
    "surface": (
        *("type", "thickness", "geometry", "material_pre", "material_post", "is_stop", "aperture", "comment"),
        *("interaction_model", "coating", "bsdf", "is_reflective", "surface_type"),
    ),
    "file": ("version", "name", "aperture", "fields", "wavelengths", "surface_group"),
}
_INTERACTIONS = ("RefractiveReflectiveModel", MODEL, GRATING_MODEL, "Surface", "ObjectSurface", "ImageSurface", "")
_STRAIGHT = "HomogeneousPropagation"
"""Propagation along straight rays. optiland 0.6 also names GRINPropagation, which it does not implement."""
_WITHOUT_EFFECT = ("ray_tracer", "pickups", "solves")
"""Keys about aiming and optimisation, which are ignored: the surfaces hold the present values."""


def read(path: Path, lines: list[str] | None = None, choices: FileChoices = AS_IT_STANDS) -> tuple[Lens, Report]:
    """Return the lens of an optiland file and the report on its parts.

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
    try:
        data = json.loads("\n".join(read_lines(path) if lines is None else lines))
    except (ValueError, RecursionError) as error:
        raise SceneError(f"{path}: not JSON: {str(error)[:100]}") from None
    group = data.get("surface_group") if isinstance(data, dict) else None
    if not isinstance(group, dict) or not isinstance(group.get("surfaces"), list):
        raise SceneError(f"{path}: not an optiland lens file: it has no list surface_group.surfaces")
    report = Report(path)
    made = _Reader(report, data).prescription(group["surfaces"])
    return lens_of(made, report, choices.substitutes), report


class _Reader:
    """Reader of the file's parts; each part is named by its path in the file."""

    def __init__(self, report: Report, data: Mapping[str, Any]) -> None:
        self.report, self.data = report, data

    def prescription(self, entries: list[Any]) -> Prescription:
        """Return the prescription in the file."""
        name = self.data.get("name")
        made = Prescription(name=name if isinstance(name, str) and name else None)
        z: list[float] = []
        for k, entry in enumerate(entries):
            where = f"surfaces[{k}]"
            made.surfaces.append(FileSurface(0, where))
            try:
                z.append(self._surface(made.surfaces[-1], _table(entry, where), where))
                self.report.add(0, where, Verdict.TAKEN)
            except ValueError as error:
                self.report.refuse(0, where, str(error))
        self.report.raise_refusals()
        for surface, here, after in zip(made.surfaces, z, z[1:], strict=False):
            surface.thickness = after - here
        for key, take in (("aperture", self._aperture), ("fields", self._fields), ("wavelengths", self._wavelengths)):
            try:
                take(made, _held(self.data, key, dict))
                self.report.add(0, key, Verdict.TAKEN)
            except ValueError as error:
                self.report.refuse(0, key, str(error))
        self._rest("", self.data, _KNOWN["file"])
        return made

    @staticmethod
    def _number(entry: Mapping[str, Any], key: str, infinite: bool = False) -> float:
        value = _held(entry, key, int | float)
        if abs(value) > sys.float_info.max and isinstance(value, int):
            raise ValueError(f"{key} = {str(value)[:30]}... exceeds the range of numbers")
        if math.isnan(value):
            raise ValueError(f"{key} = NaN is not a number")
        if not infinite and math.isinf(value):
            raise ValueError(f"{key} = {value} is not finite")
        return float(value)

    def _rest(self, where: str, entry: Mapping[str, Any], known: tuple[str, ...]) -> None:
        """Report unrecognised keys with content."""
        for key, value in entry.items():
            filled = any(value.values()) if isinstance(value, dict) else bool(value)
            if key not in known and filled:
                verdict = Verdict.WITHOUT_EFFECT if key in _WITHOUT_EFFECT else Verdict.UNKNOWN
                self.report.add(0, f"{where}{key}", verdict)

    def _surface(self, surface: FileSurface, entry: Mapping[str, Any], where: str) -> float:
        """Read a surface; return the axial position of its vertex."""
        surface.stop = bool(entry.get("is_stop"))
        shape = _held(entry, "geometry", dict)
        self._rest(f"{where}.", entry, _KNOWN["surface"])
        self._rest(f"{where}.geometry.", shape, _KNOWN["geometry"])
        self._shape(surface, shape)
        self._medium(surface, _held(entry, "material_post", dict))
        if entry.get("aperture") is not None:
            stops = _held(entry, "aperture", dict)
            if _held(stops, "type", str) != "RadialAperture" or self._number(stops, "r_min"):
                raise ValueError("only round apertures without a dark middle are supported")
            largest = self._number(stops, "r_max", infinite=True)
            surface.aperture = largest if math.isfinite(largest) and largest > 0.0 else None
        # Versions before 0.4 describe the interaction on the surface itself.
        model = entry if entry.get("interaction_model") is None else _held(entry, "interaction_model", dict)
        self._interaction(surface, model, where)
        if model.get("type") == MODEL:
            surface.phase, efficiency = profile_phase(_held(model, "phase_profile", dict))
            if surface.phase is not None and efficiency < 1.0:
                surface.phase["efficiency"] = efficiency
        elif model.get("type") == GRATING_MODEL:
            surface.phase = groove_phase(shape)
        return self._number(_held(shape, "cs", dict), "z", infinite=True)

    def _shape(self, surface: FileSurface, shape: Mapping[str, Any]) -> None:
        kind, frame = _held(shape, "type", str), _held(shape, "cs", dict)
        if kind not in _FIRST_POWER:
            raise ValueError(f"surfaces of type {kind} are not read; {', '.join(_FIRST_POWER)} are")
        moved = [key for key in ("x", "y", "rx", "ry", "rz") if self._number(frame, key)]
        if moved or frame.get("reference_cs") is not None:
            raise ValueError(f"a surface off the axis ({', '.join(moved) or 'in a frame of its own'}) is not read")
        radius = self._number(shape, "radius", infinite=True)
        surface.curvature = 1.0 / radius if radius else 0.0
        surface.conic = self._number(shape, "conic") if "conic" in shape else 0.0
        step = 2 if kind == "EvenAsphere" else 1
        terms = [] if shape.get("coefficients") is None else _held(shape, "coefficients", list)
        for k, value in enumerate(terms if _FIRST_POWER[kind] else []):
            power = _FIRST_POWER[kind] + step * k
            surface.add_term(
                power, self._number({f"the coefficient of r^{power}": value}, f"the coefficient of r^{power}")
            )

    def _medium(self, surface: FileSurface, medium: Mapping[str, Any]) -> None:
        kind = _held(medium, "type", str)
        path = medium.get("propagation_model")
        if isinstance(path, dict) and path.get("class") not in (None, _STRAIGHT):
            raise ValueError(f"a medium with the propagation {str(path['class'])[:30]} is not read; {_STRAIGHT} is")
        if kind == "IdealMaterial":
            index = self._number(medium, "index")
            surface.model = None if index == 1.0 else (index, 0.0)
            if self._number(medium, "absorp") if "absorp" in medium else 0.0:
                raise ValueError("a medium that absorbs is not read")
        elif kind == "AbbeMaterial":
            surface.model = self._number(medium, "index"), self._number(medium, "abbe")
        elif kind == "Material":
            # The data folder names the maker: .../glass/schott/N-BK7.yml.
            file = "" if medium.get("filename") is None else _held(medium, "filename", str)
            folder, name = PureWindowsPath(file).parent.name.upper(), _held(medium, "name", str)
            surface.glass = f"{folder}/{name}" if folder in MAKERS else name
        elif kind == "Mirror":
            raise ValueError("mirrors are not supported: the lens refracts")
        else:
            raise ValueError(f"a medium of type {kind} is not read")

    def _interaction(self, surface: FileSurface, model: Mapping[str, Any], where: str) -> None:
        if model.get("is_reflective"):
            raise ValueError("mirrors are not supported: the lens refracts")
        if model.get("bsdf") is not None:
            raise ValueError("a surface that scatters is not read; give it a finish in the scene")
        if model.get("coating") is not None:
            self.report.add(0, f"{where}.coating", Verdict.APPROXIMATED, "not read; the surface is traced bare")
        kind = _held(model, "type", str) if "type" in model else ""
        if "focal_length" in model:
            surface.focal_length = self._number(model, "focal_length")
        elif kind == "ParaxialSurface":
            surface.focal_length = self._number(model, "f")
        elif kind not in _INTERACTIONS:
            raise ValueError(f"surfaces with a {kind} are not read")

    def _aperture(self, made: Prescription, entry: Mapping[str, Any]) -> None:
        kind = _held(entry, "type", str)
        value = self._number(entry, "value")
        if kind not in (*_APERTURES, "float_by_stop_size"):
            raise ValueError(f"an aperture of type {kind} is not read; {', '.join(_APERTURES)} are")
        if not value > 0.0:
            raise ValueError(f"value = {value:g}: it must be above 0")
        if kind in _APERTURES:
            made.pupil = _APERTURES[kind], value
            return
        stop = next((surface for surface in made.surfaces if surface.stop), None)
        if stop is None:
            raise ValueError("it gives the size of the stop, but no surface is the stop")
        made.pupil, stop.aperture = ("stop", 0.0), 0.5 * value

    def _fields(self, made: Prescription, entry: Mapping[str, Any]) -> None:
        holder = entry if entry.get("field_type") else _held(entry, "field_definition", dict)
        kind = _held(holder, "field_type", str)
        if kind not in _FIELDS:
            raise ValueError(f"fields of type {kind} are not read; {', '.join(_FIELDS)} are")
        made.field_kind = _FIELDS[kind]
        for k, point in enumerate(_held(entry, "fields", list)):
            each = _table(point, f"fields[{k}]")
            left = 1.0 - (self._number(each, "vy") if "vy" in each else 0.0)
            made.fields.append(FieldPoint(self._number(each, "x"), self._number(each, "y"), left, left))

    def _wavelengths(self, made: Prescription, entry: Mapping[str, Any]) -> None:
        primaries = []
        for k, line in enumerate(_held(entry, "wavelengths", list)):
            each = _table(line, f"wavelengths[{k}]")
            unit = _held(each, "unit", str) if "unit" in each else "um"
            if unit not in _UNITS_NM:
                raise ValueError(f"unit {unit} is unknown; known are {', '.join(_UNITS_NM)}")
            # Micrometres have up to ten digits; the product would add rounding in the eleventh.
            wavelength = float(f"{self._number(each, 'value') * _UNITS_NM[unit]:.10g}")
            if not wavelength > 0.0:
                raise ValueError(f"wavelength {wavelength:g}: it must be above 0")
            made.wavelengths_nm.append(wavelength)
            if each.get("is_primary"):
                primaries.append(k)
        made.primary = primaries[0] if primaries else 0
        if len(primaries) > 1:
            self.report.add(0, "wavelengths", Verdict.APPROXIMATED, "several are marked as primary; the first is taken")


def _held(entry: Mapping[str, Any], key: str, kind: Any) -> Any:
    """Return the value under a key; ValueError unless it has the expected type."""
    if key not in entry:
        raise ValueError(f"it has no {key}")
    value = entry[key]
    if not isinstance(value, kind) or isinstance(value, bool):
        raise ValueError(f"{key} = {json.dumps(value)[:30]} must be {_KINDS[kind]}")
    return value


def _table(entry: Any, name: str) -> Mapping[str, Any]:
    """Return a part of the file that must be a JSON object."""
    table: Mapping[str, Any] = _held({name: entry}, name, dict)
    return table


_KINDS = {dict: "an object", list: "a list", str: "text", int | float: "a number"}
"""JSON names of the types."""
