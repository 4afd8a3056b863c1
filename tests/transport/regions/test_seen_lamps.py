"""Many lamps of the forward method share its packets by their light on what the camera sees, and none is left out."""

import numpy as np
import pytest

import lfmesh as lf
from tests.cameras import camera_without_array

FLOOR = {"shape": {"kind": "plane", "width_mm": 4000.0, "height_mm": 4000.0}, "position_mm": [0.0, 0.0, -150.0]}
HOT = {"shape": {"kind": "sphere", "radius_mm": 3.0}, "position_mm": [400.0, 0.0, -100.0],
       "material": {"reflectance": 0.0, "radiance_w_m2_sr": 5.0}}  # fmt: skip


def sources(count: int, method: str) -> np.ndarray:
    """Return the sources of a row of equal lamps over a wide floor; the camera sees what the first one lights."""
    lights = [{"kind": "point", "position_mm": [60.0 + 90.0 * i, 0.0, -130.0], "power_w": 1.0} for i in range(count)]
    scene = lf.Scene(camera=camera_without_array(), targets=[FLOOR, HOT], lights=lights, transport={"method": method})
    return lf.build(scene, aimed=False).tables.objects.sources


@pytest.mark.parametrize("count", [3, 20])
def test_many_lamps_start_packets_by_their_light_on_what_is_seen_and_few_by_their_power(count: int) -> None:
    forward, plain = sources(count, "forward"), sources(count, "adjoint")
    lamps = forward["light"] >= 0
    assert forward["until"][-1] == pytest.approx(1.0, rel=1e-12)
    np.testing.assert_allclose(np.cumsum(forward["share"]), forward["until"], rtol=1e-12)
    # What emits keeps its share, and no lamp has less than half of what its power gives it.
    np.testing.assert_array_equal(forward["share"][~lamps], plain["share"][~lamps])
    assert (forward["share"][lamps] >= 0.5 * plain["share"][lamps]).all()
    if count == 3:
        np.testing.assert_array_equal(forward, plain)
    else:
        share = forward["share"][lamps]
        assert share[0] > 5.0 * share[-1]
        assert (np.diff(share) < 0.0).all()
