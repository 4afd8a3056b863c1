"""Targets of the camera: primitive shapes and mesh files, with their material."""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from lfmesh.scene.light.spectra import Kelvin, Radiance, Reflectance, Spectrum, reflectance_fault
from lfmesh.scene.light.spectra import Shape as SpectralShape
from lfmesh.scene.model import Fault, Model
from lfmesh.scene.motion import Motion
from lfmesh.scene.objects.refractor import BodyFile, Refractor
from lfmesh.scene.objects.shapes import Shape
from lfmesh.scene.quantities import FilePath, GlossIndex, MetalName, Opacity, Positive, Text, Vector

SMALLEST_ROUGHNESS, LARGEST_ROUGHNESS = 0.01, 1.0
"""Limits on the α_g of a gloss."""


class Gloss(Model):
    """A rough boundary that reflects by GGX facets: of a dielectric layer over the base, or of metal."""

    index: GlossIndex | None = None
    """Refractive index of a dielectric layer over the base. Light that it transmits reaches the base. Or give
    `metal`."""
    metal: MetalName | None = None
    """Metal of the catalogue: a symbol like "Al", or a page like "main/Al/Rakic". No light reaches the base, so the
    material's reflectance and texture have no effect."""
    roughness: Annotated[float, Field(strict=True, ge=SMALLEST_ROUGHNESS, le=LARGEST_ROUGHNESS)]
    """Walter's α_g, 0.01..1; a glTF roughness r is r². Smoother surfaces are mirrors, which a target cannot be."""

    def faults(self) -> Iterator[Fault]:
        """Yield faults between fields."""
        if self.index is None and self.metal is None:
            yield Fault(("index",), None, "missing: give the index of the layer, or metal")
        elif self.index is not None and self.metal is not None:
            yield Fault(("metal",), self.metal, f"index = {self.index:g} is given too; give one of them")


class Material(Model):
    """Material of a target: Lambertian reflection, with or without gloss over it, and emission."""

    opacity: Opacity = 1.0
    """Share of the surface that is there, 0..1; "texture_alpha" takes the alpha of the texture. Light passes straight
    through the rest. Without a texture, the alpha of the mesh file's own pictures and colours is used. A closed body
    that is not opaque also scatters and emits on its inside."""
    sides: Literal["both", "front"] = "both"
    """Sides of an open sheet that reflect and emit; the other side is black. "front": the side from which the corners
    of its facets run counter-clockwise (the +z side of a plane or disk). A closed body has only its outside."""

    reflectance: Reflectance = 0.8
    """Share of the light that is scattered, by Lambert's law, 0..1; under `gloss`, of the light that reaches the base.
    A number, a table { wavelengths_nm = [...], values = [...] } or a CSV file with the columns wavelength_nm and
    value."""
    gloss: Gloss | None = None
    """Reflecting boundary over the base. Omitted: matt."""
    radiance_w_m2_sr: Radiance = 0.0
    """Emission of the surface, the same in every direction. A number, in W/(m² sr), applies at each wavelength of
    `transport.wavelengths_nm`. With bands it is the radiance over the whole range from the start of the first band to
    the end of the last, spread evenly or by `spectrum`. With bands also a table, a CSV file or { blackbody_k = ... },
    in W/(m² sr nm)."""
    spectrum: SpectralShape | None = None
    """Spectrum of a number in `radiance_w_m2_sr`, in any unit; as for lights. An illuminant's name such as "D65", a
    table, a CSV file or { blackbody_k = ... }. Needs bands."""
    temperature_k: Kelvin | None = None
    """Temperature, in K, in place of a radiance: the surface emits by Planck's law. Its emissivity is 1 minus the share
    that it scatters of light from that direction, including gloss, metal and texture. In a room of its own temperature
    it looks like a black body. The black side of `sides = "front"` emits as a black body. Needs bands."""
    texture: FilePath | None = None
    """Picture, relative to the scene file: its linearised values multiply reflectance and radiance. Under `gloss` they
    multiply only the reflectance of the base. It reads correctly from outside the body. On a shape its top lies towards
    +y (towards ∓z on faces that look along ±y), and its right towards +x on the face towards the camera. Mesh files
    bring their own coordinates."""

    @property
    def emits(self) -> bool:
        """True if the surface emits light."""
        return self.temperature_k is not None or self.radiance_w_m2_sr != 0.0

    def faults(self) -> Iterator[Fault]:
        """Yield faults between fields."""
        yield from reflectance_fault(self.reflectance, ("reflectance",))
        if isinstance(self.radiance_w_m2_sr, Spectrum):
            if self.radiance_w_m2_sr.name is not None:
                name = self.radiance_w_m2_sr.name
                yield Fault(
                    ("radiance_w_m2_sr",),
                    name,
                    f'an illuminant has no absolute scale; give a number here, and spectrum = "{name}"',
                )
            if self.spectrum is not None:
                yield Fault(
                    ("spectrum",), None, "radiance_w_m2_sr is a spectrum already; omit it, or give a number there"
                )
        elif self.spectrum is not None and not self.radiance_w_m2_sr:
            yield Fault(("spectrum",), None, "omit it: the surface has no radiance_w_m2_sr")
        if self.temperature_k is not None and self.radiance_w_m2_sr != 0.0:
            yield Fault(("temperature_k",), self.temperature_k, "radiance_w_m2_sr is given too; give one of them")


class Target(BodyFile):
    """A body in front of the camera: a shape or a mesh file, in the world frame."""

    name: Text | None = None
    """Name of the target in reports."""
    shape: Shape | None = None
    """Primitive shape. Or give `file`."""
    materials: Literal["file", "colours", "ignore"] | None = None
    """Use of a mesh file's own materials: whole, base colours only, or none. "file": a glTF file's materials whole
    (base colour, metallic, roughness and alpha, with their pictures); the target then has no `material`. "colours":
    only their base colours and the pictures of these, which multiply the reflectance and radiance of `material`; a
    texture of `material` replaces them. "ignore": nothing. Omitted: "file" for glTF files without `material`, else
    "colours". Programs that show glTF files do the same."""
    normals: Literal["file", "facets"] = "file"
    """Normals that shade a mesh file's surface: those at its vertices, interpolated, or of its facets. "file": vertex
    normals, if the file has any (OBJ, PLY, GLB, glTF), which make a mesh look as smooth as intended. In both cases rays
    meet the facets, which also determine side and shadow."""
    scale: Positive | None = None
    """Factor on a mesh file's coordinates, in addition to its unit. Use 0.001 for a GLB file, defined in metres, that
    was written with numbers in millimetres. Omitted: 1."""
    anchor: Literal["origin", "centre", "base"] | None = None
    """Point of a mesh file that `position_mm` places: origin, or centre or base of its box. "origin": that of its
    coordinates. "centre": the centre of its bounding box. "base": the centre of the lowest side, towards -y, of the
    bounding box of the body as rotated by `rotation_deg`. Omitted: "origin"."""
    position_mm: Vector = (0.0, 0.0, 0.0)
    """Position of the target's own origin, or of its `anchor`, in mm."""
    rotation_deg: Vector = (0.0, 0.0, 0.0)
    """Rotations about x, then y, then z, in degrees."""
    material: Material = Field(default_factory=Material)
    """Material of the whole surface."""
    refractor: Refractor | None = None
    """Closed body of glass, in place of shape or file; it has no material."""
    motion: Motion | None = None
    """Motion during the exposure; needs `[exposure]`. Omitted: it stands still."""

    def faults(self) -> Iterator[Fault]:
        """Yield faults between fields."""
        if self.refractor is not None:
            if self.refractor.file is None:
                yield from self._placing_faults()
            for key in ("shape", *BodyFile.model_fields):
                if getattr(self, key) is not None:
                    yield Fault((key,), getattr(self, key), "a refractor is given too; give one of them")
            yield from self._file_faults("a refractor does not take it; omit it")
            if self.material != Material():
                yield Fault(("material",), None, "glass has no material: it only reflects and refracts; omit it")
            return
        if self.shape is not None and self.file is not None:
            yield Fault(("file",), self.file, "a shape is given too; give one of them")
        elif self.file is None:
            yield from self._placing_faults()
            if self.shape is None:
                yield Fault(("shape",), None, 'missing: give shape = { kind = ... }, or file = "...", or refractor')
            elif self.units is not None:
                yield Fault(("units",), self.units, "only for a mesh file; the sizes of a shape are in mm")
            if self.node is not None:
                yield Fault(("node",), self.node, "only for a GLB, glTF, STEP or 3MF file; omit it")
            if self.tolerance_mm is not None:
                yield Fault(("tolerance_mm",), self.tolerance_mm, "only for a STEP file; omit it")
            yield from self._file_faults("a shape takes its material from the scene and has its own normals")
        else:
            if self.materials == "file" and self.material != Material():
                yield Fault(("material",), None, 'materials = "file" takes those of the mesh file; omit one of them')
            yield from self.file_faults()

    def _placing_faults(self) -> Iterator[Fault]:
        """Yield coordinate keys of mesh files that are given without one."""
        for key in ("scale", "anchor"):
            if getattr(self, key) is not None:
                yield Fault((key,), getattr(self, key), "only for a mesh file: a shape is centred, its size in mm")

    def _file_faults(self, why: str) -> Iterator[Fault]:
        """Yield material and normal keys of mesh files that are given without one."""
        if self.materials is not None:
            yield Fault(("materials",), self.materials, f"only for a mesh file: {why}")
        if self.normals != "file":
            yield Fault(("normals",), self.normals, f"only for a mesh file: {why}")

    @property
    def takes_materials(self) -> bool:
        """True if a glTF file's materials are used whole."""
        return self.materials == "file" or (self.materials is None and self.material == Material())
