"""Probe rays from the pixels through lens and glass, to find the directions in which object space sees the lens.

They take the image path through the camera; at glass, chance decides between reflection and refraction. Media that bend
light count as glass. Light scattered back along a probe reaches the sensor, from its hit on a target and from a random
point on its way through a medium or past particles.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry import frame
from lfmesh.kernels.decorators import kernel
from lfmesh.transport.aims.mixture import WIDE_SHARE_OF_IMAGE_PATH, with_wide_share
from lfmesh.transport.choice import obstacle_of
from lfmesh.transport.engine import CHUNK, Workspace
from lfmesh.transport.events.moving import point_between, start_in_mover
from lfmesh.transport.packets.packet import (
    BY_ORDER,
    CAMERA_FRAME,
    IN_FIELD,
    NO_SURFACE,
    OBJECT_FRAME,
    OBJECTS,
    ON_GLASS,
    ROULETTE,
    S_ABSORBED,
    S_ESCAPED,
    S_TARGET,
    STATIONS,
    TRANSMIT,
    WORLD_FRAME,
    Event,
    Options,
)
from lfmesh.transport.render.tally import Film
from lfmesh.transport.settings import options_of
from lfmesh.transport.sources.pixels import PixelSource
from lfmesh.transport.tables.bending_fields import crossed_at_once
from lfmesh.transport.tables.lines import Nodes
from lfmesh.transport.tables.media import without_absorption
from lfmesh.transport.tables.motions import STILL
from lfmesh.transport.tables.particles import corners_round
from lfmesh.transport.tables.swept import box_round
from lfmesh.transport.tables.volumes import corners_of
from lfmesh.transport.world import World

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]

ON_ROUGH_GLASS, ON_TARGETS, FIRST_REGION = -2, -1, 0
"""Places of sights. Regions are numbered with media first, then the entries of particles."""

ROOM = 0.02
"""Enlargement of the box of particles within which rays pass them, relative to its largest edge."""

MOST_FACES, PLANE_DECIMALS = 64, 4
"""Largest number of flat faces to distinguish on a body, and the decimals that distinguish their planes."""

MIX = np.uint64(0x9E3779B97F4A7C15)
"""Odd multiplier of the hash of a way's events."""


class Sights(NamedTuple):
    """Points that see the lens, each in one direction.

    Attributes
    ----------
    point : (n, 3) float64, mm, camera frame
    direction : (n, 3) float64, unit, camera frame
        Towards the lens.
    way : (n,) uint64
        Hash of the sequence of refracting and reflecting bodies; 0: straight to the lens.
    place : (n,) int64
        ON_TARGETS, ON_ROUGH_GLASS, or the number of the region.
    """

    point: Array
    direction: Array
    way: NDArray[np.uint64]
    place: Numbers

    def some(self, which: NDArray[np.generic]) -> "Sights":
        """Return a selection, given by numbers or a mask."""
        return Sights(*(values[which] for values in self))

    def joined(self, other: "Sights") -> "Sights":
        """Return these sights followed by others."""
        return Sights(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))


class Region(NamedTuple):
    """Box of a medium or of particles that emit or scatter light."""

    to_own: Array  # (3, 4) from the world frame
    low: Array  # (3,) mm
    high: Array


class _Stretches(NamedTuple):
    """Straight segments of the probes' ways."""

    start: Array  # (n, 3) mm, world frame
    end: Array
    way: NDArray[np.uint64]  # way of the light from there to the lens
    probe: Numbers


def regions_of(world: World) -> list[Region]:
    """Return boxes round all media that emit or scatter light, then round the entries of particles.

    They hold during the whole exposure, in the world that the camera carries along.
    """
    objects, moves, motions = world.tables.objects, world.tables.frames, world.tables.motions
    found = []
    if objects.volumes is not None:
        acts = (objects.volumes.scattering > 0.0).any(axis=1) | (objects.volumes.emission > 0.0).any(axis=1)
        for number in np.flatnonzero(acts):
            row = objects.volumes.rows[number]
            corners = corners_of(row)
            if corners is None:
                corners = objects.outer_radius * np.array([[-1.0] * 3, [1.0] * 3])
            elif motions is not None and motions.of_medium[number] != STILL:
                # All the space that the medium passes through.
                corners = frame.points(frame.inverse(row["to_own"]), corners)
                corners = box_round(motions, int(motions.of_medium[number]), corners, np.eye(3, 4))
                found.append(Region(moves[WORLD_FRAME, OBJECT_FRAME], corners.min(axis=0), corners.max(axis=0)))
                continue
            to_own = frame.compose(row["to_own"], moves[WORLD_FRAME, OBJECT_FRAME])
            found.append(Region(to_own, corners.min(axis=0), corners.max(axis=0)))
    for table in world.particles:
        corners = corners_round((table,), motions)
        low, high = corners.min(axis=0), corners.max(axis=0)
        # A box without volume, of a single particle or a plane of them, would be passed by no ray.
        room = ROOM * max(float((high - low).max()), float(np.linalg.norm(low)))
        found.append(Region(np.eye(3, 4), low - room, high + room))
    return found


def probe(world: World, count: int, seed: int) -> Sights:
    """Return the sights found by about `count` probe rays.

    Parameters
    ----------
    world : World
    count : int
    seed : int
        Seed of their random numbers.
    """
    draw = np.random.default_rng(seed)
    colours = world.tables.lens.media.indices.shape[1]
    chosen = sorted({0, colours // 2, colours - 1})
    packets = np.concatenate([_before_lens(world, count // len(chosen), colour, draw) for colour in chosen])
    regions = regions_of(world)
    found = [_traced(world, packets[k : k + CHUNK], regions, draw) for k in range(0, len(packets), CHUNK)]
    nothing = np.zeros((0, 3))
    sights = Sights(nothing, nothing, np.zeros(0, np.uint64), np.zeros(0, np.int64))
    for each in found:
        sights = sights.joined(each)
    moves = world.tables.frames[WORLD_FRAME, CAMERA_FRAME]
    return sights._replace(point=frame.points(moves, sights.point), direction=frame.directions(moves, sights.direction))


def _before_lens(world: World, count: int, colour: int, draw: np.random.Generator) -> NDArray[np.void]:
    """Return packets that have left the lens along the image path, drawn by the light that they would bring."""
    transport, sensor = world.scene.transport, world.tables.sensor
    in_order = obstacle_of(world.scene, transport.surface, transport.max_events) is None
    options = options_of(world, adjoint=True, importance=True, split=TRANSMIT)
    if in_order:
        options = options._replace(faces=BY_ORDER)
    tables = world.aimed_tables
    tables = tables._replace(aim=with_wide_share(tables.aim, WIDE_SHARE_OF_IMAGE_PATH, WIDE_SHARE_OF_IMAGE_PATH))
    of_sensor = sensor.rows * sensor.columns
    pixels = np.sort(draw.permutation(of_sensor)[:count])
    samples = -(-count // len(pixels))
    work = Workspace(world, options, CHUNK, tables)
    started = []
    at_once = max(1, CHUNK // samples)
    key = np.uint64(draw.integers(1 << 62))
    for first in range(0, len(pixels), at_once):
        some = pixels[first : first + at_once]
        work.begin(Film.empty(of_sensor, 1, 0), len(some) * samples)
        PixelSource(some, samples, key, Nodes.single(colour), channel=0).launch(work, range(len(some)))
        while True:
            others = work.tops[:STATIONS].copy()
            others[OBJECTS] = 0
            if not others.any():
                break
            work.advance(int(np.argmax(others)))
        started.append(work.stacks.waiting(OBJECTS).copy())
    packets = np.concatenate(started)
    weight = packets["weight"]
    if not weight.sum() > 0.0:
        return packets[:0]
    times = np.floor(weight / weight.mean() + draw.random(len(weight))).astype(np.int64)
    return np.repeat(packets, times)


def _traced(world: World, packets: NDArray[np.void], regions: list[Region], draw: np.random.Generator) -> Sights:
    """Trace packets through object space; return their sights, world frame."""
    objects = world.tables.objects
    clear = objects._replace(
        volumes=None, media=without_absorption(objects.media), fields=crossed_at_once(objects.fields)
    )  # fmt: skip
    split = TRANSMIT if world.scene.transport.split == "transmit" else ROULETTE
    # Their times are those of the exposure.
    stream = np.uint64(0 if world.tables.motions is None else draw.integers(1 << 62))
    options = options_of(world, tracing=True, record=True, split=split, cutoff=0.0, still=False, stream=stream)
    work = Workspace(world, options, max(1, len(packets)), world.tables._replace(objects=clear))
    work.begin(None, len(packets))
    work.stacks.queue(OBJECTS, packets)
    waiting = work.stacks.waiting(OBJECTS)
    waiting["source"], waiting["key"] = np.arange(len(packets)), draw.integers(1 << 62, size=len(packets))
    waiting["weight"], waiting["start"], waiting["events"], waiting["node"] = 1.0, 1.0, 0, NO_SURFACE
    work.record_starts()
    while work.tops[OBJECTS]:
        work.advance(OBJECTS)
    return _sights(work, work.vertices(), work.ends(), regions, draw)


def _sights(
    work: Workspace, nodes: NDArray[np.void], ends: NDArray[np.void], regions: list[Region], draw: np.random.Generator
) -> Sights:
    """Return the sights along recorded ways, world frame."""
    world = work.world
    rough = np.array([t.refractor is not None and t.refractor.finish.is_rough for t in world.scene.targets] + [False])
    parent, glass = nodes["parent"], nodes["surface"] == ON_GLASS
    bends = glass | (nodes["surface"] == IN_FIELD)
    way, first, spoilt = np.zeros(len(nodes), np.uint64), np.arange(len(nodes)), np.zeros(len(nodes), np.bool_)
    event = _events(work, nodes, glass)
    on_rough = glass & rough[np.where(glass, nodes["part"], -1)]
    depth = np.zeros(len(nodes), np.int64)
    while True:
        deeper = np.where(parent >= 0, depth[parent] + 1, 0)
        if (deeper == depth).all():
            break
        depth = deeper
    for k in range(1, int(depth.max(initial=0)) + 1):
        level = np.flatnonzero(depth == k)
        up = parent[level]
        way[level] = np.where(bends[level], (way[up] + event[level]) * MIX + np.uint64(1), way[up])
        first[level], spoilt[level] = first[up], spoilt[up] | on_rough[level]
    probe_of = np.zeros(len(nodes), np.int64)
    probe_of[np.flatnonzero(parent < 0)] = np.arange((parent < 0).sum())
    probe_of = probe_of[first]
    position, end = nodes["position"], ends["node"]
    clean = ends[~spoilt[end]]
    on_target = clean[clean["status"] == S_TARGET]
    found = [
        Sights(on_target["position"], -on_target["direction"], way[on_target["node"]], _all(on_target, ON_TARGETS))
    ]
    matt = np.flatnonzero(on_rough & ~spoilt[parent])
    found.append(
        Sights(position[matt], _unit(position[parent[matt]] - position[matt]), way[parent[matt]],
               _all(matt, ON_ROUGH_GLASS))
    )  # fmt: skip
    if regions:
        inner = np.flatnonzero(bends & ~spoilt[parent])
        met = clean[np.isin(clean["status"], (S_TARGET, S_ABSORBED))]["node"]
        inner = np.concatenate([inner, met])
        out = clean[clean["status"] == S_ESCAPED]
        far = _past_all_mm(world, regions, out["position"]) * out["direction"]
        stretches = _Stretches(
            np.concatenate([position[parent[inner]], out["position"]]),
            np.concatenate([position[inner], out["position"] + far]),
            np.concatenate([way[parent[inner]], way[out["node"]]]),
            np.concatenate([probe_of[inner], probe_of[out["node"]]]),
        )
        found += [_within(stretches, region, number, draw) for number, region in enumerate(regions)]
    sights = found[0]
    for each in found[1:]:
        sights = sights.joined(each)
    return sights


def _events(work: Workspace, nodes: NDArray[np.void], glass: NDArray[np.bool_]) -> NDArray[np.uint64]:
    """Return a number for body, face and kind of event of each vertex on glass or in an index field; 0 for others."""
    world, face, positions = work.world, np.zeros(len(nodes), np.int64), _at_start(work, nodes, glass)
    for body in np.unique(nodes["part"][glass]):
        if world.targets[body].round is not None:
            # Its single curved face bends neighbouring ways alike.
            continue
        mine = np.flatnonzero(glass & (nodes["part"] == body))
        corners = world.targets[body].mesh.vertices[world.targets[body].mesh.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals = _unit(normals)
        planes = np.column_stack([normals, np.einsum("ij,ij->i", normals, corners[:, 0])])
        planes = np.unique(np.round(planes, PLANE_DECIMALS), axis=0)
        if len(planes) <= MOST_FACES:
            off = np.abs(positions[mine] @ planes[:, :3].T - planes[:, 3])
            face[mine] = np.argmin(off, axis=1)
    number = (face * len(world.targets) + nodes["part"]) * len(Event) + nodes["event"] + 1
    # The faces of a field bend neighbouring ways alike.
    further = (MOST_FACES * len(world.targets) + nodes["part"]) * len(Event) + nodes["event"] + 1
    return np.where(glass, number, np.where(nodes["surface"] == IN_FIELD, further, 0)).astype(np.uint64)


def _at_start(work: Workspace, nodes: NDArray[np.void], glass: NDArray[np.bool_]) -> Array:
    """Return the positions of vertices, those on glass carried back with it to t = 0, (n, 3) mm, world frame."""
    found, motions = nodes["position"].copy(), work.tables.motions
    if motions is None:
        return found
    some = np.flatnonzero(glass & (motions.of_target[np.where(glass, nodes["part"], -1)] != STILL))
    root = np.arange(len(nodes))
    while (nodes["parent"][root] >= 0).any():
        root = np.where(nodes["parent"][root] >= 0, nodes["parent"][root], root)
    # The starts were recorded in the order of the packets, whose numbers are their sources.
    source = np.cumsum(nodes["parent"] < 0)[root] - 1
    frames = work.tables.frames
    points = frame.points(frames[WORLD_FRAME, OBJECT_FRAME], found[some])
    movers = motions.of_target[nodes["part"][some]]
    _carry_back(work.moving, work.options, work.template, source[some], movers, points)
    found[some] = frame.points(frames[OBJECT_FRAME, WORLD_FRAME], points)
    return found


@kernel
def _carry_back(
    moving: Any, options: Options, template: NDArray[np.void], source: Numbers, movers: Numbers, points: Array
) -> None:
    """Move points, (n, 3) mm, of the object frame into the frame of their movers at the times of some sources."""
    packet = template[0]
    for i in range(len(points)):
        packet.source = source[i]
        start_in_mover(moving, options, packet, STILL)
        x, y, z = point_between(moving, STILL, movers[i], points[i, 0], points[i, 1], points[i, 2])
        points[i, 0], points[i, 1], points[i, 2] = x, y, z


def _past_all_mm(world: World, regions: list[Region], places: Array) -> float:
    """Return a distance from some places beyond all regions, or far into an unbounded one."""
    radius = world.tables.objects.outer_radius
    if np.isfinite(radius):
        return 4.0 * radius
    corners = [
        np.linalg.norm(np.maximum(abs(region.low), abs(region.high))) + np.linalg.norm(region.to_own[:, 3])
        for region in regions
    ]
    bounded = [corner for corner in corners if np.isfinite(corner)]
    return 2.0 * float(max(bounded, default=0.0) + np.linalg.norm(places, axis=1).max(initial=0.0))


def _within(stretches: _Stretches, region: Region, number: int, draw: np.random.Generator) -> Sights:
    """Return a random point on each probe's way through a region."""
    start, end = frame.points(region.to_own, stretches.start), frame.points(region.to_own, stretches.end)
    step = end - start
    with np.errstate(divide="ignore", invalid="ignore"):
        one, other = (region.low - start) / step, (region.high - start) / step
    # A way of zero length on a plane of the box gives NaN, and no length inside.
    enters = np.fmax.reduce(np.minimum(one, other), axis=1).clip(0.0)
    leaves = np.fmin.reduce(np.maximum(one, other), axis=1).clip(max=1.0)
    length = (leaves - enters) * np.linalg.norm(step, axis=1)
    some = np.flatnonzero(length > 0.0)
    # Draw one segment of each way by its length: the earliest of exponential times with these rates.
    order = some[np.argsort(-np.log1p(-draw.random(len(some))) / length[some])]
    _, chosen = np.unique(stretches.probe[order], return_index=True)
    chosen = order[chosen]
    t = enters[chosen] + draw.random(len(chosen)) * (leaves - enters)[chosen]
    way = stretches.end[chosen] - stretches.start[chosen]
    return Sights(
        stretches.start[chosen] + t[:, None] * way, -_unit(way), stretches.way[chosen],
        _all(chosen, FIRST_REGION + number),
    )  # fmt: skip


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def _all(of: NDArray[np.generic], value: int) -> Numbers:
    return np.full(len(of), value, np.int64)
