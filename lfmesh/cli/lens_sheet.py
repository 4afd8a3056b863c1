"""Lens sheet: `lfmesh lens sheet`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from lfmesh.cli.lens import lens_app
from lfmesh.cli.options import SceneFile


@lens_app.command(
    help_epilogue="""\
More examples:

    lfmesh lens sheet scene.toml -o far.png \\
      --object-mm inf --wavelengths-nm 450 550 650
"""
)
def sheet(
    scene: SceneFile,
    /,
    *,
    out: Annotated[Path, Parameter(name=["--out", "-o"], help="File to write: .pdf, .svg, .png or .html.")],
    object_mm: Annotated[
        float | None, Parameter(help="Object distance before the first vertex, mm; inf: parallel light.")
    ] = None,
    height_mm: Annotated[float | None, Parameter(help="Largest image height, mm.")] = None,
    wavelengths_nm: Annotated[
        tuple[float, ...] | None,
        Parameter(help="An odd number of wavelengths, nm; the middle one is the primary.", consume_multiple=True),
    ] = None,
) -> int:
    """Draw the lens sheet: spots, ray fans, foci and distortion over the field, colour, illumination, MTF.

    Prints the key figures. Every definition stands on the sheet.
    """
    from lfmesh.analysis.analysis import analyse
    from lfmesh.scene import load
    from lfmesh.view.lens_sheet import check_sheet_path, draw_lens_sheet

    check_sheet_path(out)
    found = analyse(load(scene), object_mm=object_mm, height_mm=height_mm, wavelengths_nm=wavelengths_nm)
    draw_lens_sheet(found, out)
    print("\n".join([*found.lines(), f"  {out}"]))
    return 0
