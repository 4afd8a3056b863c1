"""Misaligned elements of the main lens: rigid groups of surfaces with a pose."""

import math
from collections.abc import Iterator

from pydantic import Field

from lfmesh.scene.model import Fault, Model
from lfmesh.scene.pose import Pose
from lfmesh.scene.quantities import Whole

MOST_TILT_DEG = 45.0
"""Upper limit on the tilt of a posed element's axis. Light along the lens's axis then still crosses the element's
surfaces in order."""


class Element(Model):
    """A rigid group of neighbouring surfaces that is displaced from the prescription."""

    surfaces: tuple[Whole, ...]
    """Numbers of consecutive surfaces, from 0; the stop may be among them."""
    pose: Pose = Field(default_factory=Pose)
    """Rotation of the group about its first vertex, then a shift. First-order optics, and distances solved from it,
    ignore poses."""

    def faults(self) -> Iterator[Fault]:
        """Yield faults of this group on its own."""
        if not self.surfaces:
            yield Fault(("surfaces",), [], "must name at least one surface, such as [0, 1]")
            return
        first = self.surfaces[0]
        if list(self.surfaces) != list(range(first, first + len(self.surfaces))):
            yield Fault(("surfaces",), list(self.surfaces), "must be adjacent surfaces in order, such as [0, 1]")
        x, y, _ = (math.radians(angle) for angle in self.pose.tilt_deg)
        tilt = math.degrees(math.acos(max(-1.0, min(1.0, math.cos(x) * math.cos(y)))))
        if not tilt < MOST_TILT_DEG:
            yield Fault(
                ("pose", "tilt_deg"),
                list(self.pose.tilt_deg),
                f"tilts the axis by {tilt:.4g} degrees; it must stay below {MOST_TILT_DEG:g}",
            )
