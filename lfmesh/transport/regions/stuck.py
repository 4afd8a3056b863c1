"""End of packets that move on without an event and would otherwise never stop."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.events.crossing import lose
from lfmesh.transport.events.moving import begin
from lfmesh.transport.packets.book import LOST_AT_SENSOR, LOST_IN_MLA, LOST_OUTSIDE, LOST_STUCK
from lfmesh.transport.packets.packet import (
    BACK_FRAME,
    CAMERA_FRAME,
    MLA_FRAME,
    SENSOR_FRAME,
    SHADOW,
    Flow,
    Options,
)


@kernel
def lose_stuck(
    wave: NDArray[np.void], lost_in_lens: NDArray[np.int64], frames: NDArray[np.float64], options: Options, flow: Flow
) -> None:
    """End the packets of a wave as lost, except shadow packets, which carry no energy of their own.

    Parameters
    ----------
    wave : (n,) PACKET
    lost_in_lens : (K + 1,) int64
        Slots of the book for each space of the lens.
    frames : (6, 6, 3, 4) float64
    options : Options
    flow : Flow
    """
    for i in range(len(wave)):
        packet = wave[i]
        begin(flow.moving, options, packet)
        if packet.kind != SHADOW:
            lose(options, flow, frames, packet, LOST_STUCK, _body_of(packet, lost_in_lens))


@inlined
def _body_of(packet: Any, lost_in_lens: NDArray[np.int64]) -> int:
    """Return the slot for energy lost in the body that holds a packet, by the frame of its ray."""
    if packet.frame == CAMERA_FRAME:
        return int(lost_in_lens[packet.space])
    if packet.frame == MLA_FRAME or packet.frame == BACK_FRAME:
        return LOST_IN_MLA
    return LOST_AT_SENSOR if packet.frame == SENSOR_FRAME else LOST_OUTSIDE
