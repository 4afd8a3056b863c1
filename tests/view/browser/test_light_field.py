"""The light-field part of the page without a browser: clicks before its tab is filled, and marked pixels."""

import asyncio
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.cli import main
from lfmesh.files import exr, run
from lfmesh.scene import Scene
from lfmesh.view.browser.background import Background
from lfmesh.view.browser.light_field import NO_LENSLET, LightFieldPanel
from lfmesh.view.browser.replies import Replies
from lfmesh.view.browser.subject import PageSubject
from tests.view.browser.pages import Server


@pytest.fixture
def folder(tmp_path: Path, camera: Callable[..., Scene], image_of: Callable[..., lf.Image]) -> Path:
    """A run with a random raw image."""
    scene = camera()
    columns, rows = scene.camera.sensor.pixels
    light = np.random.default_rng(4).uniform(0.5, 1.5, (rows, columns))
    run.save(image_of(scene, light), tmp_path / "run")
    return tmp_path / "run"


def opened(folder: Path) -> tuple[Server, LightFieldPanel]:
    """Return a page of a run whose tab of the light field has not been opened."""
    server = Server()
    return server, LightFieldPanel(server, Replies(server), PageSubject.read(folder))


@pytest.mark.parametrize(
    ("name", "arguments", "shown"),
    [("focus", (7,), "focus_src"), ("raw_pick", (0.5, 0.5), "epi_src"), ("parallax", (), "parallax")],
)
def test_a_click_before_the_light_field_is_read_is_answered(
    name: str, arguments: tuple[Any, ...], shown: str, folder: Path
) -> None:
    server, _ = opened(folder)

    async def click() -> None:
        server.answers[name](*arguments)
        await asyncio.sleep(0.01)

    asyncio.run(click())
    assert server.state.fault == ""
    assert getattr(server.state, shown)
    assert server.state.view_src, "the tab is filled with it"


def test_a_click_beside_all_micro_images_says_so(folder: Path) -> None:
    server, _ = opened(folder)
    server.answers["raw_whole"]()
    server.answers["raw_pick"](0.001, 0.001)
    assert server.state.fault == ""
    assert NO_LENSLET in server.state.raw_under


def test_a_page_without_a_light_field_says_why(folder: Path) -> None:
    server, _ = opened(folder)
    server.state.has_field, server.state.field_note = False, "a file of it is damaged"
    server.answers["parallax"]()
    assert server.state.fault == "a file of it is damaged"


def test_a_marked_area_stays_one_until_the_picture_moves(folder: Path) -> None:
    server, panel = opened(folder)
    panel.mark(range(40, 50), range(60, 65))
    assert panel.marked == (range(40, 50), range(60, 65))
    server.answers["raw_zoom"](0.5, 0.5, 2.0)
    assert (panel.marked, server.state.raw_marked) == (None, None)
    panel.mark(range(40, 41), range(60, 61))
    box = server.state.raw_marked
    server.answers["raw_zoom"](0.5, 0.5, 2.0)
    assert panel.marked == (range(40, 41), range(60, 61))
    assert server.state.raw_marked != box


def wait_for(server: Server, name: str) -> str:
    """Press a button of a job and wait until the job has ended; return what it said meanwhile."""

    async def press() -> None:
        server.answers[name]()
        await asyncio.sleep(0.01)
        while server.state.depth_progress:
            await asyncio.sleep(0.05)

    asyncio.run(press())
    return "; ".join(value for key, value in server.state.said if key == "depth_progress")


def test_depth_is_found_by_a_button_and_added_to_the_run(tmp_path: Path, camera: Callable[..., Scene]) -> None:
    """What it adds is what the command adds."""
    plane = {"shape": {"kind": "plane", "width_mm": 400.0, "height_mm": 400.0}, "position_mm": (0.0, 0.0, -420.0)}
    material = {"reflectance": 0.0, "radiance_w_m2_sr": 1.0, "texture": asset_path("charts/siemens.png").as_posix()}
    scene = camera().changed({"targets": [plane | {"material": material}], "transport.split": "transmit"})
    for name in ("page", "command"):
        run.save(lf.render(scene), tmp_path / name)
    server, panel = opened(tmp_path / "page")
    said = wait_for(server, "find_depth")
    assert server.state.fault == ""
    assert "depth: plane " in said or "true depth: view " in said
    assert server.state.depth_src
    assert server.state.depth_note
    assert main(["depth", str(tmp_path / "command")]) == 0
    for name in ("depth.exr", "depth_views.exr", "depth_pixels.exr"):
        found, expected = (exr.read_map(tmp_path / folder / name, ("Z",)) for folder in ("page", "command"))
        np.testing.assert_array_equal(found, expected)
    assert (tmp_path / "page" / "depth.png").is_file()
    panel.close()


def test_a_depth_that_cannot_be_found_says_why(
    tmp_path: Path, camera: Callable[..., Scene], image_of: Callable[..., lf.Image]
) -> None:
    scene = camera()
    columns, rows = scene.camera.sensor.pixels
    run.save(image_of(scene, np.zeros((rows, columns))), tmp_path / "run")
    server, panel = opened(tmp_path / "run")
    wait_for(server, "find_depth")
    assert "views" in server.state.fault
    assert not server.state.depth_src
    panel.close()


def test_a_job_of_a_closed_page_ends_at_its_next_message() -> None:
    server, told, ended = Server(), list[str](), threading.Event()
    background = Background(server, Replies(server))

    def job(say: Callable[[str], None]) -> None:
        try:
            while True:
                say("still at it")
                time.sleep(0.01)
        finally:
            ended.set()

    async def close() -> None:
        background.begin(job, told.append, lambda _: told.append("finished"))
        await asyncio.sleep(0.05)
        background.close()
        await asyncio.to_thread(ended.wait, 10.0)

    asyncio.run(close())
    assert ended.is_set()
    assert told
    assert "finished" not in told
