"""Conditions of use that lens files hold beside the lens: light, fields, and where object and image stand."""

import math
from dataclasses import dataclass, field

from lfmesh.optics.glass import D_LINE_NM
from lfmesh.scene.camera.lens import Lens
from lfmesh.scene.first_order.paraxial import Paraxial


@dataclass(frozen=True)
class FieldPoint:
    """A field point of the file: where it is, and how far its beam fills the pupil upwards and downwards."""

    x: float = 0.0
    y: float = 0.0
    upper: float = 1.0
    lower: float = 1.0


@dataclass(frozen=True)
class Conditions:
    """Conditions in which a file uses its lens.

    Attributes
    ----------
    wavelengths_nm : tuple of float
    primary : int
        Number of the primary wavelength, from 0.
    field_kind : str
        "angle" in degrees, "object" or "image": heights in mm.
    fields : tuple of FieldPoint
    object_mm : float
        Distance of the object before the first surface; inf where it counts as infinite.
    image_mm : float
        Distance of the image behind the last surface.
    """

    wavelengths_nm: tuple[float, ...] = (D_LINE_NM,)
    primary: int = 0
    field_kind: str = "angle"
    fields: tuple[FieldPoint, ...] = field(default_factory=lambda: (FieldPoint(),))
    object_mm: float = math.inf
    image_mm: float = 0.0

    @classmethod
    def usual(cls, lens: Lens) -> "Conditions":
        """Return the d line, the axis, the object at infinity and the image in its paraxial focus."""
        image_mm = Paraxial.of(lens, D_LINE_NM).bfl_mm
        return cls(image_mm=image_mm if math.isfinite(image_mm) else 0.0)
