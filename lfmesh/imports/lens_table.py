"""Prescriptions as tables (`.csv`): one row per surface, named columns, separated by semicolon, comma or tab.

Columns are recognised by common names: radius or curvature, thickness, glass or index and Abbe number, semi-diameter or
diameter, conic, coefficients A4, A6, ... of even aspheres, and a mark of the stop. Lengths are mm. The last thickness
is the distance to the image.
"""

import csv
import math
import re
from collections.abc import Mapping
from pathlib import Path

from lfmesh.errors import GlassError, SceneError
from lfmesh.imports.glasses import named_glass
from lfmesh.imports.lens_making import lens_of, refuse_choices
from lfmesh.imports.numbers import number
from lfmesh.imports.prescription import FAR_MM, FileSurface, Prescription
from lfmesh.imports.report import Report, Verdict
from lfmesh.imports.text import read_lines
from lfmesh.scene.camera.lens import AS_IT_STANDS, FileChoices, Lens
from lfmesh.scene.camera.qcon import MOST_ASPHERE_TERMS

_NAMES = {
    "radius": ("r", "radius", "radiusmm", "radiusofcurvature", "roc"),
    "curvature": ("c", "cv", "curv", "curvature"),
    "thickness": ("t", "th", "thickness", "thicknessmm", "distance", "distancemm", "spacing"),
    "glass": ("glass", "material", "medium"),
    "index": ("n", "nd", "index", "refractiveindex"),
    "abbe": ("v", "vd", "vno", "vnumber", "abbe", "abbenumber"),
    "semi-diameter": (
        "sa",
        "sd",
        "semidiameter",
        "semidiametermm",
        "semiaperture",
        "semidia",
        "clearsemidia",
        "clearradius",
    ),
    "diameter": ("d", "dia", "diameter", "diametermm", "clearaperture"),
    "conic": ("k", "cc", "conic", "conicconstant"),
    "stop": ("stop",),
}
_COLUMNS = {name: column for column, names in _NAMES.items() for name in names}
_LABELS = ("surface", "surf", "number", "no", "id")
"""Columns that number the surfaces, and may name the object, stop and image."""
_WITHOUT_EFFECT = ("", "comment", "name", "description")
_TYPES = ("", "standard", "sphere", "spherical", "conic", "asphere", "evenasphere", "evenasph", "plane", "stop")
_ENDS = ("obj", "object", "sto", "ima", "image")
"""Types that are positions rather than shapes: they count as the row's label."""
_MILLIMETRES = re.compile(r"(1/)?mm(\W*\d*)")
"""Units of lengths, curvatures and coefficients; others are refused."""
_UNIT = re.compile(r"(.+?)\s*[\[(]([^\])]*)[\])]\s*")
"""Column name followed by its unit."""
_AIR = ("", "air", "vacuum")
_FLAT = ("", "inf", "infinity", "∞", "plano", "flat")
_DELIMITERS = ";\t,"
_TERM = re.compile(r"a([0-9]{1,3})")
_POWERS = range(4, 2 * MOST_ASPHERE_TERMS + 3, 2)
"""Powers of r allowed in a table."""
UNREAD = "unread "
"""Prefix of the name of an unread column that affects refraction."""


def read(path: Path, lines: list[str] | None = None, choices: FileChoices = AS_IT_STANDS) -> tuple[Lens, Report]:
    """Return the lens of a table and the report on its columns and rows.

    Parameters
    ----------
    path : Path
    lines : list of str, optional
        Text of the file; read from `path` if omitted.
    choices : FileChoices
        Substitute glasses; a table has one configuration.

    Raises
    ------
    SceneError
        The file cannot be read, or its lens is not supported.
    """
    refuse_choices(path, choices)
    report = Report(path)
    lines = read_lines(path) if lines is None else lines
    filled = [(at, line) for at, line in enumerate(lines, 1) if line.strip(" \t;,\r")]
    if not filled:
        raise SceneError(f"{path}: no prescription: it is empty")
    delimiter = max(_DELIMITERS, key=filled[0][1].count)
    columns = _columns(report, filled[0], delimiter)
    made = Prescription()
    object_given = False
    for at, line in filled[1:]:
        cells = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
        if any(cell.strip() for cell in cells[len(columns) :]):
            report.refuse(at, line, f"more cells than the {len(columns)} columns of the first line")
            continue
        values = {column: cell.strip() for column, cell in zip(columns, cells, strict=False) if cell.strip()}
        # Tables copied from print contain the minus sign instead of a hyphen.
        values = {column: cell.replace("\N{MINUS SIGN}", "-") for column, cell in values.items()}
        # A comma that does not separate columns is a decimal comma.
        if delimiter != ",":
            values = {column: cell.replace(",", ".") for column, cell in values.items()}
        label = values.get("label", "").lower()
        if _plain(values.get("type", "")) in _ENDS:
            label = _plain(values.pop("type"))
        try:
            if label.startswith(("ima", "img")):
                report.add(at, line, Verdict.TAKEN, "the image")
                continue
            is_object = label.startswith("obj")
            object_given |= is_object
            if not is_object and "thickness" not in values and at != filled[-1][0]:
                raise ValueError("it has no thickness")
            surface = _surface(at, line, values)
            surface.stop = surface.stop or label.startswith(("sto", "*"))
            made.surfaces.append(surface)
            report.add(at, line, Verdict.TAKEN)
        except ValueError as error:
            report.refuse(at, line, str(error))
    stops = [surface for surface in made.surfaces if surface.stop]
    for surface in stops[1:]:
        report.refuse(surface.line, surface.text, f"line {stops[0].line} is already the stop")
    if not stops:
        report.notes.append("no row is marked as the stop: the first surface is taken")
    if made.surfaces and not object_given and abs(made.surfaces[0].thickness) < FAR_MM:
        made.surfaces.insert(0, FileSurface(filled[0][0], "object", thickness=math.inf))
    made.surfaces.append(FileSurface(filled[-1][0], "image"))
    return lens_of(made, report, choices.substitutes), report


def _plain(name: str) -> str:
    """Return the normalised name of a column or type: only lower-case letters and digits."""
    return "".join(sign for sign in name.lower() if sign.isalnum())


def _columns(report: Report, header: tuple[int, str], delimiter: str) -> list[str]:
    """Return the meaning of each column; "" for an ignored one."""
    at, line = header
    columns = []
    for name in next(csv.reader([line], delimiter=delimiter)):
        plain = _plain(name)
        if (with_unit := _UNIT.fullmatch(name)) and plain not in _COLUMNS and not _TERM.fullmatch(plain):
            plain, unit = _plain(with_unit[1]), with_unit[2].strip().lower()
            is_length = plain in _COLUMNS or _TERM.fullmatch(plain)
            if is_length and unit and not _MILLIMETRES.fullmatch(unit):
                raise SceneError(f"{report.path}: line {at}: column {name.strip()}: lengths must be in mm")
        power = int(found[1]) if (found := _TERM.fullmatch(plain)) else None
        if plain in _COLUMNS:
            columns.append(_COLUMNS[plain])
        elif plain in _LABELS:
            columns.append("label")
        elif plain in ("type", "surfacetype", "surftype"):
            columns.append("type")
        elif power in _POWERS:
            columns.append(f"a{power}")
        elif power is not None:
            # An even asphere has no such power: it must be 0.
            columns.append(f"{UNREAD}{name.strip()}")
        else:
            columns.append("")
            if plain not in _WITHOUT_EFFECT:
                report.add(at, f"column {name.strip()}", Verdict.UNKNOWN)
    twice = next((column for column in columns if column and columns.count(column) > 1), None)
    if twice is not None:
        raise SceneError(f"{report.path}: line {at}: two columns give the {twice}")
    if "thickness" not in columns or not {"radius", "curvature"} & set(columns):
        raise SceneError(
            f"{report.path}: line {at}: no prescription: its first line must name columns in English, including a "
            f"radius or curvature and a thickness; it is {line.strip()[:60]!r}"
        )
    return columns


def _surface(at: int, line: str, values: Mapping[str, str]) -> FileSurface:
    """Return the surface of a row."""
    surface = FileSurface(at, line)
    kind = _plain(values.get("type", ""))
    if kind not in _TYPES:
        raise ValueError(f"surfaces of type {values['type']} are not read from tables")
    for column, cell in values.items():
        if column.startswith(UNREAD) and number(cell):
            raise ValueError(f"{column.removeprefix(UNREAD)} is not read: even aspheres have A4 to A{_POWERS[-1]}")
    radius = values.get("radius", "")
    if radius.lower() not in _FLAT and number(radius):
        surface.curvature = 1.0 / number(radius)
    elif "curvature" in values:
        surface.curvature = number(values["curvature"])
    thickness = values.get("thickness", "0")
    surface.thickness = math.inf if thickness.lower() in _FLAT else number(thickness)
    size = values.get("semi-diameter")
    half = number(size) if size is not None else 0.5 * number(values.get("diameter", "0"))
    if half < 0.0:
        raise ValueError("a semi-diameter or diameter below 0")
    surface.aperture = half or None
    surface.conic = number(values.get("conic", "0"))
    surface.asphere = [number(values.get(f"a{power}", "0")) for power in _POWERS]
    marked = values.get("stop", "").lower() not in ("", "0", "no", "false", "-")
    surface.stop = marked or kind == "stop"
    _fill(surface, values)
    return surface


def _fill(surface: FileSurface, values: Mapping[str, str]) -> None:
    """Set the medium behind a surface: a catalogue glass, or one given by its index and Abbe number."""
    name = values.get("glass", "")
    if name.lower() in _AIR and "index" not in values:
        return
    index = number(values["index"]) if "index" in values else None
    if index == 1.0 and name.lower() in _AIR:
        return
    abbe = number(values["abbe"]) if "abbe" in values else None
    try:
        known = bool(name) and bool(named_glass(name, [], None if index is None else (index, abbe)))
    except GlassError:
        known = False
    if known or index is None:
        surface.glass, surface.stated_index, surface.stated_abbe = name, index, abbe
    else:
        surface.model = index, abbe or 0.0
