"""Proof of the lens's ghosts: some of a run's own, followed along their sequences and traced through the meshes too.

The meshes are the model, and sequences in blocks (`sequential.lens_ghosts`) a shortcut. Each ray is traced surface by
surface through the meshes; of the two children at a surface the one that its sequence asks for goes on.
"""

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry import frame
from lfmesh.transport.engine import Workspace
from lfmesh.transport.packets.packet import (
    BOTH,
    CAMERA_FRAME,
    LENS,
    LENS_MESH,
    NO_SURFACE,
    OBJECT_FRAME,
    OBJECTS,
    WORLD_FRAME,
)
from lfmesh.transport.packets.path_class import EVERY
from lfmesh.transport.render.order_check import OrderCheck
from lfmesh.transport.sequential.lens_ghosts import GhostRoom, GhostTables, ghost_room
from lfmesh.transport.world import World

Array = NDArray[np.float64]


def compare_ghosts(world: World, work: Workspace, station: int) -> OrderCheck:
    """Follow packets from the sensor along sequences of the lens, in blocks and through meshes; compare both.

    Parameters
    ----------
    world : World
    work : Workspace
        Of the part of the image that follows the lens's ghosts. Its packets wait, before lens or array.
    station : int
        Where they wait.
    """
    ghosts = work.tables.ghosts
    count = int(work.tops[station])
    packets = work.stacks[work.rows[station], :count].copy()
    packets["source"] = np.arange(count)
    work.stacks[work.rows[station], :count] = packets
    work.advance(station)
    room = work.kept(GhostRoom, lambda: ghost_room(work.chunk, len(ghosts.lengths)))
    drawn = np.flatnonzero(room.sequence[:count] >= 0)
    rays, sequence = room.rays[:, drawn], room.sequence[drawn]
    found = work.stacks[work.rows[OBJECTS], : work.tops[OBJECTS]]
    move = work.tables.frames[OBJECT_FRAME, CAMERA_FRAME]
    of_block = np.searchsorted(drawn, found["source"])
    p, d = frame.points(move, _vectors(found, "")), frame.directions(move, _vectors(found, "d"))
    of_mesh, there = _through_meshes(world, work, packets[drawn], rays, sequence, ghosts)
    _, a, b = np.intersect1d(of_block, of_mesh, assume_unique=True, return_indices=True)
    length = float(np.max(work.tables.lens.box_high - work.tables.lens.box_low))
    apart = np.linalg.norm(p[a] - _vectors(there[b], ""), axis=1)
    turned = length * np.linalg.norm(d[a] - _vectors(there[b], "d"), axis=1)
    weights = np.abs(found["weight"][a] - there["weight"][b]) / rays[6, of_block[a]]
    return OrderCheck(
        compared=len(drawn),
        reflected=len(drawn),
        undecided=0,
        differing=len(np.setxor1d(of_block, of_mesh)),
        deviation_mm=float(np.maximum(apart, turned).max(initial=0.0)),
        deviation=float(weights.max(initial=0.0)),
    )


def _through_meshes(
    world: World, work: Workspace, packets: NDArray[np.void], rays: Array, sequence: NDArray[np.int64],
    ghosts: GhostTables,
) -> tuple[NDArray[np.int64], NDArray[np.void]]:  # fmt: skip
    """Trace rays behind the array (8, n) along their sequences; return which leave the lens, and their packets."""
    options = work.options._replace(
        tracing=True, sequential=False, in_order=False, split=BOTH, cutoff=0.0, paths=EVERY, importance=False
    )
    tables = work.tables._replace(ghosts=None)
    mesh = Workspace(world, options, len(packets), tables)
    mesh.begin(packets=len(packets))
    to_world = tables.frames[CAMERA_FRAME, WORLD_FRAME]
    p, d = frame.points(to_world, rays[:3].T), frame.directions(to_world, rays[3:6].T)
    for axis, name in enumerate("xyz"):
        packets[name], packets[f"d{name}"] = p[:, axis], d[:, axis]
    packets["source"], packets["weight"], packets["events"] = np.arange(len(packets)), rays[6], 0
    packets["frame"], packets["last"], packets["space"] = WORLD_FRAME, NO_SURFACE, len(tables.lens.surfaces)
    mesh.stacks[mesh.rows[LENS], : len(packets)] = packets
    mesh.tops[LENS] = len(packets)
    while mesh.tops[LENS] or mesh.tops[LENS_MESH]:
        for station in (LENS, LENS_MESH):
            waiting = mesh.stacks[mesh.rows[station], : mesh.tops[station]]
            kept = waiting[_on_sequence(waiting, sequence, ghosts)]
            waiting[: len(kept)] = kept
            mesh.tops[station] = len(kept)
            if len(kept):
                mesh.advance(station)
    out = mesh.stacks[mesh.rows[OBJECTS], : mesh.tops[OBJECTS]]
    out = out[out["events"] == ghosts.lengths[sequence[out["source"]]]]
    return out["source"].astype(np.int64), out


def _on_sequence(
    packets: NDArray[np.void], sequence: NDArray[np.int64], ghosts: GhostTables
) -> NDArray[np.bool_]:  # fmt: skip
    """Return which packets are where their sequence has led them; those that have met no surface yet are."""
    number = sequence[packets["source"]]
    step = packets["events"].astype(np.int64) - 1
    within = step < ghosts.lengths[number]
    at = np.clip(step, 0, ghosts.lengths[number] - 1)
    face = ghosts.faces[number, at]
    turns = np.cumsum(ghosts.reflected, axis=1)[number, at]
    # Towards the object but for what a first reflection has sent back.
    space = np.where(turns == 1, face + 1, face)
    return np.asarray((step < 0) | (within & (packets["last"] == face) & (packets["space"] == space)))


def _vectors(packets: NDArray[np.void], kind: str) -> Array:
    return np.stack([packets[kind + axis] for axis in "xyz"], axis=-1)
