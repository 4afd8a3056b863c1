"""Projection matrix: `lfmesh matrix`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from lfmesh.cli.application import app, stopped
from lfmesh.cli.interrupts import defer_interrupt
from lfmesh.cli.options import Overrides, SceneFile, Whole, overridden
from lfmesh.cli.printing import list_files
from lfmesh.errors import LfmeshError
from lfmesh.view.progress import status
from lfmesh.wrapping import wrapped

if TYPE_CHECKING:
    from lfmesh.lightfield.volumes.voxel_box import VoxelBox

Triple = tuple[float, float, float]

COPIES = 4.0
"""Memory needed to find the resolution, as a multiple of the matrix's size on disk."""


@Parameter(name="*")
@dataclass
class Voxels:
    """The box of voxels."""

    grid: Annotated[Path | None, Parameter(help="Voxel grid (.npz) with spacing_mm and origin_mm.")] = None
    counts: Annotated[tuple[Whole, Whole, Whole] | None, Parameter(help="Voxels along x, y, z, with --size-mm.")] = None
    size_mm: Annotated[Triple | None, Parameter(help="Edge lengths of the box of voxels, mm.")] = None
    position_mm: Annotated[
        Triple, Parameter(help="Position of the middle of the box, or of the grid's origin, mm.")
    ] = (
        0.0,
        0.0,
        0.0,
    )
    rotation_deg: Annotated[Triple, Parameter(help="Rotations of the box about x, then y, then z.")] = (0.0, 0.0, 0.0)


@app.command(
    help_epilogue="""\
More examples:

    lfmesh matrix scene.toml -o m.h5 --split transmit \\
      --counts 64 64 64 --size-mm 20 20 20 --position-mm 0 0 -500
"""
)
def matrix(
    scene: SceneFile,
    /,
    *,
    out: Annotated[Path, Parameter(name=["--out", "-o"], help="File to write: .npz, or .h5 with h5py.")],
    voxels: Voxels | None = None,
    channel: Annotated[Whole, Parameter(help="Index of the wavelength or band, from 0; each has its own matrix.")] = 0,
    threshold: Annotated[
        float, Parameter(help="Drop entries below this share of the largest entry of their pixel.")
    ] = 1e-6,
    absorption: Annotated[
        bool, Parameter(help="Reduce the entries by absorption and scattering in the scene's media.")
    ] = False,
    inside: Annotated[
        str | None, Parameter(help='Glass or liquid body that contains the grid, such as "tanks[0] liquid".')
    ] = None,
    overrides: Overrides | None = None,
) -> int:
    """Write a sparse matrix with standard errors: the light on every pixel from every voxel of an emitting grid.

    The same command continues an interrupted one, to the same bits. At the end it prints the camera's resolution along
    the axes of the box, and the number of features of a volume that stand out of noise of 1 %.
    """
    with defer_interrupt():
        from lfmesh.files.matrix import blocks_folder, finished_blocks, write_projection_matrix
        from lfmesh.scene import load
    loaded = overridden(load(scene), overrides)
    box = _box(voxels or Voxels())
    try:
        with status() as report:
            write_projection_matrix(
                loaded, box, out, channel=channel, threshold=threshold, absorption=absorption,
                inside=inside, say=lambda line: print(wrapped(line), flush=True),
                progress=lambda done, total: report(f"{100 * done // total} % of the pixels"),
            )  # fmt: skip
    except KeyboardInterrupt:
        return stopped(blocks_folder(out), finished_blocks(out), "blocks")
    _print_resolution(out)
    list_files([out])
    return 0


def _print_resolution(out: Path) -> None:
    """Print the resolution of a camera, if its matrix fits into memory."""
    from lfmesh.files.matrix import open_projection_matrix
    from lfmesh.lightfield.volumes.resolution_messages import resolution_message
    from lfmesh.scene.memory import fits_into_memory

    if not fits_into_memory(COPIES * out.stat().st_size):
        print(wrapped("too large for this machine's memory: the resolution was not computed"))
        return
    with status() as report:
        report("computing the resolution")
        message = resolution_message(open_projection_matrix(out))
    print(wrapped(message), flush=True)


def _box(given: Voxels) -> "VoxelBox":
    """Return the requested box of voxels."""
    from lfmesh.lightfield.volumes.voxel_box import VoxelBox, read_box

    if given.grid is not None:
        if given.counts is not None or given.size_mm is not None:
            raise LfmeshError(f"--grid {given.grid} has its own counts and size: omit --counts and --size-mm")
        return VoxelBox.of(read_box(given.grid), given.position_mm, given.rotation_deg)
    if given.counts is None or given.size_mm is None:
        raise LfmeshError("no voxels given: give --grid with a file, or --counts and --size-mm of a box")
    return VoxelBox.of_size(given.counts, given.size_mm, given.position_mm, given.rotation_deg)
