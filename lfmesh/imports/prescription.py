"""A prescription as lens files hold it, with object and image, lengths in the file's unit."""

from dataclasses import dataclass, field
from pathlib import Path

from lfmesh.imports.conditions import FieldPoint
from lfmesh.imports.decentres import Move
from lfmesh.imports.glasses import Medium
from lfmesh.imports.square_terms import SquareTerm, without_square
from lfmesh.optics.glass import D_LINE_NM
from lfmesh.scene.camera.lens import Element
from lfmesh.scene.camera.qbfs import Qbfs
from lfmesh.scene.camera.qcon import MOST_ASPHERE_TERMS

FAR_MM = 1e9
"""Distance of the object from which it counts as infinite; files write 1e10 to 1e14."""

MOST_SURFACES = 1000
"""More than any lens has; a file of more ends in an error before it takes the memory."""

MOST_CONFIGURATIONS = 1000
"""Of one file: more than any has."""


@dataclass
class FileSurface:
    """A surface as the file has it, lengths in the file's unit."""

    line: int
    """Line of the file at which it starts, from 1."""
    text: str = ""
    curvature: float = 0.0
    thickness: float = 0.0
    glass: str | None = None
    glass_line: tuple[int, str] | None = None
    """Line of the glass, if not the surface's own."""
    model: tuple[float, float] | None = None
    """nd and Vd in place of a name."""
    stated_index: float | None = None
    """nd that the file gives beside the name."""
    stated_abbe: float | None = None
    """Vd that the file gives beside the name."""
    conic: float = 0.0
    asphere: list[float] = field(default_factory=list)
    """Coefficients of r⁴, r⁶, ..."""
    odd: list[float] = field(default_factory=list)
    """Coefficients of r³, r⁵, ..."""
    square: float = 0.0
    """Coefficient of r², beside the curvature."""
    forbes: tuple[str, float, list[float]] | None = None
    """"qbfs" or "qcon", the radius that heights are counted in, and the coefficients, of a Forbes asphere."""
    rewritten: SquareTerm | None = None
    """Surface before that term was put into the others."""
    section: str | None = None
    """"biconic" or "toroid", where the section x–z is another one: the other shape is that of y–z."""
    curvature_x: float = 0.0
    conic_x: float = 0.0
    aperture: float | None = None
    """Radius beyond which the file's program stops light."""
    extent: float | None = None
    """Radius that rays of the file's fields fill: what its program computed and draws."""
    stop: bool = False
    coating: tuple[int, str, str | Path] | None = None
    """Line, text and name of its coating; or the path of a file that holds it alone."""
    focal_length: float | None = None
    """Of a thin lens in the surface's place; NaN: not given."""
    is_break: bool = False
    """True for a move of the frame alone, in the medium that is there."""
    before: Move | None = None
    """Of the frame, before the surface."""
    after: Move | None = None
    """Of the frame, at the surface's vertex, before its thickness."""
    returns_to: int | None = None
    """Number of an earlier surface in whose frame its thickness counts, in place of its own; 0 is the object."""

    @property
    def vertex_curvature(self) -> float:
        """Curvature at the vertex, where Forbes' mild terms have a share in it."""
        if self.forbes is None or self.forbes[0] != "qbfs":
            return self.curvature
        form = Qbfs(norm_radius_mm=self.forbes[1], coefficients_mm=tuple(self.forbes[2])).even_form(
            self.curvature, self.conic, self.aperture or self.extent
        )
        return self.curvature if form is None else 1.0 / form.radius_mm

    def add_term(self, power: int, value: float) -> None:
        """Let the sag have a term in a power of r; ValueError where there can be none."""
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
        """Put a term in r² into the curvature, the conic constant and the other terms."""
        if self.square:
            self.rewritten = SquareTerm(self.curvature, self.conic, self.square)
            self.curvature, self.conic, self.asphere = without_square(
                self.curvature, self.conic, self.asphere, self.square
            )
            self.square = 0.0


@dataclass
class Prescription:
    """Content of a lens file, from the object to the image.

    Attributes
    ----------
    unit_mm : float
        Length of the file's unit.
    pupil : tuple of str and float
        What sets the aperture: "epd", "f_number" (of the object at infinity), "working_f_number", "object_na",
        "image_na", each with its value, or "stop" for the stop surface's own size.
    field_kind : str
        "angle" in degrees, "object" or "image": heights.
    makers : list of str
        Glass catalogues that the file uses, the first first.
    indices : dict
        Index, or glass, by name of the materials that the file defines itself.
    coating_file : str or Path, optional
        Name of the file, beside this one, that defines coatings; or the path of one that is given in its place.
    telecentric : tuple of int and str, optional
        Line, with its text, that asks for chief rays parallel to the axis in object space.
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
    telecentric: tuple[int, str] | None = None

    @property
    def primary_nm(self) -> float:
        """Wavelength of first-order figures; the d line where the file gives none."""
        lines = self.wavelengths_nm
        return lines[min(self.primary, len(lines) - 1)] if lines else D_LINE_NM


@dataclass
class KeptSurfaces:
    """The surfaces that matter, in mm, with the gaps after merging."""

    kept: list[FileSurface]
    media: list[Medium | None]
    gaps_mm: list[float]
    object_mm: float
    """Distance of the object before the first one; inf where it counts as infinite."""
    image_mm: float
    elements: list[Element] = field(default_factory=list)
    """Groups that stand off the axis, by their numbers among these surfaces."""
