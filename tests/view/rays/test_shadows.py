"""Ghosts by sequence behind targets that hide part of the lens: against areas, sums over parts, and traced rays."""

import math

import numpy as np
import pytest
from scipy import stats

import lfmesh as lf
from lfmesh.analysis.quadrature import integral
from lfmesh.view.rays.exact_ghosts import exact_ghosts, exact_of, refusal
from lfmesh.view.rays.launch import from_field_point

POINT = (4.0, 3.0, -500.0)
LEVEL = 1e-3
"""Of all comparisons together."""


@pytest.fixture(scope="module")
def scene():
    """A doublet with its stop on its first surface, 9.5 mm wide."""
    surfaces = (
        lf.Surface(radius_mm=60.0, thickness_mm=4.0, index=1.52, semi_diameter_mm=4.75, stop=True),
        lf.Surface(radius_mm=-45.0, thickness_mm=2.0, index=1.62, semi_diameter_mm=8.0),
        lf.Surface(radius_mm=-160.0, semi_diameter_mm=8.0),
    )
    camera = lf.Camera(
        lens=lf.Lens(surfaces=surfaces),
        focus_mm=500.0,
        sensor=lf.Sensor(pixels=(100, 100), pixel_mm=0.05),
    )
    return lf.Scene(camera=camera)


def board(x=0.0, y=0.0, width=200.0, height=200.0, z=-300.0, **material):
    return {
        "name": "board",
        "shape": {"kind": "plane", "width_mm": width, "height_mm": height},
        "position_mm": (x, y, z),
        "material": {"reflectance": 0.0} | material,
    }


def behind(scene, *targets, point=POINT):
    return exact_ghosts(lf.build(scene.changed({"targets": list(targets)})), point)


@pytest.fixture(scope="module")
def open_lens(scene):
    return behind(scene)


def rows_of(exact):
    return np.array([(row.power, row.error) for row in (exact.image, exact)])


def test_nothing_reaches_the_sensor_behind_an_opaque_board(scene):
    exact = behind(scene, board())
    assert exact.image.power == exact.power == exact.image.error == exact.error == 0.0
    assert "image path 0.00000e+00 W" in exact.lines()[-2]
    assert "0.0000e+00 W" in exact.lines()[-2]


@pytest.mark.parametrize("target", [board(x=150.0), board(z=-700.0), board(x=60.0, width=100.0)])
def test_a_board_beside_the_beam_or_behind_the_point_changes_nothing(scene, open_lens, target):
    np.testing.assert_array_equal(rows_of(behind(scene, target)), rows_of(open_lens))


@pytest.mark.parametrize("turn", [0.0, 0.4])
def test_two_boards_that_meet_share_the_light_of_the_open_lens(scene, open_lens, turn):
    """An edge across the pupil: what the one lets past, the other hides. Also where the board is square to no axis."""
    parts = []
    for side in (-1.0, 1.0):
        target = board(x=2.0 + side * 50.0 * math.cos(turn), y=1.0 + side * 50.0 * math.sin(turn), width=100.0)
        parts.append(rows_of(behind(scene, target | {"rotation_deg": (0.0, 0.0, math.degrees(turn))})))
    total, whole = np.sum(parts, axis=0), rows_of(open_lens)
    assert (np.array(parts)[:, 0, 0] > 0.1 * whole[0, 0]).all()
    assert (np.abs(total - whole)[:, 0] <= total[:, 1] + whole[:, 1]).all()
    assert total[0, 1] < 0.01 * whole[0, 0]


@pytest.mark.parametrize("width", [0.05, 2e-3])
def test_a_wire_hides_its_share_or_counts_as_error(scene, open_lens, width):
    """Of 2 µm, narrower than the smallest cells are."""
    exact = behind(scene, board(x=1.6, width=width))
    # The wire's shadow on the pupil's plane is 2.5 times as wide, across a disk that the marginal ray bounds.
    lost = open_lens.image.power - exact.image.power
    share = 2.5 * width * 2.0 / (math.pi * 4.75)
    error = exact.image.error + open_lens.image.error
    assert abs(lost - share * open_lens.image.power) < error + 0.4 * share * open_lens.image.power
    assert width == 2e-3 or error < 0.5 * share * open_lens.image.power


def test_what_a_ball_leaves_of_the_light_is_what_traced_rays_bring(scene):
    """A z-test of the image path and all ghosts of two reflections together, with eight launches."""
    ball = {
        "shape": {"kind": "sphere", "radius_mm": 1.2},
        "position_mm": (2.0, 0.5, -200.0),
        "material": {"reflectance": 0.0},
    }
    world = lf.build(scene.changed({"targets": [ball]}))
    exact = exact_ghosts(world, POINT)
    found = []
    for seed in range(8):
        rays = from_field_point(world, POINT, 400, aim="lens", seed=seed, weight_cutoff=1e-3)
        chosen = [rays.of_sequences(words) for words in ({exact.image.words}, {row.words for row in exact.ghosts})]
        found.append([float((rays.end_power * rays.arrives)[each].sum()) for each in chosen])
    error = np.std(found, axis=0, ddof=1) / math.sqrt(8)
    off = np.abs(np.mean(found, axis=0) - rows_of(exact)[:, 0])
    assert (off <= stats.t.isf(0.25 * LEVEL, 7) * error + rows_of(exact)[:, 1]).all(), (off, error)


@pytest.mark.parametrize(
    "target",
    [
        board(opacity=0.5),
        {"name": "board", "refractor": {"box_mm": (30.0, 30.0, 3.0), "index": 1.5}, "position_mm": (0.0, 0.0, -300.0)},
    ],
)
def test_a_target_in_the_way_that_lets_light_through_is_named_and_one_beside_the_beam_is_not(scene, target):
    world = lf.build(scene.changed({"targets": [target]}))
    assert "board" in refusal(world, [POINT])
    with pytest.raises(lf.LfmeshError, match="board"):
        exact_ghosts(world, POINT)
    if "refractor" not in target:
        assert exact_of(from_field_point(world, POINT, 20, aim="lens")) is None
    aside = lf.build(scene.changed({"targets": [target | {"position_mm": (150.0, 0.0, -300.0)}]}))
    assert refusal(aside, [POINT]) is None


class Strips:
    """Shade of narrow strips square to x, from −1 to 1 along y."""

    def __init__(self, *strips):
        self.strips = strips

    @property
    def edges(self):
        return np.array([[[x, -2.0], [x, 2.0]] for strip in self.strips for x in strip])

    def hides(self, at):
        return np.any([(at[:, 0] > low) & (at[:, 0] < high) for low, high in self.strips], axis=0)


@pytest.mark.parametrize(
    "strips", [[(-2.0, 0.1)], [(0.1, 0.1005)], [(-2.0, 0.1), (0.1007, 2.0)], [(0.3, 0.5), (0.5001, 0.6)]]
)
def test_the_error_of_an_integral_holds_what_shadows_and_slits_narrower_than_cells_change(strips):
    """Over the unit disk, of 1: the area that strips leave is known; slits are down to a twentieth of the last cell."""

    def disk(at):
        return np.where((at * at).sum(axis=1) < 1.0, 1.0, -1.0)

    def up_to(x):
        x = float(np.clip(x, -1.0, 1.0))
        return x * math.sqrt(1.0 - x * x) + math.asin(x)

    hidden = sum(up_to(high) - up_to(low) for low, high in strips)
    found = integral(disk, 1.0, Strips(*strips))
    assert abs(found.value - (math.pi - hidden)) <= found.error
    assert found.error < 0.02
