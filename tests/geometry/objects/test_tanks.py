"""Tanks: what is behind their windows is seen where Snell's law puts it."""

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.accuracy.hard.outcome import SINGLET, lens_scene
from lfmesh.cli import main
from lfmesh.errors import SceneError
from lfmesh.geometry.frame import rotation
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.scene import Liquid, Plane, Tank, Target, Wall

WALL, WATER = 1.52, 1.333
SIZE, THICK = np.array([100.0, 80.0, 60.0]), 5.0
FAR, HALF_CHART = -400.0, 2e4
INSIDE = 12.0
"""Half the side of the plate in the water, mm."""


def tank_at(position, turn, side=None):
    return Tank(
        size_mm=tuple(SIZE), wall_mm=THICK, wall=Wall(index=WALL), liquid=Liquid(index=WATER), open=side,
        position_mm=position, rotation_deg=turn,
    )  # fmt: skip


def world_with(tank):
    """Build a camera before a tank with a plate in its middle, and a wide chart behind it."""
    chart = Target(
        name="chart", shape=Plane(width_mm=2 * HALF_CHART, height_mm=2 * HALF_CHART), position_mm=(0.0, 0.0, FAR)
    )
    plate = Target(
        name="plate", shape=Plane(width_mm=2 * INSIDE, height_mm=2 * INSIDE), position_mm=tank.position_mm,
        rotation_deg=tank.rotation_deg,
    )  # fmt: skip
    return lf.build(lens_scene(SINGLET, targets=(chart, plate)).changed({"tanks": [tank.model_dump()]}))


def boxes(side):
    """Return the lower and upper corners of walls and liquid in the tank's own frame."""
    low, high = -0.5 * SIZE + THICK, 0.5 * SIZE - THICK
    if side is not None:
        axis = {"top": 1, "front": 2}[side]
        high[axis] = 0.5 * SIZE[axis]
    return (-0.5 * SIZE, 0.5 * SIZE), (low, high)


def index_at(p, outer, inner):
    if ((p > inner[0]) & (p < inner[1])).all():
        return WATER
    return WALL if ((p > outer[0]) & (p < outer[1])).all() else 1.0


def truth(tank, o, d):
    """Follow one ray by vector Snell, face by face, to plate or chart; return its end and the share that arrives."""
    turn, centre = rotation(tank.rotation_deg), np.array(tank.position_mm)
    outer, inner = boxes(tank.open)
    p, u, weight = turn.T @ (o - centre), turn.T @ d, 1.0
    n = 1.0
    planes = [(axis, value) for box in (outer, inner) for corner in box for axis, value in enumerate(corner)]
    for _ in range(40):
        # The plate, in the plane z = 0 of the tank, and every face ahead.
        with np.errstate(divide="ignore", invalid="ignore"):
            to_plate = -p[2] / u[2]
            steps = sorted((float((value - p[axis]) / u[axis]), axis) for axis, value in planes)
        on_plate = p + to_plate * u
        crossed = ((t, axis, index_at(p + (t + 1e-7) * u, outer, inner)) for t, axis in steps if t > 1e-9)
        t, axis, beyond = next((each for each in crossed if each[2] != n), (np.inf, 0, 1.0))
        if 1e-9 < to_plate < t and (np.abs(on_plate[:2]) < INSIDE).all():
            return "plate", turn @ on_plate + centre, weight
        if not np.isfinite(t):
            world_p, world_u = turn @ p + centre, turn @ u
            if not world_u[2] < 0.0:
                return "away", world_p, weight
            end = world_p + (FAR - world_p[2]) / world_u[2] * world_u
            return "chart" if np.abs(end[:2]).max() < HALF_CHART else "away", end, weight
        p = p + t * u
        cosine, heading = abs(u[axis]), u[axis]
        across = u.copy()
        across[axis] = 0.0
        sine2 = (n / beyond) ** 2 * (across @ across)
        if sine2 >= 1.0:
            u[axis] = -u[axis]
            continue
        refracted = np.sqrt(1.0 - sine2)
        ts = 2 * n * cosine / (n * cosine + beyond * refracted)
        tp = 2 * n * cosine / (beyond * cosine + n * refracted)
        weight *= 0.5 * (ts * ts + tp * tp) * beyond * refracted / (n * cosine)
        u = across * (n / beyond)
        u[axis] = np.copysign(refracted, heading)
        n = beyond
    return "trapped", p, weight


@pytest.mark.parametrize("side", [None, "top", "front"])
def test_rays_through_a_tank_end_where_snells_law_sends_them(side):
    """Random poses, plate in the water and chart behind it: ends to 1e-9 mm and shares to 1e-10, nothing lost."""
    draw = np.random.default_rng({None: 1, "top": 2, "front": 3}[side])
    ends = {"plate": 0, "chart": 0}
    for _ in range(3):
        tank = tank_at((*draw.uniform(-10, 10, 2), draw.uniform(-160, -120)), tuple(draw.uniform(-35, 35, 3)), side)
        world = world_with(tank)
        o = np.column_stack([draw.uniform(-2, 2, (400, 2)), np.full(400, -1.0)])
        d = np.array(tank.position_mm) + draw.uniform(-55, 55, (400, 3)) - o
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        paths = lf.trace(world, o, d, split="transmit")
        assert sum(paths.ledger.lost.values()) <= 1e-7 * len(o)
        assert len(paths) == len(o)
        for k, (name, end, weight) in enumerate(truth(tank, a, b) for a, b in zip(o, d, strict=True)):
            if name not in ends:
                continue
            ends[name] += 1
            assert paths.body[k] == name
            np.testing.assert_allclose(paths.position[k], end, rtol=1e-11, atol=1e-9)
            assert paths.weight[k] == pytest.approx(weight, rel=1e-10)
    assert min(ends.values()) > 50


def test_a_tank_is_two_bodies_that_nest_and_a_solved_scene_has_them_among_its_targets():
    tank = tank_at((0.0, 0.0, -200.0), (0.0, 90.0, 0.0), "front")
    scene = lens_scene(SINGLET).changed({"tanks": [tank.model_dump()]})
    wall, liquid = solved_camera(scene).scene.targets
    assert (wall.name, liquid.name) == ("tanks[0] wall", "tanks[0] liquid")
    assert liquid.refractor.box_mm == (90.0, 70.0, 55.0)
    # Its own +z looks along the world's +x.
    np.testing.assert_allclose(liquid.position_mm, (2.5, 0.0, -200.0), atol=1e-12)
    assert not solved_camera(scene).scene.tanks
    assert len(scene.tanks) == 1


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"wall_mm": 30.0}, r"tanks\[0\]\.wall_mm = 30.0: leaves no room for the liquid along z"),
        (
            {"liquid": {"index": 1.3, "absorption_per_mm": -0.1}},
            r"absorption_per_mm = -0.1: must be",
        ),
        ({"liquid": {"index": 1.3, "absorption_per_mm": "D65"}}, r'absorption_per_mm = "D65": a coefficient is'),
        (
            {"wall": {"index": 1.5, "absorption_per_mm": {"wavelengths_nm": [600.0, 700.0], "values": [0.1, 0.1]}}},
            r"tanks\[0\]\.wall\.absorption_per_mm: .*extends from 600 to 700 nm",
        ),
        ({"liquid": {}}, r"tanks\[0\]\.liquid\.index: missing"),
        ({"wall": {"index": 1.5, "glass": "SCHOTT/N-BK7"}}, r"index = 1.5 is given too"),
        ({"open": "bottom"}, r"open = \"bottom\": must be 'top' or 'front'"),
        ({"size_mm": (10.0, 10.0)}, r"tanks\[0\]\.size_mm"),
    ],
)
def test_a_tank_that_cannot_be_is_refused_in_one_line(changes, message):
    tank = tank_at((0.0, 0.0, -200.0), (0.0, 0.0, 0.0)).model_dump() | changes
    with pytest.raises(SceneError, match=message) as refused:
        lens_scene(SINGLET).changed({"tanks": [tank]})
    assert "\n" not in str(refused.value)


def test_a_tank_round_the_camera_is_refused():
    scene = lens_scene(SINGLET).changed({"tanks": [tank_at((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)).model_dump()]})
    with pytest.raises(SceneError, match=r"tanks\[0\] wall\) reaches into the camera"):
        lf.build(scene)


def test_check_prints_the_tank_and_where_its_middle_is_seen(tmp_path, capsys):
    scene = lens_scene(SINGLET).changed({"tanks": [tank_at((0.0, 0.0, -200.0), (0.0, 0.0, 0.0)).model_dump()]})
    file = tmp_path / "scene.toml"
    file.write_text(scene.dump_toml())
    assert main(["check", str(file)]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    # 5 mm of wall and 25 mm of water, each divided by its index.
    assert f"appears {5 / WALL + 25 / WATER:.6g} mm behind it" in printed
    assert "tanks[0] 100 × 80 × 60 mm, closed" in printed
