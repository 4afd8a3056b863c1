"""What a click means: the ray, glass or pixel that is drawn there."""

from collections.abc import Callable

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.view.output.window import clicked
from lfmesh.view.rays.paths import Rays
from lfmesh.view.scene3d import pick
from lfmesh.view.scene3d.describe import describe
from lfmesh.view.scene3d.plotter import View
from tests.frames import motion
from tests.view.conftest import SIZE

pytestmark = pytest.mark.drawing


def pixel_corner(world: lf.World, row: float, column: float) -> np.ndarray:
    """Return the world place of a pixel's centre, by the convention that DESIGN states: x = (c − (W−1)/2)·pitch."""
    sensor = world.scene.camera.sensor
    x = (column - (sensor.pixels[0] - 1) / 2) * sensor.pixel_mm
    y = (row - (sensor.pixels[1] - 1) / 2) * sensor.pixel_mm
    move = motion(world, "sensor", "world")
    return np.asarray(move[:, :3] @ [x, y, 0.0] + move[:, 3])


@pytest.mark.parametrize("preset", ["whole", "side", "lens"])
def test_a_click_on_a_segment_names_its_path_and_vertex(
    world: lf.World, one_ray: Rays, views: Callable[..., View], preset: str
) -> None:
    view = views(world)
    view.show_rays(one_ray)
    view.look(preset)
    clicks = 0
    for vertex in range(len(one_ray.position) - 1):
        ends = one_ray.position[vertex : vertex + 2]
        place = pick.to_picture(view, ends)
        if not ((place >= 0) & (place <= SIZE)).all() or np.hypot(*np.ptp(place, axis=0)) < 12.0:
            continue
        x, y = place.mean(axis=0)
        found = pick.pick(view, x, y)
        assert isinstance(found, pick.PickedRay)
        assert (found.path, found.vertex, found.paths.tolist()) == (0, vertex, [0])
        along = place[1] - place[0]
        aside = np.array([-along[1], along[0]]) / np.hypot(*along) * 2.0 * pick.TOLERANCE_PX
        assert pick.pick_ray(view, *(np.array([x, y]) + aside)) is None
        clicks += 1
    assert clicks >= 1


def test_of_crossing_rays_the_one_in_front_is_meant(
    world: lf.World, split_rays: Rays, views: Callable[..., View]
) -> None:
    view = views(world)
    view.show_rays(split_rays)
    view.look("lens")
    assert view.lines is not None
    ends = view.lines.ends
    towards = np.asarray(view.plotter.camera.direction)
    for segment in range(0, len(view.lines), 7):
        middle = ends[segment].mean(axis=0)
        place = pick.to_picture(view, middle[None])[0]
        found = pick.pick_ray(view, *place)
        assert found is not None
        at = np.flatnonzero((view.lines.vertex == found.vertex) & (view.lines.path == found.path))[0]
        # The found segment is drawn within a pixel of the click, and nothing that is drawn there lies in front of it.
        a, b = pick.to_picture(view, ends[at])
        share = np.clip((place - a) @ (b - a) / max((b - a) @ (b - a), 1e-12), 0.0, 1.0)
        assert np.hypot(*(a + share * (b - a) - place)) <= pick.EQUALLY_NEAR_PX
        assert (ends[at, 0] + share * (ends[at, 1] - ends[at, 0]) - middle) @ towards <= 0.2


@pytest.mark.parametrize("preset", ["whole", "sensor", "array"])
@pytest.mark.parametrize(("row", "column"), [(50, 60), (45, 66), (52, 55)])
def test_a_click_on_a_pixel_names_it(
    world: lf.World, views: Callable[..., View], preset: str, row: int, column: int
) -> None:
    view = views(world)
    view.look(preset)
    place = pick.to_picture(view, pixel_corner(world, row, column)[None])[0]
    assert pick.pixel_at(view, *place) == pick.PickedPixel(row, column)


def test_the_pixel_behind_the_array_is_meant(world: lf.World, views: Callable[..., View]) -> None:
    view = views(world)
    view.look("sensor")
    place = pick.to_picture(view, pixel_corner(world, 20, 100)[None])[0]
    assert pick.pick(view, *place) == pick.PickedPixel(20, 100)


def test_a_box_on_the_sensor_holds_its_pixels(world: lf.World, views: Callable[..., View]) -> None:
    view = views(world)
    view.look("sensor")
    # Straight on, so that a box of the picture is one of the sensor.
    eye = pixel_corner(world, 49.5, 59.5)
    view.plotter.camera.position, view.plotter.camera.focal_point = eye - [0.0, 0.0, 40.0], eye
    view.plotter.camera.up = (0.0, -1.0, 0.0)
    inside = [pick.to_picture(view, pixel_corner(world, r, c)[None])[0] for r, c in ((19.7, 30.2), (39.3, 50.8))]
    (x0, y0), (x1, y1) = inside
    assert pick.box(view, x0, y0, x1, y1) == (range(20, 40), range(30, 52))
    assert pick.box(view, x1, y0, x0, y1) == (range(20, 40), range(30, 52)), "dragged the other way"
    assert pick.box(view, -5000.0, y0, -4000.0, y1) is None


@pytest.mark.parametrize("number", [0, 1])
def test_a_click_on_glass_gives_its_prescription(world: lf.World, views: Callable[..., View], number: int) -> None:
    view = views(world)
    view.look("lens")
    rim = np.asarray(world.mesh(f"lens[{number}]").vertices)
    place = pick.to_picture(view, rim)
    # The outermost point towards the side of the picture where the element ends it, a little inside.
    edge = place[np.argmin(place[:, 0]) if number == 0 else np.argmax(place[:, 0])]
    middle = place.mean(axis=0)
    found = pick.pick(view, *(edge + 0.03 * (middle - edge)))
    assert found == pick.PickedPart(f"lens[{number}]", "glass")
    words = dict(describe(world, f"lens[{number}]"))
    assert words["glass"].startswith(("n = 1.5 ", "n = 1.7 ")[number])
    assert ("R 40 mm", "flat")[number] in words["front"]
    assert ("R -40 mm", "R -120 mm")[number] in words["back"]
    assert words["thickness"] == ("5 mm", "3 mm")[number]


def test_nothing_is_picked_where_nothing_is_drawn(world: lf.World, views: Callable[..., View]) -> None:
    view = views(world)
    view.look("side")
    assert pick.pick(view, 2.0, 2.0) is None


def test_the_first_hit_solves_the_equations_of_ray_and_triangle() -> None:
    draw = np.random.default_rng(3)
    corners = draw.normal(size=(200, 3, 3)) + draw.normal(size=(200, 1, 3)) * 3.0
    origins = draw.normal(size=(100, 3)) * 6.0
    directions = -origins / np.linalg.norm(origins, axis=1, keepdims=True)
    met = 0
    for origin, direction in zip(origins, directions, strict=True):
        # o + t d = c + u (b − c) + v (a − c), solved as three equations.
        sides = np.stack([np.tile(-direction, (200, 1)), *(corners[:, 1:] - corners[:, :1]).swapaxes(0, 1)], axis=2)
        t, u, v = np.linalg.solve(sides, (origin - corners[:, 0])[..., None])[..., 0].T
        distance = t[(t > 0.0) & (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0)].min(initial=np.inf)
        met += np.isfinite(distance)
        assert pick.first_hit(origin, direction, corners) == pytest.approx(distance, rel=1e-9)
    assert 20 < met < 100


def test_a_click_in_the_window_tells_the_history(
    world: lf.World, one_ray: Rays, views: Callable[..., View], capsys: pytest.CaptureFixture[str]
) -> None:
    view = views(world)
    view.show_rays(one_ray)
    view.look("side")
    x, y = pick.to_picture(view, one_ray.position[:2]).mean(axis=0)
    words = clicked(view, x, SIZE[1] - y)
    assert "image path" in words[0]
    assert len(words) == 2 + len(one_ray.position)
    assert words[-1].startswith("sensor")
    assert capsys.readouterr().out.strip() == "\n".join(words)


def test_every_part_can_be_described(world: lf.World) -> None:
    for name in [*world.mesh_names, "lights[0]"]:
        if name != "housing":
            assert describe(world, name)
