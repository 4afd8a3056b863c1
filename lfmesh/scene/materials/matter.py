"""Homogeneous matter: a plain refractive index, or a glass or liquid by catalogue name or dispersion."""

from collections.abc import Iterator

from lfmesh.optics.glass import AIR, Medium
from lfmesh.scene.materials.own_glass import Glass
from lfmesh.scene.model import Fault, Model
from lfmesh.scene.quantities import Index


class Matter(Model):
    """A refractive index, or a material that has one."""

    index: Index | None = None
    """Refractive index. Or give `glass`."""
    glass: Glass | None = None
    """Glass or liquid: a catalogue name such as "main/H2O/Daimon-20.0C", or a dispersion such as { nd = 1.5168, vd =
    64.17 }."""

    @property
    def medium(self) -> Medium:
        """An index or a glass; None for an index of 1 (air)."""
        return self.glass if self.index is None else None if self.index == AIR else self.index

    def faults(self) -> Iterator[Fault]:
        """Yield faults between fields."""
        if self.index is None and self.glass is None:
            yield Fault(("index",), None, "missing: give the index, or glass")
        elif self.index is not None and self.glass is not None:
            yield Fault(("glass",), self.glass, f"index = {self.index:g} is given too; give one of them")
