"""Every path of a set of launched rays, vertex by vertex, as flat arrays: what tables, filters and pictures work on.

A recorded trace is a tree of vertices that know their parents; here every path is laid out from its start to its end.
Both children of a split share their first vertices, so those stand in several paths.
"""

from collections.abc import Container
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry import frame as frames
from lfmesh.scene.first_order.solve import focus_wished_mm
from lfmesh.transport.packets.packet import CAMERA_FRAME, NO_SURFACE, SENSOR_FRAME, WORLD_FRAME, Event, Status
from lfmesh.transport.tables.particles import corners_round
from lfmesh.transport.tables.tables import Records
from lfmesh.transport.world import World
from lfmesh.view.rays.names import BACK, CURVED, label, mirror_names, surface_names, surface_numbers

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

WATT, ETENDUE = "W", "m² sr"

LETTER = {Event.TRANSMITTED: "T", Event.REFLECTED: "R", Event.SCATTERED: "S"}
"""Letters of a sequence for the events at a surface; an end has its name alone."""

OF_VERTICES = ("position", "surface", "event", "power", "lenslet", "beyond")
OF_PATHS = ("status", "source", "pixel", "wavelength_nm", "sequence")
"""Arrays of `Rays` with a row for each vertex, and for each path."""


def standard_errors(power: Floats, source: Ints, group: Ints, groups: int) -> Floats:
    """Return the standard errors of sums over independent rays, (groups,); infinite with fewer than two rays.

    Parameters
    ----------
    power : (n,) float64
        Of each path, a share of its ray's.
    source : (n,) int64
        The ray of each path; the largest number is that of the last ray.
    group : (n,) int64
        The sum that each path belongs to.
    groups : int
    """
    launched = int(source.max(initial=-1)) + 1
    if launched < 2:
        return np.full(groups, np.inf)
    pairs, of_path = np.unique(group * launched + source, return_inverse=True)
    of_ray = np.bincount(of_path.reshape(-1), power, len(pairs))
    squares = np.bincount(pairs // launched, of_ray**2, groups)
    sums = np.bincount(pairs // launched, of_ray, groups)
    variance = (squares - sums**2 / launched) * launched / (launched - 1)
    return np.sqrt(np.maximum(variance, 0.0))


class FieldPoints(NamedTuple):
    """Field points that rays were launched from, where all of them were.

    Attributes
    ----------
    points_mm : tuple of (x, y, z), mm, world frame
    wavelengths_nm : tuple of float
        Of each of them.
    """

    points_mm: tuple[tuple[float, float, float], ...]
    wavelengths_nm: tuple[float, ...]


@dataclass(frozen=True)
class Rays:
    """Every path of a set of launched rays. Path i owns the vertices offsets[i]:offsets[i + 1].

    Attributes
    ----------
    position : (m, 3) float64, mm, world frame
    surface : (m,) int64
        Index into `surfaces`.
    event : (m,) int64
        `lfmesh.transport.packets.packet.Event`.
    power : (m,) float64
        What the packet went on with; at the last vertex what it ended with. In `unit`.
    offsets : (n + 1,) int64
    status : (n,) int64
        `lfmesh.Status`: how each ended.
    source : (n,) int64
        Launched ray that it descends from, counting those that left any path.
    pixel : (n, 2) int64
        Row and column of the sensor pixel that it ends on, or started from; −1, −1: none.
    wavelength_nm : (n,) float64
    sequence : (n,) int64
        Index into `sequences`.
    surfaces : list of str
        What a designer calls them, see `lfmesh.view.rays.names`.
    sequences : list of str
        Every distinct sequence of surface and event, once: "L1a T, L1b T, ..., sensor". Those that arrive come first,
        the one with the most power before all others.
    unit : str
        "W"; of rays launched from pixels "m² sr", the importance that adjoint packets carry: W per unit radiance.
    world : World
    lenslet : (m,) int64
        On the curved faces the lenslet, row by row; −1 elsewhere.
    beyond : (m,) int64
        Number in `world.media` of what is on the far side of an interface, and round a start; −1 elsewhere.
    field : FieldPoints, optional
        The field points that all of them were launched from; None if some were launched otherwise.
    """

    position: Floats
    surface: Ints
    event: Ints
    power: Floats
    offsets: Ints
    status: Ints
    source: Ints
    pixel: Ints
    wavelength_nm: Floats
    sequence: Ints
    surfaces: list[str]
    sequences: list[str]
    unit: str
    world: World
    lenslet: Ints
    beyond: Ints
    field: FieldPoints | None = None

    def __len__(self) -> int:
        return len(self.status)

    @property
    def from_sensor(self) -> bool:
        """True if the rays were launched from pixels, against the light."""
        return self.unit == ETENDUE

    @cached_property
    def path(self) -> Ints:
        """(m,) path that each vertex belongs to."""
        return np.repeat(np.arange(len(self)), np.diff(self.offsets))

    @cached_property
    def end_power(self) -> Floats:
        """(n,) power that each path ended with."""
        return self.power[self.offsets[1:] - 1]

    @cached_property
    def arrives(self) -> NDArray[np.bool_]:
        """(n,) whether a path links the scene with the sensor: it ends there or, launched from it, leaves the lens.

        Launched from pixels, a path that meets a target or goes on into object space is one along which light from
        there would come.
        """
        if self.from_sensor:
            return (self.status == Status.TARGET) | (self.status == Status.ESCAPED)
        return self.status == Status.SENSOR

    @cached_property
    def end(self) -> Ints:
        """(n,) surface that each path ended on."""
        return self.surface[self.offsets[1:] - 1]

    @cached_property
    def reflected(self) -> NDArray[np.bool_]:
        """(m,) whether a path was reflected there by lens, array, the sensor's cover or the sensor."""
        mirrors = [self.surfaces.index(name) for name in mirror_names(self.world)]
        return (self.event == Event.REFLECTED) & np.isin(self.surface, mirrors)

    @cached_property
    def events(self) -> Ints:
        """(n,) how often each path was transmitted, reflected or scattered."""
        return self.count_vertices(np.isin(self.event, [Event.TRANSMITTED, Event.REFLECTED, Event.SCATTERED]))

    @cached_property
    def ghosts(self) -> NDArray[np.bool_]:
        """(n,) whether a path is a ghost: at least two reflections by lens or array, and it arrives."""
        return self.arrives & (self.count_vertices(self.reflected) >= 2)

    @property
    def launched(self) -> int:
        """Number of launched rays that any path descends from."""
        return len(np.unique(self.source))

    def errors(self, group: Ints, groups: int) -> Floats:
        """Return the standard error of the power that groups of paths bring between scene and sensor, (groups,).

        From the spread over the launched rays, each with all of its paths, taken as independent. They cover the pupil
        more evenly than that, so that it is rather too large than too small.

        Parameters
        ----------
        group : (n,) int64
            Of each path.
        groups : int
        """
        return standard_errors(self.end_power * self.arrives, self.source, group, groups)

    def of_sequences(self, words: Container[str]) -> NDArray[np.bool_]:
        """Return (n,) which paths have one of some sequences."""
        known = np.array([sequence in words for sequence in self.sequences], np.bool_)
        return known[self.sequence]

    def keep(self, chosen: NDArray[np.bool_]) -> "Rays":
        """Return only the paths (n,) chosen; sequences keep their numbers."""
        lengths = np.diff(self.offsets)
        vertices = np.repeat(chosen, lengths)
        arrays: dict[str, Any] = {name: getattr(self, name)[vertices] for name in OF_VERTICES}
        arrays |= {name: getattr(self, name)[chosen] for name in OF_PATHS}
        return replace(self, offsets=np.concatenate([[0], np.cumsum(lengths[chosen])]), **arrays)

    def any_vertex(self, of_vertex: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return (n,) which paths have a vertex that is marked in `of_vertex` (m,)."""
        return self.count_vertices(of_vertex) > 0

    def count_vertices(self, of_vertex: NDArray[np.bool_]) -> Ints:
        """Return (n,) how many vertices of each path are marked in `of_vertex` (m,)."""
        running = np.concatenate([[0], np.cumsum(of_vertex)])
        return np.asarray(running[self.offsets[1:]] - running[self.offsets[:-1]])


def assembled(world: World, ended: Records, nodes: Records, wavelengths_nm: Floats, pixels: Ints | None = None) -> Rays:
    """Lay recorded paths out.

    Parameters
    ----------
    world : World
    ended : (n,) END, nodes : (m',) NODE
        What the engine recorded.
    wavelengths_nm : (n,) float64
    pixels : (n,) int64, optional
        Pixel, row by row, that each path started from; left out, the rays were launched with the light.
    """
    root, length = _roots(ended["node"], nodes["parent"])
    order = np.argsort(root, kind="stable")
    root, ended, wavelengths_nm = root[order], ended[order], wavelengths_nm[order]
    offsets = np.concatenate([[0], np.cumsum(length[order])])
    index = _vertices(ended["node"], nodes["parent"], offsets)
    vertices = nodes[index]
    surface = surface_numbers(world, vertices["surface"], vertices["part"])
    event = vertices["event"].copy()
    # Light that a target emits starts with what it is scattered with.
    event[offsets[:-1]] = Event.START
    names = surface_names(world)
    sequence = _sequences(surface, event, offsets)
    columns = world.tables.sensor.columns
    pixel = _pixels_under(world, ended) if pixels is None else np.stack(np.divmod(pixels[order], columns), axis=-1)
    rays = Rays(
        _within_borders(world, vertices["position"], ended, offsets), surface, event, vertices["weight"].copy(),
        offsets, ended["status"].copy(), np.unique(root, return_inverse=True)[1].reshape(-1), pixel, wavelengths_nm,
        sequence, names, [], WATT if pixels is None else ETENDUE, world,
        np.where(np.isin(surface, [names.index(CURVED), names.index(BACK)]), vertices["part"], NO_SURFACE),
        vertices["beyond"].copy(),
    )  # fmt: skip
    return _ranked(rays)


def _ranked(rays: Rays) -> Rays:
    """Return the rays with their sequences in words and in order: those that arrive, by power; the others, by count."""
    _, first, count = np.unique(rays.sequence, return_index=True, return_counts=True)
    power = np.bincount(rays.sequence, rays.end_power * rays.arrives, len(first))
    order = np.lexsort([first, -count, -power, ~rays.arrives[first]])
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return replace(rays, sequence=rank[rays.sequence], sequences=[_in_words(rays, path) for path in first[order]])


def _within_borders(world: World, position: Floats, ended: Records, offsets: Ints) -> Floats:
    """Return the vertices, the last ones of some paths moved along their last segment to where they can be seen.

    A path that escapes goes on to a sphere round the whole scene. One that is absorbed in a plane of the camera far
    outside of it (the mount has no outer edge) ends on the sphere round the camera.
    """
    moved = position.copy()
    for status, (middle, radius) in (
        (Status.ESCAPED, _sphere_round(_points_of_scene(world))),
        (Status.ABSORBED, _sphere_round(_points_of_camera(world))),
    ):
        paths = np.flatnonzero((ended["status"] == status) & (np.diff(offsets) > 1))
        last = offsets[1:][paths] - 1
        p, d = position[last - 1] - middle, ended["direction"][paths]
        along, outside = np.sum(p * d, axis=1), np.sum(p * p, axis=1) - radius**2
        # Where the ray leaves the sphere; one that starts outside and never meets it stays as it is.
        root = along**2 - outside
        leaves = np.where(root > 0.0, np.sqrt(np.maximum(root, 0.0)) - along, 0.0)
        length = np.linalg.norm(position[last] - position[last - 1], axis=1)
        moves = (leaves > 0.0) & ((length > leaves) | (status == Status.ESCAPED))
        moved[last[moves]] = (position[last - 1] + leaves[:, None] * d)[moves]
    return moved


def _points_of_camera(world: World) -> Floats:
    """Return the corners of the camera's housing, world frame."""
    return frames.points(world.tables.frames[CAMERA_FRAME, WORLD_FRAME], world.housing.vertices)


def _points_of_scene(world: World) -> Floats:
    """Return points round camera, targets, lights and the plane of focus, world frame."""
    points = [_points_of_camera(world)]
    focus = focus_wished_mm(world.scene.camera, world.scene.primary_nm)
    if focus is not None and np.isfinite(focus):
        points.append(frames.points(world.tables.frames[CAMERA_FRAME, WORLD_FRAME], [[0.0, 0.0, -focus]]))
    points += [target.mesh.vertices for target in world.targets]
    points.append(corners_round(world.particles))
    points += [light.region.corners_mm for light in world.scene.lights if light.region is not None]
    return np.concatenate(points)


def _sphere_round(points: Floats) -> tuple[Floats, float]:
    """Return centre and radius of a sphere that holds points."""
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    return middle, float(np.linalg.norm(points - middle, axis=1).max())


def _roots(last: Ints, parent: Ints) -> tuple[Ints, Ints]:
    """Return the first vertex of every path and how many it has: all climb from their last one, a vertex a step."""
    count = np.zeros(len(last), np.int64)
    root, at = last.copy(), last.copy()
    while (on := at >= 0).any():
        count += on
        root = np.where(on, at, root)
        at = np.where(on, parent[np.maximum(at, 0)], at)
    return root, count


def _vertices(last: Ints, parent: Ints, offsets: Ints) -> Ints:
    """Return the vertices of every path from its start to its end, one path after the other."""
    index = np.empty(offsets[-1], np.int64)
    place, at = offsets[1:] - 1, last
    while len(at):
        index[place] = at
        place, at = place - 1, parent[at]
        place, at = place[at >= 0], at[at >= 0]
    return index


def _sequences(surface: Ints, event: Ints, offsets: Ints) -> Ints:
    """Return (n,) a number of each path's sequence of surfaces and events.

    All paths are read together, a vertex a step: what was read so far has a number, and with the next vertex the pair
    of both has one.
    """
    code = surface * len(Event) + event
    most = int(code.max(initial=0)) + 1
    length = np.diff(offsets)
    sequence = np.zeros(len(length), np.int64)
    taken = 1
    for step in range(1, int(length.max(initial=0))):
        on = np.flatnonzero(length > step)
        pairs = sequence[on] * most + code[offsets[on] + step]
        distinct, inverse = np.unique(pairs, return_inverse=True)
        sequence[on] = taken + inverse.reshape(-1)
        taken += len(distinct)
    return np.unique(sequence, return_inverse=True)[1].reshape(-1).astype(np.int64)


def _in_words(rays: Rays, path: int) -> str:
    """Return the sequence of a path in words; where it started is no part of it."""
    words = []
    for vertex in range(int(rays.offsets[path]) + 1, int(rays.offsets[path + 1])):
        letter = LETTER.get(Event(int(rays.event[vertex])))
        name = label(rays.surfaces[rays.surface[vertex]])
        words.append(f"{name} {letter}" if letter else name)
    return ", ".join(words)


def _pixels_under(world: World, ended: Records) -> Ints:
    """Return (n, 2) row and column of the pixels that paths end on; −1, −1 for those that end elsewhere."""
    sensor = world.tables.sensor
    x, y, _ = frames.points(world.tables.frames[WORLD_FRAME, SENSOR_FRAME], ended["position"]).T
    # The tracer has decided that these lie on the sensor; a rounding error must not take one off it.
    row = np.clip(np.floor(y / sensor.pixel + 0.5 * sensor.rows), 0, sensor.rows - 1)
    column = np.clip(np.floor(x / sensor.pixel + 0.5 * sensor.columns), 0, sensor.columns - 1)
    pixel = np.stack([row, column], axis=-1).astype(np.int64)
    pixel[ended["status"] != Status.SENSOR] = -1
    return pixel
