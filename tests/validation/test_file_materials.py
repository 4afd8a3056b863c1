"""A glTF file of two materials against two targets that have them in the scene: the same image.

So has a picture of metallic and roughness, of two halves, against two meshes, and both methods against each other.

Two renders have seeds of their own. Halves of the picture, in which one of the materials lies each, and the whole
are compared by Welch's t-test over REPLICATES renders, at LEVEL, shared by the comparisons (Bonferroni).
"""

import io
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import trimesh
from scipy import stats

import lfmesh as lf
from tests.cameras import camera_without_array
from tests.glb import QUAD, QUAD_UV, SPLIT, Glb
from tests.renders import by_seed

LEVEL = 1e-3
REPLICATES = 16
GREYS = {-1.0: (204, 0.5), 1.0: (102, 0.9)}
"""By the side of the axis: base colour of 255, and roughness as glTF gives it."""


def scene(targets: list[Any]) -> lf.Scene:
    lamp = {"kind": "point", "position_mm": [60.0, 40.0, -60.0], "power_w": 1.0}
    transport = {"split": "transmit", "threads": 1, "samples": 32, "replicates": 1}
    return lf.Scene(camera=camera_without_array(), targets=targets, lights=[lamp], transport=transport)


def sums(scene: lf.Scene, first: int) -> np.ndarray:
    """Return the watts in the left half, the right half and the whole of the picture, by seed."""
    images = np.array([image.mean[..., 0] for image in by_seed(scene, range(first, first + REPLICATES))])
    halves = images.reshape(REPLICATES, 6, 2, 3).sum(axis=(1, 3))
    return np.column_stack([halves, halves.sum(axis=1)])


def p_value(one: np.ndarray, other: np.ndarray) -> float:
    return float(3.0 * stats.ttest_ind(one, other, equal_var=False).pvalue.min())


def test_two_materials_of_a_file_look_as_two_targets_do(tmp_path: Path) -> None:
    both, targets = trimesh.Scene(), []
    for side, (level, roughness) in GREYS.items():
        x = np.array([0.0, side * 0.04])
        corners = [[x.min(), -0.04, 0], [x.max(), -0.04, 0], [x.max(), 0.04, 0], [x.min(), 0.04, 0]]
        part = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
        colour = trimesh.visual.material.PBRMaterial(
            baseColorFactor=[level, level, level, 255], metallicFactor=0.0, roughnessFactor=roughness
        )
        part.visual = trimesh.visual.TextureVisuals(uv=np.zeros((4, 2)), material=colour)
        both.add_geometry(part)
        gloss = {"index": 1.5, "roughness": roughness**2}
        targets.append(
            {
                "shape": {"kind": "plane", "width_mm": 40.0, "height_mm": 80.0},
                "position_mm": [side * 20.0, 0.0, -150.0],
                "material": {"reflectance": level / 255.0, "gloss": gloss},
            }
        )
    both.export(tmp_path / "board.glb")
    target = {"file": "board.glb", "position_mm": [0.0, 0.0, -150.0]}
    of_file = sums(scene([target]).in_folder(tmp_path), 0)
    of_scene = sums(scene(targets), 1000)
    assert p_value(of_file, of_scene) > LEVEL
    # The comparison sees what is taken over: without it, both halves are the same matt white.
    ignored = sums(scene([target | {"materials": "ignore"}]).in_folder(tmp_path), 0)
    assert p_value(ignored, of_scene) < LEVEL


SIDE_M = 0.08
CODES = ((100, 255), (255, 40))
ROUGHNESS = 0.1 * 10.0 ** (26 / 32)
"""Roughness and metallic of 255, of the left half and of the right one, and the factor of roughness: both roughnesses
are ends of an interval of `GltfRange`, within 1 % of its width, where nothing is mixed."""


def png(pixels: np.ndarray) -> bytes:
    stream = io.BytesIO()
    PIL.Image.fromarray(pixels.astype(np.uint8)).save(stream, format="png")
    return stream.getvalue()


def sheet(roughness: float, metallic: float, picture: np.ndarray | None = None) -> Glb:
    """Return a square with a picture of roughness and metallic, (h, w, 2) of 255, or without one."""
    glb = Glb()
    material = glb.material((0.8, 0.8, 0.8))
    pbr = glb.tree["materials"][material]["pbrMetallicRoughness"]
    pbr |= {"roughnessFactor": roughness, "metallicFactor": metallic}
    if picture is not None:
        # What the red channel holds is nobody's business here.
        coded = np.concatenate([np.full_like(picture[..., :1], 77), picture], axis=2)
        image = glb.add("images", {"bufferView": glb.view(png(coded)), "mimeType": "image/png"})
        pbr["metallicRoughnessTexture"] = {"index": glb.add("textures", {"source": image})}
    part = glb.primitive(SIDE_M * QUAD, SPLIT, material, TEXCOORD_0=QUAD_UV)
    glb.node("sheet", mesh=glb.add("meshes", {"primitives": [part]}))
    return glb


def halves() -> np.ndarray:
    """Return two halves, between which 1/4096 of the picture is interpolated."""
    return np.repeat(np.array([[CODES[0], CODES[1]]]), 2048, axis=1)


def pictured(folder: Path, name: str, glb: Glb, *others: dict[str, Any]) -> lf.Scene:
    glb.write(folder / name)
    return scene([{"file": name, "position_mm": [0.0, 0.0, -150.0]}, *others]).in_folder(folder)


def test_an_even_picture_of_roughness_and_metallic_is_its_factor(tmp_path: Path) -> None:
    white = pictured(tmp_path, "white.glb", sheet(0.4, 0.7, np.full((3, 5, 2), 255)))
    plain = pictured(tmp_path, "plain.glb", sheet(0.4, 0.7))
    np.testing.assert_array_equal(*(next(iter(by_seed(each, [3]))).mean for each in (white, plain)))


def test_a_picture_of_two_halves_looks_as_two_meshes_do(tmp_path: Path) -> None:
    of_picture = sums(pictured(tmp_path, "halves.glb", sheet(ROUGHNESS, 1.0, halves())), 0)
    left_and_right = []
    for (roughness, metallic), side in zip(CODES, (-1.0, 1.0), strict=True):
        sheet(ROUGHNESS * roughness / 255.0, metallic / 255.0).write(tmp_path / f"{side}.glb")
        left_and_right.append({"file": f"{side}.glb", "position_mm": [side * 500.0 * SIDE_M, 0.0, -150.0]})
    of_meshes = sums(scene(left_and_right).in_folder(tmp_path), 1000)
    assert p_value(of_picture, of_meshes) > LEVEL
    # The comparison sees the picture: its mean looks different.
    roughness, metallic = np.mean(CODES, axis=0) / 255.0
    of_mean = sums(pictured(tmp_path, "mean.glb", sheet(ROUGHNESS * roughness, metallic)), 2000)
    assert p_value(of_mean, of_meshes) < LEVEL


def test_both_methods_see_the_same_picture_of_roughness_and_metallic(tmp_path: Path) -> None:
    """By lamps, and by a wall that glows beside it, to which light is asked for and scattered."""
    wall = {
        "shape": {"kind": "plane", "width_mm": 40.0, "height_mm": 40.0},
        "position_mm": [25.0, 0.0, -130.0],
        "rotation_deg": [0.0, 90.0, 0.0],
        "material": {"reflectance": 0.3, "radiance_w_m2_sr": 5.0},
    }
    ramp = np.stack(np.meshgrid(np.linspace(60, 255, 16), np.linspace(0, 255, 8)), axis=2)
    seen = pictured(tmp_path, "ramp.glb", sheet(1.0, 1.0, ramp), wall)
    adjoint = sums(seen.changed({"transport.method": "adjoint"}), 0)
    forward = sums(seen.changed({"transport.method": "forward", "transport.samples": 96}), 1000)
    assert p_value(adjoint, forward) > LEVEL
