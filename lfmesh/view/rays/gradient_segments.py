"""Segments of paths in gradient-index glass, which are curves: their directions at both ends, and points along them.

A recorded path holds vertices alone. The direction in which a curve begins follows from the ray before it, by
refraction or reflection at the face where it begins. Points and directions are in the camera frame.

A face is the number of a refracting surface of the lens, or `TO_LENS` or `TO_SENSOR` of the array.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry import frame as frames
from lfmesh.geometry.ray import Ray
from lfmesh.geometry.surfaces.sag import normals
from lfmesh.geometry.surfaces.surface import in_place
from lfmesh.kernels.decorators import kernel
from lfmesh.transport.events.gradient import cross_gap, index_at
from lfmesh.transport.packets.packet import Event
from lfmesh.transport.sequences.gradient_gaps import gap_curves
from lfmesh.transport.tables.tables import LensTables, Tables
from lfmesh.transport.trace import at_wavelength
from lfmesh.transport.world import World
from lfmesh.view.rays.gradient_cells import arriving_in_cells, cell_curves, indices_and_normals, other_face

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

Curves = dict[int, Floats]
"""Points along curves, (points, 3) mm each, by the vertex at which each begins. The ends are the vertices."""

FLATNESS = 1e-4
"""Largest distance of a drawn curve from its chords, over the length of the longest curve in the same glass."""

FEWEST_POINTS, MOST_POINTS = 9, 1025

NO_FACE = -1

BEFORE_LENS, IN_ARRAY = -1, -2
"""In place of a space of the lens: a path that has not met the lens yet, and one in the array."""


class Vertices(NamedTuple):
    """Vertices of paths. Path i owns the vertices offsets[i]:offsets[i + 1].

    Attributes
    ----------
    position : (m, 3) float64, mm
    face : (m,) int64
        `NO_FACE` elsewhere than on lens and array.
    cell : (m,) int64
        Lenslet, row by row, on faces of a gradient-index array; of no effect elsewhere.
    event : (m,) int64
    offsets : (n + 1,) int64
    wavelength_nm : (n,) float64
    """

    position: Floats
    face: Ints
    cell: Ints
    event: Ints
    offsets: Ints
    wavelength_nm: Floats


class GradientSegments(NamedTuple):
    """Segments in gradient-index glass.

    Attributes
    ----------
    space_behind : (m,) int64
        Space of the lens that a path is in behind each of its vertices, or `BEFORE_LENS` or `IN_ARRAY`.
    vertex : (k,) int64
        Vertex at which each segment begins, ascending.
    space, face : (k,) int64
        Space of the segment, and the face that its ray travels to.
    cell : (k,) int64
        Lenslet where it begins; of no effect in the lens.
    wavelength_nm : (k,) float64
    leaving, arriving : (k, 3) float64, unit
        Directions at its start and at its end.
    """

    space_behind: Ints
    vertex: Ints
    space: Ints
    face: Ints
    cell: Ints
    wavelength_nm: Floats
    leaving: Floats
    arriving: Floats

    def number_of(self, vertex: int) -> int | None:
        """Return the number of the segment that begins at a vertex; None if that is straight."""
        at = int(np.searchsorted(self.vertex, vertex))
        return at if at < len(self.vertex) and self.vertex[at] == vertex else None

    def of(self, numbers: Ints) -> "GradientSegments":
        """Return some of the segments."""
        columns: dict[str, Any] = {name: getattr(self, name)[numbers] for name in self._fields[1:]}
        return self._replace(**columns)


def gradient_segments(world: World, vertices: Vertices) -> GradientSegments:
    """Find the segments of paths in gradient-index glass.

    Parameters
    ----------
    world : World
    vertices : Vertices
    """
    space_behind = _spaces_behind(vertices, len(world.lens_shape.surfaces))
    parts = [
        part
        for wavelength_nm in np.unique(vertices.wavelength_nm)
        for part in _of_wavelength(world, vertices, space_behind, float(wavelength_nm))
    ]
    if not parts:
        none, vectors = np.zeros(0, np.int64), np.zeros((0, 3))
        return GradientSegments(space_behind, none, none, none, none, np.zeros(0), vectors, vectors)
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    return GradientSegments(space_behind, *columns).of(np.argsort(columns[0]))


def _spaces_behind(vertices: Vertices, faces: int) -> Ints:
    """Return the space of the lens behind each vertex, from the faces that a path has met and its events there."""
    lengths, starts = np.diff(vertices.offsets), vertices.offsets[:-1]
    behind = np.full(len(vertices.face), BEFORE_LENS)
    space, in_array = np.full(len(starts), BEFORE_LENS), np.zeros(len(starts), np.bool_)
    for step in range(int(lengths.max(initial=0))):
        on = np.flatnonzero(lengths > step)
        vertex = starts[on] + step
        face, here, crosses = vertices.face[vertex], space[on], vertices.event[vertex] == Event.TRANSMITTED
        # A path enters by the first face or, from the sensor, by the last one.
        from_sensor = (face == faces - 1) & (faces > 1)
        here = np.where((here == BEFORE_LENS) & (face >= 0), np.where(from_sensor, faces, face), here)
        space[on] = np.where(crosses & (face >= 0), 2 * face + 1 - here, here)
        in_array[on] ^= crosses & (face < NO_FACE)
        behind[vertex] = np.where(in_array[on], IN_ARRAY, space[on])
    return behind


Part = tuple[Ints, Ints, Ints, Ints, Floats, Floats, Floats]
"""Columns of `GradientSegments` from `vertex` on."""


def _of_wavelength(world: World, vertices: Vertices, space_behind: Ints, wavelength_nm: float) -> Iterator[Part]:
    """Yield the segments of paths of one wavelength, those of each step and face together."""
    tables = at_wavelength(world, wavelength_nm)
    lengths, starts = np.diff(vertices.offsets), vertices.offsets[:-1]
    mine = vertices.wavelength_nm == wavelength_nm
    arriving = np.zeros((len(starts), 3))
    for step in range(int(lengths[mine].max(initial=0)) - 1):
        path = np.flatnonzero(mine & (lengths > step + 1))
        vertex = starts[path] + step
        before = arriving[path]
        arriving[path] = _unit(vertices.position[vertex + 1] - vertices.position[vertex])
        space, face = space_behind[vertex], vertices.face[vertex]
        curved = (face != NO_FACE) & _curved_spaces(tables)[space]
        for k, s in {(int(k), int(s)) for k, s in zip(face[curved], space[curved], strict=True)}:
            group = np.flatnonzero(curved & (face == k) & (space == s))
            at, cell = vertices.position[vertex[group]], vertices.cell[vertex[group]]
            outside, inside, normal = _sides(world, tables, (k, s), at, cell)
            along = before[group]
            leaving = np.where(
                (vertices.event[vertex[group]] == Event.TRANSMITTED)[:, None],
                _refracted(along, normal, outside / inside),
                along - 2.0 * (along * normal).sum(axis=1, keepdims=True) * normal,
            )
            ahead = (s if k == s - 1 else s - 1) if s >= 0 else other_face(k)
            if s >= 0:
                ends = np.empty((len(group), 3))
                _cross(tables.lens, s, ahead, np.ascontiguousarray(at), leaving, ends)
            else:
                ends = arriving_in_cells(tables, k, cell, at, leaving)
            arriving[path[group]] = ends
            whole = np.full(len(group), s), np.full(len(group), ahead), cell, np.full(len(group), wavelength_nm)
            yield vertex[group], *whole, leaving, ends


def _curved_spaces(tables: Tables) -> NDArray[np.bool_]:
    """Tell which spaces of the lens have gradient-index glass; at the end, as `IN_ARRAY` and `BEFORE_LENS`, others."""
    gradients, spaces = tables.lens.gradients, len(tables.lens.medium)
    in_lens = np.zeros(spaces, np.bool_) if gradients is None else gradients.number >= 0
    return np.concatenate([in_lens, [tables.mla.gradient is not None, False]])


def _sides(
    world: World, tables: Tables, where: tuple[int, int], at: Floats, cell: Ints
) -> tuple[Floats, Floats, Floats]:  # fmt: skip
    """Return the indices outside and inside gradient-index glass at points on a face of it, and unit normals there.

    Parameters
    ----------
    world : World
    tables : Tables
        Of one wavelength.
    where : (int, int)
        The face, and the space of the glass.
    at : (n, 3) float64, mm
    cell : (n,) int64
        Lenslets.
    """
    face, space = where
    if space >= 0:
        outside, inside = (indices_in(tables.lens, side, at) for side in (2 * face + 1 - space, space))
        return outside, inside, _normals(world.lens_shape.surfaces[face], at)
    inside, normals_ = indices_and_normals(tables, face, cell, at)
    return np.full(len(at), float(tables.mla.gradient.outside[0])), inside, normals_


@kernel
def _cross(lens: LensTables, space: int, face: int, points: Floats, directions: Floats, ends: Floats) -> None:
    """Find the directions of rays at the end of a gap."""
    for i in range(len(points)):
        ray = Ray(
            points[i, 0], points[i, 1], points[i, 2], directions[i, 0], directions[i, 1], directions[i, 2]
        )  # fmt: skip
        end = cross_gap(lens, space, 0, face, ray)
        ends[i, 0], ends[i, 1], ends[i, 2] = end.dx, end.dy, end.dz


@kernel
def _fill_indices(lens: LensTables, space: int, points: Floats, indices: Floats) -> None:
    for i in range(len(points)):
        indices[i] = index_at(lens, space, 0, points[i, 0], points[i, 1], points[i, 2])


def indices_in(lens: LensTables, space: int, points: Floats) -> Floats:
    """Return the refractive index of a space of the lens at points, (n,).

    Parameters
    ----------
    lens : LensTables
        Of one wavelength.
    space : int
    points : (n, 3) float64, mm
    """
    indices = np.empty(len(points))
    _fill_indices(lens, space, np.ascontiguousarray(points), indices)
    return indices


def curves_of(world: World, vertices: Vertices, segments: GradientSegments) -> Curves:
    """Return points along segments, as many as a smooth line needs.

    Parameters
    ----------
    world : World
    vertices : Vertices
    segments : GradientSegments
        Some of those of the vertices.
    """
    curves: Curves = {}
    keys = list(zip(segments.wavelength_nm.tolist(), segments.space.tolist(), segments.face.tolist(), strict=True))
    for key in dict.fromkeys(keys):
        group = np.array([number for number, other in enumerate(keys) if other == key])
        wavelength_nm = key[0]
        first = segments.vertex[group]
        start, end = vertices.position[first], vertices.position[first + 1]
        points = _smooth(_curves(at_wavelength(world, wavelength_nm), segments.of(group), start))
        points[:, 0], points[:, -1] = start, end
        curves |= zip(first.tolist(), points, strict=True)
    return curves


def line_of(position: Floats, first: int, last: int, curves: Curves) -> Floats:
    """Return the vertices of a path, with the points along its curves, (points, 3).

    Parameters
    ----------
    position : (m, 3) float64, mm
        Vertices of all paths.
    first, last : int
        Its first and last vertex.
    curves : Curves
        In the same frame.
    """
    pieces = [curves.get(vertex, position[vertex : vertex + 2])[:-1] for vertex in range(first, last)]
    return np.concatenate([*pieces, position[last : last + 1]])


def _curves(tables: Tables, segments: GradientSegments, start: Floats) -> Callable[[int], Floats]:
    """Return a function from the number of points to those along segments of one space and face, (n, points, 3)."""
    space, face, leaving = int(segments.space[0]), int(segments.face[0]), segments.leaving
    if space >= 0:
        return lambda points: gap_curves(tables.lens, space, face, 0, start, leaving, points)
    return lambda points: cell_curves(tables, other_face(face), segments.cell, start, leaving, points)


def _smooth(curves_by: Callable[[int], Floats]) -> Floats:
    """Return points along curves, (n, points, 3), so close that their chords are smooth.

    Parameters
    ----------
    curves_by : callable
        See `_curves`.
    """
    points = FEWEST_POINTS
    while True:
        curves = curves_by(points)
        length = float(np.linalg.norm(curves[:, -1] - curves[:, 0], axis=1).max())
        # The distance of an arc from its chord is an eighth of the second difference of its points.
        bend = np.linalg.norm(curves[:, 2:] - 2.0 * curves[:, 1:-1] + curves[:, :-2], axis=2)
        if 0.125 * float(bend.max()) <= FLATNESS * length or points >= MOST_POINTS:
            return np.array(curves)
        points = 2 * points - 1


def _normals(surface: np.void, points: Floats) -> Floats:
    """Return the unit normals of a lens surface at points on it, (n, 3)."""
    own = in_place(surface, points)
    return np.asarray(frames.directions(surface["pose"], normals(surface, own[:, 0], own[:, 1])))


def _refracted(d: Floats, normal: Floats, ratio: Floats) -> Floats:
    """Return unit directions behind faces by Snell's law; NaN under total reflection.

    Parameters
    ----------
    d, normal : (n, 3) float64, unit
    ratio : (n,) float64
        Index before each face over that behind it.
    """
    cosine = (d * normal).sum(axis=1, keepdims=True)
    across = ratio[:, None] * (d - cosine * normal)
    with np.errstate(invalid="ignore"):
        along = np.sqrt(1.0 - (across * across).sum(axis=1, keepdims=True))
    return np.asarray(across + np.copysign(along, cosine) * normal)


def _unit(vectors: Floats) -> Floats:
    """Return vectors scaled to length 1; vectors of length 0 as they are."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.where(length > 0.0, length, 1.0))
