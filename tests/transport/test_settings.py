"""A scene's settings as kernels take them."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy import stats

import lfmesh as lf
from lfmesh.transport.settings import NEAR_LENS, options_of
from tests.renders import by_seed
from tests.transport.checks.test_picture_warnings import plane, scene

SHINES = {"reflectance": 0.9, "radiance_w_m2_sr": 1.0}
SPECK = {
    "shape": {"kind": "plane", "width_mm": 1e-3, "height_mm": 1e-3},
    "position_mm": (0.0, 0.0, -1e5),
    "material": {"reflectance": 0.0},
}


def test_a_sheet_near_the_lens_gets_light_back_from_it() -> None:
    """It is as bright alone as in a scene in which light goes from target to target anyway."""
    sheet = plane(-3.0) | {"material": SHINES}
    alone = scene(targets=[sheet], **{"transport.split": "both"})
    one, two = lf.render(alone), lf.render(alone.changed({"targets": [sheet, SPECK]}))
    np.testing.assert_allclose(one.mean.sum(), two.mean.sum(), rtol=1e-6)


@pytest.mark.parametrize(
    ("radii", "split", "followed"),
    [(0.9, "both", True), (1.1, "both", False), (0.9, "transmit", False)],
)
def test_light_is_followed_from_a_single_sheet_only_near_the_lens(radii: float, split: str, followed: bool) -> None:
    """The lens has a radius of 7 mm; without reflections none comes back."""
    sheet = plane(-radii * NEAR_LENS * 7.0) | {"material": SHINES}
    world = lf.build(scene(targets=[sheet], **{"transport.split": split}))
    assert options_of(world).bounce == followed


V = np.array(
    [
        [[0.0, -15.0, 0.0], [0.0, 15.0, 0.0], [-30.0, 0.0, 30.0]],
        [[0.0, 15.0, 0.0], [0.0, -15.0, 0.0], [30.0, 0.0, 30.0]],
    ]
)
"""Two facets that meet along an edge and look at each other, open towards the camera."""


def mesh_scene(path: Path, corners: np.ndarray, divided: bool = False) -> lf.Scene:
    """The camera before facets that shine and reflect."""
    vertices, faces = corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)
    if divided:
        vertices, faces = trimesh.remesh.subdivide(vertices, faces)
    trimesh.Trimesh(vertices, faces, process=False).export(path)
    target = {"file": str(path), "units": "mm", "position_mm": [0.0, 0.0, -110.0], "material": SHINES}
    return lf.Scene(
        camera={
            "focus_mm": 110.0,
            "lens": {"surfaces": [{"paraxial": True, "focal_length_mm": 20.0, "semi_diameter_mm": 2.0, "stop": True}]},
            "sensor": {"pixels": [4, 4], "pixel_mm": 1.0},
        },
        targets=[target],
        transport={"split": "transmit", "samples": 64},
    )


def test_dividing_the_facets_of_a_v_changes_no_picture(tmp_path: Path) -> None:
    """Each side lights the other, whether it is one facet or four: a z-test at 4 σ of 12 seeds."""
    sums = [
        np.array([image.mean.sum() for image in by_seed(mesh_scene(tmp_path / f"{each}.stl", V, each), range(12))])
        for each in (False, True)
    ]
    error = np.hypot(*(stats.sem(each) for each in sums))
    assert error < 0.01 * sums[1].mean()
    assert abs(sums[0].mean() - sums[1].mean()) < 4.0 * error


@pytest.mark.parametrize("divided", [False, True])
def test_light_is_followed_between_facets_unless_they_lie_in_one_plane(tmp_path: Path, divided: bool) -> None:
    """Their number does not matter; two parallel sheets of one target light each other."""
    flat = V * [1.0, 1.0, 0.0]
    sheets = np.concatenate([flat[:1], np.add(flat[:1], [0.0, 0.0, 10.0])])
    for corners, followed in ((V, True), (flat, False), (flat[:1], False), (sheets, True)):
        scene = mesh_scene(tmp_path / "some.stl", corners, divided)
        assert options_of(lf.build(scene)).bounce == followed


def test_light_is_followed_between_targets_unless_they_lie_in_one_plane() -> None:
    """Side by side in one plane no target lights another; a step behind it one may."""
    sheet = plane(-1e3) | {"material": SHINES}
    for step_mm, followed in ((0.0, False), (1.0, True)):
        beside = sheet | {"position_mm": [5e3, 0.0, -1e3 - step_mm]}
        world = lf.build(scene(targets=[sheet, beside], **{"transport.split": "transmit"}))
        assert options_of(world).bounce == followed
