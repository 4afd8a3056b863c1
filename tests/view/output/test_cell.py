"""A scene in a notebook: a page that turns, small enough for a cell, or a still picture that says why."""

import base64
import html
import io
import re
import shutil
import signal
import sys
from collections.abc import Callable
from importlib import util
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.view import show
from lfmesh.view.output import cell
from lfmesh.view.output import html as pages
from lfmesh.view.scene3d.plotter import View
from tests.processor_time import HANGS_S
from tests.view.browser.test_page import CHROMIUM, not_blank

pytestmark = pytest.mark.drawing

MOST_BYTES = 3_000_000
"""Of the output of a cell."""


@pytest.fixture
def notebook(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(show, "in_notebook", lambda: True)


def outputs(shown: Any) -> dict[str, str]:
    """Return what a notebook stores of a value, by kind, as IPython asks for it."""
    formatters = pytest.importorskip("IPython.core.formatters")
    data, _ = formatters.DisplayFormatter().format(shown)
    return {
        kind: base64.b64encode(value).decode() if isinstance(value, bytes) else value for kind, value in data.items()
    }


def page_in(text: str) -> str:
    (content,) = re.findall(r'<iframe srcdoc="([^"]*)"', text)
    return html.unescape(content)


@pytest.mark.usefixtures("notebook")
def test_a_notebook_shows_a_page_that_turns(world: lf.World) -> None:
    shown = lf.show(world, "field 0,0,-190", count=4, size=(200, 120), preset="lens")
    assert isinstance(shown, PIL.Image.Image)
    data = outputs(shown)
    page = page_in(data["text/html"])
    assert "<h1>bench</h1>" in page
    assert "4 rays from field 0,0,-190" in page
    assert not re.search(r"""(?:src|href)=["']https?:""", page)
    still = PIL.Image.open(io.BytesIO(base64.b64decode(data["image/jpeg"])))
    assert still.size == (200, 120)
    assert "image/png" not in data


@pytest.mark.usefixtures("notebook")
@pytest.mark.parametrize("name", ["first_light", "flame"])
def test_a_cell_stays_below_three_megabytes(name: str) -> None:
    """Of 4096 lenslets a plate with some of them is drawn, of rays a selection, of pictures small ones."""
    data = outputs(lf.show(asset_path(f"scenes/{name}.toml")))
    assert "<iframe" in data["text/html"]
    assert sum(len(value.encode()) for value in data.values()) < MOST_BYTES


@pytest.mark.usefixtures("notebook")
def test_without_the_extra_the_picture_says_how_to_get_more(world: lf.World, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "trame_pyvista", None)
    assert util.find_spec("trame_pyvista") is None
    text = outputs(lf.show(world, "none", size=(200, 120)))["text/html"]
    assert 'pip install "lfmesh[browser]"' in html.unescape(text)
    (picture,) = re.findall(r'src="data:image/jpeg;base64,([^"]+)"', text)
    assert PIL.Image.open(io.BytesIO(base64.b64decode(picture))).size == (200, 120)
    with pytest.raises(lf.LfmeshError, match=r"the extra \"browser\""):
        pages.write_page(None, Path("out.html"))  # type: ignore[arg-type]


def test_a_page_that_is_too_large_is_a_picture_that_says_so(
    world: lf.World, views: Callable[..., View], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cell, "MOST_BYTES", 1000)
    shown = cell.shown_in_cell(views(world), PIL.Image.new("RGB", (20, 10)))
    text = html.unescape(shown._repr_html_())
    assert re.search(r"would take \d\.\d MB\. lf\.show\(\.\.\., html=\"scene\.html\"\)", text)
    assert "<iframe" not in text


def test_ctrl_c_works_after_a_page(world: lf.World, views: Callable[..., View]) -> None:
    """A server exports the page; its handlers of signals must not outlive it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        pages.page_of(views(world))
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.browser
@pytest.mark.usefixtures("notebook")
def test_the_page_draws_in_its_frame_and_turns(world: lf.World) -> None:

    from playwright.sync_api import sync_playwright

    text = outputs(lf.show(world, "field 0,0,-190", count=4, size=(640, 400)))["text/html"]
    with sync_playwright() as driver:
        chromium = next(filter(None, map(shutil.which, CHROMIUM)))
        running = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        tab = running.new_context(offline=True, viewport={"width": 700, "height": 450}).new_page()
        tab.set_default_timeout(1000.0 * HANGS_S)
        tab.set_content(f"<body>{text}</body>")
        frame = tab.frame_locator("iframe")
        frame.locator("canvas").first.wait_for()
        assert any(not_blank(frame) or tab.wait_for_timeout(250) for _ in range(int(4 * HANGS_S)))
        before = seen(frame)
        box = tab.locator("iframe").bounding_box()
        assert box is not None
        tab.mouse.move(box["x"] + 300, box["y"] + 200)
        tab.mouse.down()
        tab.mouse.move(box["x"] + 420, box["y"] + 240, steps=6)
        tab.mouse.up()
        assert any(
            np.abs(seen(frame) - before).mean() > 1.0 or tab.wait_for_timeout(250) for _ in range(int(4 * HANGS_S))
        )
        running.close()


def seen(frame: Any) -> np.ndarray:
    """What a frame's canvas shows, (height, width, 3)."""
    shot = frame.locator("canvas").first.screenshot()
    return np.asarray(PIL.Image.open(io.BytesIO(shot)).convert("RGB")).astype(float)
