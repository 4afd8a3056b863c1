"""Export to other tools: `lfmesh export`."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from lfmesh.cli.application import app
from lfmesh.cli.interrupts import defer_interrupt
from lfmesh.cli.lightfield import field_of
from lfmesh.cli.options import RunFolder
from lfmesh.errors import LfmeshError


@app.command(
    help_epilogue="""\
More examples:

    lfmesh export run/ --format plenopticam -o decoder/
    lfmesh export run/ --format exr-rgb --depth depth.exr -o for-opencv/
"""
)
def export(
    run: RunFolder,
    /,
    *,
    kind: Annotated[
        Literal["lftoolbox", "eslf", "hci", "views", "exr-rgb", "plenopticam", "plenpy"],
        Parameter(
            name="--format",
            help="lftoolbox, eslf, hci, views, exr-rgb: the light field; plenopticam, plenpy: raw and white image.",
        ),
    ],
    out: Annotated[Path, Parameter(name=["--out", "-o"], help="Folder to write: new or empty.")],
    depth: Annotated[
        Path | None,
        Parameter(
            help="With hci and exr-rgb: EXR file of distances in mm, channel truth or Z, such as the run's depth.exr; "
            "for hci of a view's size."
        ),
    ] = None,
) -> int:
    """Convert a run for other tools: a folder with their files, and export.json, which explains them."""
    if depth is not None and kind not in ("hci", "exr-rgb"):
        raise LfmeshError(f"--depth {depth}: {kind} cannot hold depth; omit it, or use --format hci or exr-rgb")
    with defer_interrupt():
        from lfmesh.files import exr
        from lfmesh.files.exports.export import export_field

    if kind == "plenopticam" or kind == "plenpy":
        paths = _exported_raw(run, out, kind)
    else:
        depth_mm = exr.read_map(_found(depth, run), ("truth", "Z")) if depth is not None else None
        field = field_of(run)
        paths = export_field(field, out, kind, depth_mm=depth_mm)
    print(f"  {out}: {len(paths)} files; {paths[-1].name} explains them")
    return 0


def _found(depth: Path, folder: Path) -> Path:
    """Return the path of a depth file, as given or else in the run."""
    from lfmesh.files.folder import saved

    if depth.exists() and depth.resolve().parent != folder.resolve():
        return depth
    return saved(folder, depth.name if depth.exists() else str(depth)) or depth


def _exported_raw(folder: Path, out: Path, kind: Literal["plenopticam", "plenpy"]) -> list[Path]:
    with defer_interrupt():
        from lfmesh.files import run
        from lfmesh.files.exports.export import export_raw
        from lfmesh.lightfield.rays.ray_model import RayModel

    image, recorded = run.open_run(folder), run.open_white(folder)
    RayModel.of(image.scene)  # a conventional camera is refused before a white image is asked for
    if recorded is None:
        raise LfmeshError(f"--format {kind}: {folder} has no white.exr; make it with lfmesh white {folder}")
    calibration = run.open_calibration(folder)
    if calibration is None:
        raise LfmeshError(f"--format {kind}: {folder} has no calibration.json; make it with lfmesh white {folder}")
    return export_raw(image, recorded, calibration, out, kind)
