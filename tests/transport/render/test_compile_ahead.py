"""Compiling in a second process: it compiles what a render needs, only where nothing is cached, and never disturbs."""

import json
import subprocess
import sys
from typing import Any

import pytest

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.errors import LfmeshError
from lfmesh.transport.regions.objects import shade_objects
from lfmesh.transport.render import compile_ahead
from lfmesh.transport.render.compile_ahead import Ahead
from tests.instances import instances

SIGNATURES = """
import json
import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.geometry.objects.targets import is_met_exactly
from lfmesh.transport.regions import lens, mla, mla_plate, objects, sensor
from lfmesh.transport.render.compile_ahead import EVERYWHERE, ON_IMAGE_PATH, compile_launches, compile_stations
from lfmesh.transport.sources import pixels
from lfmesh.transport.sequences import ghosts, image_path
from lfmesh.transport.build import build

regions = [mla.admit_to_cells, mla.shade_cells, mla_plate.through_plate, lens.admit_to_lens, lens.shade_lens,
    objects.admit_to_objects, objects.shade_objects, sensor.onto_sensor]
launches = [pixels.launch_adjoint, ghosts._leave_pixels, ghosts._draw_sequences, ghosts._hand_on,
    ghosts.follow_rays, pixels.launch_along_image_path, image_path.follow_image_path]
small = {{"camera.sensor.pixels": [8, 8], "transport.samples": 4, "transport.replicates": 2, "transport.threads": 1,
    "transport.split": "{split}"}}
scene = lf.load(asset_path("scenes/{scene}.toml")).changed(small)
alone = "{split}" == "transmit"
glass = len(scene.bodies()) > 0
rounds = any(is_met_exactly(target, scene) for target in scene.targets)
compile_stations(ON_IMAGE_PATH if alone else EVERYWHERE, glass=glass, rounds=rounds)
compile_launches(build(scene))
before = [len(kernel.signatures) for kernel in regions + launches]
lf.render(scene)
print(json.dumps([before, [len(kernel.signatures) for kernel in regions + launches]]))
"""


@pytest.mark.parametrize(
    "scene", instances(["first_light", "lit_chart", "aquarium", "tank"], long=["lit_chart", "aquarium", "tank"])
)
def test_all_that_a_render_needs_is_compiled_ahead(scene: str) -> None:
    code = SIGNATURES.format(scene=scene, split="both")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    before, after = json.loads(done.stdout)
    assert before == after == [1] * len(before)


def test_what_the_image_path_alone_needs_is_compiled_ahead() -> None:
    code = SIGNATURES.format(scene="first_light", split="transmit")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    before, after = json.loads(done.stdout)
    assert before == after
    assert before[-2:] == [1, 1]


def scene_of(**transport: Any) -> lf.Scene:
    small = {"camera.sensor.pixels": [4, 4], "transport.samples": 2, "transport.replicates": 2}
    changes = small | {f"transport.{key}": value for key, value in transport.items()}
    return lf.load(asset_path("scenes/first_light.toml")).changed(changes)


def test_nothing_is_started_where_kernels_are_cached() -> None:
    lf.render(scene_of())
    assert shade_objects.signatures
    assert Ahead(scene_of())._process is None


def test_nothing_is_started_on_a_single_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compile_ahead, "is_cached", lambda kernel: False)
    monkeypatch.setattr(compile_ahead, "processors", lambda: 1)
    assert Ahead(scene_of())._process is None


@pytest.mark.parametrize("python", ["no/such/program", "false"])
def test_a_render_does_without_a_process_that_fails(python: str, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = lf.render(scene_of())
    monkeypatch.setattr(compile_ahead, "is_cached", lambda kernel: False)
    monkeypatch.setattr(compile_ahead.sys, "executable", python)
    image = lf.render(scene_of())
    assert (image.mean == expected.mean).all()


def test_a_first_render_tells_how_much_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compile_ahead, "is_cached", lambda kernel: False)
    heard: list[lf.Progress] = []
    lf.render(scene_of(), progress=heard.append)
    compiling = [each for each in heard if each.stage == compile_ahead.STAGE]
    assert heard[: len(compiling)] == compiling
    done = [each.done for each in compiling]
    assert done == sorted(set(done))
    # The world, its parts (image path with other paths, ghosts), and seven steps of the other process.
    assert done[0] == 0 < len(compiling) - 3
    assert compiling[-1].done == compiling[-1].total


def test_a_render_of_cached_kernels_tells_of_no_compiling() -> None:
    lf.render(scene_of())
    heard: list[lf.Progress] = []
    lf.render(scene_of(), progress=heard.append)
    assert {each.stage for each in heard} <= {"tracing"}


def test_the_process_ends_with_a_build_that_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[subprocess.Popen[bytes]] = []
    start = subprocess.Popen

    def noted(*command: Any, **options: Any) -> subprocess.Popen[bytes]:
        started.append(start(*command, **options))
        return started[-1]

    monkeypatch.setattr(compile_ahead, "is_cached", lambda kernel: False)
    monkeypatch.setattr(compile_ahead, "_CHILD", "import time; time.sleep(600)")
    monkeypatch.setattr(compile_ahead.subprocess, "Popen", noted)
    inside = scene_of().changed({"targets[0].position_mm": [0.0, 0.0, 20.0]})
    with pytest.raises(LfmeshError, match="into the camera"):
        lf.render(inside)
    assert [process.poll() is not None for process in started] == [True]


@pytest.mark.parametrize(
    ("changes", "asked"),
    [
        ({}, (compile_ahead.EVERYWHERE, False, False)),
        ({"transport.split": "transmit"}, (((2, False), (0, True)), False, False)),
        ({"targets[0]": compile_ahead.GLASS}, (compile_ahead.EVERYWHERE, True, False)),
        ({"targets[0]": compile_ahead.BALL}, (compile_ahead.EVERYWHERE, False, True)),
    ],
    ids=["all paths", "image path", "glass", "ball"],
)
def test_only_what_the_scene_needs_is_compiled(
    changes: dict[str, Any], asked: tuple[Any, bool, bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    started = []
    monkeypatch.setattr(compile_ahead, "is_cached", lambda kernel: False)
    monkeypatch.setattr(compile_ahead.subprocess, "Popen", lambda command, **_: started.append(command))
    Ahead(scene_of().changed({"transport.split": "both"} | changes))
    stations, glass, rounds = asked
    assert f"compile_stations({stations!r}, glass={glass}, rounds={rounds}, " in started[0][-1]
