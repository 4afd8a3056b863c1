"""The solved camera: one answer for equal scenes, another one as soon as the scene or one of its files is another."""

import os
from dataclasses import FrozenInstanceError
from pathlib import Path

import numpy as np
import pytest
import trimesh

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.geometry.lens import solved_camera as module
from lfmesh.geometry.lens.lens_shape import lens_shape
from lfmesh.geometry.lens.solved_camera import mesh_lines, solved_camera
from lfmesh.scene import Camera, Lens, Scene, Sensor, first_order, solved
from lfmesh.scene.first_order.paraxial import Paraxial

LENS = """
surfaces = [
  {{ radius_mm = {radius}, thickness_mm = 4.0, index = 1.5, semi_diameter_mm = 5.0 }},
  {{ radius_mm = -60.0, semi_diameter_mm = 5.0 }},
]
"""


def scene_with(lens: Lens, folder: Path) -> Scene:
    return Scene(camera=Camera(focus_mm=400.0, lens=lens, sensor=Sensor(pixels=(8, 8), pixel_mm=0.1))).in_folder(folder)


def asset(name: str = "first_light") -> Scene:
    return lf.load(asset_path(f"scenes/{name}.toml"))


def ball(path: Path, radius: float) -> None:
    trimesh.creation.icosphere(3, radius).export(path)


def test_it_is_what_solving_and_first_order_optics_say() -> None:
    camera, by_hand = solved_camera(asset()), solved(asset())
    assert camera.scene == by_hand
    assert camera.report == first_order(asset())
    assert camera.paraxial == Paraxial.of(by_hand.camera.lens, 587.6)


def test_equal_scenes_and_the_solved_one_share_it() -> None:
    first = solved_camera(solved(asset()))
    camera = solved_camera(asset())
    assert camera is first
    assert solved_camera(asset()) is camera
    assert solved_camera(camera.scene) is camera
    assert camera.report is solved_camera(asset()).report


@pytest.mark.parametrize(
    "change",
    [
        {"camera.focus_mm": 501.0},
        {"transport.wavelengths_nm": [550.0]},
        {"camera.lens.surfaces[0].radius_mm": 29.5},
        {"name": "other"},
        {"targets": ()},
    ],
)
def test_another_scene_has_another(change: dict[str, object]) -> None:
    camera = solved_camera(asset())
    other = solved_camera(asset().changed(change))
    assert other is not camera
    assert other.scene == solved(asset().changed(change))


def test_scenes_that_differ_beside_their_camera_share_its_meshes() -> None:
    shape = solved_camera(asset()).lens_shape()
    for change in ({"targets": ()}, {"name": "another"}, {"transport.seed": 7, "transport.samples": 3}):
        other = solved_camera(asset().changed(change)).lens_shape()
        assert all(one is same for one, same in zip(other.caps, shape.caps, strict=True))


@pytest.mark.parametrize(
    "change",
    [
        {"camera.lens.surfaces[0].radius_mm": 29.5},
        {"camera.sensor.pixel_mm": 0.05},
        {"camera.mla.distance_mm": 60.0},
        {"camera.lens.stop_semi_diameter_mm": 3.0},
        {"transport.wavelengths_nm": [400.0]},
        {"transport.surface": "smooth"},
        {"transport.surface": "exact"},
        {"transport.tessellation.sag_mm": 0.02},
        {"targets": ()},
    ],
)
def test_meshes_are_those_that_the_scene_asks_for(change: dict[str, object]) -> None:
    """Whichever scene near it was meshed before."""
    near = asset().changed({"transport.surface": "patch"})
    solved_camera(near).lens_shape()
    camera = solved_camera(near.changed(change))
    found, anew = camera.lens_shape(), lens_shape(camera.scene)
    assert (found.rings, found.azimuths, found.rims) == (anew.rings, anew.azimuths, anew.rims)
    np.testing.assert_array_equal(found.surfaces, anew.surfaces)
    np.testing.assert_array_equal(found.errors_mm, anew.errors_mm)
    for one, same in zip(found.caps, anew.caps, strict=True):
        np.testing.assert_array_equal(one.vertices, same.vertices)


def test_it_cannot_be_changed() -> None:
    camera = solved_camera(asset("conventional"))
    with pytest.raises(FrozenInstanceError):
        camera.scene = asset()  # type: ignore[misc]
    shape = camera.lens_shape()
    with pytest.raises(ValueError, match="read-only"):
        shape.caps[0].vertices[0, 0] = 1.0
    shape.surfaces["curvature"] = 0.0
    shape.caps.clear()
    again = camera.lens_shape()
    assert (again.surfaces["curvature"] != 0.0).any()
    assert again.caps


@pytest.mark.parametrize("aged", [False, True])
def test_a_changed_lens_file_is_read_again(tmp_path: Path, aged: bool) -> None:
    """Even within one tick of the file system's clock, with the size unchanged."""
    path = tmp_path / "lens.toml"
    radii = ["60.0", "40.0"]
    lengths = []
    for radius in radii:
        path.write_text(LENS.format(radius=radius))
        os.utime(path, (1e9, 1e9) if aged else None)
        lengths.append(solved_camera(scene_with(Lens(file="lens.toml"), tmp_path)).paraxial.efl_mm)
    assert lengths[1] < 0.9 * lengths[0]


def test_a_changed_mesh_file_is_measured_again(tmp_path: Path) -> None:
    path = tmp_path / "ball.ply"
    glass = {"file": "ball.ply", "units": "mm", "index": 1.5}
    lens = Lens(surfaces=({"refractor": glass, "semi_diameter_mm": 1.0},))
    scene = scene_with(lens, tmp_path)
    ball(path, 6.0)
    before = path.stat()
    first = solved_camera(scene)
    kept = first.scene.camera.lens.surfaces[0].radius_mm
    ball(path, 5.0)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert path.stat().st_size == before.st_size
    second = solved_camera(scene)
    assert second.scene.camera.lens.surfaces[0].radius_mm == pytest.approx(5.0 / 6.0 * kept, rel=1e-5)
    assert first.scene.camera.lens.surfaces[0].radius_mm == kept


def test_scenes_that_look_in_other_folders_do_not_share_it(tmp_path: Path) -> None:
    for name, radius in (("a", "60.0"), ("b", "40.0")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "lens.toml").write_text(LENS.format(radius=radius))
    a, b = (solved_camera(scene_with(Lens(file="lens.toml"), tmp_path / name)).paraxial.efl_mm for name in "ab")
    assert b < 0.9 * a


def test_only_the_latest_are_kept() -> None:
    first = solved_camera(asset().changed({"camera.focus_mm": 300.0}))
    for focus in np.linspace(400.0, 500.0, 2 * module.KEPT):
        solved_camera(asset().changed({"camera.focus_mm": float(focus)}))
    assert len(module._kept) <= 2 * module.KEPT
    assert solved_camera(asset().changed({"camera.focus_mm": 300.0})) is not first


def test_errors_of_meshes_are_listed_only_where_there_are_any() -> None:
    exact, patches = (mesh_lines(asset().changed({"transport.surface": level})) for level in ("exact", "patch"))
    assert not any("error" in line or "µm" in line for line in exact)
    assert exact[-1].endswith('surface = "exact"')
    assert all("error at the sensor" in line for line in patches if line.startswith("surface "))
    assert len(patches) == len(exact)
    assert "µm" in patches[-1]
