"""Pictures of metallic and roughness: their values as they are coded, at the place that the file gives them."""

import io
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest

import lfmesh as lf
from lfmesh.geometry.files.contents import counted, held
from lfmesh.geometry.files.mesh_file import load_mesh
from lfmesh.geometry.objects.targets import TargetMesh, target_mesh
from lfmesh.optics.gltf_material import GltfMaterial
from tests.cameras import camera_without_array
from tests.glb import QUAD, QUAD_UV, SPLIT, Glb

CODES = np.array([[[9, 10, 20], [9, 100, 60]], [[9, 200, 250], [9, 255, 0]]], np.uint8)
"""Left above, right above; left below, right below."""


def with_picture(glb: Glb, codes: np.ndarray, **info: Any) -> int:
    """Put a material with a picture of metallic and roughness in."""
    stream = io.BytesIO()
    PIL.Image.fromarray(codes).save(stream, format="png")
    image = glb.add("images", {"bufferView": glb.view(stream.getvalue()), "mimeType": "image/png"})
    texture = glb.add("textures", {"source": image, "sampler": glb.add("samplers", {"wrapS": 33071})})
    pbr = {"roughnessFactor": 0.5, "metallicFactor": 0.8, "metallicRoughnessTexture": {"index": texture} | info}
    return glb.add("materials", {"pbrMetallicRoughness": pbr})


def built(folder: Path, glb: Glb, **more: Any) -> TargetMesh:
    glb.write(folder / "a.glb")
    scene = lf.Scene(camera=camera_without_array(), targets=[{"file": "a.glb"} | more])
    return target_mesh(scene.targets[0], scene.in_folder(folder))


def test_a_picture_of_roughness_has_places_and_repeats_of_its_own(tmp_path: Path) -> None:
    glb = Glb()
    transform = {"KHR_texture_transform": {"offset": [0.25, 0.5], "scale": [0.5, 2.0]}}
    material = with_picture(glb, CODES, texCoord=1, extensions=transform)
    part = glb.primitive(QUAD, SPLIT, material, TEXCOORD_0=0.0 * QUAD_UV, TEXCOORD_1=QUAD_UV)
    glb.node("A", mesh=glb.add("meshes", {"primitives": [part]}))
    glb.node("B", mesh=0, scale=[-1.0, 1.0, 1.0])
    one, mirrored = load_mesh(glb.write(tmp_path / "a.glb"))
    assert one.gloss is not None
    assert mirrored.gloss is not None
    truth = (QUAD_UV * [0.5, 2.0] + [0.25, 0.5]) * [1.0, -1.0] + [0.0, 1.0]
    np.testing.assert_allclose(one.gloss.uv, truth[SPLIT])
    np.testing.assert_allclose(mirrored.gloss.uv, truth[SPLIT][:, ::-1])
    np.testing.assert_array_equal(one.gloss.picture, (CODES / 255.0).astype(np.float32))
    assert one.gloss.wrap == ("clamp", "repeat")
    assert one.material == GltfMaterial((1.0, 1.0, 1.0), 0.8, 0.5)
    assert counted(tmp_path / "a.glb") == held([one, mirrored])


def test_each_facet_has_the_materials_that_its_picture_spans(tmp_path: Path) -> None:
    glb = Glb()
    plain = glb.add("materials", {"pbrMetallicRoughness": {"metallicFactor": 0.3, "roughnessFactor": 0.4}})
    parts = [
        glb.primitive(QUAD, SPLIT, plain),
        glb.primitive(QUAD + np.array([0.0, 0.0, 1.0]), SPLIT, with_picture(glb, CODES), TEXCOORD_0=QUAD_UV),
    ]
    glb.node("A", mesh=glb.add("meshes", {"primitives": parts}))
    target = built(tmp_path, glb)
    assert target.gloss is not None
    assert target.material_of is not None
    np.testing.assert_array_equal(target.gloss.range_of, [-1, -1, 0, 0])
    (spanned,) = target.gloss.ranges
    assert spanned.metallic == (0.0, pytest.approx(0.8 * 250 / 255))
    roughnesses = [each.roughness for each in spanned.materials]
    # The least is below that of a gloss: 0.5 · 10/255.
    assert min(roughnesses) == pytest.approx(0.1)
    assert max(roughnesses) >= 0.5
    assert [target.materials[k] for k in target.material_of[[0, 2]]] == [
        GltfMaterial((1.0, 1.0, 1.0), 0.3, 0.4), spanned.materials[0]
    ]  # fmt: skip
    # The picture is read at the corners of the quad: rows from the top down, which QUAD_UV counts as glTF does.
    height, width = target.gloss.picture.shape[:2]
    u, v = np.moveaxis(target.gloss.uv[2:].reshape(-1, 2) * 0.98 + 0.02 * target.gloss.uv[2:].mean(axis=(0, 1)), 1, 0)
    found = target.gloss.picture[((1.0 - v) * height).astype(int), (u * width).astype(int)]
    corners = CODES[[1, 1, 0, 0], [0, 1, 1, 0]][SPLIT].reshape(-1, 3) / 255.0
    np.testing.assert_allclose(found, corners[:, 1:] * [0.5, 0.8], rtol=1e-6)


def test_an_even_picture_is_a_factor_of_the_material(tmp_path: Path) -> None:
    glb = Glb()
    material = with_picture(glb, np.broadcast_to(CODES[1, 0], (2, 3, 3)).copy())
    part = glb.primitive(QUAD, SPLIT, material, TEXCOORD_0=QUAD_UV)
    glb.node("A", mesh=glb.add("meshes", {"primitives": [part]}))
    target = built(tmp_path, glb)
    assert target.gloss is None
    (only,) = target.materials
    assert (only.metallic, only.roughness) == pytest.approx((0.8 * 250 / 255, 0.5 * 200 / 255), rel=1e-7)


def test_a_target_with_a_material_of_the_scene_has_no_gloss_of_its_file(tmp_path: Path) -> None:
    glb = Glb()
    part = glb.primitive(QUAD, SPLIT, with_picture(glb, CODES), TEXCOORD_0=QUAD_UV)
    glb.node("A", mesh=glb.add("meshes", {"primitives": [part]}))
    target = built(tmp_path, glb, materials="colours")
    assert target.gloss is None
    assert target.materials == ()
