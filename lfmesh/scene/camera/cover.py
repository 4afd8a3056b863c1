"""The sensor's cover glass: a plane-parallel plate in front of the pixels."""

from collections.abc import Iterator

from lfmesh.optics.glass import Medium
from lfmesh.scene.materials.coatings import UNCOATED
from lfmesh.scene.materials.own_glass import Glass
from lfmesh.scene.model import Fault, Model
from lfmesh.scene.quantities import Index, Positive, Text


class Cover(Model):
    """A glass plate parallel to the sensor, with the image medium or air on both sides.

    It tilts with the sensor and is unbounded.
    """

    thickness_mm: Positive
    """Thickness, in mm."""
    gap_mm: Positive
    """Distance from the plate to the sensor, in mm."""
    index: Index | None = None
    """Refractive index of the plate. Or give `glass`."""
    glass: Glass | None = None
    """Glass of the plate: a catalogue name such as "SCHOTT/N-BK7", or a dispersion such as { nd = 1.5168,
    vd = 64.17 }."""
    coating: Text = UNCOATED
    """Name of the coating of both faces, or "none": bare."""

    @property
    def medium(self) -> Medium:
        """Material of the plate: an index or a glass."""
        return self.index if self.index is not None else self.glass or 1.0

    @property
    def height_mm(self) -> float:
        """Distance from the sensor to the plate's far face."""
        return self.gap_mm + self.thickness_mm

    def faults(self) -> Iterator[Fault]:
        """Yield faults between fields."""
        if self.index is None and self.glass is None:
            yield Fault(("index",), None, "missing: give the cover's index, or glass")
        elif self.index is not None and self.glass is not None:
            yield Fault(("glass",), self.glass, f"index = {self.index:g} is given too; give one of them")
