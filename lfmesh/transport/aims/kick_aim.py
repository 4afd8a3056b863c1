"""Aim through lenslets that diffract: the point from which light that is not diffracted would come the same way.

The change of direction is drawn before the lenslet is chosen. With it a ray reaches the opening where one from another
point of the sensor would without. That point lies off the ray's own by the difference of two ways to the lenslet: in
the direction before the change, and in the direction of the opening's centre. So lenslets are chosen as that point sees
them, whatever the change, and next to all rays reach the opening, with the weights that they have without diffraction.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.aims.disk import Vector
from lfmesh.transport.aims.lenslet_aim import VIEW_RADIUS2, ArraySeen, list_cells
from lfmesh.transport.aims.lenslet_faces import path_to_apexes
from lfmesh.transport.events.kick import drawn_kick

Array = NDArray[np.float64]

SEARCH_AFTER_KICK = 2.0
"""Factor on the distance at which lenslets are looked for, as changes of direction widen their views."""

EVENTS_OF_COVER, EVENTS_BEHIND_FACES = 2, 2
"""Interfaces that a packet from a pixel meets in the sensor's cover, and until it has left lenslets that look to the
lens. Those that look to the sensor diffract it before it meets any."""


@inlined
def first_kick(apertures: Any, array: ArraySeen, colour: int, key: np.uint64, has_cover: bool) -> tuple[float, float]:
    """Return the change of direction of a packet from a pixel at the first lenslet that it meets.

    Parameters
    ----------
    apertures : Apertures or None
    array : ArraySeen
    colour : int
        Number of the wavelength.
    key : uint64
        Of the packet.
    has_cover : bool
        The sensor has a cover.
    """
    if apertures is None:
        return 0.0, 0.0
    events = EVENTS_OF_COVER if has_cover else 0
    return drawn_kick(apertures, colour, key, events + (EVENTS_BEHIND_FACES if array.mla.curved_to_lens else 0))


@inlined
def list_cells_after_kick(array: ArraySeen, p: Vector, kick: tuple[float, float], near: Array) -> tuple[int, Vector]:
    """List the lenslets by which a point of the sensor may see the opening after a change of direction.

    Parameters
    ----------
    array : ArraySeen
    p : (3,) float, mm
        Array frame.
    kick : (2,) float
        See `first_kick`.
    near : (n, LISTED) float64
        As for `list_cells`.

    Returns
    -------
    listed : int
        Number of lenslets listed.
    seen_from : (3,) float, mm
        The point that sees the opening without the change.
    """
    growth, seen_from = _without_kick(array, p, kick)
    if not growth > 0.0:
        return 0, p
    # A difference in depth widens the views that are listed by this factor, and a little more.
    listed = list_cells(array, seen_from, (0.0, (growth - 1.0) * abs(p[2] - array.aim.apex_z)), near)
    for i in range(listed):
        near[i, VIEW_RADIUS2] *= growth * growth
    return listed, seen_from


@kernel
def _without_kick(array: ArraySeen, p: Vector, kick: tuple[float, float]) -> tuple[float, Vector]:
    """Return by what factor a change of direction widens the views of lenslets, and the point that sees them without.

    The factor is 0 where the point does not see the opening's centre. Otherwise it is the ratio of the changes of slope
    with direction cosine before and after, as the light of all of the opening is moved by the same direction cosines.
    """
    aim, (air, plate, _) = array.aim, path_to_apexes(array.mla, p[2])
    over, kappa = 1.0 / abs(p[2] - aim.apex_z), aim.pupil_vergence
    # The slope of the chief ray.
    sx, sy = kappa * over * (aim.pupil_x - p[0]) / (kappa + over), kappa * over * (aim.pupil_y - p[1]) / (kappa + over)
    after2 = 1.0 / (1.0 + sx * sx + sy * sy)
    scale = np.sqrt(after2)
    cx, cy = sx * scale, sy * scale
    bx, by = cx - kick[0], cy - kick[1]
    before2 = 1.0 - bx * bx - by * by
    if not before2 > 0.0:
        return 0.0, p
    across, before = _shift(cx, cy, air, plate, array.glass), _shift(bx, by, air, plate, array.glass)
    growth = (1.0 + np.sqrt(kick[0] * kick[0] + kick[1] * kick[1])) * max(1.0, (after2 / before2) ** 1.5)
    return growth, (p[0] + bx * before - cx * across, p[1] + by * before - cy * across, p[2])


@inlined
def _shift(cx: float, cy: float, air: float, plate: float, glass: float) -> float:
    """Return the lateral shift over air and glass, mm, of a ray with the given direction cosines, over these."""
    square = cx * cx + cy * cy
    return air / np.sqrt(1.0 - square) + plate / np.sqrt(glass * glass - square)
