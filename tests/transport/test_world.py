"""What `build` makes: closed solids under their names, shared interfaces, and a place in the world for each."""

import copy
import gc
import pickle
import weakref
from itertools import product

import numpy as np
import pytest
import trimesh
from scipy import integrate
from scipy.spatial.transform import Rotation

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.scene import load_lens
from tests.cameras import camera_without_array
from tests.renders import of_world

LENSES = sorted(path.stem for path in asset_path("lenses").glob("*.toml"))


def array(**changes):
    settings = {"count": (5, 4), "pitch_mm": 0.5, "focal_length_mm": 2.0, "index": 1.5, "thickness_mm": 0.8}
    return lf.MicrolensArray(distance_mm=40.0, **(settings | changes))


def world_of(lens="double_gauss_50mm", targets=(), pose=None, mla=None, lights=(), **transport):
    camera = lf.Camera(
        lens=load_lens(asset_path(f"lenses/{lens}.toml")),
        mla=mla,
        sensor=lf.Sensor(pixels=(60, 40), pixel_mm=0.1, distance_mm=3.0),
        pose=pose or lf.Pose(),
    )
    return lf.build(lf.Scene(camera=camera, targets=targets, lights=lights, transport=lf.Transport(**transport)))


def assert_solid(mesh):
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.is_volume
    assert mesh.volume > 0.0


def solid_names(world):
    return [name for name in world.mesh_names if name.startswith("lens[") or name == "mla"]


def test_every_name_is_a_mesh():
    plane = lf.Target(shape=lf.Plane(width_mm=20.0, height_mm=10.0), position_mm=(0.0, 0.0, -100.0))
    world = world_of(mla=array(), targets=(plane,))
    expected = [*(f"lens[{i}]" for i in range(6)), "mount", "stop", "mla", "sensor", "housing", "targets[0]"]
    assert world.mesh_names == expected
    for name in world.mesh_names:
        mesh = world.mesh(name)
        assert isinstance(mesh, trimesh.Trimesh)
        assert len(mesh.faces) > 0
        assert mesh.area > 0.0


@pytest.mark.parametrize("surface", ["exact", "flat"])
@pytest.mark.parametrize("lens", LENSES)
def test_lens_elements_are_solids(lens, surface):
    given = load_lens(asset_path(f"lenses/{lens}.toml")).surfaces
    if surface != "exact" and any(each.gradient is not None for each in given):
        with pytest.raises(lf.SceneError, match="curved rays end on exact faces"):
            world_of(lens, surface=surface)
        return
    world = world_of(lens, surface=surface)
    names = solid_names(world)
    # The medium behind the last surface reaches to the sensor.
    media = [surface.medium for surface in world.scene.camera.lens.surfaces[:-1]]
    assert len(names) == sum(medium is not None for medium in media)
    for name in names:
        assert_solid(world.mesh(name))


@pytest.mark.parametrize(
    ("layout", "focal_length_mm", "curved_side"),
    list(product(["square", "hexagonal"], [2.0, (2.0, 2.5), (2.0, 2.5, 3.0), -2.0], ["lens", "sensor"])),
)
def test_the_array_is_a_solid(layout, focal_length_mm, curved_side):
    mla = array(layout=layout, focal_length_mm=focal_length_mm, curved_side=curved_side)
    assert_solid(world_of(mla=mla).mesh("mla"))


def test_an_array_with_form_errors_is_a_solid():
    assert_solid(world_of(mla=array(form=lf.ArrayForm(decenter_mm=0.02, radius_error=0.05))).mesh("mla"))


@pytest.mark.parametrize("curved_side", ["lens", "sensor"])
@pytest.mark.parametrize("layout", ["square", "hexagonal"])
def test_the_array_has_the_volume_of_its_lenslets(layout, curved_side):
    """Plate less what the spherical caps leave free, integrated in polar coordinates over one sector of the cell.

    The mesh's vertices are on the sphere, so it holds a little less: a facet of circumradius ρ is at most ρ² / 2R below
    it, and ρ is half of a third of a square's side, or 1/√3 of a sixth of a hexagon's.
    """
    mla = array(layout=layout, curved_side=curved_side)
    world = world_of(mla=mla)
    radius, pitch, sides = 1.0, 0.5, 4 if layout == "square" else 6

    def free(angle):
        edge = 0.5 * pitch / np.cos(angle)
        return radius * edge**2 / 2 - (radius**3 - (radius**2 - edge**2) ** 1.5) / 3

    cap = 2 * sides * integrate.quad(free, 0.0, np.pi / sides)[0]
    cell = pitch**2 * (1.0 if layout == "square" else np.sqrt(0.75))
    exact = 20 * (0.8 * cell - cap)
    volume = world.mesh("mla").volume
    circumradius = pitch / 6 if layout == "square" else pitch / np.sqrt(3.0) / 6 / np.sqrt(3.0)
    assert exact - 20 * cell * circumradius**2 / (2 * radius) < volume < exact


def test_a_lens_element_has_the_volume_of_its_glass():
    """A ball of two caps: a sphere's volume between its rims, closed by a cylinder; the mesh holds a little less."""
    world = world_of("ball_10mm", surface="smooth")
    mesh = world.mesh("lens[0]")
    rim = np.hypot(*mesh.vertices[:, :2].T).max()
    half = np.sqrt(25.0 - rim**2)
    # Two caps from |z| = half to the poles, and the cylinder between them.
    exact = 2 * np.pi * (5.0 - half) ** 2 * (10.0 + half) / 3 + 2 * half * np.pi * rim**2
    assert 0.995 * exact < mesh.volume < exact


def test_cemented_elements_share_one_interface():
    """The flint of each doublet of the double Gauss has the crown's rear face for its front one, vertex by vertex."""
    world = world_of()
    radius = 40.77
    for front, back, surface in ((1, 2, 3), (3, 4, 7)):
        first, second = world.mesh(f"lens[{front}]"), world.mesh(f"lens[{back}]")
        centre = [0.0, 0.0, world.scene.camera.lens.vertices_mm[surface] + radius]
        sides = []
        for mesh in (first, second):
            on_cap = np.abs(np.linalg.norm(mesh.vertices - centre, axis=1) - radius) < 1e-9
            faces = mesh.faces[on_cap[mesh.faces].all(axis=1)]
            sides.append({frozenset(map(tuple, mesh.vertices[face])) for face in faces})
        assert len(sides[0]) == 6 * world.lens_shape.rings**2
        assert sides[0] == sides[1]


def test_solids_of_one_lens_do_not_overlap():
    """The glass of all elements together, by probing: no point lies in two of them, and the axis passes through all."""
    world = world_of()
    meshes = [world.mesh(name) for name in solid_names(world)]
    z = np.linspace(-0.5, 32.5, 400)
    points = np.column_stack([np.full(400, 0.313), np.full(400, 0.171), z])
    inside = np.array([winding(mesh, points) for mesh in meshes])
    assert (inside.sum(axis=0) <= 1).all()
    assert (inside.sum(axis=1) > 0).all()


def winding(mesh, points):
    """How often each point is wound round by a closed mesh: the sum of the facets' solid angles over 4π."""
    a, b, c = (mesh.triangles[None, :, k] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    volume = np.einsum("ijk,ijk->ij", a, np.cross(b, c))
    dots = [np.einsum("ijk,ijk->ij", u, v) for u, v in ((a, b), (b, c), (c, a))]
    below = la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb
    return np.rint(2 * np.arctan2(volume, below).sum(axis=1) / (4 * np.pi)).astype(int)


def test_the_pose_of_the_camera_moves_its_meshes_and_not_the_targets():
    tilt, shift = (10.0, 20.0, -30.0), (5.0, 6.0, 700.0)
    ball = lf.Target(shape=lf.Sphere(radius_mm=5.0), position_mm=(0.0, 0.0, -100.0))
    still = world_of(mla=array(), targets=(ball,))
    moved = world_of(mla=array(), targets=(ball,), pose=lf.Pose(tilt_deg=tilt, shift_mm=shift))
    turn = Rotation.from_euler("xyz", tilt, degrees=True)
    assert still.mesh_names == moved.mesh_names
    for name in still.mesh_names:
        one, other = still.mesh(name), moved.mesh(name)
        expected = one.vertices if name.startswith("targets") else turn.apply(one.vertices) + shift
        np.testing.assert_allclose(other.vertices, expected, rtol=0, atol=1e-9)
        np.testing.assert_array_equal(one.faces, other.faces)


def test_installation_errors_move_array_and_sensor_about_their_centres():
    tilt, shift = (1.0, -2.0, 3.0), (0.1, 0.2, 0.05)
    pose = lf.Pose(tilt_deg=tilt, shift_mm=shift)
    turn = Rotation.from_euler("xyz", tilt, degrees=True)
    straight, crooked = world_of(mla=array()).mesh("mla"), world_of(mla=array(pose=pose)).mesh("mla")
    # About the middle of the face nearest the lens.
    middle = np.array([0.0, 0.0, straight.vertices[:, 2].min()])
    np.testing.assert_allclose(
        crooked.vertices, turn.apply(straight.vertices - middle) + middle + shift, rtol=0, atol=1e-9
    )


@pytest.mark.parametrize(
    "target",
    [
        lf.Target(shape=lf.Sphere(radius_mm=3.0), position_mm=(0.0, 0.0, 10.0)),
        lf.Target(shape=lf.Box(size_mm=(4.0, 4.0, 4.0)), position_mm=(1.0, 0.0, 50.0)),
        lf.Target(shape=lf.Plane(width_mm=200.0, height_mm=200.0), position_mm=(0.0, 0.0, 5.0)),
    ],
    ids=["ball in the lens", "box before the array", "plane through the barrel"],
)
def test_a_target_inside_the_camera_is_refused(target):
    far = lf.Target(shape=lf.Sphere(radius_mm=3.0), position_mm=(0.0, 0.0, -100.0))
    with pytest.raises(
        lf.SceneError, match=r"targets\[1\] reaches into the camera.*move it in front of z = "
    ) as refusal:
        world_of(mla=array(), targets=(far, target))
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    "lamp",
    [
        lf.PointLight(position_mm=(0.0, 0.0, 20.0), power_w=1.0),
        lf.LineLight(start_mm=(0.0, 0.0, -300.0), end_mm=(0.0, 0.0, 20.0), power_w=1.0),
        lf.LineLight(start_mm=(-90.0, 0.0, 10.0), end_mm=(90.0, 0.0, 10.0), power_w=1.0),
        lf.RectangleLight(
            position_mm=(0.0, 0.0, 20.0), direction=(0.0, 0.0, -1.0), width_mm=200.0, height_mm=200.0, power_w=1.0
        ),
        lf.DiskLight(position_mm=(50.0, 0.0, 10.0), direction=(0.0, 0.0, -1.0), radius_mm=45.0, power_w=1.0),
    ],
    ids=["point", "line along the axis", "line through the barrel", "rectangle round the axis", "disk at its edge"],
)
def test_a_lamp_inside_the_camera_is_refused(lamp):
    with pytest.raises(lf.SceneError, match=r"lights\[0\].* reaches into the camera.*move it in front of z = "):
        world_of(lights=(lamp,))


@pytest.mark.parametrize(
    "lamp",
    [
        lf.PointLight(position_mm=(0.0, 0.0, -1.0), power_w=1.0),
        lf.PointLight(position_mm=(60.0, 0.0, 10.0), power_w=1.0),
        lf.DiskLight(position_mm=(60.0, 0.0, 10.0), direction=(0.0, 0.0, -1.0), radius_mm=10.0, power_w=1.0),
    ],
    ids=["before the lens", "beside the barrel", "disk beside the barrel"],
)
def test_a_lamp_before_or_beside_the_camera_is_allowed(lamp):
    assert world_of(lights=(lamp,)).scene.lights == (lamp,)


def test_a_target_beside_the_barrel_is_allowed():
    beside = lf.Target(shape=lf.Sphere(radius_mm=3.0), position_mm=(40.0, 0.0, 10.0))
    assert "targets[0]" in world_of(targets=(beside,)).mesh_names


def test_an_unknown_mesh_is_refused_with_the_names_there_are():
    with pytest.raises(lf.LfmeshError, match=r"unknown mesh 'lens\[9\]'; valid are lens\[0\], .*, sensor, housing"):
        world_of().mesh("lens[9]")


def test_light_without_anything_to_light_keeps_its_power_in_the_ledger():
    scene = lf.Scene(
        camera=lf.Camera(
            lens=load_lens(asset_path("lenses/ball_10mm.toml")),
            sensor=lf.Sensor(pixels=(8, 8), pixel_mm=0.1, distance_mm=3.0),
        ),
        lights=(lf.PointLight(position_mm=(0.0, 0.0, -100.0), power_w=2.0),),
        transport=lf.Transport(method="forward", samples=8, replicates=4),
    )
    ledger = lf.render(scene).ledger
    assert ledger.emitted == pytest.approx(2.0, rel=1e-12)
    assert abs(ledger.imbalance) < 1e-12


@pytest.mark.parametrize("split", ["transmit", "both"])
def test_a_reseeded_world_renders_as_one_that_is_built_with_that_seed(split):
    scene = lf.load(asset_path("scenes/emitting_plane.toml")).changed(
        {
            "camera.sensor.pixels": [12, 10], "transport.samples": 4, "transport.replicates": 2,
            "transport.split": split, "transport.threads": 1,
        }
    )  # fmt: skip
    world = lf.build(scene)
    other, own = of_world(world, [7, scene.transport.seed])
    built = lf.render(scene.changed({"transport.seed": 7}))
    np.testing.assert_array_equal(other.mean, built.mean)
    assert other.scene == built.scene
    assert world.scene.transport.seed == scene.transport.seed
    assert (own.mean != other.mean).any()


def test_a_world_is_pickled_as_its_scene_and_copied(monkeypatch):
    plane = lf.Target(shape=lf.Plane(width_mm=20.0, height_mm=10.0), position_mm=(0.0, 0.0, -100.0))
    world = world_of(mla=array(), targets=(plane,))
    rays = [[0.0, 1.0, -90.0]] * 50, np.random.default_rng(1).normal([0.0, 0.0, 1.0], [0.05, 0.05, 0.0], (50, 3))
    paths = lf.trace(world, *rays)
    pickled = pickle.dumps(world)
    assert len(pickled) < 20_000, "the tables are not among it"
    for same in (
        copy.copy(world),
        pickle.loads(pickled),
        copy.deepcopy(world),
        pickle.loads(pickle.dumps(paths))._world,
    ):
        assert same.scene == world.scene
        again = lf.trace(same, *rays)
        assert np.array_equal(again.position, paths.position)
        assert np.array_equal(again.weight, paths.weight)
    monkeypatch.setattr("lfmesh.transport.build.build", pytest.fail)
    copied = copy.copy(world)
    copied.scene = None
    assert world.scene is not None


def test_a_world_is_built_again_as_it_was_built():
    scene = lf.load(asset_path("scenes/conventional.toml"))
    coarse = lf.build(scene, rings=3, aimed=False)
    again = pickle.loads(pickle.dumps(coarse))
    assert (
        len(again.mesh("lens[0]").faces)
        == len(coarse.mesh("lens[0]").faces)
        < len(lf.build(scene).mesh("lens[0]").faces)
    )
    assert again.aim_proof is None


def test_a_large_picture_on_many_facets_that_emit_is_read_once():
    """Its brightness was averaged over the wavelengths anew for each of thousands of facets, which took minutes."""
    chart = {"radiance_w_m2_sr": 1.0, "texture": str(asset_path("charts/chart.png"))}
    ball = lf.Target(shape=lf.Sphere(radius_mm=15.0), position_mm=(0.0, 0.0, -480.0), material=lf.Material(**chart))
    emitters = world_of(targets=(ball,)).tables.objects.emitters
    assert len(emitters.facet) > 1000
    assert emitters.until[-1] == pytest.approx(1.0)


def test_a_world_that_was_traced_through_is_freed_as_soon_as_nobody_has_it() -> None:
    """Its meshes in Embree are large, and the collector of cycles does not see their memory."""
    world = lf.build(lf.Scene(camera=camera_without_array(pixels=8)), aimed=False)
    lf.trace(world, [0.0, 0.0, -100.0], [0.0, 0.0, 1.0], split="transmit")
    seen = weakref.ref(world)
    gc.disable()
    try:
        del world
        assert seen() is None
    finally:
        gc.enable()
