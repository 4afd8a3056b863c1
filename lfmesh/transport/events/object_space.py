"""Data of object space for its kernels."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.transport.packets.packet import Flow, Options
from lfmesh.transport.tables.tables import LensAim, ObjectTables


class ObjectSpace(NamedTuple):
    """Settings, tables and memory of the kernels of object space.

    Attributes
    ----------
    options : Options
    flow : Flow
    frames : (6, 6, 3, 4) float64
    objects : ObjectTables
    aim : LensAim
    """

    options: Options
    flow: Flow
    frames: NDArray[np.float64]
    objects: ObjectTables
    aim: LensAim
