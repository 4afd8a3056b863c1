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
from lfmesh.transport.aims.lenslet_aim import ArraySeen, list_cells
from lfmesh.transport.aims.lenslet_faces import path_to_apexes
from lfmesh.transport.events.kick import drawn_kick

Array = NDArray[np.float64]

SEARCH_AFTER_KICK = 2.0
"""Factor on the distance at which lenslets are looked for, as changes of direction widen their views."""

SHIFT_IN_REACH, GROWTH_IN_REACH = 0.5, 1.25
"""Shift in pitches of the point that needs no change of direction, and growth of the views, up to which a sample takes
the lenslets that were listed for its pixel. The few samples beyond list their own, which takes far longer."""

MOST_GROWTH, WIDE_SHARE_AFTER_KICK = 2.0, 0.5
"""Growth of the views above which changes of direction are far, and the share of rays that go anywhere among samples
with such a one. Where lenslets are some twenty wavelengths wide, each hundredth ray is turned so far that the opening
is seen from nowhere, or in a view that no factor describes. They bring little light, which few and heavy rays would
gather in bright pixels."""

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
    return drawn_kick(apertures, colour, key, events + (EVENTS_BEHIND_FACES if apertures.to_lens else 0))


@kernel
def list_cells_of_pixel(array: ArraySeen, p: Vector, extent: tuple[float, float], near: Array) -> int:
    """List the lenslets by which points of a pixel may see the opening after changes of direction within reach.

    Parameters
    ----------
    array, p, extent, near
        As for `list_cells`.
    """
    lateral, deep = extent
    pitch, depth = array.mla.lenslets.lattice.pitch, abs(p[2] - array.aim.apex_z)
    # A difference in depth widens the views that are listed by this factor, and a little more.
    return list_cells(
        array, p, (lateral + SHIFT_IN_REACH * pitch, deep + (GROWTH_IN_REACH - 1.0) * (depth + deep)), near
    )


@inlined
def is_in_reach(array: ArraySeen, p: Vector, growth: float, seen_from: Vector) -> bool:
    """Tell whether the pixel's list holds the lenslets that a point of it needs after a change of direction.

    Parameters
    ----------
    array : ArraySeen
    p : (3,) float, mm
        Array frame.
    growth, seen_from
        From `without_kick`.
    """
    x, y, reach = seen_from[0] - p[0], seen_from[1] - p[1], SHIFT_IN_REACH * array.mla.lenslets.lattice.pitch
    return growth <= GROWTH_IN_REACH and x * x + y * y <= reach * reach


@kernel
def list_cells_after_kick(array: ArraySeen, growth: float, seen_from: Vector, near: Array) -> int:
    """List the lenslets by which a point of the sensor may see the opening after a change of direction.

    Parameters
    ----------
    array : ArraySeen
    growth, seen_from
        From `without_kick`.
    near : (n, LISTED) float64
        As for `list_cells`.
    """
    if not growth > 0.0:
        return 0
    return list_cells(array, seen_from, (0.0, (growth - 1.0) * abs(seen_from[2] - array.aim.apex_z)), near)


@inlined
def without_kick(array: ArraySeen, p: Vector, kick: tuple[float, float]) -> tuple[float, Vector]:
    """Return by what factor a change of direction widens the views of lenslets, and the point that sees them without.

    The factor is 0 where the point does not see the opening's centre. Otherwise it is the ratio of the changes of slope
    with direction cosine before and after, as the light of all of the opening is moved by the same direction cosines.

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
    after2 = 1.0 / (1.0 + sx * sx + sy * sy)
    scale = np.sqrt(after2)
    cx, cy = sx * scale, sy * scale
    bx, by = cx - kick[0], cy - kick[1]
    before2 = 1.0 - bx * bx - by * by
    if not before2 > 0.0:
        return 0.0, p
    across, before = _shift(cx, cy, air, plate, array.glass), _shift(bx, by, air, plate, array.glass)
    ratio = after2 / before2
    growth = (1.0 + np.sqrt(kick[0] * kick[0] + kick[1] * kick[1])) * max(1.0, ratio * np.sqrt(ratio))
    lever = array.mla.apertures.lever
    return growth, (p[0] + lever * (bx * before - cx * across), p[1] + lever * (by * before - cy * across), p[2])


@inlined
def _shift(cx: float, cy: float, air: float, plate: float, glass: float) -> float:
    """Return the lateral shift over air and glass, mm, of a ray with the given direction cosines, over these."""
    square = cx * cx + cy * cy
    return air / np.sqrt(1.0 - square) + plate / np.sqrt(glass * glass - square)
