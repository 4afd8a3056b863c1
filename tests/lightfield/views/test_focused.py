"""Focused plenoptic cameras: their first-order numbers, and pictures rendered by patches."""

from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from numpy.typing import NDArray

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.cli import main
from lfmesh.lightfield.views import patches
from lfmesh.lightfield.views.focused import lenslet_blur_px
from lfmesh.scene.first_order.solve import lenslet_focal_length_mm
from tests.instances import instances

Array = NDArray[np.float64]

LEAST_NCC = 0.93
"""Of a picture with 3 samples a lenslet and a conventional camera's, of a chart finer than either resolves."""


def standard(**transport: Any) -> lf.Scene:
    """The default camera, f/4 and focused on 500 mm, with 30 × 30 lenslets."""
    lens = {"file": asset_path("lenses/double_gauss_50mm.toml").as_posix(), "stop_semi_diameter_mm": 4.77}
    array = {"count": (30, 30), "pitch_mm": 0.125, "focal_length_mm": 0.5, "index": 1.5, "thickness_mm": 0.3}
    return lf.solved(
        lf.Scene(
            camera={
                "focus_mm": 500.0,
                "lens": lens,
                "mla": array,
                "sensor": {"pixels": (310, 310), "pixel_mm": 0.0125},
            },
            transport={"split": "transmit", "samples": 8, "replicates": 2, "threads": 2, **transport},
        )
    )


def chart(distance_mm: float, x_mm: float = 0.0, width_mm: float | None = None) -> dict[str, Any]:
    width = width_mm or 35.0 * distance_mm / 500.0
    return {
        "shape": {"kind": "plane", "width_mm": width, "height_mm": width},
        "position_mm": (x_mm, 0.0, -distance_mm),
        "material": {
            "reflectance": 0.0,
            "radiance_w_m2_sr": 1.0,
            "texture": asset_path("charts/chart.png").as_posix(),
        },
    }


def photograph(scene: lf.Scene, distance_mm: float, rendered_for_mm: float | None = None) -> lf.Photograph:
    scene = scene.changed({"targets": [chart(distance_mm)]})
    return lf.render_patches(lf.render(scene), rendered_for_mm or distance_mm, white=lf.white_image(scene))


def likeness(picture: lf.Photograph, scene: lf.Scene, distance_mm: float) -> float:
    """Normalised cross-correlation, over the centre half, with a conventional camera focused on the chart itself."""
    height, width = picture.mean.shape[:2]
    taken = scene.changed(
        {
            "targets": [chart(distance_mm)],
            "camera.mla": None,
            "camera.focus_mm": distance_mm,
            "camera.sensor": {"pixels": (width, height), "pixel_mm": 0.01},
            "transport.samples": 64,
        }
    )
    pixel = picture.sample_mm * abs(lf.first_order(taken).magnification)
    true = lf.render(taken.changed({"camera.sensor.pixel_mm": pixel})).mean[:, ::-1, 0]
    middle = np.s_[height // 4 : height - height // 4, width // 4 : width - width // 4]
    return float(np.corrcoef(picture.mean[..., 0][middle].ravel(), true[middle].ravel())[0, 1])


@pytest.mark.parametrize("kind", ["keplerian", "galilean"])
def test_lenslets_image_the_plane_in_focus_onto_the_sensor(kind: Any) -> None:
    scene = lf.focused(standard(), 4.0, kind)
    model = lf.RayModel.of(scene).paraxial
    assert scene.camera.mla is not None
    (f,) = lenslet_focal_length_mm(scene.camera, 587.6)
    b, a = model.lenslet_to_sensor_mm, -model.image_excess_mm(500.0)
    assert a == pytest.approx(4.0 * b * (1.0 if kind == "keplerian" else -1.0), rel=1e-9)
    assert 1.0 / a + 1.0 / b == pytest.approx(1.0 / f, rel=1e-9)
    assert lenslet_blur_px(scene, -a) == pytest.approx((0.0,), abs=1e-9)
    # The pitch in pixels follows from the distances alone; the pupil is a little farther or nearer.
    assert lf.RayModel.of(standard()).micro_image_pitch_px == pytest.approx(model.micro_image_pitch_px, rel=1e-3)


@pytest.mark.parametrize("kind", instances(["keplerian", "galilean"], long=["galilean"]))
def test_patches_make_the_picture_that_a_conventional_camera_takes(kind: Any) -> None:
    """With three samples a lenslet; patches of the wrong size do not join."""
    scene = lf.focused(standard(), 3.0, kind)
    picture = photograph(scene, 500.0)
    assert min(picture.mean.shape[:2]) > 3 * 30
    good = likeness(picture, scene, 500.0)
    assert good > LEAST_NCC
    wrong = photograph(scene, 500.0, 620.0 if kind == "keplerian" else 430.0)
    assert likeness(wrong, scene, 500.0) < 0.75


def test_of_a_multi_focus_array_the_sharpest_lenslets_are_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the first type is sharp, pictures by the type that is most blurred there are worse."""
    scene = standard().changed({"camera.mla.layout": "hexagonal", "camera.mla.count": (30, 34)})
    scene = lf.focused(scene, (2.6, 4.0, 8.0))
    model = lf.RayModel.of(scene)
    near = model.distance_mm(-model.slope_step * 2.6 * model.lenslet_to_sensor_mm)
    blur = lenslet_blur_px(scene, model.image_excess_mm(near))
    assert np.argmin(blur) == 0
    assert blur[0] < 0.1 * blur[1] < 0.1 * blur[2]
    sharp = likeness(photograph(scene, near), scene, near)
    monkeypatch.setattr(patches, "lenslet_blur_px", lambda *_: blur[::-1])
    blurred = likeness(photograph(scene, near), scene, near)
    assert sharp > max(0.9, blurred + 0.05), (sharp, blurred)


def test_every_place_gets_patches_of_its_own_size() -> None:
    """A near chart on the right, a far one on the left: the chosen distance is that of the chart, in nine of ten."""
    scene = lf.focused(standard(), 3.0).changed({"targets": [chart(470.0, 17.0, 34.0), chart(600.0, width_mm=60.0)]})
    image, white = lf.render(scene), lf.white_image(scene)
    picture = lf.patches_in_focus(image, [470.0, 600.0], white=white)
    width = picture.distance_mm.shape[1]
    middle = np.s_[width // 6 : -(width // 6)]
    assert np.mean(picture.distance_mm[middle, : int(0.4 * width)] == 600.0) > 0.9
    assert np.mean(picture.distance_mm[middle, int(0.6 * width) :] == 470.0) > 0.9


def test_the_command_joins_patches(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image = lf.render(lf.focused(standard(), 3.0).changed({"targets": [chart(500.0)]}))
    folder = lf.save(image, tmp_path / "run")
    words = ["--distance-mm", "500", "--stack", "490:510:20", "--all-in-focus", "--method", "patches"]
    assert main(["refocus", str(folder), *words]) == 0
    expected = lf.render_patches(lf.open_run(folder), 500.0)
    with OpenEXR.File(str(folder / "refocused_500mm_patches.exr"), separate_channels=True) as file:
        written = [channel.pixels for channel in file.parts[0].channels.values()]
    assert any(np.array_equal(w, expected.mean[..., 0].astype(np.float32), equal_nan=True) for w in written)
    assert (folder / "stack.exr").exists()
    assert (folder / "all_in_focus.exr").exists()
    assert main(["refocus", str(folder), *words, "--f-number", "8"]) == 2
    assert "patches use all views" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("reduction", "kind", "fault"),
    [
        (0.9, "keplerian", "numbers above 1"),
        ((2.0, 3.0, 4.0, 5.0), "keplerian", "give 1 to 3"),
        (3.0, "newtonian", 'use "keplerian" or "galilean"'),
        (200.0, "galilean", "inside the lens"),
    ],
)
def test_cameras_that_cannot_be_made_are_refused(reduction: Any, kind: Any, fault: str) -> None:
    with pytest.raises(lf.LfmeshError, match=fault):
        lf.focused(standard(), reduction, kind)


def test_a_plane_on_the_lenslets_has_no_patches() -> None:
    scene = standard().changed({"targets": [chart(500.0)]})
    with pytest.raises(lf.LfmeshError, match=r"use lf\.refocus"):
        lf.render_patches(lf.render(scene), 500.0)
