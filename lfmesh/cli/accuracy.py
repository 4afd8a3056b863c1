"""Accuracy and speed of the program: `lfmesh accuracy`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from lfmesh.cli.application import CASE_FAILED, app
from lfmesh.cli.interrupts import defer_interrupt
from lfmesh.cli.printing import list_files
from lfmesh.errors import LfmeshError
from lfmesh.view.progress import status
from lfmesh.wrapping import COLUMNS


@app.command(
    help_epilogue="""\
More examples:

    lfmesh accuracy --quick              the lenses that come with lfmesh
    lfmesh accuracy --hard               cases made to break the tracer
"""
)
def accuracy(
    scene: Annotated[
        Path | None, Parameter(name="scene", help="Scene file (TOML); if omitted, the lenses that come with lfmesh.")
    ] = None,
    /,
    *,
    output: Annotated[
        Path | None, Parameter(name=["--out", "--output", "-o"], help="Folder for the HTML page and the tables as CSV.")
    ] = None,
    quick: Annotated[bool, Parameter(help="Fewer meshes, rays and samples.")] = False,
    hard: Annotated[bool, Parameter(help="Run the hard cases instead, one line each.")] = False,
) -> int:
    """Measure speed against error: every level of `surface` on ever finer meshes, every way to estimate an image.

    With --hard exits with 1 if a case fails.
    """
    if hard:
        if scene is not None or output is not None or quick:
            raise LfmeshError("--hard takes no scene, --out or --quick, because its cases are fixed; omit them")
        return _hard_cases()

    from lfmesh.scene import load

    given = load(scene) if scene is not None else None
    with defer_interrupt():
        from rich.console import Console

        from lfmesh.accuracy.report import measure, prepare

    if output is not None:
        prepare(output)
    with status() as say:
        report = measure(given, quick=quick, progress=say)
    # Write first: the report is not lost if printing fails.
    paths = report.write(output) if output is not None else ()
    report.print(Console(width=COLUMNS))
    list_files(paths)
    return 0


def _hard_cases() -> int:
    with defer_interrupt():
        from lfmesh.accuracy import hard_cases

    outcomes = []
    for case in hard_cases.CASES:
        outcomes.append(hard_cases.judged(case))
        print(hard_cases.line(outcomes[-1]), flush=True)
    failed = sum(not outcome.passed for outcome in outcomes)
    lost, allowed = hard_cases.lost_share(outcomes), hard_cases.ALLOWED_LOSS
    verdict = f"{failed} failed" if failed else "all passed"
    print(f"{len(outcomes)} cases, {verdict}; {lost:.1g} of the energy lost, {allowed:g} allowed")
    return CASE_FAILED if failed or lost > allowed else 0
