"""Rays in blocks, from a user's arrays to those of the result, against the same rays as packets.

Both take the rays through lens and array by the same arithmetic, so they agree to the rounding of the frames' moves.
"""

import subprocess
import sys

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.geometry import frame
from lfmesh.transport import trace as trace_module
from lfmesh.transport.sequences import given_rays

ROUNDING = 1e-12
COLUMNS = ("position", "direction", "weight", "status", "source", "events")
SETTINGS = {"split": "transmit", "engine": "sequential"}
PLANE = lf.Plane(width_mm=12.0, height_mm=60.0)
SENSOR = lf.Sensor(pixels=(50, 50), pixel_mm=0.5, distance_mm=5.0)
TURNED = lf.scene.Pose(shift_mm=(40.0, -300.0, 120.0), tilt_deg=(20.0, -50.0, 110.0))


def surfaces(draw, count, kind):
    """Elements of glass with air between them, and a stop before, between or behind them, or on a surface."""
    found = []
    for number in range(count):
        shape = {"radius_mm": draw.choice([-1.0, 1.0]) * draw.uniform(22.0, 120.0)}
        if kind != "spheres":
            shape["conic"] = draw.uniform(-2.0, 0.8)
        if kind == "aspheres":
            shape["asphere_mm"] = tuple(draw.normal(size=3) * (3e-6, 1e-8, 3e-11))
        if number % 2 == 0:
            shape["index"] = draw.uniform(1.45, 1.9)
        found.append(lf.Surface(thickness_mm=draw.uniform(4.5, 7.0), semi_diameter_mm=draw.uniform(6.0, 8.0), **shape))
    place = int(draw.integers(-1, count + 1))
    if place < 0:
        found[1] = found[1].model_copy(update={"stop": True})
    else:
        radius = draw.uniform(3.0, 5.0)
        found.insert(place, lf.Surface(stop=True, radius_mm=np.inf, thickness_mm=3.0, semi_diameter_mm=radius))
    # What follows the last one, array or sensor says.
    found[-1] = found[-1].model_copy(update={"thickness_mm": 0.0})
    return tuple(found)


def random_scene(seed):
    """A camera drawn at random; with the seed change lens, array, pose and target, each at a pace of its own."""
    draw = np.random.default_rng(seed)
    kind = ("spheres", "conics", "aspheres")[seed % 3]
    sensor = {"pixels": (50, 40), "pixel_mm": 0.4, "distance_mm": 0.6 if seed % 2 else draw.uniform(20.0, 60.0)}
    camera = {"lens": lf.Lens(surfaces=surfaces(draw, int(draw.choice([2, 4, 6])), kind))}
    if seed % 2:
        camera["mla"] = lf.MicrolensArray(
            layout=("square", "hexagonal")[seed // 2 % 2], count=(120, 120), pitch_mm=0.15, focal_length_mm=0.6,
            index=1.5, thickness_mm=0.3, distance_mm=draw.uniform(20.0, 50.0),
            curved_side=("lens", "sensor")[seed // 4 % 2],
            pose=lf.scene.Pose(tilt_deg=draw.uniform(-2.0, 2.0, 3), shift_mm=draw.uniform(-0.2, 0.2, 3)),
        )  # fmt: skip
        sensor["pose"] = lf.scene.Pose(tilt_deg=draw.uniform(-2.0, 2.0, 3))
    if seed % 4 >= 2:
        camera["pose"] = TURNED
    targets = []
    if seed % 5:
        placed = frame.frame(camera["pose"].tilt_deg, camera["pose"].shift_mm) if "pose" in camera else frame.IDENTITY
        targets = [lf.Target(shape=PLANE, position_mm=tuple(frame.points(placed, [4.0, 0.0, -90.0])))]
        if "pose" not in camera:
            targets[0] = targets[0].model_copy(update={"rotation_deg": (0.0, 20.0, 0.0)})
    return lf.Scene(camera=lf.Camera(**camera, sensor=lf.Sensor(**sensor)), targets=targets)


def random_rays(world, count, seed=3):
    """Rays of every kind, mixed: into the lens or beside it, from near and far, from behind, from anywhere."""
    draw = np.random.default_rng(seed)
    camera = world.scene.camera
    vertices = camera.lens.vertices_mm
    gap = (camera.mla.distance_mm + camera.mla.thickness_mm if camera.mla else 0.0) + camera.sensor.distance_mm
    end = vertices[-1] + gap
    starts, aims = np.zeros((count, 3)), np.zeros((count, 3))
    which = draw.choice(6, count, p=[0.4, 0.1, 0.1, 0.2, 0.1, 0.1])
    for kind, some in ((kind, np.flatnonzero(which == kind)) for kind in range(6)):
        size = len(some)
        wide = draw.uniform(-7.0, 7.0, (size, 2))
        if kind < 3:
            near, far = ((-60.0, -20.0), (-400.0, -100.0), (-8.0, -3.0))[kind]
            starts[some] = np.column_stack([draw.uniform(-12.0, 12.0, (size, 2)), draw.uniform(near, far, size)])
            aims[some] = np.column_stack([wide, np.zeros(size)])
        elif kind == 3:
            starts[some] = np.column_stack([0.8 * wide, np.full(size, end - 0.05)])
            aims[some] = np.column_stack([draw.uniform(-5.0, 5.0, (size, 2)), np.full(size, vertices[-1])])
        elif kind == 4:
            starts[some] = np.column_stack([0.5 * wide, np.full(size, vertices[-1] + 0.3 * gap)])
            aims[some] = starts[some] + draw.normal(size=(size, 3))
        else:
            starts[some] = np.column_stack([draw.uniform(-60.0, 60.0, (size, 2)), draw.uniform(-90.0, -9.0, size)])
            aims[some] = draw.uniform(-50.0, 50.0, (size, 3))
    if camera.mla is None:
        # No start between the surfaces, which the engine refuses.
        starts[:, 2] = np.where((starts[:, 2] > -3.0) & (starts[:, 2] < vertices[-1] + 3.0), end - 0.05, starts[:, 2])
    move = world.tables.frames[0, 4]
    return starts @ move[:, :3].T + move[:, 3], (aims - starts) @ move[:, :3].T


def as_packets(world, origins, directions, monkeypatch, **settings):
    """Trace as before there were blocks for it."""
    with monkeypatch.context() as patch:
        patch.setattr(trace_module, "_in_blocks", trace_module._as_packets)
        return lf.trace(world, origins, directions, **SETTINGS | settings)


def entries(ledger):
    """Energies of a ledger by name."""
    parts = {name: value for name, value in vars(ledger).items() if isinstance(value, float)}
    return parts | {name: value for name, value in ledger.absorbed.items() if value}


def assert_close(one, other):
    """The same rows in the same order, and the same ledger, to rounding."""
    for name in ("source", "status", "events"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    assert one.body == other.body
    size = np.abs(other.position).max(initial=1.0)
    np.testing.assert_allclose(one.position, other.position, rtol=0, atol=ROUNDING * size)
    np.testing.assert_allclose(one.direction, other.direction, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(one.weight, other.weight, rtol=0, atol=ROUNDING)
    assert entries(one.ledger) == pytest.approx(entries(other.ledger), rel=ROUNDING)
    assert one.ledger.events == other.ledger.events
    assert one.ledger.packets == other.ledger.packets


def assert_same(one, other):
    for name in COLUMNS:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    assert one.body == other.body
    assert one.ledger == other.ledger


@pytest.fixture(scope="module")
def world():
    """With an array, a target in the way of some rays, and a camera that is turned."""
    return lf.build(random_scene(3))


@pytest.mark.parametrize("seed", [0, 1, 2, 3, 4, 6, 7, 8, 9, 10, 11])
def test_blocks_bring_the_same_rows_as_packets(seed, monkeypatch):
    world = lf.build(random_scene(seed))
    origins, directions = random_rays(world, 5000)
    kept = origins.copy(), directions.copy()
    blocks = lf.trace(world, origins, directions, **SETTINGS)
    assert_close(blocks, as_packets(world, origins, directions, monkeypatch))
    assert abs(blocks.ledger.imbalance) < ROUNDING
    assert np.array_equal(origins, kept[0])
    assert np.array_equal(directions, kept[1])
    # All kinds of ends, so that every way was taken.
    assert {"escaped", "housing", "stop"} <= set(blocks.body)
    assert (blocks.body.count("sensor") > 30) or seed % 3 == 2
    assert blocks.ledger.absorbed["reflections not followed"] > 0.0
    assert ("targets[0]" in blocks.body) == (len(world.scene.targets) > 0)
    rows = blocks.weight.sum() + blocks.ledger.absorbed["reflections not followed"]
    assert rows == pytest.approx(len(origins), rel=ROUNDING)


def test_rays_under_total_reflection_have_no_row(monkeypatch):
    """A half ball of glass, flat behind: what comes steeply from the side is reflected at its flat face."""
    ball = (
        lf.Surface(radius_mm=10.0, thickness_mm=10.0, index=1.8, semi_diameter_mm=9.0, stop=True),
        lf.Surface(radius_mm=np.inf, semi_diameter_mm=9.0),
    )
    world = lf.build(lf.Scene(camera=lf.Camera(lens=lf.Lens(surfaces=ball), sensor=SENSOR)))
    slope = np.linspace(0.0, 1.5, 400)
    directions = np.column_stack([slope, np.zeros(400), np.ones(400)])
    origins = np.array([0.0, 0.0, 10.0]) - 40.0 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    blocks = lf.trace(world, origins, directions, **SETTINGS)
    assert_close(blocks, as_packets(world, origins, directions, monkeypatch))
    # All go to the centre of the ball, and out there below the critical angle.
    through = np.sin(np.arctan(slope)) * 1.8 < 1.0
    assert set(blocks.source) >= set(np.flatnonzero(through))
    assert len(blocks) < 0.7 * len(origins)
    assert abs(blocks.ledger.imbalance) < ROUNDING


def test_rays_that_meet_only_the_camera_need_no_packet(world, monkeypatch):
    """Past the target into the lens: with no packets to be had, they arrive all the same."""
    draw = np.random.default_rng(1)
    start = np.column_stack([draw.uniform(-3.0, 3.0, (500, 2)), np.full(500, -30.0)])
    aim = np.column_stack([draw.uniform(-3.0, 3.0, (500, 2)), np.zeros(500)])
    move = world.tables.frames[0, 4]
    origins, directions = start @ move[:, :3].T + move[:, 3], (aim - start) @ move[:, :3].T
    with monkeypatch.context() as patch:
        patch.setattr(trace_module, "RaySource", None)
        paths = lf.trace(world, origins, directions, **SETTINGS)
        assert (paths.status == lf.Status.SENSOR).any()
        with pytest.raises(TypeError):
            lf.trace(world, origins, -directions, **SETTINGS)


@pytest.mark.parametrize("threads", [2, 3, 0])
def test_number_of_threads_does_not_change_a_bit(world, threads, monkeypatch):
    monkeypatch.setattr(given_rays, "PART", 900)
    origins, directions = random_rays(world, 5000)
    one = lf.trace(world, origins, directions, **SETTINGS, threads=1)
    assert_same(lf.trace(world, origins, directions, **SETTINGS, threads=threads), one)


def test_parts_of_any_size_bring_the_same_rows(world, monkeypatch):
    origins, directions = random_rays(world, 3000)
    whole = lf.trace(world, origins, directions, **SETTINGS)
    for size in (1, 127, 1000):
        monkeypatch.setattr(given_rays, "PART", size)
        parts = lf.trace(world, origins, directions, **SETTINGS)
        for name in COLUMNS:
            np.testing.assert_array_equal(getattr(whole, name), getattr(parts, name), err_msg=name)
        assert entries(whole.ledger) == pytest.approx(entries(parts.ledger), rel=ROUNDING)


def test_a_ray_does_not_depend_on_the_others_of_its_block():
    """Each in a block of its own, against the mixture."""
    world = lf.build(random_scene(1))
    origins, directions = random_rays(world, 300)
    together = lf.trace(world, origins, directions, **SETTINGS)
    apart = [lf.trace(world, origins[i], directions[i], **SETTINGS) for i in range(len(origins))]
    for name in ("position", "direction", "weight", "status", "events"):
        np.testing.assert_array_equal(getattr(together, name), np.concatenate([getattr(one, name) for one in apart]))


def test_no_ray_is_no_row(world):
    paths = lf.trace(world, np.zeros((0, 3)), np.zeros((0, 3)), **SETTINGS)
    assert len(paths) == 0
    assert paths.position.shape == (0, 3)
    assert paths.body == []
    assert paths.ledger.emitted == 0.0


def test_arrays_of_any_layout_and_type_are_taken(world):
    origins, directions = (a.astype(np.float32) for a in random_rays(world, 700))
    plain = lf.trace(world, origins.astype(np.float64), directions.astype(np.float64), **SETTINGS)
    wide = np.zeros((700, 6), np.float32)
    wide[:, ::2] = directions
    for given in (
        (origins, directions),
        (np.asfortranarray(origins), wide[:, ::2]),
        (origins[::-1].copy()[::-1], directions.tolist()),
    ):
        assert_same(lf.trace(world, *given, **SETTINGS), plain)


def test_a_million_rays_are_each_traced_once():
    world = lf.build(random_scene(0))
    origins, directions = (np.tile(a, (1000, 1)) for a in random_rays(world, 1000))
    few = lf.trace(world, origins[:1000], directions[:1000], **SETTINGS)
    many = lf.trace(world, origins, directions, **SETTINGS)
    assert len(many) == 1000 * len(few)
    np.testing.assert_array_equal(many.position.reshape(1000, -1, 3), np.tile(few.position, (1000, 1, 1)))
    np.testing.assert_array_equal(many.source.reshape(1000, -1) % 1000, np.tile(few.source, (1000, 1)))
    assert abs(many.ledger.imbalance) < ROUNDING


@pytest.mark.parametrize("distance", [1e4, 1e7, 1e12, 1e150, 1e300])
def test_rays_from_very_far_end_as_packets_do(distance, monkeypatch):
    world = lf.build(random_scene(10))
    draw = np.random.default_rng(5)
    directions = np.column_stack([draw.normal(size=(300, 2)) * 0.05, np.ones(300)])
    aims = np.column_stack([draw.uniform(-3.0, 3.0, (300, 2)), np.zeros(300)])
    origins = aims - distance * directions
    blocks = lf.trace(world, origins, directions, **SETTINGS)
    packets = as_packets(world, origins, directions, monkeypatch)
    assert abs(blocks.ledger.imbalance) < ROUNDING
    if distance > 1e7:
        # No digit of where they meet the lens is left; they are traced all the same.
        assert len(blocks) == len(packets)
        return
    assert blocks.body == packets.body
    np.testing.assert_allclose(blocks.position, packets.position, rtol=0, atol=1e-12 * distance)


@pytest.mark.parametrize("length", [1e-150, 1e-9, 1e9, 1e150])
def test_the_length_of_a_direction_does_not_count(world, length):
    origins, directions = random_rays(world, 400)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    unit = lf.trace(world, origins, directions, **SETTINGS)
    scaled = lf.trace(world, origins, length * directions, **SETTINGS)
    np.testing.assert_allclose(scaled.position, unit.position, rtol=0, atol=1e-11 * np.abs(unit.position).max())
    assert scaled.body == unit.body


@pytest.mark.parametrize(
    ("column", "value", "says"),
    [
        (0, (np.nan, 0.0, 0.0), "finite"),
        (0, (0.0, np.inf, 0.0), "finite"),
        (0, (0.0, 0.0, -np.inf), "finite"),
        (1, (0.0, 0.0, 0.0), "direction"),
        (1, (0.0, np.nan, 1.0), "finite"),
        (1, (np.inf, 0.0, 1.0), "finite"),
        (1, (1e200, 0.0, 1.0), "finite"),
        (1, (1e-200, 0.0, 0.0), "direction"),
    ],
)
@pytest.mark.parametrize("number", [0, 130, 999])
def test_what_is_no_ray_is_refused_by_its_number(world, column, value, says, number, monkeypatch):
    monkeypatch.setattr(given_rays, "PART", 300)
    rays = random_rays(world, 1000)
    rays[column][number] = value
    with pytest.raises(lf.LfmeshError, match=f"ray {number}: .*{says}"):
        lf.trace(world, *rays, **SETTINGS)


def test_starts_inside_lens_and_array_are_refused_by_their_number():
    world = lf.build(random_scene(1))
    camera = world.scene.camera
    origins, directions = random_rays(world, 500)
    origins[317] = 0.0, 0.0, 0.5 * camera.lens.vertices_mm[1]
    with pytest.raises(lf.LfmeshError, match="ray 317 starts inside the lens"):
        lf.trace(world, origins, directions, **SETTINGS)
    origins[401] = 0.0, 0.0, camera.lens.vertices_mm[-1] + camera.mla.distance_mm + 0.5 * camera.mla.thickness_mm
    with pytest.raises(lf.LfmeshError, match="ray 401 starts inside the microlens array"):
        lf.trace(world, origins, directions, **SETTINGS)
    origins[450] = np.nan
    with pytest.raises(lf.LfmeshError, match=r"ray 450: .*finite"):
        lf.trace(world, origins, directions, **SETTINGS)


UNASKED = """
import lfmesh as lf
from lfmesh.transport.sequences.given_rays import follow_given_rays

lens = lf.Lens(surfaces=(
    lf.Surface(radius_mm=30.0, thickness_mm=4.0, index=1.5, semi_diameter_mm=8.0, stop=True),
    lf.Surface(radius_mm=-30.0, semi_diameter_mm=8.0),
))
world = lf.build(lf.Scene(camera=lf.Camera(lens=lens, sensor=lf.Sensor(pixels=(9, 9), pixel_mm=1.0, distance_mm=9.0))))
assert "surroundings" not in vars(world)
lf.trace(world, [[0, 0, -9]], [[0, 0, 1]], split="transmit")
print(len(follow_given_rays.signatures))
lf.trace(world, [[0, 0, -9]], [[0, 0, 1]], split="transmit", engine="sequential")
print(len(follow_given_rays.signatures))
"""


def test_who_does_not_ask_for_blocks_does_not_wait_for_their_compilation():
    run = subprocess.run([sys.executable, "-c", UNASKED], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert run.stdout.split() == ["0", "1"]
