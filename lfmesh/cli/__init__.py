"""Command line: parses arguments, calls the package and prints.

To add a command, write a function in its group's file (or a new one, imported below), decorated with
`lfmesh.cli.application.app.command`. Its docstring is the help text, its annotated parameters are the arguments and
options, and its return value is the exit code. Raise user errors as `LfmeshError`. Take shared parameters from
`lfmesh.cli.options`, print through `lfmesh.cli.printing` and report progress through `lfmesh.view.progress`. Import
heavy modules in the body of the command, under `lfmesh.cli.interrupts.defer_interrupt` if they bring numba, Embree or
VTK. Then list the command, with an example, in `lfmesh.cli.tasks` and in the README.
"""

from lfmesh.cli.interrupts import defer_interrupt

try:
    # These imports take a third of a second, in which Ctrl-C must not end in a traceback either.
    with defer_interrupt():
        from lfmesh.cli import (  # noqa: F401  # adds their commands
            accuracy,
            camera_model,
            compare,
            dataset,
            demo,
            export,
            fit,
            frames,
            grid,
            lens,
            lens_sheet,
            lightfield,
            matrix,
            new,
            optimise,
            psf,
            render,
            schema,
            schlieren,
            study,
            view,
        )
        from lfmesh.cli.application import app, main
        from lfmesh.cli.tasks import arrange

        arrange(app)
except KeyboardInterrupt:
    raise SystemExit(130) from None

__all__ = ["app", "main"]
