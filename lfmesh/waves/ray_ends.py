"""Ends of rays in the lens: the edges that end them, with their surfaces."""

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.scene import Lens
from lfmesh.scene.literals import percent

Whole = NDArray[np.int64]


class Edge(IntEnum):
    """Cause of the end of a ray."""

    NONE = 0
    APERTURE = 1
    STOP = 2
    MISSED = 3
    REFLECTED = 4
    OTHER_SIDE = 5
    CAUSTIC = 6
    UNKNOWN = 7
    EVANESCENT = 8
    TURNED = 9
    GLASS_EDGE = 10


WORDS = {
    Edge.APERTURE: "the clear aperture of surfaces[{}]",
    Edge.STOP: "the stop, surfaces[{}]",
    Edge.MISSED: "the end of surfaces[{}]",
    Edge.REFLECTED: "total reflection at surfaces[{}]",
    Edge.OTHER_SIDE: "another side of surfaces[{}]",
    Edge.CAUSTIC: "a caustic before the stop, beyond which no ray comes",
    Edge.UNKNOWN: "an unknown edge: ray aiming did not converge",
    Edge.EVANESCENT: "total reflection, or an order that is evanescent or without light, at surfaces[{}]",
    Edge.TURNED: "the gradient-index glass behind surfaces[{}], in which it turns away from the next surface",
    Edge.GLASS_EDGE: "the edge of the gradient-index glass behind surfaces[{}]",
}
"""Description of each edge, with the number of the surface."""

IN_GRADIENT = (Edge.TURNED, Edge.GLASS_EDGE)
"""Ends of rays between the faces of gradient-index glass."""


class Ends(NamedTuple):
    """Ends of rays.

    Attributes
    ----------
    edge : (n,) int64
        See `Edge`.
    surface : (n,) int64
        Number of the surface in the prescription; −1 for none.
    """

    edge: Whole
    surface: Whole

    def with_diffraction(self, lens: Lens) -> "Ends":
        """Return the ends with total reflection at diffractive faces named for its other cause, too."""
        diffractive = [i for i, surface in enumerate(lens.surfaces) if surface.phase is not None]
        either = (self.edge == Edge.REFLECTED) & np.isin(self.surface, diffractive)
        return Ends(np.where(either, int(Edge.EVANESCENT), self.edge), self.surface)

    def words_of(self, ray: int) -> str:
        """Return the name of the edge that ends a ray."""
        return WORDS[Edge(self.edge[ray])].format(self.surface[ray])

    def words(self) -> list[str]:
        """Return each edge that ends rays, with its fraction of all rays."""
        pairs, count = np.unique(np.stack([self.edge, self.surface]), axis=1, return_counts=True)
        return [
            f"{percent(n / len(self.edge))} by {WORDS[Edge(edge)].format(surface)}"
            for (edge, surface), n in zip(pairs.T, count, strict=True)
            if edge != Edge.NONE
        ]
