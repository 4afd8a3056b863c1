"""Lens properties that other programs' files can hold, shared by the writers of both formats."""

from lfmesh.errors import GlassError, SceneError
from lfmesh.imports.coating_writer import coating_names
from lfmesh.imports.gradient_writer import check_gradient
from lfmesh.imports.phase_writer import check_phase
from lfmesh.imports.zemax_tables import SECTIONS
from lfmesh.optics.glass import D_LINE_NM, find_glass, glass_name
from lfmesh.scene.camera.lens import Lens
from lfmesh.scene.first_order.paraxial import Paraxial
from lfmesh.scene.materials.coatings import UNCOATED
from lfmesh.scene.materials.own_glass import OwnGlass

ZEMAX = "Zemax"


def check_writable(lens: Lens, program: str) -> list[str]:
    """Return notes on properties that a file will lack.

    Raises
    ------
    SceneError
        Without the missing properties it would be another lens.
    """
    for i, surface in enumerate(lens.surfaces):
        if surface.paraxial and program != ZEMAX:
            raise SceneError(f"surfaces[{i}].paraxial: a {program} file cannot hold a thin lens; write .zmx")
        form = surface.section_key
        if form is not None and (program != ZEMAX or form not in SECTIONS.values()):
            other = "; write .zmx" if form in SECTIONS.values() else ""
            raise SceneError(f"surfaces[{i}].{form}: not written to {program} files{other}")
        if surface.refractor is not None or surface.mesh is not None:
            raise SceneError(f"surfaces[{i}]: a mesh cannot be written as a {program} surface")
        check_phase(i, surface, program)
        if surface.gradient is not None and program != ZEMAX:
            raise SceneError(f"surfaces[{i}].gradient: not written to {program} files; write .zmx")
        check_gradient(i, surface)
    held = {UNCOATED, *(coating_names(lens) if program == ZEMAX else ())}
    coated = [str(i) for i, surface in enumerate(lens.surfaces) if surface.coating not in held]
    phases = {i: surface.phase for i, surface in enumerate(lens.surfaces) if surface.phase is not None}
    lossy = [str(i) for i, phase in phases.items() if phase.efficiency != "ideal" or phase.orders]
    notes = [f"coatings of surfaces {', '.join(coated)} are not in the file"] if coated else []
    return notes + ([f"efficiencies of the phases of surfaces {', '.join(lossy)} are not in the file"] if lossy else [])


PRIVATE_NM = (
    365.0146,
    404.6561,
    435.8343,
    486.1327,
    546.074,
    D_LINE_NM,
    656.2725,
    706.5188,
    768.195,
    852.11,
    930.0,
    1013.98,
)
"""Wavelengths of the table for an unnamed glass: spectral lines, and one in a gap between them."""


def table_of(glass: OwnGlass) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the wavelengths, in nm, and indices that represent an unnamed glass."""
    if glass.wavelengths_nm is not None and glass.values is not None and glass.air is None:
        return glass.wavelengths_nm, glass.values
    return PRIVATE_NM, tuple(glass.index_at(line) for line in PRIVATE_NM)


def maker_and_name(glass: str, program: str) -> tuple[str, str]:
    """Return maker and name of a catalogue glass, such as ("SCHOTT", "N-BK7").

    Raises
    ------
    SceneError
        It is no maker's glass, so the other program cannot find it.
    """
    try:
        shelf, book, name = find_glass(glass)
        full = glass_name(glass)
    except GlassError as error:
        raise SceneError(str(error)) from None
    if shelf != "specs":
        raise SceneError(f"glass {full!r}: not a maker's glass; a {program} file cannot name it")
    return book.split("-")[0].upper(), name


def stop_radius_mm(lens: Lens) -> float | None:
    """Return the radius of the stop, in mm; None if the f-number sets it, or no surface is the stop."""
    stop = lens.stop_index
    return None if stop is None else lens.aperture_mm(stop)


def entrance_pupil_mm(lens: Lens, radius_mm: float, wavelength_nm: float) -> float:
    """Return the entrance pupil diameter for a stop.

    Parameters
    ----------
    lens : Lens
    radius_mm : float
        Radius of the stop.
    wavelength_nm : float
    """
    return Paraxial.of(lens, wavelength_nm).entrance_pupil(radius_mm)[1]


def curvature(radius_mm: float) -> float:
    """Return 1/radius; 0 for a plane."""
    return 1.0 / radius_mm
