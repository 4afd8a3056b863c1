"""Launch of rays from a field point, a light or pixels, or as in a run, with every vertex recorded.

The kernels, and so the paths, are a render's. Rays launched with the light carry W, from the sensor m² sr.
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
"""Number (in the scene; 0 if foreign) and length in nm of the wavelengths that share the rays."""


@dataclass(frozen=True)
class Settings:
    """Number of rays, wavelengths, and tracing settings."""

    count: int
    colours: Colours
    split: int
    cutoff: float
    seed: int

    def rays_of(self, place: int) -> int:
        """Return the number of rays at a wavelength, by its index in `colours`."""
        return len(range(place, self.count, len(self.colours)))


MOST_RAYS = 1_000_000
"""Most rays of a launch; each stores at least two vertices."""

INTENSITY_W_SR = 1.0
"""Radiant intensity of a field point."""

_KEY = 0x6669656C64
"""Key of the roulette for rays from field points."""

PLASTIC = 1.32471795724474602596
"""Root of x³ = x + 1: powers of its inverse generate points that cover a square evenly (Roberts 2018)."""


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

    The point emits 1 W/sr at each wavelength; each ray carries its share of solid angle. The rays cover the entrance
    pupil evenly. A target that contains the point does not block them.

    Parameters
    ----------
    world : World
    position_mm : (3,) float, mm, world frame
        In front of the lens.
    count : int
        Total number of rays.
    wavelength_nm : float, optional
        Default: the scene's wavelengths share the rays.
    split : {"both", "roulette", "transmit"}
    weight_cutoff : float, optional
        Fraction of a ray's power below which rays end at random (default: the scene's). 1e-4 resolves two-reflection
        ghosts, with hundreds of paths per ray.
    seed : int
        Shifts the points of the pupil, and sets the roulette.
    aim : {"pupil", "lens"}
        Aim at the entrance pupil as seen from the point (by real rays, with a margin of 2 %), or at the whole lens for
        ghosts from outside the pupil. A point that sees no opening is aimed at the lens.

    Raises
    ------
    LfmeshError
        The point is invalid or not in front of the lens, the count is below 1, a setting is out of range, or there are
        too many paths to store (as for all launches).
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
    """Launch rays backwards from a pixel of the sensor; targets end them.

    They are the rays that an adjoint run with this seed starts at the pixel: most aim at the lenslets through which it
    sees the lens opening, some anywhere, for stray light. Each carries its share of the pixel's étendue, in m² sr.

    Parameters
    ----------
    world : World
    row, column : int
    count : int
        Total number of rays.
    wavelength_nm : float, optional
        Default: the scene's wavelengths share the rays.
    split : {"both", "roulette", "transmit"}
    weight_cutoff : float, optional
        See `from_field_point`.
    seed : int

    Raises
    ------
    LfmeshError
        The pixel does not exist, the count is below 1, or a setting is out of range.
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
    """Launch rays from a box of pixels like `from_pixel`, equally many from each, with the power of the whole box.

    With fewer rays than pixels, pixels are drawn at random. Otherwise every pixel has the same number of rays, so the
    total may differ slightly from `count`.

    Parameters
    ----------
    world : World
    rows, columns : range
    count : int
        Total number of rays.
    wavelength_nm : float, optional, nm
        Default: the scene's wavelengths.
    split : {"both", "roulette", "transmit"}
    weight_cutoff : float, optional
        See `from_field_point`.
    seed : int

    Raises
    ------
    LfmeshError
        Pixels are outside the sensor, the count is below 1, or a setting is out of range.
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
    """Launch packets from a single light as in a forward run: to the targets, and scattered on into the lens.

    Together they carry the light's power at each wavelength, except for light not directed at targets.

    Parameters
    ----------
    world : World
    number : int
        Index in `lights`.
    count : int
        Total number of packets.
    wavelength_nm : float, optional
        One of the scene's, which share the packets by default.
    split : {"both", "roulette", "transmit"}
    weight_cutoff : float, optional
        See `from_field_point`.
    seed : int

    Raises
    ------
    LfmeshError
        The light or wavelength does not exist, the scene has no targets, the count is below 1, or a setting is out of
        range.
    """
    colours = _wavelengths(world, wavelength_nm, any_other=False)
    settings = _settings(world, count, colours, split, weight_cutoff, seed)
    lights = len(world.scene.lights)
    if not 0 <= number < lights:
        known = f"it has lights[0] to lights[{lights - 1}]" if lights else "it has none"
        raise LfmeshError(f"lights[{number}] is not in the scene: {known}")
    if not len(world.scene.targets):
        raise LfmeshError(f"lights[{number}] illuminates nothing: the scene has no targets")
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
    """Launch the first rays of a run: the same kernels and random numbers.

    The scene's `transport.method` applies. Forward, they are the first packets of the run and share its power; all
    packets together reproduce the ledger's sensor power. Adjoint, they are first samples of pixels all over the sensor
    and end at targets, as light gathered there is not a packet's path.

    Parameters
    ----------
    world : World
    count : int, optional
        Total number of rays; in a forward run at most, and by default, all of them.
    wavelength_nm : float, optional
        One of the scene's, which share the rays by default.
    split, weight_cutoff, seed : optional
        Default: the scene's.

    Raises
    ------
    LfmeshError
        Nothing emits in a scene of the forward method, the count is below 1, or a setting is out of range.
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
        raise LfmeshError("nothing emits: the scene has neither lights nor targets with radiance_w_m2_sr")
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
        # Without shuffling, a few of many millions are drawn without listing all.
        row, column = np.divmod(
            np.sort(generator.choice(box, min(rays, box), replace=False, shuffle=False)), len(columns)
        )
        pixels = np.asarray(rows)[row] * world.tables.sensor.columns + np.asarray(columns)[column]
        starts = PixelSource(pixels, max(1, round(rays / box)), descendant(run_key(settings.seed), 0, colour))
        tables = at_wavelength(world, wavelength)._replace(aim=world.aim)
        ended, nodes = traced(world, tables, options, starts, place)
        # Each randomly drawn pixel represents several.
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
    """Return points that cover the unit square evenly, shifted by the seed."""
    shift = np.random.default_rng(seed).random(2)
    u, v = (np.mod(s + (number + 0.5) / PLASTIC**power, 1.0) for power, s in zip((1, 2), shift, strict=True))
    return u, v


def _disk_seen(world: World, point: Floats, aim: str) -> tuple[float, float, float, float]:
    """Return the target disk for rays from a point (camera frame): centre x, y, z and radius."""
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
    """Return the scene's wavelengths with their table columns; for a band, the wavelength nearest its centroid."""
    lines = world.lines
    if not lines.in_bands:
        return list(enumerate(lines.wavelengths_nm))
    columns = dict.fromkeys(lines.nearest(wavelength) for wavelength in world.scene.wavelengths_nm)
    return [(column, lines.wavelengths_nm[column]) for column in columns]


def _wavelengths(world: World, wavelength_nm: float | None, *, any_other: bool = True) -> Colours:
    """Return the wavelengths for a launch; with `any_other`, a wavelength outside the scene is allowed."""
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
        raise LfmeshError(f"count = {literal(int(count))}: paths of at most {MOST_RAYS:,} rays can be kept; give fewer")
    if split not in SPLIT_MODE:
        raise LfmeshError(f"split = {split!r}: use one of {', '.join(SPLIT_MODE)}")
    cutoff = world.scene.transport.weight_cutoff if weight_cutoff is None else weight_cutoff
    if not 0.0 <= cutoff <= 1.0:
        raise LfmeshError(f"weight_cutoff = {cutoff!r}: must be from 0 to 1")
    if not 0 <= seed < 2**63:
        raise LfmeshError(f"seed = {seed!r}: must be a whole number from 0 to 2^63 − 1")
    return Settings(int(count), colours, SPLIT_MODE[split], cutoff, int(seed))
