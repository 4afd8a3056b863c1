"""Scenes from glTF files: names, places, lights, cameras, what is left out and said, and files that are refused."""

import io
import json
import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest

from lfmesh.errors import LensFileWarning, LfmeshError, MeshError, SceneError
from lfmesh.geometry import frame
from lfmesh.geometry.files.mesh_file import load_mesh
from lfmesh.geometry.motions import motion_of
from lfmesh.geometry.objects.targets import target_mesh
from lfmesh.geometry.objects.texture import srgb_to_linear
from lfmesh.imports import read_gltf
from lfmesh.imports.report import Verdict
from lfmesh.optics.rgb_spectra import primary_reflectances
from lfmesh.scene import DirectionalLight, PointLight, Scene, SpotLight, load, loads
from tests.cameras import camera_without_array
from tests.glb import QUAD, QUAD_UV, SPLIT, Glb, turn
from tests.processor_time import processor_seconds

TOML = Scene(camera=camera_without_array()).dump_toml().replace("schema_version = 1\n", "")


def sheet(glb: Glb, name: str | None = "Sheet", parent: int | None = None, **placed: Any) -> int:
    mesh = glb.add("meshes", {"primitives": [glb.primitive(QUAD, SPLIT, glb.material())]})
    return glb.node(name, parent, mesh=mesh, **placed)


def loaded(folder: Path, glb: Glb, keys: str = 'targets = { file = "scene.glb" }', toml: str = TOML) -> Scene:
    """Load a scene that takes something from a file."""
    glb.write(folder / "scene.glb")
    (folder / "scene.toml").write_text(f"{keys}\n{toml}")
    return load(folder / "scene.toml")


def refusal(folder: Path, glb: Glb, keys: str = 'targets = { file = "scene.glb" }') -> str:
    """Return the one line that loading ends in."""
    with pytest.raises(LfmeshError) as raised:
        loaded(folder, glb, keys)
    message = str(raised.value)
    assert "\n" not in message
    assert "scene.glb" in message
    assert len(message) < 500 + 3 * len(str(folder))
    return message


# Targets.


def test_every_object_is_a_target_by_its_name_or_number(tmp_path: Path) -> None:
    glb = Glb()
    first = sheet(glb, "Table")
    for name in ("Leg", "Leg", None, "2"):
        sheet(glb, name, first)
    scene = loaded(tmp_path, glb)
    assert [target.node for target in scene.targets] == ["Table", 1, 2, 3, "2"]
    assert [target.name for target in scene.targets] == ["Table", "nodes[1] Leg", "nodes[2] Leg", "nodes[3]", "2"]
    assert loads(scene.dump_toml(), tmp_path) == scene


def test_objects_stand_where_the_whole_file_puts_them(tmp_path: Path) -> None:
    """A camera with something below it, a stretched parent and a mirror: nodes one by one make up the whole."""
    glb = Glb()
    rig = glb.node("Rig", translation=[1, 2, 3], rotation=turn((1, 2, 3), 50), scale=[1.0, 3.0, 0.5])
    glb.add("cameras", {"type": "perspective", "perspective": {"yfov": 0.5, "znear": 0.1, "aspectRatio": 1.0}})
    eye = glb.node("Eye", rig, camera=0, translation=[0.0, 0.0, 5.0])
    sheet(glb, "Below", eye, translation=[0.0, 0.0, -1.0])
    sheet(glb, "Mirrored", rig, scale=[-1.0, 1.0, 1.0])
    path = glb.write(tmp_path / "scene.glb")
    whole = load_mesh(path)
    single = [load_mesh(path, node=name)[0] for name in ("Below", "Mirrored")]
    assert len(whole) == 2
    for one, other in zip(whole, single, strict=True):
        np.testing.assert_array_equal(one.mesh.vertices, other.mesh.vertices)
    stretched = frame.rotation((0, 0, 0)) * [1.0, 3.0, 0.5]
    x, y, z, w = turn((1, 2, 3), 50)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    stretched = (np.eye(3) + 2 * w * cross + 2 * cross @ cross) @ stretched
    expected = 1e3 * (np.add(QUAD, [0.0, 0.0, 4.0]) @ stretched.T + [1, 2, 3])
    np.testing.assert_allclose(single[0].mesh.vertices, expected, atol=1e-3)


@pytest.mark.parametrize("anchor", ["origin", "centre", "base"])
def test_an_assembly_stands_as_one_target_of_its_whole_file(tmp_path: Path, anchor: str) -> None:
    glb = Glb()
    rig = glb.node("Rig", translation=[1, 2, 3], rotation=turn((1, 2, 3), 50), scale=[1.0, 3.0, 0.5])
    sheet(glb, "Below", rig, translation=[0.0, 0.0, -1.0])
    sheet(glb, "Beside", translation=[4.0, 0.0, 0.0])
    place = f'anchor = "{anchor}", position_mm = [1.0, -20.0, -500.0], rotation_deg = [10.0, 20.0, 30.0], scale = 0.01'
    scene = loaded(tmp_path, glb, f'targets = {{ file = "scene.glb", {place} }}')
    whole = loads(f'targets = [{{ file = "scene.glb", {place} }}]\n{TOML}', tmp_path)
    assert [target.name for target in scene.targets] == ["Below", "Beside"]
    assert loads(scene.dump_toml(), tmp_path) == scene
    parts = np.concatenate([target_mesh(target, scene).mesh.vertices for target in scene.targets])
    one = target_mesh(whole.targets[0], whole).mesh.vertices
    np.testing.assert_allclose(parts, one, rtol=1e-12)
    low, high = parts.min(axis=0), parts.max(axis=0)
    if anchor == "base":
        np.testing.assert_allclose([0.5 * (low + high)[0], low[1], 0.5 * (low + high)[2]], [1.0, -20.0, -500.0])


@pytest.mark.parametrize("anchor", ["origin", "centre", "base"])
@pytest.mark.parametrize(
    "motion",
    [
        "velocity_mm_s = [1.0, 2.0, 3.0], spin_deg_s = [0.0, 90.0, 10.0]",
        "poses = [{ time_s = 0 }, { time_s = 1, position_mm = [9.0, 0.0, -500.0], rotation_deg = [0.0, 90.0, 0.0] }]",
    ],
)
def test_an_assembly_moves_as_one_target_of_its_whole_file(tmp_path: Path, anchor: str, motion: str) -> None:
    glb = Glb()
    sheet(glb, "Below", translation=[0.0, 0.0, -1.0])
    sheet(glb, "Beside", translation=[4.0, 0.0, 0.0])
    place = f'anchor = "{anchor}", position_mm = [1.0, -20.0, -500.0], rotation_deg = [0.0, 20.0, 0.0]'
    moving = f"{place}, motion = {{ {motion} }}"
    toml = f"{TOML}\n[exposure]\nduration_s = 1.0\n"
    scene = loaded(tmp_path, glb, f'targets = {{ file = "scene.glb", {moving} }}', toml)
    whole = loads(f'targets = [{{ file = "scene.glb", {moving} }}]\n{toml}', tmp_path)
    bits = motion_of(whole.targets[0]).tobytes()  # type: ignore[union-attr]
    assert [motion_of(target).tobytes() for target in scene.targets] == [bits, bits]  # type: ignore[union-attr]
    assert loads(scene.dump_toml(), tmp_path) == scene


@pytest.mark.parametrize("uv_set", [0, 1])
def test_pictures_lie_where_offset_scale_and_their_own_coordinates_put_them(tmp_path: Path, uv_set: int) -> None:
    glb = Glb()
    material = glb.material(picture=png(np.zeros((2, 2, 3))))
    base = glb.tree["materials"][material]["pbrMetallicRoughness"]["baseColorTexture"]
    base["texCoord"] = uv_set
    base["extensions"] = {"KHR_texture_transform": {"offset": [0.25, 0.1], "scale": [0.5, 2.0]}}
    glb.tree["extensionsRequired"] = ["KHR_texture_transform"]
    uv = {f"TEXCOORD_{uv_set}": QUAD_UV, f"TEXCOORD_{1 - uv_set}": 0.3 * QUAD_UV}
    glb.node("A", mesh=glb.add("meshes", {"primitives": [glb.primitive(QUAD, SPLIT, material, **uv)]}))
    path = glb.write(tmp_path / "scene.glb")
    (piece,) = load_mesh(path)
    u, v = QUAD_UV.T
    expected = np.column_stack([0.25 + 0.5 * u, 1.0 - (0.1 + 2.0 * v)])[SPLIT]
    assert piece.uv is not None
    np.testing.assert_allclose(piece.uv, expected, atol=1e-6)
    # glTF's own words: counter-clockwise, as seen with v downwards, after the scale and before the offset.
    base["extensions"]["KHR_texture_transform"]["rotation"] = 0.7
    (piece,) = load_mesh(glb.write(path))
    turned = np.exp(0.7j) * (0.5 * u - 2.0j * v)
    expected = np.column_stack([0.25 + turned.real, 1.0 - (0.1 - turned.imag)])[SPLIT]
    assert piece.uv is not None
    np.testing.assert_allclose(piece.uv, expected, atol=1e-6)


def png(values: Any) -> bytes:
    stream = io.BytesIO()
    PIL.Image.fromarray(np.asarray(values, np.uint8)).save(stream, "PNG")
    return stream.getvalue()


WRAPS = {
    # glTF 2.0, section 5.27: by number, the place inside the picture of a place anywhere.
    10497: lambda t: t - np.floor(t),
    33071: lambda t: np.clip(t, 0.0, 1.0),
    33648: lambda t: 1.0 - np.abs(t - 2.0 * np.floor(t / 2.0) - 1.0),
}


@pytest.mark.parametrize("across", WRAPS)
@pytest.mark.parametrize("down", WRAPS)
def test_pictures_go_on_outside_as_their_sampler_says(tmp_path: Path, across: int, down: int) -> None:
    rng = np.random.default_rng(across + 3 * down)
    # Sixteen plain cells of four texels, which nothing interpolates in the middle.
    cells = rng.integers(0, 256, (4, 4, 3))
    glb = Glb()
    material = glb.material(picture=png(np.kron(cells, np.ones((4, 4, 1)))))
    glb.tree["textures"][0]["sampler"] = glb.add("samplers", {"wrapS": across, "wrapT": down})
    # Facets whose corners stand in the middle of cells, up to two pictures outside.
    uv = (rng.integers(-8, 12, (30, 2)) + 0.5) / 4.0
    corners = np.column_stack([rng.normal(size=(30, 2)), np.zeros(30)])
    faces = np.arange(30).reshape(10, 3)
    glb.node("A", mesh=glb.add("meshes", {"primitives": [glb.primitive(corners, faces, material, TEXCOORD_0=uv)]}))
    made = target_mesh(loaded(tmp_path, glb).targets[0], loaded(tmp_path, glb))
    assert made.uv is not None
    assert made.texture is not None
    assert (made.uv >= 0.0).all()
    assert (made.uv <= 1.0).all()
    height, width = made.texture.shape[:2]
    column = np.minimum((made.uv[..., 0] * width).astype(int), width - 1)
    row = np.minimum(((1.0 - made.uv[..., 1]) * height).astype(int), height - 1)
    u, v = (
        np.minimum((4 * wrap(t)).astype(int), 3) for wrap, t in zip((WRAPS[across], WRAPS[down]), uv.T, strict=True)
    )
    expected = srgb_to_linear(cells[v, u] / 255.0)[faces]
    np.testing.assert_allclose(made.texture[row, column], expected, atol=1e-6)


def test_a_sampler_that_cannot_be_is_refused_in_one_line(tmp_path: Path) -> None:
    glb = Glb()
    material = glb.material(picture=png(np.zeros((2, 2, 3))))
    glb.tree["textures"][0]["sampler"] = 0
    glb.node("A", mesh=glb.add("meshes", {"primitives": [glb.primitive(QUAD, SPLIT, material, TEXCOORD_0=QUAD_UV)]}))
    with pytest.raises(MeshError, match=r"textures\.sampler is 0, but there are 0"):
        load_mesh(glb.write(tmp_path / "scene.glb"))
    glb.add("samplers", {"wrapS": 1})
    with pytest.raises(MeshError, match=r"samplers\[0\]\.wrapS is 1; valid are 10497, 33071, 33648"):
        load_mesh(glb.write(tmp_path / "scene.glb"))


def test_every_property_is_taken_or_told(tmp_path: Path) -> None:
    glb = Glb()
    material = glb.material(picture=png(np.zeros((2, 2, 3))), occlusionTexture={"index": 0}, novelty=[1.0])
    base = glb.tree["materials"][material]["pbrMetallicRoughness"]["baseColorTexture"]
    base |= {"extensions": {"KHR_texture_transform": {}, "EXT_of_texture": {}}, "twist": 2}
    glb.tree["textures"][0] |= {"sampler": 0, "extensions": {"KHR_texture_basisu": {"source": 0}}}
    glb.add("samplers", {"magFilter": 9728, "minFilter": 9984, "wrapS": 33071})
    sheet(glb, "Other")
    glb.tree["meshes"][0]["primitives"] = [glb.primitive(QUAD, SPLIT, material, TEXCOORD_0=QUAD_UV)]
    glb.tree["meshes"][0]["primitives"][0]["extensions"] = {"KHR_materials_variants": {}}
    scene = read_gltf(glb.write(tmp_path / "scene.glb"))
    scene.targets("scene.glb")
    said = [line.how for line in scene.report.of(Verdict.APPROXIMATED)]
    assert sorted(said) == sorted([
        "KHR_materials_variants is left out",
        f"materials[{material}]: novelty is left out",
        f"materials[{material}]: EXT_of_texture is left out",
        f"materials[{material}]: twist is left out",
        f"materials[{material}]: KHR_texture_basisu is left out",
        f"materials[{material}]: its picture is interpolated between texels, where the file asks for the nearest",
    ])  # fmt: skip


def test_a_target_says_which_nodes_there_are(tmp_path: Path) -> None:
    glb = Glb()
    sheet(glb, "Cube")
    path = glb.write(tmp_path / "scene.glb")
    with pytest.raises(MeshError, match=r"has no node 'Kube' of its own; valid are 'Cube'"):
        load_mesh(path, node="Kube")
    with pytest.raises(SceneError, match=r"targets\[0\]\.node"):
        loads(TOML + '[[targets]]\nshape = { kind = "sphere", radius_mm = 1.0 }\nnode = "A"\n')
    (tmp_path / "a.stl").write_bytes(b"")
    with pytest.raises(MeshError, match="files have nodes; omit it"):
        load_mesh(tmp_path / "a.stl", "mm", node=1)


def test_what_is_left_out_is_said(tmp_path: Path) -> None:
    glb = Glb()
    sheet(glb, "Lamp", skin=0, extensions={"EXT_mesh_gpu_instancing": {}})
    primitive = glb.tree["meshes"][0]["primitives"][0]
    primitive["targets"] = [{}]
    primitive["attributes"]["COLOR_0"] = 0
    glb.tree["materials"][0] |= {
        "emissiveFactor": [1.0, 1.0, 1.0],
        "normalTexture": {"index": 0},
        "extensions": {"KHR_materials_transmission": {}, "KHR_materials_emissive_strength": {}},
    }
    glb.tree["meshes"][0]["primitives"].append(primitive | {"mode": 1})
    glb.tree |= {"animations": [{}], "skins": [{}]}
    scene = read_gltf(glb.write(tmp_path / "scene.glb"))
    scene.targets("scene.glb")
    said = "\n".join(str(line) for line in scene.report.of(Verdict.APPROXIMATED))
    for word in ("animations: ", "skins: ", "its bones", "EXT_mesh_gpu_instancing", "morph",
                 "emission", "normal map", "KHR_materials_transmission", "primitive 1 is lines"):  # fmt: skip
        assert said.count(word) == 1, word
    assert "strength" not in said
    with pytest.warns(LensFileWarning, match=r"scene\.glb: animations: approximated: left out"):
        loaded(tmp_path, glb)
    plain = Glb()
    sheet(plain)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        loaded(tmp_path, plain)


# The camera.


@pytest.mark.parametrize("seed", range(20))
def test_any_turn_of_a_camera_is_kept(tmp_path: Path, seed: int) -> None:
    """Turns of all kinds, a camera along the x axis among them, where two of the three angles turn about one axis."""
    random = np.random.default_rng(seed)
    rotation = random.normal(size=4) if seed > 3 else np.array(turn((0, 1, 0), [90, -90, 90.0000001, 0][seed]))
    rotation /= np.linalg.norm(rotation)
    place = random.uniform(-2.0, 2.0, 3)
    glb = Glb()
    glb.add("cameras", {"type": "perspective"})
    glb.node("Eye", camera=0, translation=place.tolist(), rotation=rotation.tolist())
    pose = read_gltf(glb.write(tmp_path / "scene.glb")).pose(None, 7.0)
    x, y, z, w = rotation
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turned = np.eye(3) + 2 * w * cross + 2 * cross @ cross
    to_world = frame.frame(pose.tilt_deg, pose.shift_mm)
    np.testing.assert_allclose(to_world[:, :3], turned, atol=1e-9)
    np.testing.assert_allclose(frame.points(to_world, [[0, 0, 7.0]])[0], 1e3 * place, atol=1e-9)


def test_a_camera_is_taken_by_its_name(tmp_path: Path) -> None:
    glb = Glb()
    glb.add("cameras", {"type": "perspective"})
    glb.node("Left", camera=0, translation=[-1.0, 0.0, 0.0])
    glb.node("Right", camera=0, translation=[1.0, 0.0, 0.0])
    key = '[camera.pose]\nfile = "scene.glb"\n'
    scene = loaded(tmp_path, glb, "", TOML + key + 'camera = "Right"\n')
    assert scene.camera.pose.shift_mm[:2] == (1000.0, 0.0)
    glb.write(tmp_path / "scene.glb")
    for more, why in (("", "holds 2 cameras; give camera, one of 'Left', 'Right'"),
                      ('camera = "Up"\n', "has no node 'Up' of its own; valid are 'Left', 'Right'")):  # fmt: skip
        with pytest.raises(SceneError, match=why):
            loads(TOML + key + more, tmp_path)
    mirrored = Glb()
    mirrored.add("cameras", {"type": "perspective"})
    mirrored.node("Eye", camera=0, scale=[-1.0, 1.0, 1.0])
    mirrored.write(tmp_path / "scene.glb")
    with pytest.raises(SceneError, match="mirrored or skewed"):
        loads(TOML + key, tmp_path)


# Lights.


def of_light(folder: Path, entry: dict[str, Any], keys: str = "", toml: str = TOML, **placed: Any) -> Scene:
    glb = Glb()
    glb.light("Lamp", entry, **placed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LensFileWarning)
        return loaded(folder, glb, f'lights = {{ file = "scene.glb"{keys} }}', toml)


@pytest.mark.parametrize("seed", range(8))
def test_spots_have_the_candela_of_the_file_on_their_axis(tmp_path: Path, seed: int) -> None:
    """The power into the cone by quadrature of the profile: even inside, linear in the cosine to the edge."""
    random = np.random.default_rng(seed)
    outer = float(random.uniform(1e-3, 0.5 * np.pi))
    inner = float(random.uniform(0.0, outer)) if seed else outer
    spot = {"innerConeAngle": inner, "outerConeAngle": outer}
    (light,) = of_light(tmp_path, {"type": "spot", "intensity": 683.0, "spot": spot}).lights
    assert isinstance(light, SpotLight)
    assert light.direction == (0.0, 0.0, -1.0)
    cosine = np.cos(outer) + (np.arange(200_000) + 0.5) / 200_000 * (1.0 - np.cos(outer))
    edge = max(np.cos(inner) - np.cos(outer), 1e-300)
    profile = np.clip((cosine - np.cos(outer)) / edge, 0.0, 1.0)
    assert light.power_w == pytest.approx(2.0 * np.pi * profile.mean() * (1.0 - np.cos(outer)), rel=1e-4)
    assert light.half_angle_deg == pytest.approx(np.degrees(outer))
    assert light.edge_deg == pytest.approx(np.degrees(outer - inner))


def test_colours_of_lights_are_spectra_in_bands(tmp_path: Path) -> None:
    """Red and its complement shine at every wavelength as white does; each has its share of the power."""
    toml = TOML.replace("[camera.sensor]\n", '[camera.sensor]\nbands = "rgb"\n')
    parts = []
    for colour in ([1.0, 1.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 1.0]):
        (light,) = of_light(tmp_path, {"type": "point", "intensity": 683.0, "color": colour}, toml=toml).lights
        assert isinstance(light, PointLight)
        parts.append(light)
    white, red, cyan = parts
    assert white.power_w == pytest.approx(4.0 * np.pi)
    assert red.power_w + cyan.power_w == pytest.approx(white.power_w)
    assert red.spectrum is not None
    tables = [each.spectrum.model_dump() for each in (red, cyan) if each.spectrum is not None]
    nm, values = (np.array(tables[0][key]) for key in ("wavelengths_nm", "values"))
    density = red.power_w * values / np.trapezoid(values, nm)
    np.testing.assert_allclose(density * np.ptp(nm) / white.power_w, [primary_reflectances(w)[0] for w in nm])


def test_colours_of_lights_at_single_wavelengths(tmp_path: Path) -> None:
    entry = {"type": "directional", "intensity": 683.0, "color": [1.0, 0.5, 0.0]}
    one = TOML + "[transport]\nwavelengths_nm = [610.0]\n"
    (light,) = of_light(tmp_path, entry, toml=one).lights
    assert isinstance(light, DirectionalLight)
    assert light.irradiance_w_m2 == pytest.approx(primary_reflectances(610.0) @ [1.0, 0.5, 0.0])
    glb = Glb()
    glb.light("Sun", entry)
    several = TOML + "[transport]\nwavelengths_nm = [610.0, 450.0]\n"
    with pytest.warns(LensFileWarning, match="683 lx are 1 W/m², at 683 lm/W; its colour is left out"):
        loaded(tmp_path, glb, 'lights = { file = "scene.glb" }', several)


# Files that are refused.


def broken_scenes() -> dict[str, tuple[Glb, str]]:
    """Return files that are not usable, with the reason that each must be given."""
    made: dict[str, tuple[Glb, str]] = {}

    def put(why: str, **tree: Any) -> Glb:
        glb = Glb()
        sheet(glb)
        glb.tree |= tree
        made[why] = glb, why
        return glb

    put("occurs twice in its node tree", nodes=[{"mesh": 0, "children": [0]}])
    put("occurs twice in its node tree, as", nodes=[{"children": [1]}, {"children": [2]}, {"children": [1]}])
    put("but there are 1, counted from 0", nodes=[{"mesh": 0, "children": [7]}])
    put("nodes is not a list of objects", nodes={"a": 1})
    put("nodes[0].children is 3; valid is a list", nodes=[{"mesh": 0, "children": 3}])
    put("nodes[0].matrix is [1.0]; valid are 16 finite numbers", nodes=[{"mesh": 0, "matrix": [1.0]}])
    put("is not affine", nodes=[{"mesh": 0, "matrix": [1.0] * 16}])
    put("nodes[0].scale is", nodes=[{"mesh": 0, "scale": [1.0, float("nan"), 1.0]}])
    put("nodes[0].translation is", nodes=[{"mesh": 0, "translation": [1e300, 0.0, 0.0]}])
    put("nodes[0].rotation is zero", nodes=[{"mesh": 0, "rotation": [0, 0, 0, 0]}])
    put("holds no object with facets", nodes=[{"name": "Empty"}])
    put("nodes[0].mesh is 5", nodes=[{"mesh": 5}])
    put("scene is 3, but there are 1", scene=3)
    put("100001 nodes; the limit is 100000", nodes=[{}] * 100_001)
    put("requires the extension 'KHR_draco_mesh_compression'", extensionsRequired=["KHR_draco_mesh_compression"])
    put("objects with", nodes=[{"mesh": 0}] * 10_001, scenes=[{"nodes": list(range(10_001))}])
    put("an accessor counts").tree["accessors"][0]["count"] = 10**12
    put("the limits are 10000 objects and").tree["accessors"][1]["count"] = 10**9
    put("names no vertices").tree["meshes"][0]["primitives"][0]["indices"] = 99
    put("its buffer gone.bin is missing", buffers=[{"uri": "gone.bin", "byteLength": 1}])
    return made


@pytest.mark.parametrize("why", broken_scenes())
def test_broken_scenes_get_one_line(tmp_path: Path, why: str) -> None:
    glb, why = broken_scenes()[why]
    if "uri" in str(glb.tree.get("buffers")):
        glb.data = b""
    start = processor_seconds()
    assert why in refusal(tmp_path, glb)
    assert processor_seconds() - start < 10.0


LIGHT_FAULTS = {
    "of type 'area'": {"type": "area"},
    "intensity of its light is -1": {"type": "point", "intensity": -1},
    "its color is [1.0]": {"type": "point", "color": [1.0]},
    "innerConeAngle = 1": {"type": "spot", "spot": {"innerConeAngle": 1.0, "outerConeAngle": 0.5}},
    "spot.outerConeAngle of its light is 3": {"type": "spot", "spot": {"outerConeAngle": 3}},
    "holds no light that shines": {"type": "point", "intensity": 0.0},
}


@pytest.mark.parametrize("why", LIGHT_FAULTS)
def test_broken_lights_get_one_line(tmp_path: Path, why: str) -> None:
    glb = Glb()
    glb.light("Lamp", LIGHT_FAULTS[why])
    assert why in refusal(tmp_path, glb, 'lights = { file = "scene.glb" }')


def test_wrong_keys_and_files_are_named(tmp_path: Path) -> None:
    glb = Glb()
    sheet(glb)
    glb.write(tmp_path / "scene.glb")
    (tmp_path / "a.stl").write_bytes(b"")
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.glb")
        with pytest.raises(SceneError, match=r"targets\.file.*pipe\.glb is not a regular file"):
            loads('targets = { file = "pipe.glb" }\n' + TOML, tmp_path)
    for keys, why in (
        ('targets = { file = "gone.glb" }', r"targets\.file = \"gone\.glb\".*no such file"),
        ('targets = { file = "a.stl" }', r"targets\.file = \"a\.stl\".*must end in \.glb or \.gltf"),
        ('targets = { file = "scene.glb", scale = 0 }', r"targets\.scale = 0: must be above 0"),
        ('targets = { file = "scene.glb", units = "mm" }', r"targets\.units: unknown key; .* give scale = 0\.001"),
        (
            'targets = { file = "scene.glb", material = {} }',
            r"targets\.material: unknown key; .* \[\[targets\]\] with",
        ),
        ('lights = { file = "scene.glb", lighting = "nits" }', r"lights\.lighting = \"nits\""),
        ('lights = { file = "scene.glb" }', r"holds no light that shines"),
        ("targets = { files = 1 }", "targets"),
    ):
        with pytest.raises(SceneError, match=why) as raised:
            loads(f"{keys}\n{TOML}", tmp_path)
        assert "\n" not in str(raised.value)
    with pytest.raises(SceneError, match=r"camera\.pose\.file = \"scene\.glb\": .*holds no camera in its scene"):
        loads(TOML + '[camera.pose]\nfile = "scene.glb"\n', tmp_path)


def test_the_schema_has_both_ways_of_giving_targets() -> None:
    schema = Scene.model_json_schema()
    for field in (schema["properties"]["targets"], schema["properties"]["lights"],
                  schema["$defs"]["Camera"]["properties"]["pose"]):  # fmt: skip
        assert any(each.get("required") == ["file"] for each in field["anyOf"])
    json.dumps(schema)
