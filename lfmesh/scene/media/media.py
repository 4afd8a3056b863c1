"""Media in front of the camera: flames, fog, smoke, flows that bend light."""

from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from lfmesh.scene.light.spectra import Coefficient, Kelvin, Radiance, Spectrum, coefficient_faults
from lfmesh.scene.light.spectra import Shape as SpectralShape
from lfmesh.scene.media.bending import INDEX_KEYS, FieldIndex, law_faults
from lfmesh.scene.media.phase import IsotropicPhase, Phase
from lfmesh.scene.model import Fault, Model, kind_of
from lfmesh.scene.motion import Motion
from lfmesh.scene.objects.refractor import BodyFile
from lfmesh.scene.objects.shapes import Box, Cylinder, Sphere
from lfmesh.scene.quantities import FilePath, NonNegative, Positive, Text, Vector

Quantity = Literal[
    "absorption_per_mm", "scattering_per_mm", "emission_w_mm3_sr", "temperature_k",
    "index", "density_kg_m3", "pressure_kpa",
]  # fmt: skip
"""A quantity that a grid may hold."""

NOT_A_BOX = "the bounds of a medium that bends light are a box or those of its grid; give it a box or a grid"


class MeshBounds(BodyFile):
    """A closed mesh, filled up to its flat facets."""

    kind: Literal["mesh"] = "mesh"
    """Kind of shape. Omitted: "mesh", beside `file`."""

    def faults(self) -> Iterator[Fault]:
        """Yield faults of the file's name and of its keys."""
        if self.file is None:
            yield Fault(("file",), None, "missing: a closed mesh (STL, OBJ, PLY, OFF, GLB, STEP)")
        else:
            yield from self.file_faults()


Bounds = Annotated[Box | Sphere | Cylinder | MeshBounds, Field(discriminator="kind")]


def _of_file(value: Any) -> Any:
    return {**value, "kind": kind_of(value)} if isinstance(value, dict) and "file" in value else value


AnyBounds = Annotated[Bounds, BeforeValidator(_of_file, json_schema_input_type=Bounds)]


class Grid(Model):
    """A voxel grid in a file."""

    file: FilePath
    """Grid file, relative to the scene file: `.npz`, `.npy` with one array, or VTK image data, `.vti`. Arrays [x, y, z]
    are named absorption_per_mm, scattering_per_mm, emission_w_mm3_sr, temperature_k, index, density_kg_m3 or
    pressure_kpa. A `.npz` file also has spacing_mm and, if the grid is not centred on the medium's origin, origin_mm
    (centre of voxel 0). A `.vti` file is in mm."""
    quantity: Quantity | None = None
    """Quantity in the array of a `.npy` file, or in the only array of a `.vti` file."""
    spacing_mm: tuple[Positive, Positive, Positive] | None = None
    """Distance between neighbouring voxels along x, y and z, in mm. Omitted: that of the file."""
    origin_mm: Vector | None = None
    """Centre of voxel [0, 0, 0] in the medium's own frame, in mm. Omitted: that of the file, else the grid is centred
    on the origin."""
    interpolation: Literal["trilinear", "constant"] = "trilinear"
    """Values between voxel centres: linear, or constant in each voxel. What sets the index follows cubic splines
    instead, whose gradient is continuous."""


def _of_path(value: Any) -> Any:
    return {"file": value} if isinstance(value, str) else value


AnyGrid = Annotated[Grid, BeforeValidator(_of_path, json_schema_input_type=str | Grid)]


class Medium(Model):
    """Gas, smoke, fog or dye that absorbs, scatters, emits or bends light. Overlapping media add up.

    It is in air, in the camera's object medium or, with `inside`, in one body of glass or liquid. All other bodies
    displace it. It bends light if it has one of `index`, `density_kg_m3`, and `temperature_k` with `pressure_kpa`, by a
    key or in its grid. Its bounds are then a box or those of its grid, and no two media that bend light overlap.
    """

    name: Text | None = None
    """Name of the medium in reports."""
    bounds: AnyBounds | None = None
    """Body that the medium fills, about its own origin: box, sphere, cylinder or closed mesh. Omitted: its grid, else
    the body it is inside, else all space. All space begins at the first lens vertex: the camera looks into it from its
    edge."""
    inside: Text | None = None
    """Body of glass or liquid around the medium, by its name in reports: "tanks[0] liquid", or a target with a
    refractor. Omitted: none."""
    grid: AnyGrid | None = None
    """Voxel grid of quantities that vary in space; other keys give the quantities that the grid lacks."""
    absorption_per_mm: Coefficient = 0.0
    """Absorption coefficient, in 1/mm; a number, or by wavelength."""
    scattering_per_mm: Coefficient = 0.0
    """Scattering coefficient, in 1/mm; a number, or by wavelength."""
    emission_w_mm3_sr: Radiance = 0.0
    """Emission of a cubic millimetre in each direction, in W/(mm³ sr). A number applies at each wavelength, or with
    bands to their whole range. By wavelength it is in W/(mm³ sr nm), which needs bands."""
    spectrum: SpectralShape | None = None
    """Spectrum of an emission given as a number or a grid, in any unit. Needs bands. Omitted: the same at all
    wavelengths."""
    temperature_k: Kelvin | None = None
    """Temperature, in K, in place of an emission: the medium emits the share of a black body's radiance that it
    absorbs, by Planck's and Kirchhoff's laws. Needs bands if it absorbs. With pressure_kpa it also sets the index."""
    index: FieldIndex | None = None
    """Refractive index relative to the scene's air: a number, or `{ kind = "radial_n", ... }`, a formula about the
    medium's own origin and z axis. Omitted: the medium does not bend light."""
    density_kg_m3: NonNegative | None = None
    """Density of a gas, in kg/m³, which sets the index by Gladstone and Dale's law."""
    gladstone_dale_m3_kg: Positive | None = None
    """Constant K of the law n - 1 = K times density, in m³/kg. Needs `density_kg_m3`. Omitted: that of dry air at each
    wavelength."""
    pressure_kpa: NonNegative | None = None
    """Pressure of dry air, in kPa, which sets the index together with the temperature. Needs `temperature_k`."""
    phase: Phase = Field(default_factory=IsotropicPhase)
    """Phase function: distribution of scattered light over directions."""
    position_mm: Vector = (0.0, 0.0, 0.0)
    """Position of the medium's own origin, in mm."""
    rotation_deg: Vector = (0.0, 0.0, 0.0)
    """Rotations about x, then y, then z, in degrees."""
    motion: Motion | None = None
    """Motion during the exposure; needs `[exposure]`. Omitted: that of the body it is
    inside, else it stands still."""

    def faults(self) -> Iterator[Fault]:
        """Yield faults between fields."""
        for key in ("absorption_per_mm", "scattering_per_mm"):
            yield from coefficient_faults(getattr(self, key), (key,))
        emission = self.emission_w_mm3_sr
        if isinstance(emission, Spectrum):
            if emission.name is not None:
                yield Fault(("emission_w_mm3_sr",), emission.name, "an illuminant has no absolute scale; give a "
                "number here, and the illuminant as spectrum")  # fmt: skip
            if self.spectrum is not None:
                yield Fault(("spectrum",), None, "emission_w_mm3_sr is a spectrum already; omit it")
        if self.temperature_k is not None:
            if emission != 0.0:
                yield Fault(("temperature_k",), self.temperature_k, "emission_w_mm3_sr is given too; give one of them")
            if self.absorption_per_mm == 0.0 and self.grid is None and self.pressure_kpa is None:
                yield Fault(("temperature_k",), self.temperature_k, "needs absorption_per_mm: a medium that absorbs "
                "nothing emits nothing; with pressure_kpa it bends light")  # fmt: skip
        yield from self._bending_faults()
        endless = self.bounds is None and self.grid is None and self.inside is None
        if endless and emission != 0.0 and self.absorption_per_mm == 0.0:
            yield Fault(("emission_w_mm3_sr",), None, "a medium without bounds that emits and absorbs nothing is "
                        "infinitely bright; give bounds, or absorption_per_mm")  # fmt: skip
        if self.grid is None and not (self.acts or self.bends or self.gladstone_dale_m3_kg):
            yield Fault((), None, "has no effect on light: give grid, absorption_per_mm, scattering_per_mm, "
                        "emission_w_mm3_sr, or index")  # fmt: skip

    def _bending_faults(self) -> Iterator[Fault]:
        """Yield keys that do not give one index, and bounds or bodies in which no light is bent."""
        keys = (*INDEX_KEYS, "gladstone_dale_m3_kg", "temperature_k")
        given = {key: value for key in keys if (value := getattr(self, key)) is not None}
        for key, why in law_faults(given, whole=self.grid is None):
            yield Fault((key,), given[key], why)
        if not self.bends:
            return
        if self.inside is not None:
            yield Fault(("inside",), self.inside, f"{self.bending_key} bends light in air or the object medium only; "
                        "omit it")  # fmt: skip
        elif self.bounds is None and self.grid is None:
            yield Fault(("bounds",), None, f"missing beside {self.bending_key}: {NOT_A_BOX}")
        elif self.bounds is not None and not isinstance(self.bounds, Box):
            yield Fault(("bounds",), self.bounds.kind, NOT_A_BOX)

    @property
    def may_emit(self) -> bool:
        """True if it emits light, or has a grid that may."""
        hot = self.temperature_k is not None and self.absorption_per_mm != 0.0
        return self.grid is not None or hot or self.emission_w_mm3_sr != 0.0

    @property
    def may_scatter(self) -> bool:
        """True if it scatters light, or has a grid that may."""
        return self.grid is not None or self.scattering_per_mm != 0.0

    @property
    def bending_key(self) -> str:
        """The key that sets its index; "" if none does."""
        return next((key for key in INDEX_KEYS if getattr(self, key) is not None), "")

    @property
    def bends(self) -> bool:
        """True if a key sets its index. A grid may do so too: see `geometry.index_media.bends`."""
        return self.bending_key != ""

    @property
    def acts(self) -> bool:
        """True if it absorbs, scatters or emits without a grid."""
        return bool(self.absorption_per_mm or self.scattering_per_mm or self.emission_w_mm3_sr)
