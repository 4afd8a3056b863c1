"""Pupils by brute force: the points of the stop that light of an object point reaches and passes a lens of spheres.

A grid of cells covers the whole front of the lens. Cells are divided until the map to the stop is nearly linear in
each, or no point of the stop lies near their image. Then the secant method from the middle of a cell contracts, and
finds the one ray of this cell through a point. A ray counts if it meets all conditions itself. No ray is found from one
of another cell, and no code is shared with the package.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

CELLS, DEEPEST = 72, 28
"""Number of cells of the grid along each axis, and how often they are divided in two along each axis at most."""

FOLDS = 5
"""How often cells that light may pass are divided where no point lies near them, to find folds."""

WIDER = 1.5
"""Width of the square of a cell's nodes over that of the cell, so that no border passes between the nodes unseen."""

FLAT = 0.05
"""Deviation of the map from a linear one at a cell's nodes, over the least width of their image, up to which it counts
as linear; the secant method contracts from the middle up to 0.09, by Kantorovich's theorem."""

STEPS, ARRIVED = 24, 1e-9
"""Steps of the secant method, and largest miss after them, over the stop's radius."""

SHARED = 1e-6
"""Part of a cell's width by which it overlaps the next ones, so that rounding loses no ray on their border."""

MOUNT = 1.02
"""Radius of a surface's mount, at which a ray ends, too, over that of its clear aperture."""


@dataclass(frozen=True)
class Prescription:
    """A centred lens of spheres with a stop.

    Attributes
    ----------
    surfaces : list of dict
        As a scene has them, all with `semi_diameter_mm`.
    object_mm : float
        Distance of the object plane before the first vertex, or inf.
    slope : float
        Of the object point.
    """

    surfaces: list[dict[str, Any]]
    object_mm: float
    slope: float

    @property
    def stop_radius(self) -> float:
        """mm."""
        return float(next(s["semi_diameter_mm"] for s in self.surfaces if s.get("stop")))

    def traced(self, entry: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return the points (n, 2) of the stop, mm, to which rays come, and the conditions that they meet.

        The rays cross the plane of the first vertex at `entry` (n, 2). Conditions are (n, conditions): each surface is
        there, holds the ray within its aperture, and refracts it.
        """
        return self.followed(entry)[:2]

    def followed(self, entry: Array) -> "Followed":
        """Return the rays that cross the plane of the first vertex at `entry` (n, 2), behind the lens."""
        vergence = 1.0 / self.object_mm
        d = np.column_stack([entry[:, 0] * vergence, entry[:, 1] * vergence - self.slope, np.ones(len(entry))])
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        p = np.column_stack([entry, np.zeros(len(entry))])
        met, at_stop, vertex, index = [], np.full((len(p), 2), np.nan), 0.0, 1.0
        again, weight = np.full(len(p), np.inf), np.ones(len(p))
        with np.errstate(all="ignore"):
            for surface in self.surfaces:
                c = 1.0 / surface.get("radius_mm", math.inf)
                q = p - np.array([0.0, 0.0, vertex])
                # Of the two crossings of the sphere, that of the sheet at the vertex.
                b = c * (q * d).sum(axis=1) - d[:, 2]
                g = c * (q * q).sum(axis=1) - 2.0 * q[:, 2]
                root = b * b - c * g
                t = g / (-b + np.sqrt(root))
                q, again = q + t[:, None] * d, again - t
                met.append(again > 0.0)
                met.append((root > 0.0) & (np.hypot(q[:, 0], q[:, 1]) <= surface["semi_diameter_mm"]))
                met.append(1.0 - c * q[:, 2] > 0.0)
                after = surface.get("index", 1.0) if "radius_mm" in surface else index
                normal = np.column_stack([-c * q[:, 0], -c * q[:, 1], 1.0 - c * q[:, 2]])
                cosine, ratio = (normal * d).sum(axis=1), index / after
                square = 1.0 - ratio**2 * (1.0 - cosine**2)
                met.append(square > 0.0)
                beyond = np.sqrt(square)
                # Fresnel's amplitudes, both polarisations alike.
                s, t = ((a - b) / (a + b) for a, b in ((ratio * cosine, beyond), (cosine, ratio * beyond)))
                weight *= 1.0 - 0.5 * (s * s + t * t)
                d = ratio * d + (beyond - ratio * cosine)[:, None] * normal
                if "radius_mm" in surface:
                    again = self._again(q, d, c, MOUNT * surface["semi_diameter_mm"])
                if surface.get("stop"):
                    at_stop = q[:, :2]
                p, index = q + np.array([0.0, 0.0, vertex]), after
                vertex += surface.get("thickness_mm", 0.0)
        return Followed(at_stop, np.stack([*met, np.isinf(again)], axis=1), p, d, weight)

    @staticmethod
    def _again(q: Array, d: Array, c: float, rim: float) -> Array:
        """Return the distance at which rays meet the concave surface again that they leave; inf: they do not."""
        if c == 0.0:
            return np.full(len(q), np.inf)
        again = -2.0 * (c * (q * d).sum(axis=1) - d[:, 2]) / c
        x, y, z = (q + again[:, None] * d).T
        return np.where((again > 0.0) & (c * z < 1.0) & (np.hypot(x, y) <= rim), again, np.inf)

    def box(self) -> tuple[Array, Array]:
        """Return corners of the rectangle in the plane of the first vertex through which all rays enter the glass."""
        angle, part = np.meshgrid(np.linspace(0.0, 2.0 * math.pi, 720), np.linspace(0.0, 1.0, 64))
        vertex, first = 0.0, self.surfaces[0]
        if "radius_mm" not in first:
            vertex, first = first["thickness_mm"], self.surfaces[1]
        c, height = 1.0 / first["radius_mm"], part * first["semi_diameter_mm"]
        z = vertex + c * height**2 / (1.0 + np.sqrt(1.0 - (c * height) ** 2))
        # From x(z) = e + z (e / object − slope).
        at = np.stack([height * np.cos(angle), height * np.sin(angle) + z * self.slope], axis=-1)
        every = (at / (1.0 + z / self.object_mm)[..., None]).reshape(-1, 2)
        middle, half = 0.5 * (every.min(axis=0) + every.max(axis=0)), 0.5 * np.ptp(every, axis=0)
        return middle - 1.013 * half, middle + 1.007 * half


class Followed(NamedTuple):
    """Rays behind a lens.

    Attributes
    ----------
    at_stop : (n, 2) float64, mm
    met : (n, conditions) bool
        See `Prescription.traced`.
    position, direction : (n, 3) float64
        On the last surface, mm from the first vertex, and unit.
    weight : (n,) float64
        Transmittance of bare surfaces by Fresnel's equations.
    """

    at_stop: Array
    met: Flags
    position: Array
    direction: Array
    weight: Array


class Reached(NamedTuple):
    """Points of the stop that light reaches and passes the lens.

    Attributes
    ----------
    rays : (n,) int64
        Number of rays through each point; those on the border of two cells count twice.
    folded : bool
        Whether rays that pass cross before the stop, so that a part of the map lies turned over.
    undecided : int
        Number of cells and rays that stayed open.
    """

    rays: NDArray[np.int64]
    folded: bool
    undecided: int


def reached(lens: Prescription, across: int) -> Reached:
    """Find the points of the square grid in the stop, see `pupil_grid`, that rays reach which pass the lens."""
    low, high = lens.box()
    width, points, turned, flat = (high - low) / CELLS, _Points.of(across), set[float](), []
    j, i = (each.ravel() for each in np.meshgrid(np.arange(CELLS), np.arange(CELLS), indexing="ij"))
    middle = low + (np.column_stack([i, j]) + 0.5) * width
    cells = _Cells(middle, np.tile(width, (len(middle), 1)), np.tile([[[-np.inf], [np.inf]]], (len(middle), 1, 2)))
    for level in range(DEEPEST + 1):
        images = _images(lens, cells)
        turned |= _senses(images.slopes[images.flat & images.clear])
        over = images.open & (points.number(images.bounds) > 0)
        flat.append((cells.taken(images.flat & over), images.taken(images.flat & over)))
        divided = ~images.flat & (over | (images.open & (level < FOLDS)))
        cells = cells._replace(bounds=images.bounds).taken(divided).divided()
    mine, theirs = (tuple(zip(*(pair[k] for pair in flat), strict=True)) for k in (0, 1))
    flat_cells, flat_images = _Cells(*map(np.concatenate, mine)), _Images(*map(np.concatenate, theirs))
    ray, lost = _rays(lens, flat_cells, flat_images, points)
    count = np.bincount(ray[:, 0], minlength=len(points.place))
    turned |= _senses(flat_images.slopes[ray[:, 1]])
    return Reached(count, len(turned) > 1, lost + len(cells.middle) // 4)


class _Cells(NamedTuple):
    """Cells in the plane of the first vertex.

    Attributes
    ----------
    middle, width : (n, 2) float64, mm
    bounds : (n, 2, 2) float64
        Low and high corners of a rectangle in the stop, over its radius, that holds the image.
    """

    middle: Array
    width: Array
    bounds: Array

    def taken(self, which: Flags) -> "_Cells":
        return _Cells(*(each[which] for each in self))

    def divided(self) -> "_Cells":
        """Return the four cells of half the width in each."""
        quarters = 0.25 * self.width[:, None] * np.array([[-1, -1], [1, -1], [-1, 1], [1, 1]])
        middle = (self.middle[:, None] + quarters).reshape(-1, 2)
        return _Cells(middle, np.repeat(0.5 * self.width, 4, axis=0), np.repeat(self.bounds, 4, axis=0))


class _Points(NamedTuple):
    """Points of the stop.

    Attributes
    ----------
    place : (n, 2) float64
        Over the stop's radius.
    number_at : (across, across) int64
        Number of the point in each row and column of the grid; −1 beside the stop.
    below : (across + 1, across + 1) int64
        Number of points in the rows and columns before each.
    """

    place: Array
    number_at: NDArray[np.int64]
    below: NDArray[np.int64]

    @classmethod
    def of(cls, across: int) -> "_Points":
        steps = (np.arange(across) - 0.5 * (across - 1)) / (0.5 * across)
        x, y = np.meshgrid(steps, steps, indexing="xy")
        inside = x * x + y * y <= 1.0
        number_at = np.where(inside, np.cumsum(inside).reshape(inside.shape) - 1, -1)
        below = np.pad(inside.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
        return cls(np.column_stack([x[inside], y[inside]]), number_at, below)

    def _range(self, bounds: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the first columns and rows (n, 2) within bounds, and those behind the last ones."""
        across = len(self.number_at)
        pixels = (bounds + 1.0) * 0.5 * across - 0.5
        first = np.clip(np.ceil(pixels[:, 0]), 0, across).astype(np.int64)
        return first, np.maximum(np.clip(np.floor(pixels[:, 1]) + 1.0, 0, across).astype(np.int64), first)

    def number(self, bounds: Array) -> NDArray[np.int64]:
        """Return the number of points in rectangles (n, 2, 2): their low and high corners."""
        (x, y), (to_x, to_y) = (each.T for each in self._range(bounds))
        below = self.below
        return np.asarray(below[to_y, to_x] - below[to_y, x] - below[y, to_x] + below[y, x])

    def within(self, bounds: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the numbers of points in rectangles, and of their rectangles."""
        first, behind = self._range(bounds)
        wide = behind - first
        which = np.repeat(np.arange(len(wide)), wide.prod(axis=1))
        order = np.arange(len(which)) - np.repeat(np.cumsum(wide.prod(axis=1)) - wide.prod(axis=1), wide.prod(axis=1))
        x, y = first[which].T + np.stack(
            [order % np.maximum(wide[which, 0], 1), order // np.maximum(wide[which, 0], 1)]
        )
        number = self.number_at[y, x]
        return number[number >= 0], which[number >= 0]


NODES = np.array([[x, y] for y in (-0.5, 0.0, 0.5) for x in (-0.5, 0.0, 0.5)])
"""Nodes of a cell, over the width of their square; the fifth is the middle."""

SLOPES = np.linalg.pinv(np.column_stack([np.ones(9), NODES]))[1:]
"""Takes values at the nodes to the two slopes of the linear map nearest to them."""


class _Images(NamedTuple):
    """Images of cells in the stop, over its radius.

    Attributes
    ----------
    middle : (n, 2) float64
    slopes : (n, 2, 2) float64
        [i, j] of coordinate i along axis j, over the cell's width.
    bounds : (n, 2, 2) float64
        Low and high corners of a rectangle that holds the image.
    flat, open, clear : (n,) bool
        Whether the map is known and nearly linear; whether light may pass, each condition being met at some node; and
        whether it passes in the middle.
    """

    middle: Array
    slopes: Array
    bounds: Array
    flat: Flags
    open: Flags
    clear: Flags

    def taken(self, which: Flags) -> "_Images":
        return _Images(*(each[which] for each in self))


def _images(lens: Prescription, cells: _Cells) -> _Images:
    """Trace the nodes of cells."""
    at, met = lens.traced((cells.middle[:, None] + WIDER * cells.width[:, None] * NODES).reshape(-1, 2))
    at, met = at.reshape(-1, 9, 2) / lens.stop_radius, met.reshape(-1, 9, met.shape[1])
    known = np.isfinite(at).all(axis=2)
    whole = known.all(axis=1)
    slopes = np.einsum("jk,nki->nij", SLOPES, np.where(whole[:, None, None], at, 0.0))
    off = np.abs(at - at[:, 4:5] - np.einsum("nij,kj->nki", slopes, NODES)).max(axis=(1, 2))
    low = np.where(known[:, :, None], at, np.inf).min(axis=1)
    high = np.where(known[:, :, None], at, -np.inf).max(axis=1)
    # The image ends at a border like a root: between nodes it goes on 2.5 times as far as it is wide at four of them.
    spare = np.where(whole, off, 3.0 * (high - low).max(axis=1))[:, None]
    bounds = np.where(
        (known.sum(axis=1) > 3)[:, None, None],
        np.stack([np.maximum(cells.bounds[:, 0], low - spare), np.minimum(cells.bounds[:, 1], high + spare)], axis=1),
        cells.bounds,
    )
    flat = whole & (off <= FLAT * np.linalg.norm(slopes, ord=-2, axis=(1, 2)))
    return _Images(at[:, 4], slopes / WIDER, bounds, flat, met.any(axis=1).all(axis=1), met[:, 4].all(axis=1))


def _rays(lens: Prescription, cells: _Cells, images: _Images, points: _Points) -> tuple[NDArray[np.int64], int]:
    """Find the rays of flat cells through points, and return the points and cells (n, 2) of the rays that pass.

    The second number counts the rays that were not found.
    """
    point, cell = points.within(images.bounds)
    back = np.linalg.inv(images.slopes)
    share = np.einsum("nij,nj->ni", back[cell], points.place[point] - images.middle[cell])
    near = np.abs(share).max(axis=1) < 0.5 + 4.0 * FLAT
    point, cell, share = point[near], cell[near], share[near]
    miss, passes, active = np.full(len(point), np.inf), np.zeros(len(point), np.bool_), np.arange(len(point))
    for _ in range(STEPS):
        at, met = lens.traced(cells.middle[cell[active]] + cells.width[cell[active]] * share[active])
        off = points.place[point[active]] - at / lens.stop_radius
        step = np.einsum("nij,nj->ni", back[cell[active]], off)
        share[active] += step
        miss[active], passes[active] = np.abs(off).max(axis=1), met.all(axis=1)
        active = active[~(np.abs(step).max(axis=1) < 1e-3 * SHARED)]
    inside, arrived = np.abs(share).max(axis=1) <= 0.5 + SHARED, miss <= ARRIVED
    lost = ~arrived & ~(np.abs(share).max(axis=1) > 0.5 + 4.0 * FLAT)
    return np.column_stack([point, cell])[inside & arrived & passes], int(lost.sum())


def _senses(slopes: Array) -> set[float]:
    """Return the senses, 1 or −1, in which linear maps (n, 2, 2) turn."""
    return set(np.sign(slopes[:, 0, 0] * slopes[:, 1, 1] - slopes[:, 0, 1] * slopes[:, 1, 0]).tolist())
