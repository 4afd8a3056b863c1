"""The table of lights as kernels read it.

A new light has its model in `scene/lights.py`; its kind, its row and its power here; and in
`transport/events/lighting.py` its irradiance at a point and the start of its packets.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry import frame
from lfmesh.scene import Scene
from lfmesh.scene.lights import DirectionalLight, DiskLight
from lfmesh.transport.tables.lines import Lines
from lfmesh.transport.tables.spectra import spread

Array = NDArray[np.float64]

LIGHT = np.dtype(
    [
        ("kind", "i8"),
        ("position", "f8", (3,)),
        ("direction", "f8", (3,)),  # unit, along which the light travels
        ("radius", "f8"),
        ("power", "f8"),  # W; directional: irradiance in W/m²
    ]
)

POINT, DIRECTIONAL, DISK = 0, 1, 2

MM2 = 1e-6
"""One mm² in m²."""


def light_table(scene: Scene, to_object: Array, lines: Lines) -> tuple[NDArray[np.void], Array]:
    """Return the lights in the object frame, (lights,) LIGHT, and their relative power by wavelength.

    Parameters
    ----------
    scene : Scene
    to_object : (3, 4) float64
        Move from the world frame into the object frame.
    lines : Lines

    Returns
    -------
    table : (lights,) LIGHT
        With the largest power at any wavelength.
    spectra : (lights, wavelengths) float64
        Power at each wavelength relative to that.
    """
    lights = scene.lights
    spectra = np.ones((len(lights), len(lines.wavelengths_nm)))
    table = np.zeros(len(lights), LIGHT)
    table["direction"] = (0.0, 0.0, 1.0)
    for number, (row, light, spectrum) in enumerate(zip(table, lights, spectra, strict=True)):
        total = light.irradiance_w_m2 if isinstance(light, DirectionalLight) else light.power_w
        power = spread(scene, total, light.spectrum, lines, f"lights[{number}].spectrum")
        row["power"] = power.max()
        spectrum[:] = power / power.max()
        if isinstance(light, DirectionalLight):
            row["kind"] = DIRECTIONAL
        else:
            row["kind"] = POINT
            row["position"] = frame.points(to_object, [light.position_mm])[0]
        if isinstance(light, DirectionalLight | DiskLight):
            d = frame.directions(to_object, [light.direction])[0]
            row["direction"] = d / np.linalg.norm(d)
        if isinstance(light, DiskLight):
            row["kind"], row["radius"] = DISK, light.radius_mm
    return table, spectra


def power_towards(light: Any, middle: Array, radius: float) -> tuple[float, float]:
    """Return the power that a light sends towards a sphere, and its whole power, W.

    Parameters
    ----------
    light : LIGHT
        A row of the table. For directional light both are the power through the sphere.
    middle : (3,) float64, mm
        Centre of the sphere.
    radius : float, mm
    """
    if light["kind"] == DIRECTIONAL:
        power = light["power"] * np.pi * radius**2 * MM2
        return power, power
    distance = float(np.linalg.norm(light["position"] - middle))
    seen = 1.0
    if distance > radius:
        seen = 0.5 * (1.0 - np.sqrt(1.0 - (radius / distance) ** 2))
    return light["power"] * seen, light["power"]
