"""Table of the sensor's cover glass for kernels."""

from typing import NamedTuple

import numpy as np

from lfmesh.geometry import frame
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.kernels.by_address import by_address
from lfmesh.scene import Scene
from lfmesh.scene.first_order.cover import cover_shift_mm
from lfmesh.transport.packets.book import Book
from lfmesh.transport.packets.packet import SENSOR_FRAME
from lfmesh.transport.tables.media import MediumList
from lfmesh.transport.tables.tables import Interfaces, Media

FRONT_ROW, REAR_ROW = 0, 1
"""Rows of the cover's interfaces: the face towards the lens, and the face towards the sensor."""


@by_address
class CoverTables(NamedTuple):
    """The cover in the sensor's frame."""

    front_z: float  # mm, negative
    rear_z: float
    media: Media
    medium: int  # medium of the plate
    interfaces: Interfaces  # FRONT_ROW and REAR_ROW


def cover_tables(
    scene: Scene, wavelengths_nm: tuple[float, ...], interfaces: Interfaces, known: MediumList, book: Book
) -> CoverTables | None:
    """Return the cover of a scene's sensor; None without one.

    Parameters
    ----------
    scene : Scene
    wavelengths_nm : tuple of float
    interfaces : Interfaces
    known : MediumList
    book : Book
    """
    cover = scene.camera.sensor.cover
    if cover is None:
        return None
    medium = known.in_camera(cover.medium)
    media = known.table_behind_lens(wavelengths_nm, book, (medium,))
    return CoverTables(-cover.height_mm, -cover.gap_mm, media, medium, interfaces)


def apparent_frames(scene: Scene, moves: Array) -> Array:
    """Return the moves between frames with the sensor at its apparent place behind its cover.

    A plane-parallel plate keeps directions and moves rays sideways, to first order as if the sensor were nearer by
    t (1 - 1/n), with n relative to the medium outside. Rays are aimed from there. Without a cover the moves are
    unchanged.

    Parameters
    ----------
    scene : Scene
    moves : (6, 6, 3, 4) float64
    """
    nearer = cover_shift_mm(scene.camera, scene.primary_nm)
    if nearer == 0.0:
        return moves
    from_apparent = frame.frame(origin_mm=np.array([0.0, 0.0, -nearer]))
    seen = moves.copy()
    for other in range(len(moves)):
        if other != SENSOR_FRAME:
            seen[SENSOR_FRAME, other] = frame.compose(moves[SENSOR_FRAME, other], from_apparent)
            seen[other, SENSOR_FRAME] = frame.compose(frame.inverse(from_apparent), moves[other, SENSOR_FRAME])
    return seen
