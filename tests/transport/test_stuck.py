"""Nothing runs for ever: what moves on and on without an event is lost, and said to be."""

import numpy as np
import pytest
import trimesh

import lfmesh as lf
from lfmesh.transport.packets.packet import MOST_MOVES
from tests.cameras import camera_without_array


def sheets(path, count):
    """A mesh file of parallel sheets, 0.01 mm apart."""
    corners = np.array([[-9.0, -9.0, 0.0], [9.0, -9.0, 0.0], [0.0, 9.0, 0.0]])
    vertices = (corners + 0.01 * np.arange(count)[:, None, None] * [0.0, 0.0, 1.0]).reshape(-1, 3)
    trimesh.Trimesh(vertices, np.arange(3 * count).reshape(-1, 3), process=False).export(path)
    flat = {"file": str(path), "units": "mm", "normals": "facets"}
    return flat | {"position_mm": [0.0, 0.0, -200.0], "material": {"opacity": 0.0}}


@pytest.mark.parametrize("count", [MOST_MOVES // 8, MOST_MOVES + 8])
def test_a_ray_that_passes_more_sheets_than_it_may_move_is_lost_with_a_reason(tmp_path, count):
    world = lf.build(lf.Scene(camera=camera_without_array(), targets=[sheets(tmp_path / "sheets.ply", count)]))
    origin, ahead = [[0.0, 0.0, -250.0], [0.0, 0.0, -100.0]], [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]
    if count < MOST_MOVES:
        paths = lf.trace(world, origin, ahead, split="transmit")
        assert lf.Status.LOST not in paths.status
        assert paths.ledger.lost_share == 0.0
        return
    with pytest.warns(lf.LostEnergyWarning, match="the open"):
        paths = lf.trace(world, origin, ahead, split="transmit")
    assert (paths.status == lf.Status.LOST).all()
    assert paths.ledger.lost["stuck"] == pytest.approx(2.0)
    assert abs(paths.ledger.imbalance) < 1e-12
