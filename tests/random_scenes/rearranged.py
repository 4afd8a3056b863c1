"""Scenes as tables, arranged otherwise so that the image stays: in another order, halved, with something black behind.

Their meshes are in `meshes`.
"""

import copy
from collections.abc import Callable

import numpy as np

from lfmesh.geometry.frame import rotation
from tests.random_scenes.draft import Tables
from tests.random_scenes.meshes import hull, in_file, sphere_points
from tests.random_scenes.transforms import axes

LISTS = ("targets", "lights", "media", "tanks", "particles")


def in_another_order(scene: Tables, draw: np.random.Generator) -> Tables:
    """Return a scene with its targets, lamps, media, tanks and particles in another order.

    Parameters
    ----------
    scene : dict
        Tables of a scene.
    draw : Generator
    """
    scene = copy.deepcopy(scene)
    for kind in LISTS:
        if kind in scene:
            scene[kind] = [scene[kind][i] for i in draw.permutation(len(scene[kind]))]
    return scene


def shifted(body: Tables, own_mm: list[float]) -> Tables:
    """Return a body at a place that is given in its own frame, mm."""
    turn = rotation(body.get("rotation_deg", [0.0, 0.0, 0.0]))
    place = np.array(body.get("position_mm", [0.0, 0.0, 0.0])) + turn @ own_mm
    return body | {"position_mm": list(map(float, place))}


# Media


def halved_media(scene: Tables) -> tuple[Tables, Tables] | None:
    """Return a scene and one where each bounded medium is two halves side by side; None without such media.

    Spheres are polyhedra in both.
    """
    whole, halved = copy.deepcopy(scene), copy.deepcopy(scene)
    media = scene.get("media", [])
    if all(len(_halves_of_medium(medium)) == 1 for medium in media):
        return None
    for medium in whole["media"]:
        if medium.get("bounds", {}).get("kind") == "sphere":
            medium["bounds"] = in_file(hull(sphere_points(medium["bounds"]["radius_mm"])))
    halved["media"] = [half for medium in media for half in _halves_of_medium(medium)]
    return whole, halved


def _halves_of_medium(medium: Tables) -> list[Tables]:
    if "index" in medium or "density_kg_m3" in medium:
        # The index is about the origin, and fields that touch may overlap by a rounding error.
        return [medium]
    match medium.get("bounds"):
        case {"kind": "box", "size_mm": [x, *others]}:
            bounds = {"kind": "box", "size_mm": [0.5 * x, *others]}
            return [shifted(medium | {"bounds": bounds}, [side * 0.25 * x, 0.0, 0.0]) for side in (-1.0, 1.0)]
        case {"kind": "cylinder", "radius_mm": radius, "height_mm": height}:
            bounds = {"kind": "cylinder", "radius_mm": radius, "height_mm": 0.5 * height}
            return [shifted(medium | {"bounds": bounds}, [0.0, 0.0, side * 0.25 * height]) for side in (-1.0, 1.0)]
        case {"kind": "sphere", "radius_mm": radius}:
            points = sphere_points(radius)
            return [medium | {"bounds": in_file(hull(points[side * points[:, 2] >= 0.0]))} for side in (-1.0, 1.0)]
    return [medium]


# Lamps with a size


def with_sizes(scene: Tables) -> Tables:
    """Return a scene with rectangles in place of disk lamps, and lines in place of point lamps."""
    scene = copy.deepcopy(scene)
    scene["lights"] = [_with_size(lamp) for lamp in scene.get("lights", [])]
    return scene


def _with_size(lamp: Tables) -> Tables:
    match lamp["kind"]:
        case "disk":
            radius = lamp["radius_mm"]
            kept = {key: value for key, value in lamp.items() if key != "radius_mm"}
            return kept | {"kind": "rectangle", "width_mm": 2.4 * radius, "height_mm": radius}
        case "point":
            x, y, z = start = np.array(lamp["position_mm"])
            # Away from the axis, where the camera is not moved: lamps are beside the field.
            end = start + 0.3 * np.array([x - 0.4 * y, y + 0.4 * x, 0.1 * z])
            return {"kind": "line", "start_mm": start.tolist(), "end_mm": end.tolist(), "power_w": lamp["power_w"]}
    return lamp


def halved_lamps(scene: Tables) -> Tables | None:
    """Return a scene with each line or rectangle lamp as two halves side by side; None where there is none."""
    lamps = scene.get("lights", [])
    if not any(lamp["kind"] in HALVES for lamp in lamps):
        return None
    halves = [half for lamp in lamps for half in HALVES.get(lamp["kind"], lambda whole: [whole])(lamp)]
    return copy.deepcopy(scene) | {"lights": halves}


def _halves_of_line(lamp: Tables) -> list[Tables]:
    middle = (0.5 * (np.array(lamp["start_mm"]) + np.array(lamp["end_mm"]))).tolist()
    half = lamp | {"power_w": 0.5 * lamp["power_w"]}
    return [half | {"end_mm": middle}, half | {"start_mm": middle}]


def _halves_of_rectangle(lamp: Tables) -> list[Tables]:
    across, _ = axes(lamp["direction"], lamp.get("turn_deg", 0.0))
    half = lamp | {"power_w": 0.5 * lamp["power_w"], "width_mm": 0.5 * lamp["width_mm"]}
    step = 0.25 * lamp["width_mm"] * across
    return [half | {"position_mm": (np.array(lamp["position_mm"]) + side * step).tolist()} for side in (-1.0, 1.0)]


HALVES: dict[str, Callable[[Tables], list[Tables]]] = {"line": _halves_of_line, "rectangle": _halves_of_rectangle}


# Behind everything


def with_black_behind(scene: Tables) -> Tables:
    """Return a scene with a black sheet and a black ball far behind everything; the camera is at the origin."""
    scene = copy.deepcopy(scene)
    far = 20.0 * scene["camera"]["focus_mm"]
    size = 2.0 * scene["targets"][0]["shape"]["width_mm"]
    black = {"reflectance": 0.0}
    scene["targets"] += [
        {"shape": {"kind": "plane", "width_mm": size, "height_mm": size}, "position_mm": [0.0, 0.0, -far],
         "material": black},
        {"shape": {"kind": "sphere", "radius_mm": 0.3 * size}, "position_mm": [0.1 * size, 0.0, -far - size],
         "material": black},
    ]  # fmt: skip
    return scene
