"""Shapes of bodies of glass: the same tables as of targets, and what is refused beside them."""

from typing import Any

import pytest

import lfmesh as lf
from lfmesh.errors import SceneError
from lfmesh.geometry.objects.targets import target_body
from tests.cameras import camera_without_array

BALL = {"kind": "sphere", "radius_mm": 5.0}


def scene(**refractor: Any) -> lf.Scene:
    return lf.Scene(camera=camera_without_array(), targets=[{"refractor": {"index": 1.5} | refractor}])


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({}, "refractor.file"),
        ({"shape": BALL, "file": "ball.stl"}, "shape is given too"),
        ({"shape": BALL, "units": "mm"}, "shape is given too"),
        ({"shape": BALL, "box_mm": [1.0, 1.0, 1.0]}, "shape is given too"),
        ({"box_mm": [1.0, 1.0, 1.0], "surface": "flat"}, "box_mm is given too"),
        ({"shape": BALL, "surface": "patch"}, "a shape is exact, or has flat facets"),
        ({"shape": {"kind": "disk", "radius_mm": 1.0}}, "shape"),
        ({"shape": {"kind": "sphere", "radius_mm": -1.0}}, "radius_mm"),
        ({"shape": {"kind": "cylinder", "radius_mm": 1.0}}, "height_mm"),
    ],
)
def test_a_shape_that_means_nothing_is_refused(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(SceneError, match=said.replace(".", r"\.")):
        scene(**keys)


def test_an_element_of_the_lens_is_no_primitive_shape() -> None:
    camera = camera_without_array()
    camera["lens"]["surfaces"].insert(0, {"refractor": {"shape": BALL, "index": 1.5}, "thickness_mm": 1.0})
    with pytest.raises(SceneError, match="only for a refractor in front of the camera; give file"):
        lf.Scene(camera=camera)


def test_round_glass_is_met_exactly_unless_flat_facets_are_asked_for() -> None:
    for each, is_round in (
        (scene(shape=BALL), True),
        (scene(shape={"kind": "cylinder", "radius_mm": 1.0, "height_mm": 2.0}), True),
        (scene(shape={"kind": "box", "size_mm": [1.0, 2.0, 3.0]}), False),
        (scene(shape=BALL, surface="flat"), False),
        (scene(shape=BALL).changed({"transport.surface": "flat"}), False),
    ):
        body = target_body(each.targets[0], each)
        assert (body.round is not None) == is_round
        assert body.closed


def test_a_box_is_the_same_by_either_key() -> None:
    one, other = scene(shape={"kind": "box", "size_mm": [1.0, 2.0, 3.0]}), scene(box_mm=[1.0, 2.0, 3.0])
    first, second = (target_body(each.targets[0], each).mesh for each in (one, other))
    assert (first.vertices == second.vertices).all()
    assert (first.faces == second.faces).all()


def test_a_scene_with_a_ball_of_glass_is_the_same_as_text() -> None:
    one = scene(shape=BALL)
    assert lf.loads(one.dump_toml()) == one
