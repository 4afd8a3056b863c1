"""A glTF scene as Blender writes it: ten objects, their colours and picture, the camera, lights in candela and lux.

Everything is compared with the file's own numbers: nodes composed as 4 × 4 matrices here, corners projected by hand
through a pinhole at the file's camera, radiometry in closed form. Nothing from here to the images shares code with
lfmesh.
"""

import math
import warnings
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.errors import LensFileWarning
from tests.glb import QUAD, QUAD_UV, SPLIT, Glb, turn
from tests.validation.test_handedness import assert_upright, drawing, written

RADIUS, THICKNESS, INDEX = 51.68, 5.0, 1.5168
LENS_TO_STOP, STOP_RADIUS, FOCUS = 4.0, 2.0, 600.0
PIXELS, PIXEL = 120, 0.1
LINES = (610.0, 540.0, 450.0)
"""Wavelengths where mostly red, green and blue count in a colour."""


def through_lens(height: float, slope: float) -> tuple[float, float]:
    """Return height and slope of a paraxial ray behind the lens, alike both ways."""
    power = (INDEX - 1.0) / RADIUS
    slope = (slope - height * power) / INDEX
    height += THICKNESS * slope
    return height, INDEX * slope - height * power


_Y, _U = through_lens(1.0, 1.0 / FOCUS)
STOP_TO_SENSOR = -_Y / _U - LENS_TO_STOP
_Y, _U = through_lens(LENS_TO_STOP, 1.0)
ENTRANCE_PUPIL = _Y / _U
"""From the first vertex towards the sensor, mm."""
IMAGE_DISTANCE = STOP_TO_SENSOR / _U
"""Height on the sensor over the slope of the ray through the entrance pupil."""

CAMERA = f"""
[camera.lens]
surfaces = [
  {{ radius_mm = {RADIUS}, thickness_mm = {THICKNESS}, index = {INDEX}, semi_diameter_mm = 9.0 }},
  {{ radius_mm = {-RADIUS}, thickness_mm = {LENS_TO_STOP}, semi_diameter_mm = 9.0 }},
  {{ stop = true, semi_diameter_mm = {STOP_RADIUS} }},
]
[camera.sensor]
pixels = [{PIXELS}, {PIXELS}]
pixel_mm = {PIXEL}
distance_mm = {STOP_TO_SENSOR}
"""


def placed(translation: Any = (0, 0, 0), rotation: Any = (0, 0, 0, 1), scale: Any = (1, 1, 1)) -> Any:
    """Return the (4, 4) matrix of a node: moved after turned after scaled."""
    x, y, z, w = rotation
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    made = np.eye(4)
    made[:3, :3] = (np.eye(3) + 2 * w * cross + 2 * cross @ cross) @ np.diag(scale)
    made[:3, 3] = translation
    return made


RIG = {"translation": [0.4, -0.3, 1.2], "rotation": turn((0.3, 1.0, -0.2), 70.0), "scale": [2.0, 2.0, 2.0]}
EYE = {"translation": [0.05, 0.1, -0.2], "rotation": turn((1.0, 0.2, 0.4), 25.0)}
"""The file's camera stands below a node that is moved, turned and scaled."""
OF_EYE = placed(**RIG) @ placed(**EYE)
OF_EYE[:3, :3] /= 2.0

COLOURS = [
    (0.9, 0.05, 0.05), (0.05, 0.9, 0.05), (0.05, 0.05, 0.9), (0.8, 0.8, 0.1), (0.1, 0.8, 0.8), (0.8, 0.1, 0.8),
    (0.9, 0.9, 0.9), (0.5, 0.2, 0.05), (0.3, 0.6, 0.2), (1.0, 1.0, 1.0),
]  # fmt: skip
PLACES = [(-40, 34), (-2, 36), (34, 34), (-42, -4), (40, 4), (-34, -40), (4, -38), (40, -36), (16, 4), (-10, 0)]
"""Middles of the objects, mm across and up before the camera; the last one carries the picture."""


@cache
def blender_scene(folder: Path) -> tuple[Glb, list[tuple[Any, Any, Any]]]:
    """Return a file of ten sheets that face its camera, and their facets, colours and pictures in the camera's frame.

    Some stand below a node that is stretched, one is mirrored, and all have sizes and turns of their own.
    """
    random = np.random.default_rng(4)
    glb = Glb()
    rig = glb.node("Rig", **RIG)
    camera = glb.add("cameras", {"type": "perspective", "perspective": {"yfov": 0.2, "znear": 0.1}})
    eye = glb.node("Camera", rig, camera=camera, **EYE)
    # From the side, so that the camera does not stand in its light.
    glb.light("Sun", {"type": "directional", "intensity": 6830.0}, eye, rotation=turn((0, 1, 0), 25.0))
    image, letter = written("R", folder, (48, 64))
    wall = {"scale": [1.5, 0.5, 1.0], "translation": [0.0, 0.0, -0.25]}
    empty = glb.node("Wall", eye, **wall)
    bodies = []
    for number, (colour, (across, up)) in enumerate(zip(COLOURS, PLACES, strict=True)):
        picture = number == 9
        size = random.uniform(14.0, 18.0, 2) * [1, 1.1]
        depth = 600.0 + random.uniform(-15.0, 15.0)
        corners = QUAD * [*size, 1.0] * 1e-3
        # In the frame of the eye, whose scale is 2.
        wanted = placed([across * 5e-4, up * 5e-4, -depth * 5e-4], turn((0, 0, 1), random.uniform(-40, 40)), [0.5] * 3)
        if number == 4:
            wanted = wanted @ np.diag([-1.0, 1.0, 1.0, 1.0])
        below = number % 2 == 1
        own = np.linalg.inv(placed(**wall)) @ wanted if below else wanted
        uv = {"TEXCOORD_0": QUAD_UV} if picture else {}
        material = glb.material(colour, image.read_bytes() if picture else None)
        mesh = glb.add("meshes", {"primitives": [glb.primitive(corners, SPLIT, material, **uv)]})
        glb.node(f"Sheet.{number:03d}", empty if below else eye, mesh=mesh, matrix=own.T.ravel().tolist())
        in_eye = placed(scale=(2.0, 2.0, 2.0)) @ wanted
        facets = (1e3 * (corners @ in_eye[:3, :3].T + in_eye[:3, 3]))[SPLIT]
        bodies.append((facets, colour, letter if picture else None))
    return glb, bodies


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> tuple[lf.Scene, lf.Image, list[Any]]:
    folder = tmp_path_factory.mktemp("blender")
    glb, bodies = blender_scene(folder)
    assert len(glb.write(folder / "scene.glb").read_bytes()) < 20_000
    (folder / "scene.toml").write_text(
        'targets = { file = "scene.glb" }\nlights = { file = "scene.glb" }\n'
        f'{CAMERA}\n[camera.pose]\nfile = "scene.glb"\n'
        f"[transport]\nsamples = 8\nreplicates = 2\nwavelengths_nm = {list(LINES)}\nthreads = 2\n"
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LensFileWarning)
        scene = lf.load(folder / "scene.toml")
    return scene, lf.render(scene), bodies


def test_ten_objects_are_named_targets_in_check_and_ledger(rendered: Any) -> None:
    from lfmesh.geometry.objects.placement import placements

    scene, image, bodies = rendered
    names = [f"Sheet.{number:03d}" for number in range(10)]
    assert [target.name for target in scene.targets] == names
    assert [each.name for each in placements(scene)] == [f"targets[{i}] ({name})" for i, name in enumerate(names)]
    assert set(names) <= set(image.ledger.absorbed)
    for each, (facets, _, _) in zip(placements(scene), bodies, strict=True):
        corners = facets.reshape(-1, 3) @ OF_EYE[:3, :3].T + 1e3 * OF_EYE[:3, 3]
        np.testing.assert_allclose(each.low, corners.min(axis=0), atol=1e-3)
        np.testing.assert_allclose(each.high, corners.max(axis=0), atol=1e-3)


def test_the_cameras_origin_is_the_entrance_pupil(rendered: Any) -> None:
    from lfmesh.geometry import frame

    pose = rendered[0].camera.pose
    to_world = frame.frame(pose.tilt_deg, pose.shift_mm)
    pupil = frame.points(to_world, [[0.0, 0.0, ENTRANCE_PUPIL]])[0]
    assert ENTRANCE_PUPIL > 1.0
    np.testing.assert_allclose(pupil, 1e3 * OF_EYE[:3, 3], atol=1e-6)
    np.testing.assert_allclose(to_world[:, :3], OF_EYE[:3, :3], atol=1e-9)


@pytest.mark.parametrize("channel", range(3))
def test_positions_colours_and_picture_are_the_files(rendered: Any, channel: int) -> None:
    _, image, bodies = rendered
    scale = IMAGE_DISTANCE / PIXEL

    def from_eye(points: Any) -> Any:
        depth = -points[:, 2]
        return 0.5 * (PIXELS - 1) + scale * np.column_stack([points[:, 0], -points[:, 1]]) / depth[:, None], depth

    expected = np.zeros((PIXELS, PIXELS))
    for facets, colour, letter in bodies:
        uv = (QUAD[:, :2] + 0.5)[SPLIT] if letter is not None else None
        whole = drawing(facets, None, None, from_eye, PIXELS)
        if letter is None:
            expected += colour[channel] * whole
        else:
            orange, blue = np.array([255, 170, 20])[channel] / 255.0, np.array([0, 0, 50])[channel] / 255.0
            linear = [((c + 0.055) / 1.055) ** 2.4 if c > 0.04045 else c / 12.92 for c in (orange, blue)]
            share = drawing(facets, uv, letter, from_eye, PIXELS)
            expected += linear[1] * whole + (linear[0] - linear[1]) * share
    found = image.mean[:, ::-1, channel]
    assert_upright(found, expected)
    # The letter by itself: on it the picture's orange counts in red and green.
    if channel < 2:
        column, row = np.rint(from_eye(bodies[9][0].mean(axis=(0, 1))[None])[0][0]).astype(int) - 10
        near = slice(row, row + 21), slice(column, column + 21)
        assert_upright(found[near], expected[near], least=0.85)


# Radiometry: the middle of a matt plane before the camera, lit by one light of a file.

REFLECTANCE, PLANE = 0.6, 600.0
LAMP = np.array([150.0, -200.0, -250.0])
TRANSMITTANCE = (1.0 - ((INDEX - 1.0) / (INDEX + 1.0)) ** 2) ** 2
SOLID_ANGLE = math.pi * STOP_RADIUS**2 / (STOP_RADIUS**2 + STOP_TO_SENSOR**2)
"""Projected, of the stop as the middle of the sensor sees it."""


def middle(tmp_path: Path, glb: Glb, more: str = "") -> tuple[float, float]:
    """Return the power on the four pixels in the middle, relative to that on a plane of 1 W/m², and its error."""
    glb.write(tmp_path / "lamp.glb")
    camera = CAMERA.replace(f"[{PIXELS}, {PIXELS}]", "[2, 2]")
    (tmp_path / "scene.toml").write_text(
        f'lights = {{ file = "lamp.glb"{more} }}\n{camera}\n[[targets]]\n'
        'shape = { kind = "plane", width_mm = 400.0, height_mm = 400.0 }\n'
        f"position_mm = [0.0, 0.0, {-PLANE}]\nmaterial = {{ reflectance = {REFLECTANCE} }}\n"
        '[transport]\nsplit = "transmit"\nsamples = 512\nreplicates = 8\nwavelengths_nm = [587.6]\nthreads = 2\n'
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LensFileWarning)
        image = lf.render(lf.load(tmp_path / "scene.toml"))
    radiance = REFLECTANCE / math.pi
    unit = TRANSMITTANCE * radiance * SOLID_ANGLE * (1e-3 * PIXEL) ** 2
    return float(image.mean.mean()) / unit, float(np.sqrt((image.stderr**2).sum()) / image.mean.size) / unit


def lamp(kind: str, intensity: float, **more: Any) -> Glb:
    """Return a file with one light at `LAMP` that looks at the middle of the plane, below a node that is moved."""
    glb = Glb()
    holder = glb.node("Holder", translation=[0.1, 0.0, 0.0], scale=[2.0, 2.0, 2.0])
    towards = np.array([0.0, 0.0, -PLANE]) - LAMP
    towards /= np.linalg.norm(towards)
    axis = np.cross([0.0, 0.0, -1.0], towards)
    rotation = turn(axis, math.degrees(math.acos(-towards[2])))
    place = (1e-3 * LAMP - [0.1, 0.0, 0.0]) / 2.0
    glb.light("Lamp", {"type": kind, "intensity": intensity, **more}, holder, translation=place.tolist(),
              rotation=rotation)  # fmt: skip
    return glb


DISTANCE = float(np.linalg.norm(LAMP - [0.0, 0.0, -PLANE]))
COSINE = (LAMP[2] + PLANE) / DISTANCE
CASES = {
    "point": ("point", 683.0, {}, "", COSINE / (1e-3 * DISTANCE) ** 2),
    "spot": ("spot", 1366.0, {"spot": {"innerConeAngle": 0.3, "outerConeAngle": 0.6}}, "",
             2.0 * COSINE / (1e-3 * DISTANCE) ** 2),
    "sun": ("directional", 1366.0, {}, "", 2.0 * COSINE),
    "unitless point": ("point", 3.0, {}, ', lighting = "unitless"', 3.0 * COSINE / (1e-3 * DISTANCE) ** 2),
    "raw spot": ("spot", 100.0, {"spot": {"innerConeAngle": 0.3, "outerConeAngle": 0.6}}, ', lighting = "raw"',
                 100.0 / (4.0 * math.pi) * COSINE / (1e-3 * DISTANCE) ** 2),
    "raw sun": ("directional", 3.0, {}, ', lighting = "raw"', 3.0 * COSINE),
    "grey point": ("point", 683.0, {"color": [0.5, 0.5, 0.5]}, "", 0.5 * COSINE / (1e-3 * DISTANCE) ** 2),
}  # fmt: skip
"""Kind, intensity and more of a light in the file, and the W/m² that it makes on the plane, by the inverse square."""

SLACK = 0.004
"""Relative: what a stop of f/27 and an edge of a pixel off the axis leave of paraxial optics."""


@pytest.mark.parametrize("case", CASES)
def test_candela_and_lux_arrive_at_683_lumens_per_watt(tmp_path: Path, case: str) -> None:
    kind, intensity, more, mode, expected = CASES[case]
    found, error = middle(tmp_path, lamp(kind, intensity, **more), mode)
    # 4.5 standard errors: by chance once in 100,000 runs.
    assert abs(found - expected) < 4.5 * error + SLACK * expected
    assert error < 0.01 * expected
