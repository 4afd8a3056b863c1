"""The aim from inside bodies of glass or liquid: rays are traced out of them to the lens's opening, before an image.

At each node of a lattice over a body the ray that meets the middle of the opening is found by Newton's method. Rays
aimed by what lies between the nodes, at the middle and the rim of the opening, then tell how far they miss it.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry import frame
from lfmesh.geometry.mesh import Array
from lfmesh.transport.aiming.through_glass import LATTICE, VALUES, GlassAim, Way, way_out
from lfmesh.transport.engine import Workspace
from lfmesh.transport.packets.book import HOUSING
from lfmesh.transport.packets.packet import (
    CAMERA_FRAME,
    ENDED,
    LENS,
    OBJECT_FRAME,
    OBJECTS,
    S_ABSORBED,
    S_ESCAPED,
    TRANSMIT,
    WORLD_FRAME,
)
from lfmesh.transport.regions.bodies import RANK
from lfmesh.transport.regions.glass_round import glass_round
from lfmesh.transport.settings import options_of
from lfmesh.transport.sources.rays import RaySource
from lfmesh.transport.world import World

Numbers = NDArray[np.int64]

NODES = 9
"""Of a lattice, along each axis."""

NEAR_FACES = 0.999
"""Size of a lattice over that of its body: its outer nodes lie inside."""

STEPS, NUDGE, HIT = 12, 0.002, 0.01
"""Newton's method: steps, at most; difference of slopes by which derivatives are taken; and how near to the middle a
ray is taken to meet it, over the radius of the wide disk."""

SLACK = 1.5
"""By what the largest miss that was seen is multiplied: rays are aimed so much wider than the opening."""


class Landed(NamedTuple):
    """Where rays from inside bodies meet the plane of the opening."""

    known: NDArray[np.bool_]  # (n,)
    point: Array  # (n, 2) mm, camera frame
    slope: Array  # (n, 2) in air


def bodies_with_light(world: World) -> list[int]:
    """Return the bodies inside which light starts or is scattered, by their ranks."""
    objects = world.tables.objects
    ranks = {int(rank) for table in world.particles for rank in np.unique(table.inside & RANK)}
    if objects.volumes is not None:
        acts = (objects.volumes.scattering > 0.0).any(axis=1) | (objects.volumes.emission > 0.0).any(axis=1)
        ranks |= set(objects.volumes.rows["inside"][acts].tolist())
    return sorted(ranks - {0})


def glass_aim(world: World) -> GlassAim | None:
    """Return the aim from inside the bodies in which light starts or is scattered; None if there are none."""
    ranks = bodies_with_light(world)
    if not ranks or not world.aim.entrance.known:
        return None
    lattices, nodes = np.zeros(len(ranks), LATTICE), []
    for number, rank in enumerate(ranks):
        lattice = lattices[number]
        places = _lattice(world, rank, lattice)
        inside = glass_round(world.tables.objects, world.targets, _to_world(world, places))
        nodes.append(_central_rays(world, places, inside, rank))
        lattice["first"] = sum(map(len, nodes[:-1]))
        alone = GlassAim(lattices[number : number + 1].copy(), nodes[-1])
        alone.lattices["first"] = 0
        nodes[-1][:, -1] = SLACK * _misses(world, alone, places, rank)
    return GlassAim(lattices, np.concatenate(nodes))


def _lattice(world: World, rank: int, lattice: np.void) -> Array:
    """Fill in the lattice over a body, along the axes of its target; return its nodes, (n, 3) mm, camera frame."""
    body = int(world.tables.objects.by_rank[rank])
    target = world.scene.targets[body]
    own = frame.frame(target.rotation_deg, target.position_mm)
    corners = frame.points(frame.inverse(own), world.targets[body].mesh.vertices)
    low, high = corners.min(axis=0), corners.max(axis=0)
    margin = 0.5 * (1.0 - NEAR_FACES) * (high - low)
    lattice["rank"], lattice["count"] = rank, NODES
    lattice["low"], lattice["step"] = low + margin, (high - low - 2.0 * margin) / (NODES - 1)
    to_world = world.tables.frames[CAMERA_FRAME, WORLD_FRAME]
    lattice["to_own"] = frame.compose(frame.inverse(own), to_world)
    grid = np.stack(np.meshgrid(*[np.arange(NODES)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    return frame.points(frame.inverse(lattice["to_own"]), lattice["low"] + grid * lattice["step"])


def _to_world(world: World, points: Array) -> Array:
    return frame.points(world.tables.frames[CAMERA_FRAME, WORLD_FRAME], points)


def _central_rays(world: World, places: Array, inside: Numbers, rank: int) -> Array:
    """Return the nodes at places of a body, (n, VALUES); those elsewhere, and those that no ray leaves, are unknown."""
    plane_z, wide = world.aim.entrance.plane_z, world.aim.front_radius
    nodes = np.zeros((len(places), VALUES))
    some = np.flatnonzero((inside & RANK == rank) & (places[:, 2] < plane_z))
    slope = -places[some, :2] / (plane_z - places[some, 2])[:, None]
    for step in range(STEPS):
        if not len(some):
            break
        landed = [
            _landed(world, places[some], slope + np.array(nudge), inside[some])
            for nudge in ((0.0, 0.0), (NUDGE, 0.0), (0.0, NUDGE))
        ]
        middle = landed[0]
        # Columns: change of the point for a change of each slope.
        change = np.stack([(each.point - middle.point) / NUDGE for each in landed[1:]], axis=-1)
        known = np.all([each.known for each in landed], axis=0)
        known[known] = np.abs(np.linalg.det(change[known])) > 0.0
        some, slope, change = some[known], slope[known], change[known]
        point, left = middle.point[known], middle.slope[known]
        inverse = np.linalg.inv(change)
        if step == STEPS - 1 or (np.linalg.norm(point, axis=1) < HIT * wide).all():
            met = np.linalg.norm(point, axis=1) < HIT * wide
            # To first order the ray through the very middle.
            slope = slope - np.einsum("nij,nj->ni", inverse, point)
            columns = [np.ones((len(some), 1)), slope, left, inverse.reshape(-1, 4), np.zeros((len(some), 1))]
            rows = np.concatenate(columns, axis=1)
            nodes[some[met]] = rows[met]
            break
        slope = slope - np.einsum("nij,nj->ni", inverse, point)
    return nodes


def _misses(world: World, alone: GlassAim, places: Array, rank: int) -> Array:
    """Return the largest distance by which rays from round each node miss the points they are aimed at, (n,) mm."""
    cells = places.reshape(NODES, NODES, NODES, 3)
    middles = 0.5 * (cells[:-1, :-1, :-1] + cells[1:, 1:, 1:]).reshape(-1, 3)
    inside = glass_round(world.tables.objects, world.targets, _to_world(world, middles))
    ways = [way_out(alone, rank, *point) for point in middles]
    some = np.flatnonzero((inside & RANK == rank) & np.array([way.known for way in ways]))
    missed = np.zeros(len(middles))
    if not len(some):
        return np.zeros(len(places))
    way = Way(*np.array([ways[i] for i in some], dtype=np.float64).T)
    start, change = np.stack([way.sx, way.sy], axis=-1), np.array([[way.xx, way.xy], [way.yx, way.yy]])
    radius = 0.5 * world.aim.front_radius
    for x, y in ((0.0, 0.0), (radius, 0.0), (-radius, 0.0), (0.0, radius), (0.0, -radius)):
        goal = np.array([x, y])
        landed = _landed(world, middles[some], start + np.einsum("ijn,j->ni", change, goal), inside[some])
        miss = np.where(landed.known, np.linalg.norm(landed.point - goal, axis=1), world.aim.front_radius)
        missed[some] = np.maximum(missed[some], miss)
    # Each node has the largest of the cells round it.
    padded = np.pad(missed.reshape(NODES - 1, NODES - 1, NODES - 1), 1)
    shifted = [padded[i : i + NODES, j : j + NODES, k : k + NODES] for i, j, k in np.ndindex(2, 2, 2)]
    return np.asarray(np.max(shifted, axis=0).ravel())


def _landed(world: World, places: Array, slope: Array, inside: Numbers) -> Landed:
    """Trace rays from inside bodies, through all glass, to the plane of the opening.

    Parameters
    ----------
    world : World
    places : (n, 3) float64, mm, camera frame
    slope : (n, 2) float64
        dx/dz and dy/dz.
    inside : (n,) int64
        Bodies round each place, as packets hold them.
    """
    direction = np.concatenate([slope, np.ones((len(slope), 1))], axis=1)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    ones, zeros = np.ones(len(places)), np.zeros(len(places), np.int64)
    source = RaySource(places, direction, zeros + OBJECTS, zeros, ones, np.uint64(0), inside=inside)
    objects = world.tables.objects
    clear = objects._replace(volumes=None, media=objects.media._replace(absorption=None))
    options = options_of(world, tracing=True, split=TRANSMIT, cutoff=0.0)
    work = Workspace(world, options, len(places), world.tables._replace(objects=clear))
    work.begin(None, len(places))
    source.launch(work, range(len(places)))
    while work.tops[OBJECTS]:
        work.advance(OBJECTS)
    entered = work.stacks[work.rows[LENS], : work.tops[LENS]]
    ended = work.ended[: work.tops[ENDED]]
    beside = ended[(ended["status"] == S_ESCAPED) | ((ended["status"] == S_ABSORBED) & (ended["body"] == HOUSING))]
    origin, way = np.full((2, len(places), 3), np.nan)
    for name, into in (("xyz", origin), (("dx", "dy", "dz"), way)):
        into[entered["source"]] = np.stack([entered[axis] for axis in name], axis=-1)
    moves = world.tables.frames
    origin, way = (
        frame.points(moves[OBJECT_FRAME, CAMERA_FRAME], origin),
        frame.directions(moves[OBJECT_FRAME, CAMERA_FRAME], way),
    )
    origin[beside["source"]] = frame.points(moves[WORLD_FRAME, CAMERA_FRAME], beside["position"])
    way[beside["source"]] = frame.directions(moves[WORLD_FRAME, CAMERA_FRAME], beside["direction"])
    with np.errstate(divide="ignore", invalid="ignore"):
        out = way[:, :2] / way[:, 2:]
        point = origin[:, :2] + (world.aim.entrance.plane_z - origin[:, 2:]) * out
    known = (way[:, 2] > 0.0) & np.isfinite(point).all(axis=1)
    return Landed(known, point, out)
