"""What tools/docs writes of the program itself: every table, command, name and scene is there."""

import importlib
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import lfmesh
from lfmesh.cli import app
from lfmesh.scene import Scene
from lfmesh.study.datasets.dataset_file import DatasetFile
from lfmesh.study.metrics.metrics import METRICS
from lfmesh.study.optimise.design_file import DesignFile
from lfmesh.study.optimise.figures import FIGURES
from lfmesh.study.sweeps.study_file import StudyFile
from tests.conftest import chromium

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def reference(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    return importlib.import_module("docs_reference")


Tools = Callable[[str], ModuleType]


@pytest.fixture
def tools(monkeypatch: pytest.MonkeyPatch) -> Tools:
    """Return a function that imports a module of tools/."""
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    return importlib.import_module


@pytest.fixture
def pictures(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    return importlib.import_module("docs_gallery")


FILES = {"scene": Scene, "study": StudyFile, "design": DesignFile, "dataset": DatasetFile}


@pytest.mark.parametrize("kind", FILES)
def test_the_reference_has_every_table_and_key_of_each_kind_of_file(reference: ModuleType, kind: str) -> None:
    page, schema = reference.file_pages()[kind], FILES[kind].model_json_schema()
    for name, table in {FILES[kind].__name__: schema, **schema["$defs"]}.items():
        section = page.split(f"\n(table-{name.lower()})=\n")[1].split("\n(table-")[0]
        for key in table["properties"]:
            assert section.count(f"\n```{{key}} {name}.{key}\n") == 1, f"{name}.{key}"
    assert "(no description)" not in page
    assert ("any value" in page) == (kind != "scene"), "what a study gives to a path may be anything"


def test_names_of_tables_are_those_of_one_page_alone(reference: ModuleType) -> None:
    pages = reference.file_pages().values()
    targets = [each for page in pages for each in re.findall(r"^\((table-\w+)\)=$", page, re.MULTILINE)]
    assert sorted(set(targets)) == sorted(targets)


def test_the_reference_lists_every_metric(reference: ModuleType) -> None:
    pages = reference.file_pages()
    for name, metric in METRICS.items():
        (row,) = [line for line in pages["study"].splitlines() if line.startswith(f"| `{name}` |")]
        assert all(f"`{column.name}`" in row for column in metric.columns)
    for name in FIGURES:
        assert sum(f"`{name}`" in line for line in pages["design"].splitlines() if line.startswith("|")) == 1, name


@pytest.mark.parametrize(
    ("field", "words"),
    [
        ({"type": "number", "exclusiveMinimum": 0, "maximum": 1e15}, "number (> 0)"),
        ({"anyOf": [{"$ref": "#/$defs/Cover"}, {"type": "null"}]}, "[Cover](#table-cover)"),
        ({"enum": ["rgb", "xyz"]}, '`"rgb"` or `"xyz"`'),
        ({"type": "array", "prefixItems": [{"type": "integer", "minimum": 1}] * 2}, "list of 2: whole number (≥ 1)"),
        (
            {"type": "object", "additionalProperties": {"$ref": "#/$defs/Coating"}},
            "table of [Coating](#table-coating) by name",
        ),
    ],
)
def test_a_type_is_said_in_words(reference: ModuleType, field: dict[str, Any], words: str) -> None:
    assert reference.type_in_words(field) == words


def test_the_reference_has_every_command_with_its_help(reference: ModuleType) -> None:
    page = reference.commands_page()
    named = {heading.removeprefix("## lfmesh ") for heading in page.splitlines() if heading.startswith("## ")}
    top = {name for name in app if not name.startswith("-")}
    assert {name.split()[0] for name in named} == top
    assert {"lens list", "lens convert", "lens sheet", "render"} <= named
    assert page.count("Usage: lfmesh") == len(named)
    assert set(re.findall(r"^```\{command\} (.+)\n:no-typesetting:$", page, flags=re.MULTILINE)) == named


def test_the_python_reference_has_every_public_name_once_below_an_example(tools: Tools) -> None:
    folder = ROOT / "assets" / "docs" / "python"
    pages = tools("docs_python").with_names({path.stem: path.read_text() for path in folder.glob("*.md")})
    for name in set(lfmesh.__all__) - {"__version__"}:
        assert sum(line.endswith(f":: {name}") for text in pages.values() for line in text.splitlines()) == 1, name
    for text in pages.values():
        assert 0 < text.index("```python") < text.index("\n## Names\n")
    assert ".. autofunction:: render\n" in pages["render"]
    assert ".. autoclass:: Lens\n" in pages["camera"]


def test_a_public_name_without_a_page_is_refused(tools: Tools) -> None:
    with_names = tools("docs_python").with_names
    with pytest.raises(ValueError, match=r"lf\.\w+, of .*, belongs to no page"):
        with_names({"rays": "<!-- names: transport -->"})
    with pytest.raises(ValueError, match="scene belongs to one and to two"):
        with_names({"one": "<!-- names: scene -->", "two": "<!-- names: scene -->"})
    with pytest.raises(ValueError, match="needs one line"):
        with_names({"one": "# Names"})


ARTICLES = re.compile(r"^(?:the|an?) ")


def titles(reference: ModuleType) -> dict[str, str]:
    """Return the title in the sidebar of every page, by the page."""
    docs = ROOT / "assets" / "docs"
    generated = {**reference.file_pages(), "commands": reference.commands_page()}
    generated |= {"gallery": "# Gallery\n", "validation": "# Figures of the validation\n"}
    found: dict[str, str] = {}
    for page in docs.glob("*.md"):
        for listed in re.findall(r"^```\{toctree\}\n(.*?)^```$", page.read_text(), flags=re.MULTILINE | re.DOTALL):
            for line in filter(None, listed.splitlines()):
                if line.startswith(":"):
                    continue
                named = re.fullmatch(r"(.+) <(.+)>", line)
                path = named[2] if named else line
                source = ROOT / path.lstrip("/") if path.startswith("/") else docs / path
                if path.startswith("generated/"):
                    text = generated[Path(path).name]
                elif source.with_suffix(".ipynb").is_file():
                    text = "".join(json.loads(source.with_suffix(".ipynb").read_text())["cells"][0]["source"]) + "\n"
                else:
                    text = source.with_name(f"{source.name}.md").read_text()
                assert path not in found, f"{path} is listed twice"
                found[path] = named[1] if named else re.findall(r"^# (.+)$", text, flags=re.MULTILINE)[0]
    return found


def test_no_two_pages_have_the_same_title_in_the_sidebar(reference: ModuleType) -> None:
    found = {path: ARTICLES.sub("", title.lower()) for path, title in titles(reference).items()}
    assert len(found) > 60
    twins = {title for title in found.values() if list(found.values()).count(title) > 1}
    assert not twins
    assert "lfmesh" not in found.values(), "the title of the site"


def test_the_site_has_the_cameras_of_lfmesh_new(tools: Tools, tmp_path: Path) -> None:
    pytest.importorskip("furo")
    docs = tools("docs")
    docs.copy_sources(tmp_path, {Path("assets/docs/start.md"): b"another text"})
    names = {path.name for path in (ROOT / "assets" / "cameras").glob("*.toml")}
    assert names == {path.name for path in (tmp_path / "assets" / "cameras").iterdir()}
    assert (tmp_path / "assets" / "docs" / "start.md").read_text() == "another text"


def test_wide_tables_have_their_headings_in_every_cell_that_is_not_empty(tools: Tools) -> None:
    pytest.importorskip("furo")
    from docutils.core import publish_doctree

    wide = "+---+---+---+\n| a | b | c |\n+===+===+===+\n| 1 |   | 3 |\n+---+---+---+\n"
    page = publish_doctree(f"{wide}\n\n=== ===\na   b\n=== ===\n1   2\n=== ===\n")
    tools("docs_site").label_cells(None, page)
    first, second = page.findall(lambda node: node.tagname == "table")
    assert "wide" in first["classes"]
    assert "wide" not in second["classes"]
    cells = list(first.findall(lambda node: node.tagname == "entry"))[3:]
    assert [cell.astext().split() for cell in cells] == [["a", "1"], [], ["c", "3"]]
    assert ["empty" in cell["classes"] for cell in cells] == [False, True, False]
    assert cells[0].children[0]["classes"] == ["cell-label"]


def test_broken_links_of_a_site_are_found(tools: Tools, tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.html").write_text(
        '<p id="here"><a href="../b.html#there">1</a><a href="#here">2</a><a href="../b.html?x=1">3</a>'
        '<a href="https://example.org/none">4</a><img src="none.png"><a href="../b.html#nowhere">5</a>'
        '<a href="#no">6</a>'
    )
    (tmp_path / "b.html").write_text('<a name="there" href="in/a%2Ehtml">7</a><link href="in/none.css">')
    assert list(tools("docs_links").broken_links(tmp_path)) == [
        "b.html: in/none.css: there is no such file",
        "in/a.html: none.png: there is no such file",
        "in/a.html: ../b.html#nowhere: the page has no such place",
        "in/a.html: #no: the page has no such place",
    ]


def test_the_accuracy_of_the_site_is_measured_once_for_a_program(
    tools: Tools, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = tools("docs_accuracy")
    measured: list[str] = []

    class Report:
        def write(self, folder: Path) -> None:
            folder.mkdir(parents=True)

    monkeypatch.setattr(made, "measure", lambda scene: measured.append(scene.name) or Report())
    monkeypatch.setattr(made.make_pictures, "from_report", lambda folder, picture: picture.write_bytes(b"figure"))
    assert made.accuracy_picture(tmp_path, "one", quick=True) is None
    for program in ("one", "one", "two"):
        picture = made.accuracy_picture(tmp_path, program, quick=False)
        assert picture.read_bytes() == b"figure"
    assert measured == ["first light", "first light"]
    assert made.accuracy_picture(tmp_path, "two", quick=True) == picture


def test_a_render_is_kept_until_scene_or_program_change(pictures: ModuleType) -> None:
    scene = pictures.reduced(lfmesh.load(ROOT / "assets/scenes/lytro_class.toml"))
    assert max(scene.camera.sensor.pixels) == pictures.MOST_PIXELS
    first = pictures.digest(scene, "one")
    assert pictures.digest(scene, "one") == first
    assert pictures.digest(scene, "two") != first
    assert pictures.digest(scene.changed({"transport.seed": 12345}), "one") != first


def test_the_gallery_lists_every_scene_and_shows_what_was_rendered(pictures: ModuleType, tmp_path: Path) -> None:
    path = ROOT / "assets/scenes/conventional.toml"
    kept = tmp_path / "renders" / f"{path.stem}-{pictures.digest(pictures.reduced(lfmesh.load(path)), 'one')}"
    small = lfmesh.load(path).changed({"camera.sensor.pixels": [16, 16], "transport.samples": 8})
    kept.mkdir(parents=True)
    pictures.rendered(small, kept)
    assert json.loads((kept / "facts.json").read_text())["seconds"] > 0.0
    (kept / "facts.json").write_text(json.dumps({"seconds": 1.0, "warnings": ["TooFewSamplesWarning"]}))
    page, warns = pictures.gallery(tmp_path / "renders", tmp_path / "pages", "one", quick=True)
    scenes = {scene.stem for scene in (ROOT / "assets/scenes").glob("*.toml")}
    assert {line.removeprefix("## ") for line in page.splitlines() if line.startswith("## ")} == scenes
    assert (tmp_path / "pages" / "conventional-preview.png").is_file()
    assert page.count("Not rendered in this build.") == len(scenes) - 1
    assert "[TooFewSamplesWarning](../warnings/TooFewSamplesWarning.md)" in page
    assert warns == {"TooFewSamplesWarning": ["conventional"]}
    own = tmp_path / "warnings" / "TooFewSamplesWarning.md"
    section = pictures.warned(warns["TooFewSamplesWarning"], tmp_path / "pages", own)
    assert "![conventional](../pages/conventional-preview.png)" in section
    assert "[conventional](../pages/gallery.md#conventional)" in section
    assert pictures.warned([], tmp_path / "pages", own) == ""


CASE = """
\"\"\"A truth.

Its source: a_b.

    y = f(x)
\"\"\"
import numpy as np
import pytest

def test_passes():
    assert abs(1.25 - 1.0) < 0.5
    assert np.float64(0.1) <= 1
    assert 2.003 == pytest.approx(2.0, abs=0.004)
    np.testing.assert_allclose([1.0, 10.0, np.nan], [1.0, 10.3, np.nan], atol=0.1, rtol=0.1)
    assert "a" < "b"
    assert 0.1 < 0.2 < 0.3
    assert (0.1
            < 0.4)

def test_fails():
    np.testing.assert_allclose(1.0, 2.0)

@pytest.mark.skip
def test_is_left_out():
    pass
"""


def test_figures_of_the_validation_are_those_that_its_comparisons_have(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    pages = importlib.import_module("docs_validation")
    path = tmp_path / "tests" / "validation" / "test_case_one.py"
    path.parent.mkdir(parents=True)
    path.write_text(CASE)
    monkeypatch.setattr(pages, "ROOT", tmp_path)
    monkeypatch.setattr(pages, "CASES", path.parent)
    assert pages.validation(tmp_path / "kept", "one", quick=True)[1]
    page, passed = pages.validation(tmp_path / "kept", "one", quick=False)
    assert not passed
    assert "## Case one\n\nA truth.\n\nIts source: a\\_b.\n\n```text\n    y = f(x)\n```\n" in page
    assert "`tools/test tests/validation/test_case_one.py`: 1 passed, 1 failed, 1 skipped, in" in page
    (found,) = (tmp_path / "kept").glob("*.json")
    comparisons = json.loads(found.read_text())["comparisons"]
    assert {each["what"]: (round(each["value"], 6), round(each["limit"], 6)) for each in comparisons} == {
        "abs(1.25 - 1.0) < 0.5": (0.25, 0.5),
        "np.float64(0.1) <= 1": (0.1, 1.0),
        "(0.1 < 0.4)": (0.1, 0.4),
        "2.003 == pytest.approx(2.0, abs=0.004)": (0.003, 0.004),
        "np.testing.assert_allclose([1.0, 10.0, np.nan], [1.0, 10.3, np.nan], atol=0.1, rtol=0.1)": (0.3, 1.13),
    }
    rows = [line for line in page.splitlines() if line.startswith("| `")]
    assert [row.split("|")[2].strip() for row in rows] == ["0.003", "0.25", "0.3"]
    assert pages.validation(tmp_path / "kept", "two", quick=True)[0].endswith("Not run in this build.\n")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the site, built without renders: any warning or broken link would fail it."""
    pytest.importorskip("furo")
    folder = tmp_path_factory.mktemp("site")
    built = subprocess.run(
        [sys.executable, str(ROOT / "tools" / "docs.py"), str(folder), "--quick"],
        capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(ROOT)}, timeout=1200,
    )  # fmt: skip
    assert built.returncode == 0, built.stderr
    return folder / "html"


@pytest.fixture(scope="module")
def browser(site: Path) -> Iterator[Any]:
    """Return a browser's page of 390 pixels' width."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        running = driver.chromium.launch(executable_path=chromium(), args=["--no-sandbox"])
        yield running.new_page(viewport={"width": 390, "height": 844})
        running.close()


@pytest.mark.long
def test_the_site_builds_without_a_warning_and_loads_nothing_from_the_network(site: Path) -> None:
    pages = {path: path.read_text(encoding="utf-8") for path in site.rglob("*.html")}
    assert {"start.html", "render.html", "ghost_hunt.html", "README.html"} <= {path.name for path in pages}
    assert {f"{path.stem}.html" for path in (ROOT / "assets/docs/warnings").iterdir()} <= {path.name for path in pages}
    for path, text in pages.items():
        assert not re.findall(r"<(?:script|link|img)\b[^>]*\b(?:src|href)=\"https?://", text), path


@pytest.mark.long
def test_signatures_of_the_python_reference_have_no_types(site: Path) -> None:
    """Types stand in the sections of the docstring, in words: numpy's aliases are spelt out at great length."""
    for path in (site / "assets" / "docs" / "python").glob("*.html"):
        signatures = re.findall(r"<dt class=\"sig[^>]*>(.*?)</dt>", path.read_text(encoding="utf-8"), flags=re.DOTALL)
        assert signatures, path
        for text in (re.sub(r"<[^>]+>", "", each) for each in signatures):
            assert not re.search(r"dtype|ndarray|NDArray|numpy\.|typing\.|_ScalarType", text), text


@pytest.mark.long
@pytest.mark.browser
def test_every_page_and_its_tables_fit_a_screen_of_390_pixels(site: Path, browser: Any) -> None:
    wide = (
        "() => [...document.querySelectorAll('.table-wrapper')].filter(e => e.scrollWidth > e.clientWidth + 1).length"
    )
    for path in sorted(site.rglob("*.html")):
        browser.goto(path.as_uri())
        assert browser.evaluate(wide) == 0, path
        assert browser.evaluate("document.documentElement.scrollWidth") <= 390, path


@pytest.mark.long
@pytest.mark.browser
@pytest.mark.parametrize(
    ("query", "target"),
    [
        ("stop_semi_diameter_mm", "generated/scene.html#key-Lens.stop_semi_diameter_mm"),
        ("radius_mm", "generated/scene.html#key-Surface.radius_mm"),
        ("BlackPictureWarning", "warnings/BlackPictureWarning.html"),
        ("refocus", "generated/commands.html#command-refocus"),
        ("lens convert", "generated/commands.html#command-lens-convert"),
        ("estimate_depth", "python/lightfield.html#lfmesh.estimate_depth"),
    ],
)
def test_the_search_finds_keys_commands_warnings_and_names(site: Path, browser: Any, query: str, target: str) -> None:
    browser.goto(f"{(site / 'search.html').as_uri()}?q={query.replace(' ', '+')}")
    browser.wait_for_function("document.querySelector('.search-summary')?.innerText.includes('found')")
    links = browser.eval_on_selector_all("ul.search > li > a", "all => all.map(a => a.href)")
    assert any(link.endswith(target) for link in links[:12]), links
