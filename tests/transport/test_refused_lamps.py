"""Round bodies of glass that lamps or other bodies stand in or cut are refused by their exact surfaces, in one line."""

from typing import Any

import pytest

import lfmesh as lf
from lfmesh.errors import SceneError
from tests.cameras import camera_without_array

CAMERA = camera_without_array(100.0, 8, 0.5)
LAMP: dict[str, Any] = {"kind": "point", "position_mm": [40.0, 40.0, -40.0], "power_w": 1.0}


def ball(radius: float = 8.0, at: Any = (0.0, 0.0, -100.0), **keys: Any) -> dict[str, Any]:
    return {"refractor": {"shape": {"kind": "sphere", "radius_mm": radius}, "index": 1.5} | keys, "position_mm": at}


def rod(radius: float, height: float, at: Any = (0.0, 0.0, -100.0), **keys: Any) -> dict[str, Any]:
    shape = {"kind": "cylinder", "radius_mm": radius, "height_mm": height}
    return {"refractor": {"shape": shape, "index": 1.5} | keys, "position_mm": at}


def built(*targets: dict[str, Any], lamp: dict[str, Any] = LAMP) -> lf.World:
    return lf.build(lf.Scene(camera=CAMERA, targets=targets, lights=[lamp]), aimed=False)


def refused(*targets: dict[str, Any], lamp: dict[str, Any] = LAMP) -> str:
    with pytest.raises(SceneError) as raised:
        built(*targets, lamp=lamp)
    assert "\n" not in str(raised.value)
    return str(raised.value)


def test_a_lamp_between_the_facets_of_a_balls_mesh_and_the_ball_is_in_the_glass() -> None:
    """Facets of 3 degrees lie 7e-4 of the radius within it."""
    for depth, inside in ((1e-5, True), (-1e-5, False)):
        for x, y in ((0.6, 0.8), (0.28, 0.96)):
            away = 8.0 * (1.0 - depth)
            at = (40.0 - away * x, 40.0 - away * y, -40.0)
            if inside:
                assert "lies inside targets[0]" in refused(ball(at=at))
            else:
                built(ball(at=at))


def test_a_camera_in_a_ball_is_refused_and_one_that_touches_it_is_not() -> None:
    assert "first surface lies inside" in refused(ball(30.0, at=(0.0, 0.0, -29.9)))
    built(ball(30.0, at=(0.0, 0.0, -30.01)))


def test_a_lamp_whose_rim_reaches_into_a_ball_is_refused() -> None:
    disk = LAMP | {"kind": "disk", "direction": [-1, -1, -1], "radius_mm": 3.0, "position_mm": [40.0, 40.0, -30.0]}
    assert "lies inside targets[0]" in refused(ball(at=(40.0, 40.0, -38.5)), lamp=disk)
    built(ball(at=(40.0, 40.0, -55.0)), lamp=disk)


@pytest.mark.parametrize("overlap", [1e-3, 2.0])
def test_balls_that_cut_each_other_need_priorities(overlap: float) -> None:
    pair = ball(), ball(6.0, at=(14.0 - overlap, 0.0, -100.0))
    assert "cut each other near" in refused(*pair)
    pair[1]["refractor"]["priority"] = 1
    built(*pair)


def test_balls_that_touch_or_hold_each_other_do_not() -> None:
    built(ball(), ball(6.0, at=(14.0, 0.0, -100.0)), ball(3.0, at=(5.0, 0.0, -100.0)), rod(2.0, 3.0))


def test_surfaces_that_lie_on_each_other_are_refused() -> None:
    said = refused(rod(5.0, 10.0), rod(4.0, 6.0, at=(0.0, 0.0, -92.0)))
    assert "too close for rays to find the first surface" in said
    assert said.endswith("with another priority")
    assert "too close" in refused(ball(), ball(priority=1))
    box = {"refractor": {"box_mm": [20.0, 20.0, 5.0], "index": 1.4}, "position_mm": (0.0, 0.0, -92.5)}
    assert "too close" in refused(rod(5.0, 10.0), box)
    box["position_mm"], box["refractor"]["priority"] = (0.0, 0.0, -92.6), 1
    built(rod(5.0, 10.0), box)
