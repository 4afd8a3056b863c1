"""Mesh files: lengths in mm, transforms applied, colours as the formats say, every broken file named."""

import base64
import io
import json
import os

import numpy as np
import PIL.Image
import pytest
import trimesh

from lfmesh.errors import LensFileWarning, MeshError
from lfmesh.geometry.files.mesh_file import ENDINGS, MM_PER_UNIT, load_mesh
from lfmesh.geometry.meshes.mesh import joined
from lfmesh.geometry.objects.texture import srgb_to_linear

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"


def box(size=(1.0, 2.0, 3.0)):
    return trimesh.creation.box(extents=size)


def saved(path, mesh):
    mesh.export(path)
    return path


def save_gltf(path, *, matrix=None, scale=None, factor=None, picture=None, uv=((0, 0), (1, 0), (0, 1))):
    """Write one triangle (0,0,0) (1,0,0) (0,1,0) straight from the glTF 2.0 specification."""
    blobs = [
        np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes(),
        np.array(uv, "<f4").tobytes(),
        np.array([0, 1, 2], "<u4").tobytes(),
    ]
    starts = np.cumsum([0, *map(len, blobs)])
    buffer = base64.b64encode(b"".join(blobs)).decode()
    node = {"mesh": 0}
    if matrix is not None:
        node["matrix"] = np.asarray(matrix, float).T.ravel().tolist()
    if scale is not None:
        node["scale"] = list(scale)
    material = {}
    if factor is not None:
        material["baseColorFactor"] = [*factor, 1.0]
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"children": [1], "translation": [0, 0, 7]}, node],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0}]}],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": 5126,
                "count": 3,
                "type": "VEC3",
                "min": [0, 0, 0],
                "max": [1, 1, 0],
            },
            {"bufferView": 1, "componentType": 5126, "count": 3, "type": "VEC2"},
            {"bufferView": 2, "componentType": 5125, "count": 3, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": int(s), "byteLength": len(b)} for s, b in zip(starts, blobs, strict=False)
        ],
        "buffers": [{"byteLength": int(starts[-1]), "uri": f"data:application/octet-stream;base64,{buffer}"}],
        "materials": [{"pbrMetallicRoughness": material}],
    }
    if picture is not None:
        with io.BytesIO() as file:
            PIL.Image.fromarray(picture).save(file, format="PNG")
            coded = base64.b64encode(file.getvalue()).decode()
        document["images"] = [{"uri": f"data:image/png;base64,{coded}"}]
        document["textures"] = [{"source": 0}]
        material["baseColorTexture"] = {"index": 0}
    path.write_text(json.dumps(document))
    return path


def extents(pieces):
    return np.ptp(joined(piece.mesh for piece in pieces).vertices, axis=0)


@pytest.mark.parametrize("ending", ["stl", "obj", "ply", "off"])
@pytest.mark.parametrize("units", MM_PER_UNIT)
def test_lengths_are_in_the_units_given(tmp_path, ending, units):
    pieces = load_mesh(saved(tmp_path / f"box.{ending}", box()), units)
    mm = {"um": 0.001, "mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4, "foot": 304.8}[units]
    np.testing.assert_allclose(extents(pieces), np.multiply((1, 2, 3), mm), rtol=1e-15)
    assert sum(len(piece.mesh.faces) for piece in pieces) == 12


@pytest.mark.parametrize("ending", ["glb", "gltf"])
def test_gltf_is_in_metres(tmp_path, ending):
    scene = trimesh.Scene([box()])
    if ending == "gltf":
        for name, data in scene.export(file_type="gltf").items():
            (tmp_path / name).write_bytes(data)
        path = tmp_path / "model.gltf"
    else:
        path = saved(tmp_path / "box.glb", scene)
    np.testing.assert_allclose(extents(load_mesh(path)), (1000, 2000, 3000))
    np.testing.assert_allclose(extents(load_mesh(path, "m")), (1000, 2000, 3000))
    with pytest.raises(MeshError, match="'mm' contradicts the file, which is in m"):
        load_mesh(path, "mm")


def test_formats_without_a_unit_ask_for_one(tmp_path):
    with pytest.raises(MeshError, match=r"box\.stl: the format carries no unit; give units, one of um, mm, cm"):
        load_mesh(saved(tmp_path / "box.stl", box()))
    with pytest.raises(MeshError, match=r"units = 'furlong' is not known; valid are um, mm"):
        load_mesh(tmp_path / "box.stl", "furlong")


def test_text_keeps_every_digit_of_float64(tmp_path):
    x = 0.1 + 2.0**-50
    (tmp_path / "t.obj").write_text(f"v {x!r} 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (piece,) = load_mesh(tmp_path / "t.obj", "mm")
    assert x in piece.mesh.vertices[:, 0]


def test_obj_may_count_backwards_and_hold_polygons(tmp_path):
    (tmp_path / "t.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf -4 -3 -2 -1\n")
    (piece,) = load_mesh(tmp_path / "t.obj", "mm")
    corner = piece.mesh.vertices[piece.mesh.faces]
    area = 0.5 * np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]).sum(axis=0)
    np.testing.assert_allclose(area, (0, 0, 1))


def test_obj_without_its_material_file_has_the_material_of_the_scene_and_says_so(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    (tmp_path / "bare.obj").write_text(text)
    (tmp_path / "t.obj").write_text(f"mtllib t.mtl\nusemtl red\n{text}")
    (bare,) = load_mesh(tmp_path / "bare.obj", "mm")
    with pytest.warns(
        LensFileWarning, match=r"its material file t\.mtl is missing: its facets have the scene's material"
    ):
        (piece,) = load_mesh(tmp_path / "t.obj", "mm")
    np.testing.assert_array_equal(piece.mesh.vertices, bare.mesh.vertices)
    np.testing.assert_array_equal(piece.factor, bare.factor)
    assert (piece.material, piece.picture) == (bare.material, bare.picture)


@pytest.mark.parametrize("materials", ["", "newmtl blue\nKd 0 0 1\n"])
def test_obj_with_an_undefined_material_has_the_material_of_the_scene_and_says_so(tmp_path, materials):
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    (tmp_path / "bare.obj").write_text(text)
    (tmp_path / "t.mtl").write_text(materials)
    (tmp_path / "t.obj").write_text(f"mtllib t.mtl\nusemtl red\n{text}")
    (bare,) = load_mesh(tmp_path / "bare.obj", "mm")
    with pytest.warns(LensFileWarning, match="its material red is not defined: its facets have the scene's material"):
        (piece,) = load_mesh(tmp_path / "t.obj", "mm")
    np.testing.assert_array_equal(piece.factor, bare.factor)
    assert (piece.material, piece.picture) == (bare.material, bare.picture)


def test_node_transforms_are_applied_down_the_tree(tmp_path):
    quarter_turn = [[0, -1, 0, 3], [1, 0, 0, 4], [0, 0, 1, 5], [0, 0, 0, 1]]
    (piece,) = load_mesh(save_gltf(tmp_path / "t.gltf", matrix=quarter_turn))
    truth = np.array([[3, 4, 12], [3, 5, 12], [2, 4, 12]]) * 1000.0
    np.testing.assert_allclose(piece.mesh.vertices[piece.mesh.faces[0]], truth)


def test_a_mirroring_transform_keeps_the_outside_out(tmp_path):
    (piece,) = load_mesh(save_gltf(tmp_path / "t.gltf", scale=(-1, 1, 1)))
    a, b, c = piece.mesh.vertices[piece.mesh.faces[0]]
    # glTF 2.0, section 3.7.4: a negative determinant turns the winding, so +z stays the front.
    assert np.cross(b - a, c - a)[2] > 0
    place = {tuple(np.round(v / 1000)): tuple(t) for v, t in zip((a, b, c), piece.uv[0], strict=True)}
    assert place[-1, 0, 7] == (1, 1)  # carried along with its corner


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_file_without_normals_gets_none(tmp_path, ending):
    plain = trimesh.Trimesh(box().vertices, box().faces, process=False)
    path = save_gltf(tmp_path / "t.gltf") if ending == ".gltf" else saved(tmp_path / f"box{ending}", plain)
    pieces = load_mesh(path, None if ending in (".glb", ".gltf") else "mm")
    assert all(piece.mesh.corner_normals is None for piece in pieces)


@pytest.mark.parametrize("scale", [(1, 1, 1), (1, 2, 3), (-1, 1, 1), (-1, 2, -3)])
def test_normals_stay_square_to_the_surface_under_a_nodes_transform(tmp_path, scale):
    ball = trimesh.creation.icosphere(2)
    ball.vertex_normals = ball.vertices.copy()
    turn = trimesh.transformations.euler_matrix(0.3, -0.7, 1.1)
    scene = trimesh.Scene()
    scene.add_geometry(ball, transform=turn @ np.diag([*scale, 1.0]))
    (piece,) = load_mesh(saved(tmp_path / "ball.glb", scene))
    corner, normals = piece.mesh.vertices[piece.mesh.faces], piece.mesh.corner_normals
    # Of the ellipsoid |S⁻¹ Rᵀ x| = 1, m to mm: the gradient, outwards.
    gradient = corner @ turn[:3, :3] / np.square(scale) @ turn[:3, :3].T
    gradient /= np.linalg.norm(gradient, axis=2, keepdims=True)
    length = np.linalg.norm(normals, axis=2, keepdims=True)
    np.testing.assert_allclose(normals / length, gradient, rtol=0, atol=1e-6)
    facets = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    assert (np.einsum("mi,mki->mk", facets, normals) > 0.0).all()


def test_every_instance_of_a_geometry_is_there(tmp_path):
    scene = trimesh.Scene()
    part = box()
    scene.add_geometry(part, geom_name="part", node_name="a")
    scene.graph.update("b", geometry="part", matrix=trimesh.transformations.translation_matrix([9, 0, 0]))
    pieces = load_mesh(saved(tmp_path / "two.glb", scene))
    np.testing.assert_allclose(extents(pieces), (10_000, 2000, 3000))
    assert len(pieces) == 2


def test_gltf_places_its_pictures_top_left_at_uv_zero(tmp_path):
    picture = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]], np.uint8)
    (piece,) = load_mesh(save_gltf(tmp_path / "t.gltf", picture=picture))
    # In glTF the corner with (0, 0) is the picture's top left; here that is (0, 1).
    np.testing.assert_array_equal(piece.uv[0], [(0, 1), (1, 1), (0, 0)])
    np.testing.assert_array_equal(piece.picture, picture / 255.0)
    np.testing.assert_array_equal(piece.factor, 1.0)


def test_gltf_pictures_are_srgb_and_factors_linear(tmp_path):
    picture = np.full((2, 2, 3), 128, np.uint8)
    (piece,) = load_mesh(save_gltf(tmp_path / "t.gltf", picture=picture, factor=(0.6, 0.4, 0.2)))
    np.testing.assert_allclose(piece.picture, srgb_to_linear(np.array(128 / 255)), rtol=1e-6)
    np.testing.assert_allclose(piece.factor, (0.6, 0.4, 0.2), atol=0.5 / 255)


def test_mtl_pictures_and_colours(tmp_path):
    PIL.Image.fromarray(np.full((2, 2, 3), 128, np.uint8)).save(tmp_path / "chart.png")
    (tmp_path / "m.mtl").write_text("newmtl a\nmap_Kd chart.png\n\nnewmtl b\nKd 0.5 0.25 0.1\n")
    (tmp_path / "t.obj").write_text(f"mtllib m.mtl\n{TRIANGLE}usemtl a\nf 1/1 2/2 3/3\nusemtl b\nf 3/3 2/2 1/1\n")
    pieces = load_mesh(tmp_path / "t.obj", "mm")
    charted = next(piece for piece in pieces if piece.picture is not None)
    plain = next(piece for piece in pieces if piece.picture is None)
    # No Kd in the MTL is no colour, not trimesh's 0.4.
    np.testing.assert_array_equal(charted.factor, 1.0)
    np.testing.assert_allclose(charted.picture, srgb_to_linear(np.array(128 / 255)), rtol=1e-6)
    np.testing.assert_array_equal(plain.factor, (0.5, 0.25, 0.1))
    corners = {
        tuple(v): tuple(t) for v, t in zip(charted.mesh.vertices[charted.mesh.faces[0]], charted.uv[0], strict=True)
    }
    assert corners == {(0, 0, 0): (0, 0), (1, 0, 0): (1, 0), (0, 1, 0): (0, 1)}


POSTSCRIPT = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 10 10\n%%EndComments\nshowpage\n%%EOF\n"


def gltf_of_three_corners(folder):
    """Return a glTF and a GLB file whose one facet names a vertex that is not there."""
    document = json.loads(save_gltf(folder / "index.gltf").read_text())
    uri = document["buffers"][0]["uri"]
    blob = bytearray(base64.b64decode(uri.split(",")[1]))
    at = blob.rindex(np.array([0, 1, 2], "<u4").tobytes())
    blob[at : at + 12] = np.array([0, 1, 9], "<u4").tobytes()
    document["buffers"][0]["uri"] = uri.split(",")[0] + "," + base64.b64encode(blob).decode()
    text = json.dumps(document)
    del document["buffers"][0]["uri"]
    chunk = json.dumps(document).encode()
    chunk += b" " * (-len(chunk) % 4)
    blob += b"\0" * (-len(blob) % 4)
    words = lambda *numbers: np.array(numbers, "<u4").tobytes()  # noqa: E731
    glb = words(0x46546C67, 2, 28 + len(chunk) + len(blob), len(chunk), 0x4E4F534A) + chunk
    return {"gltf": text.encode(), "glb": glb + words(len(blob), 0x004E4942) + bytes(blob)}


def broken_files(folder):
    """Yield files that are not usable, with a word of the reason each must be given."""
    body = box()

    def write(name, content):
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
        return folder / name

    for ending in ENDINGS:
        yield write(f"empty{ending}", b""), "no facets|broken"
        yield write(f"garbage{ending}", bytes(range(256)) * 8), "no facets|broken"
        yield write(f"words{ending}", "this is no mesh at all\n" * 20), "no facets|broken"
    for ending in ("stl", "ply", "off", "glb"):
        whole = body.export(file_type=ending)
        whole = whole if isinstance(whole, bytes) else whole.encode()
        yield write(f"short.{ending}", whole[: int(0.8 * len(whole))]), "no facets|broken|cut short"
    yield write("solid.stl", "solid nothing\nendsolid nothing\n"), "no facets"
    for number in (9, -4, 0):
        said = f"line 8: a facet names vertex {number}, but there are 3, counted from 1"
        yield write(f"vertex{number}.obj", TRIANGLE + f"f 1 2 3\nf 1 {number} 2\n"), said
    yield write("points.obj", TRIANGLE), "no facets"
    yield write("nan.obj", "v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"), "1 of 1 facets"
    yield write("inf.off", "OFF\n3 1 0\n0 0 0\ninf 0 0\n0 1 0\n3 0 1 2\n"), "1 of 1 facets"
    for header in ("8 x", "8"):
        yield write(f"{header}.off", f"OFF\n{header}\n-0.5 0 0\n1 0 0\n"), "its header counts no facets|broken"
    yield write("points.ply", trimesh.PointCloud(np.eye(3)).export(file_type="ply")), "no facets"
    corners = "0 0 0\n1 0 0\n0 1 0\n"
    header = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    for index in (-1, 3, 7):
        facets = f"element face 1\nproperty list uchar int vertex_indices\nend_header\n{corners}3 0 1 {index}\n"
        yield write(f"index{index}.ply", header + facets), f"names vertex {index}, but there are 3|broken"
    write("secret.txt", "newmtl a\n")
    (folder / "inner").mkdir()
    for name in ("../secret.txt", str(folder / "secret.txt")):
        yield write("inner/outside.obj", f"mtllib {name}\n" + TRIANGLE + "f 1 2 3\n"), "outside the mesh's folder"
    write("outside.mtl", "newmtl a\nmap_Kd ../secret.txt\n")
    yield write("picture.obj", "mtllib outside.mtl\n" + TRIANGLE + "f 1 2 3\n"), "outside the mesh's folder"
    yield write("far.obj", TRIANGLE.replace("1 0 0", "1e200 0 0") + "f 1 2 3\n"), "farther than"
    for ending, whole in gltf_of_three_corners(folder).items():
        yield write(f"index.{ending}", whole), "names vertex 9, but there are 3|broken"
    document = json.loads(save_gltf(folder / "document.gltf").read_text())
    document["buffers"][0]["uri"] = "gone.bin"
    yield write("buffer.gltf", json.dumps(document)), "its buffer gone.bin is missing"
    if hasattr(os, "mkfifo"):
        os.mkfifo(folder / "pipe.bin")
        document["buffers"][0]["uri"] = "pipe.bin"
        yield write("pipe.gltf", json.dumps(document)), "is not a regular file"
        os.mkfifo(folder / "pipe.stl")
        yield folder / "pipe.stl", "is not a regular file"
    document = json.loads(save_gltf(folder / "document.gltf").read_text())
    document["accessors"][0]["count"] = 10**15
    yield write("count.gltf", json.dumps(document)), "an accessor counts 1000000000000000 entries"
    yield write("one.glb", b"glTF\1\0\0\0" + bytes(20)), "is GLB of version 1; valid is 2"
    yield write("nested.gltf", "[" * 100_000), "broken"
    postscript = "data:image/png;base64," + base64.b64encode(POSTSCRIPT).decode()
    document = json.loads(save_gltf(folder / "document.gltf", picture=np.zeros((1, 1, 3), np.uint8)).read_text())
    document["images"][0]["uri"] = postscript
    yield write("postscript.gltf", json.dumps(document)), "its picture is of an unsupported kind"
    yield folder / "missing.stl", "does not exist"
    (folder / "folder.stl").mkdir()
    yield folder / "folder.stl", "is a folder"
    yield write("part.igs", "S      1"), r"valid are \.stl, \.obj"
    yield write("part", "x"), r"valid are \.stl, \.obj"


def test_every_broken_file_gets_one_line_that_names_it(tmp_path):
    for path, reason in broken_files(tmp_path):
        units = None if path.suffix in (".glb", ".gltf") else "mm"
        with pytest.raises(MeshError, match=reason) as raised:
            load_mesh(path, units)
        message = str(raised.value)
        assert path.stem in message
        assert "\n" not in message
        assert len(message) < 300 + len(str(path))


@pytest.mark.parametrize(
    ("material", "message"),
    [
        (
            {"pbrMetallicRoughness": {"metallicFactor": 1.5}},
            r"materials\[0\]\.metallicFactor is 1\.5; valid are numbers",
        ),
        ({"pbrMetallicRoughness": {"roughnessFactor": "rough"}}, r"roughnessFactor is 'rough'; valid are numbers"),
        ({"pbrMetallicRoughness": {"roughnessFactor": float("nan")}}, "roughnessFactor is nan; valid are numbers"),
        ({"pbrMetallicRoughness": {"baseColorFactor": [1.0, -0.5, 0, 1]}}, "valid are four numbers from 0 to 1"),
        ({"pbrMetallicRoughness": [1]}, r"pbrMetallicRoughness is \[1\]; valid is an object"),
        ({"alphaMode": "GLASS"}, "alphaMode is 'GLASS'; valid are OPAQUE, MASK, BLEND"),
        ({"alphaMode": "MASK", "alphaCutoff": -1}, "alphaCutoff is -1; valid are numbers from 0"),
    ],
)
def test_values_that_gltf_does_not_allow_are_refused(tmp_path, material, message):
    path = save_gltf(tmp_path / "t.gltf")
    path.write_text(json.dumps(json.loads(path.read_text()) | {"materials": [material]}))
    with pytest.raises(MeshError, match=message) as raised:
        load_mesh(path)
    assert "\n" not in str(raised.value)
