"""What becomes of a packet on its way from stack to stack."""

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.kernels.decorators import kernel
from lfmesh.transport.engine import Workspace
from lfmesh.transport.packets.packet import (
    DEPOSIT,
    END,
    LENS,
    NODE,
    PACKET,
    PLATE,
    POLARISED,
    POLARISED_END,
    STATIONS,
    TOPS,
    Flow,
    put,
)
from lfmesh.transport.settings import options_of
from tests.cameras import camera_without_array

GIVEN = {
    "x": 1.0, "y": 2.0, "z": 3.0, "dx": 0.0, "dy": 0.6, "dz": 0.8,
    "weight": 0.25, "key": 77, "query_from": 1e-3, "limit": 1e-3, "tries": 0, "frame": 2,
}  # fmt: skip
"""What `put` is given, or sets: a child asks Embree for the first time."""


@kernel
def put_child(flow, parents):
    put(flow, PLATE, parents[0], 2, 1.0, 2.0, 3.0, 0.0, 0.6, 0.8, 0.25, np.uint64(77), 1e-3)


def test_a_child_inherits_all_that_it_is_not_given():
    parents = np.zeros(1, PACKET)
    for number, name in enumerate(PACKET.names):
        parents[name] = number + 2
    flow = Flow(
        np.zeros(4 * STATIONS, PACKET), 4 * np.arange(STATIONS), np.zeros(TOPS, np.int64), np.zeros(1),
        np.zeros(1, np.int64), np.zeros((0, 1)), np.zeros((0, 1), np.uint32), np.zeros(0, np.uint8),
        np.zeros(0, DEPOSIT), np.zeros(0, END), np.zeros(0, NODE),
    )  # fmt: skip
    put_child(flow, parents)
    child = flow.stacks[flow.begins[PLATE]]
    given = GIVEN | {"moves": parents["moves"][0] + 1}
    for name in PACKET.names:
        assert child[name] == given.get(name, parents[name][0]), name
    assert flow.tops[PLATE] == 1
    assert flow.tops[LENS] == 0


CACHE_LINE = 64


@pytest.mark.parametrize(("polarisation", "records"), [(False, (PACKET, END)), (True, (POLARISED, POLARISED_END))])
def test_packets_have_a_state_only_where_the_scene_asks_for_it(polarisation, records):
    scene = lf.Scene(camera=camera_without_array(), transport={"polarisation": polarisation})
    world = lf.build(scene, aimed=False)
    work = Workspace(world, options_of(world), 1)
    assert (work.stacks.record, work.ended.dtype) == records
    assert work.template.dtype == records[0]
    assert (work.flow().polarised is not None) == polarisation
    assert PACKET.itemsize == 2 * CACHE_LINE
