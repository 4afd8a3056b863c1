"""Projection matrices through media that bend light: rays are those of the image."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from tests.cameras import close_up_camera

SIGMAS = 4.0
"""Level of each z-test: 6e-5."""

SEEDS = 6
"""Matrices with rays of their own."""

SLOPE = 1.2e-4
"""dn/dx per mm of the gas. Over its 20 mm it turns light by 2.4 mrad."""


@pytest.fixture
def scene(tmp_path: Path) -> lf.Scene:
    """A light-field camera that looks through gas with a uniform gradient of its index."""
    x = np.linspace(-7.5, 7.5, 6)
    index = np.broadcast_to(1.0 + SLOPE * x[:, None, None], (6, 6, 8))
    np.savez(tmp_path / "gas.npz", index=index, spacing_mm=[3.0, 3.0, 3.0])
    gas = {
        "grid": "gas.npz",
        "bounds": {"kind": "box", "size_mm": [16.0, 16.0, 20.0]},
        "position_mm": [0.0, 0.0, -40.0],
    }
    settings = {"samples": 32, "replicates": 8, "split": "transmit", "threads": 1}
    made: Any = {"camera": close_up_camera(16, 16), "media": [gas], "transport": settings}
    return lf.Scene(**made).in_folder(tmp_path)


def test_a_matrix_gives_the_image_of_its_voxels(scene: lf.Scene, tmp_path: Path) -> None:
    """A glowing cloud behind the gas, as an image and as a product with the matrix, by rays of their own."""
    grid = lf.VoxelBox.of_size((6, 6, 1), (12.0, 12.0, 4.0), position_mm=(0.0, 0.0, -110.0))
    glow = np.zeros(grid.shape)
    glow[1::2] = 1.0
    np.savez(tmp_path / "cloud.npz", emission_w_mm3_sr=glow, spacing_mm=grid.spacing_mm)
    cloud = {"grid": {"file": "cloud.npz", "interpolation": "constant"}, "position_mm": [0.0, 0.0, -110.0]}
    image = lf.render(scene.changed({"media": [*scene.media, cloud], "transport.seed": 99}))
    clear = scene.changed({"media": ()})
    bent, straight = (
        [
            lf.projection_matrix(each.changed({"transport.seed": seed}), grid).image(glow).ravel()
            for seed in range(SEEDS)
        ]
        for each in (scene, clear)
    )
    # The difference that the gas makes is the filter that notices it best.
    right, change = image.mean.ravel(), np.mean(bent, axis=0) - np.mean(straight, axis=0)
    variance = np.var(bent, axis=0, ddof=1) / SEEDS + image.stderr.ravel() ** 2
    error = np.sqrt((change**2 * variance).sum())
    assert abs((change * (np.mean(bent, axis=0) - right)).sum()) < SIGMAS * error
    assert abs((change * (np.mean(straight, axis=0) - right)).sum()) > 2.0 * SIGMAS * error


def test_segments_are_chords(scene: lf.Scene) -> None:
    """Rays lose no length: every row has as much of the voxels in the gas as without it, to a thousandth."""
    grid = lf.VoxelBox.of_size((1, 1, 3), (12.0, 12.0, 12.0), position_mm=(0.0, 0.0, -40.0))
    bent = lf.projection_matrix(scene, grid).matrix.sum(axis=1)
    straight = lf.projection_matrix(scene.changed({"media": ()}), grid).matrix.sum(axis=1)
    lit = straight > 0.5 * straight.max()
    # Voxels in the gas emit into its index, within 5e-4 of 1.
    assert np.mean(bent[lit] / straight[lit]) == pytest.approx(1.0, abs=2e-3)


def test_a_medium_that_also_dims_needs_absorption(scene: lf.Scene) -> None:
    dark = scene.media[0].model_copy(update={"name": "smoke", "absorption_per_mm": 0.01})
    grid = lf.VoxelBox.of_size((1, 1, 1), (2.0, 2.0, 2.0), position_mm=(0.0, 0.0, -60.0))
    with (
        pytest.warns(lf.ClearAirWarning),
        pytest.raises(lf.SceneError, match="smoke bends light and dims it: give absorption = True"),
    ):
        lf.projection_matrix(scene.changed({"media": [dark]}), grid)
