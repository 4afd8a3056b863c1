"""Scenes as tables, changed so that the new image follows from the old one: moved, scaled, cut, split, heated."""

import copy
from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from lfmesh.geometry.frame import rotation

Tables = dict[str, Any]


def moved(scene: Tables, tilt_deg: list[float], shift_mm: list[float]) -> Tables:
    """Return a scene whose camera and world are turned about the origin, then shifted: its image stays.

    Parameters
    ----------
    scene : dict
        Tables of a scene.
    tilt_deg, shift_mm : list of float
    """
    turn, shift = rotation(tilt_deg), np.array(shift_mm)
    scene = copy.deepcopy(scene)
    pose = scene["camera"].setdefault("pose", {})
    _move(pose, turn, shift, "shift_mm", "tilt_deg")
    _move_motion(scene["camera"], turn, shift)
    # A medium without bounds is everywhere before the lens, and goes with it.
    media = [medium for medium in scene.get("media", []) if "bounds" in medium or "grid" in medium]
    for body in (*scene.get("targets", []), *scene.get("tanks", []), *media, *scene.get("particles", [])):
        _move(body, turn, shift, "position_mm", "rotation_deg")
        _move_motion(body, turn, shift)
        if (step := body.get("displacement")) is not None:
            step["vector_mm"] = list(map(float, turn @ step["vector_mm"]))
        if (sheet := body.get("sheet")) is not None:
            sheet["point_mm"] = _point(sheet["point_mm"], turn, shift)
            for key in ("normal", "direction"):
                sheet[key] = list(map(float, turn @ sheet[key]))
    for light in scene.get("lights", []):
        _move_light(light, turn, shift)
        _move_motion(light, turn, shift)
    return scene


def _move_motion(thing: Tables, turn: Any, shift: Any) -> None:
    """Move the motion of a body, a lamp or the camera; its poses have no `turn_deg`."""
    motion = thing.get("motion", {})
    for key in ("velocity_mm_s", "spin_deg_s"):
        if key in motion:
            motion[key] = list(map(float, turn @ motion[key]))
    if "center_mm" in motion:
        motion["center_mm"] = _point(motion["center_mm"], turn, shift)
    for pose in motion.get("poses", []):
        for key in {"position_mm", "shift_mm"} & pose.keys():
            pose[key] = _point(pose[key], turn, shift)
        for key in {"rotation_deg", "tilt_deg"} & pose.keys():
            _turn(pose, turn, key)
        if "direction" in pose:
            pose["direction"] = list(map(float, turn @ pose["direction"]))


def _move_light(light: Tables, turn: Any, shift: Any) -> None:
    for key in ("position_mm", "start_mm", "end_mm"):
        if key in light:
            light[key] = _point(light[key], turn, shift)
    if "direction" in light:
        across, _ = axes(light["direction"], light.get("turn_deg", 0.0))
        light["direction"] = list(map(float, turn @ light["direction"]))
        first, second = axes(light["direction"], 0.0)
        if {"profile", "width_mm"} & light.keys():
            light["turn_deg"] = float(np.rad2deg(np.arctan2(second @ turn @ across, first @ turn @ across)))
    elif "profile" in light:
        _turn(light, turn, "rotation_deg")


def axes(direction: list[float], turn_deg: float) -> tuple[Any, Any]:
    """Return the two axes square to a lamp's direction: at first on the side of +x, of +y for light along x.

    They turn counter-clockwise for an eye that looks along the direction.
    """
    d = np.array(direction) / np.linalg.norm(direction)
    first = np.eye(3)[0] - d[0] * d
    if np.linalg.norm(first) == 0.0:
        first = np.eye(3)[1]
    first /= np.linalg.norm(first)
    second = np.cross(first, d)
    angle = np.deg2rad(turn_deg)
    return np.cos(angle) * first + np.sin(angle) * second, np.cos(angle) * second - np.sin(angle) * first


def _point(place: list[float], turn: Any, shift: Any) -> list[float]:
    return list(map(float, turn @ place + shift))


def _move(body: Tables, turn: Any, shift: Any, place: str, angles: str) -> None:
    body[place] = _point(body.get(place, [0.0, 0.0, 0.0]), turn, shift)
    _turn(body, turn, angles)


def _turn(body: Tables, turn: Any, angles: str) -> None:
    whole = turn @ rotation(body.get(angles, [0.0, 0.0, 0.0]))
    body[angles] = list(map(float, Rotation.from_matrix(whole).as_euler("xyz", degrees=True)))


def scaled(scene: Tables, factor: float) -> Tables:
    """Return a scene of all lengths times a factor, radiances and irradiances kept: its image has factor² the power.

    Powers and intensities of lamps and particles grow by the factor's square; light per volume, and absorption and
    scattering per length, fall. Wavelengths stay, so that phases grow. Files have their own lengths, and are refused.
    """
    return _scaled(copy.deepcopy(scene), factor)


def _scaled(table: Tables, k: float) -> Tables:
    for key, value in table.items():
        if key == "file":
            raise ValueError(f"{value} has lengths of its own")
        table[key] = _scaled_value(key, value, k)
    return table


LOWEST = {"asphere_mm": 4, "odd_asphere_mm": 3}
"""Powers of r of the first coefficients."""

PHASES = ("coefficients_rad",)
"""Coefficients of phases, in rad, alone or after two powers."""


LOWEST_OF_GRADIENTS = {"radial_n2": 2, "radial_n": 2, "axial": 1, "spherical": 1}
"""Powers of the length in the first coefficient of a gradient, by its kind; the others have its multiples."""


def _scaled_gradient(gradient: Tables, k: float) -> Tables:
    scaled = _scaled({key: value for key, value in gradient.items() if not key.endswith("coefficients")}, k)
    for key in gradient.keys() - scaled.keys():
        step = LOWEST_OF_GRADIENTS[gradient["kind"]] if key == "coefficients" else 1
        scaled[key] = [c * k ** (-step * i) for i, c in enumerate(gradient[key], 1)]
    return scaled


def _scaled_value(key: str, value: Any, k: float) -> Any:
    if key == "gradient" or (key == "index" and isinstance(value, dict)):
        return _scaled_gradient(value, k)
    if isinstance(value, dict):
        return _scaled(value, k)
    if key in PHASES and isinstance(value, list):
        # The change of direction by a phase is that of radians over lengths.
        return [[*one[:2], one[2] * k] if isinstance(one, list) else one * k for one in value]
    if isinstance(value, list):
        if key in LOWEST and value and not isinstance(value[0], list):
            return [a * k ** (1 - LOWEST[key] - 2 * j) for j, a in enumerate(value)]
        return [_scaled_value(key, one, k) for one in value]
    if isinstance(value, bool) or not isinstance(value, int | float):
        return value
    if key == "lines_per_mm":
        return value
    if key.endswith("_per_mm") or key == "emission_w_mm3_sr":
        return value / k
    if key.endswith(("_mm", "_mm_s")) or key == "diameter_um":
        return value * k
    return value * k**2 if key in ("power_w", "intensity_w_sr") else value


def cut(scene: Tables) -> Tables | None:
    """Return a scene whose first target, a plane, is two halves side by side: its image stays. None under a texture."""
    plane = scene["targets"][0]
    if "texture" in plane["material"]:
        return None
    scene = copy.deepcopy(scene)
    whole, *others = scene["targets"]
    shape = whole["shape"] | {"width_mm": 0.5 * whole["shape"]["width_mm"]}
    to_the_side = rotation(whole.get("rotation_deg", [0.0, 0.0, 0.0]))[:, 0] * 0.5 * shape["width_mm"]
    halves = [
        whole | {"shape": shape, "position_mm": list(map(float, np.array(whole["position_mm"]) + side * to_the_side))}
        for side in (-1.0, 1.0)
    ]
    scene["targets"] = [*halves, *others]
    return scene


def split_sources(scene: Tables) -> tuple[Tables, Tables] | None:
    """Return a scene with every second source, and with the others: their images add. None of fewer than two."""
    both = copy.deepcopy(scene), copy.deepcopy(scene)
    sources = list(_sources(scene))
    for number, (kind, place) in enumerate(sources):
        _put_out(both[number % 2], kind, place)
    for one in both:
        for kind in ("lights", "particles"):
            one[kind] = [entry for entry in one.get(kind, []) if entry is not None]
    return both if len(sources) > 1 else None


SHINES = ("radiance_w_m2_sr", "emission_w_mm3_sr", "temperature_k")


def _sources(scene: Tables) -> Iterator[tuple[str, int]]:
    for kind in ("lights", "particles", "targets", "media"):
        for place, entry in enumerate(scene.get(kind, [])):
            matter = entry.get("material", {}) if kind == "targets" else entry
            if kind in ("lights", "particles") or any(matter.get(key) for key in SHINES):
                yield kind, place


def _put_out(scene: Tables, kind: str, place: int) -> None:
    if kind in ("lights", "particles"):
        scene[kind][place] = None
        return
    matter = scene[kind][place]["material"] if kind == "targets" else scene[kind][place]
    for key in SHINES:
        matter.pop(key, None)


KELVIN = 1700.0
BAND = {"name": "b", "center_nm": 600.0, "fwhm_nm": 0.02}
STOPPED_DOWN = 16.0
"""f-number: the opening that the camera leaves in the enclosure is then less than a thousandth of what bodies see."""


FRONT = 0.05
"""Distance from the lens to the front wall of an isothermal room, over that to its back wall."""


def isothermal(scene: Tables) -> tuple[Tables, Tables]:
    """Return a scene's bodies and media in a closed room, all of one temperature, and that room with a black plane.

    Both images are the same: in an isothermal enclosure everything looks like a black body, whatever it is made of.
    """
    scene = copy.deepcopy(scene)
    for kind in ("lights", "particles"):
        scene.pop(kind, None)
    scene["camera"]["lens"]["f_number"] = STOPPED_DOWN
    scene["camera"]["sensor"]["bands"] = [BAND]
    scene["transport"].pop("wavelengths_nm", None)
    # All that a body reflects is light of the room.
    scene["transport"]["split"] = "both"
    black = copy.deepcopy(scene)
    bodies = [body for target in scene["targets"] if (body := target.get("refractor"))]
    for body in (*bodies, *(tank["liquid"] for tank in scene.get("tanks", []))):
        body.pop("absorption_per_mm", None)
    for target in scene["targets"]:
        if (material := target.get("material")) is not None:
            for key in ("texture", "radiance_w_m2_sr"):
                material.pop(key, None)
            material["temperature_k"] = KELVIN
    for medium in scene.get("media", []):
        medium.pop("emission_w_mm3_sr", None)
        # One that bends light, and absorbs nothing, emits nothing.
        if "absorption_per_mm" in medium:
            medium["temperature_k"] = KELVIN
    wall = scene["targets"][0]["shape"]["width_mm"]
    half, depth = 3.0 * wall, 1.1 * scene["camera"]["focus_mm"]
    room = list(_room(half, depth, 0.1 * wall))
    for medium in scene.get("media", []):
        # Between the room and the lens a medium would scatter light of the cold outside.
        if not {"bounds", "grid", "inside"} & medium.keys():
            medium["bounds"] = {"kind": "box", "size_mm": [2.0 * half, 2.0 * half, (1.0 - FRONT) * depth]}
            medium["position_mm"] = [0.0, 0.0, -0.5 * (1.0 + FRONT) * depth]
    scene["targets"] += room
    plane = black["targets"][0]
    for kind in ("tanks", "media"):
        black.pop(kind, None)
    # Reflections in the lens look past the plane: the walls are there, too.
    black["targets"] = [plane | {"material": {"reflectance": 0.0, "temperature_k": KELVIN}}, *room]
    return scene, black


def _room(half_mm: float, depth_mm: float, hole_mm: float) -> Iterator[Tables]:
    """Yield the black walls of a room before the camera, open in a square round the axis."""
    front = -FRONT * depth_mm
    middle, length = 0.5 * (front - depth_mm), depth_mm + front
    side = 0.5 * (half_mm + hole_mm)
    yield _wall([0.0, 0.0, -depth_mm], [0.0, 0.0, 0.0], 2.0 * half_mm, 2.0 * half_mm)
    for sign in (-1.0, 1.0):
        yield _wall([sign * half_mm, 0.0, middle], [0.0, 90.0, 0.0], length, 2.0 * half_mm)
        yield _wall([0.0, sign * half_mm, middle], [90.0, 0.0, 0.0], 2.0 * half_mm, length)
        yield _wall([sign * side, 0.0, front], [0.0, 0.0, 0.0], half_mm - hole_mm, 2.0 * half_mm)
        yield _wall([0.0, sign * side, front], [0.0, 0.0, 0.0], 2.0 * hole_mm, half_mm - hole_mm)


def _wall(position: list[float], turn: list[float], width: float, height: float) -> Tables:
    shape = {"kind": "plane", "width_mm": width, "height_mm": height}
    material = {"reflectance": 0.0, "temperature_k": KELVIN}
    return {"shape": shape, "position_mm": position, "rotation_deg": turn, "material": material}
