"""The number of replicates of a scene that gives none follows its splitting, wherever that is set."""

import pickle
import tomllib

import pytest

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.errors import LfmeshError
from lfmesh.files.image_file import scene_from

USUAL = {"both": 8, "roulette": 8, "transmit": 4}


@pytest.fixture
def scene() -> lf.Scene:
    scene = lf.load(asset_path("scenes/first_light.toml"))
    return scene.changed({"transport": {"samples": 64}, "targets": ()})


@pytest.mark.parametrize(("split", "count"), USUAL.items())
def test_a_scene_without_replicates_has_those_of_its_splitting(scene: lf.Scene, split: str, count: int) -> None:
    assert scene.transport.replicates == 8
    changed = scene.changed({"transport.split": split})
    assert changed.transport.replicates == count
    # There and back, by way of another change and a pickle.
    other = pickle.loads(pickle.dumps(changed.changed({"transport.seed": 3})))
    assert other.transport.replicates == count
    assert other.changed({"transport.split": "both"}).transport.replicates == 8
    assert other.transport.samples_each * count == 64


@pytest.mark.parametrize("split", USUAL)
def test_given_replicates_stay(scene: lf.Scene, split: str) -> None:
    given = scene.changed({"transport.replicates": 6})
    assert given.changed({"transport.split": split}).transport.replicates == 6


@pytest.mark.parametrize(("split", "count"), USUAL.items())
def test_files_name_the_replicates(scene: lf.Scene, split: str, count: int) -> None:
    written = scene.changed({"transport.split": split, "transport.seed": 3})
    table = tomllib.loads(written.dump_toml())
    assert table["transport"]["replicates"] == count
    back = lf.loads(written.dump_toml())
    assert back == written
    assert back.digest == written.digest


def test_runs_from_before_the_rule_keep_the_eight_that_they_had(scene: lf.Scene, tmp_path) -> None:
    text = scene.changed({"transport.split": "transmit"}).dump_toml()
    old = "\n".join(line for line in text.splitlines() if not line.startswith("replicates"))
    assert lf.loads(old).transport.replicates == 4
    assert scene_from({"scene_toml": old, "scene_folder": "."}, tmp_path).transport.replicates == 8


def test_a_wrong_splitting_is_one_fault_alone(scene: lf.Scene) -> None:
    with pytest.raises(LfmeshError) as caught:
        scene.changed({"transport.split": "none"})
    assert str(caught.value).count("\n") == 0
    assert "transport.split" in str(caught.value)
    assert "replicates" not in str(caught.value)


def test_samples_are_rounded_to_the_replicates_of_the_splitting(scene: lf.Scene) -> None:
    assert scene.changed({"transport.samples": 12}).transport.samples_each == 2
    assert scene.changed({"transport.samples": 12, "transport.split": "transmit"}).transport.samples_each == 3
