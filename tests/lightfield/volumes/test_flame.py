"""Reconstructed flames: as near to the truth as the best strength brings them, with an error that holds."""

import warnings
from pathlib import Path

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.optics.cie import planck_radiance
from tools.make_flame import HEIGHT_MM, LINE_NM, soot_and_temperature

FIRST_LIGHT = Path(__file__).resolve().parents[3] / "assets" / "scenes" / "first_light.toml"


def flame(grid):
    """Return the soot flame of `tools/make_flame.py`, as tall as a grid, (nx, ny, nz), 1 where it is brightest."""
    x, y, z = grid.axes_mm
    up = y - y[0] + 0.5 * grid.spacing_mm[1]
    smaller = HEIGHT_MM / (grid.shape[1] * grid.spacing_mm[1])
    soot, temperature = soot_and_temperature(
        smaller * np.hypot(x[:, None, None], z[None, None, :]), smaller * up[None, :, None]
    )
    glow = soot * np.vectorize(lambda kelvin: float(planck_radiance(LINE_NM, kelvin)))(np.round(temperature, 1))
    return glow / glow.max()


def flame_scene(**changes):
    """Return the first scene's camera alone, on its image path."""
    alone = {"targets": (), "lights": (), "transport.split": "transmit", "transport.threads": 1}
    return lf.load(FIRST_LIGHT).changed(alone | changes)


def least_by_neighbours(matrix, image, noise, found, true, factor):
    """Return the smallest error of strengths that are some factor below and above the chosen one."""
    return min(
        np.linalg.norm(
            lf.reconstruct(matrix, image, "tikhonov", noise=noise, strength=found.strength * by).volume - true
        )
        for by in (1.0 / factor, factor)
    )


@pytest.mark.parametrize(
    ("lenslets", "side", "step"),
    [((16, 24), 2, 67), pytest.param((64, 64), 1, 9, marks=pytest.mark.long)],
    ids=["every 67th pixel, voxels of 2 mm", "every ninth pixel, voxels of 1 mm"],
)
def test_a_rendered_flame_is_as_near_as_the_best_strength_brings_it_and_its_error_holds(lenslets, side, step, tmp_path):
    """A flame in 16 × 24 × 16 mm, its values trilinear between points 1 mm apart, and a matrix by rays of its own.

    The noise is that of render and model: voxels do not show what lies between the flame's points. With the render's
    alone nobody can tell the error of coarse voxels, and that is said.
    """
    fine = lf.VoxelBox.of_size((16, 24, 16), (16.0, 24.0, 16.0), (0.0, 0.0, -500.0))
    values = flame(fine)
    corner = [-0.5 * (n - 1) for n in fine.shape]
    np.savez(tmp_path / "flame.npz", emission_w_mm3_sr=values, spacing_mm=fine.spacing_mm, origin_mm=corner)
    pixels = (10 * lenslets[0], 10 * lenslets[1])
    scene = flame_scene(**{"camera.mla.count": lenslets, "camera.sensor.pixels": pixels})
    glow = {"name": "flame", "grid": str(tmp_path / "flame.npz"), "position_mm": (0.0, 0.0, -500.0)}
    settings = {"media": [glow], "transport.samples": 8, "transport.replicates": 4, "transport.seed": 5}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        image = lf.render(scene.changed(settings))
    shape = tuple(n // side for n in fine.shape)
    grid = lf.VoxelBox.of_size(shape, (16.0, 24.0, 16.0), (0.0, 0.0, -500.0))
    true = values.reshape(shape[0], side, shape[1], side, shape[2], side).mean(axis=(1, 3, 5))
    some = np.arange(0, pixels[0] * pixels[1], step)
    matrix = lf.projection_matrix(scene.changed({"transport.samples": 32}), grid, pixels=some)
    seen, own = image.mean.reshape(-1)[some], image.error.reshape(-1)[some]
    model = np.sqrt(np.mean((matrix.image(true).reshape(-1) - seen) ** 2))
    noise = np.hypot(np.where(own > 0.0, own, np.median(own[own > 0.0])), model)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", lf.FineVoxelsWarning)
        found = lf.reconstruct(matrix, seen, "tikhonov", noise=noise)
        off = np.linalg.norm(found.volume - true)
        best = least_by_neighbours(matrix, seen, noise, found, true, 4.0)
        best = min(best, least_by_neighbours(matrix, seen, noise, found, true, 16.0))
    assert off < 1.1 * best
    assert off < 0.9 * np.linalg.norm(true)
    assert 0.8 < found.total_error / off < 1.25
    if side > 1:
        with pytest.warns(lf.UnknownErrorWarning, match="the squared residual of the image is"):
            unsure = lf.reconstruct(matrix, seen, "tikhonov", noise=own, strength=found.strength)
        assert np.isnan(unsure.total_error)


@pytest.mark.long
def test_a_flame_of_which_no_depth_is_resolved_is_as_near_as_the_best_strength_brings_it():
    """An axisymmetric flame in 16 × 24 × 16 mm before first light's camera; noise of 1 % of the brightest pixel."""
    scene = flame_scene()
    grid = lf.VoxelBox.of_size((16, 24, 16), (16.0, 24.0, 16.0), (0.0, 0.0, -500.0))
    matrix = lf.projection_matrix(scene, grid)
    assert 25.0 < matrix.resolved_mm[2] < 100.0
    assert 1000 < matrix.effective_rank < 3000
    true = flame(grid)
    clean = matrix.image(true)
    noise = 0.01 * clean.max()
    image = clean + noise * np.random.default_rng(2).standard_normal(len(clean))
    with pytest.warns(lf.FineVoxelsWarning, match="along z 44"):
        found = lf.reconstruct(matrix, image, "tikhonov", noise=noise)
    off = np.linalg.norm(found.volume - true)
    assert off < 1.1 * least_by_neighbours(matrix, image, noise, found, true, 4.0)
    assert off < 0.85 * np.linalg.norm(true)
    assert 0.8 < found.total_error / off < 1.25
