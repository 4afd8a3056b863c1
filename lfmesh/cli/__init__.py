"""The command line: it parses, calls and prints; what it calls stands elsewhere.

To add a command, write a function in the file of its group (or in a new file, imported below), decorated with
`lfmesh.cli.application.app.command`: its docstring is the help text, its annotated parameters are the arguments and
options, and what it returns is the exit code. A mistake of the user is raised as an `LfmeshError`. Parameters that
other commands have too come from `lfmesh.cli.options`; what is printed goes through `lfmesh.cli.printing`, progress
through `lfmesh.cli.progress`. Import nothing heavy at the top of the file: what the command calls is imported in its
body, under `lfmesh.cli.interrupts.defer_interrupt` if that brings numba, Embree or VTK. Then name the command,
with an example, in `lfmesh.cli.tasks` and in the README.
"""

from lfmesh.cli.interrupts import defer_interrupt

try:
    # A third of a second, in which Ctrl-C is no traceback either.
    with defer_interrupt():
        from lfmesh.cli import (  # noqa: F401  # adds their commands
            accuracy,
            camera_model,
            compare,
            dataset,
            export,
            fit,
            frames,
            lens,
            lens_sheet,
            lightfield,
            matrix,
            optimise,
            psf,
            render,
            schema,
            study,
            view,
        )
        from lfmesh.cli.application import app, main
        from lfmesh.cli.tasks import arrange

        arrange(app)
except KeyboardInterrupt:
    raise SystemExit(130) from None

__all__ = ["app", "main"]
