"""Punctual lights of glTF files as scene lights.

In KHR_lights_punctual, a light stands at its node's origin and shines along its -z. Point and spot lights have a
luminous intensity in cd, directional ones an illuminance in lux. Blender's exporter has three modes
(`export_import_convert_lighting_mode`): "standard" multiplies Blender's watts by 683 lm/W, over 4π sr for points and
spots; "unitless" omits the 683; "raw" writes the watts unchanged.
"""

import math
from typing import Any

import numpy as np

from lfmesh.errors import MeshError
from lfmesh.geometry.files.gltf_nodes import Node
from lfmesh.geometry.files.mesh_file import MM_PER_UNIT
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.optics.rgb_spectra import primary_reflectances
from lfmesh.scene import DirectionalLight, PointLight, Scene, SpotLight

LUMENS_PER_WATT = 683.0
"""Definition of the candela at 540 THz; Blender's exporter uses it for light of any colour."""

KINDS = ("point", "spot", "directional")

LARGEST = 1e12
"""Largest intensity."""

STEP_NM = 5.0
"""Wavelength step of a coloured light's spectrum, as in the spectra of the primaries."""


def light_of(
    where: str, node: Node, entry: Any, lighting: str, scene: Scene
) -> tuple[PointLight | SpotLight | DirectionalLight | None, list[str]]:
    """Return a light and its conversion in words.

    Parameters
    ----------
    where : str
        File and node, for errors.
    node : Node
    entry : dict
        Definition of the light in the file.
    lighting : str
        "standard", "unitless" or "raw".
    scene : Scene
        Its wavelengths or bands determine the spectrum of a coloured light.

    Returns
    -------
    light : Light or None
        None if it emits nothing.
    how : list of str

    Raises
    ------
    MeshError
        A value is invalid in glTF.
    """
    if not isinstance(entry, dict) or entry.get("type") not in KINDS:
        kind = entry.get("type") if isinstance(entry, dict) else entry
        raise MeshError(f"{where}: its light is of type {repr(kind)[:60]}; valid are {', '.join(KINDS)}")
    intensity = _value(where, "intensity", entry.get("intensity", 1.0), LARGEST)
    colour = np.array([_value(where, "color", each, LARGEST) for each in _three(where, entry.get("color", [1.0] * 3))])
    radiant, how = _radiant(entry["type"], intensity, lighting)
    share, spectrum, coloured = _spread(colour, scene)
    if radiant * share <= 0.0:
        return None, ["a light of intensity 0; left out"]
    said = [how + coloured]
    if "range" in entry:
        said.append("its range is left out: it also lights objects beyond it")
    light = _made(where, node, entry, radiant * share, spectrum)
    if isinstance(light, SpotLight) and light.edge_deg > 0.0:
        said.append("its soft edge is linear in the cosine of the angle, whereas viewers square it")
    return light, said


def _radiant(kind: str, intensity: float, lighting: str) -> tuple[float, str]:
    """Return W/sr of a point or spot, W/m² of a directional light, and the conversion in words."""
    unit = ("lx", "W/m²") if kind == "directional" else ("cd", "W/sr")
    if lighting == "standard":
        value = intensity / LUMENS_PER_WATT
        return value, f"{intensity:.6g} {unit[0]} are {value:.6g} {unit[1]}, at {LUMENS_PER_WATT:g} lm/W"
    if lighting == "raw" and kind != "directional":
        value = intensity / (4.0 * math.pi)
        return value, f"{intensity:.6g} W (raw) are {value:.6g} W/sr"
    return intensity, f"{intensity:.6g} {unit[1]} ({lighting})"


def _spread(colour: Array, scene: Scene) -> tuple[float, dict[str, Any] | None, str]:
    """Return a colour's fraction of the power of white, its spectrum for bands, and its losses in words."""
    if np.ptp(colour) == 0.0:
        return float(colour[0]), None, ""
    if scene.camera.sensor.bands is None:
        each = [float(primary_reflectances(wavelength) @ colour) for wavelength in scene.wavelengths_nm]
        lost = "" if len(set(each)) == 1 else "; its colour is left out: its power is equal at all wavelengths"
        return float(np.mean(each)), None, lost
    low, high = scene.reach_nm
    nm = np.linspace(low, high, 1 + max(1, math.ceil((high - low) / STEP_NM)))
    density = np.array([primary_reflectances(wavelength) @ colour for wavelength in nm])
    mean = float(np.trapezoid(density, nm) / (high - low))
    return mean, {"wavelengths_nm": nm.tolist(), "values": density.tolist()}, "; its colour as a smooth spectrum"


def _made(
    where: str, node: Node, entry: dict[str, Any], radiant: float, spectrum: dict[str, Any] | None
) -> PointLight | SpotLight | DirectionalLight:
    place = node.to_scene[:3, 3] * MM_PER_UNIT["m"]
    position = (float(place[0]), float(place[1]), float(place[2]))
    kind = entry["type"]
    shape: dict[str, Any] = {} if spectrum is None else {"spectrum": spectrum}
    if kind == "point":
        return PointLight(position_mm=position, power_w=4.0 * math.pi * radiant, **shape)
    # Only the node's rotation affects directions, not its scale (KHR_lights_punctual).
    along = -node.to_scene[:3, 2]
    if not (length := float(np.linalg.norm(along))):
        raise MeshError(f"{where}: a light whose scale is 0 has no direction")
    x, y, z = (float(each) for each in along / length)
    if kind == "directional":
        return DirectionalLight(direction=(x, y, z), irradiance_w_m2=radiant, **shape)
    inner, outer = _cone(where, entry)
    # ∫ dω over the cone inside the edge, and half as much over the edge itself.
    power = radiant * math.pi * ((1.0 - math.cos(inner)) + (1.0 - math.cos(outer)))
    half, edge = math.degrees(outer), math.degrees(outer - inner)
    return SpotLight(
        position_mm=position, direction=(x, y, z), half_angle_deg=half, edge_deg=min(edge, half), power_w=power, **shape
    )


def _cone(where: str, entry: dict[str, Any]) -> tuple[float, float]:
    """Return the inner and outer angle from the axis, rad."""
    cone = entry.get("spot", {})
    if not isinstance(cone, dict):
        raise MeshError(f"{where}: its spot is {repr(cone)[:60]}; valid is an object")
    outer = _value(where, "spot.outerConeAngle", cone.get("outerConeAngle", 0.25 * math.pi), 0.5 * math.pi + HALF_TURN)
    inner = _value(where, "spot.innerConeAngle", cone.get("innerConeAngle", 0.0), 0.5 * math.pi + HALF_TURN)
    if not inner <= outer or outer == 0.0:
        raise MeshError(
            f"{where}: innerConeAngle = {inner:.6g}, outerConeAngle = {outer:.6g}; valid is 0 ≤ inner ≤ outer ≤ π/2, "
            "and outer above 0"
        )
    return inner, outer


HALF_TURN = 1e-6
"""Rounding excess of float32 angles over π/2."""


def _three(where: str, values: Any) -> list[Any]:
    if isinstance(values, list) and len(values) == 3:
        return values
    raise MeshError(f"{where}: its color is {repr(values)[:60]}; valid are three numbers from 0")


def _value(where: str, key: str, value: Any, largest: float) -> float:
    if isinstance(value, int | float) and not isinstance(value, bool) and 0.0 <= value <= largest:
        return float(value)
    raise MeshError(f"{where}: {key} of its light is {repr(value)[:60]}; valid are numbers from 0 to {largest:.6g}")
