"""Writer of a lens as a CODE V sequence."""

import math
from collections.abc import Sequence
from pathlib import Path

from lfmesh.errors import GlassError, SceneError
from lfmesh.imports.codev_tables import COEFFICIENTS, MOVES
from lfmesh.imports.conditions import Conditions
from lfmesh.imports.decentres import START, Move, move_of
from lfmesh.imports.phase_writer import codev_lines
from lfmesh.imports.writing import check_writable, entrance_pupil_mm, maker_and_name, stop_radius_mm, table_of
from lfmesh.optics.glass import Medium
from lfmesh.scene.camera.lens import Lens, Surface
from lfmesh.scene.first_order.paraxial import Paraxial
from lfmesh.scene.materials.own_glass import OwnGlass
from lfmesh.scene.pose import Pose


def written(lens: Lens, conditions: Conditions, path: Path) -> tuple[dict[Path, bytes], list[str]]:
    """Return a lens as the bytes of a `.seq` file, and notes on properties that the file lacks.

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
    notes = check_writable(lens, "CODE V")
    lines = ["RDM;LEN", f"TITLE '{_quoted(lens.name or 'lens')}'"]
    if lens.source:
        lines.append(f"! {' '.join(lens.source.split())}")
        notes.append("the source is written as a comment")
    radius = stop_radius_mm(lens)
    far = math.isinf(conditions.object_mm)
    primary_nm = conditions.wavelengths_nm[conditions.primary]
    if lens.f_number is not None and far:
        lines.append(f"FNO {lens.f_number!r}")
    elif lens.f_number is not None:
        # FNO is the image-side f-number at any object distance.
        lines.append(f"EPD {abs(Paraxial.of(lens, primary_nm).efl_mm) / lens.f_number!r}")
    else:
        lines.append(f"EPD {lens.epd_mm or entrance_pupil_mm(lens, radius or 1.0, primary_nm)!r}")
    lines += ["DIM M", *_conditions(conditions)]
    plain = dict.fromkeys(medium for medium in lens.media if isinstance(medium, float))
    private: dict[Medium, str] = {index: f"N{i}" for i, index in enumerate(plain)}
    if private:
        # Give two wavelengths, to show that the table means a constant index.
        lines += ["PRV", "PWL 1000.0 400.0", *(f"'{name}' {n!r} {n!r}" for n, name in private.items()), "END"]
    lines += _dispersive(lens, private, notes)
    distance = "0.1e14" if far else repr(conditions.object_mm)
    lines.append(f"SO 0.0 {distance}{_named(lens.media[0], private)}")
    for i, (surface, medium) in enumerate(zip(lens.surfaces, lens.media[1:], strict=True)):
        last = i == len(lens.surfaces) - 1
        behind = conditions.image_mm if last else surface.thickness_mm or 0.0
        radius_mm = 0.0 if math.isinf(surface.vertex_radius_mm) else surface.vertex_radius_mm
        lines.append(f"S {radius_mm!r} {behind!r}{_named(medium, private)}")
        lines += _qualified(i, surface, radius if surface.stop else surface.semi_diameter_mm)
        if surface.phase is not None:
            lines += codev_lines(i, surface.phase, primary_nm)
        lines += _moved(lens, i)
    return {path: "\r\n".join([*lines, "SI 0.0 0.0", "GO", ""]).encode()}, notes


def _named(medium: Medium, private: dict[Medium, str]) -> str:
    """Return the glass name that ends a surface's line; empty for air."""
    if isinstance(medium, str):
        maker, name = maker_and_name(medium, "CODE V")
        return f" {''.join(sign for sign in name if sign.isalnum())}_{maker}"
    return "" if medium is None else f" '{private[medium]}'"


def _conditions(conditions: Conditions) -> list[str]:
    """Return the lines for wavelengths and fields."""
    kind = {"angle": "AN", "object": "OB", "image": "IM"}[conditions.field_kind]
    fields = conditions.fields
    columns: dict[str, Sequence[float]] = {
        "WL": list(conditions.wavelengths_nm),
        "REF": [conditions.primary + 1],
        f"X{kind}": [point.x for point in fields],
        f"Y{kind}": [point.y for point in fields],
        "VUY": [1.0 - point.upper for point in fields],
        "VLY": [1.0 - point.lower for point in fields],
    }
    return [f"{name} {' '.join(map(repr, values))}" for name, values in columns.items()]


def _moved(lens: Lens, number: int) -> list[str]:
    """Return the decentre of a surface in an off-axis element; the axis continues unchanged behind it."""
    which = lens.element_of(number)
    if which is None or lens.elements[which].pose == Pose():
        return []
    element = lens.elements[which]
    shift, tilt = move_of(element)
    from_first = lens.vertices_mm[number] - lens.vertices_mm[element.surfaces[0]]
    place = START.moved(Move.shifted_then_tilted(shift, tilt)).along(from_first)
    x, y, z = place.vertex - [0.0, 0.0, from_first]
    values = (x, y, z, -tilt[0], -tilt[1], tilt[2])
    return [*(f"  {name} {float(value) + 0.0!r}" for name, value in zip(MOVES, values, strict=True)), "  DAR"]


def _dispersive(lens: Lens, private: dict[Medium, str], notes: list[str]) -> list[str]:
    """Return the tables of unnamed glasses, and enter the names given to them in `private`."""
    lines = []
    for glass in lens.media:
        if not isinstance(glass, OwnGlass) or glass in private:
            continue
        private[glass] = f"G{len(private)}"
        try:
            wavelengths_nm, indices = table_of(glass)
        except GlassError as error:
            raise SceneError(f"{glass.in_words()}: it cannot be tabulated: {error}") from None
        lines += ["PRV", f"PWL {' '.join(map(repr, wavelengths_nm))}"]
        lines += [f"'{private[glass]}' {' '.join(map(repr, indices))}", "END"]
        if glass.values is None:
            notes.append(f"{glass.in_words()} is written as a table of its indices")
    return lines


def _qualified(number: int, surface: Surface, aperture_mm: float | None) -> list[str]:
    """Return the lines that qualify a surface."""
    if any(surface.odd_asphere_mm):
        raise SceneError(f"surfaces[{number}].odd_asphere_mm: not written to CODE V files; write .zmx")
    if len(surface.terms_mm) > len(COEFFICIENTS):
        key = surface.terms_key
        raise SceneError(f"surfaces[{number}].{key}: CODE V's asphere has {len(COEFFICIENTS)} terms from r⁴")
    lines = ["  STO"] if surface.stop else []
    if aperture_mm is not None:
        lines.append(f"  CIR {aperture_mm!r}")
    if surface.terms_mm:
        terms = (f"{letter} {value!r}" for letter, value in zip(COEFFICIENTS, surface.terms_mm, strict=False))
        lines += ["  ASP", f"  K {surface.vertex_conic!r}", f"  {'; '.join(terms)}"]
    elif surface.vertex_conic:
        lines += ["  CON", f"  K {surface.vertex_conic!r}"]
    return lines


def _quoted(text: str) -> str:
    return " ".join(text.replace("'", "’").split())
