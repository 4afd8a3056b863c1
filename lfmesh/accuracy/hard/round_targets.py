"""Round targets met at their outlines, from nearby and from afar, and at grazing incidence."""

from typing import Any

import numpy as np

from lfmesh.accuracy.hard.outcome import SINGLET, Outcome, case, lens_scene, outcome
from lfmesh.accuracy.hard.truth import Array
from lfmesh.scene import Target
from lfmesh.scene.objects.targets import Cylinder, Sphere
from lfmesh.transport.trace import Status, trace
from lfmesh.transport.traced_paths import Paths
from lfmesh.transport.world import build

RADIUS_MM = 5.0
PLACE = np.array([3.0, -2.0, -300.0])
BESIDE = 1e-8
"""Fraction of an outline's angle by which rays pass to either side."""

NEAREST_MM, FARTHEST_MM = 5.01, 1e5
"""Distances of the rays' starts from the centre of a ball."""

RAYS = 20_000
ROUNDING = 1e-9
"""Largest distance of a point from its surface, mm."""


def _traced(shape: Sphere | Cylinder, starts: Array, ways: Array, **place: Any) -> Paths:
    target = Target(shape=shape, position_mm=tuple(PLACE.tolist()), **place)
    return trace(build(lens_scene(SINGLET, targets=(target,)), aimed=False), starts, ways)


def _square(draw: np.random.Generator, ways: Array) -> Array:
    """Return a random unit vector perpendicular to each direction."""
    aside = np.cross(ways, draw.normal(size=ways.shape))
    return np.asarray(aside / np.linalg.norm(aside, axis=1, keepdims=True))


@case
def outline_of_a_ball() -> Outcome:
    """Pass a ball by 1e-8 of the angle of its outline on either side, from 0.01 mm to 100 m away."""
    draw = np.random.default_rng(41)
    away = np.exp(draw.uniform(np.log(NEAREST_MM), np.log(FARTHEST_MM), RAYS))
    # Start beside the ball, so that the camera is not in the way.
    turn = draw.uniform(0.0, 2.0 * np.pi, RAYS)
    to_ball = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(RAYS)])
    inside = np.arange(RAYS) % 2 == 0
    angle = np.arcsin(RADIUS_MM / away) * np.where(inside, 1.0 - BESIDE, 1.0 + BESIDE)
    ways = np.cos(angle)[:, None] * to_ball + np.sin(angle)[:, None] * _square(draw, to_ball)
    paths = _traced(Sphere(radius_mm=RADIUS_MM), PLACE - away[:, None] * to_ball, ways)
    right = (paths.status == Status.TARGET) == inside[paths.source]
    return outcome(
        paths, f"the {inside.sum()} inner ones of {RAYS} rays end on it",
        f"{int((~right).sum())} rays are on the wrong side", bool(right.all()),
    )  # fmt: skip


@case
def grazed_cylinder() -> Outcome:
    """Graze the wall of a cylinder at depths of 1e-3 to 1e-12 of its radius."""
    draw = np.random.default_rng(42)
    depth = 10.0 ** draw.uniform(-12.0, -3.0, RAYS)
    turn = draw.uniform(0.0, 2.0 * np.pi, RAYS)
    outward = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(RAYS)])
    rise = draw.uniform(-0.5, 0.5, RAYS)
    ways = np.column_stack([-np.sin(turn), np.cos(turn), rise]) / np.sqrt(1.0 + rise**2)[:, None]
    on_wall = RADIUS_MM * (1.0 - depth)[:, None] * outward
    on_wall[:, 2] = draw.uniform(-4.0, 4.0, RAYS)
    paths = _traced(Cylinder(radius_mm=RADIUS_MM, height_mm=20.0), PLACE + on_wall - 50.0 * ways, ways)
    met = paths.status == Status.TARGET
    off = np.abs(np.hypot(*(paths.position[met] - PLACE)[:, :2].T) - RADIUS_MM).max(initial=0.0)
    return outcome(
        paths, f"all {RAYS} rays end on it, within {ROUNDING:.0e} mm",
        f"{int(met.sum())} do; the farthest lies {off:.1e} mm off", bool(met.all() and off < ROUNDING),
    )  # fmt: skip
