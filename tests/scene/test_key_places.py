"""An unknown key is answered with the tables that know it, derived from the models of the scene."""

from collections.abc import Iterator
from typing import Any

import pytest

from lfmesh.errors import SceneError
from lfmesh.scene import Scene, loads
from lfmesh.scene.key_places import key_places
from lfmesh.study.sweeps.paths import value_at
from tests.cameras import close_up_camera

SPHERE = {"shape": {"kind": "sphere", "radius_mm": 1.0}, "position_mm": [0.0, 0.0, -60.0]}
LAMP = {"kind": "point", "position_mm": [0.0, 0.0, -10.0], "power_w": 1.0}
SCENE = Scene(camera=close_up_camera(), targets=[SPHERE], lights=[LAMP])


@pytest.mark.parametrize(
    ("path", "answer"),
    [
        ("targets[0].sides", "it is valid as Scene.targets[0].material.sides; valid here: file,"),
        (
            "targets[0].material.position_mm",
            "valid as Scene.targets[0].position_mm or Scene.targets[0].motion.poses[i].position_mm; valid here:",
        ),
        ("camera.replicates", "it is valid as Scene.transport.replicates; valid here: focus_mm,"),
        ("camera.samples", "it is valid as Scene.particles[i].samples or Scene.transport.samples; valid here:"),
        ("camera.radius_mm", "Scene.camera.lens.surfaces[i].radius_mm"),
        ("transport.layers", "it is valid as Scene.coatings.NAME.layers or Scene.camera.lens.coatings.NAME.layers;"),
        ("targets[0].shape.width_mm", 'it is valid with kind = "plane"; valid here: kind, radius_mm'),
        ("lights[0].radius_mm", 'it is valid with kind = "disk"'),
        ("targets[0].shape.material", "it is valid as Scene.targets[0].material; valid here: kind, radius_mm"),
        ("targets[0].nowhere", "Scene.targets[0].nowhere: unknown key; valid here: file,"),
    ],
)
def test_an_unknown_key_is_answered_with_the_tables_that_know_it(path: str, answer: str) -> None:
    with pytest.raises(SceneError) as told:
        SCENE.changed({path: 1.0})
    assert f"Scene.{path}: unknown key" in str(told.value)
    assert answer in str(told.value)


def test_a_path_of_a_study_is_answered_alike() -> None:
    with pytest.raises(KeyError, match=r"has no field 'replicates'; it is valid as transport\.replicates; valid"):
        value_at(SCENE, "camera.replicates")
    with pytest.raises(KeyError, match=r"it is valid as targets\[0\]\.material\.sides; valid here"):
        value_at(SCENE, "targets[0].sides")


def test_every_key_of_the_schema_has_its_places() -> None:
    """The JSON Schema, which pydantic writes, has the same keys; it also holds the tables that name a glTF file."""
    schema = Scene.model_json_schema()
    found = key_places(Scene)
    assert set(found) >= set(_keys(schema)) - {"lighting"}
    for key, places in found.items():
        for place in places:
            assert key in _tables_at(schema, place.steps), place


def _keys(schema: Any) -> Iterator[str]:
    if isinstance(schema, dict):
        properties = schema.get("properties")
        yield from properties if isinstance(properties, dict) else ()
    for inner in schema.values() if isinstance(schema, dict) else schema if isinstance(schema, list) else ():
        yield from _keys(inner)


def _tables_at(schema: dict[str, Any], steps: tuple[str, ...]) -> set[str]:
    """Return the keys of all tables that the schema allows at a place."""
    nodes = _opened(schema, schema)
    for step in steps[:-1]:
        inside = []
        for node in nodes:
            if step == "[i]":
                inside += [node[key] for key in ("items",) if key in node] + node.get("prefixItems", [])
            elif step == "NAME":
                inside += [node["additionalProperties"]] if isinstance(node.get("additionalProperties"), dict) else []
            elif step in node.get("properties", {}):
                inside.append(node["properties"][step])
        nodes = [opened for each in inside for opened in _opened(each, schema)]
    return {key for node in nodes for key in node.get("properties", {})}


def _opened(node: dict[str, Any], schema: dict[str, Any]) -> list[dict[str, Any]]:
    """Return a node with its references followed and its alternatives side by side."""
    if "$ref" in node:
        return _opened(schema["$defs"][node["$ref"].rsplit("/", 1)[-1]], schema)
    inner = [each for key in ("anyOf", "oneOf", "allOf") for each in node.get(key, [])]
    return [node, *(opened for each in inner for opened in _opened(each, schema))]


@pytest.mark.parametrize(
    "shape", ['{ kind = "mesh" }', '{ file = "part.stl" }', '{ kind = "mesh", file = "part.stl" }']
)
def test_a_mesh_given_as_a_shape_is_answered_with_its_table(shape: str) -> None:
    camera = SCENE.camera_alone().dump_toml()
    with pytest.raises(SceneError) as told:
        loads(f"{camera}\n[[targets]]\nshape = {shape}\n")
    answer = 'targets[0].shape: a mesh is no shape: write [[targets]] file = "part.stl" in place of shape'
    assert str(told.value) == f"scene: {answer}"
    with pytest.raises(SceneError, match=r"refractor\.shape: .*\[targets\.refractor\] file = \"part\.stl\""):
        loads(f"{camera}\n[[targets]]\nrefractor = {{ index = 1.5, shape = {shape} }}\n")
