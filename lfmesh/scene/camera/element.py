"""Elements of the main lens that stand off their places: rigid groups of surfaces with a pose."""

import math
from collections.abc import Iterator

from pydantic import Field

from lfmesh.scene.model import Fault, Model
from lfmesh.scene.pose import Pose
from lfmesh.scene.quantities import Whole

MOST_TILT_DEG = 45.0
"""Angle between the axis of a posed element and that of the lens, which a pose must stay below: light that comes along
the axis of the lens then still crosses the element's surfaces in their order."""


class Element(Model):
    """A rigid group of neighbouring surfaces that stands off its place in the prescription."""

    surfaces: tuple[Whole, ...]
    """Numbers of the surfaces, from 0, without a gap; the stop may be among them."""
    pose: Pose = Field(default_factory=Pose)
    """Rotation of the group about the vertex of its first surface, then a shift. First-order optics, and what is
    solved from it, stay those of the lens without poses."""

    def faults(self) -> Iterator[Fault]:
        """Yield what is wrong with this group by itself."""
        if not self.surfaces:
            yield Fault(("surfaces",), [], "must name one surface or more, such as [0, 1]")
            return
        first = self.surfaces[0]
        if list(self.surfaces) != list(range(first, first + len(self.surfaces))):
            yield Fault(
                ("surfaces",), list(self.surfaces), "must be neighbouring surfaces in their order, such as [0, 1]"
            )
        x, y, _ = (math.radians(angle) for angle in self.pose.tilt_deg)
        tilt = math.degrees(math.acos(max(-1.0, min(1.0, math.cos(x) * math.cos(y)))))
        if not tilt < MOST_TILT_DEG:
            yield Fault(
                ("pose", "tilt_deg"),
                list(self.pose.tilt_deg),
                f"inclines the axis by {tilt:.4g} degrees; it must stay below {MOST_TILT_DEG:g}",
            )
