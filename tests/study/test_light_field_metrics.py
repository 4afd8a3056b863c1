"""Refocused distance, depth and cross-talk of disturbed cameras, against first-order optics and circles in squares."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.lightfield.rays.ray_model import RayModel
from lfmesh.study.metrics.crosstalk import lenslet_light
from lfmesh.study.metrics.edge_focus import edge_shift_mm
from lfmesh.study.sweeps.table import Row
from tests.instances import instances

DISTANCE = "camera.mla.distance_mm"
SENSOR = "camera.sensor.pose.shift_mm[2]"


def camera(lenslets: int, **changes: Any) -> lf.Scene:
    """Return the first scene's camera with fewer lenslets, its distances solved."""
    pixels = 10 * lenslets + 12
    settings = {
        "camera.mla.count": (lenslets, lenslets),
        "camera.sensor.pixels": (pixels, pixels),
        "transport.samples": 32,
        "transport.replicates": 4,
        "transport.split": "transmit",
    }
    return lf.solved(lf.load(asset_path("scenes/first_light.toml")).changed(settings | changes))


def array_mm(scene: lf.Scene) -> float:
    assert scene.camera.mla is not None
    assert scene.camera.mla.distance_mm is not None
    return scene.camera.mla.distance_mm


def moved(scene: lf.Scene, path: str, value: float, metric: str, folder: Path, **settings: Any) -> tuple[Row, Row]:
    """Return the rows of the reference and of the camera with one field changed."""
    axes = [{"path": path, "values": [value]}]
    table = lf.Study(scene, axes=axes, metrics=[metric], **settings).run(folder, workers=0)
    return table.rows[0], table.rows[1]


def shown_mm(scene: lf.Scene, path: str, value: float, at_mm: float) -> float:
    """Return at which distance a camera to plan would have to see what the changed one sees at one, by first order."""
    return RayModel.of(scene).distance_mm(RayModel.of(scene.changed({path: value})).shift_mm(at_mm))


@pytest.mark.parametrize(
    ("path", "by", "edge_mm"),
    [
        (SENSOR, 0.04, 560.0),
        *(pytest.param(DISTANCE, *values, marks=pytest.mark.long) for values in ((-0.1, 500.0), (0.1, 560.0))),
    ],
)
def test_an_edge_is_refocused_where_first_order_optics_says(
    tmp_path: Path, path: str, by: float, edge_mm: float
) -> None:
    """Nearer if the array stands farther from the lens; by d/(d + δ) nearer to the focus if the sensor stands off by δ.

    The shift within 4 standard errors and 4 %, the distance itself within 1 %: beside first order the lens has
    aberrations.
    """
    scene = camera(18)
    value = by + (array_mm(scene) if path == DISTANCE else 0.0)
    own, other = moved(scene, path, value, "refocus", tmp_path, edge_distance_mm=edge_mm)
    assert own.estimates["refocus_mm"].value == pytest.approx(edge_mm, rel=0.01)
    expected = shown_mm(scene, path, value, edge_mm) - edge_mm
    for name in ("refocus_shift_mm", "refocus_calibrated_shift_mm"):
        found, error = other.estimates[name]
        assert abs(found - expected) < 4.0 * error + 0.04 * abs(expected)
        assert error < 0.1 * abs(expected)
    size, error = other.estimates["refocus_error_mm"]
    assert abs(size - abs(expected)) < 4.0 * error + 0.04 * abs(expected)


@pytest.mark.parametrize(
    ("changes", "metric", "why"),
    [
        ({"camera.mla.count": (11, 24)}, "refocus", "needs at least 12 × 12 lenslets, but the camera has 11 × 24"),
        ({"camera.mla.count": (24, 9)}, "mtf50", "needs at least 10 × 10 lenslets, but the camera has 24 × 9"),
        ({"camera.sensor.pixel_mm": 0.03}, "refocus", "needs at least 3 columns of views .*images are .* pixels wide"),
    ],
)
def test_a_camera_without_what_a_metric_needs_is_refused_before_anything_is_traced(
    changes: dict[str, Any], metric: str, why: str
) -> None:
    axes = [{"path": "camera.mla.pose.tilt_deg[2]", "values": [0.1]}]
    with pytest.raises(lf.LfmeshError, match=f"^study: metrics: {metric} {why}"):
        lf.Study(camera(24).changed(changes), axes=axes, metrics=[metric])


def test_a_shift_by_half_a_pixel_does_not_refocus(tmp_path: Path) -> None:
    """Views at the pupil's border, which a shift cuts off, would."""
    _, other = moved(camera(24), "camera.mla.pose.shift_mm[0]", 0.00625, "refocus", tmp_path, edge_distance_mm=560.0)
    shift, error = other.estimates["refocus_shift_mm"]
    assert abs(shift) < 4.0 * error + 1.0


def test_light_of_neighbouring_lenslets_does_not_refocus_an_edge(tmp_path: Path) -> None:
    """0.1 mm nearer to the lens micro-images overlap, and five sixths of the image's 8.7 mm are seen, by Newton's law.

    What is left of the pupil is a narrower zone, with a focus of its own.
    """
    _, other = moved(camera(16), "camera.mla.pose.shift_mm[2]", -0.1, "refocus", tmp_path)
    shift, error = other.estimates["refocus_shift_mm"]
    assert abs(shift + 8.7 * 5.0 / 6.0) < 4.0 * error + 3.0
    assert error < 3.0


def test_the_shift_of_an_edge_between_views_is_found_whatever_the_slant() -> None:
    """Views of ideal edges at x = x₀ − a u + b y: to a thousandth of a sample."""
    scene = camera(18)
    field = lf.decode(lf.white_image(scene.changed({"transport.samples": 4})), scene)
    draw = np.random.default_rng(4)
    for _ in range(5):
        shift, slant, middle = draw.uniform((-0.4, -0.2, -2.0), (0.4, 0.2, 2.0))
        v, u, t, s, _ = field.data.shape
        y, x = np.meshgrid(np.arange(t) - 0.5 * (t - 1), np.arange(s) - 0.5 * (s - 1), indexing="ij")
        place = middle - shift * (np.arange(u) - 0.5 * (u - 1))
        one = np.clip(x - (place[:, None, None] + slant * y) + 0.5, 0.0, 1.0) + 0.1
        data = np.broadcast_to(one[None, ..., None], (v, u, t, s, 1)).astype(np.float32)
        # However bright the lenslets of each column are.
        bright = draw.uniform(0.5, 1.0, (v, u, 1, s, 1))
        # Not the views: those of less light are taken for cut off.
        bright /= bright[:, :, :, s // 8 : s - s // 8].mean(axis=3, keepdims=True)
        white = np.broadcast_to(bright, data.shape).astype(np.float32)
        edges, blank = replace(field, data=data * white), replace(field, data=white)
        found = edge_shift_mm(edges, blank)
        assert found == pytest.approx(shift * field.spacing_mm[1], abs=1e-3 * field.spacing_mm[1])
        assert math.isnan(edge_shift_mm(blank, blank))


def ideal_edges(field: lf.LightField, place: NDArray[np.float64], bright: NDArray[np.float64]) -> tuple[Any, Any]:
    """Return views of edges at places by (v, u, t), in samples from the middle, and of white as bright as (v, u)."""
    v, u, t, s, _ = field.data.shape
    x = np.arange(s) - 0.5 * (s - 1)
    one = np.clip(x - place[..., None] + 0.5, 0.0, 1.0) + 0.1
    white = np.broadcast_to(bright[:, :, None, None, None], (v, u, t, s, 1)).astype(np.float32)
    return replace(field, data=(one[..., None] * white).astype(np.float32)), replace(field, data=white)


def test_views_that_the_pupil_cuts_and_places_within_a_sample_do_not_move_the_edge() -> None:
    """Nor those that neighbours shine into. A third of a sample is added by where lenslets are crossed."""
    scene = camera(16)
    field = lf.decode(lf.white_image(scene.changed({"transport.samples": 4})), scene)
    v, u, t, _, _ = field.data.shape
    shift, rows = 0.15, np.arange(t) - 0.5 * (t - 1)
    across = np.arange(u) - 0.5 * (u - 1)
    place = 0.3 - shift * across[None, :, None] + math.tan(math.radians(5.0)) * rows + np.zeros((v, 1, 1))
    cut, mixed = np.ones((2, v, u))
    cut[:, : u // 2 - 2], mixed[:, u // 2 + 2 :] = 0.93, 1.3
    for places, bright in (
        (place + np.where(cut < 1.0, 0.5, 0.0)[..., None], cut),
        (place + 0.3 * across[None, :, None] * (mixed > 1.0)[..., None], mixed),
        (place + 0.3 * np.sin(2.0 * np.pi * place), np.ones((v, u))),
    ):
        found = edge_shift_mm(*ideal_edges(field, places, bright)) / field.spacing_mm[1]
        assert found == pytest.approx(shift, abs=2e-3)


def textured(scene: lf.Scene, at_mm: float) -> lf.Scene:
    chart = {
        "shape": {"kind": "plane", "width_mm": 60.0, "height_mm": 60.0},
        "position_mm": (0.0, 0.0, -at_mm),
        "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0, "texture": str(asset_path("charts/chart.png"))},
    }
    return scene.changed({"targets": [chart], "lights": []})


@pytest.mark.parametrize("at_mm", instances([470.0, 600.0], long=[600.0]))
def test_depth_is_wrong_by_what_first_order_optics_says(tmp_path: Path, at_mm: float) -> None:
    """Nothing for the camera to plan; both within 4 standard errors and the 1 % that the lens aberrates."""
    scene = textured(camera(18), at_mm)
    value = array_mm(scene) + 0.15
    own, other = moved(scene, DISTANCE, value, "depth", tmp_path)
    expected = shown_mm(scene, DISTANCE, value, at_mm) - at_mm
    for name in ("depth", "depth_calibrated"):
        for row, wrong_by in ((own, 0.0), (other, expected)):
            bias, error = row.estimates[f"{name}_bias_mm"]
            assert abs(bias - wrong_by) < 4.0 * error + 0.01 * at_mm
            assert error < 1.0
        size, error = other.estimates[f"{name}_error_mm"]
        assert abs(size - expected) < 4.0 * error + 0.01 * at_mm


@pytest.mark.parametrize(
    ("semi_diameter_mm", "overlapping"), [pytest.param(4.0, False, marks=pytest.mark.long), (5.6, True)]
)
def test_crosstalk_is_what_of_a_disk_lies_outside_a_square(semi_diameter_mm: float, overlapping: bool) -> None:
    """Of inner lenslets' micro-images; a disk on its cell of one pitch, where both are measured in cell widths."""
    scene = camera(12, **{"camera.lens.stop_semi_diameter_mm": semi_diameter_mm})
    facts = lf.first_order(scene)
    radius = 0.5 * facts.micro_image_diameter_px / facts.micro_image_pitch_px
    light = lenslet_light(scene, range(4))[:, 3:-3, 3:-3]
    share = light[..., 1].sum(axis=(1, 2)) / light.sum(axis=(1, 2, 3))
    half = 0.5 / radius
    expected = 4.0 * (math.acos(half) - half * math.sqrt(1.0 - half**2)) / math.pi if overlapping else 0.0
    error = share.std(ddof=1) / 2.0
    assert (share >= 0.0).all()
    # The pupil that lenslets see is a hundredth wider or narrower than by first order, its border part of a pixel.
    assert abs(share.mean() - expected) <= 4.0 * error + 0.05 * expected
