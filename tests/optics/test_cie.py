"""Colorimetry against published chromaticities, and Planck's law against Wien, Stefan and Boltzmann."""

import numpy as np
import pytest
from scipy.integrate import quad

from lfmesh.optics.cie import NAMED, named_spectrum, observer, planck_radiance

PUBLISHED_XY = {
    "A": (0.44758, 0.40745),
    "D50": (0.34567, 0.35850),
    "D55": (0.33242, 0.34743),
    "D65": (0.31272, 0.32903),
    "D75": (0.29902, 0.31485),
    "E": (1 / 3, 1 / 3),
    "FL2": (0.3721, 0.3751),
    "FL7": (0.3129, 0.3292),
    "FL11": (0.3805, 0.3769),
    "LED-B1": (0.4560, 0.4078),
    "LED-B2": (0.4357, 0.4012),
    "LED-B3": (0.3756, 0.3723),
    "LED-B4": (0.3422, 0.3502),
    "LED-B5": (0.3118, 0.3236),
    "LED-BH1": (0.4474, 0.4066),
    "LED-RGB1": (0.4557, 0.4211),
    "LED-V1": (0.4548, 0.4044),
    "LED-V2": (0.3781, 0.3775),
}
"""CIE 15:2018, tables T.3 to T.8 and section 4."""


def chromaticity(wavelengths_nm: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return x and y, summed every 5 nm from 380 to 780 as the published ones are."""
    every_5_nm = np.arange(380.0, 781.0, 5.0)
    xyz = observer(every_5_nm) @ np.interp(every_5_nm, wavelengths_nm, values)
    return xyz[:2] / xyz.sum()


@pytest.mark.parametrize("name", NAMED)
def test_illuminants_lie_at_their_published_chromaticities(name: str) -> None:
    """Within rounding: the published ones have four or five digits."""
    np.testing.assert_allclose(chromaticity(*named_spectrum(name)), PUBLISHED_XY[name], atol=6e-5)


def test_a_black_body_of_2856_k_lies_where_illuminant_a_does() -> None:
    every_nm = np.arange(360.0, 831.0)
    xy = chromaticity(every_nm, planck_radiance(every_nm, 2856.0))
    np.testing.assert_allclose(xy, PUBLISHED_XY["A"], atol=1e-4)


def test_the_observer_is_one_per_luminance_and_dark_outside() -> None:
    assert observer(555.0)[1] == 1.0
    assert not observer([359.0, 831.0]).any()


@pytest.mark.parametrize("temperature_k", [300.0, 1500.0, 5772.0])
def test_planck_obeys_stefan_boltzmann_and_wien(temperature_k: float) -> None:
    peak_nm = 2.897771955e6 / temperature_k
    near = np.linspace(0.99, 1.01, 2001) * peak_nm
    assert abs(near[np.argmax(planck_radiance(near, temperature_k))] / peak_nm - 1.0) < 2e-5

    def per_log(log_nm: float) -> float:
        return float(np.exp(log_nm) * planck_radiance(np.exp(log_nm), temperature_k))

    total, _ = quad(per_log, np.log(peak_nm / 40), np.log(peak_nm * 1e4), epsabs=0.0, epsrel=1e-11, limit=400)
    assert abs(total * np.pi / (5.670374419e-8 * temperature_k**4) - 1.0) < 1e-9


def test_planck_of_cold_bodies_is_zero_and_finite() -> None:
    assert planck_radiance(400.0, 3.0) == 0.0


def test_an_unknown_illuminant_is_an_error() -> None:
    with pytest.raises(KeyError, match="D66"):
        named_spectrum("D66")
