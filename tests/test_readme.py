"""The README does what it says: its scene renders, its Python runs, its commands and files exist."""

import os
import re
import shlex
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from cyclopts import CycloptsError

import lfmesh
from lfmesh.cli import app, main
from lfmesh.scene import first_order
from lfmesh.scene.model import Model

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = {
    path: path.read_text(encoding="utf-8")
    for path in (
        ROOT / "README.md",
        ROOT / "CONTRIBUTING.md",
        *ROOT.glob("assets/docs/*.md"),
        *(p for part in ("lfmesh", "tests", "tools") for p in ROOT.glob(f"{part}/**/README.md")),
    )
}
"""The README, those of the parts, which it names, and the pages of the site."""
COMMANDS = PAGES[ROOT / "lfmesh" / "cli" / "README.md"]


def blocks(language: str, page: str = README) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", page, flags=re.MULTILINE | re.DOTALL)


def commands(*pages: str) -> list[list[str]]:
    """Every command line of the shell blocks and of the tables; of all pages if none is given."""
    lines = []
    for page in pages or PAGES.values():
        lines += [line for block in blocks("sh", page) for line in block.replace("\\\n", " ").splitlines()]
        lines += re.findall(r"`((?:tools/|lfmesh )[^`]+)`", page)
    return [words for line in lines if (words := shlex.split(line, comments=True))]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the assets, as the checkout is, and the README's scene in it."""
    (scene,) = blocks("toml")
    (tmp_path / "scene.toml").write_text(scene)
    (tmp_path / "assets").symlink_to(ROOT / "assets")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_first_scene_has_ten_lines_and_nothing_to_warn_of(folder: Path) -> None:
    assert len((folder / "scene.toml").read_text().splitlines()) <= 10
    assert first_order(lfmesh.load("scene.toml")).warnings == ()


def test_the_first_scene_needs_no_other_file(tmp_path: Path) -> None:
    (scene,) = blocks("toml")
    assert lfmesh.first_order(lfmesh.loads(scene, tmp_path)).warnings == ()


def test_the_first_scene_renders_with_the_commands_given(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ours = [words[1:] for words in commands(README) if words[0] == "tools/run" and "scene.toml" in words]
    assert {words[0] for words in ours} == {"check", "render"}
    for words in ours:
        assert main(words) == 0
    image = lfmesh.open_run("run")
    picture = image.mean[..., 0]
    middle = picture[len(picture) // 4 : -len(picture) // 4]
    assert (middle > 0).mean() > 0.5
    assert "Noise: " in capsys.readouterr().out


@pytest.mark.filterwarnings("error")
def test_the_python_example_runs(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (example,) = blocks("python")
    exec(compile(example, "example", "exec"), {"__name__": "__main__"})
    done = capsys.readouterr()
    assert done.err == ""
    lens, energy, closed, *vertices = done.out.splitlines()
    assert re.fullmatch(r"f = 50\.36 mm, f/4\.00", lens)
    assert abs(float(re.findall(r"-?\de[+-]\d+", energy)[0])) < 1e-12
    assert closed == "True"
    assert vertices[0].startswith("start START")
    assert any(line.startswith("mla curved face TRANSMITTED") for line in vertices)
    assert any(line.startswith("sensor SENSOR") for line in vertices)
    assert np.isfinite(lfmesh.open_run("run").stderr).all()


def test_every_command_named_exists() -> None:
    known = {name for name in app if not name.startswith("-")}
    named = {words[1] for words in commands() if words[0] in ("lfmesh", "tools/run") and len(words) > 1}
    assert named == known
    for program in {words[0] for words in commands()} - {"lfmesh", ".venv/bin/python"}:
        assert os.access(ROOT / program, os.X_OK), program


def whole_commands() -> list[list[str]]:
    """Every command of lfmesh on any page that has arguments, without the name of the program."""
    ours = [words[1:] for words in commands() if words[0] in ("lfmesh", "tools/run") and len(words) > 2]
    return [words for words in ours if words != ["refocus", "run/", "--distance-mm", "500", "--method"]]


def test_every_option_of_every_command_is_one(folder: Path) -> None:
    """They are read as the command line reads them; nothing is run."""
    assert len(whole_commands()) > 25
    for words in whole_commands():
        app.parse_args(words, exit_on_error=False, print_error=False)
    with pytest.raises(CycloptsError):
        app.parse_args(["white", "run", "--no-such-option"], exit_on_error=False, print_error=False)


SMALLER = {
    "render": ["--samples", "4", "--replicates", "2", "--split", "transmit"],
    "white": ["--samples", "8"],
    "depth": ["--samples", "4"],
}
ELSEWHERE = {"demo", "compare", "view", "accuracy", "frames", "study", "matrix", "optimise", "grid", "schlieren"}
"""Run by their own tests, or by the pages' other commands; they take long, open a window, or need other scenes."""


def test_the_commands_of_the_table_run_one_after_the_other(folder: Path) -> None:
    table = [shlex.split(line)[1:] for line in re.findall(r"^\| `(lfmesh [^`]+)`", COMMANDS, flags=re.MULTILINE)]
    run = [words for words in table if words[0] not in ELSEWHERE and words != ["lens", "convert", "in.zmx", "out.toml"]]
    assert len(run) >= 12
    for words in run:
        assert main([*words, *(SMALLER.get(words[0], []) if "--resume" not in words else [])]) == 0, words
    written = {path.name for path in Path("run").iterdir()}
    assert {"raw.exr", "white.exr", "lightfield.exr", "stack.exr", "depth.exr", "exposed.png"} <= written
    assert Path("layout.svg").is_file()
    assert Path("sheet.pdf").is_file()
    assert any(Path("hci").iterdir())


def test_every_file_named_exists() -> None:
    for page, text in PAGES.items():
        for link in re.findall(r"\]\((?!generated/)([^)#:]+)(?:#[^)]*)?\)", text):
            assert (page.parent / link).exists(), f"{page}: {link}"
    paths = [word for words in commands() for word in words if word.startswith(("tests/", "tools/"))]
    tree = re.findall(r"^((?:[\w.]+/)+)  ", PAGES[ROOT / "lfmesh" / "README.md"], flags=re.MULTILINE)
    assert tree
    for path in [*paths, *tree]:
        assert (ROOT / path).exists(), path


def test_every_page_is_named_in_the_readme() -> None:
    named = {(ROOT / link).resolve() for link in re.findall(r"\]\(([^)#:]+README\.md)", README)}
    assert named == {page for page in PAGES if page.name == "README.md"} - {ROOT / "README.md"}


def test_the_readme_is_read_in_one_go() -> None:
    assert len(README.splitlines()) <= 125


def test_every_part_of_a_page_that_is_linked_is_there() -> None:
    for page, text in PAGES.items():
        for link, part in re.findall(r"\]\(([^)#:]*)#([^)]+)\)", text):
            linked = page.parent / link if link else page
            headings = re.findall(r"^#+ (.+)$", linked.read_text(encoding="utf-8"), flags=re.MULTILINE)
            assert part in {re.sub(r"[^\w -]", "", h.lower()).replace(" ", "-") for h in headings}, f"{page}: {part}"


def models_in(kind: object) -> set[type[Model]]:
    """The models that a value of this type may hold."""
    if isinstance(kind, type) and issubclass(kind, Model):
        return {kind}
    return set().union(*map(models_in, get_args(kind)))


def test_every_table_of_the_scene_file_is_explained() -> None:
    explained = set(re.findall(r"`\[+([a-zA-Z][\w.]*)\]+`", PAGES[ROOT / "lfmesh" / "scene" / "README.md"]))
    for table in explained:
        models: set[type[Model]] = {lfmesh.Scene}
        for key in table.removesuffix(".NAME").split("."):
            fields = [model.model_fields[key] for model in models if key in model.model_fields]
            models = set().union(*(models_in(field.annotation) for field in fields))
            assert models, f"[{table}] is no table of a scene"
    tables = {key for key, field in lfmesh.Scene.model_fields.items() if models_in(field.annotation)}
    assert tables <= {table.removesuffix(".NAME") for table in explained}


def test_pictures_are_small() -> None:
    pictures = list((ROOT / "assets" / "pictures").iterdir())
    warnings = (path.read_text(encoding="utf-8") for path in ROOT.glob("assets/docs/warnings/*.md"))
    shown = set(re.findall(r"pictures/(\w+\.\w+)\)", "".join([*PAGES.values(), *warnings])))
    assert {path.name for path in pictures} == shown
    assert all(path.stat().st_size < 300_000 for path in pictures)
