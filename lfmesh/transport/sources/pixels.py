"""Pixels, the sources of the adjoint method: rays through the lenslets that show them the exit pupil.

A pixel's power is the integral of radiance over its area and its directions, W = ∫∫ L cos θ dω dA. A packet carries the
importance n'² cos θ dA / density, in m² sr, with n' the index before the pixel. Apart from T, interfaces conserve
radiance over n², so the importance would gain (n_i/n_t)² at each: together, n'² over n² of the medium where the light
starts. Importance has the first from the start, and the light is divided by n².
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.frame import move_direction, move_point
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.aims.disk import Vector
from lfmesh.transport.aims.kick_aim import (
    list_cells_of_pixel,
    shown_after_kick,
    wide_share_after_kick,
)
from lfmesh.transport.aims.lenslet_aim import (
    CELL_U,
    CELL_V,
    DISCRETE,
    PIXEL_U,
    PIXEL_V,
    WHICH_CELL,
    ArraySeen,
    Shown,
    aimed_rays,
    aimed_through_array,
    pixel_extent,
    unaimed_share,
)
from lfmesh.transport.aims.lenslet_faces import glass_before_faces, lenslet_ahead
from lfmesh.transport.aims.mixture import aimed
from lfmesh.transport.engine import Workspace
from lfmesh.transport.events.kick import KICK_U, KICK_V, drawn_kick, key_of_kick, kick_by_key
from lfmesh.transport.events.polarisation import behind_polariser
from lfmesh.transport.packets.book import EMITTED
from lfmesh.transport.packets.packet import (
    BY_ORDER,
    CAMERA_FRAME,
    LENS,
    MLA_FRAME,
    PLATE,
    SAMPLE_SHIFT,
    SENSOR,
    SENSOR_FRAME,
    Flow,
    Options,
    put,
)
from lfmesh.transport.packets.random import derived
from lfmesh.transport.paths.automaton import GHOSTS
from lfmesh.transport.sequences.bundle import (
    DROPPED,
    DX,
    DY,
    DZ,
    ENDED_ON,
    KICK_AT,
    KICK_X,
    KICK_Y,
    WEIGHT,
    X,
    Y,
    Z,
    load,
    move_bundle,
    pad,
)
from lfmesh.transport.sequences.follower import Route, image_route_of
from lfmesh.transport.sequences.image_path import follow_block
from lfmesh.transport.sequences.kicks import draw_kick
from lfmesh.transport.sources.pixel_starts import STARTS, StartRoom, begin_launch, draw_numbers, start_room
from lfmesh.transport.sources.source import Source
from lfmesh.transport.sources.wavelengths import ALONE, Entries, Turn, entries_of_pixels
from lfmesh.transport.tables.lines import FIRST, Nodes
from lfmesh.transport.tables.media import clear
from lfmesh.transport.tables.pixel import area_of_sample
from lfmesh.transport.tables.tables import AimTables, Apertures, Camera, MlaTables, SensorTables

Array = NDArray[np.float64]

_NO_KICK = (0.0, 0.0)


@dataclass(frozen=True, eq=False)
class PixelSource(Source):
    """Pixels of the sensor, all with the same number of samples.

    Attributes
    ----------
    pixels : (n,) int64
        Pixel numbers, row by row.
    samples : int
        Samples per pixel.
    key : uint64
        Random key.
    nodes : Nodes
        Wavelengths of the channel, one per sample. Default: the first of all.
    stratified : bool
        Start from scrambled Sobol' points instead of random ones.
    channel : int, optional
        Column of the film that receives the light. Default: that of the first wavelength.
    turn : Turn
        Turn of the replicate in its group; the key belongs to the group.
    some : range, optional
        Samples of each pixel that start. Default: all.
    """

    pixels: NDArray[np.int64]
    samples: int
    key: np.uint64
    nodes: Nodes = FIRST
    stratified: bool = True
    channel: int | None = None
    turn: Turn = ALONE
    some: range | None = None

    def __len__(self) -> int:
        return len(self.pixels)

    @property
    def each(self) -> int:
        """Samples per pixel that start."""
        return self.samples if self.some is None else len(self.some)

    def pieces(self, chunk: int) -> Iterator[Source]:
        """Yield sources of at most `chunk` samples of each pixel."""
        for first in range(0, self.samples, chunk):
            yield self if self.samples <= chunk else replace(self, some=range(self.samples)[first : first + chunk])

    def launch(self, work: Workspace, part: range) -> None:
        """Start the samples of some of the pixels."""
        channel = self.nodes.first if self.channel is None else self.channel
        into = work.options.pixels._replace(channel=channel, samples=self.samples, columns=work.tables.sensor.columns)
        if self.stratified:
            into = into._replace(stream=self.key, each=self.samples, first=self.turn.first, step=self.turn.step)
        work.options = work.options._replace(pixels=into, stream=self.key)
        pixels = self.pixels[part.start : part.stop]
        for colour, entries in entries_of_pixels(self.nodes, pixels, self.samples, self.key, self.turn, self.some):
            self._launch(work, entries, colour)
        if work.tables.cover is not None:
            # Without a cover a pixel's light meets the array first, or the lens.
            work.stacks.move(PLATE if work.tables.mla.present else LENS, SENSOR)

    def _launch(self, work: Workspace, entries: Entries, colour: int) -> None:
        """Start samples at one wavelength."""
        tables, options = work.tables, work.options
        room = work.kept(
            StartRoom,
            lambda: start_room(tables.aim.lenslets, work.stacks.record, diffracts=tables.mla.apertures is not None),
        )
        seen = tables.frames if tables.apparent is None else tables.apparent
        on_image_path = options.faces == BY_ORDER and options.adjoint and options.paths != GHOSTS
        # For ghosts behind an array, unaimed samples get new directions later.
        unaimed_too = options.paths == GHOSTS and bool(tables.mla.present)
        if on_image_path and tables.cover is None:
            launch_along_image_path(
                entries, self.samples, self.stratified, self.key, colour, tables.camera_of_packets,
                image_route_of(tables),
                tables.aim, work.bundle, work.numbers, options, work.flow(), room,
            )  # fmt: skip
        else:
            launch_adjoint(
                entries, self.samples, self.stratified, self.key, colour, tables.sensor, clear(tables.mla),
                tables.aim, seen, len(tables.lens.surfaces), unaimed_too, work.bundle, work.flow(), room,
            )  # fmt: skip


@kernel
def launch_adjoint(
    entries: Entries, samples: int, stratified: bool, replicate_key: np.uint64, colour: int, sensor: SensorTables,
    mla: MlaTables, aim: AimTables, frames: Array, lens_surfaces: int, unaimed_too: bool,
    bundle: Array, flow: Flow, room: StartRoom,
) -> None:  # fmt: skip
    """Start packets of pixels at one wavelength.

    Parameters
    ----------
    entries : Entries
    samples : int
        Number of samples that share a pixel's light.
    stratified : bool
        Start from scrambled Sobol' points instead of random ones.
    replicate_key : uint64
    colour : int
        Wavelength number.
    lens_surfaces : int
        Number of refracting surfaces of the lens.
    unaimed_too : bool
        Also start samples without a direction towards the lens, with weight 0.
    bundle : (ROWS · BLOCK,) float64
        Working memory.
    """
    begin_launch(room, colour, lens_surfaces)
    station = PLATE if mla.present else LENS
    which, place = 0, 0
    total = entries.taken.sum()
    for first in range(0, total, STARTS):
        count = min(STARTS, total - first)
        draw_numbers(room, stratified, replicate_key, entries, which, place, count)
        which, place = _aim_rays(
            room, bundle, entries, which, place, samples, count, replicate_key, colour, sensor, mla, aim, frames,
            stratified, flow.book,
        )  # fmt: skip
        for i in range(count):
            if unaimed_too or bundle[ENDED_ON + i] == 0.0:
                weight = behind_polariser(
                    flow.polarised, room.packets[i], bundle[WEIGHT + i], bundle[DX + i], bundle[DY + i], bundle[DZ + i],
                    frames, flow.book,
                )  # fmt: skip
                put(
                    flow, station, room.packets[i], SENSOR_FRAME, bundle[X + i], bundle[Y + i], bundle[Z + i],
                    bundle[DX + i], bundle[DY + i], bundle[DZ + i], weight, room.keys[i], 0.0,
                )  # fmt: skip


@kernel
def launch_along_image_path(
    entries: Entries, samples: int, stratified: bool, replicate_key: np.uint64, colour: int, camera: Camera,
    route: Route, aim: AimTables, bundle: Array, numbers: NDArray[np.int64], options: Options, flow: Flow,
    room: StartRoom,
) -> None:  # fmt: skip
    """Start packets as `launch_adjoint` does, and take them along the image path at once.

    Parameters
    ----------
    route : Route
        See `follower.image_route`.
    bundle, numbers
        Working memory, see `image_path.follow_image_path`.
    """
    sensor, mla, frames = camera.sensor, camera.mla, camera.frames
    begin_launch(room, colour, len(camera.lens.surfaces))
    station = PLATE if mla.present else LENS
    for i in range(STARTS):
        numbers[i] = i
    which, place = 0, 0
    total = entries.taken.sum()
    for first in range(0, total, STARTS):
        count = min(STARTS, total - first)
        draw_numbers(room, stratified, replicate_key, entries, which, place, count)
        which, place = _aim_rays(
            room, bundle, entries, which, place, samples, count, replicate_key, colour, sensor, mla, aim, frames,
            stratified, flow.book,
        )  # fmt: skip
        pad(bundle, count)
        move_bundle(bundle, frames[SENSOR_FRAME, CAMERA_FRAME])
        for i in range(count):
            draw_kick(camera.lens.aperture, options.pixels, room.packets[i], bundle, i)
        follow_block(room.packets, station, False, count, camera, route, bundle, numbers, options, flow)


@inlined
def _cells_shown(
    apertures: Any, array: ArraySeen, room: StartRoom, near: int, p: Vector, i: int, stratified: bool, colour: int,
    bundle: Array,
) -> tuple[Shown, float]:  # fmt: skip
    """Return the lenslets that show a pixel's point the opening, after any deflection of the sample.

    Writes the deflection to the bundle. Also returns the fraction of rays sent anywhere if it is large, else 0.

    Parameters
    ----------
    apertures : Apertures or None
    near : int
        Number of lenslets listed for the pixel.
    p : (3,) float, mm
        Point, array frame.
    i : int
        Number of the sample in the block.
    """
    kick = _NO_KICK
    if apertures is not None:
        kick = _kick_of_sample(apertures, room, i, stratified, colour)
        bundle[KICK_X + i], bundle[KICK_Y + i], bundle[KICK_AT + i] = kick[0], kick[1], float(apertures.events)
    shown, growth = shown_after_kick(apertures, array, room.near, near, room.cells, p, kick)
    return shown, wide_share_after_kick(growth)


@inlined
def _kick_of_sample(
    apertures: Apertures, room: StartRoom, i: int, stratified: bool, colour: int
) -> tuple[float, float]:
    """Return a sample's first deflection by diffraction, as `kick_of_packet` does later."""
    if not stratified:
        return kick_by_key(apertures, colour, room.keys[i], apertures.events)
    key = key_of_kick(room.keys[i], apertures.events)
    return drawn_kick(apertures, colour, (room.numbers[KICK_U, i], room.numbers[KICK_V, i]), key)


@kernel
def _aim_rays(
    room: StartRoom, bundle: Array, entries: Entries, which: int, place: int, samples: int, count: int,
    replicate_key: np.uint64, colour: int, sensor: SensorTables, mla: MlaTables, aim: AimTables, frames: Array,
    stratified: bool, book: Array,
) -> tuple[int, int]:  # fmt: skip
    """Write a block of rays (sensor frame) and weights to the bundle, from numbers already drawn.

    Returns
    -------
    which, place : int
        Entry that holds the first sample of the next block, and the sample's place in it.
    """
    area = area_of_sample(sensor, samples, colour)
    # The sensor's normal towards the array.
    normal = move_direction(frames, SENSOR_FRAME, MLA_FRAME, 0.0, 0.0, -1.0)
    near, begun = 0, -1
    column, row, usual, wide, unaimed, extent = 0.0, 0.0, np.inf, 0.0, 0.0, (0.0, 0.0)
    by_light, own_weight = 0, 1.0
    array = ArraySeen(mla, aim.lenslets, glass_before_faces(mla, colour) if mla.present else 1.0)
    if mla.present:
        extent = pixel_extent(sensor, frames)
    for i in range(count):
        pixel, sample = entries.pixel[which], entries.begin[which] + place
        if which != begun:
            begun = which
            column, row = pixel % sensor.columns - 0.5 * sensor.columns, pixel // sensor.columns - 0.5 * sensor.rows
            if mla.present:
                x, y = (column + 0.5) * sensor.pixel, (row + 0.5) * sensor.pixel
                px, py, pz = move_point(frames, SENSOR_FRAME, MLA_FRAME, x, y, 0.0)
                near = list_cells_of_pixel(mla.apertures, array, (px, py, pz), extent, room.near)
                # Diffraction may add lenslets.
                sees = near > 0 or mla.apertures is not None
                wide = aim.exit.wide_share if sees else aim.exit.share_without_aim
                unaimed = unaimed_share(wide)
                by_light, own_weight = aimed_rays(unaimed, samples, derived(replicate_key, pixel))
                usual = area * lenslet_ahead(mla, array.glass, pz) / (1.0 - aim.exit.wide_share)
        numbers = (
            room.numbers[CELL_U, i], room.numbers[CELL_V, i], room.numbers[PIXEL_U, i],
            room.numbers[PIXEL_V, i], room.numbers[WHICH_CELL, i], room.numbers[DISCRETE, i],
        )  # fmt: skip
        x, y = (column + numbers[PIXEL_U]) * sensor.pixel, (row + numbers[PIXEL_V]) * sensor.pixel
        if mla.present:
            p = move_point(frames, SENSOR_FRAME, MLA_FRAME, x, y, 0.0)
            shown, after_kick = _cells_shown(mla.apertures, array, room, near, p, i, stratified, colour, bundle)
            choice, share = numbers[DISCRETE], wide
            far = after_kick > 0.0
            if far:
                share = max(wide, after_kick)
            elif by_light >= 0:
                choice = 1.0 if sample < by_light else choice * unaimed
            dx, dy, dz, importance = aimed_through_array(
                array, shown, share, normal, p, (*numbers[:DISCRETE], choice), far
            )
            importance *= own_weight if choice >= unaimed and not far else 1.0
            ux, uy, uz = move_direction(frames, MLA_FRAME, SENSOR_FRAME, dx, dy, dz)
        else:
            # The pupil disks are square to the axis of the lens, whichever way the sensor is tilted.
            px, py, pz = move_point(frames, SENSOR_FRAME, CAMERA_FRAME, x, y, 0.0)
            draws = numbers[DISCRETE], numbers[CELL_U], numbers[CELL_V]
            dx, dy, dz, density = aimed(aim.exit, (px, py, pz), draws)
            ux, uy, uz = move_direction(frames, CAMERA_FRAME, SENSOR_FRAME, dx, dy, dz)
            importance = -uz / density if density > 0.0 else 0.0
        weight = area * max(importance, 0.0)
        load(bundle, i, x, y, 0.0, ux, uy, uz, weight)
        if weight == 0.0:
            bundle[ENDED_ON + i] = DROPPED
        book[EMITTED] += weight
        packet = room.packets[i]
        packet.source = pixel | (entries.place[which] * samples + sample) << SAMPLE_SHIFT
        # Blind rays weigh a hundred times as much as rays through a lenslet that shows the opening. Their children are
        # followed down to that smaller weight, so that the few survivors of roulette do not dominate a pixel's error.
        packet.key, packet.start, packet.events = room.keys[i], min(weight, usual) if weight > 0.0 else usual, 0
        place += 1
        if place == entries.taken[which]:
            which, place = which + 1, 0
    return which, place
