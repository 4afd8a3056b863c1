"""The projection matrix of a camera: what every pixel detects of every voxel of an emitting grid.

Rays start at the pixels and pass array and lens exactly as those of the adjoint image do, with the same random numbers;
in object space each runs on, through glass, to the target that it meets. Where it crosses a voxel, the voxel adds
chord times weight, divided by the square of the refractive index there, as radiance over n² is what a ray keeps.
With `transport.diffraction` there are no rays: each voxel shows the point spread of its centre.
"""

import math
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import islice
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.errors import (
    ClearAirWarning,
    DiffractionWarning,
    LfmeshError,
    PictureWarning,
    SceneError,
    in_order,
    warn_caller,
)
from lfmesh.geometry import frame as frames
from lfmesh.geometry.voxels import read_voxels
from lfmesh.lightfield.volumes.chords import Haze, Room, Rows, room_for, sum_rows
from lfmesh.lightfield.volumes.resolution import effective_rank, resolved_lengths
from lfmesh.lightfield.volumes.voxel_box import VoxelBox
from lfmesh.scene import Scene
from lfmesh.scene.literals import literal
from lfmesh.transport.checks.found import given_up
from lfmesh.transport.engine import CHUNK, Workspace
from lfmesh.transport.events.bodies import RANK
from lfmesh.transport.packets.packet import (
    BY_MESH,
    CAMERA_FRAME,
    COUNTERS,
    ENDED,
    LENS,
    OBJECT_FRAME,
    OBJECTS,
    PIXEL_MASK,
    ROULETTE,
    S_ABSORBED,
    S_ESCAPED,
    S_TARGET,
    STATIONS,
    TRANSMIT,
    WORLD_FRAME,
    Options,
)
from lfmesh.transport.packets.random import descendant
from lfmesh.transport.paths.automaton import COUNTS, STANDING
from lfmesh.transport.regions.objects import admit_to_objects
from lfmesh.transport.render.parts import OWN_BOOK, Part
from lfmesh.transport.render.render import warn_beforehand
from lfmesh.transport.render.tracer import Tracer
from lfmesh.transport.settings import ledger_of, with_thinning
from lfmesh.transport.sources.pixels import PixelSource
from lfmesh.transport.sources.source import Launcher
from lfmesh.transport.tables.lights import MM2
from lfmesh.transport.threads import Threads
from lfmesh.transport.world import World, build
from lfmesh.waves.pictures import pictures_of_points
from lfmesh.waves.point_spread import TOLERANCE, warnings_of

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]

THRESHOLD = 1e-6
"""Share of the largest entry of its row below which an entry is dropped, where none is given."""

RAYS_AT_ONCE = 1 << 18
"""Rays of a block of pixels, about: their segments take some 100 bytes each."""

SAMPLED = 128
"""Pixels by which the size of a matrix is estimated."""

ENTRY_BYTES = 16
"""Of an entry: number of its voxel, value and standard error."""

WIDE_VOXELS = 0.02
"""Difference of a voxel's picture from that of its centre, over its light, above which a wave matrix warns."""

ENTRIES_AT_FIRST = 64
"""For each row of a block, before its memory grows."""


@dataclass(frozen=True, eq=False)
class ProjectionMatrix:
    """Matrix from the emission of voxels to the power on pixels.

    Attributes
    ----------
    matrix : (rows, voxels) scipy.sparse csr_array of float64, W/(W mm⁻³ sr⁻¹) = mm³ sr
        Power in W on each pixel for an emission of 1 W/(mm³ sr) of a voxel: A in b = A x.
    stderr : (entries,) float32
        Standard error of each entry, in the order of `matrix.data`; NaN from a single replicate. Entries of a row come
        from the same rays, and their errors are not independent. 0 of point spreads, which have no noise.
    row_stderr : (rows,) float64
        Standard error of the sum of each row: of a pixel that looks at even emission.
    dropped : (rows,) float64
        Sum of the entries of each row that were left out.
    pixels : (rows,) int64
        Number of the pixel of each row, row by row of the sensor.
    grid : VoxelBox
    threshold : float
        Entries smaller than this share of the largest one of their row were left out.
    wavelength_nm : float
        Of a band its centroid.
    warnings : tuple of PictureWarning
        By which it is or may be wrong.
    sensor_pixels : (int, int), optional
        Columns and rows of the sensor that the pixels are numbered on.
    """

    matrix: "csr_array"
    stderr: NDArray[np.float32]
    row_stderr: Array
    dropped: Array
    pixels: Numbers
    grid: VoxelBox
    threshold: float
    wavelength_nm: float
    warnings: tuple[PictureWarning, ...] = ()
    sensor_pixels: tuple[int, int] | None = None

    def __repr__(self) -> str:
        voxels = " × ".join(map(str, self.grid.shape))
        entries = f"{self.matrix.nnz:,} entries, {self.wavelength_nm:g} nm"
        return f"<ProjectionMatrix: {len(self.pixels):,} pixels by {voxels} voxels, {entries}>"

    @property
    def image_shape(self) -> tuple[int, int] | None:
        """Rows and columns of the rectangle that the pixels fill, row by row; None if they fill none, or unknown."""
        if self.sensor_pixels is None:
            return None
        y, x = np.divmod(self.pixels, self.sensor_pixels[0])
        rows, columns = int(np.ptp(y)) + 1, int(np.ptp(x)) + 1
        return (rows, columns) if rows * columns == len(self.pixels) else None

    @property
    def dropped_share(self) -> float:
        """Part of the sum of all entries that was left out."""
        left_out = float(self.dropped.sum())
        return left_out / (left_out + float(self.matrix.data.sum())) if left_out > 0.0 else 0.0

    @cached_property
    def resolved_mm(self) -> Array:
        """Distance along each axis of the grid at which the images of two voxels are half alike, (3,) float64, mm.

        See `lfmesh.lightfield.volumes.resolution.resolved_lengths`.
        """
        return resolved_lengths(self.matrix, self.grid.shape, self.grid.spacing_mm)

    @cached_property
    def effective_rank(self) -> int:
        """Number of independent features of a volume that stand out of noise of 1 % of the brightest one.

        Singular values above 1/100 of the largest; see `lfmesh.lightfield.volumes.resolution.effective_rank`.
        """
        return effective_rank(self.matrix)

    def image(self, emission: ArrayLike) -> Array:
        """Return the image of an emission, (rows,) W.

        Parameters
        ----------
        emission : (nx, ny, nz) or (voxels,) float64, W/(mm³ sr)

        Returns
        -------
        (rows,) float64
            W.

        Raises
        ------
        LfmeshError
            The emission has another number of voxels.
        """
        x = np.asarray(emission, dtype=np.float64)
        if x.shape not in (self.grid.shape, (self.grid.voxels,)):
            raise LfmeshError(f"the emission has the shape {x.shape}, and the grid {self.grid.shape} voxels")
        return np.asarray(self.matrix @ x.reshape(-1))


class Segments(NamedTuple):
    """Straight pieces of rays in object space.

    Attributes
    ----------
    origin, direction : (n, 3) float64
        World frame, mm; unit directions.
    length : (n,) float64, mm
    weight : (n,) float64, m² sr
        Over the square of the index of the medium.
    pixel : (n,) int64
    colour : (n,) int64
        Number of the wavelength.
    place : (n,) int64
        Rank of the body of glass or liquid that each is in; 0: air.
    per_mm : (n,) float64
        Absorption coefficient of that body, 1/mm.
    """

    origin: Array
    direction: Array
    length: Array
    weight: Array
    pixel: Numbers
    colour: Numbers
    place: Numbers
    per_mm: Array


class Block(NamedTuple):
    """The finished rows of some pixels."""

    entries: Numbers  # (rows,)
    column: NDArray[np.int32]
    value: Array
    error: NDArray[np.float32]
    row_error: Array
    dropped: Array
    book: Array  # (slots,), sum over the replicates


class Projector:
    """Traces rows of the projection matrix of a scene, at one of its channels.

    Parameters
    ----------
    scene : Scene
    grid : VoxelBox, or a voxel grid
    channel : int
        Number of the wavelength or band.
    threshold : float
    absorption : bool
        Whether what media absorb and scatter on the way to the camera is missing from its entries.
    inside : str, optional
        Name of the body of glass or liquid that the grid is in; left out, it is in none.
    tolerance : float
        Of point spreads, see `lf.point_spread`.

    Raises
    ------
    LfmeshError
        The grid is not in front of the lens, or a setting is out of range.
    """

    def __init__(
        self, scene: Scene, grid: Any, channel: int = 0, threshold: float = THRESHOLD, *, absorption: bool = False,
        inside: str | None = None, tolerance: float = TOLERANCE,
    ) -> None:  # fmt: skip
        self.grid = VoxelBox.of(grid)
        self.tolerance = tolerance
        _check(scene, channel, threshold)
        self.absorption, self.inside = bool(absorption), inside
        self._known: list[PictureWarning] = []
        if not absorption and (dimming := _dimming(scene)):
            clear = ClearAirWarning(
                f"{', '.join(dimming)}: what media absorb and scatter is not in this projection matrix, whose voxels "
                "are seen as through clear air; absorption = True puts it in"
            )
            self._known.append(clear)
            warn_caller([clear])
        self.channel, self.threshold = int(channel), float(threshold)
        self.waves = scene.transport.diffraction != "none"
        self._scene = scene
        self._of_centres: Array | None = None
        # What lights, targets, media and particles of the scene send is no part of the matrix.
        alone: dict[str, Any] = {
            "transport.method": "adjoint", "transport.diffraction": "none", "lights": (), "particles": (),
        }  # fmt: skip
        self.world = build(scene.changed(alone | ({} if absorption else {"media": ()})))
        self._volumes = self.world.tables.objects.volumes
        self._place = _place_of(self.world, inside)
        front = frames.points(self.world.tables.frames[WORLD_FRAME, CAMERA_FRAME], self.grid.corners_mm())[:, 2].max()
        if not front < 0.0:
            raise LfmeshError(
                f"the grid reaches to z = {front:.6g} mm in the camera's frame: it must lie in front of the first lens "
                "vertex, where z is below 0"
            )
        self.tracer = Tracer(self.world, check=False)
        self._known += () if self.waves else warn_beforehand(self.tracer)
        self.parts = [_without_scattered(part) for part in self.tracer.parts if part.options.adjoint]
        self.replicates = self.world.scene.transport.replicates
        self.wavelength_nm = self.world.scene.wavelengths_nm[self.channel]
        # Emission of 1 W/(mm³ sr), of a band over the whole range of wavelengths, as lines have it.
        self._power = self.world.lines.power(1.0)
        self._launchers = {part.number: Launcher(partial(_workspace, self.world, part)) for part in self.parts}

    @property
    def all_pixels(self) -> Numbers:
        """Numbers of all pixels."""
        return np.arange(self.tracer.pixels)

    @property
    def pixels_at_once(self) -> int:
        """Pixels of a block."""
        rays = sum(part.samples(self.tracer.samples) for part in self.parts) * self.replicates
        return max(1, min(1 << 16, RAYS_AT_ONCE // rays))

    def blocks(self, pixels: Numbers) -> Iterator[Numbers]:
        """Yield the pixels of each block."""
        for first in range(0, len(pixels), self.pixels_at_once):
            yield pixels[first : first + self.pixels_at_once]

    def entries_of_sample(self, pixels: Numbers) -> float:
        """Return the mean number of entries of a row, from some of the rows."""
        some = pixels[np.unique(np.linspace(0, len(pixels) - 1, SAMPLED).astype(np.int64))]
        return float(self.rows(some).entries.mean())

    def warnings(self, book: Array) -> tuple[PictureWarning, ...]:
        """Return the warnings of a matrix, and warn of those that were not known before it was traced.

        Parameters
        ----------
        book : (slots,) float64
            Sum over the blocks.
        """
        ledger = ledger_of(book, np.zeros(COUNTERS, np.int64), self.world, 0, "m² sr")
        found = given_up(self.world.scene, ledger)
        warn_caller(found)
        return in_order([*self._known, *found])

    def rows(self, pixels: Numbers, room: Room | None = None) -> Block:
        """Return the rows of increasing pixel numbers, whatever pixels they are traced with."""
        if self.waves:
            return self._wave_rows(pixels)
        book = np.zeros(len(self.world.slots))
        found = [
            (replicate, some)
            for replicate in range(self.replicates)
            for some in self._segments(pixels, replicate, book)
        ]
        counts = [len(some.pixel) for _, some in found]
        segments = Segments(*(np.concatenate(column) for column in zip(*(some for _, some in found), strict=True)))
        replicate = np.repeat([number for number, _ in found], counts)
        slot = np.searchsorted(pixels, segments.pixel) * self.replicates + replicate
        order = np.argsort(slot, kind="stable")
        first = np.searchsorted(slot[order], np.arange(len(pixels) * self.replicates + 1))
        ordered = Segments._make(column[order] for column in segments)
        return self._summed(ordered, first, len(pixels), room or room_for(self.grid.voxels), book)

    def _pictures(self) -> Array:
        """Compute what each pixel detects of each voxel by its centre's point spread, (pixels, voxels), mm³ sr."""
        centres = self.grid.centres_mm().reshape(-1, 3)
        beside = _within_middle_voxel(self.grid)
        points = frames.points(self.world.tables.frames[WORLD_FRAME, CAMERA_FRAME], np.concatenate([centres, beside]))
        size = 8.0 * len(points) * self.tracer.pixels
        if not fits_into_memory(3.0 * size):
            raise LfmeshError(
                f"{len(points):,} point spreads on {self.tracer.pixels:,} pixels take {size / 1e9:.3g} GB: give fewer "
                "voxels or pixels"
            )
        pictures = pictures_of_points(self._scene, points, self.wavelength_nm, tolerance=self.tolerance)
        warning = [*warnings_of(pictures.beyond), *_wide_voxels(pictures.mean, self.grid.shape)]
        self._known += warning
        warn_caller(warning)
        own = pictures.mean[: len(centres)]
        return own.reshape(len(own), -1).T * float(np.prod(self.grid.spacing_mm))

    def _wave_rows(self, pixels: Numbers) -> Block:
        """Return the rows of pixels from point spreads."""
        if self._of_centres is None:
            self._of_centres = self._pictures()
        rows = self._of_centres[pixels]
        kept = rows > self.threshold * rows.max(axis=1, keepdims=True)
        _, column = np.nonzero(kept)
        return Block(
            kept.sum(axis=1), column.astype(np.int32), rows[kept], np.zeros(len(column), np.float32),
            np.zeros(len(pixels)), np.where(kept, 0.0, rows).sum(axis=1), np.zeros(len(self.world.slots)),
        )  # fmt: skip

    def _summed(self, segments: Segments, first: Numbers, count: int, room: Room, book: Array) -> Block:
        p, d = self.grid.in_voxels(segments.origin, segments.direction)
        weight = segments.weight / MM2
        moves = self.world.tables.frames[WORLD_FRAME, OBJECT_FRAME]
        haze = Haze(
            self._volumes, frames.points(moves, segments.origin), frames.directions(moves, segments.direction),
            segments.colour, np.empty(0), segments.place, segments.per_mm,
        )  # fmt: skip
        capacity = ENTRIES_AT_FIRST * count
        rows = Rows(
            np.zeros(capacity, np.int32), np.zeros(capacity), np.zeros(capacity, np.float32), np.zeros(count, np.int64),
            np.zeros(count), np.zeros(count),
        )  # fmt: skip
        done = 0
        while True:
            done = sum_rows(
                done, p, d, segments.length, weight, first, self.replicates, *self.grid.shape, self.threshold, haze,
                room, rows,
            )  # fmt: skip
            if done == count:
                break
            larger = max(2 * len(rows.column), self.grid.voxels)
            rows = rows._replace(
                column=np.resize(rows.column, larger), value=np.resize(rows.value, larger),
                error=np.resize(rows.error, larger),
            )  # fmt: skip
        filled = int(rows.end[-1])
        # Each row by the numbers of its voxels, as readers of sparse matrices expect.
        row = np.repeat(np.arange(count), np.diff(rows.end, prepend=0))
        order = np.lexsort((rows.column[:filled], row))
        return Block(
            np.diff(rows.end, prepend=0), rows.column[order], rows.value[order], rows.error[order], rows.row_error,
            rows.dropped, book,
        )  # fmt: skip

    def _segments(self, pixels: Numbers, replicate: int, book: Array) -> Iterator[Segments]:
        """Yield the pieces of the rays that a replicate sends from pixels; add what became of them to a book."""
        key = descendant(self.tracer.seed, replicate)
        lines = self.world.lines
        for part in self.parts:
            stream = descendant(key, part.number * lines.channels + self.channel)
            samples = part.samples(self.tracer.samples)
            source = PixelSource(pixels, samples, stream, lines.nodes[self.channel], channel=0)
            for some in source.parts(CHUNK):
                work = self._launchers[part.number].launch(source, some)
                segments = _in_object_space(work, part)
                book += part.booked(work.book)[OWN_BOOK]
                power = np.where(segments.place == self._place, self._power[segments.colour], 0.0)
                yield segments._replace(weight=segments.weight * power)


def projection_matrix(
    scene: Scene, grid: Any, *, channel: int = 0, pixels: ArrayLike | None = None, threshold: float = THRESHOLD,
    absorption: bool = False, inside: str | None = None, tolerance: float = TOLERANCE,
    say: Callable[[str], None] | None = None,
) -> ProjectionMatrix:  # fmt: skip
    """Trace what every pixel of a camera detects of every voxel of an emitting grid.

    The rays are those of the adjoint image: `transport.samples`, `replicates`, `split` and `seed` hold. With
    `split = "transmit"` they follow the image path alone; else reflections in lens and array are in the matrix, too,
    and fill it. Targets hide what lies behind them; light that they scatter is no part of it. Glass in front of the
    camera refracts, and what it absorbs is missing from the entries. With `transport.diffraction` each voxel shows
    the point spread of its centre, by `lf.point_spread`, coherent over all lenslets, and what that refuses is refused:
    media, bodies of glass, hidden voxels, voxels out of the field. As with `[[media]]`, voxels count where they are
    outside all bodies or, with `inside`, in one body of glass or liquid.

    Parameters
    ----------
    scene : Scene
    grid : VoxelBox, or a voxel grid in the world frame
        Each voxel emits evenly.
    channel : int
        Number of the wavelength or band. Of bands the emission is that over the whole range of wavelengths that they
        reach, spread evenly.
    pixels : (rows,) int, optional
        Numbers of the pixels, row by row of the sensor, increasing; all if left out.
    threshold : float
        Entries smaller than this share of the largest one of their row are dropped, and booked.
    absorption : bool
        Take from the entries what the scene's `[[media]]` absorb and scatter on the way to the camera. Left out, air
        is clear. Light that is scattered into a ray is in no entry.
    inside : str, optional
        Name of the body of glass or liquid that the grid is in, such as "tanks[0] liquid". Left out, it is in none.
    tolerance : float
        With diffraction, the largest error of a column over its light, as of `lf.point_spread`.
    say : callable, optional
        Called with lines for the user: the expected size, first of all.

    Returns
    -------
    ProjectionMatrix

    Warns
    -----
    PictureWarning
        The matrix is or may be wrong, as an image of the scene would be; `ProjectionMatrix.warnings` keeps them.

    Raises
    ------
    LfmeshError
        The grid is not in front of the lens or not seen by the camera, the matrix would not fit into memory
        (`lf.write_projection_matrix` streams it to a file), or a setting is out of range.
    """
    from scipy.sparse import csr_array

    projector = Projector(scene, grid, channel, threshold, absorption=absorption, inside=inside, tolerance=tolerance)
    chosen = pixels_of(projector, pixels)
    size = size_in_words(projector, chosen)
    if say is not None:
        say(size.words)
    if not fits_into_memory(size.bytes):
        raise LfmeshError(f"{size.words}: more than this machine's memory; stream it with lf.write_projection_matrix")
    done = list(computed(projector, list(projector.blocks(chosen))))
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


def not_seen(projector: Projector) -> str:
    """Say that a matrix would be empty."""
    names = ", ".join(
        f'"{name}"' for name in {number: name for name, number in projector.world.scene.bodies()}.values()
    )
    other = f"; what lies in a body needs inside, one of {names}" if names else ""
    where = f" in {projector.inside}" if projector.inside is not None else " outside all bodies" if names else ""
    return (
        f"no ray from these pixels meets the grid{where}: the matrix would be empty; move the grid into the camera's "
        f"view{other}"
    )


def _within_middle_voxel(grid: VoxelBox) -> Array:
    """Return Gauss's two points in the middle voxel, along each axis of one or two voxels, (n, 3) mm, world frame."""
    middle = grid.centres_mm()[tuple(count // 2 for count in grid.shape)]
    step = grid.to_world[:, :3] * grid.spacing_mm / np.sqrt(12.0)
    few = [axis for axis, count in enumerate(grid.shape) if count < 3]
    return np.array([middle + way * step[:, axis] for axis in few for way in (-1.0, 1.0)]).reshape(-1, 3)


def _wide_voxels(pictures: Array, shape: tuple[int, int, int]) -> list[DiffractionWarning]:
    """Warn of voxels whose light is not that of their centres.

    A voxel's mean differs from its centre by a 24th of the second differences between neighbours, along each axis; of
    one or two voxels that of the middle one is known by Gauss's two points.

    Parameters
    ----------
    pictures : (voxels + n, rows, columns) float64
        Of the centres, and of `_within_middle_voxel`.
    shape : (int, int, int)
    """
    voxels = math.prod(shape)
    mean, pairs = pictures[:voxels].reshape(*shape, -1), pictures[voxels:].reshape(-1, 2, *pictures.shape[1:])
    middle = pictures[np.ravel_multi_index(tuple(count // 2 for count in shape), shape)]
    off = sum(float(np.abs(pair.mean(axis=0) - middle).sum() / middle.sum()) for pair in pairs)
    for axis, count in enumerate(shape):
        if count > 2:
            off += float(np.abs(np.diff(mean, 2, axis=axis)).sum() / mean.sum()) / 24.0 * count / (count - 2)
    if off <= WIDE_VOXELS:
        return []
    return [
        DiffractionWarning(
            "a wave matrix has the point spreads of the voxels' centres, and those of whole voxels differ from them "
            f"by some {off:.1%} of the light: take smaller voxels"
        )
    ]


def _place_of(world: World, inside: str | None) -> int:
    """Return the rank of the body that a grid is in; 0: air."""
    if inside is None:
        return 0
    try:
        return int(world.tables.objects.rank[world.scene.body_named(inside)])
    except SceneError as error:
        raise LfmeshError(f"inside = {literal(inside)}: {error}") from None


def _without_scattered(part: Part) -> Part:
    """Return a part in which what media scatter is lost, as what they absorb is."""
    objects = part.tables.objects
    if objects.volumes is None:
        return part
    volumes = objects.volumes._replace(scatters=False)
    return replace(part, tables=part.tables._replace(objects=objects._replace(volumes=volumes)))


class Size(NamedTuple):
    """The expected size of a matrix."""

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
        f"{len(pixels):,} pixels × {projector.grid.voxels:,} voxels: about {entries:.3g} entries ({each:.4g} a pixel), "
        f"{size / 1e9:.3g} GB",
    )  # fmt: skip


def computed(projector: Projector, blocks: list[Numbers]) -> Iterator[Block]:
    """Yield the rows of blocks of pixels in their order, traced in threads; only a few are kept at a time."""
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
    """Return the numbers of the pixels that were asked for; all of them for None."""
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


def _check(scene: Scene, channel: int, threshold: float) -> None:
    whole = isinstance(channel, int | np.integer) and not isinstance(channel, bool)
    if not whole or not 0 <= channel < scene.channels:
        raise LfmeshError(f"channel = {literal(channel)}: must be a whole number from 0 to {scene.channels - 1}")
    number = isinstance(threshold, int | float | np.number) and not isinstance(threshold, bool)
    if not number or not 0.0 <= threshold < 1.0:
        raise LfmeshError(f"threshold = {literal(threshold)}: must lie from 0 to below 1")
    if scene.transport.polarisation:
        raise LfmeshError("transport.polarisation: a projection matrix is one of unpolarised light; leave it out")
    if scene.transport.diffraction != "none" and scene.camera.sensor.bands:
        raise LfmeshError(
            "camera.sensor.bands: a matrix with transport.diffraction is of point spreads at single wavelengths; "
            "leave bands out"
        )
    if any(finish.is_rough for _, finish in scene.finishes()):
        raise LfmeshError("a rough finish scatters light: a projection matrix takes polished faces only")


def _dimming(scene: Scene) -> list[str]:
    """Return the names of media that absorb or scatter."""
    names = []
    for number, medium in enumerate(scene.media):
        given = medium.grid
        voxels: Mapping[str, Array] = {}
        if given is not None:
            path = scene.resolve(given.file)
            voxels = read_voxels(path, given.spacing_mm, given.origin_mm, given.interpolation, given.quantity).values
        own = (medium.absorption_per_mm, medium.scattering_per_mm)
        held = (voxels.get(key) for key in ("absorption_per_mm", "scattering_per_mm"))
        if any(value != 0.0 for value in own) or any(array is not None and array.any() for array in held):
            names.append(medium.name or f"media[{number}]")
    return names


def _workspace(world: Any, part: Part) -> Workspace:
    return Workspace(world, part.options, CHUNK, part.tables)


def fits_into_memory(size: float) -> bool:
    """Return True where this machine has memory of so many bytes."""
    return size <= _memory()


def _memory() -> float:
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, ValueError, OSError):
        return np.inf


def _in_object_space(work: Workspace, part: Part) -> Segments:
    """Trace packets from their pixels out of the camera, and return the pieces of their paths in object space."""
    elsewhere = np.arange(STATIONS) != OBJECTS
    while (work.tops[:STATIONS] * elsewhere).any():
        work.advance(int(np.argmax(work.tops[:STATIONS] * elsewhere)))
    packets = work.stacks.waiting(OBJECTS)
    counts = STANDING[part.options.paths] == COUNTS
    if not work.world.targets:
        segments = _pieces(packets, work, packets["frame"], counts)
        work.tops[OBJECTS] = 0
        return segments
    options = work.options
    work.options = _onward(options)
    try:
        return _followed(work, counts)
    finally:
        work.options = options


def _onward(options: Options) -> Options:
    """Return the options by which packets go on in object space.

    One child of each interface survives with the whole weight, so that each piece of a path has an end.
    """
    split = TRANSMIT if options.thinning.split == TRANSMIT else ROULETTE
    options = with_thinning(options, split=split)
    return options._replace(tracing=True, adjoint=False, faces=BY_MESH, bounce=False)


def _pieces(packets: NDArray[np.void], work: Workspace, frame: NDArray[Any], counts: NDArray[np.bool_]) -> Segments:
    """Return rays without an end, one for each packet."""
    p = np.stack([packets[axis] for axis in ("x", "y", "z")], axis=-1)
    d = np.stack([packets[axis] for axis in ("dx", "dy", "dz")], axis=-1)
    for number in np.unique(frame):
        some = frame == number
        to_world = work.tables.frames[number, WORLD_FRAME]
        p[some], d[some] = frames.points(to_world, p[some]), frames.directions(to_world, d[some])
    index = work.tables.objects.media.indices[packets["medium"], packets["colour"]]
    weight = packets["weight"] / (index * index)
    # The other paths belong to other parts.
    weight = np.where(counts[packets["path"]], weight, 0.0)
    pixel, colour = packets["source"] & PIXEL_MASK, packets["colour"].astype(np.int64)
    absorption = work.tables.objects.media.absorption
    per_mm = np.zeros(len(p)) if absorption is None else absorption.per_mm[packets["medium"], packets["colour"]]
    # Only packets in object space are in bodies, whose numbers have the place of a cell of the array.
    place = np.where((frame == OBJECT_FRAME) & (packets["bodies"] >= 0), packets["bodies"] & RANK, 0)
    return Segments(p, d, np.full(len(p), np.inf), weight, pixel, colour, place.astype(np.int64), per_mm)


def _followed(work: Workspace, counts: NDArray[np.bool_]) -> Segments:
    """Trace packets on from target to target until they have ended, and return the pieces of their paths.

    A packet's `node` holds the number of its piece. A packet that asks Embree again starts where it started before; a
    child starts where its parent's piece ends.
    """
    found = _pieces(work.stacks.waiting(OBJECTS)[:0], work, np.zeros(0, np.int8), counts)
    # Starts of the pieces in the object frame, as the packets hold them.
    starts = np.zeros((0, 3))
    known = 0
    while top := int(work.tops[OBJECTS]):
        fresh = work.stacks.waiting(OBJECTS)[known:]
        unused = np.empty((len(fresh), 3), np.float32)
        admit_to_objects(fresh, unused, unused.copy(), work.tables.frames)
        p = np.stack([fresh[axis] for axis in ("x", "y", "z")], axis=-1)
        is_child = np.ones(len(fresh), np.bool_)
        if len(starts):
            parent = fresh["node"].copy()
            way = p - starts[parent]
            is_child = (way != 0.0).any(axis=1)
            found.length[parent[is_child]] = np.linalg.norm(way[is_child], axis=1)
        children = fresh[is_child]
        fresh["node"][is_child] = len(starts) + np.arange(len(children))
        own = _pieces(children, work, children["frame"], counts)
        found = Segments(*(np.concatenate(pair) for pair in zip(found, own, strict=True)))
        starts = np.concatenate([starts, p[is_child]])
        known = top - work.advance(OBJECTS)
        # What comes back to the lens is followed no further; the grid lies before the lens.
        work.tops[LENS] = 0
    ended = work.ended[: work.tops[ENDED]]
    stopped = np.isin(ended["status"], (S_TARGET, S_ABSORBED))
    if (volumes := work.tables.objects.volumes) is not None:
        # Of what media take whole, as fog without bounds does, the end is where the piece began; it goes on, and dims.
        faded = stopped & (ended["body"] == volumes.rows["slot"][0])
        found.length[ended["node"][faded]] = np.inf
        ended, stopped = ended[~faded], stopped[~faded]
    way = ended["position"] - found.origin[ended["node"]]
    found.length[ended["node"][stopped]] = np.linalg.norm(way[stopped], axis=1)
    # The last piece of what is lost, or cut off after too many events, has no known end: it is left out.
    found.length[ended["node"][~stopped & (ended["status"] != S_ESCAPED)]] = 0.0
    return found
