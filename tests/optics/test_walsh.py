"""Walsh's share of diffuse light against the integral of Fresnel's equations, and its limits."""

import mpmath as mp
import pytest

from lfmesh.optics.walsh import diffuse_reflectance

RATIOS = [1.01, 1.05, 1.1, 1.333, 1.5, 1.7, 2.0, 2.5, 3.0, 4.0]


def integral(n_i: float, n_t: float) -> mp.mpf:
    """∫ 2 c R(c) dc over the cosine, by 30-digit quadrature that is split where total reflection begins."""
    with mp.workdps(30):
        n1, n2 = mp.mpf(n_i), mp.mpf(n_t)

        def reflected(c: mp.mpf) -> mp.mpf:
            s2 = (n1 / n2) ** 2 * (1 - c * c)
            if s2 >= 1:
                return 2 * c
            d = mp.sqrt(1 - s2)
            s = (n1 * c - n2 * d) / (n1 * c + n2 * d)
            p = (n2 * c - n1 * d) / (n2 * c + n1 * d)
            return c * (s * s + p * p)

        bends = [mp.sqrt(1 - (n2 / n1) ** 2)] if n1 > n2 else [mp.sqrt(n2 - n1)]
        return mp.quad(reflected, [0, *(b for b in bends if 0 < b < 1), 1])


@pytest.mark.parametrize("n", RATIOS)
def test_walsh_is_the_integral_of_fresnel_from_both_sides(n: float) -> None:
    assert abs(diffuse_reflectance(1.0, n) - integral(1.0, n)) < 1e-12
    assert abs(diffuse_reflectance(n, 1.0) - integral(n, 1.0)) < 1e-12


@pytest.mark.parametrize(("n", "share"), [(1.5, 0.091778), (1.1, 0.025157), (2.5, 0.221867)])
def test_published_values(n: float, share: float) -> None:
    assert diffuse_reflectance(1.0, n) == pytest.approx(share, abs=6e-7)
    assert diffuse_reflectance(1.5, 1.0) == pytest.approx(0.596346, abs=6e-7)


def test_equal_indices_reflect_nothing_and_nearly_equal_ones_almost_nothing() -> None:
    assert diffuse_reflectance(1.5, 1.5) == 0.0
    last = 0.0
    for difference in (2.0**-52, 1e-12, 1e-9, 1e-6, 1e-3):
        share = diffuse_reflectance(1.0, 1.0 + difference)
        # To first order in n − 1, grazing light alone is reflected: a share of the order of n − 1.
        assert last < share < difference
        last = share


def test_only_the_ratio_of_the_indices_counts() -> None:
    assert diffuse_reflectance(1.5, 3.0) == diffuse_reflectance(1.0, 2.0)
