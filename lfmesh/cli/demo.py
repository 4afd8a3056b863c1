"""First steps: `lfmesh demo`."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from lfmesh.cli.application import app
from lfmesh.cli.interrupts import defer_interrupt
from lfmesh.cli.options import Overrides, Verbose
from lfmesh.cli.render import render_file, run_account
from lfmesh.view.progress import status
from lfmesh.wrapping import wrapped

if TYPE_CHECKING:
    from lfmesh.transport.render.image import Image

SCENE = "scenes/demo.toml"

NEAR_MM, FAR_MM = 450.0, 600.0
"""Planes of the photographs: the middle of the bracket, and the chart behind it."""


@app.command
def demo(
    *,
    out: Annotated[Path, Parameter(name=["--out", "-o"], help="Run folder to write.")] = Path("lfmesh-demo"),
    verbose: Verbose = False,
    overrides: Overrides | None = None,
) -> int:
    """Render a scene in colour, and show camera, raw image, view, refocused photographs and depth on one sheet.

    The scene comes with lfmesh: a bracket in front of a chart. The sheet is overview.png in the run folder.
    """
    from lfmesh.assets import asset_path

    return render_file(asset_path(SCENE), out, partial(_account, verbose=verbose), overrides)


def _account(image: "Image", folder: Path, *, verbose: bool) -> list[str]:
    """Draw the sheet, and return lines that explain the run to a newcomer; with `verbose` also its full account."""
    if not image.complete:
        return run_account(image, folder, verbose=verbose)
    with defer_interrupt():
        from lfmesh.files import run
        from lfmesh.view.overview import save_overview
    with status() as say:
        sheet = save_overview(image, folder, (NEAR_MM, FAR_MM), say)
    files = {
        sheet: "all of it on one sheet: begin here",
        folder / run.PREVIEW: "the raw image, one small picture per microlens",
        folder / run.RAW: "power and standard error of each pixel, W",
        folder / run.SCENE: "the scene: change it, and render it again",
    }
    width = max(len(str(path)) for path in files)
    lines = run_account(image, folder, verbose=True) if verbose else []
    lines += [f"  {path!s:<{width}}  {content}" for path, content in files.items()]
    lines += map(wrapped, (_noise(image), _checks(image), _next(folder)))
    return lines


def _next(folder: Path) -> str:
    return f"Next: lfmesh view {folder} shows the camera in 3D; lfmesh new --list lists cameras to start from."


def _noise(image: "Image") -> str:
    from lfmesh.files.words import noise
    from lfmesh.scene.literals import percent

    errors = noise(image).relative_error
    if errors is None:
        return "Noise: unknown; it takes light and two replicates or more."
    return (
        f"Noise: half of the lit pixels are known to {percent(errors[1])} or better. "
        f"--samples {4 * image.samples:g} at least halves the noise."
    )


def _checks(image: "Image") -> str:
    if image.warnings:
        return "Checks: not all passed; see the warnings above."
    passed = ["all power is accounted for"]
    if image.blind is not None and image.blind.smallest_deficit is not None:
        passed.append("samples in all directions found no light that the picture lacks")
    return f"Checks: passed; {', and '.join(passed)}."
