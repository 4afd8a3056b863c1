"""Camera design: `lfmesh optimise`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from lfmesh.cli.application import app
from lfmesh.cli.interrupts import code_of_last, defer_interrupt
from lfmesh.cli.printing import list_files, say_note
from lfmesh.view.progress import status


@app.command(
    help_epilogue="""\
More examples:

    lfmesh lens sheet best/optimised.toml -o sheet.pdf
"""
)
def optimise(
    design: Annotated[Path, Parameter(name="design", help="Design file (TOML): scene, variables, merit, constraints.")],
    /,
    *,
    out: Annotated[Path, Parameter(name=["--out", "-o"], help="Folder for the best scene and the report.")],
) -> int:
    """Vary numbers of a camera until its merit is the best: optimised.toml, report.html, optimum.json and .txt.

    Ctrl-C keeps the best camera so far. The exit code is 1 if the best camera found violates a limit.
    """
    with defer_interrupt():
        from lfmesh.files.whole import make_folder
        from lfmesh.study.optimise.design_files import write_optimum
        from lfmesh.study.optimise.optimise import best_of, load_design

    problem = load_design(design)
    make_folder(out)
    with status() as say:
        found = best_of(problem, say)
    try:
        # Finish writing and printing the results even if interrupted.
        with defer_interrupt():
            paths = write_optimum(found, out)
            for line in found.lines():
                print(line)
            if not found.complete:
                say_note("stopped; the best camera so far is written")
            if found.violated:
                say_note(f"the best camera found breaks limits: {'; '.join(found.violated)}")
            list_files(paths)
    except KeyboardInterrupt:
        return code_of_last()
    if not found.complete:
        return code_of_last()
    return 1 if found.violated else 0
