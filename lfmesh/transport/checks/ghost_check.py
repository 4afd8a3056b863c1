"""Proof of the ghosts: some of a run's own, followed along their sequences and traced through the meshes.

The meshes are the model; sequences in blocks (`sequences.ghosts`) are a shortcut. Each packet is traced from its pixel
through the meshes; at each face the child that continues the sequence goes on. Its path state identifies it, which also
proves that the classes of paths agree with the sequences.
"""

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry import frame
from lfmesh.transport.checks.order_check import OrderCheck
from lfmesh.transport.engine import Workspace
from lfmesh.transport.packets.packet import BOTH, BY_MESH, CAMERA_FRAME, OBJECT_FRAME, OBJECTS, STATIONS, Thinning
from lfmesh.transport.paths.automaton import EVERY, ON_IMAGE_PATH, REFLECTED_ONCE, REFLECTED_TWICE
from lfmesh.transport.sequences.ghosts import GhostRoom, GhostTables, ghost_room
from lfmesh.transport.world import World

Array = NDArray[np.float64]


def compare_ghosts(world: World, work: Workspace) -> OrderCheck | None:
    """Follow packets along sequences of faces, in blocks and through meshes; compare both. None if no packet waits.

    Parameters
    ----------
    world : World
    work : Workspace
        Of the image's ghosts. Its packets have left their pixels and wait at one station.
    """
    station = int(np.argmax(work.tops[:STATIONS]))
    count = int(work.tops[station])
    if count == 0:
        return None
    ghosts = work.tables.ghosts
    packets = work.stacks.waiting(station).copy()
    packets["source"] = np.arange(count)
    work.stacks.queue(station, packets)
    work.advance(station)
    room = work.kept(GhostRoom, lambda: ghost_room(work.chunk, len(ghosts.lengths)))
    drawn = np.flatnonzero(room.sequence[:count] >= 0)
    sequence = room.sequence[drawn]
    packets = packets[drawn]
    packets["weight"] /= room.chance[drawn]
    # Some have left their pixels in new directions, with weights that belong to these.
    anew = ghosts.anew[sequence]
    for name, row in zip(("x", "y", "z", "dx", "dy", "dz", "weight"), room.rays, strict=False):
        packets[name][anew] = row[drawn[anew]]
    packets["frame"][anew] = CAMERA_FRAME
    found = work.stacks.waiting(OBJECTS)
    move = work.tables.frames[OBJECT_FRAME, CAMERA_FRAME]
    of_block = np.searchsorted(drawn, found["source"])
    p, d = frame.points(move, _vectors(found, "")), frame.directions(move, _vectors(found, "d"))
    of_mesh, there = _through_meshes(world, work, packets, station, sequence, ghosts)
    _, a, b = np.intersect1d(of_block, of_mesh, assume_unique=True, return_indices=True)
    length = float(np.max(work.tables.lens.box_high - work.tables.lens.box_low))
    apart = np.linalg.norm(p[a] - _vectors(there[b], ""), axis=1)
    turned = length * np.linalg.norm(d[a] - _vectors(there[b], "d"), axis=1)
    weights = np.abs(found["weight"][a] - there["weight"][b]) / packets["weight"][of_block[a]]
    return OrderCheck(
        compared=len(drawn),
        reflected=len(drawn),
        undecided=0,
        differing=len(np.setxor1d(of_block, of_mesh)),
        deviation_mm=float(np.maximum(apart, turned).max(initial=0.0)),
        deviation=float(weights.max(initial=0.0)),
    )


def _through_meshes(
    world: World, work: Workspace, packets: NDArray[np.void], station: int, sequence: NDArray[np.int64],
    ghosts: GhostTables,
) -> tuple[NDArray[np.int64], NDArray[np.void]]:  # fmt: skip
    """Trace packets along their sequences; return the numbers and the records of the packets that leave the lens.

    Their places and directions are in the camera frame.
    """
    options = work.options._replace(tracing=True, faces=BY_MESH, thinning=Thinning(BOTH, 0.0, 0.0), paths=EVERY)
    mesh = Workspace(world, options, max(len(packets), 1), work.tables._replace(ghosts=None))
    mesh.begin(packets=len(packets))
    packets["source"] = np.arange(len(packets))
    mesh.stacks.queue(station, packets)
    turns = _reflections(ghosts)[sequence]
    inside = np.array([each for each in range(STATIONS) if each != OBJECTS])
    while mesh.tops[inside].any():
        for each in inside:
            waiting = mesh.stacks.waiting(each)
            kept = waiting[_on_sequence(waiting, turns)]
            waiting[: len(kept)] = kept
            mesh.tops[each] = len(kept)
            if len(kept):
                mesh.advance(int(each))
    out = mesh.stacks.waiting(OBJECTS)
    out = out[_on_sequence(out, turns) & (out["events"] == ghosts.lengths[sequence[out["source"]]])]
    return out["source"].astype(np.int64), out


def _reflections(ghosts: GhostTables) -> NDArray[np.int64]:
    """Return the number of faces up to the first and the second reflection of each sequence, (sequences, 2)."""
    turns = []
    for number, length in enumerate(ghosts.lengths):
        legs = ghosts.route.legs[ghosts.first[number] : ghosts.first[number + 1]]
        reflected = ghosts.route.steps[legs[0, 1] : legs[-1, 2], 1]
        turns.append(1 + np.flatnonzero(reflected) + length - len(reflected))
    return np.array(turns)


def _on_sequence(packets: NDArray[np.void], turns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which packets have been reflected at the faces of their sequence, and at no other."""
    times = (packets["events"][:, None] >= turns[packets["source"]]).sum(axis=1)
    return np.asarray(packets["path"] == np.array([ON_IMAGE_PATH, REFLECTED_ONCE, REFLECTED_TWICE])[times])


def _vectors(packets: NDArray[np.void], kind: str) -> Array:
    return np.stack([packets[kind + axis] for axis in "xyz"], axis=-1)
