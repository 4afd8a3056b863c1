"""The sensor's cover: rays bend by Snell's law, light goes to and fro as in a plate of textbooks, and none is lost."""

import numpy as np
import pytest
from scipy.stats import norm

import lfmesh as lf
from lfmesh.geometry import frame
from lfmesh.optics.glass import absorption_per_mm, refractive_index
from tests.cameras import camera_without_array, close_up_camera
from tests.frames import motion

GLASS = 1.5
COVER = {"thickness_mm": 0.5, "gap_mm": 0.3, "index": GLASS}
CUTOFF = 1e-9
NOTHING = {
    "surfaces": [
        {"stop": True, "thickness_mm": 1.0, "semi_diameter_mm": 50.0},
        {"radius_mm": np.inf, "thickness_mm": 1.0, "index": 1.0, "semi_diameter_mm": 60.0},
        {"radius_mm": np.inf, "semi_diameter_mm": 60.0},
    ]
}
"""A plate of air in place of a lens: what the cover sends back leaves the camera."""


def before_nothing(cover=COVER, reflectance=0.0, **tables):
    """A wide sensor with a cover and no lens that would send light back."""
    sensor = {"pixels": (50, 50), "pixel_mm": 2.0, "distance_mm": 4.0, "reflectance": reflectance, "cover": cover}
    return lf.Scene(camera={"lens": NOTHING, "sensor": sensor}, **tables)


def snell(direction, normal, n_i, n_t):
    """Snell's law in vectors, normals along the ray."""
    cosine = direction @ normal
    across = n_i / n_t * (direction - cosine[:, None] * normal)
    return across + np.sqrt(1.0 - np.einsum("ij,ij->i", across, across))[:, None] * normal


def to_plane(position, direction, point, normal):
    return position + (((point - position) @ normal) / (direction @ normal))[:, None] * direction


def bare(n_i, n_t, cosine):
    """Reflectance of a bare interface for unpolarised light, by Fresnel's equations."""
    cosine_t = np.sqrt(1.0 - (n_i / n_t) ** 2 * (1.0 - cosine**2))
    s = (n_i * cosine - n_t * cosine_t) / (n_i * cosine + n_t * cosine_t)
    p = (n_t * cosine - n_i * cosine_t) / (n_t * cosine + n_i * cosine_t)
    return 0.5 * (s * s + p * p)


@pytest.mark.parametrize("seed", range(6))
def test_rays_pass_the_cover_by_snells_law(seed):
    """Random covers before random sensors, behind an array in half of the cameras, which may be tilted too."""
    random = np.random.default_rng(seed)
    camera = close_up_camera() if seed % 2 else camera_without_array()
    pose = {"tilt_deg": random.uniform(-2.0, 2.0, 3).tolist(), "shift_mm": random.uniform(-0.1, 0.1, 3).tolist()}
    if seed % 2:
        camera["mla"] |= {"pose": {"tilt_deg": random.uniform(-1.0, 1.0, 3).tolist()}}
    cover = {"thickness_mm": random.uniform(0.1, 1.0), "gap_mm": random.uniform(0.1, 0.5)}
    index = random.uniform(1.05, 4.0)
    camera["sensor"] |= {"pose": pose, "cover": cover | {"index": index}, "pixels": [400, 400]}
    world = lf.build(lf.Scene(camera=camera))
    move = motion(world, "sensor", "world")
    normal = frame.directions(move, np.array([[0.0, 0.0, 1.0]]))[0]
    front, rear, pixels = (
        frame.points(move, np.array([[0.0, 0.0, -z]]))[0]
        for z in (cover["gap_mm"] + cover["thickness_mm"], cover["gap_mm"], 0.0)
    )
    above = -(cover["gap_mm"] + cover["thickness_mm"]) - 0.01
    start = np.column_stack([random.uniform(-0.5, 0.5, (200, 2)), np.full(200, above)])
    steep = np.column_stack([random.uniform(-0.8, 0.8, (200, 2)), np.ones(200)])
    origins = frame.points(move, start)
    directions = frame.directions(move, steep / np.linalg.norm(steep, axis=1, keepdims=True))
    paths = lf.trace(world, origins, directions, split="transmit")
    assert (paths.status == lf.Status.SENSOR).all()
    inside = snell(directions, normal, 1.0, index)
    behind = snell(inside, normal, index, 1.0)
    expected = to_plane(origins, directions, front, normal)
    expected = to_plane(to_plane(expected, inside, rear, normal), behind, pixels, normal)
    order = np.argsort(paths.source)
    np.testing.assert_allclose(paths.position[order], expected, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(paths.direction[order], directions, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("degrees", [0.0, 30.0, 60.0])
@pytest.mark.parametrize("reflectance", [0.0, 0.3])
def test_light_between_cover_and_sensor_is_a_geometric_series(degrees, reflectance):
    """A bare plate sends back P = 2R/(1 + R); a mirror behind it adds (1 - P)² S/(1 - S P) to that."""
    direction = [np.sin(np.radians(degrees)), 0.0, np.cos(np.radians(degrees))]
    paths = lf.trace(
        lf.build(before_nothing(reflectance=reflectance)), [[0.1, 0.2, 4.0]], [direction], weight_cutoff=CUTOFF
    )
    single = bare(1.0, GLASS, np.cos(np.radians(degrees)))
    plate = 2.0 * single / (1.0 + single)
    detected = (1.0 - plate) * (1.0 - reflectance) / (1.0 - reflectance * plate)
    assert paths.weight[paths.status == lf.Status.SENSOR].sum() == pytest.approx(detected, abs=1e3 * CUTOFF)
    assert paths.weight[paths.status != lf.Status.SENSOR].sum() == pytest.approx(1.0 - detected, abs=1e3 * CUTOFF)
    assert abs(paths.ledger.imbalance) < 1e-12


def test_both_faces_have_the_coating():
    scene = before_nothing(COVER | {"coating": "ar"}, coatings={"ar": {"reflectance": 0.01}})
    paths = lf.trace(lf.build(scene), [[0.0, 0.0, 4.0]], [[0.0, 0.0, 1.0]], split="transmit")
    assert paths.weight.tolist() == pytest.approx([0.99**2], rel=1e-12)


def test_a_cover_absorbs_along_the_way_of_the_light_in_it():
    """Violet light in dense flint at a slant: exp(-α t / cos) of what both faces let through."""
    glass, nm = "SCHOTT/N-SF57", 380.0
    scene = before_nothing({"thickness_mm": 2.0, "gap_mm": 0.3, "glass": glass})
    world = lf.build(scene.changed({"camera.absorption": True}))
    sine, cosine = np.sin(np.radians(40.0)), np.cos(np.radians(40.0))
    paths = lf.trace(world, [[0.0, 0.0, 3.0]], [[sine, 0.0, cosine]], split="transmit", wavelength_nm=nm)
    index = refractive_index(glass, nm)
    inside = np.sqrt(1.0 - (sine / index) ** 2)
    left = np.exp(-absorption_per_mm(glass, nm) * 2.0 / inside)
    assert left < 0.9
    assert paths.weight.tolist() == pytest.approx([(1.0 - bare(1.0, index, cosine)) ** 2 * left], rel=1e-12)
    assert abs(paths.ledger.imbalance) < 1e-12


def test_recorded_vertices_name_the_faces():
    world = lf.build(before_nothing())
    paths = lf.trace(world, [[0.0, 0.0, 4.0]], [[0.1, 0.0, 1.0]], split="transmit", record=True)
    path = paths.vertices(0)
    assert [vertex.surface for vertex in path] == ["start", "cover front face", "cover rear face", "sensor"]
    sensor_z = motion(world, "sensor", "world")[2, 3]
    assert [sensor_z - vertex.position[2] for vertex in path[1:]] == pytest.approx([0.8, 0.3, 0.0], abs=1e-12)


def test_a_ray_that_starts_in_the_gap_meets_the_rear_face_first():
    """Upwards through both faces; downwards straight onto a pixel."""
    world = lf.build(before_nothing())
    sensor_z = motion(world, "sensor", "world")[2, 3]
    starts = [[0.0, 0.0, sensor_z - 0.1]] * 2
    paths = lf.trace(world, starts, [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]], split="transmit")
    weights = dict(zip(paths.source.tolist(), paths.weight.tolist(), strict=True))
    assert weights[0] == pytest.approx((1.0 - bare(1.0, GLASS, 1.0)) ** 2, rel=1e-12)
    assert weights[1] == 1.0


def lit(array=True, reflectance=0.0, cover=COVER, **transport):
    """A camera with a cover before an emitting plane; the sensor gives room to any of the covers."""
    camera = close_up_camera(12, 12) if array else camera_without_array(60.0, 6, 0.4)
    camera["sensor"] |= {"reflectance": reflectance, "cover": cover}
    plane = {"shape": {"kind": "plane", "width_mm": 6.0, "height_mm": 5.0}, "position_mm": [1.0, 0.5, -60.0],
             "material": {"radiance_w_m2_sr": 1.0}}  # fmt: skip
    return lf.Scene(camera=camera, targets=[plane], transport={"samples": 64, **transport})


@pytest.mark.parametrize("method", ["forward", "adjoint"])
@pytest.mark.parametrize("split", ["transmit", "both", "roulette"])
def test_energy_closes(method, split):
    image = lf.render(lit(reflectance=0.3, samples=16, method=method, split=split))
    assert abs(image.ledger.imbalance) < 1e-12
    assert image.mean.sum() > 0.0


@pytest.mark.parametrize("array", [True, False])
def test_engines_agree_on_the_image_path(array):
    """The same samples, followed in blocks and through the meshes."""
    images = [lf.render(lit(array, split="transmit", engine=engine)).mean for engine in ("sequential", "mesh")]
    np.testing.assert_allclose(images[0], images[1], rtol=1e-9, atol=1e-12 * images[1].max())


def agree(a, b, comparisons):
    """Two images by the z-test of their sums: at 1e-4, divided by the number of comparisons (Bonferroni)."""
    z = (a.mean.sum() - b.mean.sum()) / np.hypot(total_error(a), total_error(b))
    assert abs(z) < norm.isf(0.5e-4 / comparisons)


def total_error(image):
    return np.sqrt(np.square(image.stderr).sum())


@pytest.mark.parametrize("array", [True, False])
def test_forward_equals_adjoint(array):
    """With all reflections between array, cover and sensor."""
    adjoint = lf.render(lit(array, 0.4, samples=256, seed=1))
    forward = lf.render(lit(array, 0.4, samples=4096, seed=2, method="forward"))
    agree(forward, adjoint, 2)


def test_paths_in_classes_add_up_to_what_the_meshes_find_at_once():
    parts = lf.render(lit(True, 0.4, samples=256, seed=3))
    at_once = lf.render(lit(True, 0.4, samples=256, seed=4, engine="mesh"))
    agree(parts, at_once, 1)


def test_a_cover_of_air_changes_nothing():
    """Where the sensor stands in the same place: the same rays, but for rounding."""
    air = lit(split="transmit", cover=COVER | {"index": 1.0})
    none = lit(split="transmit", cover=None)
    np.testing.assert_allclose(lf.render(air).mean, lf.render(none).mean, rtol=1e-9)


def test_a_cover_takes_the_reflections_of_two_faces_from_the_image_path():
    """A conventional camera with a sensor in focus, near the axis, where the angles are small."""
    with_cover, none = (lf.render(lit(False, split="transmit", cover=cover)).mean.sum() for cover in (COVER, None))
    assert with_cover / none == pytest.approx((1.0 - bare(1.0, GLASS, 1.0)) ** 2, rel=2e-3)


def tilted(degrees, reflectance, array, engine):
    """A camera whose covered sensor, and array, are tilted, before a glowing wall."""
    camera = close_up_camera(4, 4) if array else camera_without_array()
    camera["sensor"] |= {"pose": {"tilt_deg": [degrees, 0.0, 0.0]}, "reflectance": reflectance}
    camera["sensor"]["cover"] = {"thickness_mm": 0.2, "gap_mm": 0.1, "index": GLASS}
    if array:
        camera["mla"] |= {"pose": {"tilt_deg": [degrees, 0.0, 0.0]}}
    wall = {"shape": {"kind": "plane", "width_mm": 200.0, "height_mm": 200.0}, "position_mm": [0.0, 0.0, -150.0]}
    wall["material"] = {"reflectance": 0.5, "radiance_w_m2_sr": 1.0}
    return lf.Scene(
        camera=camera, targets=[wall], transport={"samples": 64, "replicates": 8, "engine": engine, "threads": 1}
    )


@pytest.mark.parametrize("degrees", [8.0, 20.0])
def test_light_that_runs_past_a_tilted_sensor_ends_on_the_housing(degrees):
    """It leaves the rim of the lens towards the sensor, as the lens sees it, and away from it, as the cover does."""
    world = lf.build(tilted(degrees, 0.0, array=False, engine="mesh"))
    rear = world.tables.lens.surfaces[-1]
    ways = np.array([[0.0, y, 0.5 * np.sin(np.deg2rad(degrees))] for y in (-1.0, 1.0)])
    ways = ways[frame.directions(motion(world, "camera", "sensor"), ways)[:, 2] < 0.0]
    start = np.array([0.0, 0.0, rear["vertex_z"] - 0.1]) + [0.0, 5.0, 0.0] * np.sign(ways)
    move = motion(world, "camera", "world")
    paths = lf.trace(world, frame.points(move, start), frame.directions(move, ways))
    assert paths.status.tolist() == [lf.Status.ABSORBED]
    assert paths.ledger.absorbed == {"housing": pytest.approx(1.0)}


@pytest.mark.parametrize("array", [False, True])
@pytest.mark.parametrize("reflectance", [0.0, 0.2])
def test_tilted_sensors_with_a_cover_lose_nothing_and_agree_in_both_engines(array, reflectance):
    images = [lf.render(tilted(15.0, reflectance, array, engine)) for engine in ("auto", "mesh")]
    for image in images:
        assert abs(image.ledger.imbalance) < 1e-12
        assert image.ledger.lost_share == 0.0
    sums = np.array([image.mean.sum() for image in images])
    error = np.sqrt(sum((image.stderr**2).sum() for image in images))
    # Of four comparisons none is as far off by chance in 999 of 1000 runs.
    assert abs(sums[0] - sums[1]) < norm.isf(0.5 * 1e-3 / 4) * error
