"""Worlds that are built once: what they depend on, and what renders take in place of building another."""

import gc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import lfmesh as lf
from lfmesh.errors import LfmeshError, SceneError, heard, warn_caller
from lfmesh.scene import Scene, loads
from lfmesh.transport import build as building
from lfmesh.transport import world_cache
from lfmesh.transport.render.tracer import Tracer
from tests.cameras import bench_camera

TEXT = f"""{bench_camera(4, 4)}[[targets]]
file = "part.stl"
units = "mm"
position_mm = [0.0, 0.0, -500.0]
[[targets]]
shape = {{ kind = "plane", width_mm = 100.0, height_mm = 100.0 }}
position_mm = [0.0, 0.0, -520.0]
material = {{ reflectance = "white.csv" }}
[[lights]]
kind = "point"
position_mm = [100.0, -100.0, -50.0]
power_w = 1.0
"""

SPECTRUM = "wavelength_nm,value\n400,{0}\n800,{0}\n"


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    write_part(tmp_path, 10.0)
    (tmp_path / "white.csv").write_text(SPECTRUM.format(0.5))
    small = {"camera.sensor.pixels": [8, 8], "transport.samples": 2, "transport.replicates": 2}
    return loads(TEXT, tmp_path).changed(small)


def write_part(folder: Path, size: float) -> None:
    trimesh.creation.box(extents=[size] * 3).export(folder / "part.stl")


@pytest.fixture
def builds(monkeypatch: pytest.MonkeyPatch) -> list[Scene]:
    """Note every scene that is built, and begin with none that is built already."""
    made: list[Scene] = []
    build = building._built

    def noted(scene: Scene, *how: Any) -> lf.World:
        made.append(scene)
        return build(scene, *how)

    monkeypatch.setattr(building, "_built", noted)
    monkeypatch.setattr(world_cache, "_latest", {})
    return made


def test_a_second_render_of_a_scene_builds_nothing(scene: Scene, builds: list[Scene]) -> None:
    first, second = lf.render(scene), lf.render(scene)
    assert len(builds) == 1
    assert np.array_equal(first.mean, second.mean)
    assert np.array_equal(first.stderr, second.stderr)
    other = lf.render(scene.changed({"transport.seed": 5}))
    assert len(builds) == 1, "no world depends on the seed"
    assert other.scene.transport.seed == 5
    assert (other.mean != first.mean).any()


def test_a_world_and_the_renders_of_its_scene_share_one_aim(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether they are given the world or find it."""
    asked: list[Scene] = []
    prove = building.proven_aim

    def noted(scene: Scene, *rest: Any, **how: Any) -> Any:
        asked.append(scene)
        return prove(scene, *rest, **how)

    monkeypatch.setattr(building, "proven_aim", noted)
    own = lf.build(scene)
    images = [lf.render(scene), lf.render(scene, world=own), lf.render(scene)]
    assert len(asked) == 1
    assert all(np.array_equal(image.mean, images[0].mean) for image in images)


def test_a_render_takes_the_world_that_it_is_given(scene: Scene, builds: list[Scene]) -> None:
    alone = lf.render(scene)
    own = lf.build(scene)
    builds.clear()
    given = lf.render(scene, world=own)
    assert not builds
    assert np.array_equal(alone.mean, given.mean)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"transport.surface": "flat"}, 'transport.surface is "exact" in the world and "flat" in the scene'),
        ({"targets[0].position_mm": [0.0, 0.0, -490.0]}, r"targets\[0\].position_mm\[2\] is -500.0"),
        ({"lights": []}, "lights is a list of 1 in the world and a list of 0 in the scene"),
    ],
)
def test_a_world_of_another_scene_is_refused_by_the_first_difference(
    scene: Scene, change: dict[str, Any], said: str
) -> None:
    own = lf.build(scene)
    with pytest.raises(LfmeshError, match=said) as refused:
        building.world_of(scene.changed(change), own)
    assert "\n" not in str(refused.value)


def test_a_world_is_refused_when_a_file_of_its_scene_has_changed(scene: Scene, tmp_path: Path) -> None:
    own = lf.build(scene)
    assert building.world_of(scene, own) is own
    write_part(tmp_path, 20.0)
    with pytest.raises(LfmeshError, match="files that it was built from have changed"):
        building.world_of(scene, own)


@pytest.mark.parametrize(
    "change",
    [
        {"name": "other"},
        {"camera.lens.surfaces[0].thickness_mm": 2.0},
        {"camera.mla.pitch_mm": 0.11},
        {"camera.sensor.reflectance": 0.1},
        {"targets[0].position_mm": [0.0, 0.0, -501.0]},
        {"targets[1].material.reflectance": 0.25},
        {"lights[0].power_w": 2.0},
        {"transport.max_events": 5},
        {"transport.wavelengths_nm": [500.0]},
    ],
)
def test_every_value_of_a_scene_is_part_of_what_a_world_depends_on(scene: Scene, change: dict[str, Any]) -> None:
    try:
        changed = scene.changed(change)
    except SceneError as error:
        pytest.skip(str(error))
    assert world_cache.key_of(changed) != world_cache.key_of(scene)


def test_every_file_of_a_scene_is_part_of_what_a_world_depends_on(scene: Scene, tmp_path: Path) -> None:
    keys = {world_cache.key_of(scene)}
    write_part(tmp_path, 20.0)
    keys.add(world_cache.key_of(scene))
    (tmp_path / "white.csv").write_text(SPECTRUM.format(0.6))
    keys.add(world_cache.key_of(scene))
    assert len(keys) == 3
    keys.add(world_cache.key_of(scene.changed({"transport.seed": 7})))
    assert len(keys) == 3, "the seed is not"


def test_a_file_beside_a_mesh_file_is_part_of_what_a_world_depends_on(scene: Scene, tmp_path: Path) -> None:
    (tmp_path / "part.obj").write_text("mtllib part.mtl\nv 0 0 0\nv 9 0 0\nv 0 9 0\nusemtl m\nf 1 2 3\n")
    (tmp_path / "part.mtl").write_text("newmtl m\nKd 0.1 0.1 0.1\n")
    coloured = scene.changed({"targets[0].file": "part.obj"})
    keys = {world_cache.key_of(coloured)}
    (tmp_path / "part.mtl").write_text("newmtl m\nKd 0.9 0.1 0.1\nmap_Kd part.png\n")
    keys.add(world_cache.key_of(coloured))
    for content in (b"one", b"two"):
        (tmp_path / "part.png").write_bytes(content)
        keys.add(world_cache.key_of(coloured))
    assert len(keys) == 4


def test_what_its_owner_does_to_a_world_enters_no_other_render(scene: Scene) -> None:
    own = lf.build(scene)
    own.tables = own.tables._replace(objects=None)
    own.kept["order of surfaces, aimed: True"] = None
    found = building.world_of(scene)
    assert found.tables.objects is not None
    assert not found.kept


def test_a_large_world_is_found_while_it_is_held_and_not_kept_afterwards(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(world_cache, "MOST_BYTES", 1000)
    own = lf.build(scene)
    key = world_cache.key_of(scene)
    assert world_cache.bytes_of(own.tables) > 1000
    assert world_cache.known(key) is not None
    del own
    gc.collect()
    assert world_cache.known(key) is None


def test_one_world_is_kept_that_nobody_holds(scene: Scene) -> None:
    keys = []
    for radius in (1.0, 2.0):
        other = scene.changed({"lights[0].power_w": radius})
        lf.build(other)
        keys.append(world_cache.key_of(other))
    gc.collect()
    assert [world_cache.known(key) is not None for key in keys] == [False, True]


def test_a_coarse_world_is_none_that_a_render_takes_by_itself(scene: Scene, builds: list[Scene]) -> None:
    coarse = lf.build(scene, rings=3)
    assert building.world_of(scene) is not coarse
    assert len(builds) == 2
    assert building.world_of(scene, coarse) is coarse


def test_warnings_of_building_are_said_again_by_a_render_that_builds_nothing(scene: Scene) -> None:
    own = lf.build(scene)
    world_cache.known(world_cache.key_of(scene))._said = (UserWarning("the file lacks a part"),)  # type: ignore[union-attr]
    with pytest.warns(UserWarning, match="the file lacks a part"):
        building.world_of(scene)
    assert own.scene.targets


def test_warnings_are_heard_by_all_who_listen() -> None:
    def both() -> tuple[list[Warning], list[Warning]]:
        with heard() as outer:
            with heard() as inner:
                warn_caller([UserWarning("one")])
            warn_caller([UserWarning("two")])
        return outer, inner

    with pytest.warns(UserWarning, match="one"):
        outer, inner = both()
    assert [str(each) for each in outer] == ["one", "two"]
    assert [str(each) for each in inner] == ["one"]


def test_the_order_of_surfaces_is_compared_once_for_a_camera(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    compared: list[Tracer] = []
    own = Tracer._compared_in_order

    def noted(tracer: Tracer) -> Any:
        compared.append(tracer)
        return own(tracer)

    monkeypatch.setattr(Tracer, "_compared_in_order", noted)
    scene = scene.changed({"camera.lens.stop_semi_diameter_mm": 2.03125})
    changes = ({}, {"transport.seed": 3}, {"targets[1].position_mm": [0.0, 0.0, -530.0]}, {"lights": []})
    orders = [Tracer(lf.build(scene.changed(change))).order for change in changes]
    assert len(compared) == 1
    assert all(order is orders[0] for order in orders)
    Tracer(lf.build(scene.changed({"camera.lens.stop_semi_diameter_mm": 2.015625})))
    assert len(compared) == 2
    forward = scene.changed({"transport.method": "forward"})
    for lights in (forward, forward.changed({"lights[0].power_w": 3.0})):
        Tracer(lf.build(lights))
    assert len(compared) == 4, "packets of lamps come by what stands before the camera"
