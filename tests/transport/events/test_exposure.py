"""Times of packets from lights, and their weights in the windows of rows."""

from typing import Any

import numpy as np
import pytest

from lfmesh.geometry.frame import IDENTITY
from lfmesh.geometry.rigid_motion import resting
from lfmesh.kernels.decorators import kernel
from lfmesh.scene.motion import Exposure
from lfmesh.transport.events.exposure import drawn_time, share_of_time
from lfmesh.transport.packets.packet import PACKET, Options, Thinning
from lfmesh.transport.tables.motions import Motions

COUNT = 1 << 15

FLASH = {"shutter": [[0.0, 1.0], [1e-5, 1.0], [1.001e-5, 0.0], [0.01, 0.0]]}
RISE = {"shutter": [[0.0, 0.0], [0.01, 1.0]]}

CASES: dict[str, dict[str, Any]] = {
    "one window": {},
    "a flash": FLASH,
    "a rolling shutter": {"row_time_s": 1e-3},
    "from below": {"row_time_s": 1e-3, "row_direction": "up"},
    "windows apart": {"row_time_s": 0.05},
    "rolling and rising": {"row_time_s": 1e-4} | RISE,
    "a rolling flash": {"row_time_s": 1e-4} | FLASH,
}


@kernel
def _draw(motions: Motions, options: Options, packets: Any, times: Any) -> None:
    for i in range(len(packets)):
        times[i] = drawn_time(motions, options, packets[i])


def drawn(keys: dict[str, Any], rows: int) -> tuple[np.ndarray, np.ndarray, Motions]:
    """Return times of packets from lights, and their weights in the windows of rows, (rows, n)."""
    exposure = Exposure(duration_s=0.01, **keys)
    begin_s, duration_s, end_s = exposure.windows(rows)
    none = np.zeros(0, np.int64)
    frames = np.broadcast_to(IDENTITY, (6, 6, 3, 4)).copy()
    motions = Motions(
        resting(), np.array([0, 1]), none, none, none, 0, np.zeros((1, 4)), begin_s, duration_s, end_s,
        exposure.shutter_table(), False, frames,
    )  # fmt: skip
    options = Options(
        0, 0, Thinning(0, 0.0, 0.0), 5, adjoint=False, tracing=False, record=False, bounce=True, aimed=True, paths=0,
        importance=False, still=False, stream=np.uint64(5),
    )  # fmt: skip
    packets, times = np.zeros(COUNT, PACKET), np.zeros(COUNT)
    packets["source"] = np.arange(COUNT)
    _draw(motions, options, packets, times)
    return times, np.array([[share_of_time(motions, row, t) for t in times] for row in range(rows)]), motions


@pytest.mark.parametrize("keys", CASES.values(), ids=CASES)
def test_weighted_times_are_those_that_a_row_sees(keys: dict[str, Any]) -> None:
    """Weights have the mean 1, and weighted times the mean of the shutter's opening; times are spread evenly."""
    times, weights, motions = drawn(keys, 8)
    knots, opening, integral = motions.shutter
    parts = np.diff(knots) * (opening[:-1] * (2 * knots[:-1] + knots[1:]) + opening[1:] * (knots[:-1] + 2 * knots[1:]))
    centre = parts.sum() / (6.0 * integral[-1])
    for row in range(8):
        # The begin of an interval is cut off by at most the spacing of stratified times.
        assert abs(weights[row].mean() - 1.0) < 20.0 * weights[row].max() / COUNT
        mean = (weights[row] * (times - motions.begin_s[row])).mean()
        assert abs(mean - centre) < 20.0 * weights[row].max() / COUNT * 0.01


@pytest.mark.parametrize("keys", [{}, FLASH, RISE], ids=["open", "a flash", "rising"])
def test_with_one_window_for_all_rows_packets_keep_their_weight(keys: dict[str, Any]) -> None:
    _, weights, _ = drawn(keys, 3)
    np.testing.assert_allclose(weights, 1.0, rtol=1e-9)


def test_a_rolling_flash_wastes_half_of_the_packets_at_most() -> None:
    """With uniform times one packet in a thousand would see a flash of one row."""
    _, weights, _ = drawn(CASES["a rolling flash"], 8)
    assert (weights.max(axis=0) > 0.0).mean() > 0.49
