"""Tables of coatings: what kernels look up is what was tabulated, to the error that the table states."""

import numpy as np
import pytest

from lfmesh.kernels.decorators import kernel
from lfmesh.optics.share_table import ALLOWED, TERMS, TOLERANCE, TooManyPiecesError, coated_shares, constant, tabulated


@kernel
def look_up(parameters, pieces, absorbs, n_i, n_t, cos_i, cos_t, total, outward, R, T):
    for i in range(len(cos_i)):
        R[i], T[i] = coated_shares(parameters, 0, pieces, absorbs, 0, n_i, n_t, cos_i[i], cos_t[i], total, outward)


def found(table, n_i, n_t, cos_i, cos_t, total=False, outward=False):
    parameters = table.coefficients.reshape(-1, 1)
    R, T = np.empty(len(cos_i)), np.empty(len(cos_i))
    look_up(parameters, table.pieces, len(table.coefficients) > 1, n_i, n_t, cos_i, cos_t, total, outward, R, T)
    return R, T


def wavy(u, total):
    """Quantities of a made-up coating: from the thin side, from the dense side, transmittance; or under total."""
    if total:
        return 0.9 + 0.1 * np.cos(3.0 * u)[None]
    return np.stack([0.2 + 0.1 * np.cos(20.0 * u), 0.3 + 0.1 * np.sin(9.0 * u), 0.4 - 0.1 * np.cos(20.0 * u)])


COSINES = np.random.default_rng(1).uniform(0.0, 1.0, 20_000)


def test_the_variable_is_the_root_of_the_cosine_in_the_thinner_medium():
    table = tabulated(lambda u, total: wavy(u, total)[:1], absorbs=False)
    u = np.sqrt(COSINES)
    truth = wavy(u, False)[0]
    # From the thin side this is the cosine of incidence, from the dense one that of refraction.
    for R, T in (found(table, 1.0, 1.5, COSINES, np.ones_like(u)), found(table, 1.5, 1.0, np.ones_like(u), COSINES)):
        assert np.abs(R - truth).max() < 2.0 * TOLERANCE
        np.testing.assert_array_equal(R + T, 1.0)


def test_each_side_of_a_coating_that_absorbs_has_its_own_reflectance():
    table = tabulated(wavy, absorbs=True)
    u, ones = np.sqrt(COSINES), np.ones_like(COSINES)
    thin, dense, passed = wavy(u, False)
    for side, n in ((thin, (1.0, 1.5, COSINES, ones)), (dense, (1.5, 1.0, ones, COSINES))):
        R, T = found(table, *n)
        assert np.abs(R - side).max() < 2.0 * TOLERANCE
        assert np.abs(T - passed).max() < 2.0 * TOLERANCE


@pytest.mark.parametrize("outward", [False, True])
def test_between_equal_indices_the_way_of_the_light_tells_the_side(outward):
    table = tabulated(wavy, absorbs=True)
    R, _ = found(table, 1.5, 1.5, COSINES, COSINES, outward=outward)
    assert np.abs(R - wavy(np.sqrt(COSINES), False)[int(outward)]).max() < 2.0 * TOLERANCE


def test_total_reflection_has_a_branch_of_its_own():
    table = tabulated(wavy, absorbs=True)
    n, critical = 1.5, np.sqrt(1.0 - 1.0 / 1.5**2)
    share = COSINES
    R, T = found(table, n, 1.0, critical * share, np.zeros_like(share), total=True)
    u = share / (1.0 + np.sqrt(1.0 - share * share))
    assert np.abs(R - wavy(u, True)[0]).max() < 1e-7
    assert (T == 0.0).all()
    lossless = tabulated(lambda u, total: wavy(u, total)[:1], absorbs=False)
    assert [set(each) for each in found(lossless, n, 1.0, critical * share, 0.0 * share, total=True)] == [{1.0}, {0.0}]


def test_pieces_are_added_until_the_error_is_small_and_it_is_stated():
    def steep(u, total):
        return 1.0 / (1.0 + (u[None] / 0.01) ** 2)

    table = tabulated(steep, absorbs=False)
    assert 64 < table.pieces < 8192
    assert 0.0 < table.error <= TOLERANCE
    # Between the points at which the error was measured it is not much larger.
    R, _ = found(table, 1.0, 1.5, COSINES**4, np.ones_like(COSINES))
    assert np.abs(R - steep(COSINES**2, False)[0]).max() < 3.0 * table.error + 1e-15
    assert tabulated(steep, absorbs=False, least=2048).pieces == 2048


def test_what_changes_too_fast_is_refused_with_its_error():
    with pytest.raises(TooManyPiecesError) as refused:
        tabulated(lambda u, total: 0.5 + 0.5 * np.sign(u[None] - 0.333), absorbs=False)
    assert refused.value.args[0] > ALLOWED


def test_a_fixed_reflectance_is_the_same_at_every_angle():
    table = constant(0.3)
    assert table.coefficients.shape == (1, 1, TERMS)
    R, T = found(table, 1.0, 1.5, COSINES, np.ones_like(COSINES))
    assert set(R) == {0.3}
    assert set(T) == {0.7}
