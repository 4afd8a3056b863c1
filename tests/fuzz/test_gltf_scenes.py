"""glTF scenes whose JSON has values put in at random, or bytes changed, are taken or refused by one line."""

import copy
import functools
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lfmesh.errors import LensFileWarning, LfmeshError
from lfmesh.geometry.objects.placement import placements
from lfmesh.scene import Scene, loads
from tests.cameras import camera_without_array
from tests.fuzz.test_meshes import damaged, damages, kept
from tests.glb import QUAD, QUAD_UV, SPLIT, Glb, turn
from tests.validation.test_handedness import written

TOML = (
    'targets = { file = "scene.glb" }\nlights = { file = "scene.glb" }\n'
    + Scene(camera=camera_without_array()).dump_toml().replace("schema_version = 1\n", "")
    + '[camera.pose]\nfile = "scene.glb"\n'
)


@functools.cache
def whole(folder: Path) -> Glb:
    """Return a file with a tree, two materials, a picture, three lights and a camera."""
    glb = Glb()
    rig = glb.node("Rig", translation=[0.1, 0.2, 0.3], rotation=turn((1, 2, 3), 30.0), scale=[1.0, 2.0, 1.0])
    glb.add("cameras", {"type": "perspective", "perspective": {"yfov": 0.4, "znear": 0.1}})
    glb.node("Camera", camera=0, translation=[0.0, 0.0, 1.0])
    picture = glb.material((0.5, 0.6, 0.7), written("R", folder, (12, 16))[0].read_bytes())
    base = glb.tree["materials"][picture]["pbrMetallicRoughness"]["baseColorTexture"]
    base |= {"texCoord": 0, "extensions": {"KHR_texture_transform": {"offset": [0.5, 0.0], "scale": [2.0, 1.0]}}}
    plain = glb.material(emissiveFactor=[1.0, 0.0, 0.0], normalTexture={"index": 0}, alphaMode="MASK", alphaCutoff=0.4)
    glb.add("meshes", {"primitives": [glb.primitive(QUAD, SPLIT, picture, TEXCOORD_0=QUAD_UV)]})
    glb.add("meshes", {"primitives": [glb.primitive(QUAD, SPLIT, plain), glb.primitive(QUAD + 1.0, SPLIT)]})
    glb.node("A", rig, mesh=0, matrix=[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1])
    glb.node("B", rig, mesh=1)
    glb.light("Point", {"type": "point", "intensity": 100.0, "color": [1.0, 0.9, 0.8], "range": 10.0}, rig)
    spot = {"innerConeAngle": 0.1, "outerConeAngle": 0.5}
    glb.light("Spot", {"type": "spot", "intensity": 100.0, "spot": spot}, rig)
    glb.light("Sun", {"type": "directional", "intensity": 100.0})
    glb.tree["extensionsRequired"] = ["KHR_lights_punctual"]
    return glb


def places(value: Any, where: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the ways to all values inside a document."""
    if where:
        yield where
    inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in inside:
        yield from places(item, (*where, key))


JUNK = st.sampled_from(
    [None, True, -1, 0, 1, 2, 7, 10**12, 1.5, -0.0, 1e300, 1e-300, float("nan"), float("inf"), "", "x", "\n" * 500, [],
     [0], [[]], [None, {}], [1.0] * 3, [1e200] * 4, [0.0] * 16, {}, {"nodes": 3}, {"index": "x"}, ["TEXCOORD_9"]]
)  # fmt: skip


def is_taken_or_refused(folder: Path, content: bytes) -> None:
    (folder / "scene.glb").write_bytes(content)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LensFileWarning)
            placements(loads(TOML, folder))
    except LfmeshError as error:
        message = str(error)
        assert "\n" not in message
        assert len(message) < 700 + 3 * len(str(folder))


unhurried = settings(
    deadline=None, derandomize=True, database=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
changes = st.lists(st.tuples(st.floats(0.0, 1.0, exclude_max=True), JUNK), min_size=1, max_size=2)


def changed(glb: Glb, changes: list[tuple[float, Any]]) -> bytes:
    """Return the file with values of its document replaced."""
    tree = copy.deepcopy(glb.tree)
    for share, junk in changes:
        ways = list(places(tree))
        *way, last = ways[int(share * len(ways))]
        holder = functools.reduce(lambda value, key: value[key], way, tree)
        holder[last] = copy.deepcopy(junk)
    return Glb(tree, glb.data).bytes()


def test_the_scene_that_is_damaged_is_whole(tmp_path: Path) -> None:
    (tmp_path / "scene.glb").write_bytes(whole(tmp_path).bytes())
    with pytest.warns(LensFileWarning):
        scene = loads(TOML, tmp_path)
    assert [target.name for target in scene.targets] == ["A", "B"]
    assert [light.kind for light in scene.lights] == ["point", "spot", "directional"]
    assert [each.facets for each in placements(scene)] == [2, 4]


@settings(unhurried, max_examples=60)
@given(changes)
def test_a_changed_document_is_taken_or_refused(tmp_path: Path, changes: list[tuple[float, Any]]) -> None:
    is_taken_or_refused(tmp_path, changed(whole(tmp_path), changes))


@pytest.mark.long
@settings(unhurried, max_examples=3_000)
@given(changes)
def test_many_changed_documents_are_taken_or_refused(tmp_path: Path, changes: list[tuple[float, Any]]) -> None:
    is_taken_or_refused(tmp_path, changed(whole(tmp_path), changes))


@settings(unhurried, max_examples=40)
@given(damages, kept)
def test_a_damaged_scene_is_taken_or_refused(tmp_path: Path, damage: list[tuple[float, bytes]], kept: float) -> None:
    is_taken_or_refused(tmp_path, damaged(whole(tmp_path).bytes(), damage, kept))
