"""Reconstruction of volumes: single steps against the formulas, limits against what theory says they are."""

import numpy as np
import pytest
from scipy import optimize, sparse

import lfmesh as lf
from lfmesh.errors import LfmeshError
from lfmesh.lightfield.volumes import algebraic
from tests.cameras import close_up_camera


def system(rows, columns, seed, density=0.5):
    """Return a random matrix without zero rows and columns, a positive volume, and its image."""
    draw = np.random.default_rng(seed)
    full = draw.uniform(0.1, 1.0, (rows, columns)) * (draw.random((rows, columns)) < density)
    full[np.arange(rows), np.arange(rows) % columns] = 0.7
    full[np.arange(columns) % rows, np.arange(columns)] = 0.6
    x = draw.uniform(0.5, 2.0, columns)
    return full, x, full @ x


def test_a_round_of_mart_is_the_formula_row_after_row():
    full, _, b = system(6, 9, 1)
    start = b.sum() / full.sum()
    x = np.full(9, start)
    for i in range(6):
        ratio = b[i] / sum(full[i, k] * x[k] for k in range(9))
        x = np.array([x[j] * ratio ** (0.8 * full[i, j] / full.max()) for j in range(9)])
    found = lf.reconstruct(sparse.csr_array(full), b, "mart", 1, 0.8)
    np.testing.assert_allclose(found.volume, x, rtol=1e-12)


def test_what_a_render_returns_is_an_image():
    scene = lf.Scene(
        camera=close_up_camera(4, 4),
        targets=[{"shape": {"kind": "plane", "width_mm": 9.0, "height_mm": 9.0}, "position_mm": [0, 0, -60.0],
                  "material": {"radiance_w_m2_sr": 1.0}}],
        transport={"samples": 8, "split": "transmit"},
    )  # fmt: skip
    image, matrix = lf.render(scene), sparse.csr_array(np.eye(16))
    np.testing.assert_array_equal(
        lf.reconstruct(matrix, image, "nnls").volume, lf.reconstruct(matrix, image.mean, "nnls").volume
    )


def test_a_round_of_sart_is_the_formula():
    full, _, b = system(6, 9, 2)
    x = np.zeros(9)
    for _ in range(3):
        off = [(b[i] - full[i] @ x) / full[i].sum() for i in range(6)]
        x = np.array([x[j] + 0.9 * sum(full[i, j] * off[i] for i in range(6)) / full[:, j].sum() for j in range(9)])
        x = np.maximum(x, 0.0)
    found = lf.reconstruct(sparse.csr_array(full), b, "sart", 3, 0.9)
    np.testing.assert_allclose(found.volume, x, rtol=1e-12)


def test_mart_goes_to_the_volume_of_largest_entropy_of_all_that_give_the_image():
    """Lent (1977): log x − log start lies in the row space of the matrix, whose image x has."""
    full, _, b = system(5, 12, 3)
    found = lf.reconstruct(sparse.csr_array(full), b, "mart", 4000)
    np.testing.assert_allclose(full @ found.volume, b, rtol=1e-9)
    logs = np.log(found.volume / (b.sum() / full.sum()))
    beside = logs - full.T @ np.linalg.lstsq(full.T, logs, rcond=None)[0]
    assert np.abs(beside).max() < 1e-9 * np.abs(logs).max()


def test_richardson_lucy_keeps_the_light_and_raises_the_likelihood() -> None:
    random = np.random.default_rng(5)
    full = random.random((40, 12)) * (random.random((40, 12)) < 0.5)
    b = random.poisson(20.0 * full @ random.random(12)).astype(np.float64)
    b[full.sum(axis=1) == 0.0] = 0.0
    likelihood = []
    for rounds in (1, 2, 5, 20, 100):
        x = lf.reconstruct(sparse.csr_array(full), b, "rl", rounds).volume
        assert (full @ x).sum() == pytest.approx(b.sum())
        shown = full @ x
        lit = b > 0.0
        likelihood.append((b[lit] * np.log(shown[lit])).sum() - shown.sum())
    assert (np.diff(likelihood) > 0.0).all()
    first = lf.reconstruct(sparse.csr_array(full), b, "rl", 1).volume
    flat = np.full(12, b.sum() / full.sum())
    sums = full.sum(axis=1)
    ratio = np.divide(b, sums * flat[0], out=np.zeros(40), where=sums > 0.0)
    np.testing.assert_allclose(first, flat * (full.T @ ratio) / full.sum(axis=0))


def test_sart_goes_to_least_squares_with_rows_over_their_sums():
    """Jiang & Wang (2003), on a system that no volume solves; the best one is positive."""
    full, x, b = system(14, 6, 4)
    b = b * (1.0 + 0.02 * np.random.default_rng(5).standard_normal(14))
    weight = np.sqrt(1.0 / full.sum(axis=1))
    best = np.linalg.lstsq(full * weight[:, None], b * weight, rcond=None)[0]
    assert (best > 0.0).all()
    found = lf.reconstruct(sparse.csr_array(full), b, "sart", 20000)
    np.testing.assert_allclose(found.volume, best, rtol=1e-8)
    assert (np.diff(lf.reconstruct(sparse.csr_array(full), full @ x, "sart", 50).residual) < 0.0).all()


def test_nnls_is_scipys_also_where_the_matrix_is_too_large_for_it(monkeypatch):
    full, _, b = system(30, 12, 6)
    # Some voxels would be negative.
    b = b + 2.0 * np.random.default_rng(7).standard_normal(30)
    best = optimize.nnls(full, b)[0]
    assert (best == 0.0).any()
    found = lf.reconstruct(sparse.csr_array(full), b, "nnls")
    np.testing.assert_allclose(found.volume, best, rtol=1e-9, atol=1e-12)
    monkeypatch.setattr(algebraic, "MOST_DENSE", 0)
    found = lf.reconstruct(sparse.csr_array(full), b, "nnls")
    np.testing.assert_allclose(found.volume, best, atol=1e-5 * best.max())


@pytest.mark.parametrize("method", ["mart", "rl", "sart", "nnls"])
def test_zero_rows_and_columns_change_nothing_and_give_dark_voxels(method):
    full, x, b = system(12, 8, 8)
    wide = np.insert(np.insert(full, 5, 0.0, axis=0), 3, 0.0, axis=1)
    # A row without entries explains no light: whatever its pixel shows has no effect.
    image = np.insert(b, 5, 0.3 * b.max())
    plain = lf.reconstruct(sparse.csr_array(full), b, method, 300)
    found = lf.reconstruct(sparse.csr_array(wide), image, method, 300)
    assert not found.seen[3]
    assert found.volume[3] == 0.0
    assert found.seen.sum() == 8
    # MART starts from the image's mean, which the extra pixel is part of; an invertible system forgets the start.
    np.testing.assert_allclose(np.delete(found.volume, 3), plain.volume, rtol=1e-6, atol=1e-6)
    assert found.quality(np.insert(x, 3, 0.0)) > 0.99


@pytest.mark.parametrize("method", ["mart", "rl", "sart", "nnls"])
def test_the_unit_of_matrix_and_image_does_not_matter(method):
    full, _, b = system(8, 6, 9)
    plain = lf.reconstruct(sparse.csr_array(full), b, method, 40).volume
    scaled = lf.reconstruct(sparse.csc_array(1e-14 * full), 1e-9 * b.reshape(2, 4), method, 40).volume
    np.testing.assert_allclose(scaled, 1e5 * plain, rtol=1e-9)


def test_mart_makes_what_a_dark_pixel_sees_dark():
    full = np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 2.0]])
    found = lf.reconstruct(sparse.csr_array(full), [0.0, 3.0], "mart", 50).volume
    assert found[:2].max() < 1e-20
    assert found[2] == pytest.approx(1.5, rel=1e-12)
    assert not lf.reconstruct(sparse.csr_array(full), [0.0, 0.0]).volume.any()


def test_a_pixel_that_is_dark_by_noise_does_not_put_out_what_others_see():
    """A hundred pixels see the voxel as it is, and a faint one sees nothing."""
    full = np.array([[1.0]] * 100 + [[0.01]])
    found = lf.reconstruct(sparse.csr_array(full), [2.0] * 100 + [0.0], "mart").volume
    assert found[0] == pytest.approx(2.0, rel=0.05)


def test_quality_is_the_cosine_of_two_volumes():
    assert lf.volume_quality([[1.0, 2.0]], [[3.0, 6.0]]) == pytest.approx(1.0, rel=1e-15)
    assert lf.volume_quality([1.0, 0.0], [1.0, 1.0]) == pytest.approx(np.sqrt(0.5), rel=1e-15)
    assert lf.volume_quality([1.0, 0.0], [0.0, 1.0]) == 0.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"method": "art"}, 'method = "art": use one of mart, rl, sart, nnls'),
        ({"method": 3}, "method = 3: use one of"),
        ({"image": [1.0, 2.0]}, r"the image has the shape \(2,\), but the matrix has 3 rows"),
        ({"image": np.ones((1, 1, 3))}, "the matrix has 3 rows, one per pixel"),
        ({"image": [1.0, np.nan, 0.0]}, "not finite"),
        ({"image": ["a", "b", "c"]}, "image must be numbers"),
        ({"image": np.array([1.0, 2.0, 3.0j])}, "the image is complex"),
        ({"image": [1.0, 2.0, 3.0j]}, "the image is complex"),
        ({"matrix": np.eye(3)}, "matrix is ndarray: give what lf.projection_matrix returns"),
        ({"matrix": sparse.csr_array(-np.eye(3))}, "negative or not finite"),
        ({"matrix": sparse.csr_array((3, 4))}, "no entry above 0"),
        ({"iterations": 0}, "iterations = 0: must be a whole number from 1"),
        ({"iterations": 2.5}, "iterations = 2.5: must be a whole number from 1"),
        ({"relaxation": 2.0}, "relaxation = 2.0: must lie between 0 and 2"),
        ({"relaxation": float("nan")}, "relaxation = nan: must lie between 0 and 2"),
        ({"relaxation": 1.0, "method": "nnls"}, '"nnls" has none'),
    ],
)
def test_bad_input_is_told_in_one_line(arguments, message):
    given = {"matrix": sparse.csr_array(np.eye(3)), "image": [1.0, 2.0, 3.0]} | arguments
    with pytest.raises(LfmeshError, match=message) as refused:
        lf.reconstruct(**given)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(("found", "true"), [([1.0], [1.0, 2.0]), ([0.0], [1.0]), ([1.0], [np.inf])])
def test_volumes_without_a_quality_are_refused(found, true):
    with pytest.raises(LfmeshError, match="volume"):
        lf.volume_quality(found, true)
