"""The index of air against Ciddor's formula and against NIST's calculator."""

import pytest

from lfmesh.optics.air import REFERENCE_C, REFERENCE_KPA, air_index, in_other_air
from lfmesh.optics.glass import refractive_index


@pytest.mark.parametrize("wavelength_nm", [300.0, 404.66, 587.56, 633.0, 852.11, 1064.0, 1600.0])
def test_standard_air_is_ciddors(wavelength_nm: float) -> None:
    """The catalogue's entry: dry air at 15 °C, 101.325 kPa, with 450 ppm of CO2."""
    truth = refractive_index("other/air/Ciddor", wavelength_nm)
    assert air_index(wavelength_nm, 15.0, 101.325) == pytest.approx(truth, abs=2e-8)


@pytest.mark.parametrize(
    ("temperature_c", "pressure_kpa", "index", "within"),
    [
        (20.0, 101.325, 1.000271800, 4e-8),
        (20.0, 60.0, 1.000160924, 4e-8),
        (20.0, 120.0, 1.000321916, 4e-8),
        (50.0, 100.0, 1.000243285, 4e-8),
        (5.0, 100.0, 1.000282756, 4e-8),
        (-40.0, 100.0, 1.000337580, 1.2e-7),
    ],
)
def test_air_is_as_nist_calculates_it(temperature_c: float, pressure_kpa: float, index: float, within: float) -> None:
    """Dry air at 633 nm: Engineering Metrology Toolbox, refractive index of air calculator, Ciddor's equation."""
    assert air_index(633.0, temperature_c, pressure_kpa) == pytest.approx(index, abs=within)


def test_vacuum_is_one_and_the_catalogues_air_changes_nothing() -> None:
    assert air_index(500.0, -50.0, 0.0) == 1.0
    assert in_other_air(1.6, 500.0, REFERENCE_C, REFERENCE_KPA) == 1.6
    assert in_other_air(1.5, 633.0, 20.0, 0.0) == pytest.approx(1.5 * 1.0002718, abs=1e-7)
