"""Pixel of the sensor in the adjoint method."""

from lfmesh.kernels.decorators import inlined
from lfmesh.transport.tables.lights import MM2
from lfmesh.transport.tables.tables import SensorTables


@inlined
def area_of_sample(sensor: SensorTables, samples: int) -> float:
    """Return a pixel's area, m², per sample, reduced by the sensor's reflectance."""
    return sensor.pixel * sensor.pixel * MM2 / samples * (1.0 - sensor.reflectance)
