"""True depth by tracing, depth from the light field: laws that hold without looking at a rendered texture."""

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from matplotlib.figure import Figure

import lfmesh as lf
from lfmesh.cli import main
from lfmesh.files.depth import save_depth
from lfmesh.lightfield.photographs.depth_truth import without_depth
from lfmesh.lightfield.rays.view_rays import ViewRays, traced_shift
from lfmesh.scene import Scene
from tests.instances import instances

ROUNDING = 1e-6
"""Of float32, in which depth is given."""


def plane(distance_mm: float, *, width_mm: float = 400.0, x_mm: float = 0.0, tilt_deg: float = 0.0) -> dict[str, Any]:
    return {
        "shape": {"kind": "plane", "width_mm": width_mm, "height_mm": 400.0},
        "position_mm": (x_mm, 0.0, -distance_mm),
        "rotation_deg": (0.0, tilt_deg, 0.0),
        "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0},
    }


@pytest.fixture
def half_near(camera: Callable[..., Scene]) -> Scene:
    """The right half of the picture is 350 mm away, the left half 700 mm."""
    return camera().changed({"targets": [plane(350.0, x_mm=200.0), plane(700.0)]})


@pytest.mark.parametrize("layout", ["square", "hexagonal"])
@pytest.mark.parametrize("curved_side", instances(["lens", "sensor"], long=["sensor"]))
def test_a_plane_square_to_the_axis_is_everywhere_as_far(
    camera: Callable[..., Scene], layout: str, curved_side: str
) -> None:
    scene = camera(layout, curved_side).changed({"targets": [plane(420.0)]})
    truth = lf.depth_truth(scene, samples=4)
    middle = truth.views_mm[2:8, 2:8]
    np.testing.assert_allclose(middle, 420.0, rtol=ROUNDING)
    np.testing.assert_allclose(truth.middle_mm, 420.0, rtol=ROUNDING)
    lit = truth.seen > 0.0
    assert lit.mean() > 0.5
    np.testing.assert_allclose(truth.pixels_mm[lit], 420.0, rtol=ROUNDING)
    # The variance is a difference of squares.
    assert truth.spread_mm[lit].max() < 420.0 * 1e-6
    assert np.isnan(truth.pixels_mm[~lit]).all()


def test_distance_is_counted_from_the_camera_wherever_it_stands(camera: Callable[..., Scene]) -> None:
    """Moved and turned together with its target, a camera sees the same."""
    scene = camera().changed({"targets": [plane(420.0)]})
    pose = {"shift_mm": (5.0, -20.0, 30.0), "tilt_deg": (0.0, 90.0, 0.0)}
    # Turned about y by 90°, the axis points along x, and what was before the lens at −z lies at −x.
    turned = {**plane(0.0), "position_mm": (5.0 - 420.0, -20.0, 30.0), "rotation_deg": (0.0, 90.0, 0.0)}
    moved = lf.depth_truth(scene.changed({"camera.pose": pose, "targets": [turned]}), samples=2)
    np.testing.assert_allclose(moved.middle_mm, 420.0, rtol=ROUNDING)


def test_inverse_depth_of_a_slanted_plane_is_linear_over_the_picture(camera: Callable[..., Scene]) -> None:
    """Chief rays of the middle view go through the middle of the entrance pupil; the lens distorts by some 1e-4."""
    scene = camera(columns=40).changed({"targets": [plane(480.0, tilt_deg=50.0)], "camera.sensor.pixels": (420, 130)})
    truth = lf.depth_truth(scene, samples=2).middle_mm
    inverse = 1.0 / (truth[6] + lf.first_order(scene).entrance_pupil_z_mm)
    s = lf.decode(lf.render(scene.changed({"transport.samples": 8}))).s_mm
    line = np.polyval(np.polyfit(s, inverse, 1), s)
    assert np.ptp(truth[6]) > 30.0
    assert np.abs(inverse / line - 1.0).max() < 2e-4


def test_the_edge_of_what_is_near_moves_against_the_view(half_near: Scene) -> None:
    """By as much as the ray model says, 0.49 lenslets a view."""
    truth = lf.depth_truth(half_near, samples=2)
    near = (truth.views_mm[4, :, 6] < 500.0).sum(axis=1)
    shift = lf.RayModel.of(half_near).shift_mm(350.0) / 0.125
    moved = float(near[8]) - float(near[1])
    assert abs(moved - 7.0 * shift) < 1.0
    assert moved > 2.0


def test_mean_and_spread_of_two_planes_are_those_of_two_values(half_near: Scene) -> None:
    truth = lf.depth_truth(half_near, samples=64)
    mean, spread = truth.pixels_mm.astype(np.float64), truth.spread_mm.astype(np.float64)
    mixed = spread > 10.0
    assert mixed.sum() > 20
    np.testing.assert_allclose(spread[mixed] ** 2, ((mean - 350.0) * (700.0 - mean))[mixed], rtol=1e-3)


def test_bundles_meet_the_near_plane_as_often_as_its_light_says(half_near: Scene) -> None:
    """Total light with the far plane dark, against that which the truth's bundles give: one z-test, level 1e-5."""
    scene = half_near.changed({"transport.samples": 64, "transport.replicates": 8})
    truth = lf.depth_truth(scene, samples=64)
    both = lf.render(scene)
    near, far = scene.targets
    dark = far.model_dump()
    dark["material"]["radiance_w_m2_sr"] = 0.0
    alone = lf.render(scene.changed({"targets": [near.model_dump(), dark]}))
    share = np.nan_to_num((700.0 - truth.pixels_mm.astype(np.float64)) / 350.0)
    expected = share * both.mean[..., 0]
    # A bundle's share scatters no more than that of independent rays.
    variance = alone.stderr[..., 0] ** 2 + (share * both.stderr[..., 0]) ** 2
    variance += both.mean[..., 0] ** 2 * share * (1.0 - share) / 64.0
    z = (alone.mean.sum() - expected.sum()) / np.sqrt(variance.sum())
    assert abs(z) < 4.42
    assert 0.2 < expected.sum() / both.mean.sum() < 0.8


def test_what_meets_nothing_is_infinitely_far(camera: Callable[..., Scene]) -> None:
    truth = lf.depth_truth(camera(), samples=2)
    assert np.isinf(truth.middle_mm).all()
    assert np.isinf(truth.pixels_mm).any()
    assert not truth.seen.any()


def test_the_traced_map_is_the_ray_model_for_a_slow_lens_and_its_own_inverse(
    camera: Callable[..., Scene], image_of: Callable[..., lf.Image]
) -> None:
    scene = camera()
    field = lf.decode(image_of(scene, np.ones(scene.camera.sensor.pixels[::-1])))
    middle = np.zeros(field.views, np.bool_)
    middle[4:6, 4:6] = True
    rays = ViewRays.of_camera(scene)
    slow, whole = traced_shift(rays, middle), traced_shift(rays, np.hypot(*np.indices((10, 10)) - 4.5) < 4.6)
    for distance in (300.0, 480.0, 900.0, 3000.0):
        paraxial = field.model.paraxial.shift_mm(distance)
        assert slow.shift_mm(distance) == pytest.approx(paraxial, abs=0.002 * 0.125)
        assert float(whole.distance_mm(np.array(whole.shift_mm(distance)))) == pytest.approx(distance, rel=1e-12)
        # Spherical aberration: the rim of this pupil focuses nearer, by a hundredth of a lenslet a view.
        assert whole.shift_mm(distance) < paraxial - 0.005 * 0.125


def synthetic(field: lf.LightField, shift_mm: float, noise: float) -> lf.LightField:
    """The views of a plane of smooth random texture, and noise."""
    rng = np.random.default_rng(2)
    waves = rng.normal(size=(12, 2)) * 1.5
    phases = rng.uniform(0.0, 2.0 * np.pi, 12)
    data = np.zeros_like(field.data)
    for v in range(field.views[0]):
        for u in range(field.views[1]):
            # L(u, s) = m(s + shift · u).
            t = field.t_mm[:, None] / 0.125 + shift_mm / 0.125 * (v - 4.5)
            s = field.s_mm[None, :] / 0.125 + shift_mm / 0.125 * (u - 4.5)
            picture = sum(np.cos(a * t + b * s + p) for (a, b), p in zip(waves * 0.5, phases, strict=True))
            data[v, u, :, :, 0] = 10.0 + picture + rng.normal(scale=noise, size=(len(field.t_mm), len(field.s_mm)))
    return dataclasses.replace(field, data=data)


@pytest.mark.parametrize("shift", [-0.6, -0.13, 0.0, 0.37, 0.8])
def test_the_shift_of_a_synthetic_light_field_is_found(
    camera: Callable[..., Scene], image_of: Callable[..., lf.Image], shift: float
) -> None:
    scene = camera()
    field = lf.decode(image_of(scene, np.ones(scene.camera.sensor.pixels[::-1])))
    depth = lf.estimate_depth(synthetic(field, shift * 0.125, 0.0))
    inner = depth.shift_mm[3:-3, 3:-3] / 0.125
    assert np.median(np.abs(inner - shift)) < 0.01
    assert np.median(depth.confidence) > 0.8


def test_noise_without_texture_gives_no_confidence(
    camera: Callable[..., Scene], image_of: Callable[..., lf.Image]
) -> None:
    scene = camera()
    field = lf.decode(image_of(scene, np.ones(scene.camera.sensor.pixels[::-1])))
    noise = np.random.default_rng(3).normal(10.0, 1.0, field.data.shape).astype(np.float32)
    depth = lf.estimate_depth(dataclasses.replace(field, data=noise))
    assert np.median(depth.confidence) < 0.3


def test_depth_joins_a_run(half_near: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image = lf.render(half_near)
    folder = lf.save(image, tmp_path / "run")
    assert main(["depth", str(folder), "--near-mm", "300", "--far-mm", "900"]) == 0
    assert "Depth is off by" in capsys.readouterr().out
    truth = lf.depth_truth(half_near)
    with OpenEXR.File(str(folder / "depth_pixels.exr"), separate_channels=True) as file:
        channels = file.parts[0].channels
        np.testing.assert_array_equal(channels["Z"].pixels, truth.pixels_mm)
        np.testing.assert_array_equal(channels["spread"].pixels, truth.spread_mm)
    with OpenEXR.File(str(folder / "depth_views.exr"), separate_channels=True) as file:
        views = file.parts[0].channels["Z"].pixels
        np.testing.assert_array_equal(views[:12, 14:28], truth.views_mm[0, 1])
    assert (folder / "depth.png").stat().st_size > 10_000
    lf.save(image, folder)
    assert not list(folder.glob("depth*")), "the depth of another image"


@pytest.mark.parametrize(
    ("words", "fault"),
    [
        (["--near-mm", "900", "--far-mm", "300"], "give near below far"),
        (["--near-mm", "-5"], "near_mm = -5"),
        (["--samples", "0"], "samples = 0"),
    ],
)
def test_wrong_wishes_get_one_line(
    camera: Callable[..., Scene], image_of: Callable[..., lf.Image], tmp_path: Path,
    capsys: pytest.CaptureFixture[str], words: list[str], fault: str,
) -> None:  # fmt: skip
    scene = camera()
    folder = lf.save(image_of(scene, np.ones(scene.camera.sensor.pixels[::-1])), tmp_path / "run")
    before = sorted(path.name for path in folder.iterdir())
    assert main(["depth", str(folder), *words]) == 2
    assert fault in capsys.readouterr().err
    assert sorted(path.name for path in folder.iterdir()) == before


def test_a_conventional_camera_has_no_views(camera: Callable[..., Scene]) -> None:
    scene = camera().changed({"camera.mla": None, "camera.sensor.distance_mm": None})
    with pytest.raises(lf.LfmeshError, match=r"camera\.mla is missing"):
        lf.depth_truth(scene)


@pytest.mark.parametrize(
    ("truth_mm", "found_mm", "titles", "said"),
    [
        (math.nan, 421.0, 2, "without true depth: fire"), (math.inf, 421.0, 2, "without true depth: fire"),
        (420.0, 421.0, 4, "without true depth: fire"),
        (420.0, math.nan, 2, "the light field gives no depth; without true depth: fire"),
    ],
)  # fmt: skip
def test_a_picture_of_depth_has_no_empty_panels_without_a_depth(
    camera: Callable[..., Scene], image_of: Callable[..., lf.Image], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    truth_mm: float, found_mm: float, titles: int, said: str,
) -> None:  # fmt: skip
    scene = camera()
    folder = lf.save(image_of(scene, np.ones(scene.camera.sensor.pixels[::-1])), tmp_path / "run")
    drawn: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **_: (drawn.append(figure), path.touch()))
    found = np.full((4, 5), found_mm)
    depth = lf.DepthMap(found, np.zeros_like(found), np.ones_like(found), (300.0, 900.0))
    save_depth(depth, np.full((4, 5), truth_mm), folder, ("fire",))
    (figure,) = drawn
    pictures = [axes for axes in figure.axes if axes.get_images()]
    assert len(pictures) == titles
    assert all(np.isfinite(axes.get_images()[0].get_array()).any() for axes in pictures)
    assert pictures[0].get_xlabel() == said
    plots = [axes for axes in figure.axes if axes.get_lines()]
    assert len(plots) == (2 if titles == 4 else 0), "an error is plotted only where there is one"


def test_media_and_particles_are_named_as_what_has_no_true_depth(camera: Callable[..., Scene]) -> None:
    """A flame and a spark stand at 420 mm, where nothing else does; or before a plane, which has a true depth."""
    fire = {
        "name": "fire",
        "bounds": {"kind": "sphere", "radius_mm": 20.0},
        "emission_w_mm3_sr": 1.0,
        "position_mm": (0.0, 0.0, -420.0),
    }
    spark = {
        "count": 1,
        "bounds": {"kind": "sphere", "radius_mm": 1.0},
        "position_mm": (0.0, 0.0, -420.0),
        "intensity_w_sr": 1.0,
    }
    alone = camera().changed({"targets": [], "media": [fire], "particles": [spark]})
    before = alone.changed({"targets": [plane(600.0)]})
    for scene, words in (
        (alone, "no true depth to compare with (fire and particles[0] have none)."),
        (before, "Without true depth: fire and particles[0]"),
        (before.changed({"media": [], "particles": []}), "lies in the range searched, 300 mm to 900 mm."),
    ):
        truth = lf.depth_truth(scene, views=2, samples=1)
        assert ("fire" in repr(truth)) == bool(scene.media)
        found = np.full(truth.middle_mm.shape, 420.0)
        depth = lf.DepthMap(found, np.zeros_like(found), np.ones_like(found), (300.0, 900.0))
        said = depth.in_words(truth.middle_mm, truth.without_depth)
        assert said.endswith(words) or words in said, said
        assert np.isfinite(truth.middle_mm).any() == bool(scene.targets)


def test_media_that_only_bend_light_hide_no_depth(camera: Callable[..., Scene], tmp_path: Path) -> None:
    box = {"bounds": {"kind": "box", "size_mm": [9.0, 9.0, 9.0]}, "index": 1.0002}
    np.savez(tmp_path / "hot.npz", temperature_k=np.full((2, 2, 2), 400.0), spacing_mm=np.full(3, 5.0))
    np.savez(
        tmp_path / "soot.npz",
        index=np.ones((2, 2, 2)),
        absorption_per_mm=np.ones((2, 2, 2)),
        spacing_mm=np.full(3, 5.0),
    )
    media = [
        box | {"name": "gas", "position_mm": [0.0, 0.0, -80.0]},
        {"name": "hot", "grid": "hot.npz", "pressure_kpa": 101.3, "position_mm": [0.0, 0.0, -120.0]},
        {"name": "soot", "grid": "soot.npz", "position_mm": [0.0, 0.0, -160.0]},
        box | {"name": "fog", "scattering_per_mm": 0.1, "position_mm": [0.0, 0.0, -200.0]},
        {"name": "air", "absorption_per_mm": 1e-6},
    ]
    assert without_depth(camera().in_folder(tmp_path).changed({"media": media})) == ("soot", "fog", "air")
