"""Coatings of a lens file's surfaces, from the files that define them."""

import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from lfmesh.imports.coatings import USUAL_FILE, CoatingFile, UnreadableCoatingError, found_coating, numbered
from lfmesh.imports.glasses import Medium
from lfmesh.imports.multilayer import multilayer
from lfmesh.imports.prescription import FileSurface, Prescription
from lfmesh.imports.report import Report, Verdict
from lfmesh.scene.camera.gradient import Gradient
from lfmesh.scene.materials.coatings import UNCOATED, Coating


def lens_coatings(
    surfaces: Sequence[FileSurface],
    media: Sequence[Medium | None],
    prescription: Prescription,
    report: Report,
) -> tuple[dict[str, Coating], list[str | None]]:
    """Return the coatings of a lens by name, and the coating name of each surface.

    Parameters
    ----------
    surfaces : sequence of FileSurface
    media : sequence of Medium
        Medium before the first surface, then behind each; None is air.
    prescription : Prescription
        Gives the coating file, and the primary wavelength for quarter waves.
    report : Report
        Receives the verdict on each line with a coating.
    """
    coatings: dict[str, Coating] = {}
    names: list[str | None] = []
    primary_nm, file_name = prescription.primary_nm, prescription.coating_file
    coated = any(surface.coating for surface in surfaces)
    file = CoatingFile.beside(report.path, file_name) if coated else None
    for surface, (before, medium) in zip(surfaces, pairwise(media), strict=True):
        names.append(None)
        if surface.coating is not None:
            line, text, name = surface.coating
            found, bare = None, ""
            if medium == before or surface.focal_length is not None:
                bare = "no coating, since it has the same medium on both sides"
            else:
                try:
                    if isinstance(name, Path):
                        found = multilayer(name)
                    else:
                        found = found_coating(name, primary_nm, file, str(file_name or USUAL_FILE))
                except UnreadableCoatingError as error:
                    bare = f"{error}; the surface is traced bare"
            if found is not None and found.coating.layers and any(isinstance(m, Gradient) for m in (before, medium)):
                found, bare = None, "layers on gradient-index glass are not supported; the surface is traced bare"
            if found is not None:
                coating = found.coating
                free = next(each for each in numbered(_name_in_scene(name)) if coatings.get(each, coating) == coating)
                names[-1], coatings[free] = free, coating
            how = bare
            if found is not None:
                beyond = _beyond_tables(found.coating, prescription.wavelengths_nm)
                how = "; ".join(filter(None, (found.how, beyond)))
            report.add(line, text, Verdict.APPROXIMATED if how else Verdict.TAKEN, how)
    return coatings, names


def _beyond_tables(coating: Coating, wavelengths_nm: Sequence[float]) -> str:
    """Return a note on a coating if some of the wavelengths lie outside its tables."""
    tables = {layer.measured.wavelengths_nm for layer in coating.layers or () if layer.measured is not None}
    tables |= {coating.measured.wavelengths_nm} if coating.measured is not None else set()
    for table in sorted(tables):
        beyond = [line for line in wavelengths_nm if not table[0] <= line <= table[-1]]
        if len(table) > 1 and beyond:
            return (
                f"at {', '.join(f'{line:g}' for line in beyond)} nm, outside its table from {table[0]:g} to "
                f"{table[-1]:g} nm, the nearest index or shares are taken"
            )
    return ""


def _name_in_scene(name: str | Path) -> str:
    """Return the name of a coating or of its file, restricted to letters that a scene allows."""
    allowed = re.sub(r"[^A-Za-z0-9_-]", "_", name.stem if isinstance(name, Path) else name)
    return f"{allowed}_" if allowed == UNCOATED else allowed
