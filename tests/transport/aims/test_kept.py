"""Ghosts of a camera and light through glass of a scene are searched once, and anew where anything of it differs."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.transport.aims import ghost_aim, kept
from lfmesh.transport.aims.kept import Kept, digest_of
from lfmesh.transport.render import glass_aim
from tests.cameras import camera_without_array

BLOCK = {"refractor": {"box_mm": [10.0, 10.0, 10.0], "index": 1.5}, "position_mm": [0.0, 0.0, -100.0]}
WALL = {"shape": {"kind": "plane", "width_mm": 80.0, "height_mm": 80.0}, "position_mm": [0.0, 0.0, -130.0]}


def scene(**transport: Any) -> lf.Scene:
    """A block of glass before a wall that a lamp lights."""
    return lf.Scene(
        camera=camera_without_array(pixels=4),
        targets=[WALL, BLOCK],
        lights=[{"kind": "point", "position_mm": [20.0, 20.0, -60.0], "power_w": 1.0}],
        transport={"samples": 2, "replicates": 2, **transport},
    )


@pytest.fixture
def searches(monkeypatch: pytest.MonkeyPatch) -> dict[str, int]:
    """How often ghosts and light through glass have been searched; nothing is kept of other tests."""
    counts = {"ghosts": 0, "glass": 0}

    def counted(name: str, search: Callable[..., Any]) -> Callable[..., Any]:
        def found(*given: Any) -> Any:
            counts[name] += 1
            return search(*given)

        return found

    monkeypatch.setattr(ghost_aim, "_traced", counted("ghosts", ghost_aim._traced))
    monkeypatch.setattr(glass_aim, "_found", counted("glass", glass_aim._found))
    monkeypatch.setattr(ghost_aim, "_kept", Kept())
    monkeypatch.setattr(glass_aim, "_aims", Kept())
    return counts


@pytest.fixture
def in_vain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Searches take no time and find nothing."""
    monkeypatch.setattr(ghost_aim, "_traced", lambda *_: None)
    monkeypatch.setattr(glass_aim, "_found", lambda *_: (None, None))


def test_renders_of_a_scene_share_its_searches_and_have_the_bits_of_one_alone(searches: dict[str, int]) -> None:
    alone = lf.render(scene(seed=3))
    lf.render(scene(seed=4, samples=4, method="forward"))
    again = lf.render(scene(seed=3))
    assert searches == {"ghosts": 1, "glass": 1}
    np.testing.assert_array_equal(again.mean, alone.mean)
    np.testing.assert_array_equal(again.stderr, alone.stderr)


@pytest.mark.parametrize(
    ("change", "anew"),
    [
        ({"targets[1].position_mm": [1.0, 0.0, -100.0]}, {"ghosts": 1, "glass": 2}),
        ({"targets[1].refractor.box_mm": [10.0, 10.0, 9.0]}, {"ghosts": 1, "glass": 2}),
        ({"lights[0].position_mm": [20.0, 20.0, -70.0]}, {"ghosts": 1, "glass": 2}),
        ({"camera.sensor.pixel_mm": 0.4}, {"ghosts": 2, "glass": 2}),
        ({"transport.max_events": 32}, {"ghosts": 2, "glass": 2}),
    ],
)
def test_what_may_change_them_has_them_searched_anew(
    change: dict[str, Any], anew: dict[str, int], in_vain: None, searches: dict[str, int]
) -> None:
    for each in (scene(), scene().changed(change)):
        lf.render(each)
    assert searches == anew


def test_only_the_latest_are_kept() -> None:
    store, asked = Kept[int](), []
    for number in [*range(kept.KEPT + 1), kept.KEPT, 0]:
        assert store.of(digest_of(number), lambda number=number: asked.append(number) or number) == number
    assert asked == [*range(kept.KEPT + 1), 0]


def test_digests_tell_values_types_and_shapes() -> None:
    array = np.arange(6.0)
    alike = [array, array.reshape(2, 3), array.astype(np.float32), tuple(array), (array, array), None, 0, 0.0, "0"]
    assert len({digest_of(each) for each in alike}) == len(alike)
    assert digest_of(array, (array, 1)) == digest_of(array.copy(), (array.copy(), 1))
