"""Closed surfaces of one body of glass that cut each other only where edges cross edges."""

from pathlib import Path

import numpy as np
import pytest

import lfmesh as lf
from tests.cameras import camera_without_array

FACES = [[6, 7, 5], [6, 5, 4], [1, 3, 2], [0, 1, 2], [2, 3, 7], [2, 7, 6],
         [5, 1, 0], [4, 5, 0], [1, 5, 7], [1, 7, 3], [6, 4, 0], [2, 6, 0]]  # fmt: skip
"""Facets of a cube whose corners are numbered by 4 x + 2 y + z."""


@pytest.mark.parametrize("shift", [0.9, 0.875])
def test_cubes_whose_walls_cross_at_their_diagonals_are_refused(tmp_path: Path, shift: float) -> None:
    """Only edges cross edges, and no facet has its centre in both."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float64)
    vertices = 4.0 * np.concatenate([corners, np.add(corners, [shift, shift, 0.0])])
    faces = np.concatenate([np.array(FACES), np.array(FACES) + 8]) + 1
    lines = [*(f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices), *(f"f {a} {b} {c}" for a, b, c in faces)]
    (tmp_path / "cubes.obj").write_text("\n".join(lines) + "\n", encoding="utf-8")
    refractor = {"file": "cubes.obj", "units": "mm", "index": 1.5}
    target = {"refractor": refractor, "position_mm": [-4.0, -4.0, -300.0]}
    scene = lf.Scene(camera=camera_without_array(), targets=[target]).in_folder(tmp_path)
    with pytest.raises(lf.SceneError, match="its closed surfaces cut each other near"):
        lf.build(scene, aimed=False)
