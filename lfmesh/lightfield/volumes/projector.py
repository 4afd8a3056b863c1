"""Tracer of the rows of a projection matrix: power on pixels from each voxel of an emitting grid.

Rays start at the pixels and pass array and lens like the adjoint image's, with the same random numbers. In object space
each continues, through glass, to a target. Every voxel on the way adds chord times weight over n², as rays conserve
radiance over n². With `transport.diffraction` each voxel has the point spread of its centre instead.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import (
    ClearAirWarning,
    LfmeshError,
    PictureWarning,
    SceneError,
    in_order,
    warn_caller,
)
from lfmesh.geometry import frame as frames
from lfmesh.geometry.index_media import bends
from lfmesh.geometry.voxels import read_voxels
from lfmesh.lightfield.volumes.chords import Haze, Room, Rows, room_for, sum_rows
from lfmesh.lightfield.volumes.object_segments import Segments, object_segments
from lfmesh.lightfield.volumes.voxel_box import VoxelBox
from lfmesh.lightfield.volumes.voxel_pictures import voxel_pictures
from lfmesh.scene import Medium, Scene
from lfmesh.scene.literals import literal
from lfmesh.transport.build import build
from lfmesh.transport.checks.found import given_up
from lfmesh.transport.engine import CHUNK, Workspace
from lfmesh.transport.packets.packet import (
    CAMERA_FRAME,
    COUNTERS,
    OBJECT_FRAME,
    WORLD_FRAME,
)
from lfmesh.transport.packets.random import descendant
from lfmesh.transport.render.parts import OWN_BOOK, Part
from lfmesh.transport.render.render import warn_beforehand
from lfmesh.transport.render.tracer import Tracer
from lfmesh.transport.settings import ledger_of
from lfmesh.transport.sources.pixels import PixelSource
from lfmesh.transport.sources.source import Launcher
from lfmesh.transport.tables.lights import MM2
from lfmesh.transport.world import World
from lfmesh.waves.point_spread import TOLERANCE

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]

THRESHOLD = 1e-6
"""Default fraction of a row's largest entry below which entries are dropped."""

RAYS_AT_ONCE = 1 << 18
"""Approximate number of rays in a block of pixels; their segments take some 100 bytes each."""
SAMPLED = 128
"""Pixels used to estimate the size of a matrix."""
ENTRIES_AT_FIRST = 64
"""Entries per row of a block before its memory grows."""


class Block(NamedTuple):
    """Finished rows of some pixels."""

    entries: Numbers  # (rows,)
    column: NDArray[np.int32]
    value: Array
    error: NDArray[np.float32]
    row_error: Array
    dropped: Array
    book: Array  # (slots,) sum over the replicates


class Projector:
    """Tracer of rows of a scene's projection matrix for one channel.

    Parameters
    ----------
    scene : Scene
    grid : VoxelBox, or a voxel grid
    channel : int
        Index of the wavelength or band.
    threshold : float
    absorption : bool
        Attenuate entries by absorption and scattering of media on the way to the camera.
    inside : str, optional
        Name of the body of glass or liquid that contains the grid (default: none).
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
                f"{', '.join(dimming)}: this projection matrix ignores absorption and scattering by media, and sees "
                "voxels as through clear air; absorption = True includes them"
            )
            self._known.append(clear)
            warn_caller([clear])
        self.channel, self.threshold = int(channel), float(threshold)
        self.waves = scene.transport.diffraction != "none"
        self._scene = scene
        self._of_centres: Array | None = None
        # Light from the scene's lights, targets, media and particles is not part of the matrix.
        alone: dict[str, Any] = {
            "transport.method": "adjoint", "transport.diffraction": "none", "lights": (), "particles": (),
        }  # fmt: skip
        self.world = build(scene.changed(alone | ({} if absorption else {"media": _bending_alone(scene)})))
        self._volumes = self.world.tables.objects.volumes if absorption else None
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
        # Emission of 1 W/(mm³ sr); for a band, over the whole range of its lines.
        self._power = self.world.lines.power(1.0)
        self._launchers = {part.number: Launcher(partial(_workspace, self.world, part)) for part in self.parts}

    @property
    def all_pixels(self) -> Numbers:
        """Numbers of all pixels."""
        return np.arange(self.tracer.pixels)

    @property
    def pixels_at_once(self) -> int:
        """Pixels per block."""
        rays = sum(part.samples(self.tracer.samples) for part in self.parts) * self.replicates
        fields = self.world.tables.objects.fields
        chords = 1 if fields is None else 1 + int(fields.fields.rows["slabs"].max())
        return max(1, min(1 << 16, RAYS_AT_ONCE // (rays * chords)))

    def blocks(self, pixels: Numbers) -> Iterator[Numbers]:
        """Yield the pixels of each block."""
        for first in range(0, len(pixels), self.pixels_at_once):
            yield pixels[first : first + self.pixels_at_once]

    def entries_of_sample(self, pixels: Numbers) -> float:
        """Return the mean number of entries per row, from a sample of rows."""
        some = pixels[np.unique(np.linspace(0, len(pixels) - 1, SAMPLED).astype(np.int64))]
        return float(self.rows(some).entries.mean())

    def warnings(self, book: Array) -> tuple[PictureWarning, ...]:
        """Return the warnings of a matrix, and issue those found by tracing.

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
        """Return the rows of increasing pixel numbers, independent of the other pixels in the block."""
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

    def _wave_rows(self, pixels: Numbers) -> Block:
        """Return the rows of pixels from point spreads."""
        if self._of_centres is None:
            to_camera = self.world.tables.frames[WORLD_FRAME, CAMERA_FRAME]
            self._of_centres, warned = voxel_pictures(
                self._scene, self.grid, to_camera, self.wavelength_nm, self.tolerance
            )
            self._known += warned
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
        # Sort each row by voxel, as readers of sparse matrices expect.
        row = np.repeat(np.arange(count), np.diff(rows.end, prepend=0))
        order = np.lexsort((rows.column[:filled], row))
        return Block(
            np.diff(rows.end, prepend=0), rows.column[order], rows.value[order], rows.error[order], rows.row_error,
            rows.dropped, book,
        )  # fmt: skip

    def _segments(self, pixels: Numbers, replicate: int, book: Array) -> Iterator[Segments]:
        """Yield the segments of a replicate's rays from pixels; add the fate of the rays to a book."""
        key = descendant(self.tracer.seed, replicate)
        lines = self.world.lines
        for part in self.parts:
            stream = descendant(key, part.number * lines.channels + self.channel)
            samples = part.samples(self.tracer.samples)
            source = PixelSource(pixels, samples, stream, lines.nodes[self.channel], channel=0)
            for some in source.parts(CHUNK):
                launcher = self._launchers[part.number]
                for work in launcher.launches(source, some):
                    segments = object_segments(work, part)
                    power = np.where(segments.place == self._place, self._power[segments.colour], 0.0)
                    yield segments._replace(weight=segments.weight * power)
                book += part.booked(launcher.workspace.book)[OWN_BOOK]


def _place_of(world: World, inside: str | None) -> int:
    """Return the rank of the body that contains the grid; 0 for air."""
    if inside is None:
        return 0
    try:
        return int(world.tables.objects.rank[world.scene.body_named(inside)])
    except SceneError as error:
        raise LfmeshError(f"inside = {literal(inside)}: {error}") from None


def _without_scattered(part: Part) -> Part:
    """Return a part that loses light scattered by media, like absorbed light."""
    objects = part.tables.objects
    if objects.volumes is None:
        return part
    volumes = objects.volumes._replace(scatters=False)
    return replace(part, tables=part.tables._replace(objects=objects._replace(volumes=volumes)))


def _check(scene: Scene, channel: int, threshold: float) -> None:
    whole = isinstance(channel, int | np.integer) and not isinstance(channel, bool)
    if not whole or not 0 <= channel < scene.channels:
        raise LfmeshError(f"channel = {literal(channel)}: must be a whole number from 0 to {scene.channels - 1}")
    number = isinstance(threshold, int | float | np.number) and not isinstance(threshold, bool)
    if not number or not 0.0 <= threshold < 1.0:
        raise LfmeshError(f"threshold = {literal(threshold)}: must lie from 0 to below 1")
    if scene.transport.polarisation:
        raise LfmeshError("transport.polarisation: a projection matrix is for unpolarised light; omit it")
    if scene.transport.diffraction != "none" and scene.camera.sensor.bands:
        raise LfmeshError(
            "camera.sensor.bands: a matrix with transport.diffraction has point spreads at single wavelengths; omit "
            "bands"
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


def _bending_alone(scene: Scene) -> tuple[Medium, ...]:
    """Return the media that bend light; refuse those that dim it as well."""
    found = []
    dimming = _dimming(scene)
    for number, medium in enumerate(scene.media):
        if not bends(scene, medium):
            continue
        if (name := medium.name or f"media[{number}]") in dimming:
            raise SceneError(f"{name} bends light and dims it: give absorption = True, which includes both")
        found.append(medium)
    return tuple(found)


def _workspace(world: Any, part: Part) -> Workspace:
    tables, objects = part.tables, part.tables.objects
    if objects.fields is not None:
        # Each chord is a segment: no field is crossed in one move.
        fields = objects.fields._replace(free=np.zeros_like(objects.fields.free))
        tables = tables._replace(objects=objects._replace(fields=fields))
    return Workspace(world, part.options._replace(still=True), CHUNK, tables)
