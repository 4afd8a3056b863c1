"""Round targets and glass met at their outlines, from nearby and from afar, and at grazing incidence."""

from typing import Any

import numpy as np

from lfmesh.accuracy.hard.outcome import SINGLET, Outcome, case, lens_scene, outcome
from lfmesh.accuracy.hard.truth import Array
from lfmesh.optics.fresnel import fresnel
from lfmesh.scene import Refractor, Target
from lfmesh.scene.objects.shapes import Cylinder, Sphere
from lfmesh.transport.build import build
from lfmesh.transport.trace import Status, trace
from lfmesh.transport.traced_paths import Paths

RADIUS_MM = 5.0
PLACE = np.array([3.0, -2.0, -300.0])
BESIDE = 1e-8
"""Fraction of an outline's angle by which rays pass to either side."""

NEAREST_MM, FARTHEST_MM = 5.01, 1e5
"""Distances of the rays' starts from the centre of a ball."""

RAYS = 20_000
ROUNDING = 1e-9
"""Largest distance of a point from its surface, mm."""

STEEPEST = 3e-3
"""Cosine over which the share that a face of index 1.0001 passes changes by as much as itself, at the least."""


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


@case
def grazed_ball_of_glass() -> Outcome:
    """Pass through balls of index 1.0001 to 4 at depths of 1 to 1e-12 of their radius below the outline."""
    draw = np.random.default_rng(43)
    depth = 10.0 ** draw.uniform(-12.0, 0.0, RAYS)
    way = np.array([0.6, 0.0, 0.8])
    aside = _square(draw, np.broadcast_to(way, (RAYS, 3)))
    sine = 1.0 - depth
    starts = PLACE + RADIUS_MM * sine[:, None] * aside - 50.0 * way
    # Where coordinates are rounded, the height is; near the outline the angle of incidence moves much more.
    grain = 8.0 * np.finfo(np.float64).eps * float(np.abs(starts).max()) / RADIUS_MM
    allowed = grain * (1.0 + 1.0 / np.sqrt(depth))
    traced, turned, weighed = [], 0.0, 0.0
    for index in (1.0001, 1.5, 4.0):
        glass = Refractor(shape=Sphere(radius_mm=RADIUS_MM), index=index)
        ball = Target(refractor=glass, position_mm=tuple(PLACE.tolist()))
        world = build(lens_scene(SINGLET, targets=(ball,)), aimed=False)
        paths = trace(world, starts, np.broadcast_to(way, starts.shape), split="transmit")
        traced.append(paths)
        out = paths.status == Status.ESCAPED
        ray = paths.source[out]
        # The sine to all of its digits: that of the start as it was rounded.
        height = np.linalg.norm(np.cross(starts[ray] - PLACE, way), axis=1) / RADIUS_MM
        first = np.arcsin(np.minimum(height, 1.0))
        turn = 2.0 * (first - np.arcsin(np.minimum(height, 1.0) / index))
        found = np.arctan2(-(paths.direction[out] * aside[ray]).sum(axis=1), paths.direction[out] @ way)
        turned = max(turned, float((np.abs(found - turn) / allowed[ray]).max(initial=0.0)))
        # Both faces of a ball pass the same share, which changes within STEEPEST of the cosine.
        through = np.array([fresnel(1.0, index, c)[1] for c in np.cos(first)])
        off = STEEPEST * np.abs(paths.weight[out] - through**2) / allowed[ray]
        weighed = max(weighed, float(off.max(initial=0.0)))
    met = sum(int((paths.events > 0).sum()) for paths in traced)
    lost = sum(sum(paths.ledger.lost.values()) for paths in traced)
    return outcome(
        traced, f"{3 * RAYS} rays turn by 2 (i − r), to rounding, with T² of their weight",
        f"{met} meet it, {lost:g} lost; angles off by {turned:.2g}, weights by {weighed:.2g} of what rounding allows",
        met >= 3 * RAYS - 3 and lost == 0.0 and turned < 1.0 and weighed < 1.0,
    )  # fmt: skip
