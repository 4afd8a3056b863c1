"""Scattering by spheres against published tables, against miepython's amplitudes, and in the limit of small ones."""

import miepython
import numpy as np
import pytest

from lfmesh.optics.mie import _brightness, _efficiencies, _multipoles, mie_sphere
from lfmesh.optics.phase import rayleigh

PUBLISHED = [
    # Wiscombe, NCAR/TN-140+STR (1979), table of test cases: index n - ik, size, Q_ext, Q_sca, g
    (1.5, 10.0, 2.881999, 2.881999, 0.742913),
    (1.5, 100.0, 2.094388, 2.094388, 0.818246),
    (0.75, 10.0, 2.232265, 2.232265, 0.896473),
    (1.33 - 1e-5j, 1.0, 0.093952, 0.093923, 0.184517),
    (1.33 - 1e-5j, 100.0, 2.101321, 2.096594, 0.868959),
    (1.5 - 1.0j, 1.0, 2.336321, 0.663454, 0.192136),
    (1.5 - 1.0j, 100.0, 2.097502, 1.283697, 0.850252),
    # Bohren & Huffman (1983), appendix A, the sample of BHMIE, with g by Wiscombe's program
    (1.55, 5.212820, 3.10543, 3.10543, 0.63314),
]


@pytest.mark.parametrize(("index", "x", "extinction", "scattering", "g"), PUBLISHED)
def test_efficiencies_are_the_published_ones(index, x, extinction, scattering, g):
    found = _efficiencies(*_multipoles(complex(index), x), x)
    last_digit = 5.1e-7 if x != 5.212820 else 6e-6
    np.testing.assert_allclose(found, (extinction, scattering, g), rtol=0.0, atol=last_digit)


@pytest.mark.parametrize(("index", "x"), [(1.5, 0.3), (1.2, 7.0), (1.33 - 0.02j, 40.0)])
def test_brightness_is_that_of_miepythons_amplitudes(index, x):
    mu = np.concatenate([np.linspace(-1.0, 1.0, 57), [0.9999, 0.99]])
    truth = 2.0 * miepython.i_unpolarized(index, x, mu, norm="wiscombe")
    ours = _brightness(*_multipoles(complex(index), x), mu)
    np.testing.assert_allclose(ours, truth, rtol=1e-9, atol=1e-12 * truth.max())


@pytest.mark.parametrize("diameter_um", [0.1, 1.0, 10.0, 60.0])
def test_table_is_the_function_and_keeps_its_mean_cosine(diameter_um):
    """The table gives the mean cosine of the series to 1e-4, and the function within 5e-4 of the light."""
    found = mie_sphere(diameter_um, 1.59, 532.0, 1.333)
    assert found.phase.mean_cosine == pytest.approx(found.mean_cosine, abs=1e-4)
    x = np.pi * diameter_um * 1e3 * 1.333 / 532.0
    mu = np.cos(np.random.default_rng(3).uniform(0.0, np.pi, 300))
    truth = miepython.i_unpolarized(1.59 / 1.333, x, mu, norm="one")
    sine = np.sqrt(1.0 - mu**2)
    # Angles are uniform, so the mean over them with weights sin θ is one over the sphere.
    off = np.pi**2 * 2.0 * np.mean(np.abs(found.phase.at(mu) - truth) * sine)
    assert off < 5e-4


def test_small_spheres_are_rayleighs():
    found = mie_sphere(0.002, 1.5, 550.0)
    mu = np.linspace(-1.0, 1.0, 201)
    np.testing.assert_allclose(found.phase.at(mu), rayleigh().at(mu), rtol=3e-4)
    # 2 π⁵ d⁶ / (3 λ⁴) ((n² - 1) / (n² + 2))²
    truth = 2.0 * np.pi**5 * 0.002**6 / (3.0 * 0.55**4) * ((1.5**2 - 1.0) / (1.5**2 + 2.0)) ** 2
    assert found.scattering_um2 == pytest.approx(truth, rel=1e-3)


def test_narrow_distribution_is_one_size_and_a_wide_one_is_the_mean_of_its_sizes():
    one, narrow = mie_sphere(1.0, 1.4, 500.0), mie_sphere(1.0, 1.4, 500.0, 1.0, 1e-4)
    assert narrow.scattering_um2 == pytest.approx(one.scattering_um2, rel=1e-4)
    wide = mie_sphere(0.5, 1.4, 500.0, 1.0, 0.3)
    steps = np.linspace(-7.0, 8.0, 901)
    diameters, share = 0.5 * np.exp(0.3 * steps), np.exp(-0.5 * steps**2) / np.exp(-0.5 * steps**2).sum()
    sizes = np.pi * diameters / 0.5
    spheres = np.array([_efficiencies(*_multipoles(1.4 + 0j, x), x) for x in sizes])
    scattering = share * 0.25 * np.pi * diameters**2 * spheres[:, 1]
    assert wide.scattering_um2 == pytest.approx(scattering.sum(), rel=1e-5)
    assert wide.mean_cosine == pytest.approx((scattering * spheres[:, 2]).sum() / scattering.sum(), abs=1e-5)
    assert wide.phase.mean_cosine == pytest.approx(wide.mean_cosine, abs=1e-4)


def test_what_spheres_absorb_is_extinction_less_scattering():
    clear, dark = mie_sphere(1.0, 1.5, 500.0), mie_sphere(1.0, 1.5 + 0.1j, 500.0)
    assert clear.extinction_um2 == pytest.approx(clear.scattering_um2, rel=1e-12)
    assert dark.extinction_um2 > 1.2 * dark.scattering_um2


def test_too_large_spheres_are_refused():
    with pytest.raises(ValueError, match="size parameter"):
        mie_sphere(5000.0, 1.5, 500.0)
