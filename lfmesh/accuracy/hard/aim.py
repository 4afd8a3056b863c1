"""Rays aimed at vertices and edges of a mesh."""

import numpy as np
import trimesh

from lfmesh.accuracy.hard.outcome import (
    SINGLET,
    Outcome,
    case,
    faces_of,
    lens_scene,
    on_sensor,
    sensor_z,
    through_lens,
    tilted,
    world_with,
)
from lfmesh.accuracy.hard.truth import Array, Interface, at_plane, through
from lfmesh.transport.build import build
from lfmesh.transport.trace import trace


def _aimed(points: Array, seed: int = 3) -> tuple[Array, Array]:
    """Return rays from 50 mm in front that pass exactly through points, to rounding."""
    d = tilted(len(points), 0.1, seed)
    return points - 50.0 * d, d


@case
def vertices_and_edges() -> Outcome:
    """Aim rays exactly at every vertex, and at points on every edge, of a lens mesh."""
    scene = lens_scene(SINGLET)
    world = build(scene, rings=24)
    cap = world.lens_shape.caps[0]
    edges = np.unique(
        np.sort(np.concatenate([cap.faces[:, [0, 1]], cap.faces[:, [1, 2]], cap.faces[:, [2, 0]]])), axis=0
    )
    corner = cap.vertices[edges]
    middles = [corner[:, 0] * (1.0 - share) + corner[:, 1] * share for share in (0.5, 0.25, 0.1)]
    o, d = _aimed(np.concatenate([cap.vertices, *middles]))
    return through_lens(scene, o, d, 1e-9, world=world)


@case
def pole_and_rim() -> Outcome:
    """Aim rays at the pole of a cap, and within 1e-9 mm of the rim of its aperture."""
    scene = lens_scene(SINGLET)
    phi = 2.0 * np.pi * np.arange(720) / 720
    radii = 10.0 + np.array([-1e-3, -1e-9, 1e-9, 1e-3])
    x, y = (np.outer(radii, f(phi)).ravel() for f in (np.cos, np.sin))
    o, d = _aimed(np.zeros((500, 3)))
    o = np.concatenate([o, [[0.0, 0.0, -60.0]], np.column_stack([x, y, np.full(len(x), -60.0)])])
    return through_lens(scene, o, np.concatenate([d, np.tile([0.0, 0.0, 1.0], (1 + len(x), 1))]), 1e-9)


@case
def skinny_fan() -> Outcome:
    """Aim rays at the centre of a fan of 7,200 thin triangles on a glass plate."""
    disk = trimesh.creation.cylinder(radius=20.0, height=4.0, sections=7200)
    world = world_with(disk, index=1.5, position_mm=(0.0, 0.0, -30.0))
    draw = np.random.default_rng(0)
    n = 4000
    # Half of them pass exactly through the centre, the others as near as 1e-7 mm.
    aside = draw.normal(size=(n, 2)) * 10.0 ** draw.uniform(-7.0, -2.0, (n, 1))
    aside[: n // 2] = 0.0
    d = tilted(n, 0.15)
    o = np.column_stack([aside, np.full(n, -32.0)]) - 20.0 * d
    paths = trace(world, o, d, split="transmit")
    plate = through([Interface(np.inf, -32.0, 1.5), Interface(np.inf, -28.0), *faces_of(world.scene)], o, d)
    return on_sensor(paths, at_plane(plate.p, plate.d, sensor_z(world.scene)), plate.weight, 1e-9)
