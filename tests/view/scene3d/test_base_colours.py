"""Targets have the colours in a 3D view that they have in a render: of materials, pictures and reflectances."""

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest
import trimesh

import lfmesh as lf
from lfmesh.scene import loads
from lfmesh.view.output.gltf import write_model
from lfmesh.view.scene3d import pick
from lfmesh.view.scene3d.parts import Part, parts
from lfmesh.view.scene3d.plotter import View
from tests.glb import QUAD, QUAD_UV, SPLIT, Glb
from tests.view.conftest import SCENE, shot

pytestmark = pytest.mark.drawing

HALF = 0.2158605
"""Linear light of the code 128 of 255 (IEC 61966-2-1)."""


def png(pixels: list[list[list[int]]]) -> bytes:
    content = io.BytesIO()
    PIL.Image.fromarray(np.array(pixels, np.uint8)).save(content, format="PNG")
    return content.getvalue()


def world_of(target: dict[str, Any], **more: Any) -> lf.World:
    return lf.build(loads(SCENE).changed({"targets": [target], **more}))


def surfaces(world: lf.World) -> list[Part]:
    return [part for part in parts(world) if part.kind == "target"]


@pytest.fixture
def pieces(tmp_path: Path) -> lf.World:
    """Two squares of 20 mm side by side, 200 mm before the camera: an orange one, and one with a picture."""
    glb = Glb()
    plain = glb.material((1.0, HALF, 0.0))
    pictured = glb.material((HALF, 1.0, 1.0), png([[[255, 0, 0], [0, 0, 255]]]))
    for shift, material, more in ((-0.5, plain, {}), (0.5, pictured, {"TEXCOORD_0": QUAD_UV})):
        mesh = glb.add(
            "meshes", {"primitives": [glb.primitive(QUAD + np.array([shift, 0.0, 0.0]), SPLIT, material, **more)]}
        )
        glb.node(mesh=mesh)
    file = str(glb.write(tmp_path / "pieces.glb"))
    return world_of({"file": file, "scale": 0.02, "position_mm": [0.0, 0.0, -200.0]})


def test_parts_of_a_gltf_file_have_its_base_colours_and_pictures(pieces: lf.World) -> None:
    found = {part.look["color"]: part for part in surfaces(pieces)}
    assert found.keys() == {"#ff8000", "#80ffff"}
    assert [len(part.mesh.regular_faces) for part in found.values()] == [2, 2]
    assert {part.name for part in found.values()} == {"targets[0]"}
    assert len({part.label for part in found.values()}) == 2
    assert found["#ff8000"].picture is None, "so it is shaded like any body"
    picture = found["#80ffff"].picture
    assert picture is not None
    assert {(255, 0, 0), (0, 0, 255)} <= {tuple(code) for code in picture.reshape(-1, 3).tolist()}
    assert np.asarray(found["#ff8000"].mesh.points)[:, 0].max() <= 1e-6, "the left one"


def test_the_colours_are_seen(pieces: lf.World, views: Callable[..., View]) -> None:
    view = views(pieces)
    view.look("object")
    seen = shot(view)
    places = pick.to_picture(view, np.array([[-10.0, 0.0, -200.0], [5.0, 0.0, -200.0], [15.0, 0.0, -200.0]]))
    orange, left, right = (seen[round(y), round(x)] for x, y in places)
    assert orange[0] > 1.5 * orange[1] > 0
    assert orange[2] < 0.2 * orange[0]
    assert np.abs(left - [128, 0, 0]).max() <= 3, "the picture's red by the factor"
    assert np.abs(right - [0, 0, 255]).max() <= 3


def test_models_hold_base_colours_as_linear_light(pieces: lf.World, views: Callable[..., View], tmp_path: Path) -> None:
    write_model(views(pieces), tmp_path / "out.glb")
    held = trimesh.load(tmp_path / "out.glb").geometry
    materials = [mesh.visual.material for name, mesh in held.items() if name.startswith("targets[0]")]
    factors = sorted(material.baseColorFactor.tolist() for material in materials)
    assert factors == [[55, 255, 255, 255], [255, 55, 0, 255]], "55 is 255 times 0.2158605"
    assert sum(material.baseColorTexture is not None for material in materials) >= 1


def test_a_reflectance_by_wavelength_has_the_colour_of_its_pictures() -> None:
    plane = {"kind": "plane", "width_mm": 20.0, "height_mm": 20.0}
    red = {"wavelengths_nm": [400.0, 560.0, 580.0, 700.0], "values": [0.05, 0.05, 0.9, 0.9]}
    target = {"shape": plane, "position_mm": [0.0, 0.0, -200.0], "material": {"reflectance": red}}
    (card,) = surfaces(world_of(target, **{"transport.wavelengths_nm": [450.0, 550.0, 650.0]}))
    codes = [int(card.look["color"][i : i + 2], 16) for i in (1, 3, 5)]
    assert codes[0] > 200
    assert max(codes[1:]) < 130
    (grey,) = surfaces(world_of(target, **{"transport.wavelengths_nm": [650.0]}))
    assert len({grey.look["color"][i : i + 2] for i in (1, 3, 5)}) == 1, "as are pictures at one wavelength"


def test_facets_that_show_a_texel_each_have_its_colour(tmp_path: Path) -> None:
    """Models made with a palette are shaded, not drawn as flat pictures."""
    glb = Glb()
    palette = glb.material(picture=png([[[255, 0, 0], [0, 128, 0]]]))
    primitives = [
        glb.primitive(QUAD + np.array([0.0, 0.0, z]), SPLIT, palette, TEXCOORD_0=np.full((4, 2), [u, 0.5]))
        for z, u in ((0.0, 0.25), (0.5, 0.75))
    ]
    glb.node(mesh=glb.add("meshes", {"primitives": primitives}))
    file = str(glb.write(tmp_path / "palette.glb"))
    found = surfaces(world_of({"file": file, "scale": 0.02, "position_mm": [0.0, 0.0, -200.0]}))
    assert {part.look["color"] for part in found} == {"#ff0000", "#008000"}
    assert all(part.picture is None for part in found)


def test_a_reflectance_multiplies_a_picture(tmp_path: Path) -> None:
    (tmp_path / "white.png").write_bytes(png([[[255, 255, 255]]]))
    target = {
        "shape": {"kind": "plane", "width_mm": 20.0, "height_mm": 20.0}, "position_mm": [0.0, 0.0, -200.0],
        "material": {"reflectance": HALF, "texture": str(tmp_path / "white.png")},
    }  # fmt: skip
    (chart,) = surfaces(world_of(target))
    assert chart.picture is not None
    assert chart.look["color"] == "#808080"


def test_what_is_cut_out_by_a_picture_is_not_drawn(tmp_path: Path, views: Callable[..., View]) -> None:
    (tmp_path / "half.png").write_bytes(png([[[255, 255, 255, 255], [255, 255, 255, 0]]]))
    material = {"reflectance": 1.0, "texture": str(tmp_path / "half.png"), "opacity": "texture_alpha"}
    plane = {"kind": "plane", "width_mm": 20.0, "height_mm": 20.0}
    world = world_of({"shape": plane, "position_mm": [0.0, 0.0, -200.0], "material": material})
    view = views(world)
    view.look("object")
    seen = shot(view)
    there, hole = (
        seen[round(y), round(x)] for x, y in pick.to_picture(view, np.array([[-8.0, 3.0, -200.0], [8.0, 3.0, -200.0]]))
    )
    assert there.min() > 200
    assert hole.max() < 100
