"""Values of a scene replaced by their path: a path that leads nowhere is named, whatever stands in it."""

import pytest

from lfmesh.errors import SceneError
from lfmesh.scene import Scene
from tests.cameras import close_up_camera

TARGET = {"shape": {"kind": "sphere", "radius_mm": 1.0}, "position_mm": [0.0, 0.0, -60.0]}
SCENE = Scene(camera=close_up_camera(), targets=[TARGET])


@pytest.mark.parametrize(
    ("path", "says"),
    [
        ("targets[1].position_mm", "targets has 1 entry, numbered from 0: there is no [1]"),
        ("targets[1000000000].position_mm", "targets has 1 entry, numbered from 0: there is no [1000000000]"),
        ("lights[0].power_w", "lights has 0 entries, numbered from 0: there is no [0]"),
        ("targets[0].position_mm[3]", "targets[0].position_mm has 3 entries, numbered from 0: there is no [3]"),
        ("targets[-1].position_mm", "targets is a list: a whole number from 0 must follow, such as targets[0]"),
        ("targets[-1]", "targets is a list: a whole number from 0 must follow, such as targets[0]"),
        ("targets[x].position_mm", "targets is a list: a whole number from 0 must follow, such as targets[0]"),
        ("targets.position_mm", "targets is a list: a whole number from 0 must follow, such as targets[0]"),
        ("targets[" + 30 * "9" + "].position_mm", "targets is a list: a whole number from 0 must follow"),
        ("schema_version.x", "schema_version is a single value, 1: nothing can follow"),
        ("camera[0]", "unknown key; valid here: focus_mm,"),
        ("", "unknown key"),
    ],
)
def test_a_path_that_leads_nowhere_is_named_with_what_is_valid(path: str, says: str) -> None:
    with pytest.raises(SceneError) as told:
        SCENE.changed({path: 1.0})
    assert says in str(told.value)
    assert path in str(told.value)


def test_a_quoted_number_is_not_told_to_be_what_it_is() -> None:
    with pytest.raises(SceneError) as told:
        SCENE.changed({"schema_version": "1"})
    assert str(told.value) == 'Scene.schema_version = "1": must be 1'


def test_an_entry_is_replaced_and_the_others_stay() -> None:
    moved = SCENE.changed({"targets[0].position_mm[2]": -70.0})
    assert moved.targets[0].position_mm == (0.0, 0.0, -70.0)
    assert moved.targets[0].shape == SCENE.targets[0].shape
    assert SCENE.targets[0].position_mm == (0.0, 0.0, -60.0)
