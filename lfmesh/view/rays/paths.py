"""Paths of launched rays, vertex by vertex, as flat arrays for tables, filters and pictures.

A recorded trace is a tree of vertices with parents; here each path is laid out from start to end. The children of a
split share their first vertices, which are repeated in each path.
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
from lfmesh.transport.tables.gradient_spaces import has_gradients
from lfmesh.transport.tables.particles import corners_round
from lfmesh.transport.tables.tables import Records
from lfmesh.transport.world import World
from lfmesh.view.rays.gradient_cells import array_face
from lfmesh.view.rays.gradient_segments import (
    NO_FACE,
    Curves,
    GradientSegments,
    Vertices,
    curves_of,
    gradient_segments,
    line_of,
)
from lfmesh.view.rays.names import BACK, CURVED, FLAT, label, mirror_names, surface_names, surface_numbers

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

WATT, ETENDUE = "W", "m² sr"

LETTER = {Event.TRANSMITTED: "T", Event.REFLECTED: "R", Event.SCATTERED: "S"}
"""Letters for the events in a sequence; an end has only its name."""

OF_VERTICES = ("position", "surface", "event", "power", "lenslet", "beyond", "bends")
OF_PATHS = ("status", "source", "pixel", "wavelength_nm", "sequence")
"""Arrays of `Rays` with one row per vertex, and per path."""


def standard_errors(power: Floats, source: Ints, group: Ints, groups: int) -> Floats:
    """Return the standard errors of sums over independent rays, (groups,); infinite for fewer than two rays.

    Parameters
    ----------
    power : (n,) float64
        Power of each path, part of its ray's.
    source : (n,) int64
        Ray of each path; the largest number is that of the last ray.
    group : (n,) int64
        Sum to which each path contributes.
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
    """Field points of rays launched only from field points.

    Attributes
    ----------
    points_mm : tuple of (x, y, z), mm, world frame
    wavelengths_nm : tuple of float
        Wavelengths of each point.
    """

    points_mm: tuple[tuple[float, float, float], ...]
    wavelengths_nm: tuple[float, ...]


@dataclass(frozen=True)
class Rays:
    """Paths of launched rays. Path i owns the vertices offsets[i]:offsets[i + 1].

    Attributes
    ----------
    position : (m, 3) float64, mm, world frame
    surface : (m,) int64
        Index into `surfaces`.
    event : (m,) int64
        `lfmesh.transport.packets.packet.Event`.
    power : (m,) float64
        Power of the packet after the vertex; at the last vertex, its final power. In `unit`.
    offsets : (n + 1,) int64
    status : (n,) int64
        `lfmesh.Status` at the end.
    source : (n,) int64
        Number of the launched ray, counting only rays with paths.
    pixel : (n, 2) int64
        Row and column of the sensor pixel at its end or start; −1, −1: none.
    wavelength_nm : (n,) float64
    sequence : (n,) int64
        Index into `sequences`.
    surfaces : list of str
        Designers' names, see `lfmesh.view.rays.names`.
    sequences : list of str
        Distinct sequences of surfaces and events: "L1a T, L1b T, ..., sensor". Arriving sequences come first, in
        descending order of power.
    unit : str
        "W"; for rays launched from pixels "m² sr", the importance carried by adjoint packets: W per unit radiance.
    world : World
    lenslet : (m,) int64
        Lenslet on the curved faces, row by row; −1 elsewhere.
    beyond : (m,) int64
        Number in `world.media` of the medium beyond an interface or around a start; −1 elsewhere.
    bends : (m,) int64
        Number of points between a vertex and the next, on curves in media that bend light.
    bent : (k, 3) float64, mm, world frame
        These points, vertex by vertex.
    field : FieldPoints, optional
        Field points of the launch; None if some rays were launched otherwise.
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
    bends: Ints
    bent: Floats
    field: FieldPoints | None = None

    def __len__(self) -> int:
        return len(self.status)

    @property
    def from_sensor(self) -> bool:
        """True if the rays were launched backwards from pixels."""
        return self.unit == ETENDUE

    @cached_property
    def path(self) -> Ints:
        """(m,) path of each vertex."""
        return np.repeat(np.arange(len(self)), np.diff(self.offsets))

    @cached_property
    def gradients(self) -> GradientSegments:
        """Segments in gradient-index glass, camera frame."""
        return gradient_segments(self.world, self._vertices)

    @cached_property
    def _vertices(self) -> Vertices:
        position = frames.points(self.world.tables.frames[WORLD_FRAME, CAMERA_FRAME], self.position)
        face = np.where(self.surface <= len(self.world.lens_shape.surfaces), self.surface - 1, NO_FACE)
        for name in (CURVED, FLAT, BACK):
            face[self.surface == self.surfaces.index(name)] = array_face(self.world, is_curved=name == CURVED)
        return Vertices(position, face, self.lenslet, self.event, self.offsets, self.wavelength_nm)

    def curves(self, vertices: Ints) -> Curves:
        """Return points along the curved segments that begin at some vertices (k,), world frame."""
        curves = self._curves_in_air(vertices)
        return curves | self._curves_in_glass(vertices) if has_gradients(self.world.scene) else curves

    def _curves_in_air(self, vertices: Ints) -> Curves:
        """Return the curves in media that bend light."""
        ends = np.cumsum(self.bends)
        return {
            vertex: np.vstack([
                self.position[vertex], self.bent[ends[vertex] - self.bends[vertex] : ends[vertex]],
                self.position[vertex + 1],
            ])
            for vertex in vertices[self.bends[vertices] > 0].tolist()
        }  # fmt: skip

    def _curves_in_glass(self, vertices: Ints) -> Curves:
        chosen = self.gradients.of(np.flatnonzero(np.isin(self.gradients.vertex, vertices)))
        to_world = self.world.tables.frames[CAMERA_FRAME, WORLD_FRAME]
        curves = curves_of(self.world, self._vertices, chosen)
        for vertex, points in curves.items():
            curves[vertex] = frames.points(to_world, points)
            curves[vertex][[0, -1]] = self.position[[vertex, vertex + 1]]
        return curves

    def line(self, path: int) -> Floats:
        """Return the vertices of a path, with points along its curved segments, (points, 3) mm, world frame."""
        first, last = int(self.offsets[path]), int(self.offsets[path + 1]) - 1
        return line_of(self.position, first, last, self.curves(np.arange(first, last)))

    @cached_property
    def end_power(self) -> Floats:
        """(n,) power at the end of each path."""
        return self.power[self.offsets[1:] - 1]

    @cached_property
    def arrives(self) -> NDArray[np.bool_]:
        """(n,) whether a path connects scene and sensor: ends on it or, if launched from it, leaves the lens.

        Launched from pixels, a path that meets a target or enters object space is one along which light would arrive.
        """
        if self.from_sensor:
            return (self.status == Status.TARGET) | (self.status == Status.ESCAPED)
        return self.status == Status.SENSOR

    @cached_property
    def end(self) -> Ints:
        """(n,) surface at the end of each path."""
        return self.surface[self.offsets[1:] - 1]

    @cached_property
    def reflected(self) -> NDArray[np.bool_]:
        """(m,) whether the path was reflected there by the lens, array, sensor cover or sensor."""
        mirrors = [self.surfaces.index(name) for name in mirror_names(self.world)]
        return (self.event == Event.REFLECTED) & np.isin(self.surface, mirrors)

    @cached_property
    def events(self) -> Ints:
        """(n,) number of transmissions, reflections and scatterings of each path."""
        return self.count_vertices(np.isin(self.event, [Event.TRANSMITTED, Event.REFLECTED, Event.SCATTERED]))

    @cached_property
    def ghosts(self) -> NDArray[np.bool_]:
        """(n,) whether a path is a ghost: at least two reflections by lens or array, and it arrives."""
        return self.arrives & (self.count_vertices(self.reflected) >= 2)

    @property
    def launched(self) -> int:
        """Number of launched rays with paths."""
        return len(np.unique(self.source))

    def errors(self, group: Ints, groups: int) -> Floats:
        """Return the standard error of the power of groups of paths between scene and sensor, (groups,).

        It comes from the spread over the launched rays, each with all its paths, taken as independent. As they cover
        the pupil more evenly than that, it is an overestimate.

        Parameters
        ----------
        group : (n,) int64
            Group of each path.
        groups : int
        """
        return standard_errors(self.end_power * self.arrives, self.source, group, groups)

    def of_sequences(self, words: Container[str]) -> NDArray[np.bool_]:
        """Return a mask (n,) of the paths with one of the given sequences."""
        known = np.array([sequence in words for sequence in self.sequences], np.bool_)
        return known[self.sequence]

    def keep(self, chosen: NDArray[np.bool_]) -> "Rays":
        """Return only the paths chosen by a mask (n,); sequences keep their numbers."""
        lengths = np.diff(self.offsets)
        vertices = np.repeat(chosen, lengths)
        arrays: dict[str, Any] = {name: getattr(self, name)[vertices] for name in OF_VERTICES}
        arrays |= {name: getattr(self, name)[chosen] for name in OF_PATHS}
        arrays["bent"] = self.bent[np.repeat(vertices, self.bends)]
        return replace(self, offsets=np.concatenate([[0], np.cumsum(lengths[chosen])]), **arrays)

    def any_vertex(self, of_vertex: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return a mask (n,) of the paths with a vertex marked in `of_vertex` (m,)."""
        return self.count_vertices(of_vertex) > 0

    def count_vertices(self, of_vertex: NDArray[np.bool_]) -> Ints:
        """Return the number (n,) of vertices of each path that are marked in `of_vertex` (m,)."""
        running = np.concatenate([[0], np.cumsum(of_vertex)])
        return np.asarray(running[self.offsets[1:]] - running[self.offsets[:-1]])


def assembled(world: World, ended: Records, nodes: Records, wavelengths_nm: Floats, pixels: Ints | None = None) -> Rays:
    """Lay out recorded paths.

    Parameters
    ----------
    world : World
    ended : (n,) END, nodes : (m',) NODE
        Records of the engine.
    wavelengths_nm : (n,) float64
    pixels : (n,) int64, optional
        Start pixel of each path, row by row; if omitted, the rays were launched with the light.
    """
    root, length = _roots(ended["node"], nodes["parent"])
    order = np.argsort(root, kind="stable")
    root, ended, wavelengths_nm = root[order], ended[order], wavelengths_nm[order]
    offsets = np.concatenate([[0], np.cumsum(length[order])])
    every = nodes[_vertices(ended["node"], nodes["parent"], offsets)]
    met = every["event"] != Event.BENT
    vertices, bent = every[met], every["position"][~met]
    # The points of a curve follow the vertex at which it begins.
    bends = np.bincount(np.cumsum(met)[~met] - 1, minlength=len(vertices))
    offsets = np.concatenate([[0], np.cumsum(met)])[offsets]
    surface = surface_numbers(world, vertices["surface"], vertices["part"])
    event = vertices["event"].copy()
    # The first recorded event of light emitted by a target is that of its scattering.
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
        vertices["beyond"].copy(), bends, bent,
    )  # fmt: skip
    return _ranked(rays)


def _ranked(rays: Rays) -> Rays:
    """Return the rays with sequences in words and in order: arriving ones by power, others by count."""
    _, first, count = np.unique(rays.sequence, return_index=True, return_counts=True)
    power = np.bincount(rays.sequence, rays.end_power * rays.arrives, len(first))
    order = np.lexsort([first, -count, -power, ~rays.arrives[first]])
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return replace(rays, sequence=rank[rays.sequence], sequences=[_in_words(rays, path) for path in first[order]])


def _within_borders(world: World, position: Floats, ended: Records, offsets: Ints) -> Floats:
    """Return the vertices, with the last ones of some paths moved along their last segment into view.

    A path that escapes ends on a sphere around the whole scene. A path absorbed in a plane of the camera far outside it
    (the mount has no outer edge) ends on a sphere around the camera.
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
        # Move to the exit point from the sphere; rays that start outside and miss it stay unchanged.
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
    """Return points around camera, targets, lights and plane of focus, world frame."""
    points = [_points_of_camera(world)]
    focus = focus_wished_mm(world.scene.camera, world.scene.primary_nm)
    if focus is not None and np.isfinite(focus):
        points.append(frames.points(world.tables.frames[CAMERA_FRAME, WORLD_FRAME], [[0.0, 0.0, -focus]]))
    points += [target.mesh.vertices for target in world.targets]
    points.append(corners_round(world.particles))
    points += [light.region.corners_mm for light in world.scene.lights if light.region is not None]
    return np.concatenate(points)


def _sphere_round(points: Floats) -> tuple[Floats, float]:
    """Return centre and radius of a sphere that contains points."""
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    return middle, float(np.linalg.norm(points - middle, axis=1).max())


def _roots(last: Ints, parent: Ints) -> tuple[Ints, Ints]:
    """Return the first vertex and length of every path, by climbing from the last vertices in parallel."""
    count = np.zeros(len(last), np.int64)
    root, at = last.copy(), last.copy()
    while (on := at >= 0).any():
        count += on
        root = np.where(on, at, root)
        at = np.where(on, parent[np.maximum(at, 0)], at)
    return root, count


def _vertices(last: Ints, parent: Ints, offsets: Ints) -> Ints:
    """Return the vertices of every path from start to end, one path after the other."""
    index = np.empty(offsets[-1], np.int64)
    place, at = offsets[1:] - 1, last
    while len(at):
        index[place] = at
        place, at = place - 1, parent[at]
        place, at = place[at >= 0], at[at >= 0]
    return index


def _sequences(surface: Ints, event: Ints, offsets: Ints) -> Ints:
    """Return a number (n,) for each path's sequence of surfaces and events.

    All paths are read in parallel, one vertex per step: a number represents the part read so far, and its pair with the
    next vertex gets a new number.
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
    """Return the sequence of a path in words, without its start."""
    words = []
    for vertex in range(int(rays.offsets[path]) + 1, int(rays.offsets[path + 1])):
        letter = LETTER.get(Event(int(rays.event[vertex])))
        name = label(rays.surfaces[rays.surface[vertex]])
        words.append(f"{name} {letter}" if letter else name)
    return ", ".join(words)


def _pixels_under(world: World, ended: Records) -> Ints:
    """Return row and column (n, 2) of the pixels where paths end; −1, −1 for other ends."""
    sensor = world.tables.sensor
    x, y, _ = frames.points(world.tables.frames[WORLD_FRAME, SENSOR_FRAME], ended["position"]).T
    # The tracer has found these on the sensor; rounding must not move one off it.
    row = np.clip(np.floor(y / sensor.pixel + 0.5 * sensor.rows), 0, sensor.rows - 1)
    column = np.clip(np.floor(x / sensor.pixel + 0.5 * sensor.columns), 0, sensor.columns - 1)
    pixel = np.stack([row, column], axis=-1).astype(np.int64)
    pixel[ended["status"] != Status.SENSOR] = -1
    return pixel
