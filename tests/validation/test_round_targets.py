"""Spheres, cylinders and disks as rays meet them: outlines, light on them and of them, against closed forms."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from tests.cameras import camera_without_array
from tests.renders import by_seed
from tests.validation.test_radiometry import assert_means, disk_factor, irradiances, patch

Array = NDArray[np.float64]

PLACE = np.array([3.0, -2.0, -300.0])
NARROW = 2.5e-7
"""Half of 1e-6 of an area, to either side of its outline."""


def world_of(*targets: dict[str, Any], **settings: Any) -> lf.World:
    return lf.build(lf.Scene(camera=camera_without_array(), targets=targets, transport=settings), aimed=False)


def ends(world: lf.World, starts: Array, ways: Array) -> tuple[NDArray[np.bool_], Array]:
    """Tell which rays end on a target, and where."""
    paths = lf.trace(world, starts, ways, split="transmit", threads=1)
    met, place = np.zeros(len(starts), np.bool_), np.full((len(starts), 3), np.nan)
    on = paths.status == lf.Status.TARGET
    met[paths.source[on]], place[paths.source[on]] = True, paths.position[on]
    return met, place


def along(outline: Array, way: Array, share: float) -> tuple[Array, Array]:
    """Parallel rays through an outline about the target's place, made larger by a share."""
    return PLACE + (1.0 + share) * outline - 800.0 * way, np.broadcast_to(way, outline.shape).copy()


TURN = 2.0 * np.pi * np.arange(720) / 720
SIDE = np.linspace(-0.999, 0.999, 360)
X, BACK = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
OUTLINES: dict[str, tuple[dict[str, Any], Array, Array]] = {
    "sphere": (
        {"kind": "sphere", "radius_mm": 5.0},
        5.0 * np.stack([0.0 * TURN, np.cos(TURN), np.sin(TURN)], axis=1), X,
    ),
    "wall": (
        {"kind": "cylinder", "radius_mm": 4.0, "height_mm": 12.0},
        np.concatenate([np.stack([0.0 * SIDE, np.full(360, sign * 4.0), 6.0 * SIDE], axis=1) for sign in (-1, 1)]), X,
    ),
    "end": (
        {"kind": "cylinder", "radius_mm": 4.0, "height_mm": 12.0},
        4.0 * np.stack([np.cos(TURN), np.sin(TURN), 0.0 * TURN], axis=1), BACK,
    ),
    "disk": (
        {"kind": "disk", "radius_mm": 7.0}, 7.0 * np.stack([np.cos(TURN), np.sin(TURN), 0.0 * TURN], axis=1), BACK,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", OUTLINES)
def test_the_area_of_an_outline_is_right_to_a_millionth(name: str) -> None:
    shape, outline, way = OUTLINES[name]
    world = world_of({"shape": shape, "position_mm": PLACE.tolist()})
    assert ends(world, *along(outline, way, -NARROW))[0].all()
    assert not ends(world, *along(outline, way, NARROW))[0].any()


def test_an_outline_seen_from_nearby_is_a_cone_as_sharp() -> None:
    """From ten times and a thousand times nearer than the sphere's distance from the camera."""
    world = world_of({"shape": {"kind": "sphere", "radius_mm": 5.0}, "position_mm": PLACE.tolist()})
    for away in (30.0, 5.3):
        for share, meets in ((-1e-7, True), (1e-7, False)):
            angle = np.arcsin(5.0 / away) * (1.0 + share)
            ways = np.stack([np.cos(angle) + 0.0 * TURN, np.sin(angle) * np.cos(TURN), np.sin(angle) * np.sin(TURN)], 1)
            met, _ = ends(world, np.broadcast_to(PLACE - [away, 0, 0], ways.shape).copy(), ways)
            assert (met == meets).all()


def test_flat_facets_still_are_a_mesh_and_planes_and_boxes_are_one_anyway() -> None:
    shape, outline, way = OUTLINES["sphere"]
    flat = world_of({"shape": shape, "position_mm": PLACE.tolist()}, surface="flat")
    assert flat.tables.objects.rounds is None
    met, _ = ends(flat, *along(outline, way, -NARROW))
    assert 0 < met.sum() < len(outline)
    box = {"shape": {"kind": "box", "size_mm": [5.0, 5.0, 5.0]}, "position_mm": PLACE.tolist()}
    assert world_of(box).tables.objects.rounds is None


def test_what_comes_first_is_met_where_balls_cut_a_table_and_each_other() -> None:
    """Against the least distance of all: on one side of a contact the ball comes first, on the other the table."""
    table = PLACE[2] - 5.0
    centres = PLACE + np.array([[0.0, 0.0, 0.0], [6.0, 0.0, -3.0], [-8.0, 4.0, -5.0]])
    world = world_of(
        {"shape": {"kind": "plane", "width_mm": 60.0, "height_mm": 60.0}, "position_mm": [*PLACE[:2], table]},
        *({"shape": {"kind": "sphere", "radius_mm": 5.0}, "position_mm": each.tolist()} for each in centres),
    )
    draw = np.random.default_rng(1)
    starts = PLACE + draw.uniform([-40, -40, 20], [40, 40, 60], (20_000, 3))
    aims = np.column_stack([PLACE[:2] + draw.uniform(-12, 12, (len(starts), 2)), np.full(len(starts), table)])
    ways = (aims - starts) / np.linalg.norm(aims - starts, axis=1, keepdims=True)
    first = (table - starts[:, 2]) / ways[:, 2]
    for centre in centres:
        p = starts - centre
        b = (p * ways).sum(axis=1)
        room = b * b - (p * p).sum(axis=1) + 25.0
        first = np.minimum(first, np.where(room >= 0.0, -b - np.sqrt(np.maximum(room, 0.0)), np.inf))
    met, place = ends(world, starts, ways)
    assert met.all()
    np.testing.assert_allclose(place, starts + first[:, None] * ways, rtol=0, atol=1e-9)


@pytest.mark.parametrize("inside", [False, True])
def test_a_ball_in_glass_and_one_behind_a_pane_are_met_where_they_stand(inside: bool) -> None:
    """Along the normals of the glass, which bends nothing."""
    deep, glass = (40.0, PLACE) if inside else (4.0, PLACE + np.array([0.0, 0.0, 20.0]))
    world = world_of(
        {"shape": {"kind": "sphere", "radius_mm": 5.0}, "position_mm": PLACE.tolist()},
        {"refractor": {"box_mm": [60.0, 60.0, deep], "index": 1.5}, "position_mm": glass.tolist()},
    )
    x, y = 20.0 * (np.random.default_rng(2).random((2, 400)) - 0.5)
    starts = PLACE + np.stack([x, y, np.full(len(x), 100.0)], axis=1)
    met, place = ends(world, starts, np.broadcast_to(-BACK, starts.shape).copy())
    on = np.hypot(x, y) < 5.0
    np.testing.assert_array_equal(met, on)
    height = np.sqrt(25.0 - x[on] ** 2 - y[on] ** 2)
    np.testing.assert_allclose(place[on], starts[on] - (100.0 - height)[:, None] * BACK, rtol=0, atol=1e-9)


@pytest.mark.parametrize("angle", [20.0, 60.0, 100.0])
def test_a_lit_sphere_shows_lamberts_phase_law(angle: float) -> None:
    """At an angle α from parallel light a sphere shines 2 / (3 π) (sin α + (π − α) cos α) times as a facing disk.

    The disk is lit at 35°. Each pixel's cone and the sphere's size average over less than 0.04 rad.
    """

    def scene(shape: dict[str, Any], degrees: float) -> lf.Scene:
        a = np.radians(degrees)
        lamp = {"kind": "directional", "direction": [np.sin(a), 0.0, -np.cos(a)], "irradiance_w_m2": 3.0}
        target = {"shape": shape, "position_mm": [0.0, 0.0, -60.0], "material": {"reflectance": 0.6}}
        return patch([lamp]).changed({"targets": [target]})

    ball, disk = ({"kind": kind, "radius_mm": 0.05} for kind in ("sphere", "disk"))
    alpha = np.radians(angle)
    lit, facing = (
        np.array([image.mean.sum() for image in by_seed(one, range(24))])
        for one in (scene(ball, angle), scene(disk, 35.0))
    )
    law = 2.0 / (3.0 * np.pi) * (np.sin(alpha) + (np.pi - alpha) * np.cos(alpha)) / np.cos(np.radians(35.0))
    expected = law * facing.mean()
    assert stats.sem(lit) < 8e-3 * expected
    spread = lit - law * (facing - facing.mean())
    assert_means(spread[:, None], np.array([expected]), 2e-3)


def wall_factor(radius: float, aside: float, low: float, high: float) -> float:
    """Form factor from an element at the origin, facing +z, to the wall of a cylinder about a line parallel to z."""
    nodes, weights = np.polynomial.legendre.leggauss(80)
    # It sees the part of the wall whose normal turns to it.
    edge = np.arccos(-radius / aside)
    turn, height = np.meshgrid(np.pi + (np.pi - edge) * nodes, 0.5 * (low + high) + 0.5 * (high - low) * nodes)
    x, y = aside + radius * np.cos(turn), radius * np.sin(turn)
    r2 = x * x + y * y + height**2
    towards = -(x * np.cos(turn) + y * np.sin(turn))
    area = radius * (np.pi - edge) * 0.5 * (high - low) * np.outer(weights, weights)
    return float((area * towards * height / (np.pi * r2 * r2)).sum())


@pytest.mark.parametrize("kind", ["disk", "cylinder"])
def test_a_glowing_disk_and_cylinder_light_a_patch_by_their_form_factors(kind: str) -> None:
    shapes = {"disk": {"radius_mm": 8.0}, "cylinder": {"radius_mm": 3.0, "height_mm": 8.0}}
    place = {"disk": [0.0, 12.0, -35.0], "cylinder": [9.0, 0.0, -50.0]}[kind]
    factors = {
        "disk": disk_factor(25.0, 12.0, 8.0),
        "cylinder": disk_factor(6.0, 9.0, 3.0) + wall_factor(3.0, 9.0, 6.0, 14.0),
    }
    glow = {"shape": {"kind": kind} | shapes[kind], "position_mm": place,
            "material": {"reflectance": 0.0, "radiance_w_m2_sr": 7.0}}  # fmt: skip
    expected = np.pi * 7.0 * factors[kind]
    found = irradiances(patch([], [glow]), 32)
    assert stats.sem(found) < 0.01 * expected
    assert_means(found[:, None], np.array([expected]), 2e-4)
