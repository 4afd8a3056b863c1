"""Properties of a glTF object's material and mesh that a target does not take over."""

from collections.abc import Iterator
from typing import Any

from lfmesh.geometry.files.gltf_nodes import Node

_MAPS = {"normalTexture": "its normal map", "emissiveTexture": "its emission"}


def left_out(document: dict[str, Any], node: Node, parts: list[tuple[int, int]]) -> Iterator[str]:
    """Yield in words what is left out of a node with a mesh.

    Parameters
    ----------
    document : dict
        The file's JSON.
    node : Node
    parts : list of (int, int)
        Mesh and number of its primitives.
    """
    if "skin" in node.entry:
        yield "its bones are left out: it stands in the shape that it was made in"
    extensions = node.entry.get("extensions")
    if isinstance(extensions, dict):
        for name in sorted(set(extensions) - {"KHR_lights_punctual"}):
            yield f"{str(name)[:60]} is left out"
    told: dict[str, None] = {}
    for mesh, number in parts:
        primitive = document["meshes"][mesh]["primitives"][number]
        if primitive.get("targets"):
            told["its shape keys (morph targets) are left out"] = None
        if "COLOR_0" in (primitive.get("attributes") or {}):
            told["its vertex colours are left out"] = None
        told |= dict.fromkeys(_of_material(document, primitive.get("material")))
    yield from told


def _of_material(document: dict[str, Any], number: Any) -> Iterator[str]:
    materials = document.get("materials")
    if not isinstance(materials, list) or not isinstance(number, int) or not 0 <= number < len(materials):
        return
    material = materials[number]
    if not isinstance(material, dict):
        return
    where = f"materials[{number}]: "
    glow = material.get("emissiveFactor", [0.0])
    if isinstance(glow, list) and any(glow) and "emissiveTexture" not in material:
        yield f"{where}its emission is left out"
    for key, what in _MAPS.items():
        if key in material and (key != "emissiveTexture" or (isinstance(glow, list) and any(glow))):
            yield f"{where}{what} is left out"
    pbr = material.get("pbrMetallicRoughness")
    if isinstance(pbr, dict) and "metallicRoughnessTexture" in pbr:
        yield f"{where}of its metallic and roughness picture the mean is taken"
    extensions = material.get("extensions")
    if isinstance(extensions, dict):
        # The strength multiplies an emission that is told of above.
        for name in sorted(set(extensions) - {"KHR_materials_emissive_strength"}):
            yield f"{where}{str(name)[:60]} is left out"
