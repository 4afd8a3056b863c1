"""Targets: shapes of the right size and side, pictures that read correctly on them, files placed in the world."""

import json

import numpy as np
import PIL.Image
import pytest
import trimesh

import lfmesh as lf
from lfmesh.errors import FileError, MeshError
from lfmesh.geometry.frame import frame, points
from lfmesh.geometry.meshes.mesh import facet_normals
from lfmesh.geometry.objects.primitives import primitive
from lfmesh.geometry.objects.targets import target_mesh
from lfmesh.geometry.objects.texture import srgb_to_linear
from lfmesh.optics.gltf_material import RATIO, GltfMaterial
from lfmesh.scene import Box, Cylinder, Disk, Plane, Sphere, Target

SHAPES = {
    "plane": Plane(width_mm=4.0, height_mm=3.0),
    "disk": Disk(radius_mm=2.0),
    "sphere": Sphere(radius_mm=2.0),
    "box": Box(size_mm=(1.0, 2.0, 3.0)),
    "cylinder": Cylinder(radius_mm=2.0, height_mm=5.0),
}
VOLUMES = {"sphere": 32 * np.pi / 3, "box": 6.0, "cylinder": 20 * np.pi}
AREAS = {"plane": 12.0, "disk": 4 * np.pi, "sphere": 16 * np.pi, "box": 22.0, "cylinder": 28 * np.pi}
PICTURE = np.random.default_rng(31).integers(0, 256, size=(6, 8, 3)).astype(np.uint8)


class Folder:
    """All that a target asks of its scene: where relative paths start, and its own number there."""

    targets = ()

    def __init__(self, path):
        self.path = path
        PIL.Image.fromarray(PICTURE).save(path / "chart.png")

    def resolve(self, path):
        return self.path / path

    def mesh(self, **values):
        return target_mesh(Target(**values), self)


@pytest.fixture
def folder(tmp_path):
    return Folder(tmp_path)


def colours(target, share=(0.25, 0.35, 0.4)):
    """A point in every facet and the texel that lies there."""
    place = np.einsum("k,fkj->fj", share, target.uv)
    height, width = target.texture.shape[:2]
    column = np.minimum((place[:, 0] * width).astype(int), width - 1)
    row = np.minimum(((1.0 - place[:, 1]) * height).astype(int), height - 1)
    where = np.einsum("k,fkj->fj", share, target.mesh.vertices[target.mesh.faces])
    return where, target.texture[row, column]


def in_picture(column, row):
    """The linear picture at fractions 0..1 of its width and height, from the top left."""
    height, width = PICTURE.shape[:2]
    return srgb_to_linear(PICTURE / 255.0)[
        (np.asarray(row) * height).astype(int), (np.asarray(column) * width).astype(int)
    ]


@pytest.mark.parametrize("kind", SHAPES)
def test_shapes_have_their_area_and_enclose_their_volume_outside_out(folder, kind):
    target = folder.mesh(shape=SHAPES[kind])
    assert target.texture is None
    normals, area = facet_normals(target.mesh)
    assert (area > 0).all()
    assert area.sum() == pytest.approx(AREAS[kind], rel=2e-3)
    assert target.closed == (kind in VOLUMES)
    if target.closed:
        solid = trimesh.Trimesh(target.mesh.vertices, target.mesh.faces, process=False)
        assert solid.is_volume
        assert solid.volume == pytest.approx(VOLUMES[kind], rel=2e-3)
        centroids = target.mesh.vertices[target.mesh.faces].mean(axis=1)
        assert (np.einsum("ij,ij->i", normals, centroids) > 0).all()
    else:
        np.testing.assert_array_equal(normals, np.broadcast_to([0, 0, 1], normals.shape))


def test_round_shapes_are_round_to_a_thousandth():
    sphere = primitive(SHAPES["sphere"]).mesh
    plane_distance = np.einsum("ij,ij->i", facet_normals(sphere)[0], sphere.vertices[sphere.faces[:, 0]])
    np.testing.assert_allclose(np.linalg.norm(sphere.vertices, axis=1), 2.0, rtol=1e-15)
    assert plane_distance.min() > 2.0 * (1 - 1e-3)
    disk = primitive(SHAPES["disk"]).mesh
    rim = disk.vertices[np.linalg.norm(disk.vertices, axis=1) > 2.0 * (1 - 1e-9)]
    assert np.cos(np.pi / len(rim)) > 1 - 1e-3


@pytest.mark.parametrize("kind", SHAPES)
def test_shapes_stand_where_position_and_rotation_put_them(folder, kind):
    placed = folder.mesh(shape=SHAPES[kind], position_mm=(10, 20, -500), rotation_deg=(20, -30, 40))
    truth = points(frame((20, -30, 40), (10, 20, -500)), primitive(SHAPES[kind]).mesh.vertices)
    np.testing.assert_allclose(np.sort(placed.mesh.vertices, axis=0), np.sort(truth, axis=0), rtol=0, atol=1e-12)


@pytest.mark.parametrize("kind", SHAPES)
def test_pictures_have_their_right_at_x_and_their_top_at_y_on_the_side_that_faces_the_camera(folder, kind):
    """As somebody behind the camera sees it, who looks along -z and has x to the right and y up."""
    target = folder.mesh(shape=SHAPES[kind], material={"texture": "chart.png"})
    where, seen = colours(target)
    width, height = {"plane": (4, 3), "disk": (4, 4), "sphere": (4, 4), "box": (1, 2), "cylinder": (4, 4)}[kind]
    front = facet_normals(target.mesh)[0][:, 2] > (0.0 if kind == "sphere" else 0.99)
    x, y = where[front, 0] / width, where[front, 1] / height
    if kind == "sphere":
        x, y = (
            np.arctan2(where[front, 0], where[front, 2]) / (2 * np.pi),
            np.arctan2(where[front, 1], np.hypot(where[front, 0], where[front, 2])) / np.pi,
        )
    away = (np.abs((0.5 + x) * 8 % 1 - 0.5) < 0.45) & (np.abs((0.5 + y) * 6 % 1 - 0.5) < 0.45)
    if kind == "sphere":  # facets at the poles share one point of many columns
        away &= np.abs(y) < 0.48
    assert away.any()
    np.testing.assert_array_equal(seen[front][away], in_picture(0.5 + x, 0.5 - y)[away])


def test_the_wall_of_a_cylinder_that_is_rotated_by_90_degrees_about_x_faces_the_camera_upright(folder):
    target = folder.mesh(shape=SHAPES["cylinder"], rotation_deg=(90, 0, 0), material={"texture": "chart.png"})
    where, seen = colours(target)
    front = (np.abs(facet_normals(target.mesh)[0][:, 1]) < 0.01) & (where[:, 2] > 0.0)
    x, y = np.arctan2(where[front, 0], where[front, 2]) / (2 * np.pi), where[front, 1] / 5.0
    away = np.abs((0.5 + x) * 8 % 1 - 0.5) < 0.45
    assert away.sum() > 50
    np.testing.assert_array_equal(seen[front][away], in_picture(0.5 + x, 0.5 - y)[away])


def directions_of(kind):
    """Where a picture's right and top point on every facet (m, 3), not normalised, from its corners' places in it."""
    mesh, uv = primitive(SHAPES[kind])
    corners = mesh.vertices[mesh.faces]
    # Corner k is origin + u_k right + v_k up.
    edges, steps = corners[:, 1:] - corners[:, :1], uv[:, 1:] - uv[:, :1]
    right, up = np.moveaxis(np.linalg.solve(steps, edges), 1, 0)
    return right, up, facet_normals(mesh)[0]


@pytest.mark.parametrize("kind", SHAPES)
def test_pictures_read_correctly_from_outside_on_every_side(kind):
    right, up, normal = directions_of(kind)
    across = np.cross(right, up)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    np.testing.assert_allclose(across, normal, atol=1e-9)
    uv = primitive(SHAPES[kind]).uv
    assert uv.min() == pytest.approx(0.0, abs=1e-12)
    assert uv.max() == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("kind", SHAPES)
def test_the_top_of_pictures_lies_towards_y_and_on_faces_along_y_towards_minus_z(kind):
    _, up, normal = directions_of(kind)
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    if kind == "sphere":
        # Along the meridians: as far towards +y as the surface allows, but for the facets' tilt.
        meridian = [0.0, 1.0, 0.0] - normal[:, 1:2] * normal
        assert (np.einsum("ij,ij->i", up, meridian) > 0.0).all()
        return
    wall = np.zeros(len(up), bool) if kind != "cylinder" else np.abs(normal[:, 2]) < 0.5
    top = np.where(np.abs(normal[:, 1:2]) > 0.99, [0.0, 0.0, -1.0] * np.sign(normal[:, 1:2]), [0.0, 1.0, 0.0])
    top[wall] = [0.0, 0.0, -1.0]
    np.testing.assert_allclose(up, top, atol=1e-9)


def test_every_face_of_a_box_carries_the_whole_picture():
    uv = primitive(SHAPES["box"]).uv
    a, b = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    assert len(uv) == 12
    assert (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() / 2 == pytest.approx(6.0)


def test_a_closed_file_is_closed_and_an_open_one_is_not(folder):
    box = trimesh.creation.box(extents=(1, 2, 3))
    box.export(folder.path / "closed.stl")
    open_box = box.copy()
    open_box.update_faces(np.arange(12) > 0)
    open_box.export(folder.path / "open.stl")
    assert folder.mesh(file="closed.stl", units="mm").closed
    assert not folder.mesh(file="open.stl", units="mm").closed


def test_a_closed_file_that_is_inside_out_is_turned(folder):
    box = trimesh.creation.box(extents=(1, 2, 3))
    box.invert()
    box.export(folder.path / "turned.stl")
    target = folder.mesh(file="turned.stl", units="cm", position_mm=(1e4, 0, 0))
    assert target.closed
    assert target.mesh.solid().volume == pytest.approx(6000.0, rel=1e-6)


def test_a_body_of_two_materials_is_closed_as_a_whole(folder):
    box = trimesh.creation.box()
    lines = [f"v {x} {y} {z}" for x, y, z in box.vertices.tolist()]
    for k, (a, b, c) in enumerate((box.faces + 1).tolist()):
        lines.append(f"usemtl {'red' if k < 5 else 'blue'}\nf {a} {b} {c}")
    (folder.path / "m.mtl").write_text("newmtl red\nKd 1 0 0\n\nnewmtl blue\nKd 0 0 0.5\n")
    (folder.path / "t.obj").write_text("mtllib m.mtl\n" + "\n".join(lines) + "\n")
    target = folder.mesh(file="t.obj", units="mm")
    assert target.closed
    seen = colours(target)[1]
    assert sorted(map(tuple, seen.tolist())) == [(0.0, 0.0, 0.5)] * 7 + [(1.0, 0.0, 0.0)] * 5


def test_facets_without_area_are_left_out(folder):
    (folder.path / "t.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 2 0 0\nf 1 2 3\nf 1 2 4\nf 1 1 2\n")
    assert len(folder.mesh(file="t.obj", units="mm").mesh.faces) == 1
    (folder.path / "none.obj").write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n")
    with pytest.raises(MeshError, match=r"none\.obj: none of its 1 facets has an area"):
        folder.mesh(file="none.obj", units="mm")


def obj_square(folder, corners, material=""):
    """Write a square of the given uv range, which carries the chart or what the MTL says."""
    (u0, v0), (u1, v1) = corners
    (folder.path / "m.mtl").write_text(f"newmtl a\nmap_Kd chart.png\n{material}\n")
    (folder.path / "t.obj").write_text(
        "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
        f"vt {u0} {v0}\nvt {u1} {v0}\nvt {u1} {v1}\nvt {u0} {v1}\nusemtl a\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"
    )


def test_a_body_that_is_turned_keeps_its_picture_in_place(folder):
    (folder.path / "m.mtl").write_text("newmtl a\nmap_Kd chart.png\n")
    # A tetrahedron inside out, the picture projected on it along z.
    (folder.path / "t.obj").write_text(
        "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nvt 1 0\nvt 0 1\nvt 0 0\nusemtl a\n"
        "f 1/1 2/2 3/3\nf 2/2 1/1 4/4\nf 3/3 2/2 4/4\nf 1/1 3/3 4/4\n"
    )
    target = folder.mesh(file="t.obj", units="mm")
    assert target.closed
    assert target.mesh.solid().volume == pytest.approx(1 / 6)
    where, seen = colours(target)
    inside = where[:, :2].min(axis=1) > 0.0  # elsewhere the picture is seen edge-on, at its border
    np.testing.assert_allclose(seen[inside], in_picture(where[inside, 0], 1.0 - where[inside, 1]), rtol=1e-6)


def test_a_files_own_picture_is_used_and_its_factor_multiplies_it(folder):
    obj_square(folder, ((0, 0), (1, 1)), "Kd 0.5 0.5 0.25")
    where, seen = colours(folder.mesh(file="t.obj", units="mm"))
    truth = in_picture(where[:, 0], 1.0 - where[:, 1]) * np.float32([0.5, 0.5, 0.25])
    np.testing.assert_allclose(seen, truth, rtol=1e-6)


def test_a_gltf_files_texture_coordinates_start_at_the_top_left_of_its_picture(folder):
    """glTF 2.0, section 3.8: "The origin of the UV coordinates (0, 0) corresponds to the upper left corner"."""
    square = np.float32([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    places = np.float32([[0, 1], [1, 1], [1, 0], [0, 0]])
    data = square.tobytes() + places.tobytes() + np.uint16([0, 1, 2, 0, 2, 3]).tobytes()
    (folder.path / "square.bin").write_bytes(data)
    whole = {"buffer": 0, "byteOffset": 0}
    gltf = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "textures": [{"source": 0}],
        "images": [{"uri": "chart.png"}],
        "buffers": [{"uri": "square.bin", "byteLength": len(data)}],
        "bufferViews": [
            {**whole, "byteLength": 48},
            {**whole, "byteOffset": 48, "byteLength": 32},
            {**whole, "byteOffset": 80, "byteLength": 12},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
            {"bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC2"},
            {"bufferView": 2, "componentType": 5123, "count": 6, "type": "SCALAR"},
        ],
    }
    (folder.path / "square.gltf").write_text(json.dumps(gltf))
    for share in np.random.default_rng(34).dirichlet((1, 1, 1), size=20):
        where, seen = colours(folder.mesh(file="square.gltf"), share)
        np.testing.assert_array_equal(seen, in_picture(where[:, 0] / 1e3, 1.0 - where[:, 1] / 1e3))


def test_the_materials_texture_replaces_the_files_colours(folder):
    obj_square(folder, ((0, 0), (1, 1)), "Kd 0.5 0.5 0.25")
    PIL.Image.fromarray(PICTURE[::-1]).save(folder.path / "other.png")
    where, seen = colours(folder.mesh(file="t.obj", units="mm", material={"texture": "other.png"}))
    np.testing.assert_allclose(seen, in_picture(where[:, 0], where[:, 1]), rtol=1e-6)


def test_repeats_are_unrolled_into_the_unit_square(folder):
    obj_square(folder, ((-1.5, 2.0), (1.5, 4.0)))
    target = folder.mesh(file="t.obj", units="mm")
    assert target.uv.min() >= 0.0
    assert target.uv.max() <= 1.0
    for share in np.random.default_rng(32).dirichlet((1, 1, 1), size=50):
        where, seen = colours(target, share)
        u, v = 3.0 * where[:, 0] - 1.5, 2.0 * where[:, 1] + 2.0
        np.testing.assert_allclose(seen, in_picture(u % 1.0, (1.0 - v) % 1.0), rtol=1e-6)


def test_a_picture_repeated_beyond_memory_is_refused(folder):
    obj_square(folder, ((0, 0), (3000, 3000)))
    with pytest.raises(MeshError, match=r"t\.obj: its pictures, .* need 24000 x 18000 texels; the limit is"):
        folder.mesh(file="t.obj", units="mm")


def test_geometries_that_share_a_picture_get_it_once(folder):
    scene = trimesh.Scene()
    image = PIL.Image.fromarray(PICTURE)
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=image)
    for k in range(3):
        part = trimesh.Trimesh([[0, 0, k], [1, 0, k], [1, 1, k]], [[0, 1, 2]], process=False)
        part.visual = trimesh.visual.TextureVisuals(uv=[[0, 0], [1, 0], [1, 1]], material=material)
        scene.add_geometry(part)
    scene.export(folder.path / "t.glb")
    assert folder.mesh(file="t.glb").texture.shape == PICTURE.shape


def test_several_pictures_share_one_sheet(folder):
    scene = trimesh.Scene()
    for k, picture in enumerate((PICTURE, PICTURE[:3, :2][::-1], None)):
        square = trimesh.Trimesh([[0, 0, k], [1, 0, k], [1, 1, k], [0, 1, k]], [[0, 1, 2], [0, 2, 3]], process=False)
        image = PIL.Image.fromarray(np.ascontiguousarray(picture)) if picture is not None else None
        factor = [255, 0, 51, 255] if picture is None else [255, 255, 255, 255]
        material = trimesh.visual.material.PBRMaterial(baseColorTexture=image, baseColorFactor=factor)
        uv = [[0, 0], [1, 0], [1, 1], [0, 1]]
        square.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
        scene.add_geometry(square)
    scene.export(folder.path / "t.glb")
    target = folder.mesh(file="t.glb", materials="colours")
    assert not target.closed
    for share in np.random.default_rng(33).dirichlet((1, 1, 1), size=20):
        where, seen = colours(target, share)
        for (x, y, z), colour in zip(where / 1000.0, seen, strict=True):
            small = srgb_to_linear(PICTURE[:3, :2][::-1] / 255.0)
            truth = [
                lambda x, y: in_picture(x, 1.0 - y),
                lambda x, y: small[int((1.0 - y) * 3), int(x * 2)],  # noqa: B023
                lambda x, y: (1.0, 0.0, 0.2),
            ][round(z)](x, y)
            np.testing.assert_allclose(colour, truth, rtol=1e-6)


def test_a_texture_needs_texture_coordinates(folder):
    trimesh.creation.box().export(folder.path / "t.stl")
    with pytest.raises(MeshError, match=r"t\.stl: the mesh has no texture coordinates"):
        folder.mesh(file="t.stl", units="mm", material={"texture": "chart.png"})


def test_a_texture_that_is_no_picture_is_an_error(folder):
    (folder.path / "words.png").write_text("no picture")
    with pytest.raises(FileError, match=r"words\.png: not a picture"):
        folder.mesh(shape=SHAPES["plane"], material={"texture": "words.png"})


def test_alpha_is_that_of_the_texture(folder):
    picture = np.random.default_rng(7).integers(0, 256, (3, 5, 4)).astype(np.uint8)
    PIL.Image.fromarray(picture).save(folder.path / "leaf.png")
    target = folder.mesh(shape=SHAPES["plane"], material={"texture": "leaf.png", "opacity": "texture_alpha"})
    np.testing.assert_allclose(target.alpha, picture[:, :, 3] / 255.0, rtol=1e-6)
    plain = folder.mesh(shape=SHAPES["plane"], material={"texture": "leaf.png"})
    assert plain.alpha is None
    np.testing.assert_array_equal(plain.texture, target.texture)


def test_alpha_of_a_mesh_file_is_its_pictures_times_its_colours(folder):
    picture = np.random.default_rng(7).integers(0, 256, (3, 5, 4)).astype(np.uint8)
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=PIL.Image.fromarray(picture), baseColorFactor=[255, 255, 255, 51], alphaMode="BLEND"
    )
    uv = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    trimesh.Trimesh(np.eye(3), [[0, 1, 2]], visual=visual, process=False).export(folder.path / "leaf.glb")
    target = folder.mesh(file="leaf.glb", material={"opacity": "texture_alpha"})
    np.testing.assert_allclose(target.alpha, picture[:, :, 3] / 255.0 * 0.2, rtol=1e-6)
    assert folder.mesh(file="leaf.glb", materials="colours").alpha is None


def test_alpha_is_asked_of_no_opaque_picture(folder):
    for values in ({"shape": SHAPES["plane"]}, {"shape": SHAPES["plane"], "material": {"texture": "chart.png"}}):
        material = values.pop("material", {}) | {"opacity": "texture_alpha"}
        with pytest.raises(MeshError, match="is opaque everywhere"):
            folder.mesh(**values, material=material)


def board(folder, name="board.glb", **values):
    """Save a GLB of two squares: a matt red one, and one of metal or as `values` say."""
    scene = trimesh.Scene()
    red = {"baseColorFactor": [255, 0, 0, 255], "metallicFactor": 0.0, "roughnessFactor": 1.0}
    for number, values_of in enumerate([red, {"metallicFactor": 1.0, "roughnessFactor": 0.3} | values]):
        square = trimesh.Trimesh([[0, 0, number], [1, 0, number], [0, 1, number]], [[0, 1, 2]], process=False)
        square.visual = trimesh.visual.TextureVisuals(
            uv=[[0, 0], [1, 0], [0, 1]], material=trimesh.visual.material.PBRMaterial(**values_of)
        )
        scene.add_geometry(square)
    scene.export(folder.path / name)
    return name


def test_materials_of_a_gltf_file_are_taken_facet_by_facet_unless_the_scene_has_its_own(folder):
    name = board(folder)
    taken = folder.mesh(file=name)
    depth = taken.mesh.vertices[taken.mesh.faces][:, 0, 2]
    by_depth = {bool(z > 500.0): taken.materials[number] for z, number in zip(depth, taken.material_of, strict=True)}
    assert by_depth == {False: GltfMaterial((1.0, 0.0, 0.0), 0.0, 1.0), True: GltfMaterial((1.0, 1.0, 1.0), 1.0, 0.3)}
    assert len(taken.materials) == 2
    assert taken.texture is None
    assert taken.alpha is None
    for values in ({"materials": "colours"}, {"material": {"reflectance": 0.5}}):
        coloured = folder.mesh(file=name, **values)
        assert coloured.materials == ()
        assert coloured.material_of is None
        assert {tuple(colour) for colour in colours(coloured)[1]} == {(1.0, 0.0, 0.0), (1.0, 1.0, 1.0)}
    ignored = folder.mesh(file=name, materials="ignore")
    assert ignored.materials == ()
    assert ignored.texture is None


@pytest.mark.parametrize(
    ("mode", "alpha", "seen"), [("OPAQUE", 51, None), ("BLEND", 51, 0.2), ("MASK", 51, 0.0), ("MASK", 204, None)]
)
def test_alpha_counts_as_the_material_says(folder, mode, alpha, seen):
    target = folder.mesh(file=board(folder, baseColorFactor=[255, 255, 255, alpha], alphaMode=mode))
    found = None if target.alpha is None else target.alpha.min()
    assert found == (seen if seen is None else pytest.approx(seen, abs=1e-6))


def test_pictures_of_metallic_and_roughness_span_the_materials_of_their_facets(folder):
    picture = np.zeros((1, 2, 3), np.uint8)
    picture[0, 0, 1], picture[0, :, 2] = 255, [51, 102]
    target = folder.mesh(file=board(folder, metallicRoughnessTexture=PIL.Image.fromarray(picture), roughnessFactor=0.8))
    assert target.gloss is not None
    assert target.material_of is not None
    (spanned,) = target.gloss.ranges
    assert spanned.metallic == pytest.approx((51 / 255, 102 / 255))
    assert {target.materials[k].base for k in target.material_of[target.gloss.range_of == 0]} == {(1.0, 1.0, 1.0)}
    # The smoothest texel has no roughness, the roughest that of the factor.
    roughnesses = [each.roughness for each in spanned.materials]
    assert min(roughnesses) == pytest.approx(0.1)
    assert 0.8 <= max(roughnesses) < 0.8 * np.exp(0.5 * RATIO)


def test_materials_that_are_not_there_are_refused(folder):
    trimesh.creation.box().export(folder.path / "box.stl")
    with pytest.raises(MeshError, match=r'box\.stl: has no glTF materials, but materials = "file" needs them'):
        folder.mesh(file="box.stl", units="mm", materials="file")
    for values, message in [
        ({"materials": "file", "material": {"reflectance": 0.1}}, "omit one of them"),
        ({"shape": SHAPES["box"], "file": None, "materials": "ignore"}, "only for a mesh file"),
        ({"shape": SHAPES["box"], "file": None, "normals": "facets"}, "only for a mesh file"),
    ]:
        with pytest.raises(ValueError, match=message):
            lf.Scene.model_validate(example({"file": "t.glb"} | values))


def example(target):
    """A scene with one target."""
    surfaces = [{"radius_mm": 50.0, "thickness_mm": 5.0, "index": 1.5, "semi_diameter_mm": 5.0}, {"radius_mm": -50.0,
                "semi_diameter_mm": 5.0}]  # fmt: skip
    sensor = {"pixels": [4, 4], "pixel_mm": 0.1}
    return {"camera": {"focus_mm": 500.0, "lens": {"surfaces": surfaces}, "sensor": sensor}, "targets": [target]}


def ball_with_normals(folder, turn=1.0):
    ball = trimesh.creation.icosphere(2, 10.0)
    ball.vertex_normals = turn * ball.vertices / 10.0
    ball.export(folder.path / "ball.ply", vertex_normal=True)
    return {"file": "ball.ply", "units": "mm"}


@pytest.mark.parametrize("turn", [1.0, -3.0])
def test_vertex_normals_of_a_file_are_kept_on_the_side_of_their_facets(folder, turn):
    """Of any length and sense; a scene may ask for those of the facets."""
    ball = ball_with_normals(folder, turn)
    target = folder.mesh(**ball)
    assert target.smooth
    radial = target.mesh.vertices[target.mesh.faces] / 10.0
    np.testing.assert_allclose(target.mesh.corner_normals, radial, atol=1e-6)
    assert not folder.mesh(**ball, normals="facets").smooth


def test_normals_that_say_no_more_than_the_facets_leave_them_flat(folder):
    """A box with normals of its faces; and one with the means of its corners, which stand off by 55 degrees."""
    box = trimesh.creation.box()
    for mesh in (
        box,
        trimesh.Trimesh(box.vertices[box.faces].reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False),
    ):
        mesh.vertex_normals  # noqa: B018
        mesh.export(folder.path / "box.ply", vertex_normal=True)
        assert not folder.mesh(file="box.ply", units="mm").smooth
