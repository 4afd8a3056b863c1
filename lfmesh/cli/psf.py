"""Point spread: `lfmesh psf`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from lfmesh.cli.application import app
from lfmesh.cli.interrupts import code_of_last, defer_interrupt
from lfmesh.cli.options import SceneFile, Whole
from lfmesh.cli.printing import list_files
from lfmesh.errors import LfmeshError
from lfmesh.view.progress import progress
from lfmesh.wrapping import wrapped


@app.command(
    help_epilogue="""\
More examples:

    lfmesh psf scene.toml --point-mm 5 0 -500 -o white/ \\
      --wavelengths-nm 500 550 600 --oversample 4 --window 32
"""
)
def psf(
    scene: SceneFile,
    /,
    *,
    out: Annotated[Path, Parameter(name=["--out", "-o"], help="Folder for spread.exr, spread.png and spread.json.")],
    point_mm: Annotated[
        tuple[float, float, float], Parameter(help="x, y and z of the point in the camera frame, mm; z below 0.")
    ],
    wavelengths_nm: Annotated[
        list[float] | None, Parameter(help="One or more wavelengths, nm, equally weighted.", consume_multiple=True)
    ] = None,
    band: Annotated[str | None, Parameter(help="Name of a sensor band, in place of wavelengths.")] = None,
    window: Annotated[
        Whole | None, Parameter(help="Pixels along each side of a window around the light (default: the whole sensor).")
    ] = None,
    oversample: Annotated[Whole, Parameter(help="Subdivisions along each side of a pixel.")] = 1,
    tolerance: Annotated[
        float | None, Parameter(help="Stop refining when the picture changes by less than this share of its light.")
    ] = None,
) -> int:
    """Compute the sensor's picture of a point of 1 W/sr, with diffraction and interference of lenslets.

    The picture is logarithmic over four decades, with its scale.
    """
    with defer_interrupt():
        from lfmesh.files.point_spread import prepare, write_point_spread
        from lfmesh.scene import load
        from lfmesh.waves.point_spread import TOLERANCE, point_spread
    loaded = load(scene)
    if band is not None and wavelengths_nm is not None:
        raise LfmeshError(f"--band {band}: omit --wavelengths-nm, or the band")
    if band is not None and band not in loaded.channel_names:
        known = (
            f"must be one of {', '.join(loaded.channel_names)}" if loaded.channel_names else "the scene has no bands"
        )
        raise LfmeshError(f"--band {band}: {known}")
    # Faults of the folder are reported before the waves are computed.
    prepare(out)
    with progress() as report:
        found = point_spread(
            loaded, point_mm, band if band is not None else wavelengths_nm, window=window, oversample=oversample,
            tolerance=TOLERANCE if tolerance is None else tolerance, progress=report,
        )  # fmt: skip
    try:
        with defer_interrupt():
            files = write_point_spread(found, out)
            for line in found.lines():
                print(wrapped(line))
            list_files(files)
    except KeyboardInterrupt:
        return code_of_last()
    return 0
