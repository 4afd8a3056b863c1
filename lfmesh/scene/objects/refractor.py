"""Bodies of glass: an element of the lens from a mesh file, or a body in front of the camera."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from lfmesh.optics.glass import Medium
from lfmesh.scene.light.spectra import Coefficient, coefficient_faults
from lfmesh.scene.materials.coatings import UNCOATED
from lfmesh.scene.materials.finishes import POLISHED, AnyFinish, both_given
from lfmesh.scene.materials.own_glass import Glass
from lfmesh.scene.model import Fault, Model, nearest
from lfmesh.scene.objects.shapes import Box, Cylinder, Solid, Sphere
from lfmesh.scene.quantities import FilePath, Index, NodeKey, Positive, Text

STEP_ENDINGS = (".step", ".stp")
NODE_ENDINGS = (".glb", ".gltf", *STEP_ENDINGS, ".3mf")
"""Formats with named bodies; either the standard fixes the unit of length or the file names it."""
UNITS_MISSING = (".stl", ".obj", ".ply", ".off")
"""Formats without a unit of length."""

WAYS_IN = dict.fromkeys(
    (".iges", ".igs"),
    "is not read: export it from the CAD program as STEP, or as a finely tessellated STL or GLB",
)
"""Advice for other CAD formats."""

Units = Literal["um", "mm", "cm", "m", "inch", "foot"]
FacetLevel = Literal["flat", "smooth", "patch"]
FaceLevel = Literal["flat", "smooth", "patch", "exact"]
Priority = Annotated[int, Field(strict=True, ge=-1000, le=1000)]
CreaseAngle = Annotated[float, Field(strict=True, gt=0, lt=180)]


class BodyFile(Model):
    """Body of a mesh file, and the tessellation of a STEP file's curved faces."""

    file: FilePath | None = None
    """Mesh file (STL, OBJ, PLY, OFF, GLB, glTF, STEP, 3MF), relative to the scene file."""
    node: NodeKey | None = None
    """One object of a GLB, glTF, STEP or 3MF file: name of the node or body, or number of one without a name. It stays
    where the file places it; child nodes are left out. Omitted: all of the file."""
    units: Units | None = None
    """Unit of length of the mesh file. Omitted: that of the file; STL, OBJ, PLY and OFF files have none."""
    tolerance_mm: Positive | None = None
    """Largest distance of a STEP file's facets from their surface, in mm. Omitted: 3e-4 of the largest body's
    diagonal."""

    def file_faults(self) -> Iterator[Fault]:
        """Yield faults of the mesh file's name and of its keys.

        Returns
        -------
        iterator of Fault
        """
        file = str(self.file)
        ending = Path(file).suffix.lower()
        known = (*UNITS_MISSING, *NODE_ENDINGS)
        if ending not in known:
            if ending in WAYS_IN:
                yield Fault(("file",), file, f"{WAYS_IN[ending]}; must end in one of {', '.join(known)}")
                return
            yield Fault(("file",), file, f"must end in one of {', '.join(known)}{nearest(ending, known)}")
            return
        if self.units is None and ending in UNITS_MISSING:
            yield Fault(("units",), None, f'missing: {ending[1:].upper()} files carry no unit; give units, e.g. "mm"')
        if self.node is not None and ending not in NODE_ENDINGS:
            yield Fault(("node",), self.node, f"omit it: only {', '.join(NODE_ENDINGS)} files have named bodies")
        if self.tolerance_mm is not None and ending not in STEP_ENDINGS:
            yield Fault(("tolerance_mm",), self.tolerance_mm, "omit it: only the faces of STEP files are curved")


class MeshShape(BodyFile):
    """The mesh that gives glass its shape."""

    surface: FaceLevel = "exact"
    """Surface behind a facet: flat, flat with smooth normals, a curved patch, or the exact surface of a lens face.
    "exact": a recognised face of a lens element is traced as its exact surface, and every other facet as a patch."""
    crease_deg: CreaseAngle | None = None
    """Angle above which facets meet at an edge of the body, in degrees. Below it they meet on a smooth surface with
    estimated normals. Omitted: as the file's vertex normals say, else estimated. The estimate is a few times the
    typical angle between the mesh's curved facets."""

    @property
    def facets(self) -> FacetLevel:
        """Meaning of facets without a recognised exact surface."""
        return "patch" if self.surface == "exact" else self.surface

    def faults(self) -> Iterator[Fault]:
        """Yield faults between fields."""
        if self.file is None:
            yield Fault(
                ("file",), None, "missing: a mesh file (STL, OBJ, PLY, OFF, GLB, STEP), relative to the scene file"
            )
        else:
            yield from self.file_faults()


class Refractor(MeshShape):
    """A closed body of glass, its shape a mesh or, in object space, a sphere, box or cylinder."""

    shape: Solid | None = None
    """Sphere, box or cylinder, as of targets, in object space. Or give `file`."""
    box_mm: tuple[Positive, Positive, Positive] | None = None
    """Edges of a box along x, y, z, in mm, centred, in object space. Or give `shape` or `file`."""
    index: Index | None = None
    """Refractive index. Or give `glass`."""
    glass: Glass | None = None
    """Glass: a catalogue name such as "SCHOTT/N-BK7", or a dispersion such as { nd = 1.5168, vd = 64.17 }."""
    absorption_per_mm: Coefficient = 0.0
    """Absorption coefficient in object space, in 1/mm; a number, or by wavelength."""
    coating: Text = UNCOATED
    """Name of the coating of its whole surface, or "none": bare."""
    finish: AnyFinish = POLISHED
    """Finish of its whole surface: "polished", "diffuse" or { kind = "ground", roughness = 0.1 }."""
    priority: Priority = 0
    """Rank where bodies in object space overlap: the highest prevails; of equal ones, the inner. Water that overlaps
    slightly with the surrounding glass thus touches it everywhere."""

    @property
    def medium(self) -> Medium:
        """Material of the body: an index or a glass."""
        return self.index if self.index is not None else self.glass or 1.0

    @property
    def solid(self) -> Sphere | Box | Cylinder | None:
        """Primitive shape of the body; None where a mesh file has it."""
        return Box(size_mm=self.box_mm) if self.box_mm is not None else self.shape

    @property
    def level(self) -> FacetLevel:
        """Meaning of its facets; those of a primitive shape are flat."""
        return self.facets if self.solid is None else "flat"

    def faults(self) -> Iterator[Fault]:
        """Yield what is wrong between the fields."""
        if self.solid is None:
            yield from super().faults()
        else:
            yield from self._solid_faults("box_mm" if self.shape is None else "shape")
        if self.index is None and self.glass is None:
            yield Fault(("index",), None, "missing: give the index of the glass, or glass")
        elif self.index is not None and self.glass is not None:
            yield Fault(("glass",), self.glass, f"index = {self.index:g} is given too; give one of them")
        yield from coefficient_faults(self.absorption_per_mm, ("absorption_per_mm",))
        yield from both_given(self.coating, self.finish, "finish")

    def _solid_faults(self, given: str) -> Iterator[Fault]:
        """Yield keys that stand beside a primitive shape, which the key `given` gives, and mean nothing there."""
        if self.shape is not None and self.box_mm is not None:
            yield Fault(("box_mm",), self.box_mm, "shape is given too; give one of them")
        for key in MeshShape.model_fields:
            value = getattr(self, key)
            if value == MeshShape.model_fields[key].default:
                continue
            if key != "surface" or self.shape is None:
                yield Fault((key,), value, f"{given} is given too; omit it, or give a mesh file")
            elif value != "flat":
                yield Fault((key,), value, 'a shape is exact, or has flat facets: omit it, or give "flat"')


class MeshFace(MeshShape):
    """One optical face of a mesh body; the lens axis is the mesh's z axis."""

    side: Literal["front", "back"]
    """Face that the axis meets first, coming from the objects, or last."""
