"""Laws of a trace: invariances, energy, unbiased roulette, and Snell's law along recorded paths."""

from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.geometry.surfaces.sag import sag
from lfmesh.scene import load_lens
from lfmesh.transport import engine as engine_module
from lfmesh.transport import trace as trace_module
from lfmesh.transport.engine import Workspace

SPLITS = ["both", "roulette", "transmit"]


def scene_with(**changes):
    """A double Gauss with a small array close behind its image, and nothing in object space."""
    camera = {
        "lens": load_lens(asset_path("lenses/double_gauss_50mm.toml")),
        "mla": lf.MicrolensArray(
            count=(64, 64), pitch_mm=0.125, focal_length_mm=0.5, index=1.5, thickness_mm=0.3, distance_mm=40.0
        ),
        "sensor": lf.Sensor(pixels=(640, 640), pixel_mm=0.0125),
    }
    return lf.Scene(camera=lf.Camera(**(camera | changes)))


@pytest.fixture(scope="module")
def world():
    return lf.build(scene_with())


def rays_into_the_lens(count, seed=0, slope=0.1):
    """Rays from object space that cross the front element."""
    draw = np.random.default_rng(seed)
    directions = np.column_stack([draw.normal(scale=slope, size=(count, 2)), np.ones(count)])
    through = np.column_stack([draw.uniform(-9.0, 9.0, size=(count, 2)), np.zeros(count)])
    return through - 30.0 * directions, directions


def bare_singlet(**changes):
    """A biconvex lens before a wide sensor."""
    surfaces = (
        lf.Surface(radius_mm=30.0, thickness_mm=6.0, index=1.8, semi_diameter_mm=10.0, stop=True),
        lf.Surface(radius_mm=-30.0, semi_diameter_mm=10.0),
    )
    sensor = lf.Sensor(pixels=(1000, 1000), pixel_mm=0.1, distance_mm=20.0)
    return lf.Scene(camera=lf.Camera(lens=lf.Lens(surfaces=surfaces), sensor=sensor, **changes))


def assert_same(one, other):
    """The same packets, bit for bit."""
    for name in ("position", "direction", "weight", "status", "source", "events"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    assert one.body == other.body


@pytest.mark.parametrize("split", SPLITS)
def test_rigid_motion_of_the_camera_moves_its_rays_and_nothing_else(world, split):
    tilt, shift = (20.0, -35.0, 110.0), (300.0, -120.0, 700.0)
    moved_world = lf.build(scene_with(pose=lf.scene.Pose(tilt_deg=tilt, shift_mm=shift)))
    # About the fixed axes x, then y, then z.
    turn = Rotation.from_euler("xyz", tilt, degrees=True).as_matrix()
    origins, directions = rays_into_the_lens(3000)
    still = lf.trace(world, origins, directions, split=split)
    moved = lf.trace(moved_world, origins @ turn.T + shift, directions @ turn.T, split=split)
    assert still.body == moved.body
    np.testing.assert_array_equal(still.source, moved.source)
    np.testing.assert_array_equal(still.events, moved.events)
    np.testing.assert_allclose((moved.position - shift) @ turn, still.position, rtol=0, atol=1e-9)
    np.testing.assert_allclose(moved.direction @ turn, still.direction, rtol=0, atol=1e-10)
    np.testing.assert_allclose(moved.weight, still.weight, rtol=0, atol=1e-11)
    assert len(set(still.body)) >= 5


@pytest.mark.parametrize("split", SPLITS)
def test_number_of_threads_does_not_change_a_bit(world, split, monkeypatch):
    """Of three threads each has a chunk: two whole ones, and the rest."""
    monkeypatch.setattr(trace_module, "CHUNK", 2000)
    origins, directions = rays_into_the_lens(2 * trace_module.CHUNK + 1000)
    one = lf.trace(world, origins, directions, split=split, threads=1)
    for threads in (2, 3):
        other = lf.trace(world, origins, directions, split=split, threads=threads)
        assert_same(one, other)
        assert one.ledger == other.ledger


@pytest.mark.parametrize("split", SPLITS)
def test_chunks_and_waves_of_any_size_trace_the_same_packets(world, split, monkeypatch):
    origins, directions = rays_into_the_lens(4000)
    whole = lf.trace(world, origins, directions, split=split)
    monkeypatch.setattr(trace_module, "CHUNK", 700)
    monkeypatch.setattr(trace_module, "Workspace", partial(Workspace, chunk=900))
    parts = lf.trace(world, origins, directions, split=split)

    def in_order(paths):
        order = np.lexsort((paths.position[:, 0], paths.weight, paths.source))
        columns = (paths.source, paths.weight, paths.status, paths.events, *paths.position.T, *paths.direction.T)
        return np.column_stack(columns)[order]

    np.testing.assert_array_equal(in_order(whole), in_order(parts))
    assert whole.ledger.events == parts.ledger.events
    assert whole.ledger.sensor == pytest.approx(parts.ledger.sensor, rel=1e-13)


@pytest.mark.parametrize("weight_cutoff", [0.001, 0.1, 0.7])
@pytest.mark.parametrize("split", SPLITS)
def test_ledger_closes(world, split, weight_cutoff):
    origins, directions = rays_into_the_lens(2000)
    paths = lf.trace(world, origins, directions, split=split, weight_cutoff=weight_cutoff, max_events=20)
    ledger = paths.ledger
    assert ledger.emitted == len(origins)
    assert ledger.sensor > 0.01 * ledger.emitted
    assert abs(ledger.imbalance) < 1e-12
    # The rows are the book once more, but for what roulette and unfollowed reflections took, which is no packet.
    on_sensor = paths.weight[paths.status == lf.Status.SENSOR].sum()
    assert on_sensor == pytest.approx(ledger.sensor, rel=1e-12)
    for body, absorbed in ledger.absorbed.items():
        if body != "reflections not followed":
            assert paths.weight[np.array(paths.body) == body].sum() == pytest.approx(absorbed, rel=1e-12)


def test_next_to_nothing_is_lost_over_the_whole_hemisphere():
    """300,000 rays from anywhere on the sensor of the default scene, in every direction, with all their reflections."""
    world = lf.build(lf.load(asset_path("scenes/first_light.toml")))
    draw = np.random.default_rng(8)
    count = 300_000
    corners = world.mesh("sensor").vertices
    low, high = corners.min(axis=0), corners.max(axis=0)
    origins = draw.uniform(low, high, size=(count, 3))
    up = draw.normal(size=(count, 3))
    up[:, 2] = -np.abs(up[:, 2])
    ledger = lf.trace(world, origins, up, split="both").ledger
    # Light got everywhere: through the lens, onto its edges, and back to the sensor.
    assert ledger.sensor > 0.0
    assert ledger.escaped + ledger.absorbed["chart"] > 0.0
    assert {"stop", "mount", "mla edge", "mla mount", "housing", "lens[5] edge"} <= set(ledger.absorbed)
    assert ledger.lost_share < 1e-7
    assert abs(ledger.imbalance) < 1e-12


def test_children_of_a_ray_share_its_power(world):
    origins, directions = rays_into_the_lens(200)
    paths = lf.trace(world, origins, directions, split="both", weight_cutoff=0.0, max_events=9)
    total = np.bincount(paths.source, weights=paths.weight, minlength=len(origins))
    np.testing.assert_allclose(total, 1.0, rtol=0, atol=1e-12)
    assert (paths.status == lf.Status.DEPTH).any()
    assert len(paths) > 10 * len(origins)


def test_roulette_is_unbiased():
    """Mean power on the sensor over seeds against that of the full tree of reflections.

    Two-sided t-tests, of 2 ways to play by 3 outcomes, at a level of 1e-3 in all (Bonferroni).
    """
    world = lf.build(bare_singlet())
    # A call costs as much as a thousand rays: few seeds of many rays tell as much as many of few, in less time.
    origins, directions = rays_into_the_lens(1500, slope=0.5)
    depth = 9
    tree = lf.trace(world, origins, directions, split="both", weight_cutoff=0.0, max_events=depth).ledger
    ways = [{"split": "roulette"}, {"split": "both", "weight_cutoff": 0.5}]
    seeds = 50
    limit = stats.t.isf(1e-3 / (2 * 3 * len(ways)), seeds - 1)
    for way in ways:
        runs = [
            lf.trace(world, origins, directions, max_events=depth, seed=seed, **way).ledger for seed in range(seeds)
        ]
        for power in (
            lambda ledger: ledger.sensor,
            lambda ledger: ledger.escaped,
            lambda ledger: ledger.absorbed["housing"],
        ):
            sample = np.array([power(ledger) for ledger in runs])
            assert sample.std() > 0.0
            z = (sample.mean() - power(tree)) / (sample.std(ddof=1) / np.sqrt(seeds))
            assert abs(z) < limit


def surfaces_of(world):
    """Vertex z, radius, and the indices before and behind, of every surface of the scene's lens by its number."""
    lens = world.scene.camera.lens
    before = 1.0
    table = {}
    for number, (surface, z) in enumerate(zip(lens.surfaces, lens.vertices_mm, strict=True)):
        behind = surface.index or 1.0
        table[f"lens surface {number}"] = z, surface.radius_mm, before, behind
        before = behind
    return table


def test_recorded_paths_obey_the_laws_of_reflection_and_refraction(world):
    """From the vertices alone: on their surfaces, in the medium the path has come to, by Snell's law in vector form."""
    surfaces = surfaces_of(world)
    origins, directions = rays_into_the_lens(50, slope=0.05)
    paths = lf.trace(world, origins, directions, split="both", weight_cutoff=0.02, record=True)
    checked = {"TRANSMITTED": 0, "REFLECTED": 0}
    backwards = 0
    for packet in range(len(paths)):
        path = paths.vertices(packet)
        index = 1.0
        for previous, here, following in zip(path, path[1:], path[2:], strict=False):
            if here.surface not in surfaces:
                # What returns from the array comes through air.
                index = 1.0
                continue
            z, radius, before, behind = surfaces[here.surface]
            centre = np.array([0.0, 0.0, z + radius])
            assert abs(np.linalg.norm(here.position - centre) - abs(radius)) < 1e-10
            normal = (centre - here.position) / radius
            arriving, leaving = here.position - previous.position, following.position - here.position
            lengths = np.linalg.norm(arriving), np.linalg.norm(leaving)
            if not all(lengths):
                # What leaves the camera ends where it was last seen.
                continue
            arriving, leaving = arriving / lengths[0], leaving / lengths[1]
            forward = arriving @ normal > 0.0
            assert index == (before if forward else behind)
            reflects = here.event.name == "REFLECTED"
            index_after = index if reflects else (behind if forward else before)
            # Vertices are given to some 1e-14 mm, so a short segment's direction is not known any better.
            tolerance = 1e-11 + 1e-13 / min(lengths)
            tangential = index * np.cross(arriving, normal) - index_after * np.cross(leaving, normal)
            assert np.abs(tangential).max() < tolerance
            assert ((leaving @ normal > 0.0) == forward) != reflects
            index = index_after
            checked[here.event.name] += 1
            backwards += not forward
    assert checked["TRANSMITTED"] > 2000
    assert checked["REFLECTED"] > 100
    assert backwards > 100


def test_recorded_weights_fall_by_what_the_interfaces_take(world):
    """Along the transmitted path a vertex carries T times what the one before it did, by Fresnel's equations."""
    surfaces = surfaces_of(world)
    origins, directions = rays_into_the_lens(200, slope=0.05)
    paths = lf.trace(world, origins, directions, split="transmit", record=True)
    compared = 0
    for packet in range(len(paths)):
        path = paths.vertices(packet)
        for previous, here, following in zip(path, path[1:], path[2:], strict=False):
            if here.surface not in surfaces:
                break
            z, radius, n_i, n_t = surfaces[here.surface]
            normal = (np.array([0.0, 0.0, z + radius]) - here.position) / radius
            cos_i, cos_t = (
                v @ normal / np.linalg.norm(v)
                for v in (here.position - previous.position, following.position - here.position)
            )
            t_s, t_p = 2 * n_i * cos_i / (n_i * cos_i + n_t * cos_t), 2 * n_i * cos_i / (n_t * cos_i + n_i * cos_t)
            share = n_t * cos_t / (n_i * cos_i) * (t_s**2 + t_p**2) / 2
            assert here.weight == pytest.approx(previous.weight * share, rel=1e-10)
            compared += 1
    assert compared > 500


def test_a_trace_may_start_anywhere_but_in_the_array(world):
    """Cutting a path at a point between two of its vertices and going on from there ends at the same place."""
    origins, directions = rays_into_the_lens(25, slope=0.03)
    whole = lf.trace(world, origins, directions, split="transmit", record=True)
    cut = [
        (packet, here, following.position - here.position)
        for packet in np.flatnonzero(whole.status == lf.Status.SENSOR)
        for here, following in pairwise(whole.vertices(packet))
        if here.surface != "mla curved face"
    ]
    packets, ways = [packet for packet, *_ in cut], np.array([way for *_, way in cut])
    rest = lf.trace(world, np.array([here.position for _, here, _ in cut]) + 0.5 * ways, ways, split="transmit")
    order = np.argsort(rest.source)
    np.testing.assert_array_equal(rest.source[order], np.arange(len(cut)))
    np.testing.assert_allclose(rest.position[order], whole.position[packets], rtol=0, atol=1e-9)
    weights = rest.weight[order] * [here.weight for _, here, _ in cut]
    np.testing.assert_allclose(weights, whole.weight[packets], rtol=1e-10)
    assert len(cut) > 100


FORWARD = [[0.0, 0.0, 1.0]]


@pytest.mark.parametrize(
    ("origins", "directions", "options", "says"),
    [
        ([[0.0, 0.0]], [[0.0, 1.0]], {}, r"\(n, 3\)"),
        ([[0.0, 0.0, -9.0]] * 2, FORWARD, {}, r"\(2, 3\) and directions \(1, 3\)"),
        ([[[0.0, 0.0, -9.0]]], [FORWARD], {}, r"\(n, 3\)"),
        ([[0.0, np.nan, -9.0]], FORWARD, {}, "ray 0: .*finite"),
        ([[0.0, 0.0, -9.0]], [[0.0, np.inf, 1.0]], {}, "ray 0: .*finite"),
        ([[0.0, 0.0, -9.0]] * 2, [*FORWARD, [0.0, 0.0, 0.0]], {}, "ray 1: .*direction"),
        ([[0.0, 0.0, 72.2]], FORWARD, {}, "ray 0 starts inside the microlens array"),
        ([[0.0, 0.0, -9.0]], FORWARD, {"split": "half"}, "split = 'half': .*both, roulette, transmit"),
        ([[0.0, 0.0, -9.0]], FORWARD, {"surface": "round"}, "surface = 'round': .*flat, smooth, patch, exact"),
        ([["a", "b", "c"]], FORWARD, {}, r"origins .* numbers"),
        ([[0.0, 0.0, -9.0]], FORWARD, {"wavelength_nm": np.nan}, "wavelength_nm = nan"),
        ([[0.0, 0.0, -9.0]], FORWARD, {"weight_cutoff": np.nan}, "weight_cutoff = nan"),
        ([[0.0, 0.0, -9.0]], FORWARD, {"weight_cutoff": -0.1}, "weight_cutoff = -0.1"),
        ([[0.0, 0.0, -9.0]], FORWARD, {"max_events": 0}, "max_events = 0"),
        ([[0.0, 0.0, -9.0]], FORWARD, {"max_events": 2**15}, "max_events = 32768"),
        ([[0.0, 0.0, -9.0]], FORWARD, {"threads": -1}, "threads = -1"),
        ([[0.0, 0.0, -9.0]], FORWARD, {"seed": -1}, "seed = -1"),
        ([[0.0, 0.0, -9.0]], FORWARD, {"seed": None}, "seed = None: must be a whole number"),
        ([[0.0, 0.0, -9.0]], FORWARD, {"seed": "a"}, 'seed = "a": must be a whole number'),
        ([[0.0, 0.0, -9.0]], FORWARD, {"seed": 1.5}, "seed = 1.5: must be a whole number"),
        ([[0.0, 0.0, -9.0]], FORWARD, {"seed": True}, "seed = true: must be a whole number"),
        ([[0.0, 0.0, -9.0]], FORWARD, {"seed": 10**6000}, "seed = an integer of about 6000 digits"),
        ([[0.0, 0.0, -9.0]], FORWARD, {"threads": 1.0}, "threads = 1.0: must be a whole number"),
        ([[0.0, 0.0, -9.0]], FORWARD, {"threads": 10**9}, "threads = 1000000000: must be a whole number up to 1024"),
        ([[0.0, 0.0, -9.0]], FORWARD, {"max_events": 1.5}, "max_events = 1.5: must be a whole number"),
        ([[0.0, 0.0, -9.0]], FORWARD, {"wavelength_nm": "a"}, 'wavelength_nm = "a": must be a number'),
        ([[0.0, 0.0, -9.0]], FORWARD, {"wavelength_nm": [500.0]}, r"wavelength_nm = \[500.0\]: must be a number"),
        ([[0.0, 0.0, -9.0]], FORWARD, {"weight_cutoff": "a"}, 'weight_cutoff = "a": must be a number'),
        ([[0.0, 0.0, -9.0]], FORWARD, {"split": ["both"]}, "split = .*: must be text"),
        ([[0.0, 0.0, -9.0]], FORWARD, {"engine": 3}, "engine = 3: must be text"),
        ([[0.0, 0.0, 10**400]], FORWARD, {}, "origins .* numbers"),
    ],
)
def test_input_that_is_no_ray_is_refused_in_one_message(world, origins, directions, options, says):
    with pytest.raises(lf.LfmeshError, match=says) as refusal:
        lf.trace(world, origins, directions, **options)
    assert "\n" not in str(refusal.value)


def test_a_tree_of_reflections_without_an_end_is_refused_in_bounded_memory(world, monkeypatch):
    # What a chunk of rays may end in is reserved beforehand: a chunk is small, as few packets are too many here.
    monkeypatch.setattr(engine_module, "MOST_ENDS", 1_000)
    monkeypatch.setattr(trace_module, "Workspace", partial(Workspace, chunk=100))
    origins, directions = rays_into_the_lens(5)
    assert len(lf.trace(world, origins, directions, split="both", weight_cutoff=0.0, max_events=7)) < 1_000
    with pytest.raises(lf.LfmeshError, match="end in more than 1,000 packets: raise weight_cutoff above"):
        lf.trace(world, origins, directions, split="both", weight_cutoff=0.0, max_events=64)


def test_whole_numbers_of_numpy_are_whole_numbers(world):
    whole = {"seed": np.uint64(3), "threads": np.int64(1), "max_events": np.int32(20)}
    assert len(lf.trace(world, [[0.0, 0.0, -9.0]], FORWARD, wavelength_nm=np.float32(550), **whole))


def test_rays_have_the_primary_wavelength_of_the_scene_where_none_is_given() -> None:
    lens, lines = load_lens("lib:achromat_100mm"), {"transport.wavelengths_nm": (450.0, 656.3, 700.0)}
    world = lf.build(lf.load(asset_path("scenes/lit_chart.toml")).changed(lines | {"camera.lens": lens}))
    rays = [[0.0, 0.0, -100.0]], [[0.05, 0.0, 1.0]]
    omitted, red, blue = (
        lf.trace(world, *rays, split="transmit", **given)
        for given in ({}, {"wavelength_nm": 656.3}, {"wavelength_nm": 450.0})
    )
    assert np.array_equal(omitted.position, red.position)
    assert not np.array_equal(omitted.position, blue.position)


def test_a_path_that_was_not_recorded_is_refused(world):
    paths = lf.trace(world, [[0.0, 0.0, -9.0]], FORWARD)
    with pytest.raises(lf.LfmeshError, match="record=True"):
        paths.vertices(0)


def test_no_rays_are_no_paths(world):
    paths = lf.trace(world, np.zeros((0, 3)), np.zeros((0, 3)))
    assert len(paths) == 0
    assert paths.ledger.emitted == 0.0


def test_a_ray_that_starts_on_a_lens_surface_meets_it() -> None:
    """At every vertex of the double Gauss and beside it, from both sides: as from 1e-9 mm before."""
    scene = lf.load(asset_path("scenes/first_light.toml")).changed({"targets": (), "lights": ()})
    world = lf.build(scene)
    r = np.array([0.0, 2.0, 3.7])
    p = np.array([
        (x, 0.0, s["vertex_z"] + z) for s in world.lens_shape.surfaces for x, z in zip(r, sag(s, r), strict=True)
    ])  # fmt: skip
    p, d = np.concatenate([p, p]), np.repeat([[0.0, 0.01, 1.0], [0.0, 0.01, -1.0]], len(p), axis=0)
    on_it, before = (lf.trace(world, start, d, split="transmit") for start in (p, p - 1e-9 * d))
    assert (on_it.events == before.events).all()
    assert (on_it.events > 0).all()
    np.testing.assert_allclose(on_it.weight, before.weight, rtol=1e-8)
