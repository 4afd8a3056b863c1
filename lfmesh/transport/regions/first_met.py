"""First facets and round faces met by single rays in object space, for questions before tracing.

Embree identifies the facet, as for packets; the distance is that of its plane, in float64.
"""

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.objects.round_faces import RoundFaces, first_round, round_normal
from lfmesh.geometry.ray import Ray, along
from lfmesh.kernels.decorators import kernel
from lfmesh.transport.regions.embree import Finder
from lfmesh.transport.tables.tables import ObjectTables

Array = NDArray[np.float64]


def first_met(
    objects: ObjectTables, finder: Finder, starts: Array, directions: Array
) -> tuple[NDArray[np.int64], Array, Array]:  # fmt: skip
    """Return the first facet that each ray meets.

    Parameters
    ----------
    objects : ObjectTables
    finder : Finder
        Finder of object space.
    starts, directions : (n, 3) float64
        Rays in the object frame, mm and unit vectors.

    Returns
    -------
    facet : (n,) int64
        Number of the facet, round faces numbered last; −1: the ray meets nothing.
    t : (n,) float64, mm
        Distance; inf if the ray meets nothing.
    normal : (n, 3) float64
        Unit normal of the facet, on whichever side the ray arrives.
    """
    if not len(objects.facets):
        return np.full(len(starts), -1), np.full(len(starts), np.inf), np.zeros((len(starts), 3))
    facet = finder.find(starts.astype(np.float32), directions.astype(np.float32)).astype(np.int64)
    rows = objects.facets[np.maximum(facet, 0)]
    normal = rows["normal"].copy()
    with np.errstate(divide="ignore", invalid="ignore"):
        height = np.einsum("ij,ij->i", normal, starts) - rows["offset"]
        t = -height / np.einsum("ij,ij->i", normal, directions)
    met = (facet >= 0) & np.isfinite(t) & (t > 0.0)
    facet, t = np.where(met, facet, -1), np.where(met, t, np.inf)
    if objects.rounds is not None:
        _meet_rounds(objects.rounds, starts, directions, facet, t, normal)
    return facet, t, normal


@kernel
def _meet_rounds(
    rounds: RoundFaces, starts: Array, directions: Array, facet: NDArray[np.int64], t: Array, normal: Array
) -> None:
    """Replace hits by nearer hits on round faces, in place."""
    for i in range(len(starts)):
        ray = Ray(starts[i, 0], starts[i, 1], starts[i, 2], directions[i, 0], directions[i, 1], directions[i, 2])
        number, nearest, _ = first_round(rounds, None, ray, -1, t[i])
        if number >= 0:
            x, y, z = along(ray, nearest)
            nx, ny, nz = round_normal(rounds.faces[number], x, y, z)
            facet[i], t[i] = rounds.first + number, nearest
            normal[i, 0], normal[i, 1], normal[i, 2] = nx, ny, nz
