"""Tracing of given rays through a built scene, with every vertex recorded on request."""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.errors import LfmeshError, LostEnergyWarning, warn_caller
from lfmesh.geometry.meshes.levels import PATCH, SURFACE_LEVEL
from lfmesh.scene.literals import literal
from lfmesh.scene.settings.transport import MOST_EVENTS, MOST_THREADS
from lfmesh.signatures import with_keywords
from lfmesh.transport.aims.kept import Kept
from lfmesh.transport.choice import obstacle_of
from lfmesh.transport.engine import CHUNK, Workspace
from lfmesh.transport.events.polarisation import across
from lfmesh.transport.packets.ledger import Ledger
from lfmesh.transport.packets.packet import BY_MESH, BY_ORDER, COUNTERS, END, NODE, Event, Options, Status
from lfmesh.transport.packets.random import descendant
from lfmesh.transport.ray_starts import located, refuse_starts_in_the_lens
from lfmesh.transport.regions.glass_round import glass_round
from lfmesh.transport.sequences.given_rays import ENDED, GONE, REFUSED, UNSURE, followed
from lfmesh.transport.settings import SPLIT_MODE, ledger_of, options_of
from lfmesh.transport.sources.face_starts import before_faces
from lfmesh.transport.sources.rays import RaySource
from lfmesh.transport.sources.source import Launcher
from lfmesh.transport.tables.bending_fields import at_wavelength as fields_at_wavelength
from lfmesh.transport.tables.gradient_cells import with_gradient_cells
from lfmesh.transport.tables.gradient_spaces import gradient_spaces, has_gradients
from lfmesh.transport.tables.hosts import hosts_of
from lfmesh.transport.tables.interfaces import interface_tables
from lfmesh.transport.tables.lens import with_diffraction
from lfmesh.transport.tables.lines import Lines
from lfmesh.transport.tables.media import index2_behind_lens, with_media
from lfmesh.transport.tables.phase_faces import has_phases
from lfmesh.transport.tables.polarisation import polarisation_tables
from lfmesh.transport.tables.tables import ABSORBING, Media, Records, Tables
from lfmesh.transport.tables.volumes import volumes_at
from lfmesh.transport.traced_paths import Paths, Vertex
from lfmesh.transport.world import World

X_AXIS = (1.0, 0.0, 0.0)

ROUNDING = 1e-12
"""Relative excess of a given Stokes vector's polarised part over I that is accepted."""


class Settings(TypedDict, total=False):
    """Further settings of `trace`. Transport settings that are omitted or None are the scene's."""

    surface: str | None
    engine: str
    max_events: int | None
    weight_cutoff: float | None
    reference: ArrayLike


@with_keywords(engine="mesh", reference=X_AXIS)
def trace(
    world: World,
    origins: ArrayLike,
    directions: ArrayLike,
    wavelength_nm: float | None = None,
    split: str = "both",
    record: bool = False,
    *,
    stokes: ArrayLike | None = None,
    seed: int = 0,
    threads: int = 0,
    **settings: Unpack[Settings],
) -> Paths:
    """Trace rays until every packet has ended; targets and the sensor end packets.

    Parameters
    ----------
    world : World
        From `build`.
    origins : (n, 3) float64, mm, world frame
        Anywhere but inside the array: in object space and its bodies of glass, in the lens, or between lens, array and
        sensor. A ray that starts on a face of lens or glass meets it; to continue from a recorded vertex, start
        slightly beyond it.
    directions : (n, 3) float64
        Any length but zero.
    wavelength_nm : float, optional
        Default: the scene's primary wavelength.
    split : {"both", "roulette", "transmit"}
        At an interface, follow both children, one at random, or the refracted one with weight T.
    record : bool
        Keep every vertex, see `Paths.vertices`.
    stokes : (4,) or (n, 4) float64, optional
        I, Q, U and V of the rays, in a scene with `transport.polarisation`; weights then begin at I. Default:
        unpolarised rays with I = 1. For the conventions see `optics.polarisation`.
    seed : int
        Seed of the roulette.
    threads : int
        Number of threads, 0 for all processors. Does not affect the result.

    Returns
    -------
    Paths

    Other Parameters
    ----------------
    surface : str
    max_events : int
    weight_cutoff : float
        Override the scene's transport settings.
    reference : (3,) or (n, 3) float64
        Reference direction of Q and U, world frame; its component perpendicular to the ray counts. For rays along it,
        the y axis replaces it. Default: the x axis.
    engine : {"mesh", "sequential"}
        Default "mesh". "sequential" meets the exact surfaces of lens and array in their order and is many times faster.
        It follows refracted rays only (`split="transmit"`), records nothing, and drops rays that total reflection turns
        off the image path. It is fastest for rays that can meet only the camera, which are traced in blocks.

    Warns
    -----
    LostEnergyWarning
        More energy was lost than rounding explains; names the bodies.

    Raises
    ------
    LfmeshError
        Rays have the wrong shape, no direction, values that are not finite, or start inside the array; Stokes vectors
        are not physical, or given for a scene without polarisation; or a setting is out of range.
    """
    p, d = _arrays(origins, directions)
    wavelength_nm = world.scene.primary_nm if wavelength_nm is None else wavelength_nm
    given = {name: value for name, value in settings.items() if value is not None}
    check_whole(seed=seed, threads=threads, **{name: given[name] for name in ("max_events",) if name in given})
    check_numbers(wavelength_nm=wavelength_nm, **{name: given[name] for name in ("weight_cutoff",) if name in given})
    of_transport: dict[str, Any] = {name: value for name, value in settings.items() if name != "reference"}
    options = _options(world, record, split, **of_transport)
    for name, value, valid, wish in (
        ("wavelength_nm", wavelength_nm, 0.0 < wavelength_nm < np.inf, "a positive number"),
        ("seed", seed, 0 <= seed < 2**63, "a whole number from 0 to 2^63 − 1"),
        ("threads", threads, 0 <= threads <= MOST_THREADS, f"a whole number up to {MOST_THREADS}, 0 for all"),
    ):
        if not valid:
            raise LfmeshError(f"{name} = {shown(value)}: must be {wish}")
    tables = _at_level(world, at_wavelength(world, float(wavelength_nm)), options.surface)
    states = None
    if stokes is not None:
        if not world.scene.transport.polarisation:
            raise LfmeshError("stokes: the scene needs transport.polarisation = true")
        states = _states(stokes, settings.get("reference", X_AXIS), _unit_directions(p, d))
    call = _Call(world, tables, options, descendant(0x7472616365, int(seed)), int(threads), states)
    p = before_faces(world, p, d)
    in_blocks = options.faces == BY_ORDER and not _absorbs(call.tables)
    paths = _in_blocks(call, p, d) if in_blocks else _as_packets(call, p, d)
    lost = paths.ledger.loss_in_words()
    if lost is not None:
        warn_caller([LostEnergyWarning(lost)])
    return paths


def check_whole(**values: object) -> None:
    """Refuse settings that are not whole numbers."""
    for name, value in values.items():
        whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
        if not whole:
            raise LfmeshError(f"{name} = {shown(value)}: must be a whole number")


def check_numbers(**values: object) -> None:
    """Refuse settings that are not numbers."""
    for name, value in values.items():
        number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
        if not number:
            raise LfmeshError(f"{name} = {shown(value)}: must be a number")


def shown(value: object) -> str:
    """Return a value for a message, truncated if long."""
    text = literal(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _options(
    world: World, record: bool, split: str, surface: str | None = None, engine: str = "mesh",
    max_events: int | None = None, weight_cutoff: float | None = None,
) -> Options:  # fmt: skip
    """Return the scene's settings with overrides by the call."""
    transport = world.scene.transport
    level = transport.surface if surface is None else surface
    # Plain numbers: for other types numba would compile the kernels again.
    depth = int(transport.max_events if max_events is None else max_events)
    cutoff = float(transport.weight_cutoff if weight_cutoff is None else weight_cutoff)
    for name, word in (("split", split), ("surface", level), ("engine", engine)):
        if not isinstance(word, str):
            raise LfmeshError(f"{name} = {shown(word)}: must be text")
    if split not in SPLIT_MODE:
        raise LfmeshError(f"split = {split!r}: use one of {', '.join(SPLIT_MODE)}")
    if level not in SURFACE_LEVEL:
        raise LfmeshError(f"surface = {level!r}: use one of {', '.join(SURFACE_LEVEL)}")
    if level != "exact" and has_phases(world.scene):
        raise LfmeshError(f'surface = {level!r}: phases of the camera need exact surfaces; use "exact"')
    if level != "exact" and has_gradients(world.scene):
        raise LfmeshError(f'surface = {level!r}: rays in gradient-index glass end on exact surfaces; use "exact"')
    if not 1 <= depth <= MOST_EVENTS:
        raise LfmeshError(f"max_events = {shown(depth)}: must be from 1 to {MOST_EVENTS}")
    if not 0.0 <= cutoff <= 1.0:
        raise LfmeshError(f"weight_cutoff = {cutoff!r}: must be from 0 to 1")
    if engine not in ("mesh", "sequential"):
        raise LfmeshError(f'engine = {engine!r}: use "mesh" or "sequential"')
    if engine == "sequential":
        obstacle = obstacle_of(world.scene, level, depth, tracing=True)
        if split != "transmit":
            obstacle = f"split = {split!r} follows reflections"
        elif record:
            obstacle = "record = True keeps every vertex"
        if obstacle is not None:
            raise LfmeshError(f'engine = "sequential": {obstacle}; use "mesh"')
    return options_of(
        world,
        tracing=True,
        faces=BY_ORDER if engine == "sequential" else BY_MESH,
        record=record,
        split=SPLIT_MODE[split],
        surface=SURFACE_LEVEL[level],
        max_events=depth,
        cutoff=cutoff,
    )


def _arrays(origins: ArrayLike, directions: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    try:
        p = np.atleast_2d(np.asarray(origins, dtype=np.float64))
        d = np.atleast_2d(np.asarray(directions, dtype=np.float64))
    except (TypeError, ValueError, OverflowError) as error:
        raise LfmeshError(f"origins and directions must be (n, 3) numbers: {error}") from error
    if p.ndim != 2 or p.shape[1] != 3 or p.shape != d.shape:
        raise LfmeshError(f"origins {p.shape} and directions {d.shape}: both must be (n, 3)")
    return np.ascontiguousarray(p), np.ascontiguousarray(d)


class _States(NamedTuple):
    """States of polarisation of rays: I; Q, U and V over I; reference directions across the rays, world frame."""

    power: NDArray[np.float64]
    stokes: NDArray[np.float64]
    reference: NDArray[np.float64]


def _states(stokes: ArrayLike, reference: ArrayLike, d: NDArray[np.float64]) -> _States:
    """Return the states of rays with unit directions; refuse unphysical Stokes vectors."""
    try:
        given = np.broadcast_to(np.asarray(stokes, dtype=np.float64), (len(d), 4))
        axis = np.broadcast_to(np.asarray(reference, dtype=np.float64), d.shape)
    except (TypeError, ValueError) as error:
        raise LfmeshError(f"stokes must be (4,) or (n, 4) numbers, reference (3,) or (n, 3): {error}") from None
    size = np.linalg.norm(given[:, 1:], axis=1)
    bad = ~(np.isfinite(given).all(axis=1) & (given[:, 0] > 0.0) & (size <= given[:, 0] * (1.0 + ROUNDING)))
    bad_axis = ~(np.isfinite(axis).all(axis=1) & (axis != 0.0).any(axis=1))
    if bad.any():
        i = int(np.flatnonzero(bad)[0])
        raise LfmeshError(f"ray {i}: stokes = {given[i].tolist()}: must be finite, with I > 0 and I² ≥ Q² + U² + V²")
    if bad_axis.any():
        i = int(np.flatnonzero(bad_axis)[0])
        raise LfmeshError(f"ray {i}: reference = {axis[i].tolist()}: must be finite, with a direction")
    shares = given[:, 1:] / np.maximum(given[:, 0], size)[:, None]
    return _States(given[:, 0].copy(), shares, across(d, axis))


def _unit_directions(p: NDArray[np.float64], d: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the directions with unit length; refuse invalid rays."""
    with np.errstate(over="ignore"):
        length = np.linalg.norm(d, axis=1, keepdims=True)
    bad = ~(np.isfinite(p).all(axis=1) & np.isfinite(length[:, 0]) & (length[:, 0] > 0.0))
    if bad.any():
        i = int(np.flatnonzero(bad)[0])
        raise LfmeshError(
            f"ray {i}: origin {p[i].tolist()}, direction {d[i].tolist()}: must be finite, with a direction"
        )
    d = d / length
    # Normalised twice, as the first division leaves a rounding error.
    return np.ascontiguousarray(d / np.linalg.norm(d, axis=1, keepdims=True))


def at_wavelength(world: World, wavelength_nm: float) -> Tables:
    """Return the tables of a world with media and interfaces at one wavelength.

    Some are cached, to speed up many short calls of `trace`.
    """
    kept: Kept[Tables] = world.kept.setdefault("tables at a wavelength", Kept())
    return kept.of(wavelength_nm, lambda: _at_wavelength(world, wavelength_nm))


def _at_wavelength(world: World, wavelength_nm: float) -> Tables:
    tables = world.tables

    def media(within: Any, table: Callable[..., Media] = world.media.table_behind_lens) -> Media:
        return table((wavelength_nm,), world.book, np.ravel(within).tolist())

    interfaces = interface_tables(world.scene, (wavelength_nm,), world.book)
    cover = tables.cover
    if cover is not None:
        cover = cover._replace(media=media(cover.medium), interfaces=interfaces.cover)
    medium = tables.objects.medium.tolist()
    objects = tables.objects._replace(media=world.media.table_of_objects((wavelength_nm,), world.book, medium))
    if objects.glass is not None:
        objects = objects._replace(glass=objects.glass._replace(interfaces=interfaces.objects))
    if objects.volumes is not None:
        # The emission of media has a spectral width; absorption and scattering are for this wavelength.
        line = Lines.single((wavelength_nm,))
        hosts = hosts_of(world.scene, world.targets, objects.rank, objects.medium, objects.media)
        volumes, own = volumes_at(objects.volumes, world.scene, tables.frames, line, hosts)
        objects = objects._replace(volumes=volumes, media=own)
    if objects.fields is not None:
        wavelengths = world.lines.wavelengths_nm[0], wavelength_nm
        objects = objects._replace(fields=fields_at_wavelength(objects.fields, world.scene, wavelengths, objects.media))
    array = with_media(tables.mla, media(tables.mla.medium), interfaces=interfaces.mla)
    return tables._replace(
        lens=tables.lens._replace(
            aperture=None,
            media=media(tables.lens.medium, world.media.table),
            interfaces=interfaces.lens,
            gradients=gradient_spaces(world.scene, world.lens_shape, (wavelength_nm,)),
        ),
        mla=with_diffraction(world.scene, with_gradient_cells(world.scene, array, (wavelength_nm,)), (wavelength_nm,)),
        objects=objects,
        sensor=tables.sensor._replace(index2=index2_behind_lens(world.scene, (wavelength_nm,))),
        polarised=polarisation_tables(world.scene, (wavelength_nm,), tables.frames, world.book),
        cover=cover,
    )


def _at_level(world: World, tables: Tables, level: int) -> Tables:
    """Return the tables with another surface level for the analytic surfaces."""
    surfaces = tables.lens.surfaces.copy()
    surfaces["level"][world.lens_shape.analytic] = level
    bare = not len(tables.lens.patches) or (tables.mla.present and not len(tables.mla.patches))
    if level == PATCH and bare:
        raise LfmeshError('surface = "patch": needs a scene built with transport.surface = "patch"')
    return tables._replace(lens=tables.lens._replace(surfaces=surfaces))


def _kept(work: Workspace, _: range) -> tuple[Records, Records, NDArray[np.float64], NDArray[np.int64]]:
    """Return the ends, the vertices, the book and the counts of a chunk."""
    return work.ends(), work.vertices(), work.book.copy(), work.counts.copy()


def joined_records(parts: Iterable[tuple[Records, Records]]) -> tuple[Records, Records]:
    """Join the ends and vertices of chunks into one table each, with numbers adjusted."""
    shift = 0
    all_ended, all_nodes = [], [np.zeros(0, NODE)]
    for ended, nodes in parts:
        ended["node"] += np.where(ended["node"] >= 0, shift, 0)
        nodes["parent"] += np.where(nodes["parent"] >= 0, shift, 0)
        shift += len(nodes)
        all_ended.append(ended)
        all_nodes.append(nodes)
    return np.concatenate(all_ended or [np.zeros(0, END)]), np.concatenate(all_nodes)


class _Call(NamedTuple):
    """World and options of a call of `trace`."""

    world: World
    tables: Tables
    options: Options
    key: np.uint64
    threads: int
    states: _States | None = None

    def ended(
        self, p: NDArray[np.float64], d: NDArray[np.float64], numbers: NDArray[np.int64]
    ) -> tuple[Records, Records, NDArray[np.float64], NDArray[np.int64]]:
        """Trace rays as packets; return ends (in the order of the rays), vertices, book and counts.

        Parameters
        ----------
        p, d : (n, 3) float64
            Position, mm, and unit direction, world frame.
        numbers : (n,) int64
            Ray numbers in error messages.
        """
        world = self.world
        inside = glass_round(world.tables.objects, world.targets, p)
        station, space, p, d = located(world, p, d, numbers)
        if self.options.faces == BY_ORDER:
            refuse_starts_in_the_lens(station, space, len(self.tables.lens.surfaces), numbers)
        power, stokes, reference = self.states if self.states is not None else (np.ones(len(p)), None, None)
        source = RaySource(
            p, d, station, space, power, self.key, inside=inside if inside.any() else None, stokes=stokes,
            reference=reference,
        )  # fmt: skip
        launcher = Launcher(lambda: Workspace(world, self.options, tables=self.tables))
        parts = launcher.traced(source, _kept, self.threads, CHUNK)
        ended, nodes = joined_records(part[:2] for part in parts)
        book = np.sum([part[2] for part in parts], axis=0) if parts else np.zeros(len(world.slots))
        counts = np.sum([part[3] for part in parts], axis=0) if parts else np.zeros(COUNTERS, np.int64)
        return ended[np.argsort(ended["source"], kind="stable")], nodes, book, counts

    def ledger(self, book: NDArray[np.float64], counts: NDArray[np.int64], rays: int) -> Ledger:
        """Return the ledger for a number of rays."""
        return ledger_of(book, counts, self.world, rays, "of the rays' power")


def _absorbs(tables: Tables) -> bool:
    """Tell whether lens or array absorb light, or lose it in orders of phases.

    The power of a ray traced twice would then be entered twice.
    """
    return any(
        part.media.absorption is not None
        or part.interfaces.phases is not None
        or (part.interfaces.rows["kind"] == ABSORBING).any()
        for part in (tables.lens, tables.mla)
    )


def _as_packets(call: _Call, p: NDArray[np.float64], d: NDArray[np.float64]) -> Paths:
    """Trace rays as packets, with any number of children."""
    ended, nodes, book, counts = call.ended(p, _unit_directions(p, d), np.arange(len(p)))
    stokes = reference = None
    if call.tables.polarised is not None:
        stokes, reference = np.zeros((len(ended), 4)), np.zeros((len(ended), 3))
        if len(ended):
            stokes[:, 0], stokes[:, 1:] = ended["weight"], ended["weight"][:, None] * ended["stokes"]
            reference[:] = ended["reference"]
    return Paths(
        ended["position"].copy(),
        ended["direction"].copy(),
        ended["weight"].copy(),
        ended["status"].copy(),
        ended["source"].copy(),
        ended["events"].copy(),
        call.ledger(book, counts, len(p)),
        ended["body"].copy(),
        ended["node"].copy(),
        nodes,
        call.world,
        stokes,
        reference,
    )


def _in_blocks(call: _Call, p: NDArray[np.float64], d: NDArray[np.float64]) -> Paths:
    """Trace rays along the image path in blocks, and rays that may meet other things as packets.

    No ray has more than one end, so each has a fixed row in the result.
    """
    world = call.world
    ends, book, counts = followed(call.tables, world.surroundings, len(world.slots), p, d, call.threads)
    rest = np.flatnonzero(ends.fate >= UNSURE)
    if len(rest):
        if (ends.fate[rest] == REFUSED).any():
            _unit_directions(p, d)
        ended, _, more, events = call.ended(p[rest], _unit_directions(p[rest], d[rest]), rest)
        row = rest[ended["source"]]
        ends.position[row], ends.direction[row] = ended["position"], ended["direction"]
        ends.weight[row], ends.status[row], ends.events[row] = ended["weight"], ended["status"], ended["events"]
        ends.slot[row] = ended["body"]
        ends.fate[rest] = GONE
        ends.fate[row] = ENDED
        book, counts = book + more, counts + events
    shown: Any = ends.fate == ENDED
    source = np.flatnonzero(shown)
    if len(source) == len(p):
        # All rays have an end, so nothing need be copied.
        shown = slice(None)
    return Paths(
        ends.position[shown],
        ends.direction[shown],
        ends.weight[shown],
        ends.status[shown],
        source,
        ends.events[shown],
        call.ledger(book, counts, len(p)),
        ends.slot[shown],
        np.zeros(0, np.int64),
        np.zeros(0, NODE),
        world,
    )


__all__ = ["Event", "Paths", "Status", "Vertex", "trace"]
