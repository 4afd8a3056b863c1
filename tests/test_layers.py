"""The order of the house: who may import whom, which part owns which library, how light imports stay."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "lfmesh"

FOUNDATION = [
    *["arguments", "assets", "cluster", "errors", "notebook", "provenance", "regular_file", "signatures", "templates"],
    "wrapping",
]
ORDER = [
    *["kernels", "optics", "scene", "geometry", "imports", "transport", "waves"],
    *["lightfield", "analysis", "files", "view", "accuracy", "study", "cli", "__main__"],
]
"""Each may import those before it, and the foundation."""
ROOMS = {
    "kernels": ["private", "cache, accelerator", "decorators, by_address", "search, vector"],
    "transport": [
        *["packets", "paths", "tables", "events", "lights", "sequences", "aims", "checks/aim_proof", "regions"],
        *["choice", "collisions, inside_camera", "close_faces, refused_fields, refused_lamps"],
        *["refused_glass, refused_motion"],
        *["world", "world_cache", "build", "settings"],
        *["threads", "engine", "sources"],  # packets through a world, and what starts them
        "checks, render, ray_starts, traced_paths, trace",
    ],
    "view": [
        "style, figure_file, progress, pictures, media, key_figures, results",
        *["rays", "request", "layout", "lens_sheet", "scene3d", "output", "show", "overview", "browser"],
    ],
    "files": ["", "exports"],
    "cli": ["application, interrupts, options, printing, tasks", "", "__init__"],
}
"""The same inside a part, of its folders, single files in these ("folder/file"), and the files beside them; "" is every
file that is not named."""

HEAVY = {"numba", "embreex", "trimesh", "pyvista", "vtkmodules", "OpenEXR", "matplotlib"}


def modules(*parts: str) -> list[Path]:
    return sorted(path for part in parts or (".",) for path in (PACKAGE / part).rglob("*.py"))


def imported_names(path: Path) -> Iterator[str]:
    """Yield the full names a module imports, whether at its top, inside a function or for type checking."""
    return names_in(ast.walk(parsed(path)), path)


def names_in(nodes: Iterable[ast.AST], path: Path) -> Iterator[str]:
    package = path.relative_to(ROOT).parent.parts
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else ()
            origin = (*above, *filter(None, [node.module]))
            yield from (".".join((*origin, alias.name)) for alias in node.names)


@cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), filename=str(path))


def imported_parts(path: Path) -> set[str]:
    """Return the parts of lfmesh that a module imports, such as {"scene", "errors"}."""
    names = (name.split(".") for name in imported_names(path))
    return {name[1] for name in names if name[0] == "lfmesh" and len(name) > 1} - {"__version__"}


def run_nodes(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes of a module, without what stands there for type checking alone."""
    for child in ast.iter_child_nodes(tree):
        if isinstance(child, ast.If) and ast.unparse(child.test).endswith("TYPE_CHECKING"):
            continue
        yield child
        yield from run_nodes(child)


def imported_files(path: Path) -> set[Path]:
    """Return the files of lfmesh that one imports when it or one of its functions runs."""
    return files_of(names_in(run_nodes(parsed(path)), path)) - {path}


def known_files(path: Path) -> set[Path]:
    """Return the files of lfmesh that one names in any import: at its top, in a function, for type checking alone."""
    return files_of(imported_names(path)) - {path}


def files_of(names: Iterable[str]) -> set[Path]:
    return {file for name in names if (file := file_of(name)) is not None}


def file_of(name: str) -> Path | None:
    """Return the file of a module, or of the one that holds a name; None for other libraries."""
    words = name.split(".")
    if words[0] != "lfmesh":
        return None
    for length in (len(words), len(words) - 1):
        place = ROOT.joinpath(*words[:length])
        for path in (place.with_suffix(".py"), place / "__init__.py"):
            if path.is_file():
                return path
    return None


def importers(library: str) -> list[str]:
    """Return the modules that import a library, relative to the package."""
    return [
        path.relative_to(PACKAGE).as_posix()
        for path in modules()
        if any(name.split(".")[0] == library for name in imported_names(path))
    ]


def test_every_part_has_its_place_in_the_order() -> None:
    parts = {path.stem for path in PACKAGE.iterdir() if path.suffix == ".py" or (path / "__init__.py").is_file()}
    assert parts - {"__init__"} == {*FOUNDATION, *ORDER}


@pytest.mark.parametrize("part", ORDER)
def test_imports_go_downwards(part: str) -> None:
    allowed = {*FOUNDATION, *ORDER[: ORDER.index(part) + 1]}
    files = modules(part) or [PACKAGE / f"{part}.py"]
    upwards = {
        f"{path.relative_to(ROOT)} imports {', '.join(sorted(beyond))}"
        for path in files
        if (beyond := imported_parts(path) - allowed)
    }
    assert not upwards


@pytest.mark.parametrize("part", ROOMS)
def test_imports_inside_a_part_go_downwards(part: str) -> None:
    rank = {name: i for i, names in enumerate(ROOMS[part]) for name in names.split(", ")}

    def rank_of(path: Path) -> int:
        words = path.relative_to(PACKAGE / part).with_suffix("").parts
        if words == ("__init__",) and "__init__" not in rank:
            return 0
        if (file := "/".join(words)) in rank:
            return rank[file]
        assert words[0] in rank or "" in rank, f"{path.relative_to(ROOT)} has no place in the order"
        return rank.get(words[0], rank.get("", 0))

    inside = modules(part)
    upwards = {
        f"{path.relative_to(ROOT)} imports {other.relative_to(ROOT)}"
        for path in inside
        for other in imported_files(path).intersection(inside)
        if rank_of(other) > rank_of(path)
    }
    assert not upwards


def circle(graph: Mapping[Path, set[Path]]) -> str:
    """Return files that import each other in a circle, "" where there are none."""
    try:
        list(TopologicalSorter(graph).static_order())
    except CycleError as error:
        return " imports ".join(str(path.relative_to(ROOT)) for path in reversed(error.args[1]))
    return ""


def test_no_files_import_each_other_in_a_circle() -> None:
    graph = {path: imported_files(path) for path in modules()}
    assert len(graph[PACKAGE / "transport" / "build.py"]) > 10, "imports are not found"
    assert not circle(graph)


@pytest.mark.parametrize("part", ORDER)
def test_no_files_of_a_part_know_each_other_in_a_circle(part: str) -> None:
    """Every import statement between files of the part counts, also inside functions and under TYPE_CHECKING.

    Imports of the package itself (`import lfmesh`) do not count: it imports its parts when a name is asked for.
    """
    files = set(modules(part))
    assert not circle({path: known_files(path) & files for path in files})


def test_a_circle_for_type_checking_or_inside_a_function_is_found() -> None:
    """Both kinds are names that a module imports."""
    source = "if TYPE_CHECKING:\n    import lfmesh.a\ndef f():\n    from lfmesh import b\n"
    assert list(names_in(ast.walk(ast.parse(source)), PACKAGE / "c.py")) == ["lfmesh.a", "lfmesh.b"]
    one, two = PACKAGE / "one.py", PACKAGE / "two.py"
    assert circle({one: {two}, two: {one}})
    assert not circle({one: {two}, two: set()})


def test_embree_is_imported_in_one_module_of_transport() -> None:
    (importer,) = importers("embreex")
    assert importer.startswith("transport/")


@pytest.mark.parametrize(("library", "parts"), [("pyvista", ("view/", "imports/")), ("OpenEXR", ("files/",))])
def test_library_stays_in_its_parts(library: str, parts: tuple[str, ...]) -> None:
    assert all(importer.startswith(parts) for importer in importers(library)), importers(library)


def test_numbas_private_classes_are_imported_behind_their_probe_alone() -> None:
    """At the top of files: what a function imports, it can do without."""
    private = {"numba.core", "numba.np", "numba.cpython", "llvmlite.binding"}
    tops = {path: list(names_in(parsed(path).body, path)) for path in modules()}
    found = {path for path, names in tops.items() if private & {".".join(name.split(".")[:2]) for name in names}}
    assert {path.parent.relative_to(PACKAGE).as_posix() for path in found} == {"kernels/private"}


@pytest.mark.parametrize("module", ["lfmesh", "lfmesh.cli", "lfmesh.scene"])
def test_import_loads_no_heavy_library(module: str) -> None:
    assert not HEAVY & loaded_by(f"import {module}")


@pytest.mark.parametrize("arguments", [["--help"], ["render", "--help"], ["view", "--help"], ["schema"]])
def test_the_command_line_loads_no_heavy_library_before_it_works(arguments: list[str]) -> None:
    assert not HEAVY & loaded_by(f"from lfmesh.cli import main; assert main({arguments}) == 0")


@pytest.mark.parametrize("arguments", [["--help"], ["--version"]])
def test_help_loads_no_numbers_and_no_part_that_works(arguments: list[str]) -> None:
    loaded = modules_loaded_by(f"from lfmesh.cli import main; assert main({arguments}) == 0")
    working = {f"lfmesh.{part}" for part in ORDER} - {"lfmesh.cli", "lfmesh.view", "lfmesh.__main__"}
    assert not loaded & {"numpy", "scipy", "pydantic", "pydantic_core", *HEAVY, *working}
    assert "lfmesh.cli" in loaded


def test_the_list_of_lenses_loads_neither_scenes_nor_glasses() -> None:
    loaded = modules_loaded_by("from lfmesh.cli import main; assert main(['lens', 'list']) == 0")
    assert not loaded & {"numpy", "scipy", "pydantic", "lfmesh.scene", "lfmesh.optics", "lfmesh.imports", *HEAVY}


def loaded_by(statements: str) -> set[str]:
    """Return the libraries that a fresh process has loaded after some statements."""
    return {name.split(".")[0] for name in modules_loaded_by(statements)}


def modules_loaded_by(statements: str) -> set[str]:
    """Return the full names of the modules that a fresh process has loaded after some statements."""
    script = f"import sys; {statements}; print('\\n', *sys.modules)"
    child = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT)
    return set(child.stdout.splitlines()[-1].split())


def test_no_file_names_a_folder_of_one_machine() -> None:
    home = re.compile(r"(?<![\w.:/-])(?:/(?:root|home|work|Users|mnt)/\w|[A-Z]:\\\w)")
    folders = [ROOT / name for name in ("lfmesh", "assets", "tests", "tools", ".ci")]
    files = [*ROOT.glob("*.*"), *(path for folder in folders for path in folder.rglob("*"))]
    named = []
    for path in files:
        # git writes the file .git, where the checkout is one of several.
        if not path.is_file() or "__pycache__" in path.parts or path.name == ".git":
            continue
        try:
            text = path.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            continue
        named += [f"{path.relative_to(ROOT)}: {found.group()}" for found in home.finditer(text)]
    assert not named
