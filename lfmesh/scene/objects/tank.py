"""Tanks: boxes of windows and liquid in front of the camera."""

from collections.abc import Iterator
from typing import Literal

from lfmesh.scene.light.spectra import Coefficient, coefficient_faults
from lfmesh.scene.materials.matter import Matter
from lfmesh.scene.model import Fault, Model
from lfmesh.scene.motion import Motion
from lfmesh.scene.quantities import Positive, Text, Vector

Side = Literal["top", "front"]


class Wall(Matter):
    """Walls of a tank."""

    absorption_per_mm: Coefficient = 0.0
    """Absorption coefficient, in 1/mm; a number, or by wavelength."""

    def faults(self) -> Iterator[Fault]:
        """Yield faults between fields."""
        yield from super().faults()
        yield from coefficient_faults(self.absorption_per_mm, ("absorption_per_mm",))


class Liquid(Wall):
    """Liquid in a tank."""


class Tank(Model):
    """A box of flat windows, filled with a liquid; targets may stand in it."""

    name: Text | None = None
    """Name of the tank in reports."""
    size_mm: tuple[Positive, Positive, Positive]
    """Outer lengths along its own x, y, z, in mm."""
    wall_mm: Positive
    """Thickness of its walls, in mm."""
    wall: Wall
    """Material of the walls."""
    liquid: Liquid
    """Liquid inside the walls."""
    open: Side | None = None
    """Side without a wall: "top" is its own +y, "front" its own +z, towards the camera if the tank is not rotated.
    There the liquid extends to the end of the other walls. Omitted: closed."""
    position_mm: Vector = (0.0, 0.0, 0.0)
    """Position of its centre, in mm."""
    rotation_deg: Vector = (0.0, 0.0, 0.0)
    """Rotations about x, then y, then z, in degrees."""
    motion: Motion | None = None
    """Motion during the exposure; needs `[exposure]`. Omitted: it stands still."""

    def called(self, number: int) -> str:
        """Return the tank's name in reports, given its number.

        Parameters
        ----------
        number : int

        Returns
        -------
        str
        """
        return self.name or f"tanks[{number}]"

    def faults(self) -> Iterator[Fault]:
        """Yield faults between fields."""
        for axis, length in enumerate(self.size_mm):
            walls = 1 if OPEN_AXIS.get(self.open) == axis else 2
            if walls * self.wall_mm >= length * (1.0 - THINNEST):
                yield Fault(
                    ("wall_mm",),
                    self.wall_mm,
                    f"leaves no room for the liquid along {'xyz'[axis]}, where the tank is {length:g} mm long; give "
                    f"less than {length / walls:g}",
                )
                return


OPEN_AXIS: dict[Side | None, int] = {"top": 1, "front": 2}
"""Axis with the open side at its positive end."""

THINNEST = 1e-6
"""Smallest thickness of liquid between walls, relative to the tank's length."""
