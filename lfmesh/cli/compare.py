"""Comparison of camera types: `lfmesh compare`."""

import warnings
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from lfmesh.cli.application import app
from lfmesh.cli.interrupts import defer_interrupt
from lfmesh.cli.options import Overrides, SceneFile, Whole, overridden
from lfmesh.cli.printing import list_files
from lfmesh.view.progress import status


@app.command(
    help_epilogue="""\
More examples:

    lfmesh compare scene.toml -o comparison/ --reduction 4 --steps 5
"""
)
def compare(
    scene: SceneFile,
    /,
    *,
    out: Annotated[Path, Parameter(name=["--out", "-o"], help="Folder for the figure and the numbers as JSON.")],
    reduction: Annotated[
        float, Parameter(help="Factor by which the lenslets of the focused camera reduce the main image.")
    ] = 3.0,
    steps: Annotated[Whole, Parameter(help="Number of distances at which sharpness is measured; odd.")] = 13,
    overrides: Overrides | None = None,
) -> int:
    """Picture a scene with a conventional, a standard and a focused plenoptic camera, and compare the results.

    They have the same lens, sensor and samples; the scene is that of the standard one.
    """
    from lfmesh.scene import load

    loaded = overridden(load(scene), overrides)
    with defer_interrupt():
        from lfmesh.accuracy.report import prepare
        from lfmesh.study.cameras import compare as comparing

    prepare(out)
    with status() as say, warnings.catch_warnings():
        # The blur of planes beyond the refocus range is measured here.
        warnings.filterwarnings("ignore", ".*beyond the range of sharp refocusing", UserWarning)
        comparison = comparing.compare(loaded, reduction=reduction, steps=steps, progress=say)
    # Write first: the comparison is not lost if printing fails.
    paths = comparing.write(comparison, out)
    for words, *values in comparison.rows():
        print(f"{words:<23}" + "".join(f"{value:<24}" for value in values).rstrip())
    list_files(paths)
    return 0
