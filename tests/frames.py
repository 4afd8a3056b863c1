"""Rigid motions between the frames of a built camera and the world, for tests that look at rays in either."""

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lfmesh.transport.packets.packet import CAMERA_FRAME, MLA_FRAME, SENSOR_FRAME, WORLD_FRAME

Frame = Literal["camera", "array", "sensor", "world"]

_NUMBERS = {"camera": CAMERA_FRAME, "array": MLA_FRAME, "sensor": SENSOR_FRAME, "world": WORLD_FRAME}


def motion(world: Any, of: Frame, to: Frame) -> NDArray[np.float64]:
    """Return the rotation and the shift, mm, that take coordinates in one frame to those in another, (3, 4)."""
    return np.asarray(world.tables.frames[_NUMBERS[of], _NUMBERS[to]])
