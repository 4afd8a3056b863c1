"""Prescription as in a lens file, with object and image, lengths in the file's unit."""

from dataclasses import dataclass, field
from pathlib import Path

from lfmesh.errors import GlassError
from lfmesh.imports.conditions import FieldPoint
from lfmesh.imports.decentres import Move
from lfmesh.imports.glasses import Medium
from lfmesh.imports.gradient_files import GradientFiles
from lfmesh.imports.gradient_keys import GradientKeys
from lfmesh.imports.phase_keys import PhaseKeys
from lfmesh.imports.square_terms import SquareTerm, without_square
from lfmesh.optics.glass import D_LINE_NM
from lfmesh.scene.camera.gradient import Gradient
from lfmesh.scene.camera.lens import Element
from lfmesh.scene.camera.qbfs import Qbfs
from lfmesh.scene.camera.qcon import MOST_ASPHERE_TERMS
from lfmesh.scene.first_order.paraxial import GradientGap, gradient_gap

FAR_MM = 1e9
"""Distance from which an object counts as infinite; files write 1e10 to 1e14."""

MOST_SURFACES = 1000
"""More than any lens has; larger files are refused before they exhaust the memory."""

MOST_CONFIGURATIONS = 1000
"""More configurations than any file has."""


OuterShape = tuple[float, float, float, list[float]]
"""Border, curvature, conic constant and coefficients of r⁴, r⁶, ... of an outer zone."""


@dataclass
class FileSurface:
    """Surface as in the file, lengths in the file's unit."""

    line: int
    """First line in the file, from 1."""
    text: str = ""
    curvature: float = 0.0
    thickness: float = 0.0
    glass: str | None = None
    glass_line: tuple[int, str] | None = None
    """Line of the glass, if not the surface's own."""
    model: tuple[float, float] | None = None
    """nd and Vd, in place of a name."""
    stated_index: float | None = None
    """nd given beside the name."""
    stated_abbe: float | None = None
    """Vd given beside the name."""
    conic: float = 0.0
    asphere: list[float] = field(default_factory=list)
    """Coefficients of r⁴, r⁶, ..."""
    odd: list[float] = field(default_factory=list)
    """Coefficients of r³, r⁵, ..."""
    square: float = 0.0
    """Coefficient of r², in addition to the curvature."""
    forbes: tuple[str, float, list[float]] | None = None
    """"qbfs" or "qcon", normalisation radius, and coefficients, for a Forbes asphere."""
    rewritten: SquareTerm | None = None
    """Shape before the r² term was absorbed by the others."""
    section: str | None = None
    """"biconic" or "toroid" if the x–z section differs; the other shape is that of y–z."""
    curvature_x: float = 0.0
    conic_x: float = 0.0
    outer_zone: OuterShape | None = None
    """Zone with another shape, which continues the inner one without a step."""
    aperture: float | None = None
    """Radius beyond which the file's program blocks light."""
    extent: float | None = None
    """Radius filled by rays of the file's fields, as computed and drawn by its program."""
    stop: bool = False
    coating: tuple[int, str, str | Path] | None = None
    """Line, text and name of its coating; or the path of a file that holds only this coating."""
    phase: PhaseKeys | None = None
    """Keys of its phase in a scene, lengths in mm."""
    gradient: GradientKeys | None = None
    """Keys of the gradient-index glass behind it in a scene, lengths in mm."""
    focal_length: float | None = None
    """Focal length of a thin lens in place of the surface; NaN: not given."""
    is_break: bool = False
    """True for a mere move of the frame, without change of medium."""
    before: Move | None = None
    """Move of the frame before the surface."""
    after: Move | None = None
    """Move of the frame at the surface's vertex, before its thickness."""
    returns_to: int | None = None
    """Number of an earlier surface in whose frame its thickness counts instead of its own; 0 is the object."""

    @property
    def is_flat(self) -> bool:
        """True for a plane."""
        terms = (self.curvature, self.curvature_x, self.square, *self.asphere, *self.odd)
        return not any(terms) and self.forbes is None and self.outer_zone is None

    @property
    def vertex_curvature(self) -> float:
        """Curvature at the vertex, including the contribution of Forbes' mild terms."""
        if self.forbes is None or self.forbes[0] != "qbfs":
            return self.curvature
        form = Qbfs(norm_radius_mm=self.forbes[1], coefficients_mm=tuple(self.forbes[2])).even_form(
            self.curvature, self.conic, self.aperture or self.extent
        )
        return self.curvature if form is None else 1.0 / form.radius_mm

    def add_term(self, power: int, value: float) -> None:
        """Add a term in a power of r to the sag; ValueError if impossible."""
        if not value:
            return
        if power < 1:
            raise ValueError("a term without r moves the surface along the axis; put it into the thicknesses")
        if power == 1:
            raise ValueError("a term in r makes a cone, which is not supported: it has no normal at its vertex")
        if power == 2 and self.section is not None:
            raise ValueError("a term in y² beside the curvature is not supported; put it into the curvature")
        if power > 2 * MOST_ASPHERE_TERMS + 2:
            raise ValueError(f"a term in r^{power}: aspheres reach up to r^{2 * MOST_ASPHERE_TERMS + 2}")
        if power == 2:
            self.square = value
            return
        terms, place = (self.odd if power % 2 else self.asphere), (power - 3) // 2
        terms += [0.0] * (place + 1 - len(terms))
        terms[place] = value

    def take_square(self) -> None:
        """Absorb the r² term into the curvature, conic constant and other terms."""
        if self.square:
            self.rewritten = SquareTerm(self.curvature, self.conic, self.square)
            self.curvature, self.conic, self.asphere = without_square(
                self.curvature, self.conic, self.asphere, self.square
            )
            self.square = 0.0


@dataclass
class Prescription:
    """Content of a lens file, from object to image.

    Attributes
    ----------
    unit_mm : float
        Length of the file's unit.
    pupil : tuple of str and float
        Definition of the aperture: "epd", "f_number" (object at infinity), "working_f_number", "object_na", "image_na",
        "image_slope" (of the marginal ray), each with its value, or "stop" for the stop surface's own size.
    field_kind : str
        "angle" in degrees, "object" or "image": heights.
    makers : list of str
        Glass catalogues of the file, in order of preference.
    indices : dict
        Index or glass, by name, of materials that the file defines.
    coating_file : str or Path, optional
        Name of the coating file beside this one, or path of another.
    gradient_files : GradientFiles
        Files of gradient-index materials.
    telecentric : tuple of int and str, optional
        Line and text that require object-space telecentricity.
    """

    surfaces: list[FileSurface] = field(default_factory=list)
    name: str | None = None
    source: str | None = None
    unit_mm: float = 1.0
    pupil: tuple[str, float] = ("stop", 0.0)
    wavelengths_nm: list[float] = field(default_factory=list)
    primary: int = 0
    field_kind: str = "angle"
    fields: list[FieldPoint] = field(default_factory=list)
    makers: list[str] = field(default_factory=list)
    indices: dict[str, Medium] = field(default_factory=dict)
    coating_file: str | Path | None = None
    gradient_files: GradientFiles = field(default_factory=lambda: GradientFiles(Path()))
    telecentric: tuple[int, str] | None = None

    @property
    def primary_nm(self) -> float:
        """Wavelength of first-order figures; the d line if the file gives none."""
        lines = self.wavelengths_nm
        return lines[min(self.primary, len(lines) - 1)] if lines else D_LINE_NM


@dataclass
class KeptSurfaces:
    """Surfaces that matter, in mm, with the gaps after merging."""

    kept: list[FileSurface]
    media: list[Medium | None]
    gaps_mm: list[float]
    object_mm: float
    """Distance of the object before the first one; inf if treated as infinite."""
    image_mm: float
    elements: list[Element] = field(default_factory=list)
    """Off-axis groups, by the numbers of their surfaces in `kept`."""
    thin_powers: list[tuple[float, float]] = field(default_factory=list)
    """Powers of thin lenses and phases in the sections y–z and x–z, 1/mm; 0 for other surfaces."""

    def gradient_gaps(self, wavelength_nm: float, section_x: bool = False) -> tuple[GradientGap | None, ...]:
        """Return the paraxial optics of gaps of gradient-index glass, as `Paraxial` takes them.

        Parameters
        ----------
        wavelength_nm : float
        section_x : bool
            Use the x–z section in place of y–z.

        Raises
        ------
        GlassError
            The index on the axis is not between 1 and 10.
        """
        gaps = list[GradientGap | None]()
        for surface, medium, length in zip(self.kept, self.media, self.gaps_mm, strict=False):
            if not isinstance(medium, Gradient):
                gaps.append(None)
                continue
            try:
                gaps.append(gradient_gap(medium, wavelength_nm, length, section_x))
            except GlassError as error:
                raise GlassError(f"line {surface.line}: {surface.text}: {error}") from None
        return tuple(gaps) if any(gaps) else ()
