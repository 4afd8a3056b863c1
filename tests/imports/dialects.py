"""Lenses as other programs write them, for formats that the package reads alone, and such as all programs read."""

import json
import math
from collections.abc import Collection
from typing import Any

from scipy.spatial.transform import Rotation

import lfmesh as lf
from lfmesh.geometry.lens.element_poses import pose_of
from lfmesh.imports.writing import entrance_pupil_mm
from lfmesh.optics.glass import D_LINE_NM, refractive_index
from lfmesh.scene.materials.coatings import UNCOATED
from lfmesh.scene.materials.own_glass import OwnGlass

IMAGE_MM = 71.5
OSLO_NM = (500.0, 400.0, 600.0, 800.0)
"""Wavelengths of the OSLO files, the primary one first: those of its private glass."""


def terms(surface: lf.Surface) -> dict[int, float]:
    """Return the coefficients of a surface's sag by their power of r."""
    even = {4 + 2 * k: value for k, value in enumerate(surface.asphere_mm)}
    return even | {3 + 2 * k: value for k, value in enumerate(surface.odd_asphere_mm)}


def in_common_words(lens: lf.Lens, mistaken: Collection[str] = ()) -> lf.Lens:
    """Return a lens of surfaces and glasses that other programs read: bare, with at most seven terms, of revolution.

    Parameters
    ----------
    lens : Lens
    mistaken : collection of str
        Glasses that the other program takes for others. They, bare indices (of which programs make an Abbe number of 0)
        and tables (which programs interpolate in ways of their own) are given by nd and Vd.
    """
    surfaces = []
    none = {"biconic": None, "toroid": None, "qcon": None, "qbfs": None, "coating": UNCOATED}
    for surface in lens.surfaces:
        update: dict[str, Any] = {"asphere_mm": surface.asphere_mm[:7], **none}
        if surface.index is not None or isinstance(surface.glass, OwnGlass) or surface.glass in mistaken:
            nd = refractive_index(surface.medium, D_LINE_NM)
            update |= {"glass": OwnGlass(nd=nd, vd=50.0), "index": None}
        surfaces.append(surface.model_copy(update=update))
    return lens.model_copy(update={"surfaces": tuple(surfaces), "coatings": {}})


def distance_mm(lens: lf.Lens, number: int) -> float:
    """Return the thickness behind a surface; behind the last one to the image."""
    distance = lens.surfaces[number].thickness_mm
    return IMAGE_MM if distance is None else distance


def in_oslo(lens: lf.Lens) -> str:
    """Return a lens as OSLO's commands."""
    stop = lens.surfaces[lens.stop_index].semi_diameter_mm or 0.0
    lines = [f'LEN NEW "{lens.name}" 50 {len(lens.surfaces) + 1}']
    lines += [f"EBR {0.5 * entrance_pupil_mm(lens, stop, OSLO_NM[0])!r}", "UNI 1.0"]
    lines += [f"WV {' '.join(repr(nm / 1e3) for nm in OSLO_NM)}", "AIR; TH 1e20"]
    for number, surface in enumerate(lens.surfaces):
        lines.append("NXT")
        if isinstance(surface.glass, OwnGlass):
            values = dict(zip(surface.glass.wavelengths_nm, surface.glass.values or (), strict=True))
            lines.append(f"GLA MOD OWN {' '.join(repr(values[nm]) for nm in OSLO_NM)}")
        elif surface.medium is None:
            lines.append("AIR")
        else:
            lines.append(f"GLA {str(surface.medium).rpartition('/')[2]}")
        lines += [f"RD {surface.radius_mm if math.isfinite(surface.radius_mm) else 0.0!r}"]
        lines += [f"CC {surface.conic!r}; TH {distance_mm(lens, number)!r}; AP CHK {surface.semi_diameter_mm!r}"]
        lines += ["AST"] if surface.stop else []
        if surface.toroid is not None:
            lines.append(f"CVX {1.0 / surface.toroid.radius_x_mm!r}")
        step = 1 if surface.odd_asphere_mm else 2
        lines += [f"ASP {'ARA' if step == 1 else 'ASR'}"] if surface.asphere_mm else []
        lines += [f"AS{power // step} {value!r}" for power, value in terms(surface).items()]
        if lens.element_of(number) is not None:
            pose, vertex = pose_of(lens, number), [0.0, 0.0, lens.vertices_mm[number]]
            shift = pose[:, :3] @ vertex + pose[:, 3] - vertex
            a, b, c = Rotation.from_matrix(pose[:, :3]).as_euler("XYZ", degrees=True)
            moves = zip(("DCX", "DCY", "DCZ", "TLA", "TLB", "TLC"), (*shift, -a, -b, c), strict=True)
            lines += [f"{name} {float(value)!r}" for name, value in moves] + ["RCO"]
    return "\n".join([*lines, "NXT", "AIR", f"END {len(lens.surfaces) + 1}", ""])


def in_optiland(lens: lf.Lens) -> str:
    """Return a lens as optiland's JSON."""
    entries: list[dict[str, Any]] = []
    places = [-math.inf, *lens.vertices_mm, lens.vertices_mm[-1] + IMAGE_MM]
    for number, z in enumerate(places, -1):
        inside = 0 <= number < len(lens.surfaces)
        surface = lens.surfaces[number] if inside else lf.Surface(semi_diameter_mm=1.0)
        medium: dict[str, Any] = {"type": "IdealMaterial", "index": 1.0, "absorp": 0.0}
        if isinstance(surface.glass, OwnGlass):
            medium = {"type": "AbbeMaterial", "index": surface.glass.nd, "abbe": surface.glass.vd}
        elif surface.glass is not None:
            maker, _, name = surface.glass.partition("/")
            medium = {"type": "Material", "name": name, "filename": f"glass/{maker.lower()}/{name}.yml"}
        elif surface.index is not None:
            medium["index"] = surface.index
        first, step = (1, 1) if surface.odd_asphere_mm else (2, 2)
        held = terms(surface)
        powers = range(first, max(held, default=0) + 1, step)
        kind = "StandardGeometry" if not held else "OddAsphere" if step == 1 else "EvenAsphere"
        frame = {"x": 0.0, "y": 0.0, "z": z, "rx": 0.0, "ry": 0.0, "rz": 0.0, "reference_cs": None}
        shape = {"type": kind, "cs": frame, "radius": surface.radius_mm, "conic": surface.conic}
        shape["coefficients"] = [held.get(power, 0.0) for power in powers]
        rim = {"type": "RadialAperture", "r_max": surface.semi_diameter_mm, "r_min": 0.0}
        entry = {"type": "Surface", "geometry": shape, "material_post": medium, "is_stop": inside and surface.stop}
        entries.append(entry | {"aperture": rim if inside else None})
    stop = lens.surfaces[lens.stop_index].semi_diameter_mm or 0.0
    return json.dumps({
        "version": 1.0,
        "name": lens.name,
        "aperture": {"type": "float_by_stop_size", "value": 2.0 * stop},
        "fields": {"fields": [{"x": 0.0, "y": 0.0}], "field_definition": {"field_type": "AngleField"}},
        "wavelengths": {"wavelengths": [{"value": D_LINE_NM / 1e3, "is_primary": True, "unit": "um"}]},
        "surface_group": {"surfaces": entries},
    })  # fmt: skip


def in_a_table(lens: lf.Lens) -> str:
    """Return a lens as a table with decimal points."""
    powers = range(4, 32, 2)
    rows = [["radius", "thickness", "glass", "n", "v", "sd", "stop", "conic", *(f"A{power}" for power in powers)]]
    for number, surface in enumerate(lens.surfaces):
        glass = surface.glass
        medium = [str(surface.medium), "", ""] if isinstance(glass, str) else ["", "", ""]
        if isinstance(glass, OwnGlass):
            medium = ["", repr(glass.nd), repr(glass.vd)]
        elif surface.index is not None:
            medium = ["", repr(surface.index), ""]
        held = terms(surface)
        row = [repr(surface.radius_mm), repr(distance_mm(lens, number)), *medium, repr(surface.semi_diameter_mm)]
        row += ["x" if surface.stop else "", repr(surface.conic), *(repr(held.get(power, 0.0)) for power in powers)]
        rows.append(row)
    return "\n".join(";".join(row) for row in rows)


WRITTEN = {".len": in_oslo, ".json": in_optiland, ".csv": in_a_table}
