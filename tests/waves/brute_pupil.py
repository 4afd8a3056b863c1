"""Pupils by brute force: which points of the stop the light of an object point reaches that passes a lens of spheres.

A grid of rays over the whole front of the lens is traced. Triangles of neighbouring rays that all pass are carried to
the stop, and those at the borders are divided until what is left is narrower than any distance that matters. Nothing is
aimed, and no code is shared with the package.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CELLS, LEVELS, DEEPEST = 72, 7, 30
"""Cells of the grid along each axis; how often those at borders are divided in two along each axis, and how often if
they lie over a point."""


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

    def traced(self, entry: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return where rays that cross the plane of the first vertex at `entry` (n, 2) meet the stop.

        And which conditions they meet, (n, conditions): each surface has to be there, hold the ray within its aperture,
        and refract it.
        """
        vergence = 1.0 / self.object_mm
        d = np.column_stack([entry[:, 0] * vergence, entry[:, 1] * vergence - self.slope, np.ones(len(entry))])
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        p = np.column_stack([entry, np.zeros(len(entry))])
        met, at_stop, vertex, index = [], np.full((len(p), 2), np.nan), 0.0, 1.0
        again = np.full(len(p), np.inf)
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
                d = ratio * d + (np.sqrt(square) - ratio * cosine)[:, None] * normal
                if "radius_mm" in surface:
                    again = self._again(q, d, c, MOUNT * surface["semi_diameter_mm"])
                if surface.get("stop"):
                    at_stop = q[:, :2]
                p, index = q + np.array([0.0, 0.0, vertex]), after
                vertex += surface.get("thickness_mm", 0.0)
        return at_stop, np.stack([*met, np.isinf(again)], axis=1)

    @staticmethod
    def _again(q: Array, d: Array, c: float, rim: float) -> Array:
        """Return at which distance rays meet the hollow surface again that they leave; inf: they do not."""
        if c == 0.0:
            return np.full(len(q), np.inf)
        again = -2.0 * (c * (q * d).sum(axis=1) - d[:, 2]) / c
        x, y, z = (q + again[:, None] * d).T
        return np.where((again > 0.0) & (c * z < 1.0) & (np.hypot(x, y) <= rim), again, np.inf)

    def box(self) -> tuple[Array, Array]:
        """Return corners of the rectangle in the plane of the first vertex through which all rays enter the glass."""
        angle, vertex = np.linspace(0.0, 2.0 * math.pi, 720), 0.0
        for surface in self.surfaces:
            radius, rim = surface.get("radius_mm", math.inf), surface["semi_diameter_mm"]
            z = vertex + (0.0 if math.isinf(radius) else radius - math.copysign(math.sqrt(radius**2 - rim**2), radius))
            if "radius_mm" in surface:
                break
            vertex += surface["thickness_mm"]
        at = np.column_stack([rim * np.cos(angle), rim * np.sin(angle)])
        # From x(z) = e + z (e / object − slope).
        every = (at + z * np.array([0.0, self.slope])) / (1.0 + z / self.object_mm)
        middle, half = 0.5 * (every.min(axis=0) + every.max(axis=0)), 0.5 * np.ptp(every, axis=0)
        return middle - 1.013 * half, middle + 1.007 * half


@dataclass(frozen=True)
class Reached:
    """Points of the stop that light reaches which passes.

    Attributes
    ----------
    rays : (n,) int64
        Number of rays through each point.
    folded : bool
        Whether rays cross before the stop, so that parts of the grid lie turned over there.
    """

    rays: NDArray[np.int64]
    folded: bool


def reached(lens: Prescription, across: int) -> Reached:
    """Find which points of the square grid in the stop, see `pupil_grid`, rays reach that pass the lens."""
    low, high = lens.box()
    step = (high - low) / CELLS
    j, i = (each.ravel() for each in np.meshgrid(np.arange(CELLS), np.arange(CELLS), indexing="ij"))
    corner, count, turned = low + np.column_stack([i, j]) * step, np.zeros((across, across), np.int64), set()
    radius = next(s["semi_diameter_mm"] for s in lens.surfaces if s.get("stop"))
    for level in range(DEEPEST + 1):
        four = corner[:, None, :] + step * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
        at, met = lens.traced(four.reshape(-1, 2))
        at, met = at.reshape(len(corner), 4, 2) / radius, met.reshape(len(corner), 4, met.shape[1])
        whole = met.all(axis=(1, 2))
        for corners in HALVES:
            turned |= _painted(at[whole][:, corners], count)[0]
        # Where each condition is met at some corner, all may be met between them.
        border = met.any(axis=1).all(axis=1) & ~whole
        if level >= LEVELS:
            number, doubtful = np.flatnonzero(border), np.zeros((across, across), np.int64)
            over = [_painted(at[number][:, corners], doubtful)[1] for corners in HALVES]
            border = np.zeros(len(border), np.bool_)
            border[number[np.concatenate(over)]] = True
        step = 0.5 * step
        corner = (corner[border][:, None, :] + step * np.array([[0, 0], [1, 0], [0, 1], [1, 1]])).reshape(-1, 2)
    steps = (np.arange(across) - 0.5 * (across - 1)) / (0.5 * across)
    x, y = np.meshgrid(steps, steps, indexing="xy")
    inside = x * x + y * y <= 1.0
    return Reached(count[inside], len(turned) > 1)


HALVES = ([0, 1, 2], [0, 2, 3])
"""Corners of the two triangles of a cell."""


def _painted(triangles: Array, into: NDArray[np.int64]) -> tuple[set[int], NDArray[np.int64]]:
    """Count for each point of the grid [row of y, column of x] the triangles over it.

    Returns the senses in which triangles turn, and the numbers of those that lie over a point.
    """
    across, known = len(into), np.flatnonzero(np.isfinite(triangles).all(axis=(1, 2)))
    triangles = triangles[known]
    if not len(triangles):
        return set(), known
    pixels = (triangles + 1.0) * 0.5 * across - 0.5
    a, b, c = pixels.transpose(1, 0, 2)
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    signs = set(np.sign(area[np.abs(area) > 1e-9 * np.abs(area).max()]).astype(int).tolist())
    first = np.clip(np.ceil(pixels.min(axis=1)), 0, across).astype(np.int64)
    last = np.clip(np.floor(pixels.max(axis=1)), -1, across - 1).astype(np.int64)
    wide = np.maximum(last - first + 1, 0)
    number = wide.prod(axis=1)
    which = np.repeat(np.arange(len(triangles)), number)
    within = np.arange(len(which)) - np.repeat(np.cumsum(number) - number, number)
    x = first[which, 0] + within % np.maximum(wide[which, 0], 1)
    y = first[which, 1] + within // np.maximum(wide[which, 0], 1)
    point = np.column_stack([x, y])
    inside = np.ones(len(which), np.bool_)
    for p, q in ((a, b), (b, c), (c, a)):
        edge, off = (q - p)[which], point - p[which]
        inside &= (edge[:, 0] * off[:, 1] - edge[:, 1] * off[:, 0]) * np.sign(area[which]) > 0.0
    np.add.at(into, (y[inside], x[inside]), 1)
    return signs, known[np.unique(which[inside])]
