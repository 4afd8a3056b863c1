"""Cameras and rays as pictures: `lfmesh view`, `draw`."""

import re
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from lfmesh.cli.application import app
from lfmesh.cli.interrupts import defer_interrupt
from lfmesh.cli.options import SceneFile
from lfmesh.cli.printing import list_files
from lfmesh.cli.view_options import Files, Launches, Looks, Reports, Selection, Serving
from lfmesh.errors import LfmeshError

LEAST_PIXELS, MOST_PIXELS = 64, 8192
"""Smallest and largest side of a picture of the scene."""


@app.command(
    help_epilogue="""\
More examples:

    lfmesh view run/ --screenshot out.png --preset lens --cut
    lfmesh view scene.toml --rays "pixel 320,310" --preset array \\
      --html out.html
    lfmesh view scene.toml --rays "field 0,20,-500" --split both --table
    lfmesh view scene.toml --rays "field 0,20,-500" --split both \\
      --filter ghost
"""
)
def view(
    subject: Annotated[Path, Parameter(name="scene", help="Scene file (TOML), or run folder.")],
    /,
    *,
    launches: Launches | None = None,
    selection: Selection | None = None,
    looks: Looks | None = None,
    reports: Reports | None = None,
    files: Files | None = None,
    serving: Serving | None = None,
) -> int:
    """Show lens, array, sensor, targets and rays in 3D: in a window, or as a picture, a page, a model."""
    looks, files = looks or Looks(), files or Files()
    with defer_interrupt():
        from lfmesh.cli import viewing
        from lfmesh.view.scene3d.plotter import Drawing
        from lfmesh.view.show import Outputs

    lines, written = viewing.run(
        subject, launches or Launches(), (selection or Selection()).expression,
        Drawing(looks.colour, looks.fade, looks.preset, looks.cut, _size(looks.size), looks.segments),
        Outputs(files.screenshot, files.html, files.gltf), reports or Reports(), serving or Serving(),
    )  # fmt: skip
    for line in lines:
        print(line)
    list_files(written)
    return 0


@app.command(
    help_epilogue="""\
More examples:

    lfmesh draw scene.toml -o layout.pdf
"""
)
def draw(
    scene: SceneFile,
    /,
    *,
    out: Annotated[
        Path, Parameter(name=["--out", "-o"], help="File to write, by its ending an SVG, PNG or PDF.")
    ] = Path("layout.svg"),
) -> int:
    """Draw a camera's layout: meridional section with marginal and chief rays, object side, array close up."""
    with defer_interrupt():
        from lfmesh.scene import load
        from lfmesh.view.layout import figure as layout_figure

    list_files([layout_figure.draw(load(scene), out)])
    return 0


def _size(words: str) -> tuple[int, int]:
    """Return the width and height of a picture from WIDTHxHEIGHT."""
    found = re.fullmatch(r"(\d+)\s*[x×]\s*(\d+)", words.strip())
    size = (int(found[1]), int(found[2])) if found else (0, 0)
    if not all(LEAST_PIXELS <= side <= MOST_PIXELS for side in size):
        raise LfmeshError(f"--size {words}: give WIDTHxHEIGHT from {LEAST_PIXELS} to {MOST_PIXELS}, such as 1600x1000")
    return size
