"""The pages of the documentation site do what they say: commands and snippets run, every warning is explained."""

import importlib
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import lfmesh as lf
from lfmesh import errors
from lfmesh.cli import main

ROOT = Path(__file__).resolve().parents[1]
PAGES = {path.stem: path.read_text(encoding="utf-8") for path in (ROOT / "assets" / "docs").glob("*.md")}


def blocks(language: str, page: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", PAGES[page], flags=re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the scene of the first page and fewer lenslets, as other pages go on from."""
    return with_scene(tmp_path_factory.mktemp("site"))


@pytest.fixture(scope="module")
def reference_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return such a folder for the examples of the Python reference, which write other files of the same names."""
    return with_scene(tmp_path_factory.mktemp("python"))


def with_scene(place: Path) -> Path:
    """Write the scene of the first page, with fewer lenslets, into a folder; return the folder."""
    (scene,) = blocks("toml", "start")
    small = scene.replace("count = [24, 24]", "count = [8, 8]").replace("pixels = [240, 240]", "pixels = [80, 80]")
    assert small.count("[8, 8]") == small.count("[80, 80]") == 1
    (place / "scene.toml").write_text(small)
    return place


def test_the_first_scene_is_that_of_the_readme() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (first,) = re.findall(r"^```toml\n(.*?)^```$", readme, flags=re.MULTILINE | re.DOTALL)
    (ours,) = blocks("toml", "start")
    assert first == ours


@pytest.mark.parametrize("page", ["start", "howto"])
def test_commands_and_snippets_run_in_their_order(page: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    ran = 0
    for language, block in re.findall(r"^```(sh|python)\n(.*?)^```$", PAGES[page], flags=re.MULTILINE | re.DOTALL):
        if language == "python":
            text = block.replace("120, 120", "40, 40")
            done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True)
            assert (done.returncode, done.stderr) == (0, ""), block
            ran += 1
            continue
        for line in block.splitlines():
            program, *words = shlex.split(line)
            assert program == "lfmesh"
            if "--resume" in words:  # nothing was killed here: it says so
                assert main(words) in (0, 2)
                continue
            assert main(words) == 0, line
            ran += 1
    assert ran >= 4


GUIDES = re.findall(r"^(\w+)$", PAGES["guides"], flags=re.MULTILINE)
"""Pages of the list of guides, each with files of its own."""


@pytest.mark.parametrize("page", GUIDES)
def test_a_guide_runs_from_an_empty_folder(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each file has its name in its first line; the snippets of a page share their names, as in one session."""
    monkeypatch.chdir(tmp_path)
    session: dict[str, object] = {"__name__": "__main__"}
    ran = 0
    for language, block in re.findall(r"^```(toml|sh|python)\n(.*?)^```$", PAGES[page], flags=re.MULTILINE | re.DOTALL):
        ran += language != "toml"
        if language == "toml":
            name = re.match(r"# (\w+\.toml)\n", block)
            assert name, block
            Path(name[1]).write_text(block)
        elif language == "python":
            exec(compile(block, page, "exec"), session)
        else:
            for line in block.splitlines():
                program, *words = shlex.split(line)
                assert program == "lfmesh"
                assert main(words) == 0, line
    assert ran >= 3


TASKS = re.findall(r"^python/(\w+)$", PAGES["python"], flags=re.MULTILINE)
"""Pages of the Python reference, in their order."""


def test_the_examples_of_the_python_reference_run_in_their_order(
    reference_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The example on drawing, which may lack the libraries for it, has a test of its own."""
    monkeypatch.chdir(reference_folder)
    for page in TASKS:
        if page != "views":
            run_example(page)


@pytest.mark.drawing
def test_the_example_on_drawing_runs(reference_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(reference_folder)
    run_example("views")
    assert Path("rays.png").is_file()


def run_example(page: str) -> None:
    """Run the one example of a page of the Python reference."""
    text = (ROOT / "assets" / "docs" / "python" / f"{page}.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"^```python\n(.*?)^```$", text, flags=re.MULTILINE | re.DOTALL)
    exec(compile(example, page, "exec"), {"__name__": "__main__"})


def test_every_task_of_the_python_reference_is_in_its_table() -> None:
    assert re.findall(r"^\| \[[^]]+\]\(python/(\w+)\.md\)", PAGES["python"], flags=re.MULTILINE) == TASKS
    assert {path.stem for path in (ROOT / "assets" / "docs" / "python").glob("*.md")} == set(TASKS)


def test_every_warning_has_a_page_and_stands_in_the_order_of_importance() -> None:
    rows = re.findall(r"^\| \[(\w+)\]\(warnings/(\w+)\.md\) \| (.+) \|$", PAGES["warnings"], flags=re.MULTILINE)
    explained = [name for name, _, _ in rows]
    assert explained == [page for _, page, _ in rows]
    assert explained == re.findall(r"^warnings/(\w+)$", PAGES["warnings"], flags=re.MULTILINE)
    for name, _, meaning in rows:
        text = " ".join((ROOT / "assets" / "docs" / "warnings" / f"{name}.md").read_text(encoding="utf-8").split())
        assert text.startswith(f"# {name} **{meaning.rstrip('.')}"), name
    others = [name for name, each in vars(errors).items() if isinstance(each, type) and each.__base__ is UserWarning]
    pictures = [each.__name__ for each in lf.PictureWarning.__subclasses__()]
    assert explained == [*pictures, *(name for name in others if name != "PictureWarning")]


def test_the_settings_of_the_guide_to_decoders_are_those_that_decode(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    import interop

    from lfmesh.files.exports.plenopticam import _SETTINGS

    installs = [shlex.split(line) for line in PAGES["interop"].splitlines() if " -m pip install " in line]
    wanted = [packages for steps in interop.INSTALLATIONS.values() for packages in steps]
    assert [words[words.index("install") + 1 :] for words in installs] == wanted
    assert f'cal_meth = "{_SETTINGS["cal_meth"]}"' in PAGES["interop"]


def test_a_picture_of_a_warning_is_on_its_page(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    drawn = set(importlib.import_module("make_warnings").PAIRS)
    assert drawn == {path.stem for path in (ROOT / "assets" / "pictures").glob("*Warning.png")}
    for path in (ROOT / "assets" / "docs" / "warnings").glob("*.md"):
        text = path.read_text(encoding="utf-8")
        assert (f"](../../pictures/{path.stem}.png)\n\n" in text) == (path.stem in drawn)
        assert ("Left:" in text) == (path.stem in drawn), "says what is shown"
