"""Closed surfaces of glass that meet where no middle of a facet tells: at edges only, or in a narrow strip."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

import lfmesh as lf
from tests.cameras import camera_without_array

FACES = [[6, 7, 5], [6, 5, 4], [1, 3, 2], [0, 1, 2], [2, 3, 7], [2, 7, 6],
         [5, 1, 0], [4, 5, 0], [1, 5, 7], [1, 7, 3], [6, 4, 0], [2, 6, 0]]  # fmt: skip
"""Facets of a cube whose corners are numbered by 4 x + 2 y + z."""


CORNERS = 4.0 * np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float64)


def scene_of(folder: Path, *bodies: list[trimesh.Trimesh]) -> lf.Scene:
    """Bodies of glass before a camera, each with a file of its closed surfaces."""
    targets = []
    for number, parts in enumerate(bodies):
        trimesh.util.concatenate(parts).export(folder / f"{number}.obj", digits=12)
        refractor = {"file": f"{number}.obj", "units": "mm", "index": 1.5}
        targets.append({"refractor": refractor, "position_mm": [-4.0, -4.0, -300.0]})
    return lf.Scene(camera=camera_without_array(), targets=targets).in_folder(folder)


def moved(x: float, y: float, halvings: int = 0) -> trimesh.Trimesh:
    """A cube with its lowest corner there, each of its facets divided into four as often as said."""
    mesh = trimesh.Trimesh(np.add(CORNERS, [x, y, 0.0]), FACES, process=False)
    for _ in range(halvings):
        mesh = mesh.subdivide()
    return mesh


@pytest.mark.parametrize("shift", [3.6, 3.5])
def test_cubes_whose_walls_cross_at_their_diagonals_are_refused(tmp_path: Path, shift: float) -> None:
    """Only edges cross edges, and no facet has its centre in both."""
    with pytest.raises(lf.SceneError, match="its closed surfaces cut each other near"):
        lf.build(scene_of(tmp_path, [moved(0.0, 0.0), moved(shift, shift)]), aimed=False)


@pytest.mark.parametrize("shift", [3.6, 3.5])
def test_bodies_whose_walls_cross_at_their_diagonals_overlap(tmp_path: Path, shift: float) -> None:
    with pytest.raises(lf.SceneError, match=r"these glass bodies (overlap|cut each other)"):
        lf.build(scene_of(tmp_path, [moved(0.0, 0.0)], [moved(shift, shift)]), aimed=False)


def test_surfaces_of_one_body_must_not_share_a_strip_of_a_wall(tmp_path: Path) -> None:
    """The strip is 0.05 mm wide, and the middles of facets are 0.08 mm and more from the edges."""
    with pytest.raises(lf.SceneError, match="its closed surfaces lie on each other near"):
        lf.build(scene_of(tmp_path, [moved(0.0, 0.0, 4), moved(4.0, 3.95, 4)]), aimed=False)
    lf.build(scene_of(tmp_path, [moved(0.0, 0.0, 4), moved(4.01, 3.95, 4)]), aimed=False)
