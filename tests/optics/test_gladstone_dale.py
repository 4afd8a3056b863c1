"""The index of gases by density, temperature and pressure against published figures."""

import numpy as np
import pytest

from lfmesh.optics.air import air_index
from lfmesh.optics.gladstone_dale import air_density, gladstone_dale_of_air, index_by_density


def test_the_density_of_the_standard_atmosphere() -> None:
    """ISO 2533: 1.225 kg/m³ at 15 °C and 101.325 kPa, 0.41351 kg/m³ at an altitude of 10 km."""
    assert float(air_density(288.15, 101.325)) == pytest.approx(1.225, rel=1e-6)
    assert float(air_density(223.252, 26.4999)) == pytest.approx(0.41351, rel=2e-5)


@pytest.mark.parametrize(
    ("wavelength_nm", "constant"),
    [(912.5, 2.239e-4), (703.4, 2.250e-4), (607.4, 2.259e-4), (509.7, 2.274e-4), (407.9, 2.304e-4), (356.2, 2.330e-4)],
)
def test_the_constant_of_air_is_the_published_one(wavelength_nm: float, constant: float) -> None:
    """W. Merzkirch, Flow Visualization: Gladstone-Dale constants of air at 288 K, m³/kg."""
    assert gladstone_dale_of_air(wavelength_nm) == pytest.approx(constant, rel=1e-3)


@pytest.mark.parametrize(
    ("temperature_c", "pressure_kpa", "index"),
    [(20.0, 60.0, 1.000160924), (50.0, 100.0, 1.000243285), (5.0, 100.0, 1.000282756)],
)
def test_hot_and_thin_air_is_as_nist_calculates_it(temperature_c: float, pressure_kpa: float, index: float) -> None:
    """At 633 nm (see `test_air`), within the difference between an ideal and a real gas, and that of `air_index`."""
    (offset,), (scale,) = index_by_density(633.0)
    absolute = (offset + scale * air_density(temperature_c + 273.15, pressure_kpa)) * air_index(633.0, 20.0, 101.325)
    assert float(absolute) == pytest.approx(index, abs=1e-7)


@pytest.mark.parametrize(("air_c", "air_kpa"), [(20.0, 101.325), (-30.0, 80.0), (60.0, 120.0), (20.0, 0.0)])
def test_air_like_that_around_has_the_index_one(air_c: float, air_kpa: float) -> None:
    offsets, scales = index_by_density([400.0, 700.0], air_c, air_kpa)
    np.testing.assert_allclose(offsets + scales * air_density(air_c + 273.15, air_kpa), 1.0, rtol=3e-16)


def test_vacuum_is_thinner_than_the_air_around() -> None:
    offsets, _ = index_by_density([500.0])
    assert offsets[0] == pytest.approx(1.0 / air_index(500.0, 20.0, 101.325), rel=1e-15)


def test_a_given_constant_replaces_that_of_air() -> None:
    """Helium, 1.96e-4 m³/kg: at 20 °C and 101.325 kPa, 0.1664 kg/m³, n − 1 = 3.26e-5."""
    offsets, scales = index_by_density([589.0, 450.0], gladstone_dale_m3_kg=1.96e-4)
    around = np.array([air_index(589.0, 20.0, 101.325), air_index(450.0, 20.0, 101.325)])
    np.testing.assert_allclose((offsets + scales * 0.1664) * around, 1.0 + 1.96e-4 * 0.1664, rtol=1e-15)
    each, _ = index_by_density([589.0, 450.0])
    assert np.array_equal(offsets, each)


def test_the_blue_is_bent_more_than_the_red() -> None:
    _, scales = index_by_density([450.0, 550.0, 650.0])
    assert (np.diff(scales) < 0.0).all()
