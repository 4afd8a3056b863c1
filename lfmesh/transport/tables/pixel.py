"""A pixel of the sensor, as the adjoint method samples it."""

from lfmesh.kernels.decorators import inlined
from lfmesh.transport.tables.lights import MM2
from lfmesh.transport.tables.tables import SensorTables


@inlined
def area_of_sample(sensor: SensorTables, samples: int) -> float:
    """Return a pixel's area, m², for each of its samples, less what the sensor reflects of the light that arrives."""
    return sensor.pixel * sensor.pixel * MM2 / samples * (1.0 - sensor.reflectance)
