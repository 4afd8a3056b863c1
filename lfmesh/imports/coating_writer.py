"""Writer of a lens's coatings as a Zemax coating file; `lfmesh.imports.coatings` reads it."""

from collections.abc import Iterator

import numpy as np

from lfmesh.errors import GlassError, SceneError
from lfmesh.imports.coatings import BARE, numbered
from lfmesh.imports.numbers import micrometres
from lfmesh.optics.glass import complex_index
from lfmesh.scene.camera.lens import Lens
from lfmesh.scene.materials.coatings import Coating, Layer, MeasuredReflectance

_ONE_INDEX_NM = 550.0
"""Wavelength of the only row of a non-dispersive material."""

_TABLE_NM = np.arange(350.0, 1101.0, 5.0)
"""Wavelengths at which a catalogue material is written, where the catalogue has data. Linear interpolation between them
is off by about 1e-5 at 400 nm in ordinary glass."""

_KINDS = ("reflectance", "measured", "layers")
"""Kinds of coating that the file can hold."""


def coating_names(lens: Lens) -> dict[str, str]:
    """Map the coatings that the file can hold to names that are unique regardless of case."""
    names: dict[str, str] = {}
    taken = set(BARE)
    for name in dict.fromkeys(surface.coating for surface in lens.surfaces):
        if name not in lens.coatings or lens.coatings[name].kind not in _KINDS:
            continue
        free = next(each for each in numbered(name) if each.upper() not in taken)
        taken.add(free.upper())
        names[name] = free
    return names


def coating_file(lens: Lens, names: dict[str, str]) -> tuple[str, list[str]]:
    """Return the text of a coating file, and notes on inexact entries.

    Parameters
    ----------
    lens : Lens
    names : dict
        From `coating_names`.

    Raises
    ------
    SceneError
        For a layer's material, the catalogue covers none of a table's wavelengths.
    """
    notes: list[str] = []
    materials: dict[tuple[str, ...], str] = {}
    entries: list[str] = []
    for name, free in names.items():
        entries += _entry(free, lens.coatings[name], materials, notes)
    tables = [line for rows, material in materials.items() for line in (f"MATE {material}", *rows)]
    return "\r\n".join([*tables, *entries, ""]), list(dict.fromkeys(notes))


def _entry(name: str, coating: Coating, materials: dict[tuple[str, ...], str], notes: list[str]) -> Iterator[str]:
    """Yield the lines of a coating; add its materials to `materials`, keyed by their rows."""
    if coating.reflectance is not None:
        yield f"IDEAL {name} {1.0 - coating.reflectance!r} {coating.reflectance!r}"
    elif coating.measured is not None:
        yield f"TABLE {name}"
        yield from _by_angle(coating.measured)
    else:
        yield f"COAT {name}"
        for layer in coating.layers or ():
            material = materials.setdefault(_material(layer, notes), f"M{len(materials) + 1}")
            # 1 means that the thickness is in µm.
            yield f"{material} {micrometres(layer.thickness_nm)} 1"


def _by_angle(table: MeasuredReflectance) -> Iterator[str]:
    """Yield reflectance and transmittance, equal for s and p and with phase 0, by angle and wavelength."""
    for place, angle in enumerate(table.angles_deg):
        yield f"ANGL {angle!r}"
        for wavelength_nm, row in zip(table.wavelengths_nm, table.reflectance, strict=True):
            reflected, passed = row[place], 1.0 - row[place]
            yield f"WAVE {micrometres(wavelength_nm)} {reflected!r} {reflected!r} {passed!r} {passed!r} 0 0 0 0"


def _material(layer: Layer, notes: list[str]) -> tuple[str, ...]:
    """Return the rows of a layer's material: wavelength in µm, n, and negative k."""
    if layer.measured is not None:
        lines = layer.measured.wavelengths_nm
    elif layer.glass is None:
        lines = (_ONE_INDEX_NM,)
    else:
        lines = tuple(line for line in map(float, _TABLE_NM) if _has(layer.glass, line))
        if not lines:
            raise SceneError(f"a coating's layer of {layer.glass}: the catalogue lacks the table's wavelengths")
        notes.append(f"a layer of {layer.glass} is written as a table from {lines[0]:g} to {lines[-1]:g} nm")
    indices = [(line, layer.index_at(line)) for line in lines]
    return tuple(f"{micrometres(line)} {n.real!r} {0.0 - n.imag!r}" for line, n in indices)


def _has(glass: str, wavelength_nm: float) -> bool:
    try:
        complex_index(glass, wavelength_nm)
    except GlassError:
        return False
    return True
