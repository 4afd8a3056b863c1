"""The light-field part of the page without a browser: clicks before its tab is filled, and marked pixels."""

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.files import run
from lfmesh.scene import Scene
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
