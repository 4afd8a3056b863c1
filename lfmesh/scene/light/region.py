"""The emitting region of a lamp: a point, line, rectangle or disk, with bounds that enclose it."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

Shape = Literal["straight", "round"]
"""Shapes of regions: points, lines and rectangles fill their box; disks are inscribed in it."""

CORNERS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


@dataclass(frozen=True, eq=False)
class Region:
    """Points of a lamp, spanned by two perpendicular half axes about its centre.

    Both half axes are zero for a point, one for a line.

    Attributes
    ----------
    centre_mm : (3,) float64
    half_mm : (2, 3) float64
        Half axes.
    shape : str
        Shape within the rectangle of the half axes, which have equal length if it is round.
    """

    centre_mm: Array
    half_mm: Array = field(default_factory=lambda: np.zeros((2, 3)))
    shape: Shape = "straight"

    @property
    def is_round(self) -> bool:
        """True for a disk."""
        return self.shape != "straight"

    @property
    def lengths_mm(self) -> Array:
        """Lengths of the half axes, (2,) float64."""
        return np.hypot(np.hypot(self.half_mm[:, 0], self.half_mm[:, 1]), self.half_mm[:, 2])

    @property
    def size_mm(self) -> float:
        """Radius of the smallest sphere about the centre that contains the region."""
        one, other = self.lengths_mm
        return float(one if self.is_round else np.hypot(one, other))

    @property
    def area_mm2(self) -> float:
        """Area; 0 for points and lines."""
        one, other = self.lengths_mm
        return float(one * other) * (np.pi if self.shape == "round" else 4.0)

    @property
    def spine_mm(self) -> Array:
        """Half of the central segment that has every point of the region within `thickness_mm`, (3,)."""
        one, other = self.lengths_mm
        longer = int(other > one)
        longest = max(one, other)
        return self.half_mm[longer] * ((longest - min(one, other)) / longest if longest > 0.0 else 0.0)

    @property
    def thickness_mm(self) -> float:
        """Largest distance of a point of the region from the segment of `spine_mm`."""
        return float(self.lengths_mm.min() * (1.0 if self.is_round else np.sqrt(2.0)))

    @property
    def corners_mm(self) -> Array:
        """Corners of a convex hull that contains the region, (n, 3) float64: one, two or four, in cyclic order."""
        used = self.lengths_mm > 0.0
        corners = np.unique(CORNERS * used, axis=0) if used.sum() < 2 else CORNERS
        return self.centre_mm + corners @ self.half_mm

    def reach_mm(self, directions: Array) -> Array:
        """Return the extent of the region from its centre along unit directions (n, 3), (n,) float64."""
        along = np.abs(directions @ self.half_mm.T)
        return np.asarray(np.hypot(*along.T) if self.is_round else along.sum(axis=1))

    def holds(self, start_mm: Array, end_mm: Array, margin_mm: Array) -> NDArray[np.bool_]:
        """Tell for segments in the plane of the region if they enter it by more than a margin.

        Parameters
        ----------
        start_mm, end_mm : (n, 3) float64
        margin_mm : (n,) float64

        Returns
        -------
        (n,) bool
        """
        lengths = self.lengths_mm
        axes = np.divide(self.half_mm, lengths[:, None], out=np.zeros((2, 3)), where=lengths[:, None] > 0.0)
        start, end = ((place - self.centre_mm) @ axes.T for place in (start_mm, end_mm))
        way = end - start
        first, last = np.zeros(len(way)), np.ones(len(way))
        if self.is_round:
            square = (way**2).sum(axis=1)
            share = np.clip(np.divide(-(start * way).sum(axis=1), square, out=first, where=square > 0.0), 0.0, 1.0)
            return np.asarray(np.linalg.norm(start + share[:, None] * way, axis=1) < lengths[0] - margin_mm)
        for axis in np.flatnonzero(lengths > 0.0):
            # The part of the segment between two parallel edges.
            for sense in (-1.0, 1.0):
                inside, change = lengths[axis] - margin_mm - sense * start[:, axis], -sense * way[:, axis]
                with np.errstate(divide="ignore", invalid="ignore"):
                    meets = -inside / change
                first = np.where(change > 0.0, np.maximum(first, meets), first)
                last = np.where(change < 0.0, np.minimum(last, meets), last)
                last = np.where((change == 0.0) & (inside <= 0.0), -np.inf, last)
        return np.asarray(first < last)
