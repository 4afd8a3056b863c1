"""Writer of a lens as a Zemax file."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from lfmesh.errors import GlassError, SceneError
from lfmesh.imports.coating_writer import coating_file, coating_names
from lfmesh.imports.conditions import Conditions
from lfmesh.imports.decentres import move_of
from lfmesh.imports.glasses import named_glass
from lfmesh.imports.gradient_writer import gradient_lines
from lfmesh.imports.phase_writer import MOST_EVEN_TERMS, zemax_lines
from lfmesh.imports.writing import ZEMAX, check_writable, curvature, maker_and_name, stop_radius_mm
from lfmesh.optics.glass import AIR, glass_name
from lfmesh.scene.camera.lens import Lens, Surface
from lfmesh.scene.materials.matter import Matter
from lfmesh.scene.materials.own_glass import OwnGlass
from lfmesh.scene.pose import Pose

_MOST_OF_TOROID = 6
"""Toroids have the powers y² to y¹⁴."""

_LAST_ODD_POWER = 8
"""Odd aspheres have the powers from r to this."""


def written(lens: Lens, conditions: Conditions, path: Path) -> tuple[dict[Path, bytes], list[str]]:
    """Return a lens as the bytes of a `.zmx` file (UTF-16, like Zemax's), and notes on properties it lacks.

    The lens's own coatings go into a second file.

    Parameters
    ----------
    lens : Lens
    conditions : Conditions
    path : Path
        Path of the lens file.

    Raises
    ------
    SceneError
        The format cannot hold the lens.
    """
    notes = check_writable(lens, ZEMAX)
    files: dict[Path, bytes] = {}
    coatings = coating_names(lens)
    makers = _makers(lens)
    lines = ["VERS 140124 0 0", "MODE SEQ"]
    if lens.name:
        lines.append(f"NAME {' '.join(lens.name.split())}")
    if lens.source:
        lines.append(f"NOTE 0 {' '.join(lens.source.split())}")
    lines += ["PFIL 0 0 0", "UNIT MM X W X CM MR CPMM"]
    radius = stop_radius_mm(lens)
    if lens.epd_mm is not None:
        lines.append(f"ENPD {lens.epd_mm!r}")
    else:
        lines.append(f"FNUM {lens.f_number!r} 0" if lens.f_number is not None else "FLOA")
    if makers:
        lines.append(f"GCAT {' '.join(makers)}")
    lines += ["ENVD 20 1 0", *_conditions(conditions)]
    if coatings:
        text, inexact = coating_file(lens, coatings)
        beside = path.with_name(f"{path.stem}_coating.dat".replace('"', "_"))
        files[beside] = text.encode()
        # OpticStudio also requires the names of its other three files.
        lines.append(f'COFN QF "{beside.name}" "SCATTER_PROFILE.DAT" "ABG_DATA.DAT" "PROFILE.GRD"')
        notes += [f"the coatings are in {beside.name}; OpticStudio looks for it in its folder Coatings", *inexact]
    far = math.isinf(conditions.object_mm)
    rows = [
        _Row(
            ["  TYPE STANDARD", "  CURV 0.0", *_glass("object_medium", lens.object_medium or Matter(index=AIR))],
            math.inf if far else conditions.object_mm,
        ),
        *_rows(lens, radius, coatings),
    ]
    # The distance behind a group that is turned back belongs to the row of the return.
    rows[-1].distance += conditions.image_mm
    rows.append(_Row(["  TYPE STANDARD", "  CURV 0.0"], 0.0))
    for number, row in enumerate(rows):
        distance = "INFINITY" if math.isinf(row.distance) else repr(row.distance)
        lines += [f"SURF {number}", *row.lines, f"  DISZ {distance}"]
    if any("  TYPE HOLOGRM1" in row.lines for row in rows):
        notes.append("HOLOGRM1: the sign of its order is assumed to be that of HOLOGRM2; check it in OpticStudio")
    files[path] = ("\ufeff" + "\r\n".join([*lines, "MNUM 1 1", ""])).encode("utf-16-le")
    return files, notes


@dataclass
class _Row:
    """Surface of the file: its lines, and the distance to the next, mm."""

    lines: list[str]
    distance: float


_KINDS_OF_FIELD = {"angle": 0, "object": 1, "image": 3}


def _conditions(conditions: Conditions) -> list[str]:
    """Return the lines for fields and wavelengths."""
    fields = conditions.fields
    waves = conditions.wavelengths_nm

    def listed(values: Iterable[float]) -> str:
        return " ".join(map(repr, values))

    return [
        f"FTYP {_KINDS_OF_FIELD[conditions.field_kind]} 0 {len(fields)} {len(waves)} 0 0 0",
        f"XFLN {listed(point.x for point in fields)}",
        f"YFLN {listed(point.y for point in fields)}",
        f"FWGN {' '.join(['1'] * len(fields))}",
        f"VDYN {listed(0.5 * (point.upper - point.lower) for point in fields)}",
        f"VCYN {listed(1.0 - 0.5 * (point.upper + point.lower) for point in fields)}",
        *(f"WAVM {place} {nm / 1000.0!r} 1" for place, nm in enumerate(waves, 1)),
        f"PWAV {conditions.primary + 1}",
    ]


def _rows(lens: Lens, stop_mm: float | None, coatings: dict[str, str]) -> list[_Row]:
    """Return the surfaces, with coordinate breaks around off-axis elements."""
    rows: list[_Row] = []
    for i, surface in enumerate(lens.surfaces):
        which = lens.element_of(i)
        element = lens.elements[which] if which is not None and lens.elements[which].pose != Pose() else None
        if element is not None and element.surfaces[0] == i:
            shift, tilt = move_of(element)
            if shift[2] and not rows:
                rows.append(_Row(["  TYPE STANDARD", "  CURV 0.0"], 0.0))
            if shift[2]:
                rows[-1].distance += shift[2]
            rows.append(_Row(_break((*shift[:2], *tilt, 0.0)), 0.0))
        medium = lens.object_medium if i == 0 and surface.is_plain_stop else None
        row = _Row(_surface(i, surface, medium, stop_mm if surface.stop else surface.semi_diameter_mm), 0.0)
        if surface.coating in coatings:
            row.lines.append(f"  COAT {coatings[surface.coating]}")
        rows.append(row)
        row.distance = surface.thickness_mm or 0.0
        if element is not None and element.surfaces[-1] == i:
            shift, tilt = move_of(element)
            length = lens.vertices_mm[i] - lens.vertices_mm[element.surfaces[0]]
            back = _break((*(-value for value in (*shift[:2], *tilt)), 1.0))
            rows.append(_Row(back, length - shift[2] + row.distance))
            row.distance = -length
    return rows


def _break(values: Iterable[float]) -> list[str]:
    """Return a coordinate break: shifts, tilts, and their order."""
    return ["  TYPE COORDBRK", *(f"  PARM {place} {value + 0.0!r}" for place, value in enumerate(values, 1))]


def _surface(number: int, surface: Surface, medium: Matter | None, aperture_mm: float | None) -> list[str]:
    """Return the lines of a surface; `medium` overrides the surface's own."""
    lines = ["  STOP"] if surface.stop else []
    if surface.focal_length_mm is not None and math.isfinite(surface.focal_length_mm):
        lines += ["  TYPE PARAXIAL", f"  PARM 1 {surface.focal_length_mm!r}"]
    else:
        lines += _shape(number, surface)
    lines.append(f"  CURV {curvature(surface.vertex_radius_mm)!r} 0 0 0 0")
    lines += _glass(f"surfaces[{number}]", medium or surface)
    if surface.vertex_conic:
        lines.append(f"  CONI {surface.vertex_conic!r}")
    if aperture_mm is not None:
        lines += [f"  DIAM {aperture_mm!r} 1 0 0 1", f"  FLAP 0 {aperture_mm!r} 0"]
    return lines


def _glass(where: str, matter: Surface | Matter) -> list[str]:
    """Return the line of the medium behind a surface or before the lens; none for air."""
    glass = matter.glass
    if isinstance(glass, OwnGlass):
        if glass.nd is None or glass.air is not None:
            raise SceneError(f"{where}.glass: a Zemax file cannot hold this glass, {glass.in_words()}; write .seq")
        return [f"  GLAS ___BLANK 1 0 {glass.nd!r} {glass.vd!r} 0 0 0 0 0 0"]
    if isinstance(matter, Surface) and matter.gradient is not None:
        # Its index is in the parameters of the surface.
        return []
    if glass is not None:
        return [f"  GLAS {maker_and_name(glass, 'Zemax')[1]} 0 0 1.5 40 0 0 0 0 0 0"]
    # A model glass with Abbe number 0 has no dispersion.
    return [] if matter.medium is None else [f"  GLAS ___BLANK 1 0 {matter.index!r} 0 0 0 0 0 0 0"]


def _terms(terms_mm: Sequence[float]) -> list[str]:
    """Return a surface's type, and its coefficients of r² (zero), r⁴ and up."""
    if not terms_mm:
        return ["  TYPE STANDARD"]
    with_square = (0.0, *terms_mm)
    # Longer even aspheres are written as extended ones.
    if len(terms_mm) <= MOST_EVEN_TERMS:
        return ["  TYPE EVENASPH", *(f"  PARM {place} {value!r}" for place, value in enumerate(with_square, 1))]
    # The normalisation radius is 1 mm.
    extended = (len(with_square), 1.0, *with_square)
    return ["  TYPE XASPHERE", *(f"  XDAT {place} {value!r} 0 0" for place, value in enumerate(extended, 1))]


def _shape(number: int, surface: Surface) -> list[str]:
    """Return the type of a surface and its parameters."""
    if surface.phase is not None:
        return zemax_lines(number, surface)
    if surface.gradient is not None:
        return gradient_lines(number, surface)
    if surface.biconic is not None:
        section = surface.biconic
        return ["  TYPE BICONICX", f"  PARM 1 {_of_flat(section.radius_x_mm)!r}", f"  PARM 2 {section.conic_x!r}"]
    if surface.toroid is not None:
        if len(surface.terms_mm) > _MOST_OF_TOROID:
            raise SceneError(f"surfaces[{number}].asphere_mm: Zemax's toroid has {_MOST_OF_TOROID} terms from y⁴")
        terms = (_of_flat(surface.toroid.radius_x_mm), 0.0, *surface.terms_mm)
        return ["  TYPE TOROIDAL", *(f"  PARM {place} {value!r}" for place, value in enumerate(terms, 1))]
    return _odd_terms(number, surface) if any(surface.odd_asphere_mm) else _terms(surface.terms_mm)


def _of_flat(radius_mm: float) -> float:
    """Return a radius as a parameter; 0 means a flat section."""
    return 0.0 if math.isinf(radius_mm) else radius_mm


def _odd_terms(number: int, surface: Surface) -> list[str]:
    """Return the type of a surface with odd powers, and its coefficients by power."""
    terms = sorted((power, a) for power, a in surface.powers_mm if a)
    if terms[-1][0] > _LAST_ODD_POWER:
        raise SceneError(
            f"surfaces[{number}].odd_asphere_mm: Zemax's odd asphere has powers up to r^{_LAST_ODD_POWER}, even ones "
            f"too, not r^{terms[-1][0]}"
        )
    return ["  TYPE ODDASPHE", *(f"  PARM {power} {a!r}" for power, a in terms)]


def _makers(lens: Lens) -> list[str]:
    """Return the glass makers in an order that finds each name at its own maker."""
    glasses = list(dict.fromkeys(medium for medium in lens.media if isinstance(medium, str)))
    named = [(glass, *maker_and_name(glass, "Zemax")) for glass in glasses]
    makers = list(dict.fromkeys(maker for _, maker, _ in named))
    for turn in range(max(1, len(makers))):
        order = makers[turn:] + makers[:turn]
        try:
            if all(glass_name(named_glass(name, order)[0]) == glass_name(glass) for glass, _, name in named):
                return order
        except GlassError:
            continue
    raise SceneError(f"glasses {', '.join(glasses)}: a Zemax file cannot tell their makers apart")
