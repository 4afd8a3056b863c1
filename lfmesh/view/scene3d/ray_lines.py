"""Rays as line segments: shared segments are drawn once, and whole paths are omitted if there are too many.

In gradient-index glass a segment is a curve, drawn as a line through many points.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from lfmesh.view.scene3d.colours import ColourBy, Legend, power_share, ray_colours

if TYPE_CHECKING:
    from lfmesh.view.rays.paths import Rays

Ints = NDArray[np.int64]

MOST_SEGMENTS = 20_000
"""Default limit: software rendering turns this many several times a second."""

FAINTEST = 0.12
"""Opacity of the weakest rays if power sets it."""

OPAQUE_SEGMENTS = 1000
"""Most segments drawn opaque. Beyond it, opacity falls with their number, so that lens and array stay visible."""

LEAST_OPACITY = 0.08
"""Lowest opacity of the strongest rays."""


@dataclass(frozen=True)
class RayLines:
    """Drawn segments of rays.

    Attributes
    ----------
    rays : Rays
    drawn : (n,) bool
        Mask of drawn paths.
    path, vertex : (m,) int64
        First path of each segment, and its start vertex, an index into `rays.position`.
    owners : (k,) int64
        Paths that share each segment, one segment after the other: segment i has owners[starts[i]:starts[i + 1]].
    starts : (m + 1,) int64
    """

    rays: "Rays"
    drawn: NDArray[np.bool_]
    path: Ints
    vertex: Ints
    owners: Ints
    starts: Ints

    def __len__(self) -> int:
        return len(self.path)

    @property
    def ends(self) -> NDArray[np.float64]:
        """(m, 2, 3) start and end of each segment, mm, world frame."""
        return np.stack([self.rays.position[self.vertex], self.rays.position[self.vertex + 1]], axis=1)

    @cached_property
    def points(self) -> tuple[NDArray[np.float64], Ints]:
        """(p, 3) points of all segments, mm, world frame, and (m + 1,) the first of each: two of a straight one."""
        curves = self.rays.curves(self.vertex)
        if not curves:
            return self.ends.reshape(-1, 3), 2 * np.arange(len(self) + 1)
        lines = [curves.get(int(vertex), ends) for vertex, ends in zip(self.vertex, self.ends, strict=True)]
        return np.concatenate(lines), np.concatenate([[0], np.cumsum([len(line) for line in lines])])

    @cached_property
    def pieces(self) -> tuple[NDArray[np.float64], Ints]:
        """(k, 2, 3) straight pieces of all segments, mm, world frame, and (k,) the segment of each."""
        points, firsts = self.points
        starts = np.delete(np.arange(len(points)), firsts[1:] - 1)
        pieces = np.stack([points[starts], points[starts + 1]], axis=1)
        return pieces, np.repeat(np.arange(len(self)), np.diff(firsts) - 1)

    @property
    def caption(self) -> str:
        """Number of drawn paths, and of all if more."""
        drawn, all_ = int(self.drawn.sum()), len(self.rays)
        if drawn == all_:
            return f"{all_:,} path{'' if all_ == 1 else 's'}"
        return f"{drawn:,} of {all_:,} paths drawn"

    def paths_of(self, segment: int) -> Ints:
        """Return the drawn paths that share a segment."""
        return self.owners[self.starts[segment] : self.starts[segment + 1]]

    def coloured(self, by: ColourBy, *, fade: bool = False) -> tuple[pv.PolyData, Legend]:
        """Return the segments as lines, one cell each, with their legend.

        The cells carry "rgba" (fainter with more segments and, with `fade`, less power), "path" and "vertex" as above,
        "event" of the start vertex, and "paths", the number of paths that share them.
        """
        rgb, legend = ray_colours(self.rays, self.path, self.vertex, by)
        lines = lines_through(*self.points)
        opacity = np.full(len(self), max(LEAST_OPACITY, min(1.0, OPAQUE_SEGMENTS / max(1, len(self)))))
        if fade:
            opacity *= FAINTEST + (1.0 - FAINTEST) * power_share(self.rays.power[self.vertex])
        lines.cell_data["rgba"] = np.column_stack([rgb, np.rint(255.0 * opacity).astype(np.uint8)])
        lines.cell_data["path"] = self.path
        lines.cell_data["vertex"] = self.vertex
        lines.cell_data["event"] = self.rays.event[self.vertex]
        lines.cell_data["paths"] = np.diff(self.starts)
        return lines, legend


def line_segments(ends: NDArray[np.float64]) -> pv.PolyData:
    """Return (n, 2, 3) line segments, one cell each."""
    return lines_through(ends.reshape(-1, 3), 2 * np.arange(len(ends) + 1))


def lines_through(points: NDArray[np.float64], firsts: Ints) -> pv.PolyData:
    """Return lines through points, one cell each.

    Parameters
    ----------
    points : (p, 3) float64
    firsts : (n + 1,) int64
        First point of each line, and the number of all points.
    """
    if not len(points):
        return pv.PolyData()
    return pv.PolyData(points, lines=np.insert(np.arange(len(points)), firsts[:-1], np.diff(firsts)))


def ray_lines(rays: "Rays", most_segments: int = MOST_SEGMENTS) -> RayLines:
    """Choose the paths to draw: all, or an even selection of whole paths with at most `most_segments` segments."""
    path, vertex, segment = _segments(rays)
    chosen = _evenly(len(rays), len(rays))
    low, high = 0, len(rays)
    while low < high:
        middle = (low + high + 1) // 2
        if _count(segment, _evenly(len(rays), middle)[path]) <= most_segments:
            low = middle
        else:
            high = middle - 1
    chosen = _evenly(len(rays), low)
    kept = np.flatnonzero(chosen[path])
    order = kept[np.argsort(segment[kept], kind="stable")]
    _, starts = np.unique(segment[order], return_index=True)
    first = order[starts]
    return RayLines(rays, chosen, path[first], vertex[first], path[order], np.append(starts, len(order)))


def _evenly(paths: int, count: int) -> NDArray[np.bool_]:
    """Mark `count` paths at equal steps."""
    chosen = np.zeros(paths, np.bool_)
    chosen[(np.arange(count) * paths) // max(1, count)] = True
    return chosen


def _count(segment: Ints, kept: NDArray[np.bool_]) -> int:
    return len(np.unique(segment[kept]))


def _segments(rays: "Rays") -> tuple[Ints, Ints, Ints]:
    """Return path and first vertex of every segment of non-zero length, and a number shared only by equal segments."""
    path = rays.path
    vertex = np.setdiff1d(np.arange(len(path)), rays.offsets[1:] - 1)
    ends = np.concatenate([rays.position[vertex], rays.position[vertex + 1]], axis=1)
    long = (ends[:, :3] != ends[:, 3:]).any(axis=1)
    vertex, ends = vertex[long], ends[long]
    # Children of a split repeat their parent's vertices bit by bit; another wavelength is another ray.
    same = np.column_stack([ends, rays.wavelength_nm[path[vertex]]])
    rows = np.ascontiguousarray(same).view(np.dtype((np.void, same.dtype.itemsize * same.shape[1]))).ravel()
    number = np.unique(rows, return_inverse=True)[1].reshape(-1) if len(rows) else np.zeros(0, np.int64)
    return path[vertex], vertex, number.astype(np.int64)
