"""The camera model: rays of pixels lead back to them, weights are the white image's, pinholes see what views see."""

import json
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from scipy.stats import norm

import lfmesh as lf
from lfmesh.cli import main
from lfmesh.errors import FileError
from lfmesh.files.camera_model import check_model_path
from lfmesh.geometry import frame
from lfmesh.geometry.array.lattice import Lattice
from lfmesh.lightfield.rays.pixel_bundles import cell_points
from lfmesh.scene import Scene, solved
from tests.frames import motion
from tests.instances import instances
from tests.study.studies import small_scene

COVER = {"thickness_mm": 0.04, "gap_mm": 0.02, "glass": "SCHOTT/N-SF5", "coating": "none"}
BEHIND_A_COVER = {"camera.sensor.cover": COVER, "camera.sensor.reflectance": 0.2}
SMALL = {"camera.mla.count": (8, 6), "camera.sensor.pixels": (84, 64)}
POSED = {
    "camera.mla.pose": {"shift_mm": [0.03, -0.02, 0.01], "tilt_deg": [0.6, -0.4, 1.0]},
    "camera.sensor.pose": {"shift_mm": [-0.02, 0.01, 0.02], "tilt_deg": [-0.3, 0.2, 0.5]},
    "camera.pose": {"shift_mm": [40.0, 30.0, -20.0], "tilt_deg": [10.0, 20.0, 30.0]},
}


def distance_px(scene: Scene, origin: np.ndarray, direction: np.ndarray, which: np.ndarray) -> np.ndarray:
    """How far from the middle of its pixel each ray of a map lands that runs back along the light."""
    world = lf.build(scene)
    paths = lf.trace(world, origin[which] + direction[which], -direction[which], split="transmit")
    assert (paths.status == lf.Status.SENSOR).all()
    assert len(paths.source) == which.sum()
    landed = frame.points(motion(world, "world", "sensor"), paths.position)[:, :2]
    sensor = scene.camera.sensor
    row, column = np.nonzero(which)
    at = landed[np.argsort(paths.source)] / sensor.pixel_mm + 0.5 * (np.asarray(sensor.pixels) - 1.0)
    return np.linalg.norm(at - np.column_stack([column, row]), axis=1)


@pytest.mark.parametrize(
    ("layout", "curved_side"), [("square", "sensor"), pytest.param("hexagonal", "lens", marks=pytest.mark.long)]
)
def test_light_along_the_ray_of_a_pixel_lands_on_it(
    camera: Callable[..., Scene], layout: str, curved_side: str
) -> None:
    scene = camera(layout, curved_side).changed({**SMALL, **POSED})
    model = lf.camera_model(scene)
    assert model.central.mean() > 0.4
    assert distance_px(scene, model.origin, model.direction, model.central).max() < 1e-7
    mean = ~model.central & (model.weight > 0.0)
    assert mean.any()
    assert np.isfinite(model.direction[mean]).all()


@pytest.mark.parametrize(
    ("layout", "curved_side"), [("hexagonal", "sensor"), pytest.param("square", "lens", marks=pytest.mark.long)]
)
def test_light_along_the_ray_of_a_pixel_lands_on_it_behind_a_cover(
    camera: Callable[..., Scene], layout: str, curved_side: str
) -> None:
    scene = camera(layout, curved_side).changed({**SMALL, **POSED, "camera.sensor.cover": COVER})
    model = lf.camera_model(scene)
    assert model.central.mean() > 0.4
    assert distance_px(scene, model.origin, model.direction, model.central).max() < 1e-7


def test_files_hold_the_map_and_the_views(camera: Callable[..., Scene], tmp_path: Path) -> None:
    """Read by the libraries of the formats alone. In 32 bits rays still meet their pixels within 1/1000."""
    h5py = pytest.importorskip("h5py")
    scene = camera().changed({**SMALL, **POSED})
    (tmp_path / "scene.toml").write_text(scene.dump_toml())
    assert main(["camera-model", str(tmp_path / "scene.toml"), "-o", str(tmp_path / "camera.exr")]) == 0
    model = lf.camera_model(scene)
    lf.write_camera_model(model, tmp_path / "camera.h5")
    with OpenEXR.File(str(tmp_path / "camera.exr"), separate_channels=True) as file:
        pixels = {name: channel.pixels.astype(np.float64) for name, channel in file.parts[0].channels.items()}
        facts: dict[str, Any] = json.loads(file.parts[0].header["lfmesh"])
    origin, direction = (np.stack([pixels[f"{name}.{axis}"] for axis in "xyz"], -1) for name in ("origin", "direction"))
    central = pixels["central"] == 1.0
    assert distance_px(scene, origin, direction, central).max() < 1e-3
    np.testing.assert_allclose(pixels["weight"], model.weight, rtol=1e-6)
    np.testing.assert_allclose(pixels["footprint.xa"], model.footprint[..., 0, 2], rtol=1e-6)
    assert np.array_equal(np.array(facts["views"]["intrinsics"], float), model.views.intrinsics, equal_nan=True)
    with h5py.File(tmp_path / "camera.h5") as file:
        for name in ("origin", "direction", "footprint", "weight", "lenslet", "central"):
            assert np.array_equal(file[name][()], getattr(model, name), equal_nan=True), name
        assert np.array_equal(file["views/translation_mm"][()], model.views.translation_mm, equal_nan=True)


def as_opencv_projects(camera: dict[str, Any], points_mm: np.ndarray) -> np.ndarray:
    """Where OpenCV's documentation of `projectPoints` says that points lie in a picture, term by term."""
    angle = np.linalg.norm(camera["rvec"])
    x, y, z = np.array(camera["rvec"]) / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    axis = np.array([x, y, z])
    turn = np.cos(angle) * np.eye(3) + (1.0 - np.cos(angle)) * np.outer(axis, axis) + np.sin(angle) * cross
    (fx, _, cx), (_, fy, cy), _ = camera["camera_matrix"]
    k1, k2, p1, p2, k3 = camera["distortion_coefficients"]
    places = []
    for point in points_mm:
        x_c, y_c, z_c = turn @ point + camera["tvec"]
        a, b = x_c / z_c, y_c / z_c
        r2 = a**2 + b**2
        radial = 1.0 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        a_d = a * radial + 2.0 * p1 * a * b + p2 * (r2 + 2.0 * a**2)
        b_d = b * radial + p1 * (r2 + 2.0 * b**2) + 2.0 * p2 * a * b
        places.append((fx * a_d + cx, fy * b_d + cy))
    return np.array(places)


def test_opencv_projects_points_as_the_model_of_each_view(camera: Callable[..., Scene], tmp_path: Path) -> None:
    """By the numbers in `cameras.json`, to rounding."""
    scene = camera().changed({**SMALL, **POSED})
    model = lf.camera_model(scene, views=3)
    lf.write_camera_model(model, tmp_path / "camera.exr")
    facts = json.loads((tmp_path / "cameras.json").read_text())
    height, width = lf.decode(white_of(scene), views=3).size
    placed = frame.frame(POSED["camera.pose"]["tilt_deg"], POSED["camera.pose"]["shift_mm"])
    cone = np.random.default_rng(1).uniform([-0.02, -0.02, 300.0], [0.02, 0.02, 900.0], (40, 3))
    points = frame.points(placed, np.column_stack([cone[:, :2] * cone[:, 2:], -cone[:, 2]]))
    assert len(facts["cameras"]) + len(facts["without_pinhole"]) == 9
    assert len(facts["cameras"]) >= 5
    for one in facts["cameras"]:
        v, u = one["v"], one["u"]
        assert one["image_size"] == [width, height]
        expected = model.views.project(points, v, u)
        np.testing.assert_allclose(as_opencv_projects(one, points), expected, rtol=1e-9, atol=1e-9 * width)
    assert [one["name"] for one in facts["cameras"]] == [f"view_v{c['v']:02d}_u{c['u']:02d}" for c in facts["cameras"]]


def white_of(scene: Scene) -> lf.Image:
    """An image of ones, for the size of its views."""
    mean = np.ones((*scene.camera.sensor.pixels[::-1], scene.channels))
    ledger = lf.Ledger(unit="m² sr", emitted=1.0, escaped=1.0)
    return lf.Image(mean, 0.0 * mean, solved(scene), ledger, 1.0, scene.transport.replicates, 8.0, "by hand")


def test_the_pinholes_of_another_camera_are_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "cameras.json").write_text('{"ray_map": "other.exr"}')
    for name, why in (("camera.exr", "belongs to other.exr"), ("other.h5", "")):
        with pytest.raises(FileError, match=why) if why else nullcontext():
            check_model_path(tmp_path / name)
    (tmp_path / "cameras.json").write_text("[]")
    with pytest.raises(FileError, match="was not written by lfmesh"):
        check_model_path(tmp_path / "camera.exr")


def test_the_camera_of_a_run_is_that_of_its_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    lf.save(lf.render(small_scene(samples=4)), "run")
    rays: list[dict[str, Any]] = []
    for what in ("run", "run/scene.toml"):
        assert main(["camera-model", what, "-o", "camera.exr"]) == 0
        with OpenEXR.File("camera.exr", separate_channels=True) as file:
            rays.append({name: channel.pixels.copy() for name, channel in file.parts[0].channels.items()})
    assert all(np.array_equal(rays[0][name], pixels, equal_nan=True) for name, pixels in rays[1].items())


@pytest.mark.parametrize(
    ("arguments", "why"),
    [(["-o", "camera.png"], "must end in one of"), (["-o", "camera.exr", "--distances-mm", "500", "-3"], "distances")],
)
def test_what_cannot_be_written_is_refused(
    camera: Callable[..., Scene], tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], why: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    Path("scene.toml").write_text(camera().changed(SMALL).dump_toml())
    assert main(["camera-model", "scene.toml", *arguments]) == 2
    assert why in capsys.readouterr().err


def test_a_conventional_camera_has_no_camera_model(camera: Callable[..., Scene]) -> None:
    with pytest.raises(lf.LfmeshError, match="a conventional camera"):
        lf.camera_model(camera().changed({"camera.mla": None}))


@pytest.mark.parametrize("hexagonal", [False, True])
def test_points_of_a_cell_integrate_polynomials(hexagonal: bool) -> None:
    """Area, and second moments: p²/12 of a square, 5p²/72 of a regular hexagon of width p (side a: 5a²/24)."""
    lattice = Lattice(hexagonal, 0.2, 3, 3)
    points, area = cell_points(lattice)
    assert area.sum() == pytest.approx(lattice.cell_area, rel=1e-14)
    moments = points.T @ (points * area[:, None]) / area.sum()
    expected = (5.0 / 72.0 if hexagonal else 1.0 / 12.0) * 0.2**2
    np.testing.assert_allclose(moments, expected * np.eye(2), rtol=0, atol=1e-16)


PRISM = {"kind": "xy", "coefficients_rad": [[1, 0, 60.0], [0, 1, -40.0]], "radius_mm": 0.0625}
"""A phase that deflects light by some degrees."""


@pytest.mark.parametrize(
    ("layout", "curved_side", "change"),
    [
        ("square", "lens", {}),
        ("square", "lens", {"camera.mla.curved_phase": PRISM}),
        pytest.param("hexagonal", "sensor", {"camera.mla.curved_phase": PRISM}, marks=pytest.mark.long),
        pytest.param("hexagonal", "sensor", BEHIND_A_COVER, marks=pytest.mark.long),
        pytest.param("square", "lens", BEHIND_A_COVER, marks=pytest.mark.long),
        pytest.param("hexagonal", "sensor", {}, marks=pytest.mark.long),
    ],
)
def test_weights_are_the_white_image(
    camera: Callable[..., Scene], layout: str, curved_side: str, change: dict[str, Any]
) -> None:
    """Where no neighbour's light falls: in the middle of the micro-images, one z-test at the level of 1e-3 (3.3 σ).

    Quadrature errs by less than the 0.1 % that are allowed beside.
    """
    scene = camera(layout, curved_side).changed(
        {**SMALL, "camera.sensor.pixels": (84, 56), "transport.samples": 64, **change}
    )
    model = lf.camera_model(scene)
    centres = lf.calibrate(scene).centres_px
    row, column = np.indices(model.weight.shape)
    own = centres[model.lenslet[..., 1], model.lenslet[..., 0]]
    middle = (np.hypot(own[..., 0] - column, own[..., 1] - row) < 3.0) & (model.lenslet[..., 0] >= 0)
    assert middle.sum() > 500
    white = lf.white_image(scene)
    power, error = white.mean[..., 0][middle], white.stderr[..., 0][middle]
    difference = model.weight[middle].sum() - power.sum()
    assert abs(difference) < norm.isf(0.5e-3) * np.sqrt((error**2).sum()) + 1e-3 * power.sum()


@pytest.mark.parametrize("distance_mm", instances([330.0, 900.0], long=[900.0]))
def test_a_disk_lies_in_each_view_where_its_pinhole_projects_it(
    camera: Callable[..., Scene], distance_mm: float
) -> None:
    """The centroid of its light in the decoded light field, in the 16 views in the middle, within 1/20 of a sample."""
    scene = camera().changed({"camera.pose": POSED["camera.pose"]})
    pose = scene.camera.pose
    scale = distance_mm / 500.0
    middle = frame.points(
        frame.frame(pose.tilt_deg, pose.shift_mm), np.array([[1.1 * scale, -0.7 * scale, -distance_mm]])
    )
    disk = {
        "shape": {"kind": "disk", "radius_mm": 3.5 * scale},
        "position_mm": tuple(middle[0].tolist()),
        "rotation_deg": pose.tilt_deg,
        "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0},
    }
    image = lf.render(scene.changed({"targets": (disk,), "transport.samples": 32}))
    field = lf.decode(image)
    views = lf.camera_model(image).views
    t, s = np.indices(field.data.shape[2:4])
    assert field.data.shape[:2] == views.rms_error.shape == (10, 10)
    for v, u in np.ndindex(10, 10):
        if not (3 <= v <= 6 and 3 <= u <= 6):
            continue
        light = field.data[v, u, :, :, 0].astype(np.float64)
        seen = np.array([(s * light).sum(), (t * light).sum()]) / light.sum()
        assert np.linalg.norm(seen - views.project(middle, v, u)[0]) < 0.05, (v, u, seen, views.project(middle, v, u))
