"""Drawn cameras and scenes: always the same for a number, with every feature among them, and as text that loads."""

from collections import Counter
from functools import cache

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.geometry import frame
from lfmesh.geometry.motions import motions_of
from lfmesh.geometry.rigid_motion import pose_at
from tests.random_scenes.draft import FEATURES
from tests.random_scenes.examine import IN_SUITE, REPEATED
from tests.random_scenes.generator import OWN_KERNELS, Drawn, Kind, draw, smaller
from tests.random_scenes.transforms import moved

FIRST = 25
"""Draws of each kind that are looked at."""


@cache
def drawn(kind: Kind, number: int) -> Drawn:
    return draw(kind, number)


def test_a_number_draws_the_same_scene_each_time() -> None:
    assert draw("scene", 3).scene == drawn("scene", 3).scene
    assert drawn("scene", 3).scene != drawn("scene", 4).scene


@pytest.mark.long
def test_every_feature_is_drawn_as_often_as_the_table_says() -> None:
    """Of 300 cameras and 200 scenes; some features do not go with others, so that they may be rarer, never absent."""
    for kind, count in (("camera", 300), ("scene", 200)):
        found = Counter(name for number in range(count) for name in draw(kind, number).features)
        for feature in FEATURES.values():
            expected = count * (feature.in_cameras if kind == "camera" else feature.in_scenes)
            assert found[feature.name] <= expected + 5.0 * expected**0.5
            assert found[feature.name] > 0 or expected < 7.0, feature.name


def test_every_common_feature_is_among_the_first_draws() -> None:
    has = {name for kind in ("camera", "scene") for number in range(FIRST) for name in drawn(kind, number).features}
    common = {f.name for f in FEATURES.values() if max(f.in_cameras, f.in_scenes) >= 0.15}
    assert common <= has, common - has


def test_every_feature_of_the_suites_draws_is_in_those_that_are_no_long_tests() -> None:
    has = {(kind, n): set(draw(kind, n, OWN_KERNELS).features) for kind in REPEATED for n in range(IN_SUITE)}
    stay = [features for (kind, n), features in has.items() if n not in REPEATED[kind]]
    assert set().union(*has.values()) == set().union(*stay)


def test_few_draws_are_refused() -> None:
    refused = [why for kind in ("camera", "scene") for number in range(FIRST) for why in drawn(kind, number).refused]
    assert len(refused) < 0.5 * FIRST, refused


def test_a_drawn_scene_is_the_same_as_text() -> None:
    for number in range(8):
        for kind in ("camera", "scene"):
            one = drawn(kind, number)
            assert lf.loads(one.toml, asset_path(".")) == one.scene


def test_a_feature_that_is_left_out_leaves_the_others_as_they_are() -> None:
    whole = drawn("scene", 5)
    for one in smaller(whole):
        assert one.without < set(whole.features)
        assert set(one.features) < set(whole.features)
        assert one.scene.camera.focus_mm == whole.scene.camera.focus_mm


@pytest.mark.parametrize("number", [11, 14])
def test_a_scene_that_is_moved_keeps_its_motions_relative_to_itself(number: int) -> None:
    still = draw("scene", number)
    assert "motion" in still.features
    tilt, shift, end = [10.0, 20.0, 30.0], [100.0, 20.0, 3.0], still.tables["exposure"]["duration_s"]
    there = frame.frame(tilt, shift)
    moving = lf.Scene(**moved(still.tables, tilt, shift)).in_folder(asset_path("."))
    before, after = (motions_of(scene) for scene in (still.scene, moving))
    pairs = zip(
        (before.camera, *before.bodies, *before.lights), (after.camera, *after.bodies, *after.lights), strict=True
    )
    for one, other in pairs:
        assert (one is None) == (other is None)
        if one is not None and other is not None:
            wanted = frame.compose(there, frame.compose(pose_at(one, end), frame.inverse(there)))
            np.testing.assert_allclose(pose_at(other, end), wanted, atol=1e-9 * still.tables["camera"]["focus_mm"])
