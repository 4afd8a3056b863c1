"""Aim through lenslets that diffract: the point from which light that is not diffracted would come the same way.

The change of direction is drawn before the lenslet is chosen. With it a ray reaches the opening where one from another
point of the sensor would without. That point lies off the ray's own by the difference of two ways to the lenslet: in
the direction before the change, and in the direction of the opening's centre. So lenslets are chosen as that point sees
them, whatever the change, and next to all rays reach the opening, with the weights that they have without diffraction.
"""

from typing import Any

import numpy as np

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.aims.disk import Vector
from lfmesh.transport.aims.lenslet_aim import ArraySeen
from lfmesh.transport.aims.lenslet_faces import path_to_apexes
from lfmesh.transport.events.kick import drawn_kick

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


@kernel
def point_without_kick(array: ArraySeen, p: Vector, kick: tuple[float, float]) -> tuple[bool, Vector]:
    """Return whether a point may see the opening by a change of direction, and the point that sees it without.

    Parameters
    ----------
    array : ArraySeen
    p : (3,) float, mm
        Array frame.
    kick : (2,) float
        See `first_kick`.
    """
    aim, (air, plate, _) = array.aim, path_to_apexes(array.mla, p[2])
    over, kappa = 1.0 / abs(p[2] - aim.apex_z), aim.pupil_vergence
    # The slope of the chief ray.
    sx, sy = kappa * over * (aim.pupil_x - p[0]) / (kappa + over), kappa * over * (aim.pupil_y - p[1]) / (kappa + over)
    scale = 1.0 / np.sqrt(1.0 + sx * sx + sy * sy)
    cx, cy = sx * scale, sy * scale
    bx, by = cx - kick[0], cy - kick[1]
    if not bx * bx + by * by < 1.0:
        return False, p
    across, before = _shift(cx, cy, air, plate, array.glass), _shift(bx, by, air, plate, array.glass)
    return True, (p[0] + bx * before - cx * across, p[1] + by * before - cy * across, p[2])


@inlined
def _shift(cx: float, cy: float, air: float, plate: float, glass: float) -> float:
    """Return the lateral shift over air and glass, mm, of a ray with the given direction cosines, over these."""
    square = cx * cx + cy * cy
    return air / np.sqrt(1.0 - square) + plate / np.sqrt(glass * glass - square)
