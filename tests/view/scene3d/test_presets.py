"""Viewpoints: everything asked for is in the picture, and fills it, whatever its size."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.errors import LfmeshError
from lfmesh.geometry import frame as frames
from lfmesh.scene import Scene, loads
from lfmesh.view.scene3d import pick
from lfmesh.view.scene3d.overlay import in_words
from lfmesh.view.scene3d.parts import parts, round_length
from lfmesh.view.scene3d.plotter import View
from lfmesh.view.scene3d.presets import ANGLE_DEG, MARGIN, PRESETS, Viewpoint, fitted, viewpoint
from tests.frames import motion
from tests.view.conftest import SCENE, SIZE, shot

ASPECT = 1.6


def in_picture(seen: Viewpoint, points: np.ndarray) -> np.ndarray:
    """Return (n, 2) places of points in units of half the picture's height, by the pinhole's formula."""
    ahead = seen.focus - seen.eye
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, seen.up)
    x, y, z = ((points - seen.eye) @ axis for axis in (right / np.linalg.norm(right), seen.up, ahead))
    if seen.parallel:
        return np.stack([x, y], axis=1) / seen.half_height_mm
    return np.stack([x, y], axis=1) / z[:, None] / np.tan(np.deg2rad(0.5 * ANGLE_DEG))


@pytest.mark.parametrize("parallel", [False, True])
@pytest.mark.parametrize("seed", range(6))
def test_a_fitted_view_holds_all_points_and_no_more_room_than_the_margin(seed: int, parallel: bool) -> None:
    draw = np.random.default_rng(seed)
    points = draw.normal(size=(40, 3)) * draw.uniform(0.01, 100.0, 3) + draw.normal(size=3) * 50.0
    seen = fitted(points, draw.normal(size=3), ASPECT, parallel)
    place = in_picture(seen, points)
    reach = np.abs(place / [ASPECT, 1.0]).max()
    assert reach <= 1.0 / MARGIN + 1e-6
    assert reach >= 1.0 / MARGIN - 0.02


def test_what_is_seen_stands_in_the_middle_of_the_picture() -> None:
    points = np.random.default_rng(1).uniform(-1.0, 1.0, (30, 3)) * [50.0, 20.0, 200.0]
    place = in_picture(fitted(points, [-1.0, 0.3, -1.0], ASPECT, False), points)
    assert np.allclose(place.max(axis=0), -place.min(axis=0), atol=1e-6)


@pytest.mark.drawing
@pytest.mark.parametrize("preset", list(PRESETS))
def test_a_preset_shows_its_part_between_the_clipping_planes(
    world: lf.World, views: Callable[..., View], preset: str
) -> None:
    view = views(world)
    view.look(preset)
    points, _, _ = PRESETS[preset](world, (0.0, 0.0))
    place = pick.to_picture(view, points)
    assert (place >= 0.0).all()
    assert (place <= SIZE).all()
    shot(view)
    near, far = view.plotter.camera.clipping_range
    depth = (points - view.plotter.camera.position) @ view.plotter.camera.direction
    assert near < depth.min()
    assert depth.max() < far


SHORT = SCENE.replace("[camera]\nfocus_mm = 200.0", "[camera]").replace(
    "[camera.mla]", "[camera.mla]\ndistance_mm = 4.0"
)
WIDE = SCENE.replace("pixels = [120, 100]", "pixels = [400, 90]").replace("count = [12, 10]", "count = [44, 12]")


@pytest.mark.drawing
@pytest.mark.parametrize("aspect", [0.5, 1.0, 1.6, 3.0])
@pytest.mark.parametrize("preset", [name for name in PRESETS if name != "array"])
@pytest.mark.parametrize("text", [SCENE, SHORT, WIDE], ids=["bench", "short back focus", "wide sensor"])
def test_no_preset_cuts_the_sensor(text: str, preset: str, aspect: float) -> None:
    """Its board, which is larger than its pixels, is in the picture as a whole or not at all."""
    world = lf.build(loads(text))
    board = np.concatenate([np.asarray(part.mesh.points) for part in parts(world) if part.kind == "sensor"])
    seen = viewpoint(world, preset, aspect)
    ahead = (seen.focus - seen.eye) / np.linalg.norm(seen.focus - seen.eye)
    depth = (board - seen.eye) @ ahead
    if not seen.parallel and (depth <= 0.0).all():
        return
    assert seen.parallel or (depth > 0.0).all()
    across, up = in_picture(seen, board).T / [[aspect], [1.0]]
    inside = max(np.abs(across).max(), np.abs(up).max()) <= 1.0
    beside = across.min() > 1.0 or across.max() < -1.0 or up.min() > 1.0 or up.max() < -1.0
    assert inside or beside
    if preset in ("whole", "side", "sensor"):
        assert inside


@pytest.mark.drawing
def test_a_preset_fits_a_window_of_another_shape_until_the_view_is_turned(
    world: lf.World, views: Callable[..., View]
) -> None:
    view = views(world)
    view.look("side")
    shot(view)
    for size in ((200, 400), (600, 200)):
        view.plotter.window_size = size
        shot(view)
        points, _, _ = PRESETS["side"](world, (0.0, 0.0))
        place = pick.to_picture(view, points)
        assert (place >= 0.0).all()
        assert (place <= size).all()
    view.plotter.camera.Azimuth(20.0)
    turned = view.plotter.camera.position
    view.plotter.window_size = (300, 300)
    shot(view)
    assert view.plotter.camera.position == turned


@pytest.mark.parametrize("large", ["width_mm = 20000.0, height_mm = 20000.0", "width_mm = 30.0, height_mm = 30.0"])
def test_neither_walls_nor_far_lamps_make_the_camera_invisible(large: str) -> None:
    wall = SCENE.replace('{ kind = "box", size_mm = [30.0, 20.0, 2.0] }', f'{{ kind = "plane", {large} }}')
    world = lf.build(loads(wall.replace("[0.0, -40.0, -120.0]", "[0.0, -9e6, -120.0]")))
    seen = viewpoint(world, "whole", ASPECT)
    lens = np.asarray(world.mesh("lens[0]").vertices)
    height = np.ptp(in_picture(seen, lens)[:, 1]) / 2.0
    assert height > 0.1, f"the lens takes {height:.1%} of the picture's height"


@pytest.mark.parametrize("pose", [{}, {"shift_mm": (40.0, -7.0, 12.0), "tilt_deg": (20.0, 70.0, -35.0)}])
@pytest.mark.parametrize("preset", list(PRESETS))
def test_y_is_up_and_x_to_the_right_seen_from_behind_the_camera(
    scene: Scene, preset: str, pose: dict[str, Any]
) -> None:
    """From before it, x is to the left; from beside, the sensor is right of the objects. All in the camera's frame."""
    world = lf.build(scene.changed({"camera.pose": pose}))
    frame = motion(world, "camera", "world")
    seen = viewpoint(world, preset, ASPECT)
    ends = np.concatenate([frames.directions(frame, np.eye(3)), np.zeros((1, 3))]) + seen.focus
    place = in_picture(seen, ends)
    x, y, z = place[:3] - place[3]
    assert y[1] > 0.5 * np.linalg.norm(y)
    assert abs(y[0]) < 1e-6
    ahead = frames.directions(motion(world, "world", "camera"), (seen.focus - seen.eye)[None])[0]
    if preset != "side":
        assert np.sign(x[0]) == -np.sign(ahead[2])
    if preset in ("whole", "side", "object", "lens", "array"):
        assert z[0] > 0.0
    assert ahead[1] <= 1e-12 * np.linalg.norm(ahead), "seen from below"


def test_an_unknown_preset_and_an_array_that_is_not_there_are_refused(world: lf.World, conventional: lf.World) -> None:
    with pytest.raises(LfmeshError, match="preset = 'top': use one of whole, side, object, lens, array, sensor"):
        viewpoint(world, "top", ASPECT)
    with pytest.raises(LfmeshError, match="no microlens array"):
        viewpoint(conventional, "array", ASPECT)


@pytest.mark.drawing
@pytest.mark.parametrize("preset", ["lens", "whole"])
def test_the_scale_bar_is_as_long_as_it_says(world: lf.World, views: Callable[..., View], preset: str) -> None:
    view = views(world)
    view.look(preset)
    shot(view)
    ends = [view.overlay.bar_points.GetPoint(i) for i in (0, 1)]
    camera = view.plotter.camera
    right = np.cross(camera.direction, camera.up)
    words = view.overlay.bar_text.GetInput()
    length = float(words.split()[0]) * {"mm": 1.0, "µm": 1e-3}[words.split()[1]]
    a, b = pick.to_picture(view, np.array([camera.focal_point, np.add(camera.focal_point, length * right)]))
    assert np.hypot(*(b - a)) == pytest.approx(ends[1][0] - ends[0][0], rel=1e-6)


@pytest.mark.parametrize(
    ("most", "least"), [(1.0, "1 mm"), (0.99, "0.5 mm"), (73.0, "50 mm"), (0.0421, "20 µm"), (4999.0, "2000 mm")]
)
def test_round_lengths(most: float, least: str) -> None:
    assert in_words(round_length(most)) == least


@pytest.mark.drawing
def test_names_are_drawn_letter_by_letter(world: lf.World, views: Callable[..., View]) -> None:
    """VTK takes what stands between two $ for mathematics; a single one it draws as it is."""
    view = views(world)
    pictures = []
    for title in ("a $b_2$ c", "a $b_2 c"):
        view.overlay.write(title, [], None)
        lit = (shot(view)[:30].max(axis=2) > 200).any(axis=0)
        pictures.append(np.flatnonzero(lit).max())
    letter = pictures[0] / len("a $b_2$ c")
    assert pictures[0] - pictures[1] > 0.4 * letter, "one letter more"
