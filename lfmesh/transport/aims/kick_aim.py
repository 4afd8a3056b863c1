"""Aim through lenslets that diffract, by the point that would send undiffracted light the same way.

The deflection is drawn before the lenslet. A deflected ray reaches the opening as an undeflected ray from another point
of the sensor does. That point is displaced by the difference of two paths to the lenslet: along the direction before
the deflection, and along that of the opening's centre. Lenslets are chosen as that point sees them, so nearly all rays
reach the opening, with the weights of rays without diffraction.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.aims.disk import Vector
from lfmesh.transport.aims.lenslet_aim import ArraySeen, Shown, cells_that_show, list_cells, most_listed
from lfmesh.transport.aims.lenslet_faces import path_to_apexes
from lfmesh.transport.tables.tables import LensletAim

Array = NDArray[np.float64]

SEARCH_AFTER_KICK, FURTHEST_SEARCH = 2.0, 5.0
"""Factor on the search distance for lenslets, as deflections widen their views, and its value for the widest views."""

SHIFT_IN_REACH, GROWTH_IN_REACH = 0.5, 1.25
"""Limits up to which a sample uses its pixel's list of lenslets: the shift of the undeflected point, in pitches at the
chief ray's intersection with the array, and the growth of the views. The few samples beyond list their own lenslets,
which takes far longer."""

MOST_GROWTH = 1.02
"""Growth of the views above which deflections are large: some rays go anywhere, and the proof of the aim ignores them.
For lenslets some twenty wavelengths wide, that is one ray in ten. For one in a hundred the opening is not seen at all,
or in a view that no factor describes."""

WIDE_SHARE_BY_GROWTH, MOST_WIDE_SHARE = 2.5, 0.5
"""Share of rays that go anywhere among samples with a large deflection, per growth beyond 1, and its maximum.

The views miss some thousandths of the light at a growth of 1.1, and some hundredths at 1.5. Rays that go anywhere weigh
about sixty times as much as rays to the views, over this share: a smaller share would gather that light in bright
pixels."""


def most_listed_after_kick(aim: LensletAim) -> int:
    """Return the largest number of lenslets listed for a pixel, plus those for a sample."""
    of_pixel = most_listed(aim, SEARCH_AFTER_KICK * aim.search + SHIFT_IN_REACH)
    return of_pixel + most_listed(aim, FURTHEST_SEARCH * aim.search)


@inlined
def list_cells_of_pixel(apertures: Any, array: ArraySeen, p: Vector, extent: tuple[float, float], near: Array) -> int:
    """List the lenslets that may show the opening to a pixel, also after deflections within reach.

    Parameters
    ----------
    apertures : Apertures or None
    array, p, extent, near
        As for `list_cells`.
    """
    lateral, deep = extent
    search = array.aim.search
    if apertures is not None:
        lateral += _shift_in_reach(array, p)
        # A difference in depth widens the listed views by this factor, and a little more.
        deep += (GROWTH_IN_REACH - 1.0) * (abs(p[2] - array.aim.apex_z) + deep)
        search = SEARCH_AFTER_KICK * search + SHIFT_IN_REACH
    return list_cells(array, p, (lateral, deep), search, near)


@inlined
def _shift_in_reach(array: ArraySeen, p: Vector) -> float:
    """Return the largest shift, mm, of the undeflected point for which lenslets are listed.

    It moves the chief ray's intersection with the array by `SHIFT_IN_REACH` pitches.
    """
    aim = array.aim
    return SHIFT_IN_REACH * array.mla.lenslets.lattice.pitch * (1.0 + aim.pupil_vergence * abs(p[2] - aim.apex_z))


@inlined
def shown_after_kick(
    apertures: Any, array: ArraySeen, near: Array, listed: int, cells: NDArray[np.int64], p: Vector,
    kick: tuple[float, float],
) -> tuple[Shown, float]:  # fmt: skip
    """Return the lenslets that show a point the opening after a deflection, and their views' growth.

    Parameters
    ----------
    apertures : Apertures or None
        None: no deflection.
    array : ArraySeen
    near, listed
        From `list_cells_of_pixel`; beyond its reach, the point's own lenslets are listed behind these.
    cells : (n,) int64
        As for `cells_that_show`.
    p : (3,) float, mm
        Array frame.
    kick : (2,) float
        See `events.kick.drawn_kick`.
    """
    if apertures is None:
        return cells_that_show(array, near, listed, cells, p, 1.0), 1.0
    growth, seen_from = without_kick(array, p, kick)
    x, y, reach, first = seen_from[0] - p[0], seen_from[1] - p[1], _shift_in_reach(array, p), 0
    if growth > GROWTH_IN_REACH or x * x + y * y > reach * reach:
        first, listed = listed, list_cells_after_kick(array, growth, seen_from, near[listed:])
    return cells_that_show(array, near[first:], listed, cells, seen_from, growth * growth), growth


@kernel
def list_cells_after_kick(array: ArraySeen, growth: float, seen_from: Vector, near: Array) -> int:
    """List the lenslets that may show a point the opening after a deflection.

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
    extent = 0.0, (growth - 1.0) * abs(seen_from[2] - array.aim.apex_z)
    wider = min(max(growth, SEARCH_AFTER_KICK), FURTHEST_SEARCH)
    return list_cells(array, seen_from, extent, wider * array.aim.search, near)


@inlined
def without_kick(array: ArraySeen, p: Vector, kick: tuple[float, float]) -> tuple[float, Vector]:
    """Return a deflection's factor on the width of lenslet views, and the point that sees them without it.

    The factor is 0 if the point does not see the opening's centre. Otherwise it is the ratio of the derivatives of
    slope by direction cosine before and after, as a deflection shifts all light by the same direction cosines.

    Parameters
    ----------
    array : ArraySeen
    p : (3,) float, mm
        Array frame.
    kick : (2,) float
        See `events.kick.drawn_kick`.
    """
    aim, (air, plate, _) = array.aim, path_to_apexes(array.mla, p[2])
    over, kappa = 1.0 / abs(p[2] - aim.apex_z), aim.pupil_vergence
    # Slope of the chief ray.
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
    growth = (1.0 + kick[0] * kick[0] + kick[1] * kick[1]) * max(1.0, ratio * np.sqrt(ratio))
    lever = array.mla.apertures.lever
    return growth, (p[0] + lever * (bx * before - cx * across), p[1] + lever * (by * before - cy * across), p[2])


@inlined
def wide_share_after_kick(growth: float) -> float:
    """Return the share of rays that go anywhere after a deflection; 0 unless it is large.

    After a large deflection, light also comes from elsewhere: see `MOST_GROWTH`.

    Parameters
    ----------
    growth : float
        From `without_kick`.
    """
    if 0.0 < growth <= MOST_GROWTH:
        return 0.0
    return min(WIDE_SHARE_BY_GROWTH * (growth - 1.0), MOST_WIDE_SHARE) if growth > 0.0 else MOST_WIDE_SHARE


@inlined
def _shift(cx: float, cy: float, air: float, plate: float, glass: float) -> float:
    """Return a ray's lateral shift over air and glass, mm, over its direction cosines."""
    square = cx * cx + cy * cy
    return air / np.sqrt(1.0 - square) + plate / np.sqrt(glass * glass - square)
