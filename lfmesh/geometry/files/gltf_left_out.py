"""Properties of a glTF object's node, mesh and material that a target ignores.

The tables below list each property in the specification (glTF 2.0, section 5): used or without effect on light, or
ignored, with a message. Unlisted properties, such as extensions, are reported by name.
"""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from lfmesh.geometry.files.gltf_looks import SPECULAR_GLOSSINESS, only_specular
from lfmesh.geometry.files.gltf_nodes import Node

SILENT = ""
"""Instead of a message: used, or without effect on light."""

_EVERYWHERE = dict.fromkeys(("name", "extras"), SILENT)

OF_NODE = _EVERYWHERE | {
    **dict.fromkeys(("camera", "children", "matrix", "mesh", "rotation", "scale", "translation"), SILENT),
    "skin": "its bones are left out: it keeps its rest pose",
    # Weights of morph targets, which are reported for the primitives.
    "weights": SILENT,
}
OF_MESH = _EVERYWHERE | dict.fromkeys(("primitives", "weights"), SILENT)
OF_SCENE = _EVERYWHERE | {"nodes": SILENT}
OF_PRIMITIVE = _EVERYWHERE | {
    **dict.fromkeys(("attributes", "indices", "material", "mode"), SILENT),
    "targets": "its shape keys (morph targets) are left out",
}
OF_ATTRIBUTES = {
    # Vertex colours replaced by a picture are reported when the facets are read.
    **dict.fromkeys(("POSITION", "NORMAL", "TANGENT", "COLOR_0"), SILENT),
    "COLOR_1": "its second vertex colours are left out",
}
"""Attributes numbered beyond these, such as joints and further texture coordinates, are silent: the properties that use
them are reported."""
OF_MATERIAL = _EVERYWHERE | {
    **dict.fromkeys(("pbrMetallicRoughness", "alphaMode", "alphaCutoff", "doubleSided"), SILENT),
    "normalTexture": "its normal map is left out",
    # A substitute for shadowing, which is traced here.
    "occlusionTexture": SILENT,
    "emissiveFactor": "its emission is left out",
    "emissiveTexture": "its emission is left out",
}
OF_PBR = _EVERYWHERE | {
    **dict.fromkeys(("baseColorFactor", "baseColorTexture", "metallicFactor", "roughnessFactor"), SILENT),
    "metallicRoughnessTexture": SILENT,
}
OF_TEXTURE_INFO = _EVERYWHERE | dict.fromkeys(("index", "texCoord"), SILENT)
OF_TEXTURE = _EVERYWHERE | dict.fromkeys(("sampler", "source"), SILENT)
OF_SAMPLER = _EVERYWHERE | {
    **dict.fromkeys(("wrapS", "wrapT", "minFilter"), SILENT),
    "magFilter": "its picture is interpolated between texels, where the file asks for the nearest",
}
OF_IMAGE = _EVERYWHERE | dict.fromkeys(("uri", "mimeType", "bufferView"), SILENT)
_LINEAR = 9729

_TAKEN = ("KHR_lights_punctual", "KHR_texture_transform", "KHR_materials_emissive_strength", "KHR_xmp_json_ld")
"""Extensions that are used; one that multiplies an emission, which is reported itself; and one that holds only text."""


def left_out_of_scene(document: dict[str, Any], nodes: Iterable[Node]) -> Iterator[tuple[str, str]]:
    """Yield place and message for each property ignored in a file, its scene and its nodes without a mesh."""
    own = {"extensions": document.get("extensions")}
    scene = _entry(document, "scenes", document.get("scene", 0))
    for place, entry, known in (("the file", own, OF_SCENE), ("its scene", scene, OF_SCENE)):
        yield from ((place, words) for words in _told(entry, known))
    for node in nodes:
        if "mesh" not in node.entry:
            yield from ((node.place, words) for words in _told(node.entry, OF_NODE))


def left_out(document: dict[str, Any], node: Node, parts: list[tuple[int, int]]) -> Iterator[str]:
    """Yield a message for each property ignored in a node with a mesh.

    Parameters
    ----------
    document : dict
    node : Node
    parts : list of (int, int)
        Mesh and number of its primitives.
    """
    told = dict.fromkeys(_told(node.entry, OF_NODE))
    for mesh, number in parts:
        told |= dict.fromkeys(_told(document["meshes"][mesh], OF_MESH))
        primitive = document["meshes"][mesh]["primitives"][number]
        told |= dict.fromkeys(_told(primitive, OF_PRIMITIVE))
        attributes = primitive.get("attributes")
        told |= {words: None for key in attributes or () if (words := OF_ATTRIBUTES.get(key, SILENT))}
        told |= dict.fromkeys(_of_material(document, primitive.get("material")))
    yield from told


def _of_material(document: dict[str, Any], number: Any) -> Iterator[str]:
    material = _entry(document, "materials", number)
    if only_specular(material) is not None:
        # It replaces the missing metallic-roughness description.
        yield f"materials[{number}]: {SPECULAR_GLOSSINESS} is read without its specular colour and combined picture"
        extensions = {key: value for key, value in material["extensions"].items() if key != SPECULAR_GLOSSINESS}
        material = material | {"extensions": extensions}
    glow = material.get("emissiveFactor", [0.0])
    dark = not (isinstance(glow, list) and any(glow))
    shown = {key: value for key, value in material.items() if not (dark and key.startswith("emissive"))}
    pbr = _table(material.get("pbrMetallicRoughness"))
    told = dict.fromkeys([*_told(shown, OF_MATERIAL), *_told(pbr, OF_PBR)])
    for key in ("baseColorTexture", "metallicRoughnessTexture"):
        told |= dict.fromkeys(_of_texture(document, _table(pbr.get(key))))
    yield from (f"materials[{number}]: {words}" for words in told)


def _of_texture(document: dict[str, Any], info: dict[str, Any]) -> Iterator[str]:
    texture = _entry(document, "textures", info.get("index"))
    sampler = dict(_entry(document, "samplers", texture.get("sampler")))
    if sampler.get("magFilter") == _LINEAR:
        sampler.pop("magFilter")
    image = _entry(document, "images", texture.get("source"))
    for entry, known in ((info, OF_TEXTURE_INFO), (texture, OF_TEXTURE), (sampler, OF_SAMPLER), (image, OF_IMAGE)):
        yield from _told(entry, known)


def _told(entry: Mapping[str, Any], known: Mapping[str, str]) -> Iterator[str]:
    """Yield the messages for the properties of an entry, and its extensions by name."""
    for key, value in entry.items():
        if key == "extensions":
            names = sorted(str(name) for name in _table(value) if name not in _TAKEN)
            yield from (f"{name[:60]} is left out" for name in names)
        elif (words := known.get(key, f"{str(key)[:60]} is left out")) != SILENT and value not in ([], {}, None):
            yield words


def _entry(document: dict[str, Any], key: str, number: Any) -> dict[str, Any]:
    """Return an entry of one of the document's lists; empty if there is none."""
    entries = document.get(key)
    if not isinstance(entries, list) or not isinstance(number, int) or not 0 <= number < len(entries):
        return {}
    return _table(entries[number])


def _table(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}
