"""Rays of pixels and pinholes of views: `lfmesh camera-model`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from lfmesh.cli.application import app
from lfmesh.cli.interrupts import defer_interrupt
from lfmesh.cli.options import Whole
from lfmesh.cli.printing import list_files
from lfmesh.view.progress import status
from lfmesh.wrapping import wrapped


@app.command(
    help_epilogue="""\
More examples:

    lfmesh camera-model scene.toml -o camera.h5 --distances-mm 300 500 900
"""
)
def camera_model(
    scene: Annotated[Path, Parameter(name="scene", help="Scene file (TOML), or run folder.")],
    /,
    *,
    out: Annotated[
        Path,
        Parameter(
            name=["--out", "-o"], help="File to write: .exr, or .h5 with h5py. Also writes cameras.json beside it."
        ),
    ],
    views: Annotated[
        Whole | None, Parameter(help="Number of views along each axis (default: pixels across a micro-image).")
    ] = None,
    distances_mm: Annotated[
        list[float] | None,
        Parameter(help="Object distances at which the pinholes of the views are fitted, mm.", consume_multiple=True),
    ] = None,
) -> int:
    """Write the ray in object space of every pixel, and every view as a pinhole camera in OpenCV's convention."""
    with defer_interrupt():
        from lfmesh.files.camera_model import check_model_path, write_camera_model
        from lfmesh.files.opencv_cameras import NAME
        from lfmesh.files.run import open_run
        from lfmesh.lightfield.rays import camera_model as models
        from lfmesh.scene import load
    check_model_path(out)
    loaded = open_run(scene) if scene.is_dir() else load(scene)
    with status() as report:
        distances = None if distances_mm is None else tuple(distances_mm)
        model = models.camera_model(loaded, views=views, distances_mm=distances, progress=report)
        write_camera_model(model, out)
    print(wrapped(model.in_words))
    list_files([out, out.with_name(NAME)])
    return 0
