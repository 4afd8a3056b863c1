"""glTF geometry and materials straight from the file's own numbers."""

import io
import json
import warnings

import numpy as np
import PIL.Image
import pytest

from lfmesh.errors import LensFileWarning, MeshError
from lfmesh.geometry.files.mesh_file import load_mesh
from tests.glb import QUAD, QUAD_UV, SPLIT, Glb


def picture(value=51):
    stream = io.BytesIO()
    PIL.Image.fromarray(np.full((2, 2, 3), value, np.uint8)).save(stream, "PNG")
    return stream.getvalue()


def sheet(material=None, **attributes):
    """Return a file with a square, and its primitive."""
    glb = Glb()
    number = glb.material(picture=picture()) if material is None else glb.add("materials", material)
    primitive = glb.primitive(QUAD, SPLIT, number, **({"TEXCOORD_0": QUAD_UV} | attributes))
    glb.node("A", mesh=glb.add("meshes", {"primitives": [primitive]}))
    return glb, primitive


def loaded(folder, glb):
    """Load a file without a warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return load_mesh(glb.write(folder / "t.glb"))


def corners(piece):
    return piece.mesh.vertices[piece.mesh.faces]


@pytest.mark.parametrize("stored", [True, False])
def test_sparse_numbers_replace_those_that_are_stored_or_zero(tmp_path, stored):
    glb, primitive = sheet()
    accessor = glb.tree["accessors"][primitive["attributes"]["POSITION"]]
    moved = np.array([[7.0, 8.0, 9.0], [-1.0, 2.0, 0.5]])
    accessor["sparse"] = {
        "count": 2,
        "indices": {"bufferView": glb.view(np.array([1, 3], "<u2").tobytes()), "componentType": 5123},
        "values": {"bufferView": glb.view(moved.astype("<f4").tobytes())},
    }
    if not stored:
        del accessor["bufferView"]
    truth = QUAD.copy() if stored else np.zeros((4, 3))
    truth[[1, 3]] = moved
    (piece,) = loaded(tmp_path, glb)
    np.testing.assert_array_equal(corners(piece), 1e3 * truth[SPLIT])


@pytest.mark.parametrize(("component", "dtype", "most"), [(5121, "<u1", 255), (5123, "<u2", 65535)])
def test_places_in_a_picture_may_be_whole_numbers(tmp_path, component, dtype, most):
    glb, primitive = sheet()
    accessor = glb.tree["accessors"][primitive["attributes"]["TEXCOORD_0"]]
    rows = np.zeros((4, 4), dtype)
    rows[:, :2] = np.round(0.4 * most * QUAD_UV)
    accessor |= {"bufferView": glb.view(rows.tobytes()), "componentType": component, "normalized": True}
    glb.tree["bufferViews"][accessor["bufferView"]]["byteStride"] = rows.itemsize * 4
    (piece,) = loaded(tmp_path, glb)
    np.testing.assert_allclose(piece.uv, ([0.0, 1.0] + 0.4 * QUAD_UV * [1.0, -1.0])[SPLIT], atol=0.6 / most)


def test_quantised_positions_are_the_numbers_that_their_node_scales(tmp_path):
    glb, primitive = sheet()
    glb.tree["extensionsRequired"] = ["KHR_mesh_quantization"]
    accessor = glb.tree["accessors"][primitive["attributes"]["POSITION"]]
    rows = np.zeros((4, 4), "<i2")
    rows[:, :3] = 20 * QUAD
    accessor |= {"bufferView": glb.view(rows.tobytes()), "componentType": 5122}
    glb.tree["bufferViews"][accessor["bufferView"]]["byteStride"] = 8
    glb.tree["nodes"][0]["scale"] = [0.05] * 3
    (piece,) = loaded(tmp_path, glb)
    np.testing.assert_allclose(corners(piece), 1e3 * QUAD[SPLIT])


MODES = {
    # glTF 2.0, section 3.7.2.1: the corners of each facet, in order.
    4: [(0, 1, 2), (3, 4, 5)],
    5: [(0, 1, 2), (1, 3, 2), (2, 3, 4), (3, 5, 4)],
    6: [(1, 2, 0), (2, 3, 0), (3, 4, 0), (4, 5, 0)],
}


def test_lists_strips_and_fans_are_all_there_beside_one_another(tmp_path):
    glb = Glb()
    points = np.random.default_rng(0).normal(size=(6, 3)).astype("f4")
    primitives = [glb.primitive(points, range(6)) | {"mode": mode} for mode in MODES]
    for primitive in primitives[1:]:
        del primitive["indices"]
    glb.node("A", mesh=glb.add("meshes", {"primitives": primitives}))
    pieces = loaded(tmp_path, glb)
    assert len(pieces) == len(MODES)
    for piece, facets in zip(pieces, MODES.values(), strict=True):
        np.testing.assert_allclose(corners(piece), 1e3 * points[np.array(facets)], rtol=1e-6)


@pytest.mark.parametrize("value", [0.002, 0.01, 0.05, 1.00000024])
def test_factors_are_the_numbers_of_the_file(tmp_path, value):
    pbr = {"baseColorFactor": [value, 0.5, 0.25, 1.0], "metallicFactor": 0.0, "roughnessFactor": value}
    (piece,) = loaded(tmp_path, sheet({"pbrMetallicRoughness": pbr})[0])
    np.testing.assert_array_equal(piece.factor, (min(value, 1.0), 0.5, 0.25))
    assert piece.material.roughness == min(value, 1.0)


OTHER = {"KHR_materials_pbrSpecularGlossiness": {"diffuseFactor": [0.3, 0.2, 0.1, 1.0], "glossinessFactor": 0.75}}


def test_specular_glossiness_beside_a_surface_is_left_out(tmp_path):
    material = {"pbrMetallicRoughness": {"metallicFactor": 0.0, "baseColorFactor": [0.5] * 4}, "extensions": OTHER}
    path = sheet(material)[0].write(tmp_path / "t.glb")
    with pytest.warns(LensFileWarning, match="KHR_materials_pbrSpecularGlossiness is left out"):
        (piece,) = load_mesh(path)
    assert (piece.factor.tolist(), piece.material.metallic, piece.material.roughness) == ([0.5] * 3, 0.0, 1.0)


def test_specular_glossiness_alone_is_the_surface(tmp_path):
    path = sheet({"extensions": OTHER})[0].write(tmp_path / "t.glb")
    with pytest.warns(
        LensFileWarning, match="PbrSpecularGlossiness is read without|SpecularGlossiness is read without"
    ):
        (piece,) = load_mesh(path)
    assert (piece.factor.tolist(), piece.material.metallic, piece.material.roughness) == ([0.3, 0.2, 0.1], 0.0, 0.25)


@pytest.mark.parametrize("name", ["my%20chart.png", "my chart.png", "%C3%A4.png"])
def test_names_of_pictures_may_be_percent_encoded(tmp_path, name):
    glb, _ = sheet()
    glb.tree["images"][0] = {"uri": name}
    (tmp_path / ("ä.png" if "%C3" in name else "my chart.png")).write_bytes(picture())
    (piece,) = loaded(tmp_path, glb)
    assert piece.picture is not None


def test_a_missing_picture_is_told_and_a_buffer_of_an_extension_refused(tmp_path):
    glb, primitive = sheet()
    glb.tree["images"][0] = {"uri": "gone.png"}
    with pytest.warns(LensFileWarning, match=r"its picture gone\.png is missing: its facets have their plain colour"):
        (piece,) = load_mesh(glb.write(tmp_path / "t.glb"))
    assert piece.picture is None
    glb, primitive = sheet()
    primitive["extensions"] = {"KHR_draco_mesh_compression": {}}
    del glb.tree["accessors"][primitive["attributes"]["POSITION"]]["bufferView"]
    with pytest.raises(MeshError, match="is stored by KHR_draco_mesh_compression, which is not read"):
        load_mesh(glb.write(tmp_path / "t.glb"))


def test_vertex_colours_are_read_and_told_where_a_picture_has_their_place(tmp_path):
    shades = np.random.default_rng(1).random((4, 3))
    glb, primitive = sheet({"pbrMetallicRoughness": {"metallicFactor": 0.0}})
    primitive["attributes"]["COLOR_0"] = glb.table(shades, "VEC3")
    (piece,) = loaded(tmp_path, glb)
    np.testing.assert_allclose(piece.colours, shades[SPLIT], rtol=1e-6)
    glb, primitive = sheet()
    primitive["attributes"]["COLOR_0"] = glb.table(shades, "VEC3")
    with pytest.warns(LensFileWarning, match="the vertex colours of 2 facets with a picture are left out"):
        (piece,) = load_mesh(glb.write(tmp_path / "t.glb"))
    assert piece.colours is None


def test_what_a_file_has_and_the_scene_has_not_is_told_in_python(tmp_path):
    glb, primitive = sheet()
    glb.tree["materials"][0]["normalTexture"] = {"index": 0}
    glb.tree["meshes"][0]["primitives"].append(primitive | {"mode": 1})
    path = glb.write(tmp_path / "t.glb")
    with (
        pytest.warns(LensFileWarning, match=r"nodes\[0\] \(A\): materials\[0\]: its normal map is left out"),
        pytest.warns(LensFileWarning, match="primitive 1 is lines and has no facets"),
    ):
        load_mesh(path)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda tree: tree["bufferViews"][0].update(byteLength=10**6), "cut short: bufferViews"),
        (lambda tree: tree["accessors"][0].update(count=9), "more than its view of 48 bytes holds"),
        (lambda tree: tree["bufferViews"][0].update(byteStride=3), "a stride of 3 bytes; valid are 12 to 252"),
        (lambda tree: tree["accessors"][0].update(type="MAT4"), "type is 'MAT4'; valid are VEC3"),
        (
            lambda tree: tree["accessors"].__setitem__(0, {"componentType": 5126, "count": 10**8, "type": "VEC3"}),
            "not stored",
        ),
        (lambda tree: tree["accessors"][2].update(componentType=5126), "unsigned whole numbers|more than its view"),
    ],
)
def test_numbers_that_the_file_does_not_hold_are_refused_in_one_line(tmp_path, spoil, message):
    glb, _ = sheet({"pbrMetallicRoughness": {}})
    spoil(glb.tree)
    with pytest.raises(MeshError, match=message) as raised:
        load_mesh(glb.write(tmp_path / "t.glb"))
    assert "\n" not in str(raised.value)
    json.dumps(glb.tree)
