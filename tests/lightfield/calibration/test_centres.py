"""The estimator finds micro-images that are drawn where a test puts them."""

from collections.abc import Callable

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.geometry.array.lattice import Lattice
from lfmesh.lightfield.calibration.centres import estimate_centres
from lfmesh.scene import Scene

RADIUS = 4.4


def disks(scene: Scene, centres: np.ndarray, noise: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Round micro-images, a little brighter on one side, on a sensor 8 times as fine; with their standard error."""
    width, height = scene.camera.sensor.pixels
    fine = 8
    y, x = ((np.arange(fine * size) + 0.5) / fine - 0.5 for size in (height, width))
    picture = np.zeros((fine * height, fine * width))
    for cx, cy in centres.reshape(-1, 2):
        across, along = np.abs(x - cx) < RADIUS, np.abs(y - cy) < RADIUS
        dx, dy = x[across] - cx, y[along, None] - cy
        picture[np.ix_(along, across)] = np.where(dx**2 + dy**2 < RADIUS**2, 1.0 + 0.004 * dx, 0.0)
    picture = picture.reshape(height, fine, width, fine).mean(axis=(1, 3))
    spread = noise * picture
    return picture + spread * np.random.default_rng(4).normal(size=picture.shape), spread


def lattice_px(scene: Scene, *, pitch: float, turn: float, shift: tuple[float, float]) -> np.ndarray:
    mla, (width, height) = scene.camera.mla, scene.camera.sensor.pixels
    ideal = Lattice(mla.layout == "hexagonal", pitch, *mla.count).centres()
    turned = ideal @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    return turned + 0.5 * np.array([width - 1.0, height - 1.0]) + shift


@pytest.mark.parametrize("layout", ["square", "hexagonal"])
def test_a_lattice_that_is_shifted_turned_and_stretched_is_found(
    camera: Callable[..., Scene], image_of: Callable[..., lf.Image], layout: str
) -> None:
    scene = camera(layout)
    true = lattice_px(scene, pitch=10.12, turn=0.004, shift=(2.3, -3.1))
    found = estimate_centres(image_of(scene, *disks(scene, true)))
    assert found.known.mean() > 0.9
    off = np.linalg.norm(found.centres_px - true, axis=-1)
    assert off.mean() < 0.025
    assert off.max() < 0.06
    assert found.pitch_px == pytest.approx(10.12, rel=2e-4)
    assert found.rotation_rad == pytest.approx(0.004, abs=1e-4)


def test_lenslets_that_stand_beside_the_lattice_are_found_one_by_one(
    camera: Callable[..., Scene], image_of: Callable[..., lf.Image]
) -> None:
    scene = camera()
    true = lattice_px(scene, pitch=10.08, turn=0.0, shift=(0.0, 0.0))
    true = true + np.random.default_rng(8).normal(0.0, 0.2, true.shape)
    found = estimate_centres(image_of(scene, *disks(scene, true)))
    off = np.linalg.norm(found.centres_px - true, axis=-1)
    assert np.sqrt((off**2).mean()) < 0.05


def test_noise_alone_does_not_make_a_perfect_array_look_a_bad_one(
    camera: Callable[..., Scene], image_of: Callable[..., lf.Image]
) -> None:
    scene = camera()
    true = lattice_px(scene, pitch=10.08, turn=0.0, shift=(0.0, 0.0))
    noisy = estimate_centres(image_of(scene, *disks(scene, true, noise=0.3)))
    unaware = estimate_centres(image_of(scene, disks(scene, true, noise=0.3)[0]))
    off = [np.sqrt((np.linalg.norm(f.centres_px - true, axis=-1) ** 2).mean()) for f in (noisy, unaware)]
    assert off[0] < 0.5 * off[1]


def test_a_dark_micro_image_is_continued_from_the_others(
    camera: Callable[..., Scene], image_of: Callable[..., lf.Image]
) -> None:
    scene = camera()
    true = lattice_px(scene, pitch=10.08, turn=0.0, shift=(0.0, 0.0))
    lit = np.delete(true.reshape(-1, 2), 5 * 14 + 3, axis=0)
    found = estimate_centres(image_of(scene, *disks(scene, lit)))
    assert np.argwhere(~found.known).tolist() == [[5, 3]]
    np.testing.assert_allclose(found.centres_px[5, 3], true[5, 3], atol=0.04)


@pytest.mark.parametrize(("level", "words"), [(0.0, "it is black"), (1.0, "they touch without dark")])
def test_an_image_without_micro_images_is_refused(
    camera: Callable[..., Scene], image_of: Callable[..., lf.Image], level: float, words: str
) -> None:
    scene = camera()
    with pytest.raises(lf.LfmeshError, match=words):
        estimate_centres(image_of(scene, np.full(scene.camera.sensor.pixels[::-1], level)))
