"""Primitive shapes: of targets, of bodies of glass, and of what bounds media."""

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from lfmesh.scene.model import Model, kind_of
from lfmesh.scene.quantities import Positive


class Plane(Model):
    """A rectangle in its own xy plane, facing +z: towards the camera where it is not rotated.

    Seen from behind, its texture is mirrored.
    """

    kind: Literal["plane"] = "plane"
    """Kind of shape."""
    width_mm: Positive
    """Extent along x, in mm."""
    height_mm: Positive
    """Extent along y, in mm."""


class Disk(Model):
    """A disk in its own xy plane, facing +z. The square round it carries the texture, mirrored if seen from behind."""

    kind: Literal["disk"] = "disk"
    """Kind of shape."""
    radius_mm: Positive
    """Radius, in mm."""


class Sphere(Model):
    """A sphere. Its texture is an equirectangular map: centre towards +z, top towards +y."""

    kind: Literal["sphere"] = "sphere"
    """Kind of shape."""
    radius_mm: Positive
    """Radius, in mm."""


class Box(Model):
    """A box, centred, with its edges along x, y and z. Every face carries the whole texture."""

    kind: Literal["box"] = "box"
    """Kind of shape."""
    size_mm: tuple[Positive, Positive, Positive]
    """Lengths of the edges along x, y, z, in mm."""


class Cylinder(Model):
    """A closed cylinder, centred, with its axis along z; `rotation_deg = [90, 0, 0]` stands it up.

    Its ends carry the texture as disks do, its wall once round: middle towards +y, top towards -z, so that it faces the
    camera upright when the cylinder stands.
    """

    kind: Literal["cylinder"] = "cylinder"
    """Kind of shape."""
    radius_mm: Positive
    """Radius, in mm."""
    height_mm: Positive
    """Length along z, in mm."""


def _no_mesh(table: str) -> BeforeValidator:
    """Return a validator that refuses a mesh as a shape, and names the table that takes its file."""

    def refused(value: Any) -> Any:
        if isinstance(value, dict) and kind_of(value) == "mesh":
            raise ValueError(f'a mesh is no shape: write {table} file = "part.stl" in place of shape')
        return value

    return BeforeValidator(refused)


Shape = Annotated[Plane | Disk | Sphere | Box | Cylinder, Field(discriminator="kind"), _no_mesh("[[targets]]")]

Solid = Annotated[Sphere | Box | Cylinder, Field(discriminator="kind"), _no_mesh("[targets.refractor]")]
"""Shapes that are closed."""
