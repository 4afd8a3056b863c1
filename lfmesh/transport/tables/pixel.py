"""Pixel of the sensor in the adjoint method."""

from lfmesh.kernels.decorators import inlined
from lfmesh.transport.tables.lights import MM2
from lfmesh.transport.tables.tables import SensorTables


@inlined
def area_of_sample(sensor: SensorTables, samples: int, colour: int) -> float:
    """Return a pixel's area, m², per sample, reduced by the sensor's reflectance, times n² of the medium before it.

    Radiance in a medium of index n is n² times that in air.

    Parameters
    ----------
    sensor : SensorTables
    samples : int
    colour : int
        Wavelength number.
    """
    return sensor.pixel * sensor.pixel * MM2 / samples * (1.0 - sensor.reflectance) * sensor.index2[colour]
