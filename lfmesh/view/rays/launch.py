"""Launching rays to look at: from a field point, a light, pixels, or as a run does, with every vertex kept.

The kernels are those of a render, so the paths are its paths. With the light they carry W; from the sensor m² sr.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.errors import LfmeshError
from lfmesh.geometry import frame as frames
from lfmesh.scene.literals import literal
from lfmesh.transport.aims.aim_table import opening_seen, widest_disk
from lfmesh.transport.aims.pupil import opening_from
from lfmesh.transport.packets.packet import BY_MESH, CAMERA_FRAME, WORLD_FRAME
from lfmesh.transport.packets.random import descendant, run_key
from lfmesh.transport.settings import SPLIT_MODE, options_of
from lfmesh.transport.sources.lights import LightSource
from lfmesh.transport.sources.pixels import PixelSource
from lfmesh.transport.tables.lines import Nodes
from lfmesh.transport.tables.tables import Records, Tables
from lfmesh.transport.trace import at_wavelength, joined_records
from lfmesh.transport.world import World
from lfmesh.view.rays.paths import FieldPoints, Rays, assembled
from lfmesh.view.rays.recording import from_point, traced

Floats = NDArray[np.float64]

Colours = Sequence[tuple[int, float]]
"""Number (among the scene's; 0 for one that is not) and length in nm of the wavelengths that share the rays."""


@dataclass(frozen=True)
class Settings:
    """Number of rays, their wavelengths, and the settings by which they are followed."""

    count: int
    colours: Colours
    split: int
    cutoff: float
    seed: int

    def rays_of(self, place: int) -> int:
        """Return how many rays the wavelength at a place of `colours` has."""
        return len(range(place, self.count, len(self.colours)))


MOST_RAYS = 1_000_000
"""Of a launch: each keeps two vertices or more, and more of them are not kept."""

INTENSITY_W_SR = 1.0
"""Radiant intensity of a field point."""

_KEY = 0x6669656C64
"""Of the roulette that rays from field points play."""

PLASTIC = 1.32471795724474602596
"""Root of x³ = x + 1: its inverse powers make a sequence of points that covers a square evenly (Roberts 2018)."""


def from_field_point(
    world: World,
    position_mm: ArrayLike,
    count: int,
    *,
    wavelength_nm: float | None = None,
    split: str = "both",
    weight_cutoff: float | None = None,
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
    weight_cutoff : float, optional
        Share of a ray's power below which rays are ended at random, in place of the scene's. With 1e-4 ghosts of two
        reflections are followed one by one; there are hundreds of them a ray.
    seed : int
        Shifts the points of the pupil, and plays the roulette.
    aim : {"pupil", "lens"}
        At the entrance pupil as the point sees it, by real rays and with a margin of 2 %; or at all of the lens, for
        ghosts that come from beside the pupil. A point that sees no opening is aimed at the lens.

    Raises
    ------
    LfmeshError
        A point that is none or not in front of the lens, a count below 1, a setting out of its range, or more paths
        than can be kept (as for all launches).
    """
    settings = _settings(world, count, _wavelengths(world, wavelength_nm), split, weight_cutoff, seed)
    if aim not in ("pupil", "lens"):
        raise LfmeshError(f'aim = {aim!r}: use "pupil" or "lens"')
    point = _point_before_lens(world, position_mm)
    x, y, plane_z, radius = _disk_seen(world, point, aim)
    options = options_of(world, tracing=True, record=True, split=settings.split, cutoff=settings.cutoff)
    parts = []
    for place, (colour, wavelength) in enumerate(settings.colours):
        u, v = _square(np.arange(place, count, len(settings.colours)), seed)
        r, phi = radius * np.sqrt(u), 2.0 * np.pi * v
        ray = np.stack([x + r * np.cos(phi), y + r * np.sin(phi), np.full(len(u), plane_z)], axis=-1) - point
        length = np.linalg.norm(ray, axis=1)
        solid_angle = np.pi * radius**2 * ray[:, 2] / length**3 / max(len(u), 1)
        watts = INTENSITY_W_SR * solid_angle
        starts = from_point(world, point, ray / length[:, None], watts, descendant(_KEY, seed, colour))
        parts.append(traced(world, at_wavelength(world, wavelength), options, starts, place))
    x, y, z = np.asarray(position_mm, dtype=np.float64).tolist()
    field = FieldPoints(((x, y, z),), tuple(wavelength for _, wavelength in settings.colours))
    return replace(_assembled(world, parts, settings), field=field)


def from_pixel(
    world: World,
    row: int,
    column: int,
    count: int,
    *,
    wavelength_nm: float | None = None,
    split: str = "both",
    weight_cutoff: float | None = None,
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
    weight_cutoff : float, optional
        Share of a ray's power below which rays are ended at random, in place of the scene's. With 1e-4 ghosts of two
        reflections are followed one by one; there are hundreds of them a ray.
    seed : int

    Raises
    ------
    LfmeshError
        No such pixel, a count below 1, or a setting out of its range.
    """
    return from_pixels(
        world, range(row, row + 1), range(column, column + 1), count,
        wavelength_nm=wavelength_nm, split=split, weight_cutoff=weight_cutoff, seed=seed,
    )  # fmt: skip


def from_pixels(
    world: World,
    rows: range,
    columns: range,
    count: int,
    *,
    wavelength_nm: float | None = None,
    split: str = "both",
    weight_cutoff: float | None = None,
    seed: int = 0,
) -> Rays:
    """Launch rays from a box of pixels as `from_pixel` does, as many from each; the power stands for the whole box.

    With fewer rays than pixels, as many pixels are drawn by chance. Else every pixel has the same number of rays, so
    that there may be a few more or less than asked for.

    Parameters
    ----------
    world : World
    rows, columns : range
    count : int
        Rays in all.
    wavelength_nm : float, optional, nm
        Those of the scene if left out.
    split : {"both", "roulette", "transmit"}
    weight_cutoff : float, optional
        As the scene has it if left out.
    seed : int

    Raises
    ------
    LfmeshError
        Pixels outside the sensor, a count below 1, or a setting out of its range.
    """
    settings = _settings(world, count, _wavelengths(world, wavelength_nm), split, weight_cutoff, seed)
    sensor = world.tables.sensor
    for name, wished, size in (("row", rows, sensor.rows), ("column", columns, sensor.columns)):
        if not len(wished) or min(wished) < 0 or max(wished) >= size:
            given = wished[0] if len(wished) == 1 else f"{wished.start}:{wished.stop}"
            raise LfmeshError(f"{name} {given}: the sensor has {name}s 0 to {size - 1}")
    return _from_pixels(world, rows, columns, settings)


def from_light(
    world: World,
    number: int,
    count: int,
    *,
    wavelength_nm: float | None = None,
    split: str = "both",
    weight_cutoff: float | None = None,
    seed: int = 0,
) -> Rays:
    """Launch packets from one light alone as a forward run does: to the targets, and scattered on into the lens.

    Together they carry the light's power at each wavelength; what does not go towards the targets is left out.

    Parameters
    ----------
    world : World
    number : int
        Of `lights[number]`.
    count : int
        Packets in all.
    wavelength_nm : float, optional
        One of the scene's; else those share the packets.
    split : {"both", "roulette", "transmit"}
    weight_cutoff : float, optional
        Share of a ray's power below which rays are ended at random, in place of the scene's. With 1e-4 ghosts of two
        reflections are followed one by one; there are hundreds of them a ray.
    seed : int

    Raises
    ------
    LfmeshError
        No such light or wavelength, a scene without targets, a count below 1, or a setting out of its range.
    """
    colours = _wavelengths(world, wavelength_nm, any_other=False)
    settings = _settings(world, count, colours, split, weight_cutoff, seed)
    lights = len(world.scene.lights)
    if not 0 <= number < lights:
        known = f"it has lights[0] to lights[{lights - 1}]" if lights else "it has none"
        raise LfmeshError(f"lights[{number}] is not in the scene: {known}")
    if not len(world.scene.targets):
        raise LfmeshError(f"lights[{number}] lights nothing: the scene has no targets")
    objects = world.tables.objects
    sources = objects.sources[objects.sources["light"] == number].copy()
    sources["share"] = sources["until"] = 1.0
    tables = world.aimed_tables._replace(objects=objects._replace(sources=sources))
    return _from_sources(world, tables, settings)


def as_in_run(
    world: World,
    count: int | None = None,
    *,
    wavelength_nm: float | None = None,
    split: str | None = None,
    weight_cutoff: float | None = None,
    seed: int | None = None,
) -> Rays:
    """Launch the rays with which a run starts: the same kernels, the same numbers.

    By the scene's `transport.method`. Forward, they are the first packets of the run and share its power; all of them
    put on the sensor what its ledger says. Adjoint, they are first samples of pixels all over the sensor; targets end
    them, since what is gathered there is no path of a packet.

    Parameters
    ----------
    world : World
    count : int, optional
        Rays in all; a forward run's are not more than it has, and all of them if left out.
    wavelength_nm : float, optional
        One of the scene's; else those share the rays.
    split, weight_cutoff, seed : optional
        In place of the scene's.

    Raises
    ------
    LfmeshError
        Nothing shines in a scene of the forward method, a count below 1, or a setting out of its range.
    """
    transport = world.scene.transport
    split = transport.split if split is None else split
    seed = transport.seed if seed is None else seed
    colours = _wavelengths(world, wavelength_nm, any_other=False)
    sensor = world.tables.sensor
    pixels = sensor.rows * sensor.columns
    most = pixels * len(colours) * (transport.samples if transport.method == "forward" else 1)
    settings = _settings(world, most if count is None else count, colours, split, weight_cutoff, seed)
    if transport.method == "adjoint":
        return _from_pixels(world, range(sensor.rows), range(sensor.columns), settings)
    if not len(world.tables.objects.sources):
        raise LfmeshError("nothing shines: the scene has neither lights nor targets with radiance_w_m2_sr")
    return _from_sources(world, world.aimed_tables, replace(settings, count=min(settings.count, most)))


def _from_pixels(world: World, rows: range, columns: range, settings: Settings) -> Rays:
    """Launch rays from a box of pixels, shared among wavelengths."""
    box = len(rows) * len(columns)
    options = options_of(
        world, tracing=True, record=True, split=settings.split, cutoff=settings.cutoff, importance=True
    )
    generator = np.random.default_rng(settings.seed)
    parts = []
    for place, (colour, wavelength) in enumerate(settings.colours):
        rays = settings.rays_of(place)
        # Unshuffled, a few of many millions are drawn without listing them all.
        row, column = np.divmod(
            np.sort(generator.choice(box, min(rays, box), replace=False, shuffle=False)), len(columns)
        )
        pixels = np.asarray(rows)[row] * world.tables.sensor.columns + np.asarray(columns)[column]
        starts = PixelSource(pixels, max(1, round(rays / box)), descendant(run_key(settings.seed), 0, colour))
        tables = at_wavelength(world, wavelength)._replace(aim=world.aim)
        ended, nodes = traced(world, tables, options, starts, place)
        # Of pixels drawn by chance, each stands for several.
        for table in (ended, nodes):
            table["weight"] *= box / max(len(pixels), 1)
        parts.append((ended, nodes))
    return _assembled(world, parts, settings, from_sensor=True)


def _from_sources(world: World, tables: Tables, settings: Settings) -> Rays:
    """Launch the first packets of a forward run, shared among wavelengths, replicate by replicate."""
    transport = world.scene.transport
    options = options_of(
        world,
        record=True,
        split=settings.split,
        cutoff=settings.cutoff,
        adjoint=False,
        importance=False,
        faces=BY_MESH,
    )
    one = tables.sensor.rows * tables.sensor.columns * transport.samples_each
    parts = []
    for place, (colour, _) in enumerate(settings.colours):
        total = settings.rays_of(place)
        for replicate, first in enumerate(range(0, total, one)):
            key = descendant(run_key(settings.seed), replicate, colour)
            starts = LightSource(0, min(one, total - first), total, key, Nodes.single(colour))
            parts.append(traced(world, tables, options, starts, place))
    return _assembled(world, parts, settings)


def _assembled(
    world: World, parts: list[tuple[Records, Records]], settings: Settings, *, from_sensor: bool = False
) -> Rays:
    ended, nodes = joined_records(parts)
    lengths = np.array([wavelength for _, wavelength in settings.colours])
    return assembled(world, ended, nodes, lengths[ended["colour"]], ended["source"] if from_sensor else None)


def _square(number: NDArray[np.int64], seed: int) -> tuple[Floats, Floats]:
    """Return points of a sequence that covers the unit square evenly, moved by a seed's shift."""
    shift = np.random.default_rng(seed).random(2)
    u, v = (np.mod(s + (number + 0.5) / PLASTIC**power, 1.0) for power, s in zip((1, 2), shift, strict=True))
    return u, v


def _disk_seen(world: World, point: Floats, aim: str) -> tuple[float, float, float, float]:
    """Return the disk that rays from a point (camera frame) are aimed at: middle x, y, z and radius."""
    lens = world.tables.lens
    wide = widest_disk(lens, point[None], front=True)
    opening = opening_seen(world.facts, lens, point[None], wide, bool(world.lens_shape.analytic.all()), front=True)
    decentre = world.aim.entrance.opening.far.decentre * [[1.0], [0.0]]
    opening = opening._replace(far=opening.far._replace(decentre=decentre))
    x, y, radius = opening_from(opening, (point[0], point[1], point[2]))
    if aim == "lens" or radius <= 0.0:
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
            f"position_mm = {point.tolist()}: a field point lies in front of the lens, in the camera frame at z < "
            f"{round(front, 6) + 0.0:g} mm; this one is at z = {moved[2]:.6g} mm"
        )
    return np.asarray(moved)


def wavelengths_of(world: World) -> Colours:
    """Return the wavelengths of a scene with their columns in its tables; of a band that nearest to its centroid."""
    lines = world.lines
    if not lines.in_bands:
        return list(enumerate(lines.wavelengths_nm))
    columns = dict.fromkeys(lines.nearest(wavelength) for wavelength in world.scene.wavelengths_nm)
    return [(column, lines.wavelengths_nm[column]) for column in columns]


def _wavelengths(world: World, wavelength_nm: float | None, *, any_other: bool = True) -> Colours:
    """Return the wavelengths that rays are launched at; `any_other`: one that is not the scene's will do."""
    known = wavelengths_of(world)
    if wavelength_nm is None:
        return known
    for colour, each in known:
        if wavelength_nm == each:
            return [(colour, each)]
    if not any_other:
        listed = ", ".join(f"{w:g}" for _, w in known)
        raise LfmeshError(f"wavelength_nm = {wavelength_nm!r}: light and targets are known at the scene's ({listed})")
    if not 0.0 < wavelength_nm < np.inf:
        raise LfmeshError(f"wavelength_nm = {wavelength_nm!r}: must be a positive number")
    return [(0, float(wavelength_nm))]


def _settings(
    world: World, count: int, colours: Colours, split: str, weight_cutoff: float | None, seed: int
) -> Settings:
    """Return checked settings."""
    if isinstance(count, bool) or not isinstance(count, (int, np.integer)) or count < 1:
        raise LfmeshError(f"count = {count!r}: must be a whole number of rays, at least 1")
    if count > MOST_RAYS:
        raise LfmeshError(f"count = {literal(int(count))}: paths of {MOST_RAYS:,} rays at most can be kept; give fewer")
    if split not in SPLIT_MODE:
        raise LfmeshError(f"split = {split!r}: use one of {', '.join(SPLIT_MODE)}")
    cutoff = world.scene.transport.weight_cutoff if weight_cutoff is None else weight_cutoff
    if not 0.0 <= cutoff <= 1.0:
        raise LfmeshError(f"weight_cutoff = {cutoff!r}: must be from 0 to 1")
    if not 0 <= seed < 2**63:
        raise LfmeshError(f"seed = {seed!r}: must be a whole number from 0 to 2^63 − 1")
    return Settings(int(count), colours, SPLIT_MODE[split], cutoff, int(seed))
