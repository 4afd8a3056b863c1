"""Extensions of glTF files are named wherever they stand."""

import io
from pathlib import Path

import numpy as np
import PIL.Image
import pytest

from lfmesh.imports import read_gltf
from lfmesh.imports.report import Verdict
from tests.glb import QUAD, QUAD_UV, SPLIT, Glb

PLACES = {
    "KHR_animation_pointer": "animation",
    "KHR_gaussian_splatting": "primitive",
    "KHR_interactivity": "file",
    **dict.fromkeys(
        ("KHR_materials_anisotropy", "KHR_materials_clearcoat", "KHR_materials_dispersion", "KHR_materials_ior",
         "KHR_materials_iridescence", "KHR_materials_sheen", "KHR_materials_specular", "KHR_materials_transmission",
         "KHR_materials_unlit", "KHR_materials_volume"),
        "material",
    ),
    "KHR_materials_variants": "file",
    **dict.fromkeys(("KHR_node_hoverability", "KHR_node_selectability", "KHR_node_visibility"), "node above"),
    "KHR_texture_basisu": "texture",
    "EXT_lights_image_based": "scene",
    "EXT_mesh_gpu_instancing": "node",
    "EXT_texture_webp": "texture",
    "EXT_of_a_mesh": "mesh",
    "EXT_of_a_picture_in_a_material": "picture",
    "EXT_of_a_sampler": "sampler",
    "EXT_of_an_image": "image",
}  # fmt: skip
"""Extensions and where they stand: the ratified ones of Khronos' registry that are not taken, and others."""


def picture() -> bytes:
    stream = io.BytesIO()
    PIL.Image.fromarray(np.zeros((2, 2, 3), np.uint8)).save(stream, "PNG")
    return stream.getvalue()


def sheet() -> Glb:
    """A square with a picture, below a node without a mesh."""
    glb = Glb()
    material = glb.material(picture=picture())
    above = glb.node("above")
    mesh = glb.add("meshes", {"primitives": [glb.primitive(QUAD, SPLIT, material, TEXCOORD_0=QUAD_UV)]})
    glb.node("A", above, mesh=mesh)
    glb.tree["textures"][0]["sampler"] = glb.add("samplers", {})
    return glb


@pytest.mark.parametrize("name", PLACES)
def test_an_extension_is_named_wherever_it_stands(tmp_path: Path, name: str) -> None:
    glb = sheet()
    tree = glb.tree
    if PLACES[name] == "animation":
        glb.add("animations", {"channels": [], "samplers": []})
    (material,) = tree["materials"]
    places = {
        "file": tree,
        "scene": tree["scenes"][0],
        "node above": tree["nodes"][0],
        "node": tree["nodes"][1],
        "mesh": tree["meshes"][0],
        "primitive": tree["meshes"][0]["primitives"][0],
        "material": material,
        "picture": material["pbrMetallicRoughness"]["baseColorTexture"],
        "texture": tree["textures"][0],
        "sampler": tree["samplers"][0],
        "image": tree["images"][0],
        "animation": tree.get("animations", [{}])[0],
    }
    places[PLACES[name]]["extensions"] = {name: {}}
    scene = read_gltf(glb.write(tmp_path / "scene.glb"))
    scene.targets("scene.glb")
    (said,) = scene.report.of(Verdict.APPROXIMATED)
    assert ("animations: " if PLACES[name] == "animation" else f"{name} is left out") in str(said)
