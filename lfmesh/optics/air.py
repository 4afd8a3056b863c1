"""The refractive index of air by temperature and pressure, the reference of glass indices."""

REFERENCE_C, REFERENCE_KPA = 20.0, 101.325
"""Reference air of catalogue indices: SCHOTT, HOYA, CDGM and most others state 20 °C, HIKARI 23 °C and OHARA 25 °C, at
1 atm. Using 20 °C for all changes an index by at most 5e-6."""

_STANDARD_C = 15.0
_EXPANSION_PER_C = 3.4785e-3


def air_index(wavelength_nm: float, temperature_c: float, pressure_kpa: float) -> float:
    """Return the refractive index of dry air, relative to vacuum.

    F. Kohlrausch, Praktische Physik (1968), vol. 1, p. 408, as in SCHOTT's TIE-19 ("Temperature coefficient of the
    refractive index") and OpticStudio. It agrees with Ciddor (Appl. Opt. 35, 1566, 1996) within 2e-8 at 15 °C from 300
    to 1600 nm, 4e-8 from 5 to 50 °C and 60 to 120 kPa, and 1.2e-7 at -40 °C. Saturated air at 20 °C is 1e-6 lower.

    Parameters
    ----------
    wavelength_nm : float
    temperature_c : float
        Above -270.
    pressure_kpa : float
        0 is vacuum.
    """
    square = (1e-3 * wavelength_nm) ** 2
    standard = 1e-8 * (6432.8 + 2949810.0 * square / (146.0 * square - 1.0) + 25540.0 * square / (41.0 * square - 1.0))
    warmer = 1.0 + _EXPANSION_PER_C * (temperature_c - _STANDARD_C)
    return 1.0 + standard * (pressure_kpa / REFERENCE_KPA) / warmer


def in_other_air(index: float, wavelength_nm: float, temperature_c: float, pressure_kpa: float) -> float:
    """Return a catalogue index relative to air of another temperature and pressure.

    The glass itself stays at the catalogue's temperature.

    Parameters
    ----------
    index : float
        Relative to air at `REFERENCE_C` and `REFERENCE_KPA`.
    wavelength_nm, temperature_c, pressure_kpa : float
        As in `air_index`.
    """
    there = air_index(wavelength_nm, temperature_c, pressure_kpa)
    return index * (air_index(wavelength_nm, REFERENCE_C, REFERENCE_KPA) / there)
