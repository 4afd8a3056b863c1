"""A glTF file of two materials against two targets that have them in the scene: the same image.

The two renders have seeds of their own. Halves of the picture, in which one of the materials lies each, and the whole
are compared by Welch's t-test over REPLICATES renders, at LEVEL, shared by the comparisons (Bonferroni).
"""

from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy import stats

import lfmesh as lf
from tests.cameras import camera_without_array
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
