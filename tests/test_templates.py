"""HTML from templates: values are escaped, markup is kept, what is missing is noticed."""

from pathlib import Path

import jinja2
import pytest
from markupsafe import Markup

from lfmesh.templates import filled


@pytest.fixture
def template(tmp_path: Path) -> Path:
    path = tmp_path / "page.html"
    path.write_text("<p>{{ words }}</p>{{ drawing }}\n")
    return path


def test_text_is_escaped_and_markup_is_kept(template: Path) -> None:
    page = filled(template, words='<script> & "', drawing=Markup("<svg></svg>"))
    assert page == "<p>&lt;script&gt; &amp; &#34;</p><svg></svg>"


def test_a_missing_value_is_an_error(template: Path) -> None:
    with pytest.raises(jinja2.UndefinedError, match="drawing"):
        filled(template, words="")
