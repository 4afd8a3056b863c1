"""The example notebooks run as they are, and keep output that is whole, small and of no machine."""

import importlib.util
import re
from pathlib import Path
from types import ModuleType
from typing import Any

import nbformat
import pytest

import lfmesh as lf

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = sorted((ROOT / "assets" / "notebooks").glob("*.ipynb"))

MOST_BYTES = 300_000

SHORT = ("first_scene",)
"""Runs in every test of the suite; the others with --long, and whenever the site is built."""


def maker() -> ModuleType:
    """Import tools/make_notebooks.py."""
    found = importlib.util.spec_from_file_location("make_notebooks", ROOT / "tools" / "make_notebooks.py")
    assert found is not None
    assert found.loader is not None
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module


def kinds(notebook: Any) -> list[list[tuple[str, ...]]]:
    """Return the kinds of output of every cell of code."""
    return [
        [(output.output_type, output.get("name", ""), *sorted(output.get("data", {}))) for output in cell.outputs]
        for cell in notebook.cells
        if cell.cell_type == "code"
    ]


def texts(notebook: Any) -> list[str]:
    """Return everything that its cells gave as text."""
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    return [str(part) for output in outputs for part in (output.get("text", ""), *output.get("data", {}).values())]


def test_every_one_is_listed_once_among_the_tutorials() -> None:
    page = (ROOT / "assets" / "docs" / "tutorials.md").read_text(encoding="utf-8")
    assert sorted(re.findall(r"^/assets/notebooks/(\w+)$", page, flags=re.MULTILINE)) == [p.stem for p in NOTEBOOKS]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_they_take_public_names_alone(path: Path) -> None:
    """Nothing is imported from within lfmesh, and every name of it is one of `lf.__all__`."""
    code = "\n".join(cell.source for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code")
    assert "from lfmesh" not in code
    assert re.findall(r"import lfmesh.*", code) == ["import lfmesh as lf"]
    assert set(re.findall(r"\blf\.(\w+)", code)) <= set(lf.__all__)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_what_is_kept_is_whole_and_small(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert path.stat().st_size < MOST_BYTES
    numbers = [cell.execution_count for cell in notebook.cells if cell.cell_type == "code"]
    assert numbers == list(range(1, len(numbers) + 1)), "run from the top, once"
    outputs = [kind for cell in kinds(notebook) for kind in cell]
    assert not [kind for kind in outputs if "error" in kind or "stderr" in kind]
    assert not any(str(ROOT) in text for text in texts(notebook))


@pytest.mark.drawing
@pytest.mark.parametrize(
    "path", [pytest.param(p, id=p.stem, marks=[] if p.stem in SHORT else [pytest.mark.long]) for p in NOTEBOOKS]
)
def test_it_runs_and_gives_what_is_kept(path: Path) -> None:
    again = maker().executed(path)
    assert kinds(again) == kinds(nbformat.read(path, as_version=4))
