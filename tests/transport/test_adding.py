"""The recipes of `transport/ADDING.md`, put into a copy of the package, make what they promise."""

import json
import os
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

import lfmesh

PACKAGE = Path(lfmesh.__file__).parent
RECIPES = (PACKAGE / "transport" / "ADDING.md").read_text()

NEUTRAL_DENSITY = """
import json
import lfmesh as lf

camera = {
    "lens": {"surfaces": [
        {"radius_mm": 50.0, "thickness_mm": 5.0, "index": 1.5, "semi_diameter_mm": 8.0, "stop": True,
         "coating": "grey"},
        {"radius_mm": -50.0, "semi_diameter_mm": 8.0},
    ]},
    "focus_mm": 500.0,
    "sensor": {"pixels": [40, 40], "pixel_mm": 0.2},
}
found = {}
for engine in ("mesh", "sequential"):
    scene = lf.Scene(camera=camera, coatings={"grey": {"transmittance": 0.25}})
    paths = lf.trace(lf.build(scene), [[0.0, 0.0, -5.0]], [[0.0, 0.0, 1.0]], split="transmit", engine=engine)
    absorbed = paths.ledger.absorbed.get("coating of lens surface 0", 0.0)
    found[engine] = [float(paths.weight.sum()), float(absorbed)]
print(json.dumps(found))
"""


def blocks_of(recipe: str) -> list[str]:
    """Return the blocks of code in a recipe, as they stand in a file."""
    (text,) = (part for part in RECIPES.split("\n## ") if part.startswith(recipe + "\n"))
    return [textwrap.dedent(block.partition("\n")[2]).rstrip() for block in text.split("```python")[1:]
            for block in [block.partition("```")[0]]]  # fmt: skip


def put(tree: Path, file: str, before: str, block: str, indent: int) -> None:
    """Put a block of a recipe before a line of a file."""
    path = tree / "lfmesh" / file
    source = path.read_text()
    assert source.count(before) == 1, (file, before)
    path.write_text(source.replace(before, textwrap.indent(block, " " * indent) + "\n" + before))


def run_in(tree: Path, script: str) -> str:
    environment = os.environ | {"PYTHONPATH": str(tree)}
    done = subprocess.run([sys.executable, "-c", script], env=environment, cwd=tree, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.long  # a changed table compiles kernels anew
def test_a_neutral_density_coating_is_added_as_its_recipe_says(tmp_path: Path) -> None:
    shutil.copytree(PACKAGE, tmp_path / "lfmesh")
    field, absorbs, table = blocks_of("A coating")
    file = "scene/materials/coatings.py"
    put(tmp_path, file, "    layers: tuple[Layer, ...] | None = None\n", field, 4)
    path = tmp_path / "lfmesh" / file
    path.write_text(path.read_text().replace('kinds = ("reflectance",', 'kinds = ("transmittance", "reflectance",'))
    tables = "transport/tables/coatings.py"
    put(tmp_path, tables, "    return any(stack_of(coating.layers or (), wavelength).absorbs", absorbs, 4)
    put(tmp_path, tables, "    if coating.reflectance is not None:\n        return constant", table, 4)
    found = json.loads(run_in(tmp_path, NEUTRAL_DENSITY))
    for weight, absorbed in found.values():
        # Beside the coating the back face reflects 4 % of what comes to it.
        assert weight == pytest.approx(0.25 * 0.96, abs=1e-9)
        assert absorbed == pytest.approx(0.75, abs=1e-9)
