"""Rays through media that bend light, by `lf.trace`, against closed forms in 30 digits.

- Gaussian ball, n = 1 + δ exp(−r²/w²), weak and strong: Bouguer's law, n r sin θ is constant (M. Born and E. Wolf,
  Principles of Optics, 3.2.1).
- Parabolic duct, n² = n₀² (1 + c r²): rays are harmonic in σ, dσ = ds/n (E. W. Marchand, Gradient Index Optics,
  Academic Press 1978).
- An index that is linear in y, by formula and on a grid: n is a hyperbolic cosine of σ, and rays are nearly catenaries.
- Mirage above a hot plate, n² = n₀² − A exp(−y/l).

A face across z keeps the components of T along it, so that the closed forms begin and end with rays in air. Media are
turned and shifted: their closed forms hold in their own frame.
"""

import math
from pathlib import Path
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import lfmesh as lf
from tests.optics.closed_fields import (
    DIGITS,
    ball_deflection,
    in_duct,
    in_linear_index,
    over_hot_plate,
)
from tests.validation.field_scenes import (
    FOCAL_MM,
    FOCUS_MM,
    NM,
    PIXEL_MM,
    POSE,
    Tables,
    assert_on_lines,
    ball_of,
    box_of,
    camera,
    entered,
    from_sines,
    grid_of,
    in_world,
    nodes,
    scene_of,
    sent,
    turn,
)

Array = NDArray[np.float64]

# The balls have grids at the limit, whose error is stated and is that of the tests.
pytestmark = pytest.mark.filterwarnings("ignore::lfmesh.errors.CoarseFieldWarning")

WEAK, STRONG = 2e-4, 0.1
WIDTH = 8.0
IMPACTS = WIDTH * np.linspace(0.15, 1.5, 10)

FORMULA_MM, FORMULA = 1e-4, 1e-7
"""Largest errors behind fields that are formulas: 1e-6 of deflections by up to 0.04 over 2 m, the error of the steps,
with room for rays longer than the probes."""


# A Gaussian ball


def past_ball(*, along_z: bool) -> tuple[Array, Array]:
    """Return directions of rays past a ball, and the unit vectors across that point from its centre to them."""
    draw = np.random.default_rng(3)
    along = np.tile([0.0, 0.0, 1.0], (len(IMPACTS), 1)) if along_z else draw.normal(size=(len(IMPACTS), 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along, draw.normal(size=along.shape))
    return along, across / np.linalg.norm(across, axis=1, keepdims=True)


def deflection_errors(medium: Tables, delta: float, folder: Path, *, along_z: bool) -> Array:
    """Return the errors of the deflection by a ball, over the largest deflection; rays stay in their planes."""
    along, across = past_ball(along_z=along_z)
    world = lf.build(scene_of(medium, folder=folder))
    ends = sent(world, IMPACTS[:, None] * across - 200.0 * along, along)
    truth = np.array([ball_deflection(delta, WIDTH, impact) for impact in IMPACTS])
    np.testing.assert_allclose(ends.weight, 1.0, rtol=0.0, atol=1e-12)
    towards = -np.einsum("ij,ij->i", ends.along, across)
    found = np.arctan2(towards, np.einsum("ij,ij->i", ends.along, along))
    beside = np.abs(np.einsum("ij,ij->i", ends.along, np.cross(along, across)))
    return np.concatenate([np.abs(found - truth), beside]) / truth.max()


@pytest.mark.parametrize("delta", [WEAK, STRONG])
def test_rays_past_a_gaussian_ball_turn_by_bouguers_law(delta: float, tmp_path: Path) -> None:
    """Within the error of a grid whose voxels are an eighth of the ball's radius, in any direction and in line."""
    medium = ball_of(tmp_path, delta, WIDTH, 93)
    assert np.sqrt((deflection_errors(medium, delta, tmp_path, along_z=False) ** 2).mean()) < 6e-5
    assert deflection_errors(medium, delta, tmp_path, along_z=True).max() < 2.6e-4


def test_the_error_of_the_grid_has_the_third_order(tmp_path: Path) -> None:
    coarse, fine = (
        deflection_errors(ball_of(tmp_path, WEAK, WIDTH, count, spacing), WEAK, tmp_path, along_z=True).max()
        for count, spacing in ((61, 1.6), (121, 0.8))
    )
    assert 2.6 < np.log2(coarse / fine) < 3.6


def test_a_ray_that_is_sent_back_returns(tmp_path: Path) -> None:
    """Within the error of the steps."""
    along, across = past_ball(along_z=False)
    world = lf.build(scene_of(ball_of(tmp_path, WEAK, WIDTH, 93), folder=tmp_path))
    start = IMPACTS[:, None] * across - 200.0 * along
    there = sent(world, start, along)
    back = sent(world, there.at + 5.0 * there.along, -there.along)
    largest = ball_deflection(WEAK, WIDTH, 0.7 * WIDTH)
    assert_on_lines(back, start, -along, 3e-5 * largest * 400.0, 3e-5 * largest)


# Ducts, linear indices, mirages

DUCT_INDEX, DUCT_POWER, DUCT_MM = 1.0006, -2e-6, 1000.0
DUCT: Tables = {"kind": "radial_n2", "index": DUCT_INDEX, "coefficients": [DUCT_POWER]}
RATES = DUCT_INDEX * math.sqrt(-DUCT_POWER) * np.array([1.0, 1.0, 0.0])
POINTS = np.array([[12.0, 0.0], [0.0, -8.0], [4.0, 3.0], [-9.0, 7.0], [0.0, 0.0], [5.0, -11.0]])
SINES = np.array([[0.0, 0.0], [0.0, 0.01], [0.006, -0.008], [0.01, 0.002], [-0.007, 0.005], [0.0, 0.0]])


def duct_square(at: Array) -> Array:
    return np.asarray(DUCT_INDEX**2 * (1.0 + DUCT_POWER * (at[:, :2] ** 2).sum(axis=1)))


def through_duct(rays: Array, length: float) -> Array:
    """Return position and T, (n, 6), of rays in the duct, a length behind their points along z."""
    return np.array([in_duct(ray, RATES, mp.mpf(length) / mp.mpf(float(ray[5]))) for ray in rays])


def duct(length: float = DUCT_MM, **keys: Any) -> Tables:
    return box_of((40.0, 40.0, length), index=DUCT, **keys)


def at_front(length: float = DUCT_MM) -> Array:
    """Return the points of the rays on a front face."""
    return np.column_stack([POINTS, np.full(len(POINTS), -0.5 * length)])


def test_rays_in_a_parabolic_duct_are_harmonic() -> None:
    """Meridional and skew ones."""
    along = from_sines(SINES)
    truth = through_duct(entered(at_front(), along, duct_square), DUCT_MM)
    assert np.abs(truth[:, 3:5] - SINES).max() > 0.01
    ends = sent(lf.build(scene_of(duct())), at_front() - 30.0 * along, along)
    assert_on_lines(ends, truth[:, :3], from_sines(truth[:, 3:5]), FORMULA_MM, FORMULA)
    np.testing.assert_allclose(ends.weight, 1.0, rtol=0.0, atol=1e-12)


def test_rays_pass_fields_in_succession() -> None:
    """Three ducts with air between the first two, and with a common face of the other two."""
    lengths, centres = (300.0, 200.0, 250.0), np.array([-450.0, 0.0, 225.0])
    media = [
        duct(length, position_mm=in_world([0.0, 0.0, z]).tolist())
        for length, z in zip(lengths, centres, strict=True)
    ]  # fmt: skip
    along = from_sines(SINES)
    at = np.column_stack([POINTS, np.full(len(POINTS), -600.0)])
    rays = np.hstack([at, along])
    for length, z in zip(lengths, centres, strict=True):
        gap = z - 0.5 * length - rays[:, 2]
        rays[:, :3] += (gap / rays[:, 5])[:, None] * rays[:, 3:]
        behind = through_duct(entered(rays[:, :3], rays[:, 3:], duct_square), length)
        rays = np.hstack([behind[:, :3], from_sines(behind[:, 3:5])])
    ends = sent(lf.build(scene_of(*media)), at - 30.0 * along, along)
    assert_on_lines(ends, rays[:, :3], rays[:, 3:], FORMULA_MM, FORMULA)


def test_a_ray_may_start_inside_a_field() -> None:
    """Its given direction is the true one there: T is n times it."""
    along = from_sines(SINES)
    at = np.column_stack([POINTS, np.full(len(POINTS), -120.0)])
    rays = np.hstack([at, np.sqrt(duct_square(at))[:, None] * along])
    truth = through_duct(rays, 0.5 * DUCT_MM + 120.0)
    ends = sent(lf.build(scene_of(duct())), at, along)
    assert_on_lines(ends, truth[:, :3], from_sines(truth[:, 3:5]), FORMULA_MM, FORMULA)


def test_a_target_in_a_field_is_hit_where_the_curve_meets_it() -> None:
    """Within a hundredth of a pixel's footprint, though rays run on chords."""
    depth = 260.0
    wall = {
        "shape": {"kind": "plane", "width_mm": 80.0, "height_mm": 80.0}, "material": {"reflectance": 0.0}, **POSE,
        "position_mm": in_world([0.0, 0.0, depth]).tolist(),
    }  # fmt: skip
    along = from_sines(SINES)
    truth = through_duct(entered(at_front(), along, duct_square), 0.5 * DUCT_MM + depth)
    ends = sent(lf.build(scene_of(duct(), targets=[wall])), at_front() - 30.0 * along, along)
    assert (ends.paths.status == lf.Status.TARGET).all()
    footprint = PIXEL_MM * FOCUS_MM / FOCAL_MM
    straight = at_front() + (0.5 * DUCT_MM + depth) / along[:, 2:] * along
    assert np.linalg.norm(straight - truth[:, :3], axis=1).max() > 0.5 * footprint
    assert np.linalg.norm(ends.at - truth[:, :3], axis=1).max() < 0.011 * footprint


def test_a_speck_in_a_corner_of_a_field_changes_no_ray_that_misses_it() -> None:
    """With it, each chord is a query of its own."""
    speck = {
        "shape": {"kind": "disk", "radius_mm": 0.01}, "material": {"reflectance": 0.0},
        "position_mm": in_world([19.0, 19.0, 450.0]).tolist(),
    }  # fmt: skip
    along = from_sines(SINES)
    free, shared = (
        sent(lf.build(scene_of(duct(), targets=targets)), at_front() - 30.0 * along, along) for targets in ([], [speck])
    )
    assert_on_lines(shared, free.at, free.along, FORMULA_MM, FORMULA)


def test_a_ray_behind_a_field_enters_the_lens() -> None:
    """An ideal lens images it by x = a + s (m − a/f), of the slope m and the height a at the lens."""
    sensor = 80.0
    given = camera(semi_mm=60.0, pixels=200, pixel_mm=1.0)
    del given["focus_mm"]
    given["sensor"]["distance_mm"] = sensor
    middle: Tables = {"position_mm": (0.0, 0.0, -800.0), "rotation_deg": (0.0, 0.0, 0.0)}
    scene = scene_of(duct(**middle), camera=given)
    along = from_sines(SINES)
    truth = through_duct(entered(at_front(), along, duct_square), DUCT_MM)
    behind = from_sines(truth[:, 3:5])
    slope = behind[:, :2] / behind[:, 2:]
    height = truth[:, :2] + 300.0 * slope
    paths = lf.trace(lf.build(scene), at_front() + middle["position_mm"] - 30.0 * along, along, split="transmit")
    assert (paths.status == lf.Status.SENSOR).all()
    landed = height + sensor * (slope - height / FOCAL_MM)
    np.testing.assert_allclose(paths.position[:, :2], landed, rtol=0.0, atol=2.0 * FORMULA_MM)
    np.testing.assert_allclose(paths.weight, 1.0, rtol=0.0, atol=1e-12)


SLOPE, LINEAR_MM = 2e-5, 2000.0
LINEAR: Tables = {"kind": "xyz", "index": 1.0, "y_coefficients": [SLOPE]}
HEIGHTS = np.array([[0.0, -30.0], [10.0, -25.0], [-8.0, -20.0]])
LEVEL_SINES = np.array([[0.0, 0.0], [-0.004, -0.003], [0.005, 0.001]])


def linear_rays() -> tuple[Array, Array, Array]:
    """Return points on the front of a field whose index is linear in y, directions in air, and position and T there."""
    at = np.column_stack([HEIGHTS, np.full(len(HEIGHTS), -0.5 * LINEAR_MM)])
    along = from_sines(LEVEL_SINES)
    return at, along, entered(at, along, lambda p: (1.0 + SLOPE * p[:, 1]) ** 2)


def linear_medium(kind: str, folder: Path, **keys: Any) -> Tables:
    """Return an index that is linear in y, by formula or on a grid, whose splines are exact."""
    if kind == "formula":
        return box_of((60.0, 80.0, LINEAR_MM), index=LINEAR, **keys)
    shape, spacing = (4, 40, 50), (15.0, 2.0, 40.0)
    return grid_of(folder, spacing, index=1.0 + SLOPE * nodes(shape, spacing)[..., 1]) | keys


@pytest.mark.parametrize("kind", ["formula", "grid"])
def test_rays_in_a_linear_index_are_catenaries(kind: str, tmp_path: Path) -> None:
    at, along, rays = linear_rays()
    truth = np.array([in_linear_index(ray, 1.0, SLOPE, LINEAR_MM)[0] for ray in rays])
    ends = sent(lf.build(scene_of(linear_medium(kind, tmp_path), folder=tmp_path)), at - 40.0 * along, along)
    assert_on_lines(ends, truth[:, :3], from_sines(truth[:, 3:5]), FORMULA_MM, FORMULA)


@pytest.mark.parametrize("kind", ["formula", "grid"])
def test_absorption_follows_the_length_of_the_curve(kind: str, tmp_path: Path) -> None:
    """In the field itself, and in fog over its second half: the curve is 0.1 mm longer than its chord."""
    at, along, rays = linear_rays()
    whole, first = (
        np.array([in_linear_index(ray, 1.0, SLOPE, length)[1] for ray in rays])
        for length in (LINEAR_MM, 0.75 * LINEAR_MM)
    )
    own, of_fog = 1e-3, 4e-3
    fog = box_of((400.0, 400.0, 0.25 * LINEAR_MM), absorption_per_mm=of_fog)
    fog["position_mm"] = in_world([0.0, 0.0, 0.375 * LINEAR_MM]).tolist()
    field = linear_medium(kind, tmp_path, absorption_per_mm=own)
    ends = sent(lf.build(scene_of(field, fog, folder=tmp_path)), at - 40.0 * along, along)
    np.testing.assert_allclose(ends.weight, np.exp(-own * whole - of_fog * (whole - first)), rtol=1e-5)


def test_a_mirage_above_a_hot_plate(tmp_path: Path) -> None:
    """A ray that comes down turns upwards before it meets the plate, as in a puddle of sky on a road."""
    strength, height, spacing = 6e-4, 5.0, (60.0, 0.25, 20.0)
    count = (1, 160, 100)
    up = 15.0
    values = np.sqrt(1.0 - strength * np.exp(-(nodes(count, spacing)[..., 1] + up) / height))
    at, along = np.array([[0.0, 10.0 - up, -1000.0]]), from_sines([0.0, -0.01])
    ray = entered(at, along, lambda p: 1.0 - strength * np.exp(-(p[:, 1] + up) / height))[0]
    above = ray + np.array([0.0, up, 0.0, 0.0, 0.0, 0.0])
    y, rise = over_hot_plate(above, strength, height, 2000.0 / mp.mpf(float(ray[5])))
    assert rise > 0.012
    ends = sent(lf.build(scene_of(grid_of(tmp_path, spacing, index=values), folder=tmp_path)), at - 30.0 * along, along)
    assert_on_lines(ends, [[0.0, y - up, 1000.0]], from_sines([0.0, rise]), 1e-4, 1e-6)


# Faces

UNIFORM = 1.0005
"""Index of a uniform box: light inside is totally reflected within 1.81 degrees of grazing."""


def test_uniform_boxes_refract_by_snells_law() -> None:
    """Through opposite faces, and in by one and out by its neighbour, as in a prism."""
    size = np.array([40.0, 30.0, 50.0])
    along = np.array([[0.1, 0.2, 1.0], [0.5, 0.05, 0.8], [0.3, -0.6, 0.7]])
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    entry = np.array([[1.0, -2.0, -25.0], [15.0, 3.0, -25.0], [-5.0, -13.0, -25.0]])
    inside = entered(entry, along, lambda p: np.full(len(p), UNIFORM**2))[:, 3:]
    outs, exits = [], []
    for point, t in zip(entry, inside, strict=True):
        steps = (np.sign(t) * 0.5 * size - point) / t
        axis = int(np.argmin(steps))
        out = t.copy()
        out[axis] = np.sign(t[axis]) * math.sqrt(1.0 - (t @ t - t[axis] ** 2))
        outs.append(out)
        exits.append(point + steps[axis] * t)
    assert len({int(np.argmax(np.abs(at) / size)) for at in exits}) == 3
    world = lf.build(scene_of(box_of(size, index=UNIFORM)))
    ends = sent(world, entry - 20.0 * along, along)
    assert_on_lines(ends, exits, outs, 1e-9, 1e-12)
    assert np.abs(ends.along - along)[1:].max() > 1e-5


ANGLES = np.array([0.3, 0.9, 0.9999, 1.0001, 1.1, 3.0])
"""Angles between rays and a face, over the critical one."""
SIZE = (400.0, 60.0, 4000.0)


def on_upper_face(index: float, side: float) -> tuple[Array, Array]:
    """Return rays towards the middle of the face at y = 30, from above (side 1) or below (-1), and their sines there.

    The sines are those of the angles to the face: the largest ones that are turned back, and those that pass it.
    """
    angles = math.acos(min(index, 1.0 / index)) * ANGLES
    along = np.column_stack([0.0 * angles, -side * np.sin(angles), np.cos(angles)])
    return np.array([0.0, 30.0, 0.0]) - 100.0 * along, along


def across_y(ty: Array) -> Array:
    """Return directions in air in the plane x = 0 with a given component along y."""
    return np.column_stack([0.0 * ty, ty, np.sqrt(1.0 - ty**2)])


def test_thin_gas_turns_back_light_from_air_near_grazing() -> None:
    index = 1.0 - 4e-4
    at, along = on_upper_face(index, 1.0)
    ends = sent(lf.build(scene_of(box_of(SIZE, index=index))), at, along)
    # Light that passes leaves by the far face across z, which keeps T_y; the steepest ray by the lower face.
    passed = -np.sqrt((index**2 - along[3:, 2] ** 2).clip(0.0))
    assert (np.abs(passed) * 2000.0 < 60.0).tolist() == [True, True, False]
    truth = np.vstack([along[:3] * [1.0, -1.0, 1.0], across_y(passed[:2]), along[5:]])
    np.testing.assert_allclose(ends.along, truth, rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(ends.weight, 1.0, rtol=0.0, atol=1e-12)


def test_dense_gas_keeps_light_from_inside_near_grazing() -> None:
    index = 1.0 + 4e-4
    at, along = on_upper_face(index, -1.0)
    ends = sent(lf.build(scene_of(box_of(SIZE, index=index))), at, along)
    # Light that is turned back leaves by the far face across z, which keeps T_y.
    turned, passed = -index * along[:3, 1], np.sqrt(1.0 - (index * along[3:, 2]) ** 2)
    assert (np.abs(turned) * 2000.0 < 60.0).all()
    np.testing.assert_allclose(ends.along, across_y(np.append(turned, passed)), rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(ends.weight, 1.0, rtol=0.0, atol=1e-12)


def test_a_uniform_box_guides_light() -> None:
    """Totally reflected by its sides again and again, a ray leaves by the back with its slopes but for their signs."""
    size = np.array([2.0, 3.0, 3000.0])
    along = from_sines([[0.02, 0.015], [-0.01, 0.03], [0.025, 0.0]])
    entry = np.array([[0.3, -0.4, -1500.0], [0.0, 1.0, -1500.0], [-0.7, 0.2, -1500.0]])
    inside = entered(entry, along, lambda p: np.full(len(p), UNIFORM**2))[:, 3:]
    world = lf.build(scene_of(box_of(size, index=UNIFORM)))
    ends = sent(world, entry - 5.0 * along, along, max_events=1000)
    # Unfolded: the walls are mirrors.
    at, out = entry + (size[2] / inside[:, 2:]) * inside, along.copy()
    for axis in (0, 1):
        cells = np.round(at[:, axis] / size[axis])
        sign = np.where(cells % 2 == 0, 1.0, -1.0)
        assert np.abs(cells).max() > 5
        at[:, axis] = sign * (at[:, axis] - cells * size[axis])
        out[:, axis] *= sign
    assert_on_lines(ends, at, out, 1e-9, 1e-11)
    np.testing.assert_allclose(ends.weight, 1.0, rtol=0.0, atol=1e-12)


def test_rays_beside_a_field_are_straight(tmp_path: Path) -> None:
    """Those that miss its box, also where they run along its faces."""
    medium = ball_of(tmp_path, STRONG, WIDTH, 93)
    half = 46.5
    at = np.array([[half + 1e-6, 0.0, -90.0], [60.0, -80.0, 3.0], [0.0, -half - 1e-3, -90.0]])
    along = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    ends = sent(lf.build(scene_of(medium, folder=tmp_path)), at, along)
    assert_on_lines(ends, at, along, 1e-10, 1e-14)


def test_light_on_a_closed_orbit_is_trapped(tmp_path: Path) -> None:
    """Where n r has a maximum, a ray across the radius stays on its circle, and the ledger names the field.

    n r = r (1 + δ exp(−r²/w²)) has one inside the radius w √1.5 if δ exceeds e^1.5 / 2.
    """
    delta = 3.0
    root = float(mp.findroot(lambda s: delta * mp.exp(-s) * (2 * s - 1) - 1, 0.7))
    world = lf.build(scene_of(ball_of(tmp_path, delta, WIDTH, 121, 0.75), folder=tmp_path))
    start, along = in_world([[WIDTH * math.sqrt(root), 0.0, 0.0]]), np.array([[0.0, 0.6, 0.8]]) @ turn().T
    paths = lf.trace(world, start, along)
    trapped = {name: value for name, value in paths.ledger.absorbed.items() if name.startswith("trapped in media[0]")}
    assert sum(trapped.values()) == pytest.approx(1.0, rel=1e-12), paths.ledger.absorbed
    assert abs(paths.ledger.imbalance) < 1e-12


# Gases

AIR_K_KG_KJ = 0.28705287
"""Specific gas constant of dry air, kJ/(kg K) (ISO 2533)."""

VACUUM = {"camera.air": {"temperature_c": 20.0, "pressure_kpa": 0.0}}


def prism_index(medium: Tables, nm: float = NM, **changes: Any) -> float:
    """Return the index of a uniform box by the ray that it deflects, in by a face across z and out by one across x."""
    world = lf.build(scene_of({**box_of(40.0), **medium}, **changes))
    sine = 0.6
    along = from_sines([sine, 0.0])
    ends = sent(world, np.array([[15.0, 0.0, -20.0]]) - 5.0 * along, along, wavelength_nm=nm)
    # Squares of T: n² = sine² + T_z², of which the second face keeps T_z.
    return float(math.sqrt(sine**2 + ends.along[0, 2] ** 2))


def test_the_index_of_a_gas_is_gladstone_and_dales() -> None:
    """In vacuum, n − 1 = K ρ."""
    found = prism_index({"density_kg_m3": 2.0, "gladstone_dale_m3_kg": 2.4e-4}, **VACUUM)
    assert found - 1.0 == pytest.approx(4.8e-4, rel=1e-9)


@pytest.mark.parametrize(("nm", "constant"), [(703.4, 2.250e-4), (607.4, 2.259e-4), (407.9, 2.304e-4)])
def test_the_index_of_air_is_the_published_one_at_each_wavelength(nm: float, constant: float) -> None:
    """W. Merzkirch, Flow Visualization, Academic Press 1987: Gladstone-Dale constants of air, m³/kg."""
    found = prism_index({"density_kg_m3": 1.5}, nm, **VACUUM)
    assert found - 1.0 == pytest.approx(1.5 * constant, rel=1e-3)


def test_hot_air_is_an_ideal_gas_in_the_scenes_air() -> None:
    """n − 1 = K p/(R T), over the index of the air around at 20 °C and 101.325 kPa."""
    nm, constant = 607.4, 2.259e-4
    hot, around = (1.0 + constant * 101.325 / (AIR_K_KG_KJ * kelvin) for kelvin in (900.0, 293.15))
    found = prism_index({"temperature_k": 900.0, "pressure_kpa": 101.325}, nm)
    assert found - 1.0 == pytest.approx(hot / around - 1.0, rel=2e-3)


def test_air_like_that_around_bends_no_light() -> None:
    found = prism_index({"temperature_k": 293.15, "pressure_kpa": 101.325})
    assert found == pytest.approx(1.0, abs=1e-14)


K_YELLOW = 2.262e-4
"""Merzkirch's constant of air at 587.6 nm, interpolated, m³/kg."""

DENSE, CONSTANT, COOLEST = 0.8, 2.5e-4, 293.15
GAS_BALLS: dict[str, tuple[Tables, float, float]] = {
    # Keys, δ, and how well it is known. In vacuum, but for hot air, whose density is 0.4 of that around in the middle.
    "index": ({}, CONSTANT * DENSE, 0.0),
    "density_kg_m3": ({"gladstone_dale_m3_kg": CONSTANT}, CONSTANT * DENSE, 0.0),
    "temperature_k": ({"pressure_kpa": 101.325}, -0.6 * K_YELLOW * 101.325 / (AIR_K_KG_KJ * COOLEST), 1e-3),
}


@pytest.mark.parametrize("quantity", GAS_BALLS)
def test_quantities_of_a_grid_bend_light_by_the_index_that_they_give(quantity: str, tmp_path: Path) -> None:
    """Balls of index, of density, and of hot air, which spreads light."""
    keys, delta, known = GAS_BALLS[quantity]
    bump = np.exp(-(nodes(93) ** 2).sum(axis=-1) / WIDTH**2)
    values = {
        "index": 1.0 + delta * bump, "density_kg_m3": DENSE * bump, "temperature_k": COOLEST / (1.0 - 0.6 * bump)
    }[quantity]  # fmt: skip
    medium = grid_of(tmp_path, 1.0, **{quantity: values}) | keys
    along, across = past_ball(along_z=False)
    around = {} if quantity == "temperature_k" else VACUUM
    ends = sent(lf.build(scene_of(medium, folder=tmp_path, **around)), IMPACTS[:, None] * across - 200.0 * along, along)
    truth = np.array([ball_deflection(delta, WIDTH, impact) for impact in IMPACTS])
    found = -np.einsum("ij,ij->i", ends.along, across)
    within = (3e-4 + known) * np.abs(truth).max()
    np.testing.assert_allclose(found, np.sin(truth), rtol=0.0, atol=within)


def test_the_frame_of_the_tests_is_that_of_rotations_about_x_then_y_then_z() -> None:
    """Else the closed forms above would hold in a frame of their own."""
    x, y, z = (Rotation.from_euler(axis, angle, degrees=True) for axis, angle in
               zip("xyz", POSE["rotation_deg"], strict=True))  # fmt: skip
    np.testing.assert_allclose(in_world(np.eye(3)) - in_world([0.0, 0.0, 0.0]), (z * y * x).as_matrix().T, atol=1e-12)


def test_catenaries_in_thirty_digits_conserve_the_length_of_t() -> None:
    """The truth itself: |T| is the index at the end."""
    _, _, rays = linear_rays()
    with mp.workdps(DIGITS):
        for ray in rays:
            end, _ = in_linear_index(ray, 1.0, SLOPE, LINEAR_MM)
            assert abs(np.linalg.norm(end[3:]) - (1.0 + SLOPE * end[1])) < 1e-14
