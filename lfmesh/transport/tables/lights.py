"""Table of lights for kernels: one row of properties per light, whatever its type.

Only `transport/lights/intensity.py` reads the number of a lamp's law of intensity; only `transport/lights/places.py`
reads the number of its shape.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry import frame
from lfmesh.kernels.by_address import by_address
from lfmesh.optics.light_profile import LightProfile, read_profile
from lfmesh.optics.scattering import tangents
from lfmesh.scene import Light, Scene
from lfmesh.scene.light.region import Region
from lfmesh.transport.tables.lamp_tree import lamp_tree
from lfmesh.transport.tables.lines import Lines
from lfmesh.transport.tables.spectra import spread

Array = NDArray[np.float64]

LIGHT = np.dtype(
    [
        ("emission", "i8"),  # law of the intensity; asked by `transport/lights/intensity.py` alone
        ("shape", "i8"),  # shape of the emitting region; asked by `transport/lights/places.py` alone
        ("position", "f8", (3,)),  # mm, middle of the region
        ("direction", "f8", (3,)),  # unit axis, along which the light travels; a profile's vertical angle 0
        ("across", "f8", (2, 3)),  # unit axes of the region, and a profile's horizontal angles 0 and 90 degrees
        ("half", "f8", (2,)),  # mm, half of the region's extent along these axes
        ("area", "f8"),  # mm², area of the region, if any
        ("size", "f8"),  # mm, radius of a sphere around the middle that holds the region; 0: a point, or no place
        ("spine", "f8", (3,)),  # mm, half of a segment about the middle; all of the region is near it
        ("thickness", "f8"),  # mm, largest distance of the region from the segment
        ("power", "f8"),  # W; directional: irradiance in W/m²
        ("peak", "f8"),  # W/sr, largest intensity
        ("gain", "f8"),  # peak over the mean intensity of all directions
        ("inner", "f8"),  # CONE: 1 − cos of the angle at which the soft edge begins
        ("outer", "f8"),  # 1 − cos of the angle from the axis beyond which nothing shines; 2: all round
        ("profile", "i8"),  # PROFILED: number of the profile
        ("mover", "i8"),  # see `tables.motions`; the row holds in the frame of the mover
        ("placed", "?"),  # it has a position; else it is parallel light
        ("fades", "?"),  # its intensity falls as the cosine of the angle from the axis
    ]
)

EVEN, CONE, LAMBERT, SINE, PROFILED = range(5)
LAWS = {"even": EVEN, "cone": CONE, "lambert": LAMBERT, "sine": SINE, "profile": PROFILED}

STRAIGHT, ROUND = range(2)
SHAPES = {"straight": STRAIGHT, "round": ROUND}

MM2 = 1e-6
"""One mm² in m²."""


@by_address
class Profiles(NamedTuple):
    """Angular profiles of lights: intensities over the power, linear between the angles (see `LightProfile`)."""

    rows: NDArray[np.int64]  # (n, 5): first vertical angle, their number, the same for horizontal ones, first intensity
    angles: Array  # rad, of all profiles
    intensity: Array  # 1/sr, of all profiles: horizontal angle by horizontal angle
    until: Array  # as `intensity`: largest random number that draws a cell, see `drawn_by_intensity`


@by_address
class Lamps(NamedTuple):
    """Lights of a scene, and the tree for the choice of lights at a point (see `tables.lamp_tree`)."""

    rows: NDArray[np.void]  # (lamps,) LIGHT, with the largest power at any wavelength
    spectra: Array  # (lamps, wavelengths) power at each wavelength relative to the largest
    profiles: Profiles
    nodes: NDArray[np.void]  # (nodes,) LAMP_NODE
    power: Array  # (nodes, wavelengths) W; for parallel light W/m²
    leaf: NDArray[np.int64]  # (lamps,) node of each lamp


def light_tables(scene: Scene, to_object: Array, lines: Lines) -> Lamps:
    """Return the lights in the object frame, at t = 0.

    Parameters
    ----------
    scene : Scene
    to_object : (3, 4) float64
        From the world frame into the object frame.
    lines : Lines

    Raises
    ------
    FileError
        A profile cannot be read.
    """
    lights = scene.lights
    spectra = np.ones((len(lights), len(lines.wavelengths_nm)))
    table = np.zeros(len(lights), LIGHT)
    profiles: list[LightProfile] = []
    read: dict[Path, int] = {}
    for number, (row, light, spectrum) in enumerate(zip(table, lights, spectra, strict=True)):
        power = spread(scene, light.strength, light.spectrum, lines, f"lights[{number}].spectrum")
        row["power"] = power.max()
        spectrum[:] = power / power.max()
        x, y, z = frame.directions(to_object, light.axes)
        row["across"], row["direction"] = (x, y), z / np.linalg.norm(z)
        _set_region(row, light.region, to_object)
        if light.ies is not None:
            path = scene.resolve(light.ies)
            if path not in read:
                read[path] = len(profiles)
                profiles.append(read_profile(path))
            row["profile"] = read[path]
        _set_emission(row, light, profiles)
    tree = lamp_tree(table, table["power"][:, None] * spectra)
    return Lamps(table, spectra, _profile_tables(profiles), *tree)


def _set_region(row: Any, region: Region | None, to_object: Array) -> None:
    """Fill in the place of a lamp, and its bounds."""
    if region is None:
        return
    row["placed"] = True
    row["position"] = frame.points(to_object, [region.centre_mm])[0]
    row["half"], row["size"] = region.lengths_mm, region.size_mm
    row["spine"] = frame.directions(to_object, [region.spine_mm])[0]
    row["thickness"] = region.thickness_mm
    row["shape"], row["area"] = SHAPES[region.shape], region.area_mm2
    first = region.lengths_mm[0]
    if region.is_round:
        row["across"] = np.reshape(tangents(*row["direction"]), (2, 3))
    elif first > 0.0:
        row["across"][0] = frame.directions(to_object, region.half_mm[:1] / first)[0]


def _set_emission(row: Any, light: Light, profiles: list[LightProfile]) -> None:
    """Fill in the angular distribution of a lamp; the number of its profile is already set."""
    row["emission"] = LAWS[light.emission]
    row["outer"] = _height(light.spread_deg)
    solid_angle = 4.0 * np.pi  # filled by the whole power at the largest intensity
    if light.emission == "profile":
        profile = profiles[row["profile"]]
        lit = np.flatnonzero(profile.intensity.any(axis=0))
        row["outer"] = _height(np.rad2deg(profile.vertical[min(lit[-1] + 1, len(profile.vertical) - 1)]))
        solid_angle = 1.0 / profile.intensity.max()
    elif light.emission == "lambert":
        solid_angle, row["fades"] = np.pi, True
    elif light.emission == "sine":
        solid_angle = np.pi**2
    elif light.emission == "cone":
        row["inner"] = _height(light.even_deg)
        # ∫ dω is 2π times that over the cone, and half as much over the soft edge.
        solid_angle = np.pi * (row["inner"] + row["outer"])
    row["peak"], row["gain"] = row["power"] / solid_angle, 4.0 * np.pi / solid_angle


def _height(angle_deg: float) -> float:
    """Return 1 − cos of an angle without cancellation."""
    return float(2.0 * np.sin(0.5 * np.deg2rad(angle_deg)) ** 2)


def _profile_tables(profiles: list[LightProfile]) -> Profiles:
    rows, angles, intensity, until = [], [np.zeros(0)], [np.zeros(0)], [np.zeros(0)]
    first, value = 0, 0
    for profile in profiles:
        v, h = len(profile.vertical), len(profile.horizontal)
        rows.append((first, v, first + v, h, value))
        angles += [profile.vertical, profile.horizontal]
        intensity.append(profile.intensity.ravel())
        # As long as the intensities; only the first entries are cells.
        cells = np.cumsum(profile.shares().ravel())
        until.append(np.concatenate([cells / cells[-1], np.ones(h * v - len(cells))]))
        first, value = first + v + h, value + h * v
    table = np.array(rows, dtype=np.int64).reshape(-1, 5)
    return Profiles(table, np.concatenate(angles), np.concatenate(intensity), np.concatenate(until))


def with_movers(lamps: Lamps, movers: NDArray[np.int64]) -> Lamps:
    """Return the lights with their movers, each mover with a tree of its own.

    Parameters
    ----------
    lamps : Lamps
    movers : (lamps,) int64
    """
    rows = lamps.rows.copy()
    rows["mover"] = movers
    nodes, power, leaf = lamp_tree(rows, rows["power"][:, None] * lamps.spectra)
    return lamps._replace(rows=rows, nodes=nodes, power=power, leaf=leaf)


def power_towards(light: Any, middle: Array, radius: float) -> tuple[float, float]:
    """Return an upper bound of a light's power towards a sphere, and its whole power, W.

    Parameters
    ----------
    light : LIGHT
        For directional light both results are the power through the sphere.
    middle : (3,) float64, mm
        Centre of the sphere.
    radius : float, mm
    """
    if not light["placed"]:
        power = light["power"] * np.pi * radius**2 * MM2
        return power, power
    # The sphere is no nearer to any point of the lamp.
    distance = float(np.linalg.norm(light["position"] - middle)) - float(light["size"])
    seen = 1.0
    if distance > radius:
        # 0.5 · (1 − cos) without cancellation for a far lamp.
        ratio2 = (radius / distance) ** 2
        seen = 0.5 * ratio2 / (1.0 + np.sqrt(1.0 - ratio2))
    return min(light["power"], light["peak"] * 4.0 * np.pi * seen), light["power"]
