"""Rays along sequences with reflections against the same paths as the mesh engine recorded them."""

from itertools import pairwise

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.scene import load_lens
from lfmesh.transport.sequences.ray_tables import follow_sequence
from lfmesh.transport.sequences.sequences import Itinerary, reflected_twice_at, two_reflections
from lfmesh.view.rays.launch import from_field_point

POSITION_MM = 1e-9
WEIGHT = 1e-11


def posed(lens):
    """The lens with its first and last element tilted and decentred."""
    poses = (
        lf.scene.Pose(shift_mm=(0.02, -0.05, 0.0), tilt_deg=(0.3, -0.2, 0.0)),
        lf.scene.Pose(shift_mm=(-0.04, 0.01, 0.02), tilt_deg=(-0.1, 0.25, 0.0)),
    )
    groups = ((0, 1), (len(lens.surfaces) - 2, len(lens.surfaces) - 1))
    elements = [lf.scene.Element(surfaces=group, pose=pose) for group, pose in zip(groups, poses, strict=True)]
    return lens.model_copy(update={"elements": tuple(elements)})


def world_of(name, change=lambda lens: lens):
    camera = lf.Camera(
        lens=change(load_lens(asset_path(f"lenses/{name}.toml"))),
        sensor=lf.Sensor(pixels=(4000, 4000), pixel_mm=0.02, distance_mm=30.0),
    )
    return lf.build(lf.Scene(camera=camera, transport={"engine": "mesh"}))


def hollow(world):
    """Every lens surface from both sides: what is not hollow lets no ray pass."""
    return [(k, behind) for k in range(len(world.lens_shape.surfaces)) for behind in (False, True)]


def paths_of(world):
    return list(two_reflections(len(world.lens_shape.surfaces), hollow(world)))


# A lens, what is changed about it, a point before it, and how many paths are compared at least.
CASES = [
    ("double_gauss_50mm", lambda lens: lens, (10.0, 5.0, -300.0), 300),
    ("double_gauss_50mm", posed, (-20.0, 5.0, -300.0), 200),
    ("cooke_triplet_50mm", lambda lens: lens, (10.0, 5.0, -300.0), 200),
    ("asphere_100mm", lambda lens: lens, (5.0, 8.0, -200.0), 50),
    ("ball_10mm", lambda lens: lens, (1.0, 2.0, -15.0), 5),
]


@pytest.mark.parametrize(
    ("name", "change", "point", "least"),
    [pytest.param(*case, marks=[pytest.mark.long] if number == 0 else []) for number, case in enumerate(CASES)],
)
def test_paths_of_two_reflections_are_those_of_the_mesh_engine(name, change, point, least):
    """Where recorded paths end and which share of the power they carry; and no ray passes along a path of none."""
    world = world_of(name, change)
    # Nothing is left to the roulette down to three reflections of 4 %.
    rays = from_field_point(world, point, 200, aim="lens", weight_cutoff=1e-5)
    tables = world.tables
    count = len(world.lens_shape.surfaces)
    start = np.array(point)
    mirrored = rays.keep(rays.arrives & (rays.count_vertices(rays.reflected) == 2))
    recorded = {}
    for path in range(len(mirrored)):
        part = slice(mirrored.offsets[path] + 1, mirrored.offsets[path + 1] - 1)
        faces = tuple(int(k) - 1 for k in mirrored.surface[part])
        recorded.setdefault(Itinerary(faces, tuple(mirrored.event[part] == lf.Event.REFLECTED)), []).append(path)
    expected = set(paths_of(world))
    # A path that is reflected at a face that it has just left, and elsewhere, is none of these: see `paths.automaton`.
    others = {path for path in recorded if any(one == next_one for one, next_one in pairwise(path.faces))} - expected
    assert set(recorded) <= expected | others
    assert sum(len(recorded[path]) for path in others) < 0.01 * len(mirrored)
    assert len(recorded) >= count * (count - 1) // 3
    step = rays.position[rays.offsets[:-1] + 1] - start
    goes = np.flatnonzero(np.linalg.norm(step, axis=1) > 0.0)
    source, at = np.unique(rays.source[goes], return_index=True)
    launched = step[goes[at]] / np.linalg.norm(step[goes[at]], axis=1)[:, None]
    z = float(world.scene.camera.lens.vertices_mm[-1] + world.scene.camera.sensor.distance_mm)
    compared = 0
    for path in expected:
        got = follow_sequence(tables, path, np.tile(start, (len(launched), 1)), launched)
        landed = got.position + ((z - got.position[:, 2]) / got.direction[:, 2])[:, None] * got.direction
        on_sensor = (np.abs(landed[:, :2]) < 40.0).all(axis=1) & (got.direction[:, 2] > 0.0)
        passed = set(source[(got.weight > 0.0) & on_sensor])
        rows = np.array(recorded.get(path, []), np.int64)
        power = mirrored.end_power[rows] / mirrored.power[mirrored.offsets[rows]]
        # Of those below the roulette's floor some are missing, others raised.
        certain = {s for s in passed if got.weight[np.searchsorted(source, s)] > 1e-5}
        assert certain <= set(mirrored.source[rows]) <= passed, path
        place = np.searchsorted(source, mirrored.source[rows])
        ends = mirrored.offsets[1:][rows] - 1
        np.testing.assert_allclose(mirrored.position[ends], landed[place], atol=POSITION_MM)
        sure = got.weight[place] > 1e-5
        np.testing.assert_allclose(power[sure], got.weight[place][sure], rtol=WEIGHT)
        compared += len(rows)
    assert compared > least


def test_light_runs_along_the_inside_of_a_ball():
    """Reflected twice running at the hollow far side: in a plane through the centre, by equal chords."""
    world = world_of("ball_10mm")
    heights = np.linspace(3.0, 4.4, 800)
    p = np.column_stack([heights, np.zeros_like(heights), np.full_like(heights, -5.0)])
    got = follow_sequence(
        world.tables, reflected_twice_at(2, 1, from_behind=False), p, np.tile([0.0, 0.0, 1.0], (len(p), 1))
    )
    # A parallel ray of height h enters at the angle a, sin a = h/R, and every chord turns it by 2b, sin b = sin a / n.
    a = np.arcsin(heights / 5.0)
    b = np.arcsin(heights / 5.0 / 1.5)
    turns = [np.pi - a + k * (np.pi - 2.0 * b) for k in range(4)]
    aperture = np.arcsin(4.5 / 5.0)
    # Angles from the vertex of the far side, of the three points there.
    there = [np.abs(np.angle(np.exp(1j * turn))) for turn in turns[1:]]
    expected = np.all([angle <= aperture for angle in there], axis=0) & (a <= aperture)
    np.testing.assert_array_equal(got.weight > 0.0, expected)


DEEP_MM, RIM_MM = 8.2, 8.0


def along_deep_bowl(faces, reflected):
    """Weights of axial rays through a plane into glass with a deep bowl behind, and their polar angles on the bowl."""
    surfaces = (
        lf.Surface(radius_mm=np.inf, thickness_mm=7.0, index=1.5, semi_diameter_mm=20.0, stop=True),
        lf.Surface(radius_mm=-DEEP_MM, semi_diameter_mm=RIM_MM),
    )
    sensor = lf.Sensor(pixels=(10, 10), pixel_mm=0.1, distance_mm=30.0)
    world = lf.build(lf.Scene(camera=lf.Camera(lens=lf.Lens(surfaces=surfaces), sensor=sensor)))
    heights = np.linspace(0.5, 5.7, 400)
    p = np.column_stack([heights, np.zeros_like(heights), np.full_like(heights, -5.0)])
    got = follow_sequence(world.tables, Itinerary(faces, reflected), p, np.tile([0.0, 0.0, 1.0], (len(p), 1)))
    # Off the border between both fates, where the rim reaches a little beyond the aperture.
    angle = np.arcsin(heights / DEEP_MM)
    again = DEEP_MM * np.sin(3.0 * angle)
    certain = np.abs(again - RIM_MM) > 0.05 * RIM_MM
    return got.weight[certain], angle[certain], ((again < RIM_MM) & (3.0 * angle > 0.5 * np.pi))[certain]


def test_a_ray_that_meets_its_own_surface_first_is_on_no_path_to_the_next():
    """Reflected at the polar angle a, a ray meets the bowl again at 3a − π, if that lies within the rim."""
    weight, angle, returns = along_deep_bowl((0, 1, 0), (False, True, True))
    # Where the line to the plane meets it within its aperture, too.
    z, r = 7.0 - DEEP_MM * (1.0 - np.cos(angle)), DEEP_MM * np.sin(angle)
    within = np.abs(r - z * np.tan(2.0 * angle)) < 20.0
    assert (returns & within).sum() > 10
    np.testing.assert_array_equal(weight > 0.0, within & ~returns)


def test_a_path_does_not_end_before_its_last_surface_is_met_again():
    weight, _, returns = along_deep_bowl((0, 1), (False, True))
    assert 10 < returns.sum() < len(returns) - 10
    np.testing.assert_array_equal(weight > 0.0, ~returns)


def test_the_half_of_a_sphere_beyond_its_equator_is_no_surface():
    front = lf.Surface(radius_mm=10.0, thickness_mm=5.0, index=1.5, semi_diameter_mm=8.0, stop=True)
    back = lf.Surface(radius_mm=np.inf, semi_diameter_mm=8.0)
    sensor = lf.Sensor(pixels=(10, 10), pixel_mm=0.1, distance_mm=30.0)
    world = lf.build(lf.Scene(camera=lf.Camera(lens=lf.Lens(surfaces=(front, back)), sensor=sensor)))
    starts, ahead = [[2.0, 0.0, -5.0], [30.0, 0.0, 19.0]], [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]]
    got = follow_sequence(world.tables, Itinerary((0,), (False,)), np.array(starts), np.array(ahead))
    assert (got.weight > 0.0).tolist() == [True, False]


@pytest.mark.parametrize(("name", "change", "point", "least"), CASES)
def test_a_path_and_its_reverse_carry_the_same_share(name, change, point, least):
    world = world_of(name, change)
    tables = world.tables
    draw = np.random.default_rng(3)
    rim = float(tables.lens.surfaces[0]["semi_diameter"])
    to = np.column_stack([draw.uniform(-rim, rim, (400, 2)), np.zeros(400)]) - point
    d = to / np.linalg.norm(to, axis=1)[:, None]
    passed = 0
    for path in paths_of(world):
        there = follow_sequence(tables, path, np.tile(np.array(point), (400, 1)), d)
        through = there.weight > 0.0
        # From behind the lens, clear of its last surface.
        beyond = there.position[through] + 20.0 * there.direction[through]
        back = follow_sequence(tables, path.reverse, beyond, -there.direction[through])
        np.testing.assert_allclose(back.direction, -d[through], atol=1e-10)
        np.testing.assert_allclose(back.weight, there.weight[through], rtol=1e-8)
        passed += through.sum()
    assert passed > least
