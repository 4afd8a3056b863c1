"""Launching rays to look at: from a field point, a light, pixels, or as a run does, with every vertex kept.

The kernels are those of a render, so the paths are its paths. With the light they carry W; from the sensor m² sr.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.errors import LfmeshError
from lfmesh.geometry import frame as frames
from lfmesh.transport.adjoint import launch_adjoint
from lfmesh.transport.aim_table import opening_seen, widest_disk
from lfmesh.transport.crossing import FLOAT32_GRAIN
from lfmesh.transport.engine import CHUNK, Workspace
from lfmesh.transport.packet import (
    CAMERA_FRAME,
    E_START,
    ENDED,
    NO_SURFACE,
    NODES,
    OBJECTS,
    STATIONS,
    WORLD_FRAME,
    Options,
)
from lfmesh.transport.pupil import opening_from
from lfmesh.transport.random import descendant, run_key
from lfmesh.transport.settings import SPLIT_MODE, options_of
from lfmesh.transport.tables import Records, Tables
from lfmesh.transport.trace import at_wavelength, joined_records, launch_rays
from lfmesh.transport.world import World
from lfmesh.view.rays import Rays, assembled

Floats = NDArray[np.float64]
Start = Callable[[Workspace], None]
"""Puts a chunk's packets on the stacks of a workspace."""

INTENSITY_W_SR = 1.0
"""Radiant intensity of a field point."""

OWN_SURFACE = 32.0 * FLOAT32_GRAIN
"""How far a field point may lie off a target to be a point of it, relative to its coordinates."""

PLASTIC = 1.32471795724474602596
"""Root of x³ = x + 1: its inverse powers make a sequence of points that covers a square evenly (Roberts 2018)."""


def from_field_point(
    world: World,
    position_mm: ArrayLike,
    count: int,
    *,
    wavelength_nm: float | None = None,
    split: str = "both",
    seed: int = 0,
    aim: Literal["pupil", "lens"] = "pupil",
) -> Rays:
    """Launch rays from a point of object space into the lens.

    The point shines with 1 W/sr at each wavelength; a ray carries that times the solid angle that it stands for. Points
    of the entrance pupil are covered evenly. A target that holds the point does not hide the lens from it.

    Parameters
    ----------
    world : World
    position_mm : (3,) float, mm, world frame
        In front of the lens.
    count : int
        Rays in all.
    wavelength_nm : float, optional
        Else the scene's wavelengths share the rays.
    split : {"both", "roulette", "transmit"}
    seed : int
        Shifts the points of the pupil, and plays the roulette.
    aim : {"pupil", "lens"}
        At the entrance pupil as the point sees it, by real rays and with a margin of 2 %; or at all of the lens, for
        ghosts that come from beside the pupil. A point that sees no opening is aimed at the lens.

    Raises
    ------
    LfmeshError
        A point that is none or not in front of the lens, a count below 1, or a setting out of its range.
    """
    _check(count, split, seed)
    if aim not in ("pupil", "lens"):
        raise LfmeshError(f'aim = {aim!r}: use "pupil" or "lens"')
    point = _point_before_lens(world, position_mm)
    x, y, plane_z, radius = _disk_seen(world, point, aim)
    options = options_of(world, tracing=True, record=True, split=SPLIT_MODE[split])
    parts = []
    waves = _wavelengths(world, wavelength_nm)
    for wave, wavelength in enumerate(waves):
        u, v = _square(np.arange(wave, count, len(waves)), seed)
        r, phi = radius * np.sqrt(u), 2.0 * np.pi * v
        ray = np.stack([x + r * np.cos(phi), y + r * np.sin(phi), np.full(len(u), plane_z)], axis=-1) - point
        length = np.linalg.norm(ray, axis=1)
        solid_angle = np.pi * radius**2 * ray[:, 2] / length**3 / max(len(u), 1)
        starts = _from_point(point, ray / length[:, None], INTENSITY_W_SR * solid_angle, descendant(_KEY, seed, wave))
        parts.append(_traced(world, at_wavelength(world, wavelength), options, starts, wave))
    ended, nodes = joined_records(parts)
    return assembled(world, ended, nodes, np.array(waves)[ended["wave"]])


_KEY = 0x6669656C64


def from_pixel(
    world: World,
    row: int,
    column: int,
    count: int,
    *,
    wavelength_nm: float | None = None,
    split: str = "both",
    seed: int = 0,
) -> Rays:
    """Launch rays from a pixel of the sensor against the light; targets end them.

    They are those that an adjoint run with this seed starts at the pixel: most at the lenslets that show it the lens's
    opening, some anywhere, for stray light. Each carries its share of the pixel's étendue, in m² sr.

    Parameters
    ----------
    world : World
    row, column : int
    count : int
        Rays in all.
    wavelength_nm : float, optional
        Else the scene's wavelengths share the rays.
    split : {"both", "roulette", "transmit"}
    seed : int

    Raises
    ------
    LfmeshError
        No such pixel, a count below 1, or a setting out of its range.
    """
    return from_pixels(
        world, range(row, row + 1), range(column, column + 1), count,
        wavelength_nm=wavelength_nm, split=split, seed=seed,
    )  # fmt: skip


def from_pixels(
    world: World,
    rows: range,
    columns: range,
    count: int,
    *,
    wavelength_nm: float | None = None,
    split: str = "both",
    seed: int = 0,
) -> Rays:
    """Launch rays from a box of pixels as `from_pixel` does, as many from each; the power stands for the whole box.

    With fewer rays than pixels, as many pixels are drawn by chance. Else every pixel has the same number of rays, so
    that there may be a few more or less than asked for.

    Raises
    ------
    LfmeshError
        Pixels outside the sensor, a count below 1, or a setting out of its range.
    """
    _check(count, split, seed)
    sensor = world.tables.sensor
    for name, wished, size in (("row", rows, sensor.rows), ("column", columns, sensor.columns)):
        if not len(wished) or min(wished) < 0 or max(wished) >= size:
            given = wished[0] if len(wished) == 1 else f"{wished.start}:{wished.stop}"
            raise LfmeshError(f"{name} {given}: the sensor has {name}s 0 to {size - 1}")
    box = np.add.outer(np.array(rows) * sensor.columns, np.array(columns)).ravel()
    return _from_pixels(world, box, count, _wavelengths(world, wavelength_nm), split, seed)


def _from_pixels(
    world: World, box: NDArray[np.int64], count: int, waves: Sequence[float], split: str, seed: int
) -> Rays:
    """Launch `count` rays from some pixels, shared among wavelengths."""
    options = options_of(world, tracing=True, record=True, split=SPLIT_MODE[split])
    generator = np.random.default_rng(seed)
    parts = []
    for wave, wavelength in enumerate(waves):
        rays = len(range(wave, count, len(waves)))
        if rays == 0:
            continue
        pixels = np.sort(generator.choice(box, min(rays, len(box)), replace=False))
        tables = at_wavelength(world, wavelength)
        key = descendant(run_key(seed), 0, wave)
        ended, nodes = _traced(world, tables, options, _at_pixels(pixels, max(1, round(rays / len(box))), key), wave)
        # Of pixels drawn by chance, each stands for several.
        ended["weight"] *= len(box) / len(pixels)
        nodes["weight"] *= len(box) / len(pixels)
        parts.append((ended, nodes))
    ended, nodes = joined_records(parts)
    return assembled(world, ended, nodes, np.array(waves)[ended["wave"]], ended["source"])


def _traced(
    world: World, tables: Tables, options: Options, starts: Iterator[Start], wave: int
) -> tuple[Records, Records]:
    """Trace one chunk after the other; return how packets ended and all vertices."""
    work = Workspace(world, options, tables=tables)
    parts = []
    for start in starts:
        work.begin(np.zeros((0, 1)))
        start(work)
        _record_starts(work)
        work.run()
        parts.append((work.ended[: work.tops[ENDED]].copy(), work.nodes[: work.tops[NODES]].copy()))
    ended, nodes = joined_records(parts)
    ended["wave"] = wave
    return ended, nodes


def _record_starts(work: Workspace) -> None:
    """Give every packet that waits and has no vertex yet one where it starts."""
    for station in range(STATIONS):
        packets = work.stacks[work.rows[station], : work.tops[station]]
        for frame in np.unique(packets["frame"]):
            fresh = np.flatnonzero((packets["frame"] == frame) & (packets["node"] == NO_SURFACE))
            top = int(work.tops[NODES])
            number = np.arange(top, top + len(fresh))
            p = np.stack([packets[axis][fresh] for axis in "xyz"], axis=-1)
            nodes = work.nodes
            nodes["position"][number] = frames.points(work.tables.frames[frame, WORLD_FRAME], p)
            nodes["weight"][number] = packets["weight"][fresh]
            for field in ("parent", "surface", "part"):
                nodes[field][number] = NO_SURFACE
            nodes["event"][number] = E_START
            packets["node"][fresh] = number
            work.tops[NODES] = top + len(fresh)


def _from_point(point: Floats, d: Floats, watts: Floats, key: np.uint64) -> Iterator[Start]:
    """Yield the chunks of rays of a point in front of the lens (camera frame)."""
    away = OWN_SURFACE * float(np.abs(point).sum())
    for first in range(0, len(d), CHUNK):
        part = slice(first, first + CHUNK)

        def start(work: Workspace, first: int = first, part: slice = part) -> None:
            rays = len(d[part])
            launch_rays(
                first, np.tile(point, (rays, 1)), np.ascontiguousarray(d[part]), np.full(rays, OBJECTS),
                np.zeros(rays, np.int64), key, work.tables.frames, False, work.flow(), work.template,
            )  # fmt: skip
            packets = work.stacks[work.rows[OBJECTS], :rays]
            packets["weight"] = packets["start"] = watts[part]
            packets["query_from"] = packets["limit"] = away

        yield start


def _at_pixels(pixels: NDArray[np.int64], samples: int, key: np.uint64) -> Iterator[Start]:
    """Yield the chunks of a pixel's samples, pixel by pixel."""
    # A chunk holds whole pixels; one with more samples than a chunk is launched in one all the same.
    per_chunk = max(1, CHUNK // samples)
    for first in range(0, len(pixels), per_chunk):
        some = pixels[first : first + per_chunk]

        def start(work: Workspace, some: NDArray[np.int64] = some) -> None:
            work.reserve(len(some) * samples)
            tables = work.tables
            launch_adjoint(
                some, samples, True, key, 0, tables.sensor, tables.array, tables.aim, tables.frames,
                len(tables.lens.surfaces), work.bundle, work.flow(), work.start,
            )  # fmt: skip

        yield start


def _square(number: NDArray[np.int64], seed: int) -> tuple[Floats, Floats]:
    """Return points of a sequence that covers the unit square evenly, moved by a seed's shift."""
    shift = np.random.default_rng(seed).random(2)
    u, v = (np.mod(s + (number + 0.5) / PLASTIC**power, 1.0) for power, s in zip((1, 2), shift, strict=True))
    return u, v


def _disk_seen(world: World, point: Floats, aim: str) -> tuple[float, float, float, float]:
    """Return the disk that rays from a point (camera frame) are aimed at: middle x, y, z and radius."""
    lens = world.tables.lens
    wide = widest_disk(lens, point[None], front=True)
    opening = opening_seen(
        world.first_order, lens, point[None], wide, bool(world.lens_shape.analytic.all()), front=True
    )
    x, y, radius = opening_from(opening, *point)
    if aim == "lens" or not opening.known or radius <= 0.0:
        return 0.0, 0.0, opening.plane_z, wide
    return x, y, opening.plane_z, radius


def _point_before_lens(world: World, position_mm: ArrayLike) -> Floats:
    """Return a field point in the camera frame."""
    try:
        point = np.asarray(position_mm, dtype=np.float64)
    except (TypeError, ValueError):
        point = np.zeros(0)
    if point.shape != (3,) or not np.isfinite(point).all():
        raise LfmeshError(f"position_mm = {position_mm!r}: must be three finite numbers x, y, z")
    moved = frames.points(world.tables.frames[WORLD_FRAME, CAMERA_FRAME], point[None])[0]
    front = float(world.tables.lens.box_low[2])
    if moved[2] >= front:
        raise LfmeshError(
            f"position_mm = {point.tolist()}: a field point lies in front of the lens, at z < {front:.6g} mm in the "
            f"camera frame; this one is at z = {moved[2]:.6g} mm"
        )
    return np.asarray(moved)


def _wavelengths(world: World, wavelength_nm: float | None) -> Sequence[float]:
    """Return the wavelengths that rays are launched at."""
    if wavelength_nm is None:
        return world.scene.transport.wavelengths_nm
    if not 0.0 < wavelength_nm < np.inf:
        raise LfmeshError(f"wavelength_nm = {wavelength_nm!r}: must be a positive number")
    return (float(wavelength_nm),)


def _check(count: int, split: str, seed: int) -> None:
    if isinstance(count, bool) or not isinstance(count, (int, np.integer)) or count < 1:
        raise LfmeshError(f"count = {count!r}: must be a whole number of rays, at least 1")
    if split not in SPLIT_MODE:
        raise LfmeshError(f"split = {split!r}: use one of {', '.join(SPLIT_MODE)}")
    if not 0 <= seed < 2**63:
        raise LfmeshError(f"seed = {seed!r}: must be a whole number from 0 to 2^63 − 1")
