"""Resolution of a camera in a box: lengths of known blur, singular values counted, and who is warned."""

import warnings

import numpy as np
import pytest
from scipy import sparse

import lfmesh as lf
from lfmesh.lightfield.volumes import resolution
from tests.lightfield.volumes.test_regularised import blind_to_depth, line, matrix_of


def test_the_resolved_length_is_that_of_a_gaussian_blur():
    """Images exp(−x²/2s²) at a distance d have the cosine exp(−d²/4s²): 1/2 at 2 s √(ln 2)."""
    blur, spacing = 3.0, 0.25
    full = np.repeat(line(40, blur)[:, :, None], 4, axis=2).reshape(-1, 160)
    found = resolution.resolved_lengths(sparse.csr_array(full), (1, 40, 4), np.array([1.0, spacing, 2.0]))
    assert np.isnan(found[0])
    assert found[1] == pytest.approx(2.0 * blur * np.sqrt(np.log(2.0)) * spacing, rel=0.03)
    # Voxels behind each other have one image.
    assert found[2] > 1e6
    sharp = resolution.resolved_lengths(sparse.csr_array(np.eye(24)), (4, 3, 2), np.array([1.0, 2.0, 3.0]))
    np.testing.assert_array_equal(sharp, [1.0, 2.0, 3.0])


def test_the_effective_rank_counts_singular_values_above_a_hundredth(monkeypatch):
    draw = np.random.default_rng(3)
    left, right = (np.linalg.qr(draw.standard_normal((n, 300)))[0] for n in (500, 400))
    values = np.geomspace(1.0, 1e-4, 300)
    full = sparse.csr_array((left * values) @ right.T)
    true = int((values > 0.01).sum())
    assert resolution.effective_rank(full) == true == 150
    monkeypatch.setattr(resolution, "MOST_EXACT", 0)
    assert resolution.effective_rank(full) == pytest.approx(true, rel=0.07)


METHODS = ["mart", "rl", "sart", "nnls", "tikhonov", "tv"]


@pytest.mark.parametrize("method", METHODS)
def test_every_method_warns_of_voxels_that_are_finer_than_the_camera_resolves(method):
    full = blind_to_depth(5)
    with pytest.warns(lf.FineVoxelsWarning, match=r"of 125 voxels only .*along z .* mm are resolved") as told:
        found = lf.reconstruct(matrix_of(full, (5, 5, 5)), full.sum(axis=1), method)
    fine = [each for each in found.warnings if isinstance(each, lf.FineVoxelsWarning)]
    assert fine == [each.message for each in told if each.category is lf.FineVoxelsWarning]


@pytest.mark.parametrize("method", METHODS)
def test_no_method_warns_of_voxels_that_the_camera_resolves(method):
    full = np.eye(8) + 0.1
    with warnings.catch_warnings():
        warnings.simplefilter("error", lf.FineVoxelsWarning)
        found = lf.reconstruct(matrix_of(full, (2, 2, 2)), full.sum(axis=1), method)
    assert not [each for each in found.warnings if isinstance(each, lf.FineVoxelsWarning)]
