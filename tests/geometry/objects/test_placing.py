"""`scale` and `anchor` say where a mesh file stands; `check` names `scale` where a unit is suspect."""

import numpy as np
import pytest
import trimesh

from lfmesh.errors import SceneError
from lfmesh.geometry.frame import frame
from lfmesh.geometry.objects.placement import placements
from lfmesh.geometry.objects.targets import target_mesh
from lfmesh.scene import Scene, Target, loads
from tests.cameras import camera_without_array

BOX = np.array([[1.0, 2.0, 3.0], [5.0, 10.0, 6.0]])


def scene_with(folder, name="part.stl", **keys):
    body = trimesh.creation.box(bounds=BOX)
    body.export(folder / name)
    if name.endswith(".stl"):
        keys |= {"units": "mm"}
    target = Target(file=name, **keys)
    return target, Scene(camera=camera_without_array(), targets=(target,)).in_folder(folder)


def box(folder, **keys):
    target, scene = scene_with(folder, **keys)
    corners = target_mesh(target, scene).mesh.vertices
    return np.array([corners.min(axis=0), corners.max(axis=0)])


def test_scale_multiplies_the_files_coordinates(tmp_path):
    np.testing.assert_allclose(box(tmp_path, scale=0.5), 0.5 * BOX)
    np.testing.assert_allclose(box(tmp_path, name="part.glb", scale=0.001), BOX, rtol=1e-6)


def test_an_anchor_is_the_point_that_the_position_places(tmp_path):
    half, place = 0.5 * (BOX[1] - BOX[0]), np.array([7.0, -8.0, -500.0])
    np.testing.assert_allclose(box(tmp_path, anchor="origin", position_mm=(7.0, -8.0, -500.0)), BOX + place)
    found = box(tmp_path, anchor="centre", position_mm=(7.0, -8.0, -500.0), scale=2.0)
    np.testing.assert_allclose(found, [place - 2.0 * half, place + 2.0 * half])
    found = box(tmp_path, anchor="base", position_mm=(7.0, -8.0, -500.0))
    np.testing.assert_allclose(found, [place - [half[0], 0.0, half[2]], place + np.multiply(half, (1, 2, 1))])


def test_a_turned_part_stands_on_its_base_and_turns_about_its_centre(tmp_path):
    turn = (30.0, -20.0, 50.0)
    found = box(tmp_path, anchor="base", rotation_deg=turn)
    np.testing.assert_allclose(found.sum(axis=0)[[0, 2]], 0.0, atol=1e-12)
    assert found[0, 1] == pytest.approx(0.0, abs=1e-12)
    corners = (
        np.array(np.meshgrid(*np.stack([-0.5 * np.ptp(BOX, axis=0), 0.5 * np.ptp(BOX, axis=0)]).T)).reshape(3, -1).T
    )
    truth = corners @ frame(turn, (0.0, 0.0, 0.0))[:, :3].T
    np.testing.assert_allclose(
        box(tmp_path, anchor="centre", rotation_deg=turn), [truth.min(axis=0), truth.max(axis=0)]
    )


def test_a_suspect_unit_names_the_scale_that_mends_it(tmp_path):
    keys = {"name": "part.glb", "anchor": "centre", "position_mm": (0.0, 0.0, -500.0)}
    (placed,) = placements(scene_with(tmp_path, **keys)[1])
    assert any("if its numbers are in mm, give the target scale = 0.001" in text for text in placed.warnings)
    (placed,) = placements(scene_with(tmp_path, scale=0.001, **keys)[1])
    assert not any("if its numbers" in text for text in placed.warnings)


def test_shapes_have_neither():
    camera = Scene(camera=camera_without_array()).dump_toml()
    with pytest.raises(SceneError, match=r"targets\[0\]\.anchor") as raised:
        loads(camera + '\n[[targets]]\nshape = { kind = "sphere", radius_mm = 1.0 }\nanchor = "base"\nscale = 2.0\n')
    assert "targets[0].scale" in str(raised.value)
