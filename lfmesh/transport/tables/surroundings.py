"""Boxes and planes around everything near the lens, for quick tests of rays.

A ray that clears them meets no target and no part of the housing, so Embree need not be asked. All bounds are
conservative for float32 queries.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from lfmesh.geometry.frame import points
from lfmesh.geometry.lens.lens_shape import LensShape
from lfmesh.geometry.meshes.mesh import Array, Mesh
from lfmesh.geometry.surfaces.tessellation import FLOAT32_MARGIN
from lfmesh.kernels.by_address import by_address
from lfmesh.transport.packets.packet import CAMERA_FRAME, OBJECT_FRAME, WORLD_FRAME
from lfmesh.transport.tables.lens import outermost
from lfmesh.transport.tables.tables import LensTables

MOST_BOXES = 8
"""Largest number of boxes, each tested for every ray; more targets share one box."""

FARTHEST = 8.0
"""Largest distance of ray starts, over the distance of the targets: the boxes have slack for float32 rounding up to
there."""

LENS_SLACK = 0.02
"""Distance kept from the lens, over its length; between their rings, meshes deviate from their surfaces."""


@by_address
class Surroundings(NamedTuple):
    """Bounds of lens, housing and targets in the camera frame, mm."""

    before: float  # points of smaller z are in object space, in front of lens and housing
    behind: float  # points of larger z, inside the housing, are behind the lens
    end: float  # z where the housing ends
    outline: float  # radius within which points between `behind` and `end` are inside the housing
    plate: float  # z of the front of the housing
    opening: float  # radius of the opening in it
    low: Array  # (3,) corners of the box that holds the lens
    high: Array
    boxes: Array  # (n, 2, 3) corners of the boxes around the targets
    farthest: float  # bound of a start's coordinates within which the boxes are large enough


def surroundings_of(
    lens: LensTables, shape: LensShape, housing: Mesh, targets: Iterable[Mesh], frames: Array
) -> Surroundings:
    """Return the bounds of a built scene.

    Parameters
    ----------
    lens : LensTables
    shape : LensShape
    housing : Mesh
        Camera frame.
    targets : iterable of Mesh
        World frame.
    frames : (6, 6, 3, 4) float64
        See `frame_table`.
    """
    caps = outermost(shape)
    low, high = float(caps[:, 2].min()), float(caps[:, 2].max())
    slack = LENS_SLACK * (high - low) + FLOAT32_MARGIN * float(np.abs(caps).max())
    radius, z = np.hypot(housing.vertices[:, 0], housing.vertices[:, 1]), housing.vertices[:, 2]
    plate, end = float(z.min()), float(z.max())
    on_plate = z <= plate + FLOAT32_MARGIN * float(np.abs(housing.vertices).max())
    # The opening is a polygon with sides nearer to the axis than its corners; Embree has it in the object frame.
    rounding = FLOAT32_MARGIN * float(np.abs(points(frames[CAMERA_FRAME, OBJECT_FRAME], housing.vertices)).max())
    opening = float(radius[on_plate].min()) * np.cos(np.pi / shape.azimuths) - rounding
    before = min(low - slack, plate)
    # A box that reached behind the plate could be entered from the side only through the housing.
    starts = before if lens.box_low[2] <= plate else -np.inf
    boxes, farthest = _boxes(targets, frames)
    return Surroundings(
        before=float(starts),
        behind=high + slack,
        end=end,
        outline=float(radius.max()) * (1.0 - FLOAT32_MARGIN),
        plate=plate,
        opening=max(0.0, float(opening)),
        low=lens.box_low,
        high=lens.box_high,
        boxes=boxes,
        farthest=farthest,
    )


def _boxes(targets: Iterable[Mesh], frames: Array) -> tuple[Array, float]:
    """Return boxes around targets, enlarged by float32 rounding, and the largest coordinate of ray starts."""
    found, farthest = [], np.inf
    for mesh in targets:
        p = points(frames[WORLD_FRAME, CAMERA_FRAME], mesh.vertices)
        size = float(np.abs(p).max() + np.abs(points(frames[WORLD_FRAME, OBJECT_FRAME], mesh.vertices)).max())
        slack = FLOAT32_MARGIN * size
        found.append([p.min(axis=0) - slack, p.max(axis=0) + slack])
        farthest = min(farthest, FARTHEST * size)
    boxes = np.array(found).reshape(-1, 2, 3)
    if len(boxes) > MOST_BOXES:
        boxes = np.array([[boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)]])
    return boxes, farthest
