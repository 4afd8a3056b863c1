"""The air round the camera, where it is not that of the glass catalogues."""

from typing import Annotated

from pydantic import Field

from lfmesh.optics.air import REFERENCE_C, REFERENCE_KPA, in_other_air
from lfmesh.scene.model import Model

Celsius = Annotated[float, Field(strict=True, ge=-100, le=200)]
Kilopascal = Annotated[float, Field(strict=True, ge=0, le=1000)]


class Air(Model):
    """Temperature and pressure of dry air, relative to which glasses then have their indices."""

    temperature_c: Celsius = REFERENCE_C
    """Temperature, in °C. Of the air alone: the glasses stay as they are at 20 °C."""
    pressure_kpa: Kilopascal = REFERENCE_KPA
    """Pressure, in kPa; 0 is vacuum."""

    def index_of(self, index: float, wavelength_nm: float) -> float:
        """Return a catalogue's index of a glass relative to this air.

        Parameters
        ----------
        index : float
            Of the glass in the air that the catalogue is measured in.
        wavelength_nm : float
            In a vacuum.

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
