"""The words round a drawn page: all of them, none of them taken for markup, nothing fetched."""

import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import lfmesh
from lfmesh.view.output.html import captioned
from tests.processor_time import HANGS_S

PAGE = """<!DOCTYPE html><html><head><title>PyVista</title><style>
    </style>
  </head>
  <body><script>icon("https://kitware.github.io/vtk-js/icon/favicon.ico")</script></body></html>"""


@pytest.fixture
def view() -> Any:
    legend = SimpleNamespace(title="<wavelength>", entries=[("650 nm & more", "#ff0000")])
    return SimpleNamespace(title='a <b> "c"', caption=["6 rays <from>", "18 paths"], scale="1 mm", legend=legend)


def test_the_words_stand_in_the_page_as_text(view: Any) -> None:
    page = captioned(PAGE, view)
    assert "<title>a &lt;b&gt; &#34;c&#34;</title>" in page
    for words in ("<h1>a &lt;b&gt;", "<p>6 rays &lt;from&gt;</p>", "<p>18 paths</p>", "&lt;wavelength&gt;"):
        assert words in page
    assert '<p style="color: #ff0000">650 nm &amp; more</p>' in page
    assert "<from>" not in page
    assert page.index('class="content"') < page.index('id="caption"') < page.index("<script>")


def test_without_colours_there_is_no_legend(view: Any) -> None:
    view.legend = None
    assert 'id="legend"' not in captioned(PAGE, view)


def test_the_icon_is_not_fetched(view: Any) -> None:
    assert not re.search(r"https?://", captioned(PAGE, view))


OFFLINE = """
import socket, sys
from lfmesh.cli import main
connect, look_up = socket.socket.connect, socket.getaddrinfo
def inside(host):
    if host not in ("127.0.0.1", "localhost", "::1", "", None):
        print("asked for", host)
        raise OSError("no network")
def guarded(self, address):
    if self.family != socket.AF_UNIX:
        inside(address[0])
    return connect(self, address)
def names(host, *rest, **more):
    inside(host)
    return look_up(host, *rest, **more)
socket.socket.connect, socket.getaddrinfo = guarded, names
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.drawing
def test_a_page_is_written_without_a_network(scene_file: Path, tmp_path: Path) -> None:
    page = tmp_path / "out.html"
    command = ["view", str(scene_file), "--rays", "field 0,0,-190", "--count", "4", "--html", str(page)]
    done = subprocess.run(
        [sys.executable, "-c", OFFLINE, *command],
        capture_output=True, text=True, timeout=HANGS_S, cwd=Path(lfmesh.__file__).parents[1],
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "asked for" not in done.stdout
    assert "Traceback" not in done.stderr
    written = page.read_text(encoding="utf-8")
    assert re.search(r'<p style="color: #[0-9a-f]{6}">587.6 nm</p>', written), "a line of the legend says what it is"
