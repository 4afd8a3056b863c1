"""Background-oriented schlieren: `lfmesh schlieren`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from lfmesh.cli.application import app
from lfmesh.cli.interrupts import defer_interrupt
from lfmesh.cli.lightfield import field_of
from lfmesh.cli.options import Whole
from lfmesh.cli.printing import list_files
from lfmesh.view.progress import status
from lfmesh.wrapping import wrapped

if TYPE_CHECKING:
    from lfmesh.lightfield.views.field import LightField
    from lfmesh.transport.render.image import Image


@app.command(
    help_epilogue="""\
More examples:

    lfmesh schlieren hot/ cold/ --window 31 --reach 8
    lfmesh schlieren hot/ cold/ --background-mm 1200 --field-mm 800
"""
)
def schlieren(
    run: Annotated[Path, Parameter(name="run", help="Run folder of the background behind the flow.")],
    reference: Annotated[Path, Parameter(name="reference", help="Run folder of the same camera without the flow.")],
    /,
    *,
    window: Annotated[Whole, Parameter(help="Width of a window in samples, odd.")] = 21,
    step: Annotated[
        Whole | None,
        Parameter(help="Distance between neighbouring windows, in samples (default: a third of a window)."),
    ] = None,
    reach: Annotated[Whole, Parameter(help="Largest displacement along each axis, in samples.")] = 5,
    background_mm: Annotated[
        float | None,
        Parameter(help="Distance of the background before the first vertex, mm (default: the plane in focus)."),
    ] = None,
    field_mm: Annotated[
        float | None,
        Parameter(help="Distance of the middle of the flow, mm (default: that of the media that bend light)."),
    ] = None,
) -> int:
    """Measure the displacements of a background by a flow, and the deflections of light, with standard errors.

    Adds schlieren.exr and schlieren.png to the run. The two runs need different seeds.
    """
    with defer_interrupt():
        from lfmesh.files.schlieren import save_schlieren
        from lfmesh.lightfield.photographs import schlieren as evaluation

    pair = _picture_of(run), _picture_of(reference)
    with status() as say:
        result = evaluation.schlieren(
            *pair, window=window, step=step, reach=reach, background_mm=background_mm, field_mm=field_mm, progress=say
        )
    # Save first: the result is not lost if printing fails.
    paths = save_schlieren(result, run, reference)
    print(wrapped(result.in_words()))
    list_files(paths)
    return 0


def _picture_of(folder: Path) -> "Image | LightField":
    """Return the image of a conventional camera's run, or the light field of another's."""
    with defer_interrupt():
        from lfmesh.files.run import open_run

    image = open_run(folder)
    return image if image.scene.camera.mla is None else field_of(folder)
