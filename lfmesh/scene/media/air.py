"""The air around the camera, if it is not that of the glass catalogues."""

from typing import Annotated

from pydantic import Field

from lfmesh.optics.air import REFERENCE_C, REFERENCE_KPA, in_other_air
from lfmesh.scene.model import Model

Celsius = Annotated[float, Field(strict=True, ge=-100, le=200)]
Kilopascal = Annotated[float, Field(strict=True, ge=0, le=1000)]


class Air(Model):
    """Temperature and pressure of dry air, as the reference of glass indices."""

    temperature_c: Celsius = REFERENCE_C
    """Temperature, in °C. It applies to the air alone: the glasses stay at 20 °C."""
    pressure_kpa: Kilopascal = REFERENCE_KPA
    """Pressure, in kPa; 0 is vacuum."""

    def index_of(self, index: float, wavelength_nm: float) -> float:
        """Convert a glass index from the catalogue's air to this air.

        Parameters
        ----------
        index : float
            Index of the glass relative to the catalogue's air.
        wavelength_nm : float
            Vacuum wavelength.

        Returns
        -------
        float
        """
        return in_other_air(index, wavelength_nm, self.temperature_c, self.pressure_kpa)

    def in_words(self) -> str:
        """Describe the air.

        Returns
        -------
        str
        """
        return (
            f"in air of {self.temperature_c:g} °C and {self.pressure_kpa:g} kPa" if self.pressure_kpa else "in vacuum"
        )
