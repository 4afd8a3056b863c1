"""Bodies of glass around the starting points of light: a ray from inside a tank starts in its water."""

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.objects.targets import TargetMesh
from lfmesh.transport.events.bodies import BITS, LOW, LOW_BITS, MOST_AT_ONCE, RANK
from lfmesh.transport.tables.tables import AIR, ObjectTables


def glass_round(objects: ObjectTables, targets: list[TargetMesh], points: Array) -> NDArray[np.int64]:
    """Return the bodies of glass around points, (n,) int64 as packets hold them; 0: none.

    Parameters
    ----------
    objects : ObjectTables
    targets : list of TargetMesh
        World frame.
    points : (n, 3) float64, mm, world frame

    Raises
    ------
    LfmeshError
        A point lies in more bodies than packets can keep.
    """
    inside = np.zeros(len(points), np.int64)
    bodies = np.flatnonzero(objects.rank)
    if not len(bodies) or not len(points):
        return inside
    boxes = np.array([targets[body].box_mm for body in bodies])
    low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    # Most rays start far from all glass, many of them at the same points.
    near = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
    places, of_point = np.unique(points[near], axis=0, return_inverse=True)
    number = np.zeros(len(places), np.int64)
    count = np.zeros(len(places), np.int64)
    for body in sorted(bodies, key=lambda i: -int(objects.rank[i])):
        within = targets[body].holds(places)
        if (count[within] == MOST_AT_ONCE).any():
            x, y, z = places[within & (count == MOST_AT_ONCE)][0]
            raise LfmeshError(
                f"light starts at ({x:.4g}, {y:.4g}, {z:.4g}) mm, in more than {MOST_AT_ONCE} bodies of glass at once; "
                f"the limit is {MOST_AT_ONCE}"
            )
        number[within] |= objects.rank[body] << (BITS * count[within])
        count[within] += 1
    inside[near] = number[of_point.reshape(-1)]
    return inside


def places_round(
    objects: ObjectTables, targets: list[TargetMesh], points: Array
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the bodies around points, as `glass_round` does, and the numbers of the media there, (n,) int64 each.

    Parameters
    ----------
    objects : ObjectTables
    targets : list of TargetMesh
        World frame.
    points : (n, 3) float64, mm, world frame
    """
    inside = glass_round(objects, targets, points)
    media, some = np.full(len(points), AIR), np.flatnonzero(inside)
    media[some] = objects.medium[objects.by_rank[inside[some] & RANK]]
    return inside, media


def start_inside(packets: NDArray[np.void], inside: NDArray[np.int64], objects: ObjectTables) -> None:
    """Let packets in object space start inside bodies of glass.

    Parameters
    ----------
    packets : (n,) PACKET
    inside : (n,) int64
        From `glass_round`; packets with 0 stay unchanged.
    objects : ObjectTables
    """
    some = np.flatnonzero(inside)
    packets["bodies"][some] = inside[some] & LOW
    packets["space"][some] = inside[some] >> LOW_BITS
    packets["medium"][some] = objects.medium[objects.by_rank[inside[some] & RANK]]
