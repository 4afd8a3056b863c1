"""The words round a drawn page: all of them, none of them taken for markup, nothing fetched."""

import re
from types import SimpleNamespace
from typing import Any

import pytest

from lfmesh.view.output.html import captioned

PAGE = """<!DOCTYPE html><html><head><title>PyVista</title><style>
    </style>
  </head>
  <body><script>icon("https://kitware.github.io/vtk-js/icon/favicon.ico")</script></body></html>"""


@pytest.fixture
def view() -> Any:
    legend = SimpleNamespace(title="<wavelength>", entries=[("#ff0000", "650 nm & more")])
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
