"""Regularised reconstruction: closed forms, the choice of its strength, errors against the truth over many draws."""

import functools
import re
import warnings

import numpy as np
import pytest
from scipy import optimize, sparse

import lfmesh as lf
from lfmesh.errors import LfmeshError
from lfmesh.lightfield.volumes import regularised, volume_error
from tests.lightfield.volumes.test_projection import box, camera
from tests.lightfield.volumes.test_reconstruction import system


def matrix_of(full, shape, sensor_pixels=None, pixels=None):
    """Return a projection matrix of the grid with unit voxels, known exactly."""
    a = sparse.csr_array(full)
    rows = a.shape[0]
    grid = lf.VoxelBox.of_size(shape, shape)
    none = np.zeros(rows)
    return lf.ProjectionMatrix(
        a, np.zeros(a.nnz, np.float32), none, none, np.arange(rows) if pixels is None else pixels, grid, 0.0, 500.0,
        (), sensor_pixels,
    )  # fmt: skip


def differences(shape):
    """Return the differences of neighbouring voxels of a grid, (edges, voxels), one after another."""
    number = np.arange(np.prod(shape)).reshape(shape)
    found = []
    for place in np.ndindex(*shape):
        for axis in range(3):
            beside = tuple(p + (k == axis) for k, p in enumerate(place))
            if beside[axis] < shape[axis]:
                row = np.zeros(number.size)
                row[number[place]], row[number[beside]] = -1.0, 1.0
                found.append(row)
    return np.array(found)


def scale_of(full, noise, penalty):
    """Return λ at a strength of 1: sums of the diagonals of data over penalty."""
    return np.sum((full / noise[:, None]) ** 2) / np.trace(penalty)


@pytest.mark.parametrize("shape", [(8,), (2, 2, 2)])
def test_tikhonov_is_its_closed_form_where_no_voxel_is_dark(shape):
    full, _, b = system(14, 8, 1)
    noise = np.random.default_rng(2).uniform(0.5, 2.0, 14)
    rough = differences(shape) if len(shape) == 3 else np.eye(8)
    penalty = rough.T @ rough
    strength = 0.3
    weighted = full / noise[:, None]
    normal = weighted.T @ weighted + strength * scale_of(full, noise, penalty) * penalty
    best = np.linalg.solve(normal, weighted.T @ (b / noise))
    assert (best > 0.0).all()
    given = matrix_of(full, shape) if len(shape) == 3 else sparse.csr_array(full)
    found = lf.reconstruct(given, b, "tikhonov", noise=noise, strength=strength)
    np.testing.assert_allclose(found.volume.ravel(), best, rtol=2e-4)
    assert found.strength == strength
    assert found.misfit == pytest.approx(np.sum(((full @ best - b) / noise) ** 2) / 14, rel=1e-3)


def test_without_strength_it_is_weighted_least_squares_that_are_not_negative():
    full, _, b = system(30, 12, 6)
    draw = np.random.default_rng(7)
    noise = draw.uniform(1.0, 3.0, 30)
    b = b + noise * draw.standard_normal(30)
    best = optimize.nnls(full / noise[:, None], b / noise)[0]
    assert (best == 0.0).any()
    found = lf.reconstruct(sparse.csr_array(full), b, "tikhonov", noise=noise, strength=0.0)
    np.testing.assert_allclose(found.volume, best, atol=2e-4 * best.max())


def line(length, blur):
    """Return a matrix of pixels, three a voxel, that see a line of voxels blurred."""
    at = np.linspace(-0.5, length - 0.5, 3 * length)
    full = np.exp(-((at[:, None] - np.arange(length)) ** 2) / (2.0 * blur**2))
    return np.where(full < 1e-4, 0.0, full)


def test_total_variation_keeps_a_step_and_tikhonov_rounds_it():
    full = line(40, 1.2)
    true = np.where(np.arange(40) < 17, 1.0, 3.0)
    image = full @ true
    image = image + 0.01 * image.max() * np.random.default_rng(3).standard_normal(len(image))
    given = matrix_of(full, (40, 1, 1))
    found = {method: lf.reconstruct(given, image, method).volume.ravel() for method in ("tikhonov", "tv")}
    off = {method: np.linalg.norm(volume - true) for method, volume in found.items()}
    assert off["tv"] < 0.7 * off["tikhonov"], off
    steps = {method: np.abs(np.diff(volume)).max() / 2.0 for method, volume in found.items()}
    assert steps["tv"] > 0.8 > steps["tikhonov"], steps


@pytest.mark.parametrize("method", ["tikhonov", "tv"])
def test_the_discrepancy_principle_leaves_the_noise_and_no_more(method):
    full = line(30, 1.5)
    true = 1.0 + np.sin(np.arange(30) / 4.0) ** 2
    noise = 0.03 * np.random.default_rng(4).uniform(0.5, 2.0, len(full)) * (full @ true).max()
    image = full @ true + noise * np.random.default_rng(5).standard_normal(len(full))
    given = matrix_of(full, (30, 1, 1))
    # A little more noise than there is, so that some volume leaves no more.
    found = lf.reconstruct(given, image, method, noise=1.1 * noise, strength="discrepancy")
    assert 0.97 < found.misfit <= 1.0
    stronger = lf.reconstruct(given, image, method, noise=1.1 * noise, strength=1.2 * found.strength)
    assert stronger.misfit > 1.0
    assert found.tried[-1, 1] == pytest.approx(1.0, abs=0.05)
    with pytest.raises(LfmeshError, match='"discrepancy": no volume explains the image'):
        lf.reconstruct(given, image, method, noise=0.3 * noise, strength="discrepancy")


@functools.cache
def errors_of_a_sweep(seed, level):
    """Return matrix, image and true volume of a line, and how far volumes are from it by their strength."""
    full = line(30, 1.5)
    true = 1.0 + np.sin(np.arange(30) / 4.0) ** 2
    given, noise = matrix_of(full, (30, 1, 1)), level * (full @ true).max()
    image = full @ true + noise * np.random.default_rng(seed).standard_normal(len(full))
    off = {
        strength: np.linalg.norm(
            lf.reconstruct(given, image, "tikhonov", noise=noise, strength=strength).volume.ravel() - true
        )
        for strength in 4.0 ** np.arange(1.0, -6.0, -1.0)
    }
    return given, image, true, off


@pytest.mark.parametrize("choice", [None, "half-sets"])
def test_the_strength_chosen_by_the_image_is_near_the_best_of_a_sweep(choice):
    for seed, level in enumerate((0.003, 0.01, 0.1)):
        given, image, true, off = errors_of_a_sweep(seed, level)
        said = []
        found = lf.reconstruct(given, image, "tikhonov", strength=choice, say=said.append)
        assert np.linalg.norm(found.volume.ravel() - true) < 1.3 * min(off.values()), (level, found.strength, off)
        assert np.isnan(found.misfit)
        score = "half-sets of pixels predict" if choice else "expected error"
        assert sum(score in text for text in said) == len(found.tried)
        assert "error by noise" in said[-1]


def test_the_error_by_half_sets_is_as_large_as_the_scatter_over_draws_of_noise():
    """Where no voxel is dark the volume is linear in the image: variances agree, by a z-test of their sums over voxels.

    Of n pixels and p voxels half-sets find (n − p)/(n − 2p) of the variance, as least squares do: here 1.01.
    """
    full, _, b = system(800, 8, 11)
    given, noise = sparse.csr_array(full), 0.1 * np.random.default_rng(1).uniform(0.5, 2.0, 800)
    draw = np.random.default_rng(12)
    found = [
        lf.reconstruct(given, b + noise * draw.standard_normal(800), "tikhonov", noise=noise, strength=0.02)
        for _ in range(60)
    ]
    volumes = np.array([each.volume for each in found])
    assert volumes.min() > 0.0
    scatter = ((volumes - volumes.mean(axis=0)) ** 2).sum(axis=1) * 60.0 / 59.0
    stated = np.array([(each.error**2).sum() for each in found])
    z = (stated.mean() - scatter.mean()) / np.hypot(stated.std(), scatter.std()) * np.sqrt(60.0)
    assert abs(z) < 3.5, (stated.mean(), scatter.mean())
    assert 0.8 < np.sqrt(stated.mean() / scatter.mean()) < 1.25


def blind_to_depth(side, views=4, tilt=0.04):
    """Return the matrix of a grid of side³ voxels whose columns along z views see summed, each a little tilted."""
    number = np.arange(side**3).reshape(side, side, side)
    rows = []
    for view in range(views):
        for i in range(side):
            for j in range(side):
                row = np.zeros(side**3)
                for k in range(side):
                    moved = tilt * (view - 0.5 * (views - 1)) * (k - 0.5 * (side - 1))
                    for step in (0, 1):
                        at = i + int(np.floor(moved)) + step
                        share = 1.0 - abs(moved - np.floor(moved) - step)
                        if 0 <= at < side:
                            row[number[at, j, k]] += share
                rows.append(row)
    return np.array(rows)


def ball(side, draw):
    """Return a soft ball somewhere near the middle of a grid, as deep as wide."""
    centre = 0.5 * (side - 1) + draw.uniform(-1.0, 1.0, 3)
    squared = ((np.stack(np.indices((side,) * 3), axis=-1) - centre) ** 2).sum(axis=-1)
    return np.exp(-squared / (2.0 * draw.uniform(1.2, 2.2) ** 2))


def test_the_stated_error_holds_for_depth_that_is_not_resolved():
    side = 8
    full = blind_to_depth(side)
    given = matrix_of(full, (side,) * 3)
    draw = np.random.default_rng(21)
    ratios, noises = [], []
    for _ in range(6):
        true = ball(side, draw)
        image = full @ true.ravel()
        noise = 0.01 * image.max()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", lf.FineVoxelsWarning)
            found = lf.reconstruct(given, image + noise * draw.standard_normal(len(image)), "tikhonov", noise=noise)
        off = np.linalg.norm(found.volume - true)
        assert off > 0.3 * np.linalg.norm(true)
        ratios.append(found.total_error / off)
        noises.append(np.linalg.norm(found.error) / off)
    assert 0.8 < np.mean(ratios) < 1.25, ratios
    assert np.min(ratios) > 0.6
    assert np.max(ratios) < 1.7
    # Half-sets alone do not know of it.
    assert np.mean(noises) < 0.6


def voxels_of_revolution(emission, shape, parts=12):
    """Return the voxel means of an emission by its radius, voxels, about the middle of (x, z)."""
    x, z = ((np.arange(n * parts) + 0.5) / parts - 0.5 * n for n in shape)
    values = emission(np.hypot(x[:, None], z[None, :]))
    return values.reshape(shape[0], parts, shape[1], parts).mean(axis=(1, 3))


@pytest.mark.parametrize("kind", ["ball", "mantle"])
def test_volumes_as_deep_as_wide_are_round_and_have_the_same_sums(kind):
    """Round emissions, smeared along z, are found again from their sums; so are those in y and z.

    A mantle is one voxel thick: by values at whole radii and at the middles of voxels it is off by a fifth.
    """
    emission = {"ball": lambda r: np.exp(-((r / 2.5) ** 2)), "mantle": lambda r: np.exp(-(((r - 2.2) / 0.5) ** 2))}[
        kind
    ]
    disk = voxels_of_revolution(emission, (9, 7))
    true = disk[:, None, :] * np.array([1.0, 0.0, 2.0])[None, :, None]
    smeared = np.broadcast_to(true.mean(axis=2, keepdims=True), true.shape)
    first, other = volume_error.as_deep_as_wide(smeared, 2)
    assert np.linalg.norm(first - true) < 0.08 * np.linalg.norm(true)
    assert np.linalg.norm((first - true).sum(axis=2)) < 0.01 * np.linalg.norm(true.sum(axis=2))
    assert other.shape == true.shape
    # The depth may be any axis.
    turned = volume_error.as_deep_as_wide(np.transpose(smeared, (2, 0, 1)), 0)
    np.testing.assert_allclose(np.transpose(turned[0], (1, 2, 0)), first, atol=1e-9)
    line_of = np.arange(5.0).reshape(1, 1, 5)
    np.testing.assert_array_equal(volume_error.as_deep_as_wide(line_of, 2)[0], line_of)


@pytest.mark.parametrize("method", ["tikhonov", "tv"])
def test_the_unit_of_matrix_image_and_noise_does_not_matter(method):
    full = line(12, 1.0)
    b = full @ np.linspace(0.5, 2.0, 12) + 0.05 * np.random.default_rng(2).standard_normal(len(full))
    plain = lf.reconstruct(matrix_of(full, (12, 1, 1)), b, method, noise=0.05)
    scaled = lf.reconstruct(matrix_of(1e-14 * full, (12, 1, 1)), 1e-9 * b, method, noise=5e-11)
    assert scaled.strength == plain.strength
    for name in ("volume", "error", "total_error"):
        np.testing.assert_allclose(getattr(scaled, name), 1e5 * np.array(getattr(plain, name)), rtol=1e-6)


def test_the_noise_of_a_render_and_of_the_matrix_weights_the_pixels():
    """The image's own error is taken: to rounding the volume of that error given with its floor, not an even one."""
    grid = box((3, 3, 2), rotation_deg=(0.0, 0.0, 0.0))
    plate = {
        "shape": {"kind": "plane", "width_mm": 8.0, "height_mm": 8.0},
        "position_mm": [0.0, 0.0, -60.0],
        "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0},
    }
    image = lf.render(camera([plate], samples=512))
    matrix = lf.projection_matrix(camera(seed=5), grid)
    first = lf.reconstruct(matrix, image.mean, "tikhonov", strength=1.0).volume
    variance = regularised.not_too_certain(image.error.reshape(-1) ** 2, matrix.image(first).reshape(-1), 1.0)
    own, given, even = (
        lf.reconstruct(matrix, each, "tikhonov", strength=0.1, noise=noise).volume
        for each, noise in ((image, None), (image.mean, np.sqrt(variance)), (image.mean, None))
    )
    assert np.abs(own - even).max() > 0.05 * own.max()
    np.testing.assert_allclose(own, given, rtol=0.0, atol=1e-6 * own.max())


def test_the_noise_of_a_matrix_is_about_what_other_rays_show():
    """Between two seeds, at volumes with structure, in all pixels together; entries count as independent."""
    grid = box((5, 4, 6), rotation_deg=(0.0, 0.0, 0.0))
    x = np.random.default_rng(6).uniform(0.0, 1.0, grid.voxels)
    one, other = (lf.projection_matrix(camera(samples=64, replicates=16, seed=seed), grid) for seed in (1, 2))
    stated = regularised.noise_of_matrix(one, x) + regularised.noise_of_matrix(other, x)
    shown = (one.image(x) - other.image(x)) ** 2
    assert 0.8 < np.sqrt(stated.sum() / shown.sum()) < 1.6


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"iterations": 5}, 'iterations = 5: method = "tikhonov" has none'),
        ({"relaxation": 1.0, "method": "tv"}, 'relaxation = 1.0: method = "tv" has none'),
        ({"noise": 1.0, "method": "nnls"}, 'noise: method = "nnls" has none'),
        ({"strength": 1.0, "method": "mart"}, 'strength: method = "mart" has none'),
        ({"strength": -1.0}, "strength = -1.0: must be a number from 0"),
        ({"strength": 1e300}, r"strength = 1e\+300: must be a number from 0 to 1e\+06"),
        ({"strength": "best"}, 'strength = "best": must be a number from 0 to .*, "half-sets" or "discrepancy"'),
        ({"strength": "discrepancy"}, "needs noise"),
        ({"noise": [1.0, 2.0]}, r"the noise has the shape \(2,\), but the matrix has 3 rows"),
        ({"noise": [1.0, -2.0, 1.0]}, "noise: must be standard errors"),
        ({"noise": 0.0}, "noise: must be standard errors"),
        ({"noise": "much"}, "noise must be numbers"),
    ],
)
def test_bad_settings_are_told_in_one_line(arguments, message):
    given = {"matrix": sparse.csr_array(np.eye(3)), "image": [1.0, 2.0, 3.0], "method": "tikhonov"} | arguments
    with pytest.raises(LfmeshError, match=message) as refused:
        lf.reconstruct(**given)
    assert "\n" not in str(refused.value)


def told(*arguments, **settings):
    """Return a reconstruction and why its error cannot be told, as was warned of."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = lf.reconstruct(*arguments, **settings)
    why = [str(each.message) for each in caught if each.category is lf.UnknownErrorWarning]
    assert why == [str(each) for each in found.warnings if isinstance(each, lf.UnknownErrorWarning)]
    assert np.isnan(found.total_error) if why else found.total_error > 0.0
    return found, "".join(why)


def image_of_a_ball(seed, level, side=7):
    """Return matrix, true volume, image, and its noise, which is a share of the brightest pixel."""
    draw = np.random.default_rng(seed)
    full, true = blind_to_depth(side), ball(side, draw)
    clean = full @ true.ravel()
    noise = level * clean.max()
    return matrix_of(full, (side,) * 3), true, clean + noise * draw.standard_normal(len(clean)), noise


@pytest.mark.parametrize("is_noise_known", [True, False])
def test_an_image_swallowed_by_noise_determines_no_volume(is_noise_known):
    for seed in range(3):
        given, _, image, noise = image_of_a_ball(seed, 3.0)
        _, why = told(given, image, "tikhonov", noise=noise if is_noise_known else None)
        assert "the image does not determine the volume" in why
        given, true, image, noise = image_of_a_ball(seed, 0.1)
        found, why = told(given, image, "tikhonov", noise=noise if is_noise_known else None)
        assert not why
        assert 0.8 < found.total_error / np.linalg.norm(found.volume - true) < 1.6


def test_a_strength_that_is_too_large_for_the_image_is_told():
    """What is left of the image shows it where the noise is known, what a weaker one predicts where it is not."""
    given, _, image, noise = image_of_a_ball(0, 0.01)
    for strength in (100.0, 1e4, 1e6):
        assert "strength of" in told(given, image, "tikhonov", noise=noise, strength=strength)[1]
        assert "a smaller one uses more" in told(given, image, "tikhonov", strength=strength)[1]
    assert not told(given, image, "tikhonov", noise=noise, strength=1.0)[1]
    assert "the noise too small" in told(given, image, "tikhonov", noise=0.2 * noise)[1]


@pytest.mark.parametrize("method", ["tikhonov", "tv"])
def test_images_without_light_give_a_volume_whose_error_is_unknown(method):
    """Pure noise, where some draws sum up to less than nothing, an image of the wrong sign, and a dark one."""
    full = line(12, 1.0)
    given = matrix_of(full, (12, 1, 1))
    for seed in range(4):
        noise = np.random.default_rng(seed).standard_normal(len(full))
        found, why = told(given, noise, method, noise=1.0)
        assert np.isfinite(found.volume).all()
        assert "the image does not determine the volume" in why, seed
    negative, why = told(given, -(full @ np.linspace(1.0, 2.0, 12)), method)
    assert not negative.volume.any()
    assert "the image does not determine the volume" in why
    dark, why = told(given, np.zeros(len(full)), method)
    assert not dark.volume.any()
    assert why.endswith("the image is dark")


@pytest.mark.parametrize("method", ["tikhonov", "tv"])
def test_a_voxel_without_neighbours_is_weighted_least_squares(method):
    draw = np.random.default_rng(3)
    column, noise = draw.uniform(0.5, 1.0, 40), draw.uniform(0.05, 0.1, 40)
    image = 3.0 * column + noise * draw.standard_normal(40)
    best = np.sum(column * image / noise**2) / np.sum((column / noise) ** 2)
    for strength in (None, 0.0, 5.0, "discrepancy"):
        given = matrix_of(column[:, None], (1, 1, 1))
        found, why = told(given, image, method, noise=1.2 * noise, strength=strength)
        assert found.volume.shape == (1, 1, 1)
        assert found.volume.item() == pytest.approx(best, rel=1e-4)
        assert not why
        assert found.total_error < 0.3
    # Two that stand apart, and one pixel alone.
    apart = np.zeros((40, 3))
    apart[:20, 0], apart[20:, 2] = column[:20], column[20:]
    volume = lf.reconstruct(matrix_of(apart, (3, 1, 1)), image, method, strength=1.0).volume.ravel()
    np.testing.assert_allclose(volume, [3.0, 0.0, 3.0], atol=0.2)
    alone, why = told(matrix_of(np.ones((1, 1)), (1, 1, 1)), [2.0], method)
    assert alone.volume.item() == pytest.approx(2.0, rel=1e-4)
    assert "does not determine" in why


def test_without_strength_the_error_is_finite_also_where_half_of_the_pixels_miss_a_voxel():
    full = np.eye(6)[[0, 1, 2, 2, 3, 3, 4, 4, 5, 5]]
    found = lf.reconstruct(sparse.csr_array(full), np.arange(1.0, 11.0), "tikhonov", strength=0.0)
    np.testing.assert_allclose(found.volume, [1.0, 2.0, 3.5, 5.5, 7.5, 9.5], rtol=1e-3)
    assert np.isfinite(found.error).all()


def test_the_discrepancy_principle_takes_honest_images_whose_noise_is_a_little_more_than_its_mean():
    full = line(30, 1.5)
    true = 1.0 + np.sin(np.arange(30) / 4.0) ** 2
    given, noise, most = matrix_of(full, (30, 1, 1)), 0.03 * (full @ true).max(), 1.0 + 3.0 * np.sqrt(2.0 / len(full))
    draw, left = np.random.default_rng(8), []
    for _ in range(12):
        unit = draw.standard_normal(len(full))
        # As much noise as one image of six has, or more.
        image = full @ true + noise * unit * np.sqrt(1.3 * len(full) / (unit @ unit))
        left.append(told(given, image, "tikhonov", noise=noise, strength="discrepancy")[0].misfit)
    assert 1.0 < max(left) <= most
    with pytest.raises(LfmeshError, match="no volume explains the image within its noise"):
        lf.reconstruct(given, full @ true + 2.0 * noise * unit, "tikhonov", noise=noise, strength="discrepancy")


@pytest.mark.parametrize("method", ["mart", "rl", "sart", "nnls", "tikhonov", "tv"])
def test_images_have_the_shape_of_the_rectangle_of_pixels_or_stand_in_a_row(method):
    full, _, b = system(12, 4, 1)
    whole = matrix_of(full, (2, 2, 1), sensor_pixels=(4, 3))
    # A strength of its own would be searched for in each image.
    settings = {"strength": 0.1} if method in ("tikhonov", "tv") else {}
    plain = lf.reconstruct(whole, b, method, **settings).volume
    for fits in (b.reshape(3, 4), b.reshape(3, 4, 1)):
        np.testing.assert_array_equal(lf.reconstruct(whole, fits, method, **settings).volume, plain)
    for wrong in (b.reshape(3, 4).T, b.reshape(2, 6), b.reshape(12, 1), b.reshape(4, 3, 1)):
        with pytest.raises(LfmeshError, match=rf"{re.escape(str(wrong.shape))}, .* of the shape \(3, 4\): give that"):
            lf.reconstruct(whole, wrong, method, **settings)
    # Some pixels of a wider sensor: a rectangle of three rows of four, and none.
    part = matrix_of(full, (2, 2, 1), (10, 7), (10 * np.arange(2, 5)[:, None] + np.arange(3, 7)).ravel())
    np.testing.assert_array_equal(lf.reconstruct(part, b.reshape(3, 4), method, **settings).volume, plain)
    scattered = matrix_of(full, (2, 2, 1), (10, 7), 5 * np.arange(12))
    np.testing.assert_array_equal(lf.reconstruct(scattered, b, method, **settings).volume, plain)
    with pytest.raises(LfmeshError, match="12 pixels that fill no rectangle: give 12 values in a row"):
        lf.reconstruct(scattered, b.reshape(3, 4), method, **settings)


class FewHits(lf.Image):
    """An image whose errors are estimated from the few hits of each pixel: none where there were none."""

    def __init__(self, hits):
        self.hits_found = hits

    mean = property(lambda self: self.hits_found)
    error = property(lambda self: np.where(self.hits_found > 0, np.sqrt(self.hits_found), 1e-12))


@pytest.mark.parametrize(("noise_is", "least"), [("of the image", 0.9), ("given", 0.6)])
def test_pixels_that_few_samples_left_dark_make_no_dark_volume(noise_is, least):
    """Poisson counts of 3 a pixel in the mean, and errors by the counts themselves: most of the light comes back.

    Weights by counts lose 1 of 3 at least; dark pixels that are certain of it, all light.
    """
    full = line(30, 1.5)
    true = 1.0 + np.sin(np.arange(30) / 4.0) ** 2
    given = matrix_of(full, (30, 1, 1))
    unit = 3.0 / (full @ true).mean()
    shares = []
    for seed in range(6):
        image = FewHits(np.random.default_rng(seed).poisson(unit * (full @ true)).astype(np.float64))
        options = {"noise": image.error} if noise_is == "given" else {}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            found = lf.reconstruct(given, image.mean if options else image, "tikhonov", strength=0.03, **options)
        shares.append(found.volume.sum() / unit / true.sum())
    error = np.std(shares, ddof=1) / np.sqrt(len(shares))
    assert np.mean(shares) > least - 3.7 * error, shares


def test_noise_has_the_shape_of_the_image():
    full, _, b = system(12, 4, 1)
    whole = matrix_of(full, (2, 2, 1), sensor_pixels=(4, 3))
    with pytest.raises(LfmeshError, match=r"the noise has the shape \(4, 3\), .* of the shape \(3, 4\)"):
        lf.reconstruct(whole, b, "tikhonov", noise=np.ones((4, 3)))
    with pytest.raises(LfmeshError, match="the noise is complex"):
        lf.reconstruct(whole, b, "tikhonov", noise=np.ones(12) * 1j)
