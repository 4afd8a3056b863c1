"""Lenslets on the second face of the array's plate."""

import math
from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from lfmesh.scene.camera.lenslet_depth import cell_corner_mm, highest_and_deepest_mm, profile_words
from lfmesh.scene.camera.qcon import MOST_ASPHERE_TERMS
from lfmesh.scene.literals import at_least
from lfmesh.scene.model import Fault, Model
from lfmesh.scene.quantities import Coefficient, Number, Radius


class BackFace(Model):
    """Shape of the lenslets on the second face, all alike, each opposite a lenslet of the first."""

    radius_mm: Radius
    """Radius of the lenslets, in mm: positive bulges out of the plate and converges; inf is flat."""
    conic: Number = 0.0
    """Conic constant: 0 sphere, −1 paraboloid, below −1 hyperboloid."""
    asphere_mm: Annotated[tuple[Coefficient, ...], Field(max_length=MOST_ASPHERE_TERMS)] = ()
    """Even aspheric coefficients of r⁴, r⁶, ..., in mm⁻³, mm⁻⁵, ..., positive into the glass."""
    cylinder_axis: Literal["x", "y"] | None = None
    """Axis of cylindrical lenslets: "y" along the columns, "x" along the rows of a square layout. It may differ from
    that of the first face. Omitted: surfaces of revolution."""
    decenter_mm: tuple[Number, Number] = (0.0, 0.0)
    """Shift of the whole face in x and y relative to the first one, in mm: a manufacturing error, at most half a
    pitch."""

    @property
    def is_flat(self) -> bool:
        """True if the face is a plane."""
        return math.isinf(self.radius_mm) and not any(self.asphere_mm)

    @property
    def profile_words(self) -> str:
        """Shape of non-spherical lenslets, such as "aspheres" or "cylinders along y", else ""."""
        return profile_words((self.conic,), (self.asphere_mm,), self.cylinder_axis)

    def faults_in(
        self, layout: str, pitch_mm: float, thickness_mm: float, front_depth_mm: float | None
    ) -> Iterator[Fault]:  # fmt: skip
        """Yield faults of the face on a plate, with paths from the array.

        Parameters
        ----------
        layout : str
        pitch_mm, thickness_mm : float
        front_depth_mm : float or None
            Depth of the first face in the plate; None if that face has a fault of its own.

        Returns
        -------
        iterator of Fault
        """
        if self.cylinder_axis is not None and layout != "square":
            yield Fault(("back", "cylinder_axis"), self.cylinder_axis, 'cylinders need layout = "square"')
            return
        if max(map(abs, self.decenter_mm)) > pitch_mm / 2:
            why = f"must be at most half the pitch, {pitch_mm / 2:g} mm, in x and y; beyond, it faces the next lenslet"
            yield Fault(("back", "decenter_mm"), list(self.decenter_mm), why)
        corner = cell_corner_mm(pitch_mm, layout, self.cylinder_axis)
        if (1 + self.conic) * corner**2 >= self.radius_mm**2:
            reach = abs(self.radius_mm) / math.sqrt(1 + self.conic)
            why = (
                f"the lenslets end {reach:.6g} mm from the axis, before the corner of their cells, {corner:.6g} mm "
                "from it: give a larger radius or a smaller pitch_mm"
            )
            yield Fault(("back", "radius_mm"), self.radius_mm, why)
            return
        high, deep = highest_and_deepest_mm(self.radius_mm, self.conic, self.asphere_mm, corner)
        if not high <= pitch_mm:
            why = (
                f"the face rises up to {high:.6g} mm over its apexes, more than pitch_mm = {pitch_mm:g}: give a larger "
                "radius or smaller coefficients"
            )
            yield Fault(("back", "radius_mm"), self.radius_mm, why)
        elif front_depth_mm is not None and not deep + front_depth_mm < thickness_mm:
            why = (
                f"at the edges of its cells this face is {deep:.6g} mm deep and the curved face {front_depth_mm:.6g} "
                f"mm, so they meet inside the plate: give thickness_mm {at_least(deep + front_depth_mm)} or more, or "
                "larger radii"
            )
            yield Fault(("back", "radius_mm"), self.radius_mm, why)
