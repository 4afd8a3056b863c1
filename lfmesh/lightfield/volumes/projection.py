"""The projection matrix of a camera, traced in threads: expected size, blocks of pixels, and the whole matrix."""

from collections.abc import Iterator
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.errors import LfmeshError
from lfmesh.lightfield.volumes.chords import Room, room_for
from lfmesh.lightfield.volumes.projection_matrix import ProjectionMatrix
from lfmesh.lightfield.volumes.projector import THRESHOLD, Block, Projector
from lfmesh.notebook import Say, announced
from lfmesh.scene import Scene
from lfmesh.scene.memory import fits_into_memory
from lfmesh.transport.threads import Threads
from lfmesh.waves.point_spread import TOLERANCE

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]

ENTRY_BYTES = 16
"""Bytes per entry: voxel number, value and standard error."""


def projection_matrix(
    scene: Scene, grid: Any, *, channel: int = 0, pixels: ArrayLike | None = None, threshold: float = THRESHOLD,
    absorption: bool = False, inside: str | None = None, tolerance: float = TOLERANCE,
    say: Say | bool | None = None,
) -> ProjectionMatrix:  # fmt: skip
    """Trace the power on every pixel of a camera from every voxel of an emitting grid.

    Rays are traced as for the adjoint image, with `transport.samples`, `replicates`, `split` and `seed`. With `split =
    "transmit"` they follow only the image path; otherwise the matrix includes reflections in lens and array, which fill
    it. Targets hide voxels behind them; light that they scatter is left out. Glass in front of the camera refracts and
    absorbs.

    With `transport.diffraction` each voxel has the point spread of its centre, by `lf.point_spread`, coherent over all
    lenslets. Media, bodies of glass, and voxels hidden or out of the field are then refused.

    Voxels count outside all bodies or, with `inside`, in one body of glass or liquid.

    Parameters
    ----------
    scene : Scene
    grid : VoxelBox, or a voxel grid in the world frame
        Each voxel emits uniformly.
    channel : int
        Index of the wavelength or band. For bands, the emission is spread evenly over all wavelengths that they reach.
    pixels : (rows,) int, optional
        Pixel numbers, counted row by row of the sensor, increasing (default: all).
    threshold : float
        Entries below this fraction of their row's largest are dropped; their sum is recorded.
    absorption : bool
        Attenuate entries by the absorption and scattering of the scene's `[[media]]` on the way to the camera (default:
        clear air). Light scattered into a ray is left out.
    inside : str, optional
        Name of the body of glass or liquid that contains the grid, such as "tanks[0] liquid" (default: none).
    tolerance : float
        With diffraction, largest error of a column over its light, as for `lf.point_spread`.
    say : callable or bool, optional
        Called with messages, the expected size first. True shows the progress, False nothing. Default: it is shown at a
        terminal or in a notebook after two seconds.

    Returns
    -------
    ProjectionMatrix

    Warns
    -----
    PictureWarning
        The matrix is or may be wrong, like an image of the scene; `ProjectionMatrix.warnings` keeps them.

    Raises
    ------
    LfmeshError
        The grid is not in front of the lens or not seen by the camera, the matrix does not fit into memory
        (`lf.write_projection_matrix` streams it to a file), or a setting is out of range.
    """
    from scipy.sparse import csr_array

    projector = Projector(scene, grid, channel, threshold, absorption=absorption, inside=inside, tolerance=tolerance)
    chosen = pixels_of(projector, pixels)
    size = size_in_words(projector, chosen)
    if not fits_into_memory(size.bytes):
        raise LfmeshError(f"{size.words}: more than this machine's memory; stream it with lf.write_projection_matrix")
    with announced(say) as shown:
        done = _all_blocks(projector, chosen, size, shown)
    end = np.cumsum([0, *np.concatenate([block.entries for block in done])])
    column = np.concatenate([block.column for block in done])
    value = np.concatenate([block.value for block in done])
    if not len(value):
        raise LfmeshError(not_seen(projector))
    return ProjectionMatrix(
        csr_array((value, column, end), shape=(len(chosen), projector.grid.voxels)),
        np.concatenate([block.error for block in done]),
        np.concatenate([block.row_error for block in done]),
        np.concatenate([block.dropped for block in done]),
        chosen,
        projector.grid,
        projector.threshold,
        projector.wavelength_nm,
        projector.warnings(np.sum([block.book for block in done], axis=0)),
        projector.world.scene.camera.sensor.pixels,
    )


def _all_blocks(projector: Projector, pixels: Numbers, size: "Size", say: Say) -> list[Block]:
    """Return the rows of all blocks of pixels, with the progress in words."""
    say(size.words)
    done, blocks = [], list(projector.blocks(pixels))
    for block in computed(projector, blocks):
        done.append(block)
        say(f"{size.words}: {100 * len(done) // len(blocks)} % of the pixels")
    return done


def not_seen(projector: Projector) -> str:
    """Return the message for an empty matrix."""
    names = ", ".join(
        f'"{name}"' for name in {number: name for name, number in projector.world.scene.bodies()}.values()
    )
    other = f"; for the inside of a body give inside, one of {names}" if names else ""
    where = f" in {projector.inside}" if projector.inside is not None else " outside all bodies" if names else ""
    return (
        f"no ray from these pixels meets the grid{where}: the matrix would be empty; move the grid into the camera's "
        f"view{other}"
    )


class Size(NamedTuple):
    """Expected size of a matrix."""

    entries: float
    bytes: float
    words: str


def size_in_words(projector: Projector, pixels: Numbers) -> Size:
    """Estimate the size of a matrix from a sample of its rows."""
    each = projector.entries_of_sample(pixels)
    entries = each * len(pixels)
    size = ENTRY_BYTES * entries + 40.0 * len(pixels)
    return Size(
        entries, size,
        f"{len(pixels):,} pixels × {projector.grid.voxels:,} voxels: about {entries:.3g} entries ({each:.4g} per "
        f"pixel), {size / 1e9:.3g} GB",
    )  # fmt: skip


def computed(projector: Projector, blocks: list[Numbers]) -> Iterator[Block]:
    """Yield the rows of blocks of pixels in order, traced in threads; only a few are kept at a time."""
    threads = projector.tracer.threads
    rooms: list[Room] = []

    def rows(pixels: Numbers) -> Block:
        room = rooms.pop() if rooms else room_for(projector.grid.voxels)
        block = projector.rows(pixels, room)
        rooms.append(room)
        return block

    with Threads(threads) as pool:
        ahead = iter(blocks)
        waiting = [pool.submit(rows, pixels) for pixels in islice(ahead, threads + 1)]
        try:
            while waiting:
                yield waiting.pop(0).result()
                waiting += [pool.submit(rows, pixels) for pixels in islice(ahead, 1)]
        finally:
            for future in waiting:
                future.cancel()


def pixels_of(projector: Projector, pixels: ArrayLike | None) -> Numbers:
    """Return the requested pixel numbers, or all for None."""
    if pixels is None:
        return projector.all_pixels
    given = np.asarray(pixels)
    valid = given.ndim == 1 and given.size > 0 and given.dtype.kind in "iu"
    if (
        not valid
        or (np.diff(given.astype(np.int64)) <= 0).any()
        or given[0] < 0
        or given[-1] >= projector.tracer.pixels
    ):
        raise LfmeshError(
            f"pixels: must be increasing whole numbers from 0 to {projector.tracer.pixels - 1}, at least one of them"
        )
    return given.astype(np.int64)
