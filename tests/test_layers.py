"""The order of the house: who may import whom, which part owns which library, and that imports stay light."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "lfmesh"

FOUNDATION = {"compiling", "errors", "kernel", "vector"}
LOWER = {
    "optics": set(),
    "scene": {"optics"},
    "geometry": {"optics", "scene"},
    "transport": {"optics", "scene", "geometry"},
}
"""What each of the lower parts may import besides itself and the foundation."""
TOP = {"lightfield", "files", "view", "accuracy", "study"}
"""These stand on all of the lower parts and may use each other."""

HEAVY = {"numba", "embreex", "trimesh", "pyvista", "vtkmodules", "OpenEXR", "matplotlib"}


def modules(*parts: str) -> list[Path]:
    return sorted(path for part in parts or (".",) for path in (PACKAGE / part).rglob("*.py"))


def imported_names(path: Path) -> Iterator[str]:
    """Yield the full names a module imports, whether at its top, inside a function or for type checking."""
    package = path.relative_to(ROOT).parent.parts
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"), filename=str(path))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else ()
            origin = (*above, *filter(None, [node.module]))
            yield from (".".join((*origin, alias.name)) for alias in node.names)


def imported_parts(path: Path) -> set[str]:
    """Return the parts of lfmesh that a module imports, such as {"scene", "errors"}."""
    names = (name.split(".") for name in imported_names(path))
    return {name[1] for name in names if name[0] == "lfmesh" and len(name) > 1} - {"__version__"}


def importers(library: str) -> list[str]:
    """Return the modules that import a library, relative to the package."""
    return [
        path.relative_to(PACKAGE).as_posix()
        for path in modules()
        if any(name.split(".")[0] == library for name in imported_names(path))
    ]


@pytest.mark.parametrize("part", sorted(LOWER))
def test_imports_go_downwards(part: str) -> None:
    allowed = LOWER[part] | {part} | FOUNDATION
    upwards = {
        f"{path.relative_to(ROOT)} imports {', '.join(sorted(beyond))}"
        for path in modules(part)
        if (beyond := imported_parts(path) - allowed)
    }
    assert modules(part), f"lfmesh/{part} holds no module"
    assert not upwards


@pytest.mark.parametrize("part", sorted(TOP))
def test_the_top_does_not_reach_for_the_command_line(part: str) -> None:
    for path in modules(part):
        assert "cli" not in imported_parts(path), path


def test_embree_is_imported_in_one_module_of_transport() -> None:
    (importer,) = importers("embreex")
    assert importer.startswith("transport/")


@pytest.mark.parametrize(("library", "part"), [("pyvista", "view/"), ("OpenEXR", "files/")])
def test_library_stays_in_its_part(library: str, part: str) -> None:
    assert all(importer.startswith(part) for importer in importers(library)), importers(library)


@pytest.mark.parametrize("module", ["lfmesh", "lfmesh.cli", "lfmesh.scene"])
def test_import_loads_no_heavy_library(module: str) -> None:
    assert not HEAVY & loaded_by(f"import {module}")


@pytest.mark.parametrize("arguments", [["--help"], ["render", "--help"], ["view", "--help"], ["schema"]])
def test_the_command_line_loads_no_heavy_library_before_it_works(arguments: list[str]) -> None:
    assert not HEAVY & loaded_by(f"from lfmesh.cli import main; assert main({arguments}) == 0")


def loaded_by(statements: str) -> set[str]:
    """Return the libraries that a fresh process has loaded after some statements."""
    script = f"import sys; {statements}; print('\\n', *sys.modules)"
    child = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT)
    return {name.split(".")[0] for name in child.stdout.splitlines()[-1].split()}


def test_no_file_names_a_folder_of_one_machine() -> None:
    home = re.compile(r"(?<![\w.:/-])(?:/(?:root|home|work|Users|mnt)/\w|[A-Z]:\\\w)")
    folders = [ROOT / name for name in ("lfmesh", "assets", "tests", "tools", ".ci")]
    files = [*ROOT.glob("*.*"), *(path for folder in folders for path in folder.rglob("*"))]
    named = []
    for path in files:
        if not path.is_file() or "__pycache__" in path.parts:
            continue
        try:
            text = path.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            continue
        named += [f"{path.relative_to(ROOT)}: {found.group()}" for found in home.finditer(text)]
    assert not named
