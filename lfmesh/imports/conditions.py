"""Conditions of use in lens files: light, fields, and distances of object and image."""

import math
from dataclasses import dataclass, field

from lfmesh.optics.glass import D_LINE_NM
from lfmesh.scene.camera.lens import Lens
from lfmesh.scene.first_order.paraxial import Paraxial


@dataclass(frozen=True)
class FieldPoint:
    """Field point of a file, and how far its beam fills the pupil upwards and downwards."""

    x: float = 0.0
    y: float = 0.0
    upper: float = 1.0
    lower: float = 1.0


@dataclass(frozen=True)
class Conditions:
    """Conditions under which a file uses its lens.

    Attributes
    ----------
    wavelengths_nm : tuple of float
    primary : int
        Index of the primary wavelength.
    field_kind : str
        "angle" in degrees, "object" or "image": heights in mm.
    fields : tuple of FieldPoint
    object_mm : float
        Distance of the object before the first surface; inf if treated as infinite.
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
        """Return the d line, an on-axis object at infinity, and the image at the paraxial focus."""
        image_mm = Paraxial.of(lens, D_LINE_NM).bfl_mm
        return cls(image_mm=image_mm if math.isfinite(image_mm) else 0.0)
