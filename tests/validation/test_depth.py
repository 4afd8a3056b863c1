"""Depth from a rendered light field agrees with the traced truth, within 2 % of depth in the median."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image as Picture

import lfmesh as lf
from lfmesh.assets import asset_path

LARGEST_ERROR = 0.02
"""Of the median over a target's samples, as a share of its depth."""

FIRST_ORDER_ERROR = 0.012
"""What first-order optics alone would err by at 700 mm: the spherical aberration of the lens."""


@pytest.fixture(scope="module")
def texture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A random pattern with nothing finer than a tenth of the target's width."""
    rng, side, waves = np.random.default_rng(5), 256, 10.0
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(side, 1 / side), np.fft.fftfreq(side, 1 / side)))
    pattern = np.fft.ifft2(np.where(frequency < waves, np.fft.fft2(rng.normal(size=(side, side))), 0.0)).real
    path = tmp_path_factory.mktemp("texture") / "pattern.png"
    Picture.fromarray(np.clip(127.5 + 50.0 * pattern / pattern.std(), 0.0, 255.0).astype(np.uint8)).save(path)
    return path


def light_field(targets: list[dict[str, Any]]) -> lf.LightField:
    """The default camera with 40 × 40 lenslets, f/4, focused on 500 mm: it refocuses from 261 mm to 3400 mm."""
    lens = {"file": asset_path("lenses/double_gauss_50mm.toml").as_posix(), "stop_semi_diameter_mm": 4.77}
    array = {"count": (40, 40), "pitch_mm": 0.125, "focal_length_mm": 0.5, "index": 1.5, "thickness_mm": 0.3}
    sensor = {"pixels": (410, 410), "pixel_mm": 0.0125}
    scene = lf.Scene(
        camera={"focus_mm": 500.0, "lens": lens, "mla": array, "sensor": sensor},
        targets=targets,
        transport={"split": "transmit", "samples": 8, "replicates": 2, "threads": 2},
    )
    return lf.decode(lf.render(scene), white=lf.white_image(scene))


def plane(texture: Path, distance_mm: float, size_mm: tuple[float, float], **place: Any) -> dict[str, Any]:
    return {
        "shape": {"kind": "plane", "width_mm": size_mm[0], "height_mm": size_mm[1]},
        "position_mm": (place.get("x_mm", 0.0), 0.0, -distance_mm),
        "rotation_deg": (0.0, place.get("tilt_deg", 0.0), 0.0),
        "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0, "texture": texture.as_posix()},
    }


def median_error(depth: lf.DepthMap, truth: NDArray[np.float32], where: NDArray[np.bool_]) -> float:
    error = np.abs(depth.error(truth)[where])
    assert np.isfinite(error).mean() > 0.95
    return float(np.nanmedian(error))


def test_two_planes(texture: Path) -> None:
    """Both are found; by first-order optics in place of traced rays the far one would not be as near to the truth."""
    targets = [plane(texture, 380.0, (40.0, 60.0), x_mm=20.0), plane(texture, 700.0, (80.0, 80.0))]
    field = light_field(targets)
    truth, depth = lf.depth_truth(field.scene, samples=1).middle_mm, lf.estimate_depth(field)
    assert {float(z) for z in np.unique(truth.round(3))} == {380.0, 700.0}
    for distance in (380.0, 700.0):
        assert median_error(depth, truth, np.abs(truth - distance) < 1.0) < LARGEST_ERROR
    far = truth > 600.0
    assert median_error(depth, truth, far) < 0.5 * FIRST_ORDER_ERROR
    first_order = np.median([field.model.paraxial.distance_mm(shift) for shift in depth.shift_mm[far]])
    assert first_order / 700.0 - 1.0 > FIRST_ORDER_ERROR
    # Where views see past an edge, no depth is sure.
    edge = np.abs(np.gradient(truth, axis=1)) > 0.0
    assert np.median(depth.confidence[edge]) < 0.8 < np.median(depth.confidence[~edge])


def test_a_slanted_plane(texture: Path) -> None:
    """Turned by 60°, it spans depths whose differences are many times the allowed error."""
    field = light_field([plane(texture, 480.0, (110.0, 110.0), tilt_deg=60.0)])
    truth, depth = lf.depth_truth(field.scene, samples=1).middle_mm, lf.estimate_depth(field)
    seen = np.isfinite(truth)
    assert np.ptp(truth[seen]) > 70.0
    assert median_error(depth, truth, seen) < LARGEST_ERROR
    slope, _ = np.polyfit(truth[seen], depth.distance_mm[seen], 1)
    assert slope == pytest.approx(1.0, abs=0.1)
