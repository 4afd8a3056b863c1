"""The table of lights as kernels read it.

A new light has its model in `scene/light/lights.py`, its kind and its row here, and its intensity in
`transport/lights/intensity.py`.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry import frame
from lfmesh.kernels.by_address import by_address
from lfmesh.optics.light_profile import LightProfile, read_profile
from lfmesh.scene import Scene
from lfmesh.scene.light.lights import DirectionalLight, DiskLight, Light, PointLight, SpotLight
from lfmesh.transport.tables.lines import Lines
from lfmesh.transport.tables.spectra import spread

Array = NDArray[np.float64]

LIGHT = np.dtype(
    [
        ("kind", "i8"),
        ("position", "f8", (3,)),
        ("direction", "f8", (3,)),  # unit, along which the light travels; a profile's vertical angle 0
        ("across", "f8", (2, 3)),  # unit, a profile's horizontal angles 0 and 90 degrees
        ("radius", "f8"),
        ("power", "f8"),  # W; directional: irradiance in W/m²
        ("peak", "f8"),  # W/sr, largest intensity of what shines from a point
        ("inner", "f8"),  # SPOT: 1 − cos of the angles at which the soft edge begins and ends
        ("outer", "f8"),
        ("profile", "i8"),  # PROFILED: number of the profile
    ]
)

POINT, DIRECTIONAL, DISK, SPOT, PROFILED = 0, 1, 2, 3, 4

MM2 = 1e-6
"""One mm² in m²."""


@by_address
class Profiles(NamedTuple):
    """Angular profiles of lights: intensities over the power, linear between the angles (see `LightProfile`)."""

    rows: NDArray[np.int64]  # (n, 5): first vertical angle, their number, the same of horizontal ones, first intensity
    angles: Array  # rad, of all
    intensity: Array  # 1/sr, of all: horizontal angle by horizontal angle
    until: Array  # as `intensity`: up to which random number a cell is drawn, see `drawn_from_profile`


def light_tables(scene: Scene, to_object: Array, lines: Lines) -> tuple[NDArray[np.void], Array, Profiles]:
    """Return the lights in the object frame, their relative power by wavelength, and their profiles.

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
    profiles : Profiles

    Raises
    ------
    FileError
        A profile cannot be read.
    """
    lights = scene.lights
    spectra = np.ones((len(lights), len(lines.wavelengths_nm)))
    table = np.zeros(len(lights), LIGHT)
    table["direction"] = (0.0, 0.0, 1.0)
    profiles: list[LightProfile] = []
    for number, (row, light, spectrum) in enumerate(zip(table, lights, spectra, strict=True)):
        total = light.irradiance_w_m2 if isinstance(light, DirectionalLight) else light.power_w
        power = spread(scene, total, light.spectrum, lines, f"lights[{number}].spectrum")
        row["power"] = power.max()
        spectrum[:] = power / power.max()
        if isinstance(light, DirectionalLight):
            row["kind"] = DIRECTIONAL
        else:
            row["kind"] = POINT
            row["peak"] = row["power"] / (4.0 * np.pi)
            row["position"] = frame.points(to_object, [light.position_mm])[0]
        if isinstance(light, DirectionalLight | DiskLight | SpotLight):
            d = frame.directions(to_object, [light.direction])[0]
            row["direction"] = d / np.linalg.norm(d)
        if isinstance(light, DiskLight):
            row["kind"], row["radius"] = DISK, light.radius_mm
        elif isinstance(light, PointLight | SpotLight) and light.profile is not None:
            profile = read_profile(scene.resolve(light.profile))
            row["kind"], row["profile"], row["peak"] = PROFILED, len(profiles), row["power"] * profile.intensity.max()
            x, y, down = frame.directions(to_object, axes_of(light))
            row["direction"], row["across"] = down, (x, y)
            profiles.append(profile)
        elif isinstance(light, SpotLight) and light.half_angle_deg is not None:
            row["kind"] = SPOT
            # 1 − cos without the digits that the difference would lose in a narrow cone.
            inner, outer = (
                2.0 * np.sin(0.5 * np.deg2rad(light.half_angle_deg - edge)) ** 2 for edge in (light.edge_deg, 0.0)
            )
            row["inner"], row["outer"] = inner, outer
            # ∫ dω is 2π times that over the cone, and half as much over the soft edge.
            row["peak"] = row["power"] / (np.pi * (inner + outer))
    return table, spectra, _profile_tables(profiles)


def axes_of(light: Light) -> Array:
    """Return the directions of a profile's horizontal angles 0 and 90 degrees and of its vertical angle 0, world."""
    if not isinstance(light, SpotLight):
        turn = frame.rotation(getattr(light, "rotation_deg", (0.0, 0.0, 0.0)))
        return np.asarray(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, -1.0, 0.0]]) @ turn.T)
    down = np.array(light.direction) / np.linalg.norm(light.direction)
    side = np.array([1.0, 0.0, 0.0]) - down[0] * down
    if np.linalg.norm(side) < ALONG_X:
        side = np.array([0.0, 1.0, 0.0]) - down[1] * down
    side /= np.linalg.norm(side)
    other = np.cross(side, down)
    turn_rad = np.deg2rad(light.turn_deg)
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    return np.array([c * side + s * other, c * other - s * side, down])


ALONG_X = 1e-6
"""Sine of the angle from the x axis below which a spot is taken to point along it."""


def _profile_tables(profiles: list[LightProfile]) -> Profiles:
    rows, angles, intensity, until = [], [np.zeros(0)], [np.zeros(0)], [np.zeros(0)]
    first, value = 0, 0
    for profile in profiles:
        v, h = len(profile.vertical), len(profile.horizontal)
        rows.append((first, v, first + v, h, value))
        angles += [profile.vertical, profile.horizontal]
        intensity.append(profile.intensity.ravel())
        # As long as the intensities; the cells fill its beginning.
        cells = np.cumsum(profile.shares().ravel())
        until.append(np.concatenate([cells / cells[-1], np.ones(h * v - len(cells))]))
        first, value = first + v + h, value + h * v
    table = np.array(rows, dtype=np.int64).reshape(-1, 5)
    return Profiles(table, np.concatenate(angles), np.concatenate(intensity), np.concatenate(until))


def power_towards(light: Any, middle: Array, radius: float) -> tuple[float, float]:
    """Return the most power that a light may send towards a sphere, and its whole power, W.

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
        # 0.5 · (1 − cos) without cancellation for a far lamp.
        ratio2 = (radius / distance) ** 2
        seen = 0.5 * ratio2 / (1.0 + np.sqrt(1.0 - ratio2))
    if light["kind"] == DISK:
        return light["power"] * seen, light["power"]
    return min(light["power"], light["peak"] * 4.0 * np.pi * seen), light["power"]
